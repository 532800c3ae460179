"""A bounding volume hierarchy over triangles: every hit of a ray, closest points, and self-intersections.

Everything is float64 and compiled. Rays find all their hits in one traversal, and hits on shared edges and vertices are
neither lost nor doubled, because the ray is perturbed symbolically (see `_side`); casting again from behind each hit,
in float32, has neither property.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.objects.bvh_build import DEPTH, build, compiled, empty, grow, widen
from baselines.objects.triangles import closest_on_triangle, triangles_cross

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

PADDING = 1e-9
"""How far boxes are grown, as a fraction of the mesh's extent: more than rounding can move an edge."""


class BVH(NamedTuple):
    """Boxes and triangles, in the order of the tree."""

    boxes: Array  # (M, 6) lower and upper corner of each node
    links: Ints  # (M, 2) inner node: its two children; leaf: ~first triangle and count
    wide_boxes: Array  # (W, 6, 4) see `bvh_build.widen`
    wide_links: Ints  # (W, 4)
    corners: Array  # (F, 3, 3), in leaf order
    faces: Ints  # (F, 3) vertex indices, in leaf order
    order: Ints  # (F,) which of the given faces each one was

    @classmethod
    def build(cls, vertices: Array, faces: Ints) -> BVH:
        """From vertices (V, 3) and faces (F, 3); at least one face."""
        faces = np.ascontiguousarray(faces, dtype=np.int64)
        corners = np.ascontiguousarray(vertices, dtype=np.float64)[faces]
        lower, upper = corners.min(axis=1), corners.max(axis=1)
        boxes, links, order = build(lower, upper, 0.5 * (lower + upper))
        padding = PADDING * float((upper.max(axis=0) - lower.min(axis=0)).max())
        boxes[:, :3] -= padding
        boxes[:, 3:] += padding
        wide_boxes, wide_links = widen(boxes, links)
        return cls(boxes, links, wide_boxes, wide_links, corners[order], faces[order], order)

    def ray_hits(self, origins: Array, directions: Array) -> tuple[Ints, Array, Ints]:
        """Every hit: ray (H,), distance in lengths of the direction (H,) ≥ 0, and face (H,); by ray, then distance."""
        counts, distances, rows = _ray_hits(self.wide_boxes, self.wide_links, self.corners, origins, directions)
        return np.repeat(np.arange(len(origins)), counts), distances, self.order[rows]

    def closest(self, points: Array) -> tuple[Array, Ints]:
        """The closest point of the surface (N, 3), and its face (N,)."""
        found, rows = _closest(self.boxes, self.links, self.corners, points)
        return found, self.order[rows]

    def crossing_pairs(self, most: int) -> Ints:
        """(K ≤ most, 2) pairs of faces that pass through each other; see `triangles_cross` for what is not counted."""
        return self.order[_crossing_pairs(self.boxes, self.links, self.corners, self.faces, most)]


@compiled
def _side(cx, cy, bx, by):
    """Sign of the edge c → b about the ray, which sits at the origin of the sheared plane.

    Exactly opposite for b → c (no rounding breaks the symmetry), so two triangles at an edge never both hold the ray,
    nor both miss it. On the edge itself the ray is thought moved by (ε, ε²) for an infinitesimal ε > 0 (Edelsbrunner &
    Mücke 1990, "Simulation of simplicity"); 0 is left for edges that the projection makes a point.
    """
    value = cx * by - cy * bx
    if value != 0.0:
        return 1 if value > 0.0 else -1
    if by != cy:
        return 1 if cy > by else -1
    if bx != cx:
        return 1 if bx > cx else -1
    return 0


@compiled
def _crossing(p, row, okx, oky, okz, kx, ky, kz, sx, sy, sz):
    """Distance at which the ray crosses triangle p[row] (3, 3), or −1. Woop, Benthin & Wald 2013, "Watertight
    ray/triangle intersection": triangles are sheared into a frame where the ray runs along z."""
    az, bz, cz = p[row, 0, kz] - okz, p[row, 1, kz] - okz, p[row, 2, kz] - okz
    ax, ay = p[row, 0, kx] - okx - sx * az, p[row, 0, ky] - oky - sy * az
    bx, by = p[row, 1, kx] - okx - sx * bz, p[row, 1, ky] - oky - sy * bz
    cx, cy = p[row, 2, kx] - okx - sx * cz, p[row, 2, ky] - oky - sy * cz
    u, v, w = cx * by - cy * bx, ax * cy - ay * cx, bx * ay - by * ax
    if (u < 0.0 or v < 0.0 or w < 0.0) and (u > 0.0 or v > 0.0 or w > 0.0):
        return -1.0
    if u == 0.0 or v == 0.0 or w == 0.0:
        side = _side(cx, cy, bx, by)
        if side == 0 or side != _side(ax, ay, cx, cy) or side != _side(bx, by, ax, ay):
            return -1.0
    determinant = u + v + w
    if determinant == 0.0:  # an edge-on triangle in which only the perturbed ray lies: any of its points will do
        return sz * (az + bz + cz) / 3.0
    return sz * (u * az + v * bz + w * cz) / determinant


@compiled
def _ray_hits(boxes, links, corners, origins, directions):
    counts = np.zeros(len(origins), dtype=np.int64)
    distances, rows = np.empty(4 * len(origins) + 16), np.empty(4 * len(origins) + 16, dtype=np.int64)
    stack = np.empty(DEPTH, dtype=np.int64)
    total = 0
    for r in range(len(origins)):
        d = directions[r]
        kz = 0
        for k in range(1, 3):
            if abs(d[k]) > abs(d[kz]):
                kz = k
        kx, ky = (kz + 1) % 3, (kz + 2) % 3
        sx, sy, sz = d[kx] / d[kz], d[ky] / d[kz], 1.0 / d[kz]
        okx, oky, okz = origins[r, kx], origins[r, ky], origins[r, kz]
        ix = 1.0 / d[0] if abs(d[0]) > 1e-300 else 1e300
        iy = 1.0 / d[1] if abs(d[1]) > 1e-300 else 1e300
        iz = 1.0 / d[2] if abs(d[2]) > 1e-300 else 1e300
        ox, oy, oz = origins[r, 0], origins[r, 1], origins[r, 2]
        nx, ny, nz = (0 if ix > 0.0 else 3), (1 if iy > 0.0 else 4), (2 if iz > 0.0 else 5)
        start = total
        stack[0] = 0
        top = 1
        while top:
            top -= 1
            node = stack[top]
            if node >= 0:  # four boxes at once, without branches, which half the time would be mispredicted
                for k in range(4):
                    x0, x1 = (boxes[node, nx, k] - ox) * ix, (boxes[node, 3 - nx, k] - ox) * ix
                    y0, y1 = (boxes[node, ny, k] - oy) * iy, (boxes[node, 5 - ny, k] - oy) * iy
                    z0, z1 = (boxes[node, nz, k] - oz) * iz, (boxes[node, 7 - nz, k] - oz) * iz
                    stack[top] = links[node, k]
                    top += max(max(x0, y0), max(z0, 0.0)) <= min(min(x1, y1), z1)
                continue
            first, count = ~node >> 3, ~node & 7
            for row in range(first, first + count):
                t = _crossing(corners, row, okx, oky, okz, kx, ky, kz, sx, sy, sz)
                if t < 0.0:
                    continue
                if total == len(rows):
                    distances, rows = np.concatenate((distances, distances)), np.concatenate((rows, rows))
                i = total  # insertion into this ray's sorted hits
                while i > start and distances[i - 1] > t:
                    distances[i], rows[i] = distances[i - 1], rows[i - 1]
                    i -= 1
                distances[i], rows[i] = t, row
                total += 1
        counts[r] = total - start
    return counts, distances[:total].copy(), rows[:total].copy()


@compiled
def _box_distance2(box, p):
    """Squared distance of a point from a box."""
    total = 0.0
    for k in range(3):
        gap = max(box[k] - p[k], 0.0, p[k] - box[3 + k])
        total += gap * gap
    return total


@compiled
def _closest(boxes, links, corners, points):
    found, rows = np.empty((len(points), 3)), np.empty(len(points), dtype=np.int64)
    stack, bounds = np.empty(DEPTH, dtype=np.int64), np.empty(DEPTH)
    for n in range(len(points)):
        p = points[n]
        best = np.inf
        stack[0], bounds[0] = 0, _box_distance2(boxes[0], p)
        top = 1
        while top:
            top -= 1
            if bounds[top] >= best:
                continue
            first, count = links[stack[top]]
            if first >= 0:  # the nearer child is looked at first
                a, b = _box_distance2(boxes[first], p), _box_distance2(boxes[count], p)
                if a < b:
                    first, count, a, b = count, first, b, a
                stack[top], bounds[top], stack[top + 1], bounds[top + 1] = first, a, count, b
                top += 2
                continue
            for row in range(~first, ~first + count):
                x, y, z = closest_on_triangle(p, corners[row])
                gap = (x - p[0]) ** 2 + (y - p[1]) ** 2 + (z - p[2]) ** 2
                if gap < best:
                    best, rows[n] = gap, row
                    found[n, 0], found[n, 1], found[n, 2] = x, y, z
    return found, rows


@compiled
def _crossing_pairs(boxes, links, corners, faces, most):
    pairs = np.empty((most, 2), dtype=np.int64)
    stack = np.empty(DEPTH, dtype=np.int64)
    box = np.empty((1, 6))
    total = 0
    for i in range(len(corners)):
        empty(box)
        for k in range(3):
            grow(box[0], corners[i, k], corners[i, k])
        stack[0] = 0
        top = 1
        while top:
            top -= 1
            node = stack[top]
            if (boxes[node, :3] > box[0, 3:]).any() or (boxes[node, 3:] < box[0, :3]).any():
                continue
            first, count = links[node]
            if first >= 0:
                stack[top], stack[top + 1] = first, count
                top += 2
                continue
            for j in range(max(i + 1, ~first), ~first + count):
                if triangles_cross(corners[i], corners[j], faces[i], faces[j]):
                    if total == most:
                        return pairs
                    pairs[total] = i, j
                    total += 1
    return pairs[:total].copy()
