"""Convex pieces from parameters: what procedural objects are put together from.

Every piece is a convex hull, its faces outward. Lengths are in metres; solids stand on nothing: they are centred on
the origin with their axis along z, unless the function says otherwise. Neighbours made by one function share their
faces exactly, so that their union has no seam.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import manifold3d
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from aerograsp_env.sim.objects.grasp_object import Convex

Array = NDArray[np.float64]
Pieces = tuple[Convex, ...]

SIDES = 24  # of whatever is round
GRID = 9  # decimals of a coordinate [m]: faces that touch then touch exactly, and their union has no slit


def hull(points: ArrayLike) -> Convex:
    """The convex hull of (N, 3) points [m].

    Raises:
        ValueError: points that are not (N, 3), not finite, or lie in one plane.
    """
    cloud = np.round(np.ascontiguousarray(points, dtype=np.float64), GRID)
    if cloud.ndim != 2 or cloud.shape[1] != 3 or not np.isfinite(cloud).all():
        raise ValueError(f"points: expected finite points (N, 3), got shape {cloud.shape}")
    solid = manifold3d.Manifold.hull_points(cloud)
    if len(cloud) < 4 or solid.is_empty() or solid.volume() <= 0.0:
        raise ValueError("points: expected points that span a volume, got a flat or empty set")
    mesh = solid.to_mesh64()
    return Convex(np.array(mesh.vert_properties[:, :3]), np.array(mesh.tri_verts, dtype=np.int32))


def moved(
    pieces: Convex | Iterable[Convex], translation: ArrayLike = (0.0, 0.0, 0.0), turn: ArrayLike = (0.0, 0.0, 0.0)
) -> Pieces:
    """Pieces turned about the origin by a rotation vector (3,) [rad], then translated (3,) [m]."""
    rotation = Rotation.from_rotvec(np.asarray(turn, dtype=np.float64)).as_matrix()
    parts = (pieces,) if isinstance(pieces, Convex) else pieces
    return tuple(hull(part.vertices @ rotation.T + np.asarray(translation)) for part in parts)


def box(size: Sequence[float], center: ArrayLike = (0.0, 0.0, 0.0)) -> Convex:
    """A box of side lengths `size` (3,)."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    return hull(corners * np.asarray(size) + np.asarray(center))


def prism(outline: ArrayLike, height: float) -> Convex:
    """The convex outline (K, 2) in x and y, drawn along z."""
    flat = np.asarray(outline, dtype=np.float64)
    return hull(np.concatenate([_lift(flat, -0.5 * height), _lift(flat, 0.5 * height)]))


def frustum(bottom: float, top: float, height: float, sides: int = SIDES) -> Convex:
    """A truncated cone by the radii of its ends; a radius of zero is a tip."""
    ring = circle(1.0, sides)
    return hull(np.concatenate([_lift(bottom * ring, -0.5 * height), _lift(top * ring, 0.5 * height)]))


def cylinder(radius: float, height: float, sides: int = SIDES) -> Convex:
    """A cylinder whose `sides` corners lie on the circle of `radius`."""
    return frustum(radius, radius, height, sides)


def ellipsoid(semi_axes: ArrayLike, roundness: tuple[float, float] = (1.0, 1.0), rings: int = 9) -> Convex:
    """A superellipsoid (Barr 1981, "Superquadrics and angle-preserving transformations", eq. 2.10).

    Args:
        roundness: exponents from pole to pole and around, in (0, 2]: 1 an ellipsoid, towards 0 a box, 2 an octahedron.

    Raises:
        ValueError: an exponent for which the shape is not convex.
    """
    if not all(0.0 < value <= 2.0 for value in roundness):
        raise ValueError(f"roundness: expected exponents in (0, 2], got {roundness}")
    latitude = np.linspace(-0.5 * np.pi, 0.5 * np.pi, rings + 2)[:, None]
    longitude = np.arange(12) * (np.pi / 6.0)
    around = _power(np.cos(latitude), roundness[0])
    x, y = around * _power(np.cos(longitude), roundness[1]), around * _power(np.sin(longitude), roundness[1])
    z = np.broadcast_to(_power(np.sin(latitude), roundness[0]), x.shape)
    return hull(np.stack([x, y, z], axis=-1).reshape(-1, 3) * np.asarray(semi_axes))


def capsule(radius: float, length: float) -> Convex:
    """A cylinder of `length` between two half balls."""
    angles = np.linspace(0.0, 0.5 * np.pi, 4)
    profile = [(radius * math.cos(a), 0.5 * length + radius * math.sin(a)) for a in angles]
    return lathe([*profile, *((r, -z) for r, z in profile)], sides=16)


def circle(radius: float, sides: int = SIDES) -> Array:
    """(sides, 2) the corners of a regular polygon."""
    angles = np.arange(sides) * (2.0 * np.pi / sides)
    return radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def lathe(profile: ArrayLike, sides: int = SIDES) -> Convex:
    """The convex solid of revolution about z of a profile (P, 2) of radius and height."""
    ring = circle(1.0, sides)
    return hull(np.concatenate([_lift(radius * ring, z) for radius, z in np.asarray(profile, dtype=np.float64)]))


def stack(profile: ArrayLike, sides: int = SIDES) -> Pieces:
    """One truncated cone for every step of a profile (P, 2) of radius and height, which may be concave."""
    points = np.asarray(profile, dtype=np.float64)
    return tuple(lathe(points[i : i + 2], sides) for i in range(len(points) - 1))


def sectors(outline: ArrayLike, count: int = 12) -> Pieces:
    """The convex outline (K, 2) of radius and height revolved about z, cut into `count` convex sectors.

    Chords stand for arcs inside as outside, so that a sector stays convex even where the outline is hollow.
    """
    points = np.asarray(outline, dtype=np.float64)
    spokes = circle(1.0, count)
    blades = [np.concatenate([points[:, :1] * spoke, points[:, 1:]], axis=1) for spoke in spokes]
    return tuple(hull(np.concatenate([blades[i - 1], blades[i]])) for i in range(count))


def shell(inner: ArrayLike, outer: ArrayLike, count: int = 12) -> Pieces:
    """A hollow of revolution between two profiles (P, 2) of radius and height: `sectors` of every step."""
    inside, outside = np.asarray(inner, dtype=np.float64), np.asarray(outer, dtype=np.float64)
    if inside.shape != outside.shape:
        raise ValueError(f"inner: expected as many points as outer, {len(outside)}, got {len(inside)}")
    cells = [np.concatenate([inside[i : i + 2], outside[i : i + 2]]) for i in range(len(inside) - 1)]
    return tuple(piece for cell in cells for piece in sectors(cell, count))


def sweep(path: ArrayLike, section: ArrayLike, closed: bool = False) -> Pieces:
    """A convex section (K, 2) drawn along a polyline (P, 3), mitred at its corners: one piece a segment.

    The section's first axis starts perpendicular to the path in the plane of its first corner. A closed path must be
    planar and its section symmetric about that plane, or the ends would not meet.
    """
    points = np.asarray(path, dtype=np.float64)
    corners = np.concatenate([points, points[:1]]) if closed else points
    along = np.diff(corners, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    before = np.concatenate([along[-1:] if closed else along[:1], along])
    after = np.concatenate([along, along[:1] if closed else along[-1:]])
    normals = before + after  # of the mitre planes
    frame = _section_frame(along)
    ring = points[0] + np.asarray(section, dtype=np.float64) @ frame
    rings = [_slide(ring, along[0], points[0], normals[0])]
    for i, direction in enumerate(along):
        rings.append(_slide(rings[-1], direction, corners[i + 1], normals[i + 1]))
    if closed:
        rings[-1] = rings[0]
    return tuple(hull(np.concatenate([rings[i], rings[i + 1]])) for i in range(len(along)))


def arc(radius: float, start: float, stop: float, count: int, center: Sequence[float] = (0.0, 0.0)) -> Array:
    """(count, 3) points on an arc in the x-z plane, from angle `start` to `stop` [rad], measured from x towards z."""
    angles = np.linspace(start, stop, count)
    return np.stack([center[0] + radius * np.cos(angles), np.zeros(count), center[1] + radius * np.sin(angles)], axis=1)


def _lift(flat: Array, z: float) -> Array:
    return np.column_stack([flat, np.full(len(flat), z)])


def _power(values: Array, exponent: float) -> Array:
    return np.sign(values) * np.abs(values) ** exponent


def _slide(ring: Array, direction: Array, point: Array, normal: Array) -> Array:
    """The ring moved along `direction` into the plane through `point`."""
    return ring + ((point - ring) @ normal / (direction @ normal))[:, None] * direction


def _section_frame(along: Array) -> Array:
    """(2, 3) axes of the section at the path's start: in the plane of the first corner, and across it."""
    for direction in along[1:]:
        across = np.cross(along[0], direction)
        if np.linalg.norm(across) > 1e-6:
            break
    else:
        across = np.cross(along[0], np.eye(3)[np.argmin(np.abs(along[0]))])
    across /= np.linalg.norm(across)
    return np.stack([np.cross(across, along[0]), across])
