"""Errors of object poses, and distances between surfaces."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from aerograsp_env.metrics.arrays import Array, as_rows
from aerograsp_env.spatial import check_rotation, check_transform, inverse, transform_points


def add_error(T_estimate: ArrayLike, T_true: ArrayLike, points: ArrayLike) -> Array:
    """ADD (...,) [m]: mean distance of the model's points (N, 3) under two poses (..., 4, 4) (Hinterstoisser 2012)."""
    T_estimate, T_true = check_transform(T_estimate, "T_estimate"), check_transform(T_true, "T_true")
    points = as_rows(points, 3, "points")
    gap = transform_points(T_estimate, points) - transform_points(T_true, points)
    return np.linalg.norm(gap, axis=-1).mean(axis=-1)


def add_s_error(T_estimate: ArrayLike, T_true: ArrayLike, points: ArrayLike) -> Array:
    """ADD-S (...,) [m], for symmetric objects: from each point in the true pose to the nearest in the estimated one."""
    T_estimate, T_true = check_transform(T_estimate, "T_estimate"), check_transform(T_true, "T_true")
    points = as_rows(points, 3, "points")
    # Distances are the same in the estimated object's frame, where one tree serves every pose.
    distance, _ = cKDTree(points).query(transform_points(inverse(T_estimate) @ T_true, points))
    return np.asarray(distance.mean(axis=-1))


def translation_error(T_estimate: ArrayLike, T_true: ArrayLike) -> Array:
    """Distance (...,) [m] between the origins of two poses (..., 4, 4)."""
    T_estimate, T_true = check_transform(T_estimate, "T_estimate"), check_transform(T_true, "T_true")
    return np.linalg.norm(T_estimate[..., :3, 3] - T_true[..., :3, 3], axis=-1)


def rotation_error(T_estimate: ArrayLike, T_true: ArrayLike, symmetries: ArrayLike | None = None) -> Array:
    """Smallest angle (...,) [rad] between the rotations of two poses (..., 4, 4).

    Args:
        symmetries: (K, 3, 3) rotations S about the object's origin that leave its look unchanged, the identity among
            them: the smallest angle between T_estimate and T_true S counts. None is the identity only.
    """
    T_estimate, T_true = check_transform(T_estimate, "T_estimate"), check_transform(T_true, "T_true")
    S = check_rotation(np.eye(3)[None] if symmetries is None else symmetries, "symmetries")
    if S.ndim != 3 or not len(S):
        raise ValueError(f"symmetries: expected shape (K, 3, 3) with K ≥ 1, got {S.shape}")
    R_true = T_true[..., None, :3, :3] @ S
    D = np.swapaxes(T_estimate[..., None, :3, :3], -1, -2) @ R_true
    axial = np.stack([D[..., 2, 1] - D[..., 1, 2], D[..., 0, 2] - D[..., 2, 0], D[..., 1, 0] - D[..., 0, 1]], axis=-1)
    # The arc tangent keeps small angles, which the arc cosine of the trace alone would round away.
    return np.arctan2(np.linalg.norm(axial, axis=-1), np.trace(D, axis1=-2, axis2=-1) - 1.0).min(axis=-1)


def count_jumps(track: ArrayLike, angle: float = np.radians(30.0)) -> int:
    """How often consecutive poses (N, 4, 4) of one object at rest are turned by more than `angle` [rad]; N ≥ 1.

    A symmetric object's estimate that flips from one of its indistinguishable poses to another shows as a jump: one
    counts jumps of the raw rotation, with no symmetries forgiven. Poses are in a frame in which the object rests.
    """
    track = check_transform(track, "track")
    if track.ndim != 3 or not len(track):
        raise ValueError(f"track: expected shape (N, 4, 4) with N ≥ 1, got {track.shape}")
    if not 0.0 < angle < np.pi:
        raise ValueError(f"angle: expected a value in (0, π) rad, got {angle}")
    return int((rotation_error(track[1:], track[:-1]) > angle).sum()) if len(track) > 1 else 0


def chamfer_distance(a: ArrayLike, b: ArrayLike) -> float:
    """½ (mean over a of the distance to the nearest point of b + the same from b to a) [m]; a (N, 3), b (M, 3)."""
    a, b = as_rows(a, 3, "a"), as_rows(b, 3, "b")
    return float(0.5 * (cKDTree(b).query(a)[0].mean() + cKDTree(a).query(b)[0].mean()))
