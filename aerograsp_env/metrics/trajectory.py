"""Errors of trajectories: alignment, absolute and relative errors, association of stamps."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from aerograsp_env.metrics.arrays import Array, as_rows
from aerograsp_env.metrics.pose import rotation_error
from aerograsp_env.spatial import check_transform, inverse, transform, transform_points


class Alignment(NamedTuple):
    T_target_source: Array  # (4, 4)
    scale: float  # target ≈ T_target_source applied to (scale · source)


def umeyama(source: ArrayLike, target: ArrayLike, with_scale: bool = False) -> Alignment:
    """Least-squares rigid alignment of paired points (N, 3), never a reflection (Umeyama 1991, eqs. 34–43).

    Points on one line leave the turn about it open; one of the equally good alignments is then returned.

    Raises:
        ValueError: for fewer than three points, or if a scale is asked of points that all coincide.
    """
    source, target = as_rows(source, 3, "source", 3), as_rows(target, 3, "target", 3)
    if source.shape != target.shape:
        raise ValueError(f"target: expected the shape of source, {source.shape}, got {target.shape}")
    source_mean, target_mean = source.mean(axis=0), target.mean(axis=0)
    x, y = source - source_mean, target - target_mean
    U, s, Vt = np.linalg.svd(y.T @ x)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
    R = (U * sign) @ Vt
    scale = 1.0
    if with_scale:
        if not (x.any() and y.any()):
            raise ValueError("source, target: expected points that do not all coincide, to find a scale")
        scale = float((s * sign).sum() / (x**2).sum())
    return Alignment(transform(R, target_mean - scale * R @ source_mean), scale)


class TrajectoryError(NamedTuple):
    rmse: float  # [m]
    errors: Array  # (N,) [m]
    alignment: Alignment  # what was applied to the estimate


def absolute_trajectory_error(
    T_estimate: ArrayLike, T_true: ArrayLike, align: bool = True, with_scale: bool = False
) -> TrajectoryError:
    """ATE: distances of paired positions after aligning the estimate as a whole (Sturm et al. 2012, sec. V).

    Args:
        T_estimate, T_true: poses (N, 4, 4) or positions (N, 3) [m] at the same stamps (see `associate`), N ≥ 3.
        align: whether to align by SE(3) first; `with_scale` adds a scale, for monocular estimates.
    """
    if with_scale and not align:
        raise ValueError("with_scale: expected align=True with it, got align=False")
    p, q = _positions(T_estimate, "T_estimate"), _positions(T_true, "T_true")
    if len(p) != len(q):
        raise ValueError(f"T_true: expected as many poses as T_estimate, {len(p)}, got {len(q)}")
    alignment = umeyama(p, q, with_scale) if align else Alignment(np.eye(4), 1.0)
    errors = np.linalg.norm(transform_points(alignment.T_target_source, alignment.scale * p) - q, axis=1)
    return TrajectoryError(math.sqrt(np.mean(errors**2)), errors, alignment)


def _positions(T: ArrayLike, name: str) -> Array:
    T = np.asarray(T, dtype=np.float64)
    return as_rows(check_transform(T, name)[..., :3, 3] if T.shape[-2:] == (4, 4) else T, 3, name, 3)


class RelativePoseError(NamedTuple):
    translation_rmse: float  # [m]
    rotation_rmse: float  # [rad]
    translation: Array  # (N − delta,) [m]
    rotation: Array  # (N − delta,) [rad]


def relative_pose_error(T_estimate: ArrayLike, T_true: ArrayLike, delta: int = 1) -> RelativePoseError:
    """RPE over δ frames, (Q_i⁻¹ Q_{i+δ})⁻¹ (P_i⁻¹ P_{i+δ}) (Sturm et al. 2012, sec. V); P and true Q (N, 4, 4)."""
    P, Q = check_transform(T_estimate, "T_estimate"), check_transform(T_true, "T_true")
    if P.ndim != 3 or P.shape != Q.shape:
        raise ValueError(f"T_estimate, T_true: expected equal shapes (N, 4, 4), got {P.shape} and {Q.shape}")
    if not 1 <= delta < len(P):
        raise ValueError(f"delta: expected 1 ≤ delta < {len(P)} frames, got {delta}")
    motion_true, motion = (inverse(T[:-delta]) @ T[delta:] for T in (Q, P))
    error = inverse(motion_true) @ motion
    translation, rotation = np.linalg.norm(error[:, :3, 3], axis=1), rotation_error(error, np.eye(4))
    rmse = [math.sqrt(np.mean(e**2)) for e in (translation, rotation)]
    return RelativePoseError(rmse[0], rmse[1], translation, rotation)


def associate(
    stamps_a: ArrayLike, stamps_b: ArrayLike, max_difference: float = 0.02
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Indices (K,), (K,) of the stamps [s] that are each other's nearest and at most `max_difference` apart.

    Raises:
        ValueError: if stamps are not strictly increasing.
    """
    stamps = []
    for name, value in (("stamps_a", stamps_a), ("stamps_b", stamps_b)):
        t = as_rows(np.reshape(value, (-1, 1)), 1, name)
        if not (np.diff(t[:, 0]) > 0).all():
            raise ValueError(f"{name}: expected strictly increasing times [s]")
        stamps.append(t)
    distance, nearest_b = cKDTree(stamps[1]).query(stamps[0])
    _, nearest_a = cKDTree(stamps[0]).query(stamps[1])
    paired = (distance <= max_difference) & (nearest_a[nearest_b] == np.arange(len(nearest_b)))
    return np.flatnonzero(paired), nearest_b[paired]
