"""Boxes and detections: intersection over union, matching, average precision."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.metrics.arrays import Array, as_rows
from aerograsp_env.spatial import as_array


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


MISSED, IGNORED = -1, -2
"""What `assign_detections` says of a detection that is wrong, and of one that is neither right nor wrong."""


def assign_detections(
    boxes: ArrayLike,
    scores: ArrayLike,
    truth: ArrayLike,
    iou_threshold: float = 0.5,
    difficult: ArrayLike | None = None,
) -> NDArray[np.int64]:
    """Which true box each of one image's detections (N,) of one class found, by PASCAL VOC's rule.

    In order of falling score (ties in the order given) each detection takes the true box that it overlaps most
    (Everingham et al. 2010). It is correct if that IoU is at least the threshold and no earlier detection took that
    box; if that box is difficult, the detection counts neither way, and so may others of it.

    Args:
        boxes: (N, 4) xyxy; scores: (N,); truth: (M, 4) xyxy. N and M may be 0.
        iou_threshold: in (0, 1].
        difficult: (M,) bool, true objects that need not be found; None is none of them.

    Returns:
        (N,) the index of the true box, `MISSED` for a wrong detection, `IGNORED` for one of a difficult object.
    """
    if not 0.0 < iou_threshold <= 1.0:
        raise ValueError(f"iou_threshold: expected a value in (0, 1], got {iou_threshold}")
    boxes, truth = np.reshape(boxes, (-1, 4)), np.reshape(truth, (-1, 4))
    scores = as_rows(np.reshape(scores, (-1, 1)), 1, "scores", 0)[:, 0]
    if len(scores) != len(boxes):
        raise ValueError(f"scores: expected one for each of {len(boxes)} boxes, got {len(scores)}")
    hard = _flags(difficult, len(truth))
    found = np.full(len(boxes), MISSED, dtype=np.int64)
    iou = box_iou(boxes, truth)
    if not iou.size:
        return found
    free = np.ones(len(truth), dtype=np.bool_)
    for i in np.argsort(-scores, kind="stable"):
        best = iou[i].argmax()
        if iou[i, best] < iou_threshold:
            continue
        if hard[best]:
            found[i] = IGNORED
        elif free[best]:
            found[i] = best
            free[best] = False
    return found


def _flags(difficult: ArrayLike | None, count: int) -> NDArray[np.bool_]:
    if difficult is None:
        return np.zeros(count, dtype=np.bool_)
    flags = np.asarray(difficult, dtype=np.bool_).reshape(-1)
    if len(flags) != count:
        raise ValueError(f"difficult: expected one flag for each of {count} true boxes, got {len(flags)}")
    return flags


def match_detections(
    boxes: ArrayLike, scores: ArrayLike, truth: ArrayLike, iou_threshold: float = 0.5
) -> NDArray[np.bool_]:
    """Which of one image's detections (N,) of one class are correct; `assign_detections` says which box each found."""
    return assign_detections(boxes, scores, truth, iou_threshold) >= 0


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
    scores = as_rows(np.reshape(scores, (-1, 1)), 1, "scores", 0)[:, 0]
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
    difficult: Sequence[ArrayLike] | None = None,
) -> MeanAveragePrecision:
    """mAP over images at one IoU threshold.

    Args:
        detections: for each image boxes (N, 4), scores (N,) and N class labels.
        truths: for each image boxes (M, 4) and M class labels.
        difficult: for each image (M,) bool: true objects that need not be found, as VOC leaves them out; None is none.

    Raises:
        ValueError: if the numbers of images or of labels differ, or if there is no true object at all.
    """
    for name, given in (("detections", detections), ("difficult", difficult)):
        if given is not None and len(given) != len(truths):
            raise ValueError(f"{name}: expected one entry for each of {len(truths)} images, got {len(given)}")
    for k, ((boxes, _, found), (true_boxes, true)) in enumerate(zip(detections, truths, strict=True)):
        if len(found) != len(np.reshape(boxes, (-1, 4))) or len(true) != len(np.reshape(true_boxes, (-1, 4))):
            raise ValueError(f"detections, truths: expected one label a box, got another number in image {k}")
    flags = [_flags(None if difficult is None else difficult[k], len(true)) for k, (_, true) in enumerate(truths)]
    needed = [label for (_, true), hard in zip(truths, flags, strict=True) for label in _kept(true, ~hard)]
    per_class: dict[Any, float] = {}
    for label in dict.fromkeys(needed):
        scores, correct, positives = [np.zeros(0)], [np.zeros(0, dtype=np.bool_)], 0
        for (boxes, image_scores, found), (true_boxes, true), hard in zip(detections, truths, flags, strict=True):
            mine = np.fromiter((name == label for name in found), dtype=np.bool_, count=len(found))
            theirs = np.fromiter((name == label for name in true), dtype=np.bool_, count=len(true))
            my_scores, truth = np.reshape(image_scores, -1)[mine], np.reshape(true_boxes, (-1, 4))[theirs]
            my_boxes = np.reshape(boxes, (-1, 4))[mine]
            taken = assign_detections(my_boxes, my_scores, truth, iou_threshold, hard[theirs])
            counts = taken != IGNORED
            scores.append(my_scores[counts])
            correct.append(taken[counts] >= 0)
            positives += int((~hard[theirs]).sum())
        per_class[label] = average_precision(np.concatenate(scores), np.concatenate(correct), positives)
    if not per_class:
        raise ValueError("truths: expected at least one true object, got none")
    return MeanAveragePrecision(float(np.mean(list(per_class.values()))), per_class)


def _kept(labels: Sequence[Hashable], mask: NDArray[np.bool_]) -> list[Hashable]:
    return [label for label, keep in zip(labels, mask, strict=True) if keep]
