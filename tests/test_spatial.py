"""SE(3) helpers: group axioms, round trips, finite differences, and MuJoCo's own answers."""

from __future__ import annotations

import warnings

import mujoco
import numpy as np
import pytest
from scipy.linalg import expm, logm

from aerograsp_env import spatial as sp

RNG_SEED = 7


def random_rotations(rng: np.random.Generator, *batch: int) -> np.ndarray:
    return sp.so3_exp(rng.uniform(-1.5, 1.5, (*batch, 3)))


def random_transforms(rng: np.random.Generator, *batch: int) -> np.ndarray:
    return sp.transform(random_rotations(rng, *batch), rng.normal(size=(*batch, 3)))


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(RNG_SEED)


# --- group axioms ------------------------------------------------------------


def test_transforms_form_a_group(rng: np.random.Generator) -> None:
    A, B, C = random_transforms(rng, 3, 20)
    np.testing.assert_allclose((A @ B) @ C, A @ (B @ C), atol=1e-14)
    np.testing.assert_allclose(A @ sp.inverse(A), np.broadcast_to(np.eye(4), A.shape), atol=1e-14)
    np.testing.assert_allclose(sp.inverse(A) @ A, np.broadcast_to(np.eye(4), A.shape), atol=1e-14)
    np.testing.assert_allclose(sp.inverse(A @ B), sp.inverse(B) @ sp.inverse(A), atol=1e-14)
    np.testing.assert_allclose(sp.inverse(A), np.linalg.inv(A), atol=1e-14)
    sp.check_transform(A @ B)


def test_transform_points_composes_and_broadcasts(rng: np.random.Generator) -> None:
    T_a_b, T_b_c = random_transforms(rng, 2)
    p_c = rng.normal(size=(5, 3))
    expected = sp.transform_points(T_a_b, sp.transform_points(T_b_c, p_c))
    np.testing.assert_allclose(sp.transform_points(T_a_b @ T_b_c, p_c), expected, atol=1e-14)
    homogeneous = T_a_b @ np.append(p_c[0], 1.0)
    np.testing.assert_allclose(sp.transform_points(T_a_b, p_c[0]), homogeneous[:3], atol=1e-14)

    batch = random_transforms(rng, 4)
    assert sp.transform_points(batch, p_c).shape == (4, 5, 3)
    assert sp.transform_points(batch, p_c[0]).shape == (4, 3)
    assert sp.transform_points(T_a_b, rng.normal(size=(2, 4, 5, 3))).shape == (2, 4, 5, 3)
    np.testing.assert_allclose(sp.transform_points(batch, p_c)[2], sp.transform_points(batch[2], p_c), atol=1e-14)
    assert sp.transform_points(T_a_b, np.zeros((0, 3))).shape == (0, 3)


# --- round trips -------------------------------------------------------------


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-7, 1e-3, 0.0999, 0.1001, 1.0, 3.0, np.pi - 1e-6])
def test_exponentials_match_the_matrix_exponential_and_invert(rng: np.random.Generator, angle: float) -> None:
    axis = rng.normal(size=(10, 3))
    rotvec = angle * axis / np.linalg.norm(axis, axis=1, keepdims=True)
    twist = np.concatenate([rng.normal(size=(10, 3)), rotvec], axis=1)
    for xi, T in zip(twist, sp.se3_exp(twist), strict=True):
        hat = np.zeros((4, 4))
        hat[:3, :3], hat[:3, 3] = sp.skew(xi[3:]), xi[:3]
        np.testing.assert_allclose(T, expm(hat), atol=2e-13)
        np.testing.assert_allclose(T[:3, :3], sp.so3_exp(xi[3:]), atol=0)
    # Close to a half turn a rotation matrix holds its angle to the square root of the rounding error only.
    tolerance = 1e-8 if angle > 3.1 else 1e-12
    np.testing.assert_allclose(sp.se3_log(sp.se3_exp(twist)), twist, atol=tolerance)
    np.testing.assert_allclose(sp.so3_log(sp.so3_exp(rotvec)), rotvec, atol=tolerance)


def test_log_of_a_half_turn_has_length_pi(rng: np.random.Generator) -> None:
    axis = np.array([0.6, 0.0, 0.8])
    T = sp.transform(2 * np.outer(axis, axis) - np.eye(3), rng.normal(size=3))
    twist = sp.se3_log(T)
    np.testing.assert_allclose(np.linalg.norm(twist[3:]), np.pi, atol=1e-12)
    np.testing.assert_allclose(sp.se3_exp(twist), T, atol=1e-12)


def test_se3_log_matches_scipys_matrix_logarithm(rng: np.random.Generator) -> None:
    T = random_transforms(rng)
    L = logm(T).real
    np.testing.assert_allclose(sp.se3_log(T), [*L[:3, 3], L[2, 1], L[0, 2], L[1, 0]], atol=1e-12)


def test_quaternions(rng: np.random.Generator) -> None:
    R = random_rotations(rng, 3, 4)
    q = sp.quat_wxyz_from_matrix(R)
    assert q.shape == (3, 4, 4)
    assert (q[..., 0] >= 0).all()
    np.testing.assert_allclose(np.linalg.norm(q, axis=-1), 1.0, atol=1e-14)
    np.testing.assert_allclose(sp.matrix_from_quat_wxyz(q), R, atol=1e-14)
    np.testing.assert_allclose(sp.matrix_from_quat_wxyz(-3.0 * q), R, atol=1e-14)
    # A quarter turn about z, in both orders; and MuJoCo agrees about ours.
    half = np.sqrt(0.5)
    np.testing.assert_allclose(sp.quat_wxyz_from_matrix([[0, -1, 0], [1, 0, 0], [0, 0, 1]]), [half, 0, 0, half])
    np.testing.assert_array_equal(sp.quat_xyzw_from_wxyz([1, 2, 3, 4]), [2, 3, 4, 1])
    np.testing.assert_array_equal(sp.quat_wxyz_from_xyzw(sp.quat_xyzw_from_wxyz(q)), q)
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, q[1, 2])
    np.testing.assert_allclose(matrix.reshape(3, 3), R[1, 2], atol=1e-14)
    with pytest.raises(ValueError, match="q: expected a quaternion of positive length"):
        sp.matrix_from_quat_wxyz(np.zeros((2, 4)))


def test_roll_pitch_yaw(rng: np.random.Generator) -> None:
    rpy = rng.uniform([-3.1, -1.5, -3.1], [3.1, 1.5, 3.1], (50, 3))
    R = sp.matrix_from_rpy(rpy)
    np.testing.assert_allclose(sp.rpy_from_matrix(R), rpy, atol=1e-12)

    def elementary(axis: int, angle: float) -> np.ndarray:
        return expm(angle * sp.skew(np.eye(3)[axis]))

    roll, pitch, yaw = rpy[0]
    np.testing.assert_allclose(R[0], elementary(2, yaw) @ elementary(1, pitch) @ elementary(0, roll), atol=1e-13)
    # FLU: positive pitch puts the nose down, positive yaw turns it left.
    assert (sp.matrix_from_rpy([0, 0.1, 0]) @ [1, 0, 0])[2] < 0
    assert (sp.matrix_from_rpy([0, 0, 0.1]) @ [1, 0, 0])[1] > 0


@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2])
def test_gimbal_lock_gives_the_same_rotation_without_a_warning(pitch: float) -> None:
    R = sp.matrix_from_rpy([0.4, pitch, -0.3])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rpy = sp.rpy_from_matrix(R)
    assert rpy[0] == 0.0
    np.testing.assert_allclose(sp.matrix_from_rpy(rpy), R, atol=1e-9)


# --- derivatives -------------------------------------------------------------


def test_adjoint(rng: np.random.Generator) -> None:
    A, B = random_transforms(rng, 2, 6)
    twist = 0.5 * rng.normal(size=(6, 6))
    moved = np.einsum("nij,nj->ni", sp.adjoint(A), twist)
    np.testing.assert_allclose(A @ sp.se3_exp(twist) @ sp.inverse(A), sp.se3_exp(moved), atol=1e-13)
    np.testing.assert_allclose(sp.adjoint(A @ B), sp.adjoint(A) @ sp.adjoint(B), atol=1e-13)
    np.testing.assert_allclose(sp.adjoint(sp.inverse(A)), np.linalg.inv(sp.adjoint(A)), atol=1e-13)


def test_body_twist_is_the_derivative_of_the_pose(rng: np.random.Generator) -> None:
    """With dT/dt = T [ξ], positions move with R v_b, and the two MuJoCo conversions agree with finite differences."""
    T, twist_b, h = random_transforms(rng), rng.normal(size=6), 1e-5
    R = T[:3, :3]
    qvel = sp.mujoco_from_twist_body(twist_b, R)
    after, before = T @ sp.se3_exp(h * twist_b), T @ sp.se3_exp(-h * twist_b)
    velocity_w = (after[:3, 3] - before[:3, 3]) / (2 * h)
    spin_w = sp.so3_log(after[:3, :3] @ before[:3, :3].T) / (2 * h)
    np.testing.assert_allclose(qvel[:3], velocity_w, atol=1e-8)
    np.testing.assert_allclose(sp.twist_world_from_mujoco(qvel, R), [*velocity_w, *spin_w], atol=1e-8)


def test_free_joint_velocities_match_mujoco(rng: np.random.Generator) -> None:
    xml = "<mujoco><worldbody><body><freejoint/><geom size='0.1'/></body></worldbody></mujoco>"
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    R = random_rotations(rng)
    data.qpos[3:] = sp.quat_wxyz_from_matrix(R)
    data.qvel[:] = rng.normal(size=6)
    mujoco.mj_forward(model, data)
    for local, convert, back in (
        (0, sp.twist_world_from_mujoco, sp.mujoco_from_twist_world),
        (1, sp.twist_body_from_mujoco, sp.mujoco_from_twist_body),
    ):
        velocity = np.zeros(6)  # MuJoCo's order: angular, then linear
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, 1, velocity, local)
        twist = convert(data.qvel, R)
        np.testing.assert_allclose(twist, np.roll(velocity, 3), atol=1e-13)
        np.testing.assert_allclose(back(twist, R), data.qvel, atol=1e-13)
    many = random_rotations(rng, 4)
    assert sp.twist_world_from_mujoco(data.qvel, many).shape == (4, 6)


def test_camera_flip_turns_mujocos_camera_into_opencvs() -> None:
    T = sp.check_transform(sp.CAMERA_FROM_MUJOCO)
    np.testing.assert_array_equal(T @ T, np.eye(4))
    # A point in front of MuJoCo's camera (−z), to its right (+x) and above (+y) has z, x > 0 and y < 0 in OpenCV's.
    np.testing.assert_array_equal(sp.transform_points(T, [1.0, 2.0, -3.0]), [1.0, -2.0, 3.0])
    with pytest.raises(ValueError, match="read-only"):
        T[0, 0] = 2.0


# --- projection and checks ---------------------------------------------------


def test_projection_is_the_nearest_rotation(rng: np.random.Generator) -> None:
    R = random_rotations(rng, 30)
    np.testing.assert_allclose(sp.project_to_so3(R), R, atol=1e-14)
    noisy = R + 0.2 * rng.normal(size=R.shape)
    nearest = sp.project_to_so3(noisy)
    assert sp.is_rotation(nearest)
    best = np.linalg.norm(noisy - nearest, axis=(1, 2))
    for _ in range(20):
        other = nearest @ sp.so3_exp(0.1 * rng.normal(size=(30, 3)))
        assert (np.linalg.norm(noisy - other, axis=(1, 2)) >= best - 1e-12).all()


def test_projection_never_gives_a_reflection(rng: np.random.Generator) -> None:
    mirrored = random_rotations(rng, 10) * [1.0, 1.0, -1.0]
    assert (np.linalg.det(mirrored) < 0).all()
    projected = sp.project_to_so3(mirrored)
    np.testing.assert_allclose(np.linalg.det(projected), 1.0, atol=1e-12)
    assert sp.is_rotation(projected)


def test_projection_of_what_defines_no_rotation_is_an_error() -> None:
    with pytest.raises(ValueError, match="M: expected rank 2"):
        sp.project_to_so3(np.outer([1.0, 0, 0], [0, 1.0, 0]))
    with pytest.raises(ValueError, match="M: expected finite"):
        sp.project_to_so3(np.full((3, 3), np.nan))


def test_is_rotation() -> None:
    assert sp.is_rotation(np.eye(3))
    assert not sp.is_rotation(np.diag([1.0, 1.0, -1.0]))
    assert not sp.is_rotation(1.001 * np.eye(3))
    assert not sp.is_rotation(np.full((3, 3), np.nan))
    assert not sp.is_rotation(np.eye(4))


GOOD = sp.transform(sp.so3_exp([0.1, 0.2, 0.3]), [1.0, 2.0, 3.0])


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (GOOD[:3], r"T_w_b: expected shape \(\.\.\., 4, 4\), got \(3, 4\)"),
        (GOOD + np.diag([0, 0, np.inf, 0]), "T_w_b: expected finite values, got inf"),
        (GOOD + np.diag([0, 0, 0, 1]), "T_w_b: expected a last row"),
        (GOOD @ np.diag([1.1, 1, 1, 1]), "T_w_b: expected orthonormal columns, got max"),
        (GOOD @ np.diag([-1.0, 1, 1, 1]), r"T_w_b: expected det R = \+1, got -1: a reflection"),
    ],
)
def test_check_transform_says_what_is_wrong(bad: np.ndarray, message: str) -> None:
    np.testing.assert_array_equal(sp.check_transform(GOOD.tolist(), "T_w_b"), GOOD)
    with pytest.raises(ValueError, match=message):
        sp.check_transform(bad, "T_w_b")


def test_empty_batches_pass_through() -> None:
    assert sp.so3_exp(np.zeros((0, 3))).shape == (0, 3, 3)
    assert sp.so3_log(np.zeros((0, 3, 3))).shape == (0, 3)
    assert sp.se3_log(sp.se3_exp(np.zeros((0, 6)))).shape == (0, 6)
    assert sp.quat_wxyz_from_matrix(np.zeros((0, 3, 3))).shape == (0, 4)


def test_inputs_are_never_changed(rng: np.random.Generator) -> None:
    T, qvel = random_transforms(rng), rng.normal(size=6)
    before = T.copy(), qvel.copy()
    sp.inverse(T)[:] = sp.adjoint(T)[0, 0]
    sp.project_to_so3(T[:3, :3])[:] = 0
    sp.twist_world_from_mujoco(qvel, T[:3, :3])[:] = 0
    np.testing.assert_array_equal(T, before[0])
    np.testing.assert_array_equal(qvel, before[1])
