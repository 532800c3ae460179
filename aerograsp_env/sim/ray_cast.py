"""Many rays from one point: what `mujoco.mj_multiRay` answers, about twice as fast, and whether points are in shadow.

Neighbouring rays are taken together: a cone around them leaves few geoms to look at, which are met from near to far, so
that most rays stop at the first or second. What a ray meets of a primitive is MuJoCo's own answer (mju_rayGeom and
mj_rayHfield, called through their C pointers); meshes are `aerograsp_env.sim.ray_mesh`'s. Left out: signed distance
fields, flexes, skins.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim.kernel_math import compiled
from aerograsp_env.sim.ray_calls import meet, ray_functions
from aerograsp_env.sim.ray_mesh import DEEPEST, Meshes, face_normal, meshes_of, ray_mesh

Array = NDArray[Any]

_BLOCK = 32  # rays taken together
_MARGIN = 1e-7  # [rad] on the cones, for rounding
_SHADOW_BIAS = 1e-5  # [m]
_PLANE, _HFIELD, _SPHERE, _CAPSULE, _ELLIPSOID, _CYLINDER, _BOX, _MESH = (
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{name}"))
    for name in ("PLANE", "HFIELD", "SPHERE", "CAPSULE", "ELLIPSOID", "CYLINDER", "BOX", "MESH")
)


class Shapes(NamedTuple):
    """What is cast at. Arrays are MuJoCo's own, not copies: they must outlive the cast."""

    functions: tuple[int, int]  # addresses of mju_rayGeom, mj_rayHfield
    pointers: tuple[int, int]  # addresses of model and data
    meshes: Meshes
    kind: NDArray[np.int32]  # (ngeom,)
    mesh: NDArray[np.int32]  # (ngeom,) which mesh a geom has
    size: NDArray[np.float64]  # (ngeom, 3)
    position: NDArray[np.float64]  # (ngeom, 3) world [m]
    rotation: NDArray[np.float64]  # (ngeom, 9)
    radius: NDArray[np.float64]  # (ngeom,) [m] of MuJoCo's bounding spheres, used for meshes and height fields
    seen: NDArray[np.bool_]  # (ngeom,) what rays do not pass through


class Hits(NamedTuple):
    """What each ray meets first."""

    geom: NDArray[np.int32]  # (N,), −1 for a miss
    distance: NDArray[np.float64]  # (N,) in lengths of the ray's direction; 0 for a miss
    normal: NDArray[np.float64]  # (N, 3) world, unit; (0, 3) if not asked for
    face: NDArray[np.int32]  # (N,) row of the model's mesh_face, −1 where no mesh was met


def shapes_of(
    model: mujoco.MjModel, data: mujoco.MjData, seen: NDArray[np.bool_], meshes: Meshes | None = None
) -> Shapes:
    """The geoms of a model as they stand now, of which rays meet those `seen` (ngeom,).

    meshes: what `ray_mesh.meshes_of` gave for this model before; they never change.
    """
    kind = model.geom_type
    return Shapes(
        *(
            ray_functions(),
            (model._address, data._address),
            meshes or meshes_of(model),
            kind,
            model.geom_dataid,
            model.geom_size,
        ),
        *(data.geom_xpos, data.geom_xmat, model.geom_rbound, seen & (kind <= _MESH)),
    )


def cast(shapes: Shapes, origin: Array, rays: Array, normals: bool = True) -> Hits:
    """Cast `rays` (N, 3), neighbours next to each other, from `origin` (3,)."""
    count = len(rays)
    geom, face = np.empty((2, count), np.int32)
    distance, normal = np.empty(count), np.empty((count if normals else 0, 3))
    _cast(shapes, origin, rays, geom, face, distance, normal)
    return Hits(geom, distance, normal, face)


def in_shadow(shapes: Shapes, source: Array, rays: Array, geom: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Whether anything stands between `source` (3,) and points at source + rays (N, 3) on surfaces of `geom` (N,).

    The surfaces must face the source: a convex geom then does not shadow itself, and is left out.
    """
    shadow = np.empty(len(rays), np.bool_)
    _shadows(shapes, source, rays, geom, shadow)
    return shadow


@compiled
def _addresses(shapes):
    """The `address` of `meet`."""
    count = len(shapes.kind)
    out = np.empty((count + 1, 4), np.int64)
    for g in range(count):
        out[g, 0] = shapes.kind[g]
        out[g, 1] = shapes.position.ctypes.data + 24 * g
        out[g, 2] = shapes.rotation.ctypes.data + 72 * g
        out[g, 3] = shapes.size.ctypes.data + 24 * g
    out[count, 0], out[count, 1] = shapes.pointers[0], shapes.pointers[1]
    return out


@compiled
def _bounds(shapes, origin):
    """What is around each geom, as seen from the origin (ngeom, 19).

    The offset of its bounding sphere (0–2), that one's length (3), the sphere's angular radius (4), nearest distance
    (5), squared length of a tangent to it (6; negative: the origin is inside). Of meshes also the rotation (7–15) and
    the origin in the mesh's frame (16–18).
    """
    count = len(shapes.kind)
    out = np.empty((count, 19))
    for g in range(count):
        kind, a, b, c = shapes.kind[g], shapes.size[g, 0], shapes.size[g, 1], shapes.size[g, 2]
        radius = shapes.radius[g]
        if kind == _PLANE:
            radius = np.inf
        elif kind == _SPHERE:
            radius = a
        elif kind == _CAPSULE:
            radius = a + b
        elif kind == _ELLIPSOID:
            radius = max(a, b, c)
        elif kind == _CYLINDER:
            radius = math.sqrt(a * a + b * b)
        elif kind == _BOX:
            radius = math.sqrt(a * a + b * b + c * c)
        square = 0.0
        for k in range(3):
            out[g, k] = shapes.position[g, k] - origin[k]
            square += out[g, k] ** 2
        length = math.sqrt(square)
        out[g, 3] = length
        out[g, 4] = math.asin(radius / length) if radius < length else math.pi
        out[g, 5] = max(length - radius, 0.0)
        out[g, 6] = square - radius * radius
        if kind == _MESH:
            for k in range(9):
                out[g, 7 + k] = shapes.rotation[g, k]
            for k in range(3):
                out[g, 16 + k] = 0.0
                for j in range(3):
                    out[g, 16 + k] -= shapes.rotation[g, 3 * j + k] * out[g, j]
    return out


@compiled
def _candidates(seen, bounds, rays, start, stop, chosen):
    """Geoms that rays start … stop − 1 may meet, nearest first, into `chosen`. Returns how many."""
    x = y = z = 0.0
    for i in range(start, stop):
        length = math.sqrt(rays[i, 0] ** 2 + rays[i, 1] ** 2 + rays[i, 2] ** 2)
        x, y, z = x + rays[i, 0] / length, y + rays[i, 1] / length, z + rays[i, 2] / length
    length = max(math.sqrt(x * x + y * y + z * z), 1e-300)
    x, y, z = x / length, y / length, z / length
    least = 1.0
    for i in range(start, stop):
        length = math.sqrt(rays[i, 0] ** 2 + rays[i, 1] ** 2 + rays[i, 2] ** 2)
        least = min(least, (x * rays[i, 0] + y * rays[i, 1] + z * rays[i, 2]) / length)
    spread = math.acos(max(least, -1.0)) + _MARGIN
    count = 0
    for g in range(len(seen)):
        if not seen[g]:
            continue
        limit = bounds[g, 4] + spread
        if limit < math.pi:
            along = x * bounds[g, 0] + y * bounds[g, 1] + z * bounds[g, 2]
            if along < math.cos(limit) * bounds[g, 3]:
                continue
        place = count
        while place > 0 and bounds[chosen[place - 1], 5] > bounds[g, 5]:
            chosen[place] = chosen[place - 1]
            place -= 1
        chosen[place] = g
        count += 1
    return count


@compiled
def _misses(bounds, g, x, y, z, square):
    """Whether a ray (x, y, z) of squared length `square` passes by the geom's bounding sphere."""
    if bounds[g, 6] <= 0.0:
        return False
    along = x * bounds[g, 0] + y * bounds[g, 1] + z * bounds[g, 2]
    return along <= 0.0 or along * along < square * bounds[g, 6] * (1.0 - 1e-12)


@compiled
def _meet_mesh(vertices, faces, box, child, leaf, begin, bounds, g, x, y, z, limit, any_hit, stack, reach):
    """Face and distance at which a ray (x, y, z) in the world meets mesh geom g before `limit`; (−1, limit) if not."""
    dx = bounds[g, 7] * x + bounds[g, 10] * y + bounds[g, 13] * z
    dy = bounds[g, 8] * x + bounds[g, 11] * y + bounds[g, 14] * z
    dz = bounds[g, 9] * x + bounds[g, 12] * y + bounds[g, 15] * z
    ox, oy, oz = bounds[g, 16], bounds[g, 17], bounds[g, 18]
    return ray_mesh(
        vertices, faces, box, child, leaf, begin, ox, oy, oz, dx, dy, dz, limit, any_hit, stack, reach
    )  # fmt: skip


@compiled
def _cast(shapes, origin, rays, geom, face, distance, normal):
    origin = np.ascontiguousarray(origin)
    bounds, address, functions = _bounds(shapes, origin), _addresses(shapes), shapes.functions
    mesh, start_of = shapes.mesh, shapes.meshes.start
    # Arrays by themselves: tuples of them, passed on for each ray, cost more than the work.
    v, f, box, child, leaf = (
        shapes.meshes.vertex, shapes.meshes.face, shapes.meshes.box, shapes.meshes.child, shapes.meshes.leaf
    )  # fmt: skip
    chosen, found = np.empty(len(shapes.kind), np.int64), np.empty(3)
    stack, reach = np.empty(DEEPEST, np.int64), np.empty(DEEPEST)
    to = found.ctypes.data if len(normal) else 0
    for start in range(0, len(rays), _BLOCK):
        stop = min(start + _BLOCK, len(rays))
        count = _candidates(shapes.seen, bounds, rays, start, stop, chosen)
        for i in range(start, stop):
            x, y, z = rays[i, 0], rays[i, 1], rays[i, 2]
            square = x * x + y * y + z * z
            length, best, which, side = math.sqrt(square), np.inf, -1, -1
            for j in range(count):
                g = chosen[j]
                if bounds[g, 5] >= best * length:
                    break
                if _misses(bounds, g, x, y, z, square):
                    continue
                if address[g, 0] == _MESH:
                    m = mesh[g]
                    begin = start_of[m, 0], start_of[m, 1], start_of[m, 2]
                    met, t = _meet_mesh(
                        v, f, box, child, leaf, begin, bounds, g, x, y, z, best, False, stack, reach
                    )  # fmt: skip
                    if met >= 0:
                        best, which, side = t, g, met
                    continue
                t = meet(functions, address, g, origin.ctypes.data, rays.ctypes.data + 24 * i, to)
                if 0.0 <= t < best:
                    best, which, side = t, g, -1
                    if len(normal):
                        normal[i, 0], normal[i, 1], normal[i, 2] = found[0], found[1], found[2]
            geom[i], face[i], distance[i] = which, side, best if which >= 0 else 0.0
            if side >= 0 and len(normal):
                a, b, c = face_normal(v, f, start_of[mesh[which], 0], side)
                for k in range(3):
                    p = 7 + 3 * k
                    normal[i, k] = bounds[which, p] * a + bounds[which, p + 1] * b + bounds[which, p + 2] * c


@compiled
def _shadows(shapes, source, rays, geom, shadow):
    source = np.ascontiguousarray(source)
    bounds, address, functions = _bounds(shapes, source), _addresses(shapes), shapes.functions
    mesh, start_of = shapes.mesh, shapes.meshes.start
    # Arrays by themselves: tuples of them, passed on for each ray, cost more than the work.
    v, f, box, child, leaf = (
        shapes.meshes.vertex, shapes.meshes.face, shapes.meshes.box, shapes.meshes.child, shapes.meshes.leaf
    )  # fmt: skip
    chosen = np.empty(len(shapes.kind), np.int64)
    stack, reach = np.empty(DEEPEST, np.int64), np.empty(DEEPEST)
    for start in range(0, len(rays), _BLOCK):
        stop = min(start + _BLOCK, len(rays))
        count = _candidates(shapes.seen, bounds, rays, start, stop, chosen)
        last = 0
        for i in range(start, stop):
            x, y, z = rays[i, 0], rays[i, 1], rays[i, 2]
            square = x * x + y * y + z * z
            length = math.sqrt(square)
            limit = 1.0 - _SHADOW_BIAS / length
            shadow[i] = False
            for j in range(-1, count):  # what stood before the last point probably stands before this one
                k = last if j < 0 else j
                if j == last or k >= count:
                    continue
                g = chosen[k]
                if bounds[g, 5] >= limit * length:
                    if j < 0:
                        continue
                    break
                if g == geom[i] and address[g, 0] not in (_MESH, _HFIELD):
                    continue
                if _misses(bounds, g, x, y, z, square):
                    continue
                if address[g, 0] == _MESH:
                    m = mesh[g]
                    begin = start_of[m, 0], start_of[m, 1], start_of[m, 2]
                    met, _ = _meet_mesh(
                        v, f, box, child, leaf, begin, bounds, g, x, y, z, limit, True, stack, reach
                    )  # fmt: skip
                    shadow[i] = met >= 0
                else:
                    t = meet(functions, address, g, source.ctypes.data, rays.ctypes.data + 24 * i, 0)
                    shadow[i] = 0.0 <= t < limit
                if shadow[i]:
                    last = k
                    break
