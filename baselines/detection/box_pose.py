"""From a box in an image to the object's pose: crop, remove what it stands on, align its model."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.interfaces import RGBD
from aerograsp_env.spatial import as_array
from baselines.detection.alignment import DepthView, best_pose
from baselines.detection.clusters import connected_labels, groups_of
from baselines.detection.plane import fit_plane
from baselines.detection.registration import LEAST
from baselines.detection.shape_model import shape_model

Array = NDArray[np.float64]

RING = 0.4
"""How far around a box its support is looked for, as a fraction of the box's size."""
SUPPORT = 0.4
"""Smallest share of the points around a box that a plane must hold to be its support."""
PLANE_POINTS = 1000
OBJECT_POINTS = 500
"""Points that are aligned at most."""
NOISE = 0.004
"""Depth noise [m] at 1 m, three standard deviations and more; it grows with the depth's square."""
SMALL = 0.1
"""Pieces of the object's cloud smaller than this share of the largest are taken for strays."""

SURE_SEEN, SURE_INLIERS = 0.85, 0.5
"""Shares of the model seen where it should be, and of the cloud on the model, from which a rough pose, refined, is
right without a search. Wrong poses show in the first: the camera looks through them. What is not removed of the support
lowers the second of right ones too."""
SURER = 0.1
"""By how much a pose that was searched must agree better with the image than the rough pose, refined, to disprove it.
Less is taken for noise: the rough pose stays."""


class BoxPose(NamedTuple):
    """An object's pose, or None where the cloud did not agree with its model."""

    T_c_object: Array | None  # (4, 4)
    score: float  # in [0, 1]: share of the cloud on the model × share of the model that is seen; 0 without a pose
    points: Array  # (N, 3) [m] in the camera's frame: what was taken for the object
    disproved: bool = False  # another pose agrees with the image much better than the rough one that was given


def pose_from_box(
    frame: RGBD,
    box: ArrayLike,
    model: Any,
    T_init: ArrayLike | None = None,
    *,
    min_inlier_fraction: float = 0.5,
    min_seen: float = 0.4,
) -> BoxPose:
    """The pose of the object in a box. Thesis, section 3.6.3 and algorithm 2: detect, crop, align.

    Args:
        frame: colour is not used; depth registered to it.
        box: (4,) xyxy [px]; parts outside the image are cut off.
        model: what `align_model` takes: best a `ShapeModel`, which is made once.
        T_init: (4, 4) rough T_c_object, such as a tracker's prediction. Where it does not fit well, and where it is
            None, all orientations are searched, of which one must agree much better with the image to be taken instead.
        min_inlier_fraction, min_seen: as `align_model`.

    Raises:
        ValueError: a box without extent or outside the image, or a model that is none.
    """
    shape = shape_model(model)
    points, view = object_points(frame, box, shape.diameter)
    if len(points) < LEAST:
        return BoxPose(None, 0.0, points)
    disproved = False
    near = None if T_init is None else best_pose(points, shape, T_init, view=view)
    if near is not None and near.seen >= SURE_SEEN and near.inlier_fraction >= SURE_INLIERS:
        found = near
    else:
        found = best_pose(points, shape, view=view)
        if near is not None:
            disproved = found.score > near.score + SURER
            found = found if disproved else near
    if found.inlier_fraction < min_inlier_fraction or found.seen < min_seen:
        return BoxPose(None, 0.0, points)
    return BoxPose(found.T, found.inlier_fraction * found.seen, points, disproved)


def object_points(frame: RGBD, box: ArrayLike, size: float) -> tuple[Array, DepthView]:
    """What a box shows of an object about `size` [m] large: points (N, 3) in the camera's frame, at most 500.

    Points of the plane around the box (table, floor, wall) and behind it are left out, then what does not hang
    together with the largest remaining piece, or lies farther from it than the object is large.

    Returns:
        The points, (0, 3) where there are none, and the depth around the box.

    Raises:
        ValueError: a box without extent or outside the image.
    """
    camera = frame.intrinsics
    x1, y1, x2, y2 = as_array(box, (4,), "box")
    if not (x1 < x2 and y1 < y2):
        raise ValueError(f"box: expected x1 < x2 and y1 < y2, got {[x1, y1, x2, y2]}")
    if x2 < 0 or y2 < 0 or x1 > camera.width - 1 or y1 > camera.height - 1:
        raise ValueError(f"box: expected one inside {camera.width} × {camera.height} px, got {[x1, y1, x2, y2]}")
    wide, high = RING * (x2 - x1) + 4.0, RING * (y2 - y1) + 4.0
    left, top = max(int(np.floor(x1 - wide)), 0), max(int(np.floor(y1 - high)), 0)
    right, bottom = min(int(np.ceil(x2 + wide)), camera.width - 1), min(int(np.ceil(y2 + high)), camera.height - 1)
    depth = frame.depth[top : bottom + 1, left : right + 1]
    view = DepthView(depth, camera, left, top)
    rows, columns = np.nonzero(depth > 0.0)
    z = depth[rows, columns].astype(np.float64)
    u, v = columns + left, rows + top
    points = np.stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z], axis=1)
    inside = (u >= x1 - 0.5) & (u <= x2 + 0.5) & (v >= y1 - 0.5) & (v <= y2 + 0.5)
    chosen = points[inside]
    if len(chosen) < LEAST:
        return np.empty((0, 3)), view
    above = _above_support(chosen, points[~inside], float(np.median(chosen[:, 2])))
    chosen = chosen[above]
    if len(chosen) < LEAST:
        return np.empty((0, 3)), view
    chosen = chosen[:: max(1, len(chosen) // (3 * OBJECT_POINTS))]
    return _largest_piece(chosen, size, camera.fx), view


def _above_support(points: Array, around: Array, distance: float) -> NDArray[np.bool_]:
    """(N,) which points of the box lie in front of the plane that most points around it lie on; all without one."""
    if len(around) < 30:
        return np.ones(len(points), dtype=bool)
    around = around[:: max(1, len(around) // PLANE_POINTS)]
    noise = NOISE * max(distance, 0.5) ** 2
    try:
        plane = fit_plane(around, threshold=noise, iterations=100)
    except ValueError:  # the points around lie on a line: no plane
        return np.ones(len(points), dtype=bool)
    if plane.inliers.mean() < SUPPORT:
        return np.ones(len(points), dtype=bool)
    height = plane.distance(points)
    spread = 1.4826 * float(np.median(np.abs(plane.distance(around[plane.inliers]))))
    return height > max(3.0 * spread, 1e-3)


def _largest_piece(points: Array, size: float, focal: float) -> Array:
    """The largest connected piece, with those near it that are not much smaller; at most `OBJECT_POINTS`."""
    z = np.median(points[:, 2])
    # Neighbouring pixels are z / f apart on a surface that faces the camera; oblique ones, and thinning, take more.
    step = np.sqrt(max(1.0, np.ptp(points[:, 0]) * np.ptp(points[:, 1]) * (focal / z) ** 2 / len(points)))
    tolerance = max(4.0 * step * z / focal, 3.0 * NOISE * z * z)
    pieces = groups_of(connected_labels(points, tolerance))
    middle = np.median(points[pieces[0]], axis=0)
    kept = [
        piece
        for piece in pieces
        if len(piece) >= SMALL * len(pieces[0]) and np.linalg.norm(np.median(points[piece], axis=0) - middle) < size
    ]
    object_ = points[np.sort(np.concatenate(kept))]
    object_ = object_[np.linalg.norm(object_ - middle, axis=1) < size]
    if len(object_) > OBJECT_POINTS:
        object_ = object_[np.linspace(0, len(object_) - 1, OBJECT_POINTS).astype(np.int64)]
    return object_
