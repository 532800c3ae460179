"""Learning a feature model from a sequence of a moving stereo or RGB-D camera."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.interfaces import RGBD, Intrinsics
from aerograsp_env.metrics import umeyama
from aerograsp_env.spatial import check_transform, inverse, project_to_so3, transform, transform_points
from baselines.detection.bundle import bundle_adjust
from baselines.detection.extraction import feature_kind
from baselines.detection.feature_matching import MIN_PAIRS, join_beyond, match_in_order
from baselines.detection.feature_model import FeatureModel
from baselines.detection.propagation import observations, propagate
from baselines.detection.stereo_features import FrameFeatures, StereoRig, rgbd_features, stereo_features

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

ROUNDS = 3  # of bundle adjustment, each without what the last one found wrong


class LearningError(ValueError):
    """The pictures do not give a model; the message says what was missing."""


class LearnedModel(NamedTuple):
    """A model and how it came about."""

    model: FeatureModel
    T_c_object: Array  # (K, 4, 4) of the frames used
    frames: tuple[int, ...]  # which those are
    skipped: tuple[tuple[int, str], ...]  # frames left out, and why
    views: Ints  # (N,) frames that each point is seen in
    rmse: float  # [px] reprojection error of the bundle adjustment
    scale: float  # that the similarity fit multiplied the reconstruction by
    scale_spread: float  # standard deviation of it over the frames, relative
    metric_rmse: float  # [m] between the model's and the frames' own points after the fit


class _Reconstruction(NamedTuple):
    """Poses, points, and which of them are seen where."""

    T_c_o: Array  # (K, 4, 4)
    points: Array  # (N, 3)
    point: Ints  # (M,) of each observation
    frame: Ints  # (M,)
    row: Ints  # (M,) of the frame's features
    errors: Array  # (M,) [px]


def learn_from_stereo(
    pairs: Sequence[tuple[ArrayLike, ArrayLike]],
    rig: StereoRig,
    feature: str = "sift",
    masks: Sequence[ArrayLike | None] | None = None,
    n: int = 1500,
    depth_range: tuple[float, float] = (0.1, 10.0),
    T_c_object: ArrayLike | None = None,
    name: str = "object",
) -> LearnedModel:
    """A model from pairs of pictures in the order in which they were taken: see `learn_feature_model`.

    Args:
        pairs: left and right images, (H, W) or (H, W, 3) RGB, uint8.
        masks: (H, W) bool for each pair, or None: where in the left image the object is.
        n, depth_range: see `stereo_features`.
    """
    masks = _masks(masks, len(pairs))
    frames = [
        stereo_features(left, right, rig, feature, n, mask, depth_range=depth_range)
        for (left, right), mask in zip(pairs, masks, strict=True)
    ]
    return learn_feature_model(frames, rig.left, feature, T_c_object=T_c_object, name=name, rig=rig)


def learn_from_rgbd(
    frames: Sequence[RGBD],
    feature: str = "sift",
    masks: Sequence[ArrayLike | None] | None = None,
    n: int = 1500,
    T_c_object: ArrayLike | None = None,
    name: str = "object",
) -> LearnedModel:
    """A model from frames with depth, in the order in which they were taken: see `learn_feature_model`."""
    masks = _masks(masks, len(frames))
    if not frames:
        raise LearningError("frames: expected 3 or more, got 0")
    found = [rgbd_features(frame, feature, n, mask) for frame, mask in zip(frames, masks, strict=True)]
    ideal = frames[0].intrinsics
    for i, frame in enumerate(frames):
        if frame.intrinsics[:6] != ideal[:6]:
            raise ValueError(f"frames[{i}]: expected the intrinsics of the first frame, got {frame.intrinsics}")
    return learn_feature_model(found, ideal, feature, T_c_object=T_c_object, name=name)


def _masks(masks: Sequence[ArrayLike | None] | None, count: int) -> Sequence[ArrayLike | None]:
    if masks is not None and len(masks) != count:
        raise ValueError(f"masks: expected one for each of {count} frames, got {len(masks)}")
    return [None] * count if masks is None else masks


def learn_feature_model(
    frames: Sequence[FrameFeatures],
    intrinsics: Intrinsics,
    feature: str,
    min_views: int = 3,
    max_error: float = 2.0,
    ratio: float = 0.8,
    descriptors_per_point: int = 5,
    T_c_object: ArrayLike | None = None,
    name: str = "object",
    rig: StereoRig | None = None,
) -> LearnedModel:
    """A feature model from frames around an object that stands still (Ramon Soria 2018, section 3.4).

    Consecutive frames are matched, the matches propagated to all pairs, and points seen in `min_views` frames adjusted
    with the cameras in one bundle. Its scale, which pictures of one camera leave open, is the one of the similarities
    (Umeyama 1991) that bring the points to what the second camera measured in each frame: their median. With a rig of
    equal cameras, a last bundle then holds the right images too, so that errors of scale do not add up along the way.

    A frame that does not fit onto the one before is left out, and named in the result.

    Args:
        frames: features with places, from `stereo_features` or `rgbd_features`.
        intrinsics: of the camera whose pixels they are.
        max_error: [px] beyond which an observation is dropped.
        ratio: of descriptor distances between consecutive frames.
        descriptors_per_point: at most, of its views evenly.
        T_c_object: (4, 4) the object in the first frame, or (K, 4, 4) in all, to which the model's frame is fitted;
            None puts the origin into the middle of the points, with the first used camera's axes.
        rig: the stereo camera, where it was one.

    Raises:
        LearningError: too few frames fit together, or too few points are seen often enough.
        ValueError: descriptors of another feature, or settings out of range.
    """
    kind = feature_kind(feature)
    for i, given in enumerate(frames):
        if given.descriptors.shape[1] != kind.width:
            raise ValueError(f"frames[{i}]: expected descriptors of {kind}, got width {given.descriptors.shape[1]}")
    if min_views < 3 or max_error <= 0.0 or descriptors_per_point < 1:
        raise ValueError(
            f"min_views, max_error, descriptors_per_point: expected ≥ 3, > 0 and ≥ 1, "
            f"got {min_views}, {max_error}, {descriptors_per_point}"
        )
    T_given = None if T_c_object is None else check_transform(T_c_object, "T_c_object").reshape(-1, 4, 4)
    chain = match_in_order(frames, intrinsics, ratio)
    used = [frames[i] for i in chain.frames]
    if len(used) < min_views:
        raise LearningError(f"frames: expected {min_views} or more that fit together, got {len(used)} of {len(frames)}")
    matches = propagate(chain.matches)
    join_beyond(matches, used, intrinsics, ratio)
    seen = observations(matches, [len(f.pixels) for f in used], min_views)
    if seen.points < MIN_PAIRS:
        raise LearningError(f"frames: expected {MIN_PAIRS} points or more in {min_views} views, got {seen.points}")
    T = np.array(chain.T_c_o)
    stereo = np.array([used[f].points_c[r] for f, r in zip(seen.frame, seen.feature, strict=True)])
    lifted = transform_points(inverse(T)[seen.frame], stereo[:, None])[:, 0]
    points = np.array([np.median(lifted[seen.point == k], axis=0) for k in range(seen.points)])
    state = _Reconstruction(T, points, seen.point, seen.frame, seen.feature, np.zeros(len(stereo)))
    state = _adjust(state, used, intrinsics, min_views, max_error)
    scale, spread, metric = _scale(state, used)
    state = state._replace(T_c_o=transform(state.T_c_o[:, :3, :3], scale * state.T_c_o[:, :3, 3]))
    state = state._replace(points=scale * state.points)
    if rig is not None and rig.left[:6] == rig.right[:6] and all(f.pixels_right is not None for f in used):
        state = _adjust(state, used, intrinsics, min_views, max_error, rig)
    T, points, point, frame, row, errors = state
    T_first_object = transform(np.eye(3), np.median(points, axis=0))
    if T_given is not None:
        known = [(k, i) for k, i in enumerate(chain.frames) if i < len(T_given)]
        if not known:
            raise LearningError("frames: the first is not used, which T_c_object is given for")
        each = np.array([inverse(T[k]) @ T_given[i] for k, i in known])
        T_first_object = transform(project_to_so3(each[:, :3, :3].mean(axis=0)), each[:, :3, 3].mean(axis=0))
    rows, owners = _representatives(point, frame, descriptors_per_point)
    model = FeatureModel(
        transform_points(inverse(T_first_object), points),
        np.array([used[frame[r]].descriptors[row[r]] for r in rows], dtype=kind.dtype),
        *(feature, owners, name),
    )
    views = np.bincount(point, minlength=len(points))
    rmse = float(np.sqrt((errors**2).mean()))
    poses = T @ T_first_object
    return LearnedModel(model, poses, tuple(chain.frames), tuple(chain.skipped), views, rmse, scale, spread, metric)


def _adjust(
    state: _Reconstruction,
    frames: Sequence[FrameFeatures],
    intrinsics: Intrinsics,
    min_views: int,
    max_error: float,
    rig: StereoRig | None = None,
) -> _Reconstruction:
    """Bundle adjustments, each without the observations that the last one found wrong."""
    T, points, point, frame, row, errors = state
    for _ in range(ROUNDS):
        seen = [(frames[f], r) for f, r in zip(frame, row, strict=True)]
        right = None if rig is None else np.array([f.pixels_right[r] for f, r in seen if f.pixels_right is not None])
        try:
            result = bundle_adjust(
                T, points, np.array([f.pixels[r] for f, r in seen]), frame, point, intrinsics,
                pixels_right=right, T_right_left=None if rig is None else rig.T_right_left,
            )  # fmt: skip
        except ValueError as fault:
            raise LearningError(f"frames: too little is seen in common: {fault}") from None
        T, points = result.T_c_o, result.points
        good = result.errors <= max_error
        good &= np.bincount(point[good], minlength=len(points))[point] >= min_views
        names, point = np.unique(point[good], return_inverse=True)
        frame, row, points, errors = frame[good], row[good], points[names], result.errors[good]
        if len(points) < MIN_PAIRS:
            raise LearningError(f"frames: expected {MIN_PAIRS} points or more that agree, got {len(points)}")
        if good.all():
            break
    return _Reconstruction(T, points, point, frame, row, errors)


def _scale(state: _Reconstruction, frames: Sequence[FrameFeatures]) -> tuple[float, float, float]:
    """Median over the frames of the scale from the points to the frame's own, its spread, and the error left [m]."""
    scales, squares, count = [], 0.0, 0
    for k, (T, seen) in enumerate(zip(state.T_c_o, frames, strict=True)):
        rows = np.nonzero(state.frame == k)[0]
        if len(rows) < MIN_PAIRS:
            continue
        source, target = transform_points(T, state.points[state.point[rows]]), seen.points_c[state.row[rows]]
        fit = umeyama(source, target, with_scale=True)
        gap = np.linalg.norm(transform_points(fit.T_target_source, fit.scale * source) - target, axis=1)
        near = gap <= 3.0 * np.median(gap) + 1e-12  # stereo's few gross errors would turn the whole fit
        fit = umeyama(source[near], target[near], with_scale=True)
        gap = np.linalg.norm(transform_points(fit.T_target_source, fit.scale * source[near]) - target[near], axis=1)
        scales.append(fit.scale)
        squares, count = squares + float((gap**2).sum()), count + len(gap)
    if not scales or min(scales) <= 0.0:
        raise LearningError(f"frames: expected one with {MIN_PAIRS} points or more, to find the scale")
    scale = float(np.median(scales))
    return scale, float(np.std(scales) / scale), float(np.sqrt(squares / count))


def _representatives(point: Ints, frame: Ints, limit: int) -> tuple[Ints, Ints]:
    """Rows of the observations whose descriptors are kept, and their points."""
    order = np.lexsort((frame, point))
    chosen = []
    for rows in np.split(order, np.nonzero(np.diff(point[order]))[0] + 1):
        chosen.append(rows[np.unique(np.linspace(0, len(rows) - 1, min(limit, len(rows))).round().astype(int))])
    rows = np.concatenate(chosen)
    return rows, point[rows]
