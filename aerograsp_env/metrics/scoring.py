"""Detections with poses, scored over a sequence of frames: boxes by average precision, poses of what was found.

`score_frame` compares one frame with its truth, `summarize` pools any number of frames, so that an episode's score can
be had after each of its frames.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.interfaces import Detection
from aerograsp_env.metrics.arrays import Array, as_rows
from aerograsp_env.metrics.detection import IGNORED, MISSED, assign_detections, average_precision
from aerograsp_env.metrics.pose import add_s_error, rotation_error
from aerograsp_env.spatial import check_rotation

IOU_THRESHOLDS = (0.50, 0.75)
ADD_SHARE = 0.1
"""Of an object's diameter: a pose whose ADD-S is at most that counts as right (Hinterstoisser et al. 2012)."""


@dataclass(frozen=True, eq=False)
class PoseModel:
    """What poses of one object are scored with.

    Raises:
        ValueError: no points, a diameter that is not positive, or symmetries that are not rotations.
    """

    points: Array  # (N, 3) of the surface, object frame [m]
    diameter: float  # largest distance between two points of the object [m]
    symmetries: Array  # (K, 3, 3) rotations that leave its look unchanged, the identity among them

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", as_rows(self.points, 3, "points"))
        if not 0.0 < self.diameter < np.inf:
            raise ValueError(f"diameter: expected a positive length [m], got {self.diameter}")
        symmetries = check_rotation(self.symmetries, "symmetries")
        if symmetries.ndim != 3 or not len(symmetries):
            raise ValueError(f"symmetries: expected shape (K, 3, 3) with K ≥ 1, got {symmetries.shape}")
        object.__setattr__(self, "symmetries", symmetries)


class TrueObject(NamedTuple):
    """One object in one frame as it truly is."""

    label: str
    box: Array  # (4,) xyxy of what is visible [px]
    T_c_object: Array | None = None  # (4, 4); None where only boxes are known
    model: PoseModel | None = None  # needed where `T_c_object` is
    difficult: bool = False  # need not be found: neither reward nor fault
    identity: int = -1  # which of the scene's objects it is, the same in every frame


class Match(NamedTuple):
    """A detection that found an object at IoU 0.5. The errors are NaN where either has no pose."""

    detection: int
    truth: int
    position_error: float  # [m]
    rotation_error: float  # [rad], over the object's symmetries
    add_s: float  # [m]
    add_s_passed: bool  # at most `ADD_SHARE` of the diameter


class FrameScore(NamedTuple):
    """One frame's detections, in the order given, against its truth."""

    labels: tuple[str, ...]  # N
    scores: Array  # (N,)
    found: NDArray[np.int64]  # (2, N) by threshold of `IOU_THRESHOLDS`: index of a true object, MISSED or IGNORED
    needed: tuple[str, ...]  # labels of the true objects that are not difficult
    matches: tuple[Match, ...]


class DetectionSummary(NamedTuple):
    """Scores over frames. Shares and precisions are in [0, 1]; NaN where nothing defines a value."""

    map50: float  # mean over classes of the average precision at IoU 0.5
    map75: float
    recall: float  # at IoU 0.5, of all detections whatever their score; over all true objects
    precision: float  # NaN without detections
    f1: float  # harmonic mean of the two; 0 where nothing was detected
    add_s: float  # share of the true objects that were found with ADD-S ≤ 0.1 d
    position_error: float  # median over what was found [m]; a match without a pose counts as infinitely far
    rotation_error: float  # median [rad]
    per_class: dict[str, dict[str, float]]  # label → "map50", "map75", "recall"


def score_frame(detections: Sequence[Detection], truths: Sequence[TrueObject]) -> FrameScore:
    """One frame's detections against its true objects, class by class, by `assign_detections`.

    Raises:
        ValueError: a true pose without a model to score it by.
    """
    for k, true in enumerate(truths):
        if true.T_c_object is not None and true.model is None:
            raise ValueError(f"truths: expected a model with the pose of object {k} ({true.label!r}), got None")
    scores = np.array([d.score for d in detections], dtype=np.float64)
    found = np.full((len(IOU_THRESHOLDS), len(detections)), MISSED, dtype=np.int64)
    for label in dict.fromkeys(d.label for d in detections):
        mine = np.array([i for i, d in enumerate(detections) if d.label == label])
        theirs = np.array([j for j, true in enumerate(truths) if true.label == label], dtype=np.int64)
        boxes = np.array([detections[i].box for i in mine])
        truth = np.array([truths[j].box for j in theirs]).reshape(-1, 4)
        difficult = np.array([truths[j].difficult for j in theirs], dtype=np.bool_)
        for row, threshold in enumerate(IOU_THRESHOLDS):
            taken = assign_detections(boxes, scores[mine], truth, threshold, difficult)
            hit = taken >= 0
            found[row, mine[hit]] = theirs[taken[hit]]
            found[row, mine[taken == IGNORED]] = IGNORED
    pairs = [(i, int(j)) for i, j in enumerate(found[0]) if j >= 0]
    matches = tuple(_match(i, j, detections[i], truths[j]) for i, j in pairs)
    needed = tuple(true.label for true in truths if not true.difficult)
    return FrameScore(tuple(d.label for d in detections), scores, found, needed, matches)


def _match(i: int, j: int, detection: Detection, true: TrueObject) -> Match:
    T, T_true, model = detection.T_c_object, true.T_c_object, true.model
    if T is None or T_true is None or model is None:
        return Match(i, j, np.nan, np.nan, np.nan, False)
    distance = float(np.linalg.norm(T[:3, 3] - T_true[:3, 3]))
    angle = float(rotation_error(T, T_true, model.symmetries))
    add_s = float(add_s_error(T, T_true, model.points))
    return Match(i, j, distance, angle, add_s, add_s <= ADD_SHARE * model.diameter)


def summarize(frames: Iterable[FrameScore]) -> DetectionSummary:
    """The frames' scores together.

    Raises:
        ValueError: no frame holds a true object that is not difficult.
    """
    frames = list(frames)
    needed = np.array([label for frame in frames for label in frame.needed])
    if not needed.size:
        raise ValueError("frames: expected at least one true object, got none")
    labels = np.array([label for frame in frames for label in frame.labels])
    scores = np.concatenate([frame.scores for frame in frames])
    found = np.concatenate([frame.found for frame in frames], axis=1)
    counts = found != IGNORED
    per_class: dict[str, dict[str, float]] = {}
    for label in dict.fromkeys(needed.tolist()):
        mine, positives = labels == label, int((needed == label).sum())
        figures = {}
        for row, name in enumerate(("map50", "map75")):
            of = mine & counts[row]
            figures[name] = average_precision(scores[of], found[row, of] >= 0, positives)
        figures["recall"] = float((found[0, mine] >= 0).sum() / positives)
        per_class[label] = figures
    true, reported = int((found[0] >= 0).sum()), int(counts[0].sum())
    matches = [match for frame in frames for match in frame.matches]
    return DetectionSummary(
        map50=float(np.mean([figures["map50"] for figures in per_class.values()])),
        map75=float(np.mean([figures["map75"] for figures in per_class.values()])),
        recall=true / needed.size,
        precision=true / reported if reported else np.nan,
        f1=2.0 * true / (reported + needed.size),
        add_s=sum(match.add_s_passed for match in matches) / needed.size,
        position_error=_median([match.position_error for match in matches]),
        rotation_error=_median([match.rotation_error for match in matches]),
        per_class=per_class,
    )


def _median(errors: list[float]) -> float:
    values: Any = np.array(errors)
    return float(np.median(np.where(np.isnan(values), np.inf, values))) if len(values) else np.nan
