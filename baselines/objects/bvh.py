"""A bounding volume hierarchy over triangles, for queries that compiled code descends itself."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

LEAF = 4
"""Largest number of triangles in a leaf (unless their centres coincide)."""
BINS = 12
"""Bins of the surface area heuristic (Wald 2007, "On fast construction of SAH-based bounding volume hierarchies")."""
DEPTH = 96
"""Levels at most; a node deeper than `DEPTH` − 32 is split in halves, which adds at most 31."""

PADDING = 1e-9
"""How far boxes are grown, as a fraction of the mesh's extent: more than rounding can move an edge."""

compiled = njit(cache=True, nogil=True, error_model="numpy")


@compiled
def _area(box):
    a, b, c = box[3] - box[0], box[4] - box[1], box[5] - box[2]
    return a * b + b * c + c * a


@compiled
def _grow(box, lower, upper):
    for k in range(3):
        box[k] = min(box[k], lower[k])
        box[3 + k] = max(box[3 + k], upper[k])


@compiled
def _empty(boxes):
    boxes[:, :3] = np.inf
    boxes[:, 3:] = -np.inf


@compiled
def _best_split(lower, upper, centres, order, first, last, cost):
    """(axis, place) of the cheapest of the binned planes, or axis −1 when none is cheaper than `cost`."""
    axis, place = -1, 0.0
    bins, counts = np.empty((BINS, 6)), np.empty(BINS, dtype=np.int64)
    right_cost = np.empty(BINS)
    running = np.empty((1, 6))
    for k in range(3):
        low = high = centres[order[first], k]
        for i in range(first, last):
            low, high = min(low, centres[order[i], k]), max(high, centres[order[i], k])
        if not high > low:
            continue
        scale = BINS / (high - low)
        _empty(bins)
        counts[:] = 0
        for i in range(first, last):
            b = min(BINS - 1, int((centres[order[i], k] - low) * scale))
            counts[b] += 1
            _grow(bins[b], lower[order[i]], upper[order[i]])
        _empty(running)
        count = 0
        for b in range(BINS - 1, 0, -1):
            count += counts[b]
            _grow(running[0], bins[b, :3], bins[b, 3:])
            right_cost[b] = count * _area(running[0]) if count else 0.0
        _empty(running)
        count = 0
        for b in range(BINS - 1):
            count += counts[b]
            _grow(running[0], bins[b, :3], bins[b, 3:])
            if count == 0 or count == last - first:
                continue
            here = count * _area(running[0]) + right_cost[b + 1]
            if here < cost:
                axis, place, cost = k, low + (b + 1) / scale, here
    return axis, place


@compiled
def _build(lower, upper, centres):
    """Nodes' boxes and links, and the faces' order, split by the surface area heuristic."""
    n = len(centres)
    order = np.arange(n)
    boxes, links = np.empty((2 * n, 6)), np.empty((2 * n, 2), dtype=np.int64)
    stack = np.empty((2 * n, 4), dtype=np.int64)  # node, first, last, depth
    stack[0] = 0, 0, n, 0
    top, used = 1, 1
    while top:
        top -= 1
        node, first, last, depth = stack[top]
        _empty(boxes[node : node + 1])
        for i in range(first, last):
            _grow(boxes[node], lower[order[i]], upper[order[i]])
        count = last - first
        middle = first
        if count > LEAF and depth < DEPTH - 32:
            axis, place = _best_split(lower, upper, centres, order, first, last, np.inf)
            if axis >= 0:
                end = last
                while middle < end:
                    if centres[order[middle], axis] < place:
                        middle += 1
                    else:
                        end -= 1
                        order[middle], order[end] = order[end], order[middle]
        if count > LEAF and middle in (first, last):
            middle = first + count // 2
        if count <= LEAF:
            links[node] = ~first, count
            continue
        links[node] = used, used + 1
        stack[top] = used, first, middle, depth + 1
        stack[top + 1] = used + 1, middle, last, depth + 1
        top += 2
        used += 2
    return boxes[:used].copy(), links[:used].copy(), order


class BVH(NamedTuple):
    """Boxes and triangles, in the order of the tree."""

    boxes: Array  # (M, 6) lower and upper corner of each node
    links: Ints  # (M, 2) inner node: its two children; leaf: ~first triangle and count
    corners: Array  # (F, 3, 3), in leaf order

    @classmethod
    def build(cls, vertices: Array, faces: Ints) -> BVH:
        """From vertices (V, 3) and faces (F, 3); at least one face."""
        corners = np.ascontiguousarray(vertices, dtype=np.float64)[faces]
        lower, upper = corners.min(axis=1), corners.max(axis=1)
        boxes, links, order = _build(lower, upper, 0.5 * (lower + upper))
        padding = PADDING * float((upper.max(axis=0) - lower.min(axis=0)).max())
        boxes[:, :3] -= padding
        boxes[:, 3:] += padding
        return cls(boxes, links, corners[order])
