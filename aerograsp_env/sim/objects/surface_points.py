"""Points spread evenly over an object's surface, with their outward normals: what a pose tracker's model is."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim.objects.grasp_object import GraspObject

Array = NDArray[np.float64]

DENSE = 8  # candidates a point


@functools.lru_cache(maxsize=512)
def surface_points(item: GraspObject, count: int) -> Array:
    """(count, 6) point [m] and outward unit normal of its facet, in the object's frame; always the same for an object.

    Uniform by area, then thinned so that each next point is the one farthest from those already chosen (Eldar,
    Lindenbaum, Porat and Zeevi 1997, "The farthest point strategy for progressive image sampling").
    """
    if count < 1:
        raise ValueError(f"count: expected a positive number of points, got {count}")
    rng = np.random.default_rng(0)
    a, b, c = (np.asarray(item.vertices, dtype=np.float64)[item.faces[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    area = np.linalg.norm(cross, axis=1)
    face = rng.choice(len(area), size=DENSE * count, p=area / area.sum())
    u, v = rng.random((2, len(face), 1))
    fold = u + v > 1.0
    u, v = np.where(fold, 1.0 - u, u), np.where(fold, 1.0 - v, v)
    points = a[face] + u * (b[face] - a[face]) + v * (c[face] - a[face])
    chosen = np.empty(count, dtype=np.intp)
    chosen[0] = 0
    distance = np.full(len(points), np.inf)
    for k in range(1, count):
        distance = np.minimum(distance, ((points - points[chosen[k - 1]]) ** 2).sum(axis=1))
        chosen[k] = np.argmax(distance)
    result = np.concatenate([points[chosen], (cross / np.maximum(area, 1e-300)[:, None])[face[chosen]]], axis=1)
    result.setflags(write=False)
    return result
