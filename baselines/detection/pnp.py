"""Pose of a camera from points and their pixels, among wrong pairs, and how sure one can be of it."""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import gammaln

from aerograsp_env.interfaces import Intrinsics
from aerograsp_env.spatial import as_array, check_transform, skew, so3_exp, transform, transform_points

Array = NDArray[np.float64]

MIN_POINTS = 4  # of P3P, with one to choose among its four solutions
FLAT = 0.02  # smallest over largest extent of points whose mirrored pose must be tried too
CHANCE = 1e-3  # poses among random pairs that may have as many inliers, over all choices of inliers and of the sample
PIXEL_NOISE = 0.3  # [px] least deviation of a pixel that a covariance is made with


class PnPResult(NamedTuple):
    """A pose, or none with the reason."""

    T_c_object: Array | None  # (4, 4)
    inliers: NDArray[np.bool_]  # (N,) pairs within the threshold; all False without a pose
    rmse: float  # [px] reprojection error of the inliers, over both axes together; NaN without a pose
    covariance: Array | None  # (6, 6) camera-frame position [m²], then rotation vector [rad²]
    reason: str  # why there is no pose; empty with one


def undistorted(pixels: ArrayLike, intrinsics: Intrinsics) -> Array:
    """Where a camera without distortion and of the same matrix would see the pixels (N, 2) [px]."""
    pixels = as_array(pixels, (2,), "pixels").reshape(-1, 2)
    if intrinsics.distortion is None or not np.any(intrinsics.distortion) or not len(pixels):
        return pixels
    K = intrinsics.matrix
    return cv2.undistortPoints(pixels[:, None], K, intrinsics.distortion, P=K)[:, 0].astype(np.float64)


def pinhole(points_c: ArrayLike, intrinsics: Intrinsics) -> Array:
    """Pixels (N, 2) of points (N, 3) in the camera's frame, without distortion; NaN behind the camera."""
    points_c = as_array(points_c, (3,), "points_c")
    z = np.where(points_c[..., 2:] > 1e-9, points_c[..., 2:], np.nan)
    return points_c[..., :2] / z * [intrinsics.fx, intrinsics.fy] + [intrinsics.cx, intrinsics.cy]


def pose_jacobian(points_c: ArrayLike, intrinsics: Intrinsics) -> Array:
    """(N, 2, 6) derivative of the pixels by the camera-frame position and rotation vector of the object.

    The object's points in the camera's frame are R p + t; t moves to t + δ and R to exp(φ) R, so that a point moves by
    δ − (R p) × φ. Taken about the camera's origin instead of the object's: see `solve_pnp`.
    """
    x, y, z = np.moveaxis(as_array(points_c, (3,), "points_c"), -1, 0)
    J = np.zeros((*x.shape, 2, 3))
    J[..., 0, 0], J[..., 0, 2] = intrinsics.fx / z, -intrinsics.fx * x / z**2
    J[..., 1, 1], J[..., 1, 2] = intrinsics.fy / z, -intrinsics.fy * y / z**2
    return np.concatenate([J, -J @ skew(np.asarray(points_c, dtype=np.float64))], axis=-1)


def pose_covariance(points: ArrayLike, T_c_object: ArrayLike, intrinsics: Intrinsics, sigma: float) -> Array | None:
    """(6, 6) of position [m²] and rotation vector [rad²], both in the camera's axes; None where it is not determined.

    The Cramér–Rao bound σ² (JᵀJ)⁻¹ for pixels with independent noise of deviation `sigma` [px] on each axis.
    """
    T, points = check_transform(T_c_object, "T_c_object"), as_array(points, (3,), "points")
    turned = points @ T[:3, :3].T
    J = pose_jacobian(turned + T[:3, 3], intrinsics)
    J[..., 3:] = -J[..., :3] @ skew(turned)  # about the object's origin
    information = np.einsum("nki,nkj->ij", J, J)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    normalized = information * np.outer(scale, scale)
    if not np.isfinite(normalized).all() or np.linalg.eigvalsh(normalized)[0] < 1e-10:
        return None
    covariance = sigma**2 * np.linalg.inv(normalized) * np.outer(scale, scale)
    return 0.5 * (covariance + covariance.T)


def refine_pose(
    points: ArrayLike, pixels: ArrayLike, intrinsics: Intrinsics, T_c_object: ArrayLike, iterations: int = 20
) -> Array:
    """The pose (4, 4) of least squared reprojection error, from one nearby (Levenberg–Marquardt).

    Args:
        points: (N, 3) [m] in the object's frame.
        pixels: (N, 2) [px], free of distortion.
    """
    points, pixels = as_array(points, (3,), "points"), as_array(pixels, (2,), "pixels")
    T, damping = check_transform(T_c_object, "T_c_object").copy(), 1e-4
    center = points.mean(axis=0)  # turning about the middle keeps turning and moving apart

    def residual(pose: Array) -> Array:
        return pinhole(transform_points(pose, points), intrinsics) - pixels

    r = residual(T)
    for _ in range(iterations):
        if not np.isfinite(r).all():
            break
        turned = (points - center) @ T[:3, :3].T
        J = pose_jacobian(transform_points(T, points), intrinsics)
        J[..., 3:] = -J[..., :3] @ skew(turned)
        H, g = np.einsum("nki,nkj->ij", J, J), np.einsum("nki,nk->i", J, r)
        step = np.linalg.lstsq(H + damping * np.diag(np.diag(H)), -g, rcond=None)[0]
        R = so3_exp(step[3:]) @ T[:3, :3]
        moved = transform(R, T[:3, :3] @ center + T[:3, 3] + step[:3] - R @ center)
        new = residual(moved)
        if np.isfinite(new).all() and (new**2).sum() < (r**2).sum():
            gain = 1.0 - (new**2).sum() / (r**2).sum()
            T, r, damping = moved, new, max(0.1 * damping, 1e-9)
            if gain < 1e-10:
                break
        else:
            damping *= 10.0
            if damping > 1e6:
                break
    return T


def chance(pairs: int, inliers: int, share: float) -> float:
    """Expected number of poses with so many inliers among random pairs (Moisan & Stival 2004, eq. 5, four of sample).

    Args:
        share: probability that a random pair agrees with a given pose: of the threshold's disc, in which its pixel
            must lie, in all the area where it may.
    """
    log_p = math.log(min(share, 1.0))

    def choose(n: int, k: int) -> float:
        return float(gammaln(n + 1) - gammaln(k + 1) - gammaln(n - k + 1))

    log_count = math.log(max(pairs - MIN_POINTS, 1)) + choose(pairs, inliers) + choose(inliers, MIN_POINTS)
    return math.exp(min(log_count + (inliers - MIN_POINTS) * log_p, 50.0))


def solve_pnp(
    points: ArrayLike,
    pixels: ArrayLike,
    intrinsics: Intrinsics,
    threshold: float = 3.0,
    min_inliers: int = 6,
    confidence: float = 0.999,
    iterations: int = 1000,
    T_guess: ArrayLike | None = None,
    spread: float | None = None,
) -> PnPResult:
    """Pose of an object from pairs of points and pixels, some of them wrong.

    RANSAC over three-point poses (Fischler & Bolles 1981), then least squares over the inliers, which are chosen anew
    until they stay. Nearly flat inliers are also fitted by the mirrored pose (Schweighofer & Pinz 2006), and the better
    is taken. A pose is given up when it has too few inliers, so few that random pairs would have as many, or inliers
    that do not determine it. Equal calls give equal answers.

    Args:
        points: (N, 3) [m] in the object's frame.
        pixels: (N, 2) [px] as the camera gives them.
        threshold: [px] of an inlier's reprojection error.
        min_inliers: fewest pairs that a pose is believed with.
        confidence: probability of a sample without wrong pairs at which sampling stops.
        iterations: samples at most.
        T_guess: (4, 4) a pose to try beside RANSAC's, such as the last frame's.
        spread: [px] within which of the guess's pixels the pairs were sought, if they were: wrong ones then agree more
            often by chance. None: in the whole image.

    Raises:
        ValueError: shapes that do not match, values that are not finite, or settings out of range.
    """
    points, seen = as_array(points, (3,), "points").reshape(-1, 3), as_array(pixels, (2,), "pixels").reshape(-1, 2)
    if len(points) != len(seen):
        raise ValueError(f"pixels: expected one for each of {len(points)} points, got {len(seen)}")
    if not 0.0 < threshold < math.inf or not 0.0 < confidence < 1.0 or iterations < 1 or min_inliers < MIN_POINTS:
        raise ValueError(
            f"threshold, confidence, iterations, min_inliers: expected > 0, in (0, 1), ≥ 1 and ≥ {MIN_POINTS}, "
            f"got {threshold}, {confidence}, {iterations}, {min_inliers}"
        )
    guess = None if T_guess is None else check_transform(T_guess, "T_guess")
    if len(points) < min_inliers:
        return _failure(len(points), f"{len(points)} pairs, {min_inliers} needed")
    ideal = undistorted(seen, intrinsics)
    starts = [] if guess is None else [guess]
    cv2.setRNGSeed(0)
    try:
        found, rotation, translation, _ = cv2.solvePnPRansac(
            points, ideal, intrinsics.matrix, None, flags=cv2.SOLVEPNP_P3P,
            iterationsCount=iterations, reprojectionError=threshold, confidence=confidence,
        )  # fmt: skip
    except cv2.error:  # every sample was degenerate
        found = False
    if found and np.isfinite(rotation).all() and np.isfinite(translation).all():
        starts.append(_pose(rotation, translation))
    best: tuple[int, float, Array, NDArray[np.bool_]] | None = None
    for start in starts:
        T, kept = _settle(points, ideal, intrinsics, start, threshold)
        for candidate in (T, *_mirrored(points[kept], ideal[kept], intrinsics)):
            settled, inside = _settle(points, ideal, intrinsics, candidate, threshold)
            error = _errors(points, ideal, intrinsics, settled)
            cost = float(np.minimum(error, threshold).sum())
            if best is None or cost < best[1]:
                best = int(inside.sum()), cost, settled, inside
    if best is None:
        return _failure(len(points), "no pose agrees with four pairs")
    count, _, T, inliers = best
    if count < min_inliers:
        return _failure(len(points), f"{count} inliers of {len(points)} pairs, {min_inliers} needed")
    share = math.pi * threshold**2 / (intrinsics.width * intrinsics.height)
    if spread is not None:
        share = max(share, (threshold / spread) ** 2)
    if chance(len(points), count, share) > CHANCE:
        return _failure(len(points), f"{count} inliers of {len(points)} pairs, as many as by chance")
    squares = (_errors(points, ideal, intrinsics, T)[inliers] ** 2).sum()
    sigma = math.sqrt(squares / max(2 * count - 6, 1))
    covariance = pose_covariance(points[inliers], T, intrinsics, max(sigma, PIXEL_NOISE))
    if covariance is None:
        return _failure(len(points), f"{count} inliers that do not determine a pose")
    return PnPResult(T, inliers, math.sqrt(squares / count), covariance, "")


def _failure(count: int, reason: str) -> PnPResult:
    return PnPResult(None, np.zeros(count, dtype=bool), math.nan, None, reason)


def _pose(rotation: ArrayLike, translation: ArrayLike) -> Array:
    return transform(so3_exp(np.ravel(rotation)), np.ravel(translation))


def _errors(points: Array, pixels: Array, intrinsics: Intrinsics, T: Array) -> Array:
    """(N,) reprojection errors [px], infinite behind the camera."""
    gap = np.linalg.norm(pinhole(transform_points(T, points), intrinsics) - pixels, axis=1)
    return np.where(np.isfinite(gap), gap, np.inf)


def _settle(
    points: Array, pixels: Array, intrinsics: Intrinsics, T: Array, threshold: float, rounds: int = 5
) -> tuple[Array, NDArray[np.bool_]]:
    """Least squares over the inliers, and the inliers of that, until they stay."""
    inside = _errors(points, pixels, intrinsics, T) <= threshold
    for _ in range(rounds):
        if inside.sum() < MIN_POINTS:
            break
        T = refine_pose(points[inside], pixels[inside], intrinsics, T)
        new = _errors(points, pixels, intrinsics, T) <= threshold
        if (new == inside).all():
            break
        inside = new
    return T, inside


def _mirrored(points: Array, pixels: Array, intrinsics: Intrinsics) -> list[Array]:
    """Both poses that explain nearly flat points; none for others."""
    if len(points) < MIN_POINTS:
        return []
    center = points.mean(axis=0)
    _, extent, axes = np.linalg.svd(points - center, full_matrices=False)
    if extent[1] < 1e-9 * extent[0] or extent[2] > FLAT * extent[0]:
        return []
    flat = (points - center) @ axes.T
    flat[:, 2] = 0.0
    if np.linalg.det(axes) < 0.0:
        axes, flat = axes * [[1.0], [1.0], [-1.0]], flat
    try:
        _, rotations, translations, _ = cv2.solvePnPGeneric(
            flat, pixels, intrinsics.matrix, None, flags=cv2.SOLVEPNP_IPPE
        )
    except cv2.error:
        return []
    T_flat_object = transform(axes, -axes @ center)
    return [
        _pose(r, t) @ T_flat_object
        for r, t in zip(rotations, translations, strict=True)
        if np.isfinite(r).all() and np.isfinite(t).all()
    ]
