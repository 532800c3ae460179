"""Groups of points that hang together: neighbours closer than a tolerance, and their neighbours in turn."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from baselines.detection.checks import check_points, check_positive
from baselines.detection.spacing import point_spacing

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

REACH = 2
"""Cells have the tolerance as their diagonal, so a point's neighbours lie at most two cells away."""


@njit(cache=True, nogil=True, error_model="numpy")
def _root(parent, i):
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@njit(cache=True, nogil=True, error_model="numpy")
def _unite_cells(points, starts, keys, strides, reach, tolerance):
    """(C,) the cell that stands for each cell's group; points are sorted by cell, keys ascending."""
    count = len(keys)
    parent = np.arange(count)
    limit = tolerance * tolerance
    for dx in range(0, reach + 1):
        for dy in range(-reach, reach + 1):
            for dz in range(-reach, reach + 1):
                shift = dx * strides[0] + dy * strides[1] + dz
                if shift <= 0:
                    continue
                other = 0
                for cell in range(count):
                    wanted = keys[cell] + shift
                    while other < count and keys[other] < wanted:
                        other += 1
                    if other == count:
                        break
                    if keys[other] != wanted:
                        continue
                    a, b = _root(parent, cell), _root(parent, other)
                    if a == b:
                        continue
                    near = False
                    for i in range(starts[cell], starts[cell + 1]):
                        for j in range(starts[other], starts[other + 1]):
                            gap = (
                                (points[i, 0] - points[j, 0]) ** 2
                                + (points[i, 1] - points[j, 1]) ** 2
                                + (points[i, 2] - points[j, 2]) ** 2
                            )
                            if gap <= limit:
                                near = True
                                break
                        if near:
                            break
                    if near:
                        parent[max(a, b)] = min(a, b)
    for cell in range(count):
        parent[cell] = _root(parent, cell)
    return parent


def connected_labels(points: Array, tolerance: float) -> Ints:
    """(N,) a number for each point: equal where a chain of points at most `tolerance` [m] apart joins them.

    Exact, like growing regions with a kd-tree, but in time that does not depend on how many neighbours points have:
    points are sorted into cells whose diagonal is the tolerance, so that each cell is of one group, and cells are
    joined by the first close pair that is found.

    Raises:
        ValueError: a tolerance so small for the cloud that cells cannot be numbered.
    """
    cells = np.floor((points - points.min(axis=0)) * (np.sqrt(3.0) / tolerance))
    size = cells.max(axis=0) + 1.0 + 2 * REACH  # empty cells at the far sides, so that keys never wrap around
    if size.prod() > 2.0**62:
        raise ValueError(f"tolerance: expected one that gives fewer than 2^62 cells, got {tolerance} for this cloud")
    x, y, z = cells.astype(np.int64).T
    strides = np.array([int(size[1]) * int(size[2]), int(size[2])], dtype=np.int64)
    key = x * strides[0] + y * strides[1] + z
    order = np.argsort(key, kind="stable")
    keys, starts = np.unique(key[order], return_index=True)
    starts = np.append(starts, len(points))
    groups = _unite_cells(points[order], starts, keys, strides, REACH, tolerance)
    labels = np.empty(len(points), dtype=np.int64)
    labels[order] = np.repeat(groups, np.diff(starts))
    return labels


def euclidean_clusters(
    points: Any, tolerance: float | None = None, min_size: int = 20, max_size: int | None = None
) -> list[Ints]:
    """Clusters of points whose gaps are at most the tolerance (Rusu 2009, section 6.2), the largest first.

    Args:
        points: (N, 3) [m].
        tolerance: [m] largest gap inside a cluster; None: four times the median gap between neighbouring points.
        min_size, max_size: clusters with fewer or more points are left out; None: no upper limit.

    Returns:
        Indices into `points` of each cluster, ascending; an empty list where nothing is large enough.

    Raises:
        ValueError: no points, values that are not finite, or arguments out of range.
    """
    cloud = check_points(points)
    if min_size < 1 or (max_size is not None and max_size < min_size):
        raise ValueError(f"min_size, max_size: expected 1 ≤ min_size ≤ max_size, got {min_size} and {max_size}")
    if tolerance is None:
        if len(cloud) < 2:
            return [np.zeros(1, dtype=np.int64)] if min_size == 1 else []
        tolerance = max(4.0 * point_spacing(cloud), 1e-9)
    return groups_of(connected_labels(cloud, check_positive(tolerance, "tolerance")), min_size, max_size)


def groups_of(labels: Ints, min_size: int = 1, max_size: int | None = None) -> list[Ints]:
    """Indices of each label's points, the largest group first (of equal ones, that of the smaller label)."""
    _, inverse, counts = np.unique(labels, return_inverse=True, return_counts=True)
    members = np.split(np.argsort(inverse, kind="stable"), np.cumsum(counts)[:-1])
    most = np.inf if max_size is None else max_size
    ranked = np.argsort(-counts, kind="stable")
    return [members[i] for i in ranked if min_size <= counts[i] <= most]
