"""Bundle adjustment: camera poses and points that explain all pixels best."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares
from scipy.sparse import csr_matrix

from aerograsp_env.interfaces import Intrinsics
from aerograsp_env.spatial import as_array, check_transform, so3_exp, transform
from baselines.detection.pnp import pinhole, pose_jacobian

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


class BundleResult(NamedTuple):
    """Where cameras and points are, and how well that explains the pixels."""

    T_c_o: Array  # (K, 4, 4) from the points' frame to each camera's; the first is as given
    points: Array  # (N, 3)
    errors: Array  # (M,) reprojection errors [px], the larger of two; infinite behind the camera
    rmse: float  # [px] root mean square of them
    converged: bool
    evaluations: int


class _Problem(NamedTuple):
    T_c_o: Array
    points: Array
    pixels: Array
    frame: Ints
    point: Ints
    intrinsics: Intrinsics
    T_side_frame: Array  # (M, 4, 4) from the frame's camera to the one that saw it

    def moved(self, x: Array) -> tuple[Array, Array]:
        """Poses and points after the increments x: (rotation, translation) of each camera but the first, then points.

        Rotations are exp(φ) R₀, φ measured from the start, so that x stays a plain vector.
        """
        cameras = x[: 6 * (len(self.T_c_o) - 1)].reshape(-1, 6)
        T = self.T_c_o.copy()
        turn = so3_exp(cameras[:, 3:])
        T[1:, :3, :3] = turn @ T[1:, :3, :3]
        T[1:, :3, 3] += cameras[:, :3]
        return T, self.points + x[cameras.size :].reshape(-1, 3)

    def in_camera(self, T: Array, points: Array) -> tuple[Array, Array]:
        """(M, 3) the observed points turned into their frames' axes, and in the frames of the cameras that saw them."""
        turned = np.einsum("mij,mj->mi", T[self.frame, :3, :3], points[self.point])
        side = self.T_side_frame
        return turned, np.einsum("mij,mj->mi", side[:, :3, :3], turned + T[self.frame, :3, 3]) + side[:, :3, 3]

    def residual(self, x: Array) -> Array:
        _, p = self.in_camera(*self.moved(x))
        p = np.concatenate([p[:, :2], np.maximum(p[:, 2:], 1e-6)], axis=1)  # finite behind the camera, and very wrong
        return (pinhole(p, self.intrinsics) - self.pixels).ravel()

    def jacobian(self, x: Array) -> csr_matrix:
        T, points = self.moved(x)
        turned, p = self.in_camera(T, points)
        p[:, 2] = np.maximum(p[:, 2], 1e-6)
        by_position = pose_jacobian(p, self.intrinsics)[..., :3] @ self.T_side_frame[:, :3, :3]  # (M, 2, 3)
        by_point = by_position @ T[self.frame, :3, :3]
        cameras = x[: 6 * (len(self.T_c_o) - 1)].reshape(-1, 6)
        left = np.concatenate([np.zeros((1, 3, 3)), _left_jacobian(cameras[:, 3:])])
        by_turn = -by_position @ _skew(turned) @ left[self.frame]
        blocks = np.concatenate([by_position, by_turn, by_point], axis=-1)  # (M, 2, 9)
        camera_column = 6 * (self.frame - 1)[:, None] + np.arange(6)
        point_column = cameras.size + 3 * self.point[:, None] + np.arange(3)
        columns = np.repeat(np.concatenate([camera_column, point_column], axis=1)[:, None], 2, axis=1)
        rows = np.broadcast_to(np.arange(2 * len(p)).reshape(-1, 2, 1), columns.shape)
        free = columns >= 0  # the first camera stays
        shape = (2 * len(p), len(x))
        return csr_matrix((blocks[free], (rows[free], columns[free])), shape=shape)


def _skew(v: Array) -> Array:
    S = np.zeros((*v.shape, 3))
    S[..., 0, 1], S[..., 0, 2], S[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    return S - np.swapaxes(S, -1, -2)


def _left_jacobian(phi: Array) -> Array:
    """(N, 3, 3) left Jacobian of SO(3): exp(φ + δ) = exp(J δ) exp(φ) to first order (Solà et al. 2018, eq. 145)."""
    angle = np.linalg.norm(phi, axis=1)[:, None, None]
    safe = np.maximum(angle, 1e-4)
    a = np.where(angle > 1e-4, (1.0 - np.cos(safe)) / safe**2, 0.5 - angle**2 / 24)
    b = np.where(angle > 1e-4, (safe - np.sin(safe)) / safe**3, 1 / 6 - angle**2 / 120)
    W = _skew(phi)
    return np.eye(3) + a * W + b * (W @ W)


def bundle_adjust(
    T_c_o: ArrayLike,
    points: ArrayLike,
    pixels: ArrayLike,
    frame: ArrayLike,
    point: ArrayLike,
    intrinsics: Intrinsics,
    max_evaluations: int = 100,
    pixels_right: ArrayLike | None = None,
    T_right_left: ArrayLike | None = None,
) -> BundleResult:
    """Poses and points of least reprojection error, on SciPy's sparse trust-region solver (Triggs et al. 2000).

    The first camera stays where it is. The pictures do not say how large everything is: the scale stays near that of
    the start, since no step of the solver has a part along what changes nothing. Wrong observations must be left out
    before, or by their errors after a first run: losses that weigh them down stall this solver far from the solution.

    Args:
        T_c_o: (K, 4, 4) starting poses, from the points' frame to the cameras'.
        points: (N, 3) starting points.
        pixels: (M, 2) [px], free of distortion, of point `point` (M,) in camera `frame` (M,).
        max_evaluations: of the residuals.
        pixels_right, T_right_left: (M, 2) [px] and (4, 4) of a second equal camera beside each; rows of
            NaN where it does not see the point. With it, the scale is determined too.

    Raises:
        ValueError: shapes that do not match, rows that do not exist, or fewer residuals than unknowns.
    """
    T = check_transform(T_c_o, "T_c_o")
    points, pixels = as_array(points, (3,), "points"), as_array(pixels, (2,), "pixels")
    frame, point = np.asarray(frame, dtype=np.int64), np.asarray(point, dtype=np.int64)
    if not frame.shape == point.shape == (len(pixels),):
        raise ValueError(f"frame, point: expected ({len(pixels)},) as pixels, got {frame.shape} and {point.shape}")
    for name, rows, count in (("frame", frame, len(T)), ("point", point, len(points))):
        if len(rows) and not (rows.min() >= 0 and rows.max() < count):
            raise ValueError(f"{name}: expected rows below {count}, got {rows.min()} to {rows.max()}")
    side = np.broadcast_to(np.eye(4), (len(pixels), 4, 4))
    count = len(pixels)
    if pixels_right is not None:
        right, T_right = (
            np.asarray(pixels_right, dtype=np.float64),
            check_transform(np.asarray(T_right_left), "T_right_left"),
        )
        if right.shape != pixels.shape:
            raise ValueError(f"pixels_right: expected shape {pixels.shape}, got {right.shape}")
        also = np.nonzero(np.isfinite(right).all(axis=1))[0]
        pixels, frame, point = (
            np.concatenate(both) for both in ((pixels, right[also]), (frame, frame[also]), (point, point[also]))
        )
        side = np.concatenate([side, np.broadcast_to(T_right, (len(also), 4, 4))])
    unknowns = 6 * (len(T) - 1) + 3 * len(points)
    if 2 * len(pixels) < unknowns:
        raise ValueError(
            f"pixels: expected at least {unknowns} coordinates for as many unknowns, got {2 * len(pixels)}"
        )
    problem = _Problem(T, points, pixels, frame, point, intrinsics, side)
    found = least_squares(
        problem.residual, np.zeros(unknowns), problem.jacobian, method="trf", x_scale="jac", tr_solver="lsmr",
        max_nfev=max_evaluations, ftol=1e-8, xtol=1e-10, gtol=1e-10,
    )  # fmt: skip
    T, points = problem.moved(found.x)
    T = transform(T[:, :3, :3], T[:, :3, 3])
    _, p = problem.in_camera(T, points)
    errors = np.linalg.norm(pinhole(p, intrinsics) - pixels, axis=1)
    errors = np.where(np.isfinite(errors), errors, np.inf)
    rmse = float(np.sqrt((errors**2).mean()))
    if pixels_right is not None:
        np.maximum.at(errors, also, errors[count:])
    return BundleResult(T, points, errors[:count], rmse, found.status > 0, int(found.nfev))
