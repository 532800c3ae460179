"""How far a task's wrenches can grow inside a grasp wrench space, by expanding a polytope only where it matters.

The wrench space W is a Minkowski sum of hulls, and listing its points costs (edges + 1)^contacts. Its support function
h_W(d) = max over W of d·w costs one pass over the primitives, though, and the largest k with k T inside W, for a convex
set of wrenches T, is min h_W(d) / h_T(d) over the facet normals d of W. So a simplex of points of W grows, facet by
facet, the facet with the smallest offset / h_T first, until the support function says that this facet is one of W's.
This is Zheng & Qian 2009, "Improving grasp quality evaluation", in the manner of van den Bergen's expanding polytope
(2001); the hull is kept as in Clarkson, Mehlhorn & Seidel 1993, with no merging: facets are simplices.

Everything compiled stands in this one file, because numba's cache on disk looks at a function's own file alone.
"""

import math
from heapq import heappop, heappush

import numpy as np
from numba import njit

compiled = njit(cache=True, nogil=True, error_model="numpy")

FOUND, ENOUGH, OPEN, FLAT, BROKEN = range(5)  # how an expansion ended
OFFSET = 6  # column of a facet's plane (7,), after its normal: normal · x <= offset
MAX_FACETS = 2_000_000  # half a gigabyte


@compiled
def support(blocks, starts, d, point):
    """max d·w over the sum of blocks (each the hull of zero and its rows); `point` becomes the w that attains it."""
    point[:] = 0.0
    total = 0.0
    for b in range(len(starts) - 1):
        best, row = 0.0, -1
        for j in range(starts[b], starts[b + 1]):
            value = 0.0
            for i in range(6):
                value += d[i] * blocks[j, i]
            if value > best:
                best, row = value, j
        if row >= 0:
            total += best
            for i in range(6):
                point[i] += blocks[row, i]
    return total


@compiled
def reach(means, axes, starts, d):
    """max d·w over the sum of terms, each the hull of its ellipsoids {mean + axes @ z: ‖z‖ <= 1}."""
    total = 0.0
    for b in range(len(starts) - 1):
        best = -math.inf
        for j in range(starts[b], starts[b + 1]):
            along, square = 0.0, 0.0
            for i in range(6):
                along += d[i] * means[j, i]
            for k in range(axes.shape[2]):
                value = 0.0
                for i in range(6):
                    value += d[i] * axes[j, i, k]
                square += value * value
            best = max(best, along + math.sqrt(square))
        total += best
    return total


@compiled
def _plane(points, vertices, inside, work, plane):
    """The plane through six points, `inside` below it; False where they do not span one.

    Elimination with full pivoting on the five edges; the null vector is the normal.
    """
    order = np.arange(6)
    largest = 0.0
    for r in range(5):
        for i in range(6):
            work[r, i] = points[vertices[r + 1], i] - points[vertices[0], i]
            largest = max(largest, abs(work[r, i]))
    for r in range(5):
        pivot, row, column = 0.0, r, r
        for a in range(r, 5):
            for b in range(r, 6):
                if abs(work[a, b]) > pivot:
                    pivot, row, column = abs(work[a, b]), a, b
        if pivot <= 1e-13 * largest:
            return False
        for i in range(6):
            work[r, i], work[row, i] = work[row, i], work[r, i]
        for a in range(5):
            work[a, r], work[a, column] = work[a, column], work[a, r]
        order[r], order[column] = order[column], order[r]
        for a in range(r + 1, 5):
            factor = work[a, r] / work[r, r]
            for b in range(r + 1, 6):
                work[a, b] -= factor * work[r, b]
    plane[order[5]] = 1.0
    square = 1.0
    for r in range(4, -1, -1):
        value = work[r, 5]
        for b in range(r + 1, 5):
            value += work[r, b] * plane[order[b]]
        plane[order[r]] = -value / work[r, r]
        square += plane[order[r]] ** 2
    length, offset, below = math.sqrt(square), 0.0, 0.0
    for i in range(6):
        plane[i] /= length
        below += plane[i] * inside[i]
        for r in range(6):
            offset += plane[i] * points[vertices[r], i] / 6.0
    sign = 1.0 if offset > below else -1.0
    for i in range(6):
        plane[i] *= sign
    plane[OFFSET] = sign * offset
    return True


@compiled
def _above(plane, point):
    """Distance of the point above the plane."""
    value = -plane[OFFSET]
    for i in range(6):
        value += plane[i] * point[i]
    return value


@compiled
def _grown(array):
    """The array with room for twice as many rows."""
    larger = np.empty((2 * array.shape[0], array.shape[1]), array.dtype)
    larger[: array.shape[0]] = array
    return larger


@compiled
def _rest(vector, basis, count):
    """What is left of the vector beyond the first orthonormal rows of the basis."""
    for _ in range(2):  # twice is enough
        for row in range(count):
            vector = vector - (vector @ basis[row]) * basis[row]
    return vector


@compiled
def _simplex(blocks, starts, size, flat):
    """Seven points of the set that span it, and whether it is thicker than `flat` · size in every direction."""
    points, basis, axes = np.zeros((7, 6)), np.zeros((6, 6)), np.eye(6)
    low, high = np.zeros(6), np.zeros(6)
    support(blocks, starts, np.ones(6), points[0])
    for k in range(6):
        direction = np.zeros(6)
        for axis in range(6):  # of what the basis leaves of the axes, the longest
            rest = _rest(axes[axis], basis, k)
            if rest @ rest > direction @ direction:
                direction = rest
        direction /= math.sqrt(direction @ direction)
        support(blocks, starts, direction, high)
        support(blocks, starts, -direction, low)
        up, down = direction @ (high - points[0]), direction @ (points[0] - low)
        if max(up, down) <= flat * size:
            return points, False
        points[k + 1] = high if up >= down else low
        rest = _rest(points[k + 1] - points[0], basis, k)
        basis[k] = rest / math.sqrt(rest @ rest)
    return points, True


@compiled
def _key(plane, closed, means, axes, terms):
    """What a facet allows: offset / reach; facets that do not yet show zero to be inside come first."""
    if plane[OFFSET] <= closed:
        return plane[OFFSET] - 1e100
    along = reach(means, axes, terms, plane)
    return plane[OFFSET] / along if along > 0.0 else math.inf


@compiled
def _see(point, seed, across, planes, mark, turn, tolerance, visible):
    """Collect the facets that the point is above, from one of them outward."""
    visible.clear()
    visible.append(seed)
    mark[seed, 0] = turn
    head = 0
    while head < len(visible):
        for n in across[visible[head]]:
            if mark[n, 0] != turn and _above(planes[n], point) > tolerance:
                mark[n, 0] = turn
                visible.append(n)
        head += 1


@compiled
def _connect(visible, first, corners, across, mark, turn, successor):
    """New facets meet where a walk around their common face, through what is visible, comes out again."""
    g = first
    for f in visible:
        for i in range(6):
            if mark[across[f, i], 0] == turn:
                continue
            for k in range(6):
                if k == i:
                    continue
                here, out, kept = f, k, corners[f, i]
                while mark[across[here, out], 0] == turn:
                    beyond, new = across[here, out], 0
                    for j in range(6):
                        if across[beyond, j] == here:
                            new = corners[beyond, j]
                    for j in range(6):
                        if corners[beyond, j] == kept:
                            out = j
                    here, kept = beyond, new
                across[g, k] = successor[here, out]
            g += 1


@compiled
def _convex(first, last, points, corners, across, planes, tolerance):
    """Whether no neighbour rises above the new facets: a hull that is convex at every ridge is convex."""
    for g in range(first, last):
        for n in across[g]:
            for j in range(6):
                if across[n, j] == g and _above(planes[g], points[corners[n, j]]) > tolerance:
                    return False
    return True


@compiled
def expand(blocks, starts, means, axes, terms, size, closed, tolerance, flat, enough):
    """The largest k with k T inside W; arguments are arrays as `support` and `reach` take them.

    `size` is the length of W's largest wrench. A ball about zero of radius `closed` or less counts as none, a W thinner
    than `flat` · size as flat; facets closer than `tolerance` are one. More than `enough` of k need not be found.

    Returns:
        (how it ended, k, the facet's unit normal (6,)); k is 0 when OPEN or FLAT, a lower bound when ENOUGH.
    """
    best, direction = math.inf, np.zeros(6)
    simplex, spans = _simplex(blocks, starts, size, flat)
    if not spans:
        return FLAT, 0.0, direction
    points = np.empty((256, 6))
    points[:7] = simplex
    inside = simplex.sum(axis=0) / 7.0
    corners = np.empty((1024, 6), np.int64)  # of each facet: its six points
    across = np.empty((1024, 6), np.int64)  # the facet beyond the ridge that leaves out corner i
    planes = np.empty((1024, 7))
    mark = np.zeros((1024, 1), np.int64)  # the last insertion that saw the facet; -1: it is gone
    successor = np.empty((1024, 6), np.int64)  # of a facet being removed: the new facet on a ridge of the horizon
    work = np.empty((5, 6))
    heap = [(0.0, 0)]
    heap.pop()
    for f in range(7):
        for i in range(6):
            corners[f, i] = across[f, i] = i if i < f else i + 1
        if not _plane(points, corners[f], inside, work, planes[f]):
            return BROKEN, 0.0, direction
        heappush(heap, (_key(planes[f], closed, means, axes, terms), f))
    facets, count, turn = 7, 7, 0
    visible = [0]
    while heap:
        key, seed = heappop(heap)
        if mark[seed, 0] < 0:
            continue
        if key >= best:
            break
        if key > enough:
            return ENOUGH, key, planes[seed, :6].copy()
        if count == len(points):
            points = _grown(points)
        height = support(blocks, starts, planes[seed, :6], points[count])
        if height <= closed + tolerance:
            return OPEN, 0.0, planes[seed, :6].copy()
        along = reach(means, axes, terms, planes[seed])
        if along > 0.0 and height / along < best:
            best, direction = height / along, planes[seed, :6].copy()
        if height - planes[seed, OFFSET] <= tolerance:
            break  # the facet is W's own, and every other one allows as much
        p, turn = count, turn + 1
        count += 1
        _see(points[p], seed, across, planes, mark, turn, tolerance, visible)
        first = facets
        for f in visible:
            for i in range(6):
                n = across[f, i]
                if mark[n, 0] == turn:
                    continue
                if facets == len(corners):
                    if facets > MAX_FACETS:
                        return BROKEN, 0.0, direction
                    corners, across, planes = _grown(corners), _grown(across), _grown(planes)
                    mark, successor = _grown(mark), _grown(successor)
                corners[facets] = corners[f]
                corners[facets, i] = p
                across[facets, i] = n
                for j in range(6):
                    if across[n, j] == f:
                        across[n, j] = facets
                mark[facets, 0] = 0
                successor[f, i] = facets
                facets += 1
        _connect(visible, first, corners, across, mark, turn, successor)
        for f in visible:
            mark[f, 0] = -1
        for g in range(first, facets):
            if not _plane(points, corners[g], inside, work, planes[g]):
                return BROKEN, 0.0, direction
            key = _key(planes[g], closed, means, axes, terms)
            if key < best:
                heappush(heap, (key, g))
        if not _convex(first, facets, points, corners, across, planes, 10.0 * tolerance):
            return BROKEN, 0.0, direction
    return FOUND, best, direction
