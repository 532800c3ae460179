"""Conventions of the whole project, and the SE(3) helpers that follow them.

- SI units and radians. World is z-up (ENU). Body is x forward, y left, z up (FLU).
- Quaternions are wxyz (MuJoCo's). SciPy's xyzw is converted by the one pair of functions below.
- ``T_a_b`` is a 4×4 float64 array that maps b-coordinates to a: ``p_a = T_a_b @ p_b``. det R = +1.
- Vectors end in ``_w``, ``_b`` or ``_c`` (world, body, camera).
- Twists are linear, then angular. MuJoCo's free joint has linear velocity in world and angular in
  body: converted where it is read.
- Camera frames are OpenCV's (z forward, x right, y down); MuJoCo's (−z forward) is flipped by one
  constant. Depth is metres along the optical axis, float32, 0 where there is no return
  (observations must lie in bounded Boxes, so never NaN).
- Point clouds are (N, 3) float64; images (H, W, 3) uint8; boxes are xyxy pixels.

Functions take any leading axes ``(...)`` and return new float64 arrays. ``@`` composes: ``T_a_c = T_a_b @ T_b_c``.
A wrong shape, a value that is not finite, or a matrix that is not a rotation raises ValueError naming the argument.
Formulas follow Solà, Deray & Atchuthan 2018, "A micro Lie theory for state estimation in robotics".
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

CAMERA_FROM_MUJOCO: Array = np.diag([1.0, -1.0, -1.0, 1.0])
"""(4, 4) ``T_opencv_mujoco``: ``T_w_c = T_w_mujococamera @ CAMERA_FROM_MUJOCO``; it is its own inverse."""
CAMERA_FROM_MUJOCO.setflags(write=False)

ROTATION_TOLERANCE = 1e-6
"""Largest entry of ``RᵀR − I`` that still counts as a rotation."""


# --- checks -----------------------------------------------------------------------------------------------------------


def as_array(value: ArrayLike, shape: tuple[int, ...], name: str) -> Array:
    """`value` as a finite float64 array whose trailing axes are `shape`.

    Raises:
        ValueError: naming the argument, the expected and the actual shape, or the first value that is not finite.
    """
    array = np.asarray(value, dtype=np.float64)
    if array.shape[-len(shape) :] != shape:
        expected = ", ".join(map(str, shape))
        raise ValueError(f"{name}: expected shape (..., {expected}), got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name}: expected finite values, got {array[~np.isfinite(array)][0]}")
    return array


def _rotation_fault(R: Array, tolerance: float) -> str | None:
    """What keeps finite (..., 3, 3) matrices from being rotations, or None."""
    if R.size == 0:
        return None
    gap = np.abs(np.swapaxes(R, -1, -2) @ R - np.eye(3)).max()
    if gap > tolerance:
        return (
            f"expected orthonormal columns, got max |RᵀR − I| = {gap:.3g} (tolerance {tolerance:g}); see project_to_so3"
        )
    determinant = np.linalg.det(R).min()
    return f"expected det R = +1, got {determinant:.6g}: a reflection" if determinant < 0 else None


def is_rotation(R: ArrayLike, tolerance: float = ROTATION_TOLERANCE) -> bool:
    """Whether every (..., 3, 3) matrix is finite and orthonormal to `tolerance` with det +1."""
    R = np.asarray(R, dtype=np.float64)
    return R.shape[-2:] == (3, 3) and bool(np.isfinite(R).all()) and _rotation_fault(R, tolerance) is None


def check_rotation(R: ArrayLike, name: str = "R", tolerance: float = ROTATION_TOLERANCE) -> Array:
    """`R` as a (..., 3, 3) float64 array, after making sure that it holds rotations.

    Raises:
        ValueError: saying which property fails, and by how much.
    """
    R = as_array(R, (3, 3), name)
    if fault := _rotation_fault(R, tolerance):
        raise ValueError(f"{name}: {fault}")
    return R


def check_transform(T: ArrayLike, name: str = "T", tolerance: float = ROTATION_TOLERANCE) -> Array:
    """`T` as a (..., 4, 4) float64 array, after making sure that it holds rigid transforms.

    Raises:
        ValueError: saying which property fails: shape, finiteness, last row, orthonormality or determinant.
    """
    T = as_array(T, (4, 4), name)
    if T.size and np.abs(T[..., 3, :] - [0.0, 0.0, 0.0, 1.0]).max() > tolerance:
        raise ValueError(f"{name}: expected a last row of (0, 0, 0, 1), got {T[..., 3, :].tolist()}")
    if fault := _rotation_fault(T[..., :3, :3], tolerance):
        raise ValueError(f"{name}: {fault}")
    return T


# --- transforms -------------------------------------------------------------------------------------------------------


def transform(R: ArrayLike, t: ArrayLike) -> Array:
    """(..., 4, 4) transform from rotation (..., 3, 3) and translation (..., 3) [m]; leading axes broadcast."""
    R, t = as_array(R, (3, 3), "R"), as_array(t, (3,), "t")
    T = np.zeros(np.broadcast_shapes(R.shape[:-2], t.shape[:-1]) + (4, 4))
    T[..., :3, :3] = R
    T[..., :3, 3] = t
    T[..., 3, 3] = 1.0
    return T


def inverse(T: ArrayLike) -> Array:
    """``T_b_a`` from ``T_a_b`` (..., 4, 4), by transposing the rotation (exact for rigid transforms only)."""
    T = as_array(T, (4, 4), "T")
    R_inverse = np.swapaxes(T[..., :3, :3], -1, -2)
    return transform(R_inverse, -np.einsum("...ij,...j->...i", R_inverse, T[..., :3, 3]))


def transform_points(T: ArrayLike, p: ArrayLike) -> Array:
    """``p_a`` from ``T_a_b`` (..., 4, 4) and ``p_b``: one point (3,) or points (..., N, 3) [m].

    The axes before N broadcast against those of T: one T takes any points; T (B, 4, 4) with p (N, 3) gives (B, N, 3).
    """
    T, p = as_array(T, (4, 4), "T"), as_array(p, (3,), "p")
    points = p[None] if p.ndim == 1 else p
    moved = points @ np.swapaxes(T[..., :3, :3], -1, -2) + T[..., None, :3, 3]
    return moved[..., 0, :] if p.ndim == 1 else moved


def project_to_so3(M: ArrayLike) -> Array:
    """The rotation nearest to each (..., 3, 3) matrix in Frobenius norm: det +1 always, never a reflection.

    Singular values with the last sign set by the determinant (Umeyama 1991, lemma).

    Raises:
        ValueError: if a matrix has rank below two, so that no nearest rotation stands out.
    """
    M = as_array(M, (3, 3), "M")
    U, s, Vt = np.linalg.svd(M)
    if np.any(s[..., 1] <= 1e-12 * s[..., 0]):
        raise ValueError(f"M: expected rank 2 or more to define a rotation, got singular values {s.tolist()}")
    U[..., :, 2] *= np.sign(np.linalg.det(U @ Vt))[..., None]
    return U @ Vt


# --- rotations --------------------------------------------------------------------------------------------------------


def skew(v: ArrayLike) -> Array:
    """(..., 3, 3) matrix of the cross product: ``skew(v) @ x = v × x`` for v (..., 3)."""
    v = as_array(v, (3,), "v")
    S = np.zeros(v.shape + (3,))
    S[..., 0, 1], S[..., 0, 2], S[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    return S - np.swapaxes(S, -1, -2)


def so3_exp(rotvec: ArrayLike) -> Array:
    """(..., 3, 3) rotation from a rotation vector (..., 3) [rad]."""
    rotvec = as_array(rotvec, (3,), "rotvec")
    return Rotation.from_rotvec(rotvec.reshape(-1, 3)).as_matrix().reshape(rotvec.shape + (3,))


def so3_log(R: ArrayLike) -> Array:
    """Rotation vector (..., 3) [rad], of length at most π, from a rotation (..., 3, 3)."""
    R = check_rotation(R)
    return Rotation.from_matrix(R.reshape(-1, 3, 3)).as_rotvec().reshape(R.shape[:-1])


def quat_xyzw_from_wxyz(q: ArrayLike) -> Array:
    """SciPy's order from ours, (..., 4): this and its inverse are the only places that reorder."""
    return np.roll(as_array(q, (4,), "q"), -1, axis=-1)


def quat_wxyz_from_xyzw(q: ArrayLike) -> Array:
    """Our order from SciPy's (and TUM files'), (..., 4)."""
    return np.roll(as_array(q, (4,), "q"), 1, axis=-1)


def quat_wxyz_from_matrix(R: ArrayLike) -> Array:
    """Unit quaternion (..., 4), wxyz with w ≥ 0, from a rotation (..., 3, 3)."""
    R = check_rotation(R)
    xyzw = Rotation.from_matrix(R.reshape(-1, 3, 3)).as_quat(canonical=True)
    return quat_wxyz_from_xyzw(xyzw).reshape(R.shape[:-2] + (4,))


def matrix_from_quat_wxyz(q: ArrayLike) -> Array:
    """Rotation (..., 3, 3) from a wxyz quaternion (..., 4) of any positive length (it is normalised).

    Raises:
        ValueError: if a quaternion is zero.
    """
    q = as_array(q, (4,), "q")
    if not np.linalg.norm(q, axis=-1).all():
        raise ValueError("q: expected a quaternion of positive length, got (0, 0, 0, 0)")
    return Rotation.from_quat(quat_xyzw_from_wxyz(q).reshape(-1, 4)).as_matrix().reshape(q.shape[:-1] + (3, 3))


def matrix_from_rpy(rpy: ArrayLike) -> Array:
    """Rotation (..., 3, 3) from roll, pitch, yaw (..., 3) [rad]: ``Rz(yaw) @ Ry(pitch) @ Rx(roll)``."""
    rpy = as_array(rpy, (3,), "rpy")
    return Rotation.from_euler("ZYX", rpy[..., ::-1].reshape(-1, 3)).as_matrix().reshape(rpy.shape + (3,))


def rpy_from_matrix(R: ArrayLike) -> Array:
    """Roll, pitch, yaw (..., 3) [rad] from a rotation (..., 3, 3); pitch lies in [−π/2, π/2].

    At pitch ±π/2 only one of roll and yaw is determined: roll is then 0 (SciPy would warn at each call).
    """
    R = check_rotation(R)
    cos_pitch = np.hypot(R[..., 0, 0], R[..., 1, 0])
    locked = cos_pitch < 1e-9
    roll = np.where(locked, 0.0, np.arctan2(R[..., 2, 1], R[..., 2, 2]))
    pitch = np.arctan2(-R[..., 2, 0], cos_pitch)
    yaw = np.where(locked, np.arctan2(-R[..., 0, 1], R[..., 1, 1]), np.arctan2(R[..., 1, 0], R[..., 0, 0]))
    return np.stack([roll, pitch, yaw], axis=-1)


# --- twists -----------------------------------------------------------------------------------------------------------


def adjoint(T: ArrayLike) -> Array:
    """(..., 6, 6) matrix that maps twists (linear, angular): ``T exp(ξ) T⁻¹ = exp(adjoint(T) @ ξ)`` (Solà 2018, D)."""
    T = as_array(T, (4, 4), "T")
    R = T[..., :3, :3]
    A = np.zeros(T.shape[:-2] + (6, 6))
    A[..., :3, :3] = A[..., 3:, 3:] = R
    A[..., :3, 3:] = skew(T[..., :3, 3]) @ R
    return A


def _left_jacobian_terms(theta: Array) -> tuple[Array, Array, Array]:
    """(1 − cos θ)/θ², (θ − sin θ)/θ³ and (1 − (θ/2) cot(θ/2))/θ², by series below 0.1 rad where they cancel."""
    t2 = theta**2
    series_b = 1 / 6 - t2 / 120 * (1 - t2 / 42 * (1 - t2 / 72))
    series_c = 1 / 12 + t2 / 720 * (1 + t2 / 42 * (1 + t2 / 40 * (1 + t2 / 39.6)))
    small = theta < 0.1
    safe = np.where(small, 1.0, theta)
    a = 0.5 * np.sinc(theta / (2 * np.pi)) ** 2
    b = np.where(small, series_b, (safe - np.sin(safe)) / safe**3)
    c = np.where(small, series_c, (1 - 0.5 * safe / np.tan(0.5 * safe)) / safe**2)
    return a[..., None, None], b[..., None, None], c[..., None, None]


def se3_exp(twist: ArrayLike) -> Array:
    """(..., 4, 4) transform from a twist (..., 6), linear [m] then angular [rad] (Solà 2018, App. D)."""
    twist = as_array(twist, (6,), "twist")
    W = skew(twist[..., 3:])
    a, b, _ = _left_jacobian_terms(np.linalg.norm(twist[..., 3:], axis=-1))
    V = np.eye(3) + a * W + b * (W @ W)
    return transform(so3_exp(twist[..., 3:]), np.einsum("...ij,...j->...i", V, twist[..., :3]))


def se3_log(T: ArrayLike) -> Array:
    """Twist (..., 6), linear [m] then angular [rad] of length at most π, from a transform (..., 4, 4)."""
    T = check_transform(T)
    rotvec = so3_log(T[..., :3, :3])
    W = skew(rotvec)
    _, _, c = _left_jacobian_terms(np.linalg.norm(rotvec, axis=-1))
    V_inverse = np.eye(3) - 0.5 * W + c * (W @ W)
    return np.concatenate([np.einsum("...ij,...j->...i", V_inverse, T[..., :3, 3]), rotvec], axis=-1)


def _rotate_halves(twist: ArrayLike, R_linear: Array | None, R_angular: Array | None, name: str) -> Array:
    """A twist (..., 6) with its linear and its angular half each rotated, or kept where None."""
    twist = as_array(twist, (6,), name)
    halves = [
        half if R is None else np.einsum("...ij,...j->...i", R, half)
        for half, R in ((twist[..., :3], R_linear), (twist[..., 3:], R_angular))
    ]
    return np.concatenate(np.broadcast_arrays(*halves), axis=-1)


def twist_world_from_mujoco(qvel: ArrayLike, R_w_b: ArrayLike) -> Array:
    """Velocity of the body's origin and angular velocity, both in world axes, from a free joint's qvel (..., 6).

    MuJoCo's free joint: ``qvel[:3]`` is ``v_w`` [m/s] and ``qvel[3:]`` is ``omega_b`` [rad/s]. `R_w_b` is (..., 3, 3).
    """
    return _rotate_halves(qvel, None, as_array(R_w_b, (3, 3), "R_w_b"), "qvel")


def twist_body_from_mujoco(qvel: ArrayLike, R_w_b: ArrayLike) -> Array:
    """The same two velocities, both in body axes: the body twist ``(T⁻¹ dT/dt)ᵛ`` of ``T_w_b``, (..., 6)."""
    return _rotate_halves(qvel, np.swapaxes(as_array(R_w_b, (3, 3), "R_w_b"), -1, -2), None, "qvel")


def mujoco_from_twist_world(twist_w: ArrayLike, R_w_b: ArrayLike) -> Array:
    """A free joint's qvel (..., 6) from velocities in world axes: inverse of `twist_world_from_mujoco`."""
    return _rotate_halves(twist_w, None, np.swapaxes(as_array(R_w_b, (3, 3), "R_w_b"), -1, -2), "twist_w")


def mujoco_from_twist_body(twist_b: ArrayLike, R_w_b: ArrayLike) -> Array:
    """A free joint's qvel (..., 6) from velocities in body axes: inverse of `twist_body_from_mujoco`."""
    return _rotate_halves(twist_b, as_array(R_w_b, (3, 3), "R_w_b"), None, "twist_b")
