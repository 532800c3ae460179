"""The plane that most points of a cloud lie on, by random sample consensus."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.spatial import as_array
from baselines.detection.checks import check_points, check_positive

Array = NDArray[np.float64]

COARSE = 0.01
"""First guess of the threshold, as a fraction of the cloud's diagonal."""
DEVIATIONS = 3.0
"""Standard deviations of the plane's own points that make the threshold."""
LOOK = 4000
"""Points that hypotheses are compared on: more would change the winner little."""


class Plane(NamedTuple):
    """The points p with normal @ p = offset."""

    normal: Array  # (3,) unit, towards the viewpoint
    offset: float  # [m]
    inliers: NDArray[np.bool_]  # (N,) which points lie on it
    threshold: float  # [m] distance up to which they do

    def distance(self, points: ArrayLike) -> Array:
        """Signed distances [m] of points (..., 3), positive on the viewpoint's side."""
        return as_array(points, (3,), "points") @ self.normal - self.offset


@njit(cache=True, nogil=True, error_model="numpy")
def _best_plane(points, triples, threshold):
    """The triple's plane (normal, offset) with the smallest sum of distances, each cut at the threshold (MSAC)."""
    best, result = np.inf, np.zeros(4)
    for t in range(len(triples)):
        p, q, r = points[triples[t, 0]], points[triples[t, 1]], points[triples[t, 2]]
        ax, ay, az = q[0] - p[0], q[1] - p[1], q[2] - p[2]
        bx, by, bz = r[0] - p[0], r[1] - p[1], r[2] - p[2]
        nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        size = np.sqrt(nx * nx + ny * ny + nz * nz)
        if size <= 1e-9 * np.sqrt((ax * ax + ay * ay + az * az) * (bx * bx + by * by + bz * bz)):
            continue
        nx, ny, nz = nx / size, ny / size, nz / size
        offset = nx * p[0] + ny * p[1] + nz * p[2]
        cost = 0.0
        for i in range(len(points)):
            gap = abs(nx * points[i, 0] + ny * points[i, 1] + nz * points[i, 2] - offset)
            cost += gap if gap < threshold else threshold
            if cost >= best:
                break
        if cost < best:
            best = cost
            result[0], result[1], result[2], result[3] = nx, ny, nz, offset
    return result


def fit_plane(
    points: Any,
    threshold: float | None = None,
    rng: np.random.Generator | None = None,
    iterations: int = 300,
    viewpoint: ArrayLike = (0.0, 0.0, 0.0),
) -> Plane:
    """The plane with the most points near it: the floor or the table, in the thesis's section 3.2.

    RANSAC (Fischler & Bolles 1981) with truncated residuals (Torr & Zisserman 2000), then least squares on its points.

    Args:
        points: (N, 3) [m], at least four.
        threshold: [m] how far points of the plane may be from it. None: found from the cloud, as three robust
            standard deviations of the plane's own points.
        rng: None: the same samples at every call.
        iterations: planes tried.
        viewpoint: (3,) [m] the normal points to its side; the origin is right for a camera's own frame.

    Raises:
        ValueError: fewer than four points, values that are not finite, or points that all lie on a line.
    """
    cloud = check_points(points, least=4)
    view = as_array(viewpoint, (3,), "viewpoint")
    if iterations < 1:
        raise ValueError(f"iterations: expected at least 1, got {iterations}")
    rng = np.random.default_rng(0) if rng is None else rng
    center = cloud.mean(axis=0)
    local = cloud - center  # so that far-away clouds keep their digits
    if threshold is not None:
        limit = check_positive(threshold, "threshold")
    else:
        limit = max(COARSE * float(np.linalg.norm(np.ptp(local, axis=0))), 1e-12)
    shown = local if len(local) <= LOOK else local[rng.choice(len(local), LOOK, replace=False)]
    triples = rng.integers(0, len(shown), (iterations, 3))
    found = _best_plane(shown, triples, limit)
    if not found[:3].any():
        raise ValueError("points: expected some that span a plane, got all on one line")
    normal, offset = found[:3], float(found[3])
    for _ in range(4):
        gaps = np.abs(local @ normal - offset)
        near = gaps <= limit
        if near.sum() < 3:
            break
        middle = local[near].mean(axis=0)
        spread = local[near] - middle
        normal = np.linalg.eigh(spread.T @ spread)[1][:, 0]
        offset = float(normal @ middle)
        if threshold is None:
            noise = 1.4826 * float(np.median(np.abs(spread @ normal)))
            limit = min(limit, max(DEVIATIONS * noise, 1e-9 + 1e-6 * float(np.abs(local).max())))
    inliers = np.abs(local @ normal - offset) <= limit
    offset += float(normal @ center)
    if normal @ view < offset:
        normal, offset = -normal, -offset
    return Plane(normal, offset, inliers, limit)
