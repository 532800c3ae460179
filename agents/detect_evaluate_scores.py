"""mAP, recall and precision of detections against labelled pictures, where difficult objects count for nothing."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.metrics import box_iou, match_detections, mean_average_precision

Found = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]
"""Boxes (K, 4) xyxy [px], scores (K,) and classes (K,) in one picture."""


SIZES = {"below 24 px": (0.0, 24.0), "24 to 48 px": (24.0, 48.0), "48 px and more": (48.0, np.inf)}
"""Ranges of the square root of a box's area [px]."""


class Labelled(NamedTuple):
    """What is true of one picture."""

    boxes: NDArray[np.floating]  # (M, 4) xyxy [px]
    labels: NDArray[np.int64]  # (M,) classes
    difficult: NDArray[np.bool_]  # (M,) neither right nor wrong to find


class ClassScores(NamedTuple):
    """One class, or all of them."""

    map50: float
    map75: float
    recall: float  # of all detections, whatever their score, at IoU 0.5
    precision: float  # at the operating threshold
    operating_recall: float  # at the operating threshold
    objects: int


class DetectorScores(NamedTuple):
    """A detector on a set of pictures."""

    overall: ClassScores  # means over the classes that have objects; precision and operating recall over all objects
    per_class: dict[str, ClassScores]
    threshold: float  # the operating threshold
    images: int


def without_difficult(found: Found, truth: Labelled, threshold: float) -> Found:
    """Detections less those that are best explained by a difficult object of their class (Everingham et al. 2010)."""
    boxes, scores, labels = found
    if not truth.difficult.any() or not len(boxes):
        return found
    iou = box_iou(boxes, truth.boxes) * (labels[:, None] == truth.labels[None])
    best = iou.argmax(axis=1)
    excused = truth.difficult[best] & (iou[np.arange(len(boxes)), best] >= threshold)
    return boxes[~excused], scores[~excused], labels[~excused]


def score(
    detections: Sequence[Found],
    truths: Sequence[Labelled],
    classes: Sequence[str],
    threshold: float | None = None,
    counted: Iterable[int] | None = None,
) -> DetectorScores:
    """Score the detections of a set of pictures.

    Args:
        detections: of each picture, down to low scores.
        truths: of each picture.
        classes: names, by number.
        threshold: operating score; None takes the one with the best F1 on these very pictures (for validation only).
        counted: classes that are scored; all by default.

    Raises:
        ValueError: another number of pictures than truths, or no object at all.
    """
    if len(detections) != len(truths):
        raise ValueError(f"detections: expected one entry for each of {len(truths)} pictures, got {len(detections)}")
    which = sorted(set(range(len(classes)) if counted is None else counted))
    plain = [_of_classes((t.boxes[~t.difficult], t.labels[~t.difficult]), which) for t in truths]
    precisions: list[dict[Any, float]] = []
    at_half: list[Found] = []
    for overlap in (0.5, 0.75):
        kept = [without_difficult(found, truth, overlap) for found, truth in zip(detections, truths, strict=True)]
        kept = [_found_of_classes(found, which) for found in kept]
        at_half = at_half or kept
        result = mean_average_precision(
            [(boxes, scores, labels.tolist()) for boxes, scores, labels in kept],
            [(boxes, labels.tolist()) for boxes, labels in plain],
            overlap,
        )
        precisions.append(result.per_class)
    hits = {number: _hits(at_half, plain, number) for number in which if number in precisions[0]}
    threshold = _best_f1(hits.values()) if threshold is None else threshold
    per_class = {}
    for number, (scores, correct, positives) in hits.items():
        above = scores >= threshold
        per_class[classes[number]] = ClassScores(
            precisions[0][number],
            precisions[1][number],
            float(correct.sum()) / positives,
            float(correct[above].mean()) if above.any() else 0.0,
            float(correct[above].sum()) / positives,
            positives,
        )
    kept_all, right = (
        sum(int((s >= threshold).sum()) for s, _, _ in hits.values()),
        sum(int(c[s >= threshold].sum()) for s, c, _ in hits.values()),
    )
    objects = sum(row.objects for row in per_class.values())
    map50, map75, recall = (float(np.mean([row[field] for row in per_class.values()])) for field in range(3))
    precision, operating_recall = (right / kept_all if kept_all else 0.0), right / objects
    overall = ClassScores(map50, map75, recall, precision, operating_recall, objects)
    return DetectorScores(overall, per_class, float(threshold), len(truths))


def score_by_size(
    detections: Sequence[Found], truths: Sequence[Labelled], classes: Sequence[str], threshold: float
) -> dict[str, ClassScores]:
    """`score` over objects of each range of `SIZES` alone; a range without objects is left out.

    Objects of other sizes are difficult in it, and detections of other sizes that find no object of the range do not
    count (as in the COCO evaluation).
    """
    found = {}
    for name, (low, high) in SIZES.items():
        kept, mine = [], []
        for (boxes, scores, labels), truth in zip(detections, truths, strict=True):
            there = (side := _sides(truth.boxes)) >= low
            truth = truth._replace(difficult=truth.difficult | ~(there & (side < high)))
            iou = box_iou(boxes, truth.boxes) * (labels[:, None] == truth.labels[None]) * ~truth.difficult[None]
            fits = (iou >= 0.5).any(axis=1) | ((_sides(boxes) >= low) & (_sides(boxes) < high))
            kept.append((boxes[fits], scores[fits], labels[fits]))
            mine.append(truth)
        if any(not truth.difficult.all() for truth in mine):
            found[name] = score(kept, mine, classes, threshold).overall
    return found


def collect(detect: Callable[[Any], Found], samples: Iterable[Any]) -> tuple[list[Found], list[Labelled]]:
    """Run `detect` on samples of a data set."""
    detections, truths = [], []
    for sample in samples:
        detections.append(detect(sample))
        truths.append(
            Labelled(
                np.asarray(sample.boxes, dtype=np.float64).reshape(-1, 4),
                np.asarray(sample.labels, dtype=np.int64),
                np.asarray(sample.difficult, dtype=np.bool_),
            )
        )
    return detections, truths


def _sides(boxes: NDArray) -> NDArray[np.float64]:
    return np.sqrt(np.prod(np.asarray(boxes, dtype=np.float64)[:, 2:] - boxes[:, :2], axis=1))


def _of_classes(truth: tuple[NDArray, NDArray], which: list[int]) -> tuple[NDArray, NDArray]:
    mask = np.isin(truth[1], which)
    return truth[0][mask], truth[1][mask]


def _found_of_classes(found: Found, which: list[int]) -> Found:
    mask = np.isin(found[2], which)
    return found[0][mask], found[1][mask], found[2][mask]


def _hits(
    detections: Sequence[Found], truths: Sequence[tuple[NDArray, NDArray]], number: int
) -> tuple[NDArray[np.float64], NDArray[np.bool_], int]:
    """Scores and correctness of a class's detections over all pictures, and the number of its objects."""
    scores, correct, positives = [np.zeros(0)], [np.zeros(0, dtype=np.bool_)], 0
    for (boxes, values, labels), (true, true_labels) in zip(detections, truths, strict=True):
        mine, theirs = labels == number, true_labels == number
        scores.append(values[mine])
        correct.append(match_detections(boxes[mine], values[mine], true[theirs], 0.5))
        positives += int(theirs.sum())
    return np.concatenate(scores), np.concatenate(correct), positives


def _best_f1(hits: Iterable[tuple[NDArray[np.float64], NDArray[np.bool_], int]]) -> float:
    """The score at which 2 · right / (found + objects) over all classes is largest; 0.5 if nothing is right."""
    rows = list(hits)
    scores = np.concatenate([scores for scores, _, _ in rows])
    correct = np.concatenate([correct for _, correct, _ in rows])
    if not correct.any():
        return 0.5
    order = np.argsort(-scores, kind="stable")
    right = np.cumsum(correct[order])
    f1 = 2.0 * right / (np.arange(1, len(order) + 1) + sum(positives for _, _, positives in rows))
    return float(scores[order][f1.argmax()])
