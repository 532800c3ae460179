"""What tasks are scored by: detection, object pose, trajectory, shape and control errors.

Pure functions on arrays, in SI units. Empty or non-finite input raises ValueError: no score is ever made up.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from aerograsp_env.spatial import as_array, check_rotation, check_transform, inverse, transform, transform_points

Array = NDArray[np.float64]


def _rows(value: ArrayLike, width: int, name: str, minimum: int = 1) -> Array:
    """`value` as a finite (N, width) float64 array with N ≥ minimum."""
    rows = as_array(value, (width,), name)
    if rows.ndim != 2 or len(rows) < minimum:
        raise ValueError(f"{name}: expected shape (N, {width}) with N ≥ {minimum}, got {rows.shape}")
    return rows


def box_iou(a: ArrayLike, b: ArrayLike) -> Array:
    """Intersection over union of xyxy boxes (..., N, 4) and (..., M, 4): (..., N, M), leading axes broadcast.

    Coordinates are continuous: a box has area (x2 − x1)(y2 − y1), without the "+ 1" of pixel counts. Boxes without
    area have IoU 0 with everything.

    Raises:
        ValueError: if a box has x2 < x1 or y2 < y1.
    """
    a, b = as_array(a, (4,), "a"), as_array(b, (4,), "b")
    for name, boxes in (("a", a), ("b", b)):
        if boxes.ndim < 2 or np.any(boxes[..., 2:] < boxes[..., :2]):
            raise ValueError(f"{name}: expected boxes (..., N, 4) with x1 ≤ x2 and y1 ≤ y2, got shape {boxes.shape}")
    a, b = a[..., :, None, :], b[..., None, :, :]
    overlap = np.minimum(a[..., 2:], b[..., 2:]) - np.maximum(a[..., :2], b[..., :2])
    intersection = np.maximum(overlap, 0.0).prod(axis=-1)
    union = (a[..., 2:] - a[..., :2]).prod(axis=-1) + (b[..., 2:] - b[..., :2]).prod(axis=-1) - intersection
    return np.divide(intersection, union, out=np.zeros(intersection.shape), where=intersection > 0)


def match_detections(
    boxes: ArrayLike, scores: ArrayLike, truth: ArrayLike, iou_threshold: float = 0.5
) -> NDArray[np.bool_]:
    """Which of one image's detections (N,) of one class are correct, by PASCAL VOC's rule (Everingham et al. 2010).

    In order of falling score (ties in the order given) each detection takes the true box that it overlaps most. It is
    correct if that IoU is at least the threshold and no earlier detection took that box.

    Args:
        boxes: (N, 4) xyxy; scores: (N,); truth: (M, 4) xyxy. N and M may be 0.
        iou_threshold: in (0, 1].
    """
    if not 0.0 < iou_threshold <= 1.0:
        raise ValueError(f"iou_threshold: expected a value in (0, 1], got {iou_threshold}")
    boxes, truth = np.reshape(boxes, (-1, 4)), np.reshape(truth, (-1, 4))
    scores = _rows(np.reshape(scores, (-1, 1)), 1, "scores", 0)[:, 0]
    if len(scores) != len(boxes):
        raise ValueError(f"scores: expected one for each of {len(boxes)} boxes, got {len(scores)}")
    correct = np.zeros(len(boxes), dtype=np.bool_)
    iou = box_iou(boxes, truth)
    if not iou.size:
        return correct
    free = np.ones(len(truth), dtype=np.bool_)
    for i in np.argsort(-scores, kind="stable"):
        best = iou[i].argmax()
        correct[i] = iou[i, best] >= iou_threshold and free[best]
        free[best] &= not correct[i]
    return correct


def average_precision(scores: ArrayLike, correct: ArrayLike, positives: int) -> float:
    """Area under the interpolated precision–recall curve, over all points (VOC 2010 and later).

    Precision and recall are taken at each distinct score s, with the detections that score at least s: the order of
    equal scores does not matter. Precision at recall r becomes the largest precision at any recall ≥ r, and
    AP = Σ (r_k − r_{k−1}) · p(r_k) with r_0 = 0.

    Args:
        scores: (N,) of all detections of a class, over all images; N may be 0, and then AP is 0.
        correct: (N,) bool, from `match_detections`.
        positives: number of true objects of the class, at least 1 (AP is not defined without any).
    """
    if positives < 1:
        raise ValueError(f"positives: expected at least one true object, got {positives}")
    scores = _rows(np.reshape(scores, (-1, 1)), 1, "scores", 0)[:, 0]
    correct = np.asarray(correct, dtype=np.bool_)
    if correct.shape != scores.shape or correct.sum() > positives:
        got = f"{correct.shape} with {correct.sum()}"
        raise ValueError(f"correct: expected shape {scores.shape} with at most {positives} true, got {got}")
    order = np.argsort(-scores, kind="stable")
    last_of_score = np.flatnonzero(np.diff(scores[order], append=-np.inf))
    hits = np.cumsum(correct[order])[last_of_score]
    precision = np.maximum.accumulate((hits / (last_of_score + 1))[::-1])[::-1]
    return float(np.sum(np.diff(hits / positives, prepend=0.0) * precision))


class MeanAveragePrecision(NamedTuple):
    mean: float  # over the classes that have true objects
    per_class: dict[Any, float]  # AP of each of them


def mean_average_precision(
    detections: Sequence[tuple[ArrayLike, ArrayLike, Sequence[Hashable]]],
    truths: Sequence[tuple[ArrayLike, Sequence[Hashable]]],
    iou_threshold: float = 0.5,
) -> MeanAveragePrecision:
    """mAP over images at one IoU threshold.

    Args:
        detections: for each image boxes (N, 4), scores (N,) and N class labels.
        truths: for each image boxes (M, 4) and M class labels.

    Raises:
        ValueError: if the numbers of images or of labels differ, or if there is no true object at all.
    """
    if len(detections) != len(truths):
        raise ValueError(f"detections: expected one entry for each of {len(truths)} images, got {len(detections)}")
    for k, ((boxes, _, found), (true_boxes, true)) in enumerate(zip(detections, truths, strict=True)):
        if len(found) != len(np.reshape(boxes, (-1, 4))) or len(true) != len(np.reshape(true_boxes, (-1, 4))):
            raise ValueError(f"detections, truths: expected one label a box, got another number in image {k}")
    per_class: dict[Any, float] = {}
    for label in dict.fromkeys(label for _, labels in truths for label in labels):
        scores, correct, positives = [np.zeros(0)], [np.zeros(0, dtype=np.bool_)], 0
        for (boxes, image_scores, found), (true_boxes, true) in zip(detections, truths, strict=True):
            mine = np.fromiter((name == label for name in found), dtype=np.bool_, count=len(found))
            theirs = np.fromiter((name == label for name in true), dtype=np.bool_, count=len(true))
            scores.append(np.reshape(image_scores, -1)[mine])
            truth = np.reshape(true_boxes, (-1, 4))[theirs]
            correct.append(match_detections(np.reshape(boxes, (-1, 4))[mine], scores[-1], truth, iou_threshold))
            positives += len(truth)
        per_class[label] = average_precision(np.concatenate(scores), np.concatenate(correct), positives)
    if not per_class:
        raise ValueError("truths: expected at least one true object, got none")
    return MeanAveragePrecision(float(np.mean(list(per_class.values()))), per_class)


def add_error(T_estimate: ArrayLike, T_true: ArrayLike, points: ArrayLike) -> Array:
    """ADD (...,) [m]: mean distance of the model's points (N, 3) under two poses (..., 4, 4) (Hinterstoisser 2012)."""
    T_estimate, T_true = check_transform(T_estimate, "T_estimate"), check_transform(T_true, "T_true")
    points = _rows(points, 3, "points")
    gap = transform_points(T_estimate, points) - transform_points(T_true, points)
    return np.linalg.norm(gap, axis=-1).mean(axis=-1)


def add_s_error(T_estimate: ArrayLike, T_true: ArrayLike, points: ArrayLike) -> Array:
    """ADD-S (...,) [m], for symmetric objects: from each point in the true pose to the nearest in the estimated one."""
    T_estimate, T_true = check_transform(T_estimate, "T_estimate"), check_transform(T_true, "T_true")
    points = _rows(points, 3, "points")
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


def chamfer_distance(a: ArrayLike, b: ArrayLike) -> float:
    """½ (mean over a of the distance to the nearest point of b + the same from b to a) [m]; a (N, 3), b (M, 3)."""
    a, b = _rows(a, 3, "a"), _rows(b, 3, "b")
    return float(0.5 * (cKDTree(b).query(a)[0].mean() + cKDTree(a).query(b)[0].mean()))


class Alignment(NamedTuple):
    T_target_source: Array  # (4, 4)
    scale: float  # target ≈ T_target_source applied to (scale · source)


def umeyama(source: ArrayLike, target: ArrayLike, with_scale: bool = False) -> Alignment:
    """Least-squares rigid alignment of paired points (N, 3), never a reflection (Umeyama 1991, eqs. 34–43).

    Points on one line leave the turn about it open; one of the equally good alignments is then returned.

    Raises:
        ValueError: for fewer than three points, or if a scale is asked of points that all coincide.
    """
    source, target = _rows(source, 3, "source", 3), _rows(target, 3, "target", 3)
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
    return _rows(check_transform(T, name)[..., :3, 3] if T.shape[-2:] == (4, 4) else T, 3, name, 3)


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
        t = _rows(np.reshape(value, (-1, 1)), 1, name)
        if not (np.diff(t[:, 0]) > 0).all():
            raise ValueError(f"{name}: expected strictly increasing times [s]")
        stamps.append(t)
    distance, nearest_b = cKDTree(stamps[1]).query(stamps[0])
    _, nearest_a = cKDTree(stamps[0]).query(stamps[1])
    paired = (distance <= max_difference) & (nearest_a[nearest_b] == np.arange(len(nearest_b)))
    return np.flatnonzero(paired), nearest_b[paired]


def _errors(value: ArrayLike) -> Array:
    errors = np.asarray(value, dtype=np.float64)
    if errors.ndim != 2 or not len(errors) or not np.isfinite(errors).all():
        raise ValueError(f"errors: expected finite values of shape (T, n), T ≥ 1, got shape {errors.shape}")
    return errors


def mean_absolute_error(errors: ArrayLike, dt: float, skip: float = 5.0) -> Array:
    """Mean |error| per axis (n,) of errors (T, n), leaving out the rows before `skip` [s]; row k is at time k · dt.

    Raises:
        ValueError: if nothing is left after `skip`.
    """
    errors = _errors(errors)
    if not (dt > 0.0 and skip >= 0.0):
        raise ValueError(f"dt, skip: expected dt > 0 and skip ≥ 0 [s], got {dt} and {skip}")
    first = math.ceil(skip / dt - 1e-9)  # so that 5 / 0.02 is 250, whatever its rounding
    if first >= len(errors):
        raise ValueError(f"errors: expected more than {first} rows (skip = {skip} s), got {len(errors)}")
    return np.abs(errors[first:]).mean(axis=0)


class TruenessPrecision(NamedTuple):
    trueness: Array  # (n,) |mean error|: how far off on average
    precision: Array  # (n,) standard deviation of the error (over N, not N − 1): how widely spread


def trueness_precision(errors: ArrayLike) -> TruenessPrecision:
    """|mean| and standard deviation per axis (n,) of errors (T, n), the two parts of accuracy in ISO 5725-1."""
    errors = _errors(errors)
    return TruenessPrecision(np.abs(errors.mean(axis=0)), errors.std(axis=0))
