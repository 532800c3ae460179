"""Rays through the voxels that a cloud's points occupy: where each crosses the surface that the points lie on."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from baselines.objects.observations import check_points

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

LARGEST = 2**24
"""Largest number of voxels."""
GAP = 1
"""Empty voxels that a run of occupied ones may have within."""
GRAZING = 0.25
"""Crossings at a cosine below this, between ray and normal, are left out: where they are is ill-defined."""


class Crossings(NamedTuple):
    """Where rays cross the surface, ordered by ray and then by distance."""

    rays: Ints  # (H,) which ray
    distances: Array  # (H,) [m] along the ray
    normals: Array  # (H, 3) unit mean normal of the points there


class Occupancy(NamedTuple):
    """A grid of voxels over points with normals."""

    lower: Array  # (3,) corner of the grid [m]
    voxel: float  # edge [m]
    shape: Ints  # (3,) voxels along each axis
    starts: Ints  # (voxels + 1,) where each voxel's points begin
    points: Array  # (N, 3) [m], by voxel
    normals: Array  # (N, 3)

    @classmethod
    def build(cls, points: Array, normals: Array, voxel: float) -> Occupancy:
        """Raises ValueError for a voxel that is not positive, or gives more than `LARGEST` of them."""
        if not 0.0 < voxel < np.inf:
            raise ValueError(f"voxel: expected a positive edge length [m], got {voxel}")
        lower = points.min(axis=0) - voxel
        size = np.floor((points.max(axis=0) - lower) / voxel) + 2.0
        if size.prod() > LARGEST:
            raise ValueError(
                f"voxel: expected one that gives at most {LARGEST} voxels, got {size.prod():.3g} of {voxel} m"
            )
        shape = size.astype(np.int64)
        x, y, z = np.floor((points - lower) / voxel).astype(np.int64).T
        keys = (x * shape[1] + y) * shape[2] + z
        order = np.argsort(keys, kind="stable")
        starts = np.concatenate([[0], np.cumsum(np.bincount(keys, minlength=int(shape.prod())))])
        return cls(lower, float(voxel), shape, starts, points[order], normals[order])

    def cast(self, origins: Array, directions: Array, oriented: bool) -> Crossings:
        """Every crossing of rays from origins (N, 3) along unit directions (N, 3).

        A run of occupied voxels is one crossing, at the plane through the mean of its points within a voxel of the ray,
        across the mean of their normals. Where normals are oriented, points whose normals face the ray and those that
        look away are told apart, so that a plate thinner than a voxel is crossed twice; else normals are turned
        against the ray.
        """
        o, d = check_points(origins, "origins"), check_points(directions, "directions")
        rays, distances, normals = _cast(*self, o, d, oriented)
        order = np.lexsort((distances, rays))
        return Crossings(rays[order], distances[order], normals[order])


@njit(cache=True, nogil=True, error_model="numpy")
def _cast(lower, voxel, shape, starts, points, normals, origins, directions, oriented):
    rays, distances, found = (
        [np.int64(0) for _ in range(0)],
        [0.0 for _ in range(0)],
        [(0.0, 0.0, 0.0) for _ in range(0)],
    )
    sums, counts = np.zeros((2, 6)), np.zeros(2, dtype=np.int64)  # facing the ray, and looking away
    cell, step = np.empty(3, dtype=np.int64), np.empty(3, dtype=np.int64)
    border, stride = np.empty(3), np.empty(3)
    for r in range(len(origins)):
        o, d = origins[r], directions[r]
        enter, leave = 0.0, np.inf
        for i in range(3):
            low, high = lower[i] - o[i], lower[i] + shape[i] * voxel - o[i]
            if abs(d[i]) < 1e-12:
                if low > 0.0 or high <= 0.0:
                    leave = -1.0
                continue
            a, b = low / d[i], high / d[i]
            enter, leave = max(enter, min(a, b)), min(leave, max(a, b))
        if leave <= enter:
            continue
        for i in range(3):  # Amanatides & Woo 1987, "A fast voxel traversal algorithm for ray tracing"
            cell[i] = min(max(int(np.floor((o[i] + enter * d[i] - lower[i]) / voxel)), 0), shape[i] - 1)
            step[i] = 1 if d[i] > 0.0 else -1
            if abs(d[i]) < 1e-12:
                border[i], stride[i] = np.inf, np.inf
            else:
                stride[i] = voxel / abs(d[i])
                border[i] = (lower[i] + (cell[i] + (1 if d[i] > 0.0 else 0)) * voxel - o[i]) / d[i]
        sums[:], counts[:] = 0.0, 0
        empty = 0
        inside = True
        while True:
            occupied = False
            if inside:
                key = (cell[0] * shape[1] + cell[1]) * shape[2] + cell[2]
                for n in range(starts[key], starts[key + 1]):
                    p, m = points[n], normals[n]
                    x, y, z = p[0] - o[0], p[1] - o[1], p[2] - o[2]
                    t = x * d[0] + y * d[1] + z * d[2]
                    if x * x + y * y + z * z - t * t > voxel * voxel:
                        continue
                    occupied = True
                    cosine = m[0] * d[0] + m[1] * d[1] + m[2] * d[2]
                    side = 1 if oriented and cosine > 0.0 else 0
                    sign = -1.0 if not oriented and cosine > 0.0 else 1.0
                    for i in range(3):
                        sums[side, i] += p[i]
                        sums[side, 3 + i] += sign * m[i]
                    counts[side] += 1
            empty = 0 if occupied else empty + 1
            if (empty > GAP or not inside) and counts.sum() > 0:
                for side in range(2):
                    nx, ny, nz = sums[side, 3], sums[side, 4], sums[side, 5]
                    length = np.sqrt(nx * nx + ny * ny + nz * nz)
                    if counts[side] == 0 or length == 0.0:
                        continue
                    nx, ny, nz = nx / length, ny / length, nz / length
                    cosine = nx * d[0] + ny * d[1] + nz * d[2]
                    if abs(cosine) < GRAZING:
                        continue
                    n = counts[side]
                    x, y, z = sums[side, 0] / n - o[0], sums[side, 1] / n - o[1], sums[side, 2] / n - o[2]
                    rays.append(np.int64(r))
                    distances.append((x * nx + y * ny + z * nz) / cosine)
                    found.append((nx, ny, nz))
                sums[:], counts[:] = 0.0, 0
            if not inside:
                break
            axis = 0
            if border[1] < border[axis]:
                axis = 1
            if border[2] < border[axis]:
                axis = 2
            border[axis] += stride[axis]
            cell[axis] += step[axis]
            inside = 0 <= cell[axis] < shape[axis]
    normal = np.empty((len(found), 3))
    for h in range(len(found)):
        normal[h, 0], normal[h, 1], normal[h, 2] = found[h]
    return np.array(rays, dtype=np.int64), np.array(distances, dtype=np.float64), normal
