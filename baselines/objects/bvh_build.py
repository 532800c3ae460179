"""Building a bounding volume hierarchy of boxes (N, 6): lower corner, then upper."""

from __future__ import annotations

import numpy as np
from numba import njit

LEAF = 4
"""Largest number of triangles in a leaf (unless their centres coincide)."""
BINS = 12
"""Bins of the surface area heuristic (Wald 2007, "On fast construction of SAH-based bounding volume hierarchies")."""
DEPTH = 96
"""Size of the traversal stacks; a node deeper than `DEPTH` − 32 is split in halves, which adds at most 31 levels."""

compiled = njit(cache=True, nogil=True, error_model="numpy")


@compiled
def _area(box):
    a, b, c = box[3] - box[0], box[4] - box[1], box[5] - box[2]
    return a * b + b * c + c * a


@compiled
def grow(box, lower, upper):
    for k in range(3):
        box[k] = min(box[k], lower[k])
        box[3 + k] = max(box[3 + k], upper[k])


@compiled
def empty(boxes):
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
        empty(bins)
        counts[:] = 0
        for i in range(first, last):
            b = min(BINS - 1, int((centres[order[i], k] - low) * scale))
            counts[b] += 1
            grow(bins[b], lower[order[i]], upper[order[i]])
        empty(running)
        count = 0
        for b in range(BINS - 1, 0, -1):
            count += counts[b]
            grow(running[0], bins[b, :3], bins[b, 3:])
            right_cost[b] = count * _area(running[0]) if count else 0.0
        empty(running)
        count = 0
        for b in range(BINS - 1):
            count += counts[b]
            grow(running[0], bins[b, :3], bins[b, 3:])
            if count == 0 or count == last - first:
                continue
            here = count * _area(running[0]) + right_cost[b + 1]
            if here < cost:
                axis, place, cost = k, low + (b + 1) / scale, here
    return axis, place


@compiled
def build(lower, upper, centres):
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
        empty(boxes[node : node + 1])
        for i in range(first, last):
            grow(boxes[node], lower[order[i]], upper[order[i]])
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


@compiled
def widen(boxes, links):
    """The same tree with up to four children a node: boxes (W, 6, 4), and links (W, 4): a node, or ~(8 first + count).

    Fewer and independent steps make rays twice as fast. Wald, Benthin & Boulos 2008, "Getting rid of packets".
    """
    wide, joined = np.full((len(boxes), 6, 4), np.inf), np.full((len(boxes), 4), -1)
    wide[:, 3:] = -np.inf
    pending = np.empty(len(boxes), dtype=np.int64)
    pending[0] = 0
    done, used = 0, 1
    four = np.empty(4, dtype=np.int64)
    while done < used:
        four[0] = pending[done]
        count = 1
        while count < 4:  # open the inner node with the largest box
            widest, area = -1, -1.0
            for k in range(count):
                if links[four[k], 0] >= 0 and _area(boxes[four[k]]) > area:
                    widest, area = k, _area(boxes[four[k]])
            if widest < 0:
                break
            four[count] = links[four[widest], 1]
            four[widest] = links[four[widest], 0]
            count += 1
        for k in range(count):
            wide[done, :, k] = boxes[four[k]]
            first, number = links[four[k], 0], links[four[k], 1]
            if first >= 0:
                joined[done, k] = used
                pending[used] = four[k]
                used += 1
            else:
                joined[done, k] = ~(8 * ~first + number)
        done += 1
    return wide[:done].copy(), joined[:done].copy()
