"""Closed surfaces for pictures: lathes, tubes along a path, and plates cut from outlines.

Unlike `aerograsp_env.sim.objects.shapes`, which makes convex pieces for the physics, these are drawn only and may be
concave. Every function returns a watertight surface whose faces point outward, in metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import manifold3d
import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

ROUND = 24  # sides of what is round
CREASE = np.radians(38.0)  # [rad] between faces, beyond which their edge is drawn as one


class Solid(NamedTuple):
    """A closed surface."""

    vertices: Array  # (V, 3) [m]
    faces: NDArray[np.int32]  # (F, 3), outward by the right-hand rule

    def moved(self, translation: ArrayLike = (0.0, 0.0, 0.0), rotation: ArrayLike | None = None) -> Solid:
        """Turned about the origin by a rotation matrix (3, 3), then translated (3,) [m]."""
        turned = self.vertices if rotation is None else self.vertices @ np.asarray(rotation, dtype=np.float64).T
        return Solid(turned + np.asarray(translation, dtype=np.float64), self.faces)


def loft(rings: ArrayLike) -> Solid:
    """The skin over rings (R, S, 3) [m] of S corners each, its ends closed by fans around their middles."""
    points = np.asarray(rings, dtype=np.float64)
    count, sides = points.shape[:2]
    corner = np.arange(sides)
    following = (corner + 1) % sides
    low = (np.arange(count - 1) * sides)[:, None]
    a, b = (low + corner).ravel(), (low + following).ravel()
    skin = np.concatenate([np.stack([a, b, b + sides], axis=1), np.stack([a, b + sides, a + sides], axis=1)])
    first, last, end = count * sides, count * sides + 1, (count - 1) * sides
    caps = [
        np.stack([np.full(sides, first), following, corner], axis=1),
        np.stack([np.full(sides, last), end + corner, end + following], axis=1),
    ]
    vertices = np.concatenate([points.reshape(-1, 3), points[[0, -1]].mean(axis=1)])
    return outward(vertices, np.concatenate([skin, *caps]))


def lathe(profile: ArrayLike, axis: int = 0, sides: int = ROUND, lobes: int = 0, depth: float = 0.0) -> Solid:
    """A profile (P, 2) of position along the axis and radius, revolved about it.

    Args:
        axis: 0, 1 or 2 for x, y or z.
        lobes: flutes around the axis; each takes `depth` (a share) off the radius.
    """
    line = np.asarray(profile, dtype=np.float64)
    angles = np.arange(sides) * (2.0 * np.pi / sides)
    radius = np.maximum(line[:, 1:], 1e-5) * (1.0 - 0.5 * depth * (1.0 - np.cos(lobes * angles)))
    across = np.stack([radius * np.cos(angles), radius * np.sin(angles)], axis=-1)
    along = np.broadcast_to(line[:, :1], across.shape[:2])[..., None]
    points = np.concatenate([along, across], axis=-1)
    return loft(np.roll(points, axis, axis=-1))


def tube(path: ArrayLike, radii: ArrayLike, sides: int = 14, roundness: float = 1.0) -> Solid:
    """Ellipses drawn along a path in, or nearly in, the x-y plane.

    Args:
        path: (P, 3) [m].
        radii: (P, 2) [m] in the plane, and along z.
        roundness: exponent of the section as a superellipse: 1 an ellipse, 0.5 nearly a rectangle.
    """
    line, size = np.asarray(path, dtype=np.float64), np.asarray(radii, dtype=np.float64)
    along = np.gradient(line, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross((0.0, 0.0, 1.0), along)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    up = np.cross(along, across)
    angles = (np.arange(sides) + 0.5) * (2.0 * np.pi / sides)
    c, s = (np.sign(f(angles)) * np.abs(f(angles)) ** roundness for f in (np.cos, np.sin))
    ring = size[:, :1, None] * c[:, None] * across[:, None] + size[:, 1:, None] * s[:, None] * up[:, None]
    return loft(line[:, None] + ring)


def smooth_path(points: ArrayLike, count: int) -> Array:
    """`count` points (count, D) on a smooth curve through the given ones (P, D), evenly spread over their indices."""
    from scipy.interpolate import PchipInterpolator

    line = np.asarray(points, dtype=np.float64)
    return np.asarray(PchipInterpolator(np.arange(len(line)), line)(np.linspace(0.0, len(line) - 1.0, count)))


def box(size: Sequence[float], center: ArrayLike = (0.0, 0.0, 0.0)) -> Solid:
    """A box of side lengths `size` (3,) [m]."""
    x, y, z = 0.5 * np.asarray(size, dtype=np.float64)
    square = np.array([(-x, -y), (x, -y), (x, y), (-x, y)])
    rings = [np.column_stack([square, np.full(4, height)]) for height in (-z, z)]
    return loft(rings).moved(center)


# --- plates


def polygon(points: ArrayLike) -> manifold3d.CrossSection:
    """The outline (K, 2) [m] without self-crossings; either sense of rotation."""
    line = np.asarray(points, dtype=np.float64)
    x, y = line.T
    area = float(x @ np.roll(y, -1) - y @ np.roll(x, -1))
    return manifold3d.CrossSection([line if area > 0.0 else line[::-1]])


def ellipse(
    rx: float, ry: float, center: tuple[float, float] = (0.0, 0.0), sides: int = ROUND
) -> manifold3d.CrossSection:
    """An ellipse of semi-axes rx, ry [m]."""
    angles = np.arange(sides) * (2.0 * np.pi / sides)
    return polygon(np.stack([rx * np.cos(angles) + center[0], ry * np.sin(angles) + center[1]], axis=1))


def rectangle(x0: float, x1: float, y0: float, y1: float) -> manifold3d.CrossSection:
    """An axis-aligned rectangle [m]."""
    return polygon([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])


def plate(outline: manifold3d.CrossSection, thickness: float | ArrayLike, bevel: float = 0.0) -> manifold3d.Manifold:
    """An outline in x and y given a thickness along z, the middle at z = 0.

    Args:
        thickness: [m], or (P, 2) of x and the thickness there, linear between (and the same for every y).
        bevel: step [m] by which both faces are smaller than the middle.
    """
    table = np.atleast_2d(np.asarray(thickness, dtype=np.float64))
    if table.shape == (1, 1):
        table = np.array([(-10.0, table[0, 0]), (10.0, table[0, 0])])
    tallest = float(table[:, 1].max())
    body = outline.extrude(tallest).translate((0.0, 0.0, -0.5 * tallest))
    if np.ptp(table[:, 1]) > 0.0:
        ends = np.concatenate([[(-10.0, table[0, 1])], table, [(10.0, table[-1, 1])]])
        side = np.concatenate([ends * (1.0, 0.5), ends[::-1] * (1.0, -0.5)])
        # drawn along z, then stood up: (x, y, z) → (x, −z, y)
        wall = polygon(side).extrude(20.0).translate((0.0, 0.0, -10.0)).rotate((90.0, 0.0, 0.0))
        body = body ^ wall
    if bevel > 0.0:
        inner = outline.offset(-bevel, manifold3d.JoinType.Miter, 2.0, 0)
        if not inner.is_empty():
            flat = float(table[:, 1].min()) * 0.7
            core = inner.extrude(tallest * 2.0).translate((0.0, 0.0, -tallest))
            waist = outline.extrude(flat).translate((0.0, 0.0, -0.5 * flat))
            body = (body ^ core) + (body ^ waist)
    return body


def solid_of(body: manifold3d.Manifold) -> Solid:
    """The surface of a manifold, small facets merged.

    Raises:
        ValueError: an empty body.
    """
    if body.is_empty():
        raise ValueError("body: expected a solid, got an empty one")
    mesh = body.simplify(2e-5).to_mesh64()
    return outward(np.array(mesh.vert_properties[:, :3]), np.array(mesh.tri_verts, dtype=np.int32))


def manifold_of(solid: Solid) -> manifold3d.Manifold:
    """The solid as a manifold, for Boolean operations."""
    mesh = manifold3d.Mesh64(
        vert_properties=np.ascontiguousarray(solid.vertices), tri_verts=solid.faces.astype(np.uint64)
    )
    return manifold3d.Manifold(mesh)


def signed_volume(vertices: Array, faces: NDArray[np.integer]) -> float:
    """Volume [m³] of a closed surface, negative where its faces point inwards."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


class Shaded(NamedTuple):
    """A surface whose vertices are split along sharp edges: no longer watertight by its indices."""

    vertices: Array  # (V, 3) [m]
    faces: NDArray[np.int32]  # (F, 3), in the order of the closed surface's
    normals: Array  # (V, 3) unit


def shaded(vertices: Array, faces: NDArray[np.integer], crease: float = CREASE) -> Shaded:
    """A surface with normals for smooth shading that keeps edges.

    The normal of a face's corner is the mean, by area, of the normals of those faces around its vertex that make at
    most the angle `crease` [rad] with its own face.
    """
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    unit = cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-300)
    corner = faces.ravel()
    order = np.argsort(corner, kind="stable")  # corners by their vertex
    count = np.bincount(corner, minlength=len(vertices))
    start = np.cumsum(count) - count
    many = count[corner]
    mine = np.repeat(np.arange(len(corner)), many)  # each corner beside every corner at its vertex
    offset = np.arange(len(mine)) - np.repeat(np.cumsum(many) - many, many)
    other = order[start[corner[mine]] + offset] // 3
    near = np.einsum("ij,ij->i", unit[mine // 3], unit[other]) >= np.cos(crease) - 1e-9
    mine, other = mine[near], other[near]
    total = np.stack([np.bincount(mine, cross[other, k], len(corner)) for k in range(3)], axis=1)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    flat = np.repeat(unit, 3, axis=0)
    normals = np.where(length > 1e-12, total / np.maximum(length, 1e-300), flat)
    keys = np.column_stack([corner, np.round(normals * 1e3)]).astype(np.int64) @ (1 << 36, 1 << 24, 1 << 12, 1)
    _, first, index = np.unique(keys, return_index=True, return_inverse=True)
    return Shaded(vertices[corner[first]], index.reshape(-1, 3).astype(np.int32), normals[first])


def outward(vertices: Array, faces: NDArray[np.integer]) -> Solid:
    """A closed surface with its faces turned outward.

    Raises:
        ValueError: a surface without faces, or one that encloses nothing.
    """
    if len(faces) == 0:
        raise ValueError("faces: expected at least one face, got none")
    volume = signed_volume(vertices, faces)
    if abs(volume) < 1e-15:
        raise ValueError("faces: expected a surface that encloses a volume, got one that encloses none")
    turned = faces if volume > 0.0 else faces[:, ::-1]
    return Solid(np.ascontiguousarray(vertices, dtype=np.float64), np.ascontiguousarray(turned, dtype=np.int32))
