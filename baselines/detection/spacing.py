"""How dense and how large a cloud is, and where: what default scales are made from."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


@njit(cache=True, nogil=True, error_model="numpy")
def bounds(points):
    """Lowest and highest (3,) coordinates of (N, 3) points, N >= 1: NumPy is slow along the long axis."""
    low, high = points[0].copy(), points[0].copy()
    for i in range(1, len(points)):
        for k in range(3):
            low[k], high[k] = min(low[k], points[i, k]), max(high[k], points[i, k])
    return low, high


@njit(cache=True, nogil=True, error_model="numpy")
def _nearest(points, rows):
    """Squared distance of each row's point to the nearest that does not coincide with it (inf: none)."""
    looks, best = points[rows], np.full(len(rows), np.inf)
    for i in range(len(points)):
        for r in range(len(rows)):
            x, y, z = points[i, 0] - looks[r, 0], points[i, 1] - looks[r, 1], points[i, 2] - looks[r, 2]
            gap = x * x + y * y + z * z
            if 0.0 < gap < best[r]:
                best[r] = gap
    return best


def point_spacing(points: Array, looks: int = 16) -> float:
    """Median distance [m] from a point of (N, 3) to its nearest other, from some of them evenly picked by index.

    Brute force over a few points takes less time than building a tree. Coinciding points do not count; 0 when all do.
    """
    rows = np.unique(np.linspace(0, len(points) - 1, min(looks, len(points))).astype(np.int64))
    gaps = _nearest(points, rows)
    gaps = gaps[np.isfinite(gaps)]
    return float(np.sqrt(np.median(gaps))) if len(gaps) else 0.0


def cloud_size(points: Array) -> float:
    """[m] diagonal of the box that holds all but the outermost 1 % on every side."""
    sample = points[:: max(1, len(points) // 2000)]
    low, high = np.percentile(sample, (1.0, 99.0), axis=0)
    return float(np.linalg.norm(high - low))
