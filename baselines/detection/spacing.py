"""How dense and how large a cloud is: what default scales are made from."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


@njit(cache=True, nogil=True, error_model="numpy")
def _nearest(points, rows):
    """Squared distance of each row's point to the nearest that does not coincide with it (inf: none)."""
    out = np.full(len(rows), np.inf)
    for r in range(len(rows)):
        x, y, z = points[rows[r], 0], points[rows[r], 1], points[rows[r], 2]
        best = np.inf
        for i in range(len(points)):
            gap = (points[i, 0] - x) ** 2 + (points[i, 1] - y) ** 2 + (points[i, 2] - z) ** 2
            if 0.0 < gap < best:
                best = gap
        out[r] = best
    return out


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
