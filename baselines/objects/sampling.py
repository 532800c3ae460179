"""Fewer points of a cloud: one a voxel, the farthest from each other, or all but the outliers."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


def voxel_groups(points: Array, size: float) -> tuple[Ints, int]:
    """The group (N,) of each point by the voxel of edge `size` it lies in, ordered by voxel, and their number.

    Raises:
        ValueError: a size that is not positive, or so small that voxels cannot be numbered.
    """
    if not 0.0 < size < np.inf:
        raise ValueError(f"size: expected a positive edge length [m], got {size}")
    if len(points) == 0:
        return np.empty(0, dtype=np.int64), 0
    cells = np.floor(points / size)
    cells -= cells.min(axis=0)
    counts = cells.max(axis=0) + 1.0
    if counts.prod() > 2.0**62:
        raise ValueError(f"size: expected one that gives fewer than 2^62 voxels, got {size} for this cloud")
    x, y, z = cells.astype(np.int64).T
    keys = (x * int(counts[1]) + y) * int(counts[2]) + z
    _, group = np.unique(keys, return_inverse=True)
    return group, int(group.max()) + 1


def group_means(values: Array, group: Ints, count: int) -> Array:
    """(count, D) means of values (N, D) over their groups."""
    sums = np.stack([np.bincount(group, weights=column, minlength=count) for column in values.T], axis=1)
    return sums / np.bincount(group, minlength=count)[:, None]


@njit(cache=True, nogil=True, error_model="numpy")
def _farthest(x, y, z, n, first):
    chosen = np.empty(n, dtype=np.int64)
    nearest = np.full(len(x), np.inf)
    current = first
    for i in range(n):
        chosen[i] = current
        cx, cy, cz = x[current], y[current], z[current]
        best = -1.0
        for j in range(len(x)):
            gap = (x[j] - cx) ** 2 + (y[j] - cy) ** 2 + (z[j] - cz) ** 2
            if gap < nearest[j]:
                nearest[j] = gap
            if nearest[j] > best:
                best, current = nearest[j], j
    return chosen


def farthest_point_indices(points: Array, n: int, first: int) -> Ints:
    """Indices (n,) of points that are each farthest from all before, from `first` on. Gonzalez 1985; Eldar et al. 1997.

    Raises:
        ValueError: n outside [0, N].
    """
    if not 0 <= n <= len(points):
        raise ValueError(f"n: expected a number of points in [0, {len(points)}], got {n}")
    if n == 0:
        return np.empty(0, dtype=np.int64)
    x, y, z = np.ascontiguousarray(points.T)
    return _farthest(x, y, z, n, first)


def inliers(points: Array, neighbors: int, deviations: float) -> NDArray[np.bool_]:
    """(N,) whether a point's mean distance to its `neighbors` nearest is within `deviations` standard deviations of the
    mean of all. Rusu et al. 2008, "Towards 3D point cloud based object maps", section 4.1.

    Raises:
        ValueError: fewer neighbours than one, not more points than neighbours, or negative deviations.
    """
    if not 1 <= neighbors < len(points):
        raise ValueError(f"neighbors: expected a number in [1, {len(points) - 1}], got {neighbors}")
    if not deviations >= 0.0:
        raise ValueError(f"deviations: expected a number ≥ 0, got {deviations}")
    distances, _ = cKDTree(points).query(points, k=neighbors + 1)
    mean = distances[:, 1:].mean(axis=1)
    return mean <= mean.mean() + deviations * mean.std()
