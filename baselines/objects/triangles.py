"""Two triangles, and a point and a triangle: the leaves of a bounding volume hierarchy."""

from __future__ import annotations

from numba import njit

compiled = njit(cache=True, nogil=True, error_model="numpy")


@compiled
def closest_on_triangle(p, t):
    """(x, y, z) of the point of triangle t (3, 3) closest to p (3,). Ericson 2005, "Real-time collision detection",
    section 5.1.5. A degenerate triangle gives one of its edges' or corners' points."""
    abx, aby, abz = t[1, 0] - t[0, 0], t[1, 1] - t[0, 1], t[1, 2] - t[0, 2]
    acx, acy, acz = t[2, 0] - t[0, 0], t[2, 1] - t[0, 1], t[2, 2] - t[0, 2]
    apx, apy, apz = p[0] - t[0, 0], p[1] - t[0, 1], p[2] - t[0, 2]
    d1, d2 = abx * apx + aby * apy + abz * apz, acx * apx + acy * apy + acz * apz
    if d1 <= 0.0 and d2 <= 0.0:
        return t[0, 0], t[0, 1], t[0, 2]
    bpx, bpy, bpz = p[0] - t[1, 0], p[1] - t[1, 1], p[2] - t[1, 2]
    d3, d4 = abx * bpx + aby * bpy + abz * bpz, acx * bpx + acy * bpy + acz * bpz
    if d3 >= 0.0 and d4 <= d3:
        return t[1, 0], t[1, 1], t[1, 2]
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v, w = d1 / (d1 - d3), 0.0
        return t[0, 0] + v * abx, t[0, 1] + v * aby, t[0, 2] + v * abz
    cpx, cpy, cpz = p[0] - t[2, 0], p[1] - t[2, 1], p[2] - t[2, 2]
    d5, d6 = abx * cpx + aby * cpy + abz * cpz, acx * cpx + acy * cpy + acz * cpz
    if d6 >= 0.0 and d5 <= d6:
        return t[2, 0], t[2, 1], t[2, 2]
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        w = d2 / (d2 - d6)
        return t[0, 0] + w * acx, t[0, 1] + w * acy, t[0, 2] + w * acz
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return t[1, 0] + w * (acx - abx), t[1, 1] + w * (acy - aby), t[1, 2] + w * (acz - abz)
    total = va + vb + vc
    v, w = vb / total, vc / total
    return t[0, 0] + v * abx + w * acx, t[0, 1] + v * aby + w * acy, t[0, 2] + v * abz + w * acz


@compiled
def _volume(a, b, c, d):
    """Six times the signed volume of the tetrahedron abcd."""
    bx, by, bz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    cx, cy, cz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    dx, dy, dz = d[0] - a[0], d[1] - a[1], d[2] - a[2]
    return bx * (cy * dz - cz * dy) + by * (cz * dx - cx * dz) + bz * (cx * dy - cy * dx)


@compiled
def _pierces(p, q, t, tolerance):
    """Whether segment pq passes through the inside of triangle t."""
    above, below = _volume(t[0], t[1], t[2], p), _volume(t[0], t[1], t[2], q)
    if not ((above > tolerance and below < -tolerance) or (above < -tolerance and below > tolerance)):
        return False
    a, b, c = _volume(p, q, t[0], t[1]), _volume(p, q, t[1], t[2]), _volume(p, q, t[2], t[0])
    return (a > tolerance and b > tolerance and c > tolerance) or (a < -tolerance and b < -tolerance and c < -tolerance)


@compiled
def triangles_cross(s, t, s_ids, t_ids):
    """Whether an edge of one triangle pierces the inside of the other, corners that both share left out.

    Touching, and overlapping in one plane, do not count: nearly every assembled mesh has such faces.
    """
    size = 0.0
    for k in range(3):
        low = min(s[0, k], s[1, k], s[2, k], t[0, k], t[1, k], t[2, k])
        high = max(s[0, k], s[1, k], s[2, k], t[0, k], t[1, k], t[2, k])
        size = max(size, high - low)
    tolerance = 1e-12 * size**3
    for i in range(3):
        j = (i + 1) % 3
        alone = s_ids[i] not in (t_ids[0], t_ids[1], t_ids[2]) and s_ids[j] not in (t_ids[0], t_ids[1], t_ids[2])
        if alone and _pierces(s[i], s[j], t, tolerance):
            return True
        alone = t_ids[i] not in (s_ids[0], s_ids[1], s_ids[2]) and t_ids[j] not in (s_ids[0], s_ids[1], s_ids[2])
        if alone and _pierces(t[i], t[j], s, tolerance):
            return True
    return False
