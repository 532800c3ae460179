"""Registration of coloured clouds: pairs by place and colour, four rejectors, and steps to points and planes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from aerograsp_env.spatial import se3_exp
from baselines.detection.rejectors import (
    Pairs,
    hsv_cone,
    reject_colors,
    reject_distance,
    reject_normals,
    reject_shared,
)
from baselines.objects.normals import estimate_normals
from baselines.objects.sampling import group_means, voxel_groups

Array = NDArray[np.float64]

LEAST_COSINE = 0.7
"""Of the angle between the normals of a pair."""
COLOR_LIMIT = 0.25
"""Largest distance of a pair's colours in the HSV cone, whose height is 1."""
POINT_SHARE = 0.3
"""Weight of distances between paired points next to those to tangent planes: colours tell where on a plane."""
NEIGHBORS = 15


class ColoredCloud:
    """A thinned cloud with normals and colours in the HSV cone."""

    def __init__(self, points: Array, colors: NDArray[np.uint8], resolution: float) -> None:
        group, count = voxel_groups(points, resolution)
        places = group_means(points, group, count)
        shades = group_means(colors.astype(np.float64), group, count)
        found = estimate_normals(places, places.mean(axis=0), min(NEIGHBORS, max(3, count)))
        self.points, self.normals = places[found.valid], found.normals[found.valid]
        self.colors = hsv_cone(np.rint(shades[found.valid]).astype(np.uint8))


def iterate_with_colors(
    source: ColoredCloud, target: ColoredCloud, T: Array, reach: float, gate: float, max_iterations: int, least: int
) -> tuple[Array, bool, int]:
    """The pose (4, 4) that lays the source on the target, whether the steps came to rest, and their number.

    Each source point is paired with the target point that is nearest in place and colour together; a pair must pass
    the rejectors of distance (which shrinks from `reach` to `gate` [m]), normals, colours and one-to-one.
    """
    joint = cKDTree(np.concatenate([target.points, reach * target.colors], axis=1))
    size = max(float(np.ptp(source.points, axis=0).max()), gate)
    limit, still = reach, 0
    for iteration in range(1, max_iterations + 1):
        moved = source.points @ T[:3, :3].T + T[:3, 3]
        _, nearest = joint.query(np.concatenate([moved, reach * source.colors], axis=1))
        gaps = np.linalg.norm(moved - target.points[nearest], axis=1)
        pairs = reject_distance(Pairs(np.arange(len(moved)), nearest.astype(np.int64), gaps), limit)
        pairs = reject_normals(pairs, source.normals @ T[:3, :3].T, target.normals, LEAST_COSINE)
        pairs = reject_shared(reject_colors(pairs, source.colors, target.colors, COLOR_LIMIT))
        if len(pairs.source) < least:
            return T, False, iteration
        step = _step(moved[pairs.source], target.points[pairs.target], target.normals[pairs.target])
        if step is None:
            return T, False, iteration
        T = se3_exp(step) @ T
        settled = limit <= gate
        limit = max(gate, 0.8 * limit)
        small = np.linalg.norm(step[:3] + np.cross(step[3:], moved.mean(axis=0))) + size * np.linalg.norm(step[3:])
        # Pairs may switch to and fro for ever: a step far below the spacing, twice, is rest.
        still = still + 1 if settled and small < 0.02 * gate else 0
        if still >= 2:
            return T, True, iteration
    return T, False, max_iterations


def _step(p: Array, q: Array, normals: Array) -> Array | None:
    """The twist (6,) that brings points p (M, 3) to q, by planes and points; None where it is not determined."""
    center = p.mean(axis=0)
    scale = max(float(np.abs(p - center).max()), 1e-12)
    local, gap = (p - center) / scale, (q - p) / scale
    rows = np.concatenate([normals, np.cross(local, normals)], axis=1)
    A, b = rows.T @ rows, rows.T @ np.einsum("ni,ni->n", normals, gap)
    for axis in np.eye(3):
        rows = np.concatenate([np.broadcast_to(axis, local.shape), np.cross(local, axis)], axis=1)
        A += POINT_SHARE * rows.T @ rows
        b += POINT_SHARE * rows.T @ (gap @ axis)
    values = np.linalg.eigvalsh(A)
    if values[0] < 1e-6 * values[-1]:
        return None
    x = np.linalg.solve(A, b)
    turn = x[3:]
    return np.concatenate([scale * x[:3] - np.cross(turn, center), turn])
