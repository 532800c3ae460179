"""Surface normals and curvature of a cloud, from each point's neighbours.

Pauly, Gross & Kobbelt 2002: the normal is the direction in which the neighbours spread least, and the curvature is that
direction's share of their variance, λ₀ / (λ₀ + λ₁ + λ₂).
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Array = NDArray[np.float64]

COLLINEAR = 1e-8
"""Neighbours whose second spread is below this fraction of the first (of variances) lie on a line: no normal."""


class Normals(NamedTuple):
    """Normals that exist, and which do not."""

    normals: Array  # (N, 3) unit, towards the viewpoint; (0, 0, 0) where not `valid`
    curvature: Array  # (N,) in [0, 1/3]; 0 where not `valid`
    valid: NDArray[np.bool_]  # (N,) False where the neighbours are fewer than three, or lie on a line or a point


@njit(cache=True, nogil=True, error_model="numpy")
def _covariances(points, starts, neighbors):
    """(N, 6): xx, xy, xz, yy, yz, zz of each point's neighbours about their mean."""
    out = np.zeros((len(starts) - 1, 6))
    for i in range(len(starts) - 1):
        first, last = starts[i], starts[i + 1]
        n = last - first
        if n < 3:
            continue
        mx = my = mz = 0.0
        for k in range(first, last):
            j = neighbors[k]
            mx, my, mz = mx + points[j, 0], my + points[j, 1], mz + points[j, 2]
        mx, my, mz = mx / n, my / n, mz / n
        for k in range(first, last):
            j = neighbors[k]
            x, y, z = points[j, 0] - mx, points[j, 1] - my, points[j, 2] - mz
            out[i, 0] += x * x
            out[i, 1] += x * y
            out[i, 2] += x * z
            out[i, 3] += y * y
            out[i, 4] += y * z
            out[i, 5] += z * z
        out[i] /= n
    return out


def neighborhoods(points: Array, neighbors: int | None, radius: float | None) -> tuple[NDArray, NDArray]:
    """Each point's neighbours, itself among them, as starts (N + 1,) in one list: k nearest, within a radius, or both.

    Raises:
        ValueError: neither is given, or one is not positive.
    """
    if neighbors is None and radius is None:
        raise ValueError("neighbors, radius: expected at least one of them")
    if neighbors is not None and neighbors < 3:
        raise ValueError(f"neighbors: expected at least 3, got {neighbors}")
    if radius is not None and not 0.0 < radius < np.inf:
        raise ValueError(f"radius: expected a positive length [m], got {radius}")
    tree = cKDTree(points)
    if neighbors is None:
        lists = tree.query_ball_point(points, radius, return_sorted=True)
        counts = np.fromiter(map(len, lists), dtype=np.int64, count=len(points))
        joined = np.concatenate([np.asarray(x, dtype=np.int64) for x in lists]) if len(points) else np.empty(0, int)
    else:
        bound = np.inf if radius is None else radius
        _, found = tree.query(points, k=np.arange(1, min(neighbors, len(points)) + 1), distance_upper_bound=bound)
        kept = found < len(points)
        counts, joined = kept.sum(axis=1), found[kept]
    return np.concatenate([[0], np.cumsum(counts)]), joined


def normals_from_covariances(packed: Array, points: Array, viewpoint: Array) -> Normals:
    """Eigenvectors of (N, 6) covariances, turned to the viewpoint (3,)."""
    matrices = packed[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
    values, vectors = np.linalg.eigh(matrices)
    values = np.maximum(values, 0.0)
    valid = (values[:, 2] > 0.0) & (values[:, 1] > COLLINEAR * values[:, 2])
    normals = vectors[:, :, 0]
    away = np.einsum("ni,ni->n", normals, viewpoint - points) < 0.0
    normals = np.where(away[:, None], -normals, normals)
    total = values.sum(axis=1)
    curvature = np.where(valid, values[:, 0] / np.where(total > 0.0, total, 1.0), 0.0)
    return Normals(np.where(valid[:, None], normals, 0.0), curvature, valid)


def estimate_normals(
    points: Array, viewpoint: Array, neighbors: int | None = 20, radius: float | None = None
) -> Normals:
    """Normals of points (N, 3) from their k nearest neighbours, those within a radius [m], or both."""
    if len(points) == 0:
        return Normals(np.empty((0, 3)), np.empty(0), np.empty(0, dtype=bool))
    starts, joined = neighborhoods(points, neighbors, radius)
    return normals_from_covariances(_covariances(points, starts, joined), points, viewpoint)


def estimate_organized_normals(grid: Array, valid: NDArray[np.bool_], viewpoint: Array, window: int = 5) -> Normals:
    """Normals of an organised cloud (H, W, 3) from windows of pixels, by box sums: no tree, and time linear in pixels.

    A neighbour counts when its depth from the viewpoint differs by less than 3 % of the window's centre's; the sums of
    one window cannot tell, so a centre whose window straddles such a jump is marked as not valid. After Holzer et al.
    2012, "Adaptive neighborhood selection for real-time surface normal estimation".

    Returns:
        Flat over the H·W pixels.
    """
    if window < 3 or window % 2 == 0:
        raise ValueError(f"window: expected an odd number of pixels ≥ 3, got {window}")
    center = grid[valid].mean(axis=0) if valid.any() else np.zeros(3)
    p = np.where(valid[..., None], grid - center, 0.0)  # about the mean, so that box sums keep their digits
    terms = [valid.astype(np.float64), *np.moveaxis(p, -1, 0)]
    terms += [p[..., i] * p[..., j] for i in range(3) for j in range(i, 3)]
    size = (window, window)
    sums = [cv2.boxFilter(t, cv2.CV_64F, size, normalize=False, borderType=cv2.BORDER_CONSTANT) for t in terms]
    n = np.maximum(sums[0], 1.0)
    means = [s / n for s in sums[1:4]]
    pairs = [(i, j) for i in range(3) for j in range(i, 3)]
    packed = np.stack([s / n - means[i] * means[j] for s, (i, j) in zip(sums[4:], pairs, strict=True)], axis=-1)
    depth = np.linalg.norm(grid - viewpoint, axis=-1)
    kernel = np.ones(size, dtype=np.uint8)
    farthest = cv2.dilate(np.where(valid, depth, 0.0), kernel)
    nearest = cv2.erode(np.where(valid, depth, np.inf), kernel)
    usable = valid & (sums[0] >= 3.0) & (farthest - nearest < 0.03 * np.where(valid, depth, 1.0) * (window // 2))
    packed[~usable] = 0.0
    points = np.where(valid[..., None], grid, 0.0).reshape(-1, 3)
    return normals_from_covariances(packed.reshape(-1, 6), points, viewpoint)
