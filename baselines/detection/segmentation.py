"""Objects on a plane, without models: what stands out of the plane and hangs together, apart where colours part."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2
from scipy.spatial import cKDTree

from baselines.detection.checks import check_colors, check_points, check_positive
from baselines.detection.clusters import connected_labels, euclidean_clusters, groups_of
from baselines.detection.plane import Plane, fit_plane
from baselines.detection.spacing import point_spacing
from baselines.objects.normals import estimate_normals
from baselines.objects.sampling import group_means, voxel_groups

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

SEPARATION = 2.0
"""Distance of two colours, in deviations of the points from theirs, from which they may be of two objects."""
WHOLE = 0.7
"""Smallest share of a colour's points that must hang together: print on an object is scattered."""
CONCAVE = 0.05
"""Sine of the angle between touching surfaces, from which they meet in a groove and not over an edge."""


def segment_objects(
    points: Any,
    colors: Any = None,
    plane: Plane | None = None,
    tolerance: float | None = None,
    min_size: int | None = None,
) -> list[Ints]:
    """Indices of the points of each object that stands on the plane, the largest first. Thesis, section 3.2.

    The plane's points and what lies behind it are left out, the rest is parted into Euclidean clusters, and with
    colours, clusters of two objects that touch are parted where their colours differ and their surfaces meet in a
    groove.

    Args:
        points: (N, 3) [m] in the camera's frame (or any, with a plane whose normal points to the free side).
        colors: (N, 3) uint8, or None.
        plane: what the objects stand on; None: the largest plane.
        tolerance: [m] largest gap inside an object; None: four times the gap between neighbouring points.
        min_size: smallest number of points; None: one in a thousand, at least 20.

    Raises:
        ValueError: fewer than four points, values that are not finite, or shapes that do not match.
    """
    cloud = check_points(points, least=4)
    shades = None if colors is None else check_colors(colors, len(cloud)).astype(np.float64)
    floor = fit_plane(cloud) if plane is None else plane
    gap = 4.0 * point_spacing(cloud) if tolerance is None else check_positive(tolerance, "tolerance")
    least = max(20, len(cloud) // 1000) if min_size is None else min_size
    standing = np.nonzero(floor.distance(cloud) > floor.threshold)[0]
    if not len(standing):
        return []
    found = [standing[cluster] for cluster in euclidean_clusters(cloud[standing], gap, least)]
    if shades is not None:
        found = [part for cluster in found for part in _parted(cloud, shades, cluster, gap, least)]
    return sorted(found, key=lambda part: -len(part))


def _parted(points: Array, colors: Array, cluster: Ints, gap: float, least: int) -> list[Ints]:
    """The cluster, or its parts."""
    cell = 1.5 * gap  # a few hundred cells an object: enough to tell, and fast
    group, count = voxel_groups(points[cluster], cell)
    if count < 40:
        return [cluster]
    places = group_means(points[cluster], group, count)
    shades = group_means(colors[cluster], group, count)
    # Neighbours' colours are averaged: letters and stripes blur, objects do not.
    near = cKDTree(places).query_ball_point(places, 2.5 * cell)
    smooth = np.stack([shades[rows].mean(axis=0) for rows in near])
    # Shading changes brightness on one object: its share of the difference is a quarter of chromaticity's.
    total = np.maximum(smooth.sum(axis=1, keepdims=True), 1.0)
    side = _two_colors(np.concatenate([0.25 * smooth, 255.0 * smooth[:, [0, 2]] / total], axis=1))
    if side is None:
        return [cluster]
    side = _tidied(places, side, near, 2.0 * cell)
    if side is None or not _meets_in_a_groove(places, side, 2.0 * cell):
        return [cluster]
    parts = [cluster[side[group] == value] for value in (0, 1)]
    if min(len(part) for part in parts) < least:
        return [cluster]
    return [piece for part in parts for piece in _parted(points, colors, part, gap, least)]


def _two_colors(colors: Array) -> Ints | None:
    """Which of two colours each is nearer to, or None where they hardly differ."""
    start = colors[np.argsort(colors @ np.linalg.svd(colors - colors.mean(axis=0), full_matrices=False)[2][0])]
    centers, side = kmeans2(colors, start[[len(start) // 10, -len(start) // 10]], minit="matrix", iter=20)
    axis = centers[1] - centers[0]
    length = float(np.linalg.norm(axis))
    if length <= 0.0 or not 0 < side.sum() < len(side):
        return None
    rest = (colors - centers[side]) @ (axis / length)
    return side.astype(np.int64) if length > SEPARATION * max(float(rest.std()), 2.0) else None


def _tidied(places: Array, side: Ints, near: Any, reach: float) -> Ints | None:
    """Each colour as one piece, with its islands given to the other; None where a colour is too scattered."""
    side = np.array([int(2 * side[rows].sum() > len(rows)) for rows in near])
    for value in (0, 1):
        rows = np.nonzero(side == value)[0]
        if not len(rows):
            return None
        pieces = groups_of(connected_labels(places[rows], reach))
        if len(pieces[0]) < WHOLE * len(rows):
            return None
        side[rows[np.concatenate(pieces[1:])] if len(pieces) > 1 else rows[:0]] = 1 - value
    return side


def _meets_in_a_groove(places: Array, side: Ints, reach: float) -> bool:
    """Whether the surfaces on either side of the border bend towards each other, as two objects that touch do.

    The criterion of Stein et al. 2014, "Object partitioning using local convexity", eq. 1, averaged over the border.
    """
    found = estimate_normals(places, np.zeros(3), 15)
    one, other = np.nonzero(side == 0)[0], np.nonzero(side == 1)[0]
    pairs = cKDTree(places[one]).query_ball_tree(cKDTree(places[other]), reach)
    i = np.repeat(one, [len(rows) for rows in pairs])
    j = other[np.concatenate([np.asarray(rows, dtype=np.int64) for rows in pairs])] if len(i) else i
    if not len(i):
        return True
    # Normals right at a groove are blurred over it: those a little away on each side tell.
    axis = places[i] - places[j]
    axis /= np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-12)
    inward = [_behind(places, found.normals, rows, reach) for rows in (one, other)]
    bend = np.einsum("ni,ni->n", inward[0][np.searchsorted(one, i)] - inward[1][np.searchsorted(other, j)], axis)
    return float(np.median(bend)) < -CONCAVE


def _behind(places: Array, normals: Array, rows: Ints, reach: float) -> Array:
    """(K, 3) mean normal of the same side's points around each of `rows`."""
    around = cKDTree(places[rows]).query_ball_point(places[rows], 1.5 * reach)
    return np.stack([normals[rows[near]].mean(axis=0) for near in around])
