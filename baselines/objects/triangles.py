"""Pairs of faces that pass through each other."""

from __future__ import annotations

import numpy as np
from igl import predicates
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


def crossing_pairs(vertices: Array, faces: Ints) -> Ints:
    """(K, 2) pairs of faces where an edge of one pierces the inside of the other, corners that both share left out.

    libigl finds the pairs that meet, with exact predicates. Those that only touch, or overlap in one plane, are left
    out: nearly every assembled mesh has such faces.
    """
    met, pairs, coplanar = predicates.find_self_intersections(
        np.ascontiguousarray(vertices, dtype=np.float64), np.ascontiguousarray(faces, dtype=np.int64)
    )
    if not met:
        return np.empty((0, 2), dtype=np.int64)
    pairs = pairs[coplanar.reshape(len(pairs), -1)[:, 0] == 0]
    s, t = faces[pairs[:, 0]], faces[pairs[:, 1]]
    return pairs[_pierced(vertices, s, t) | _pierced(vertices, t, s)]


def _pierced(vertices: Array, s: Ints, t: Ints) -> NDArray[np.bool_]:
    """(K,) whether an edge of faces s (K, 3) that has no corner of t (K, 3) passes through the inside of t."""
    a, b, c = np.moveaxis(vertices[t], 1, 0)
    corners = np.concatenate([vertices[s], vertices[t]], axis=1)
    tolerance = 1e-12 * np.ptp(corners, axis=1).max(axis=1) ** 3
    shared = (s[:, :, None] == t[:, None, :]).any(axis=2)
    found = np.zeros(len(s), dtype=bool)
    for i in range(3):
        j = (i + 1) % 3
        p, q = vertices[s[:, i]], vertices[s[:, j]]
        above, below = _volume(a, b, c, p), _volume(a, b, c, q)
        through = (np.minimum(above, below) < -tolerance) & (np.maximum(above, below) > tolerance)
        sides = np.stack([_volume(p, q, a, b), _volume(p, q, b, c), _volume(p, q, c, a)])
        inside = (sides > tolerance).all(axis=0) | (sides < -tolerance).all(axis=0)
        found |= through & inside & ~shared[:, i] & ~shared[:, j]
    return found


def _volume(a: Array, b: Array, c: Array, d: Array) -> Array:
    """(K,) six times the signed volume of tetrahedra abcd."""
    return np.vecdot(b - a, np.cross(c - a, d - a))
