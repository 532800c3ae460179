"""From convex pieces and their densities to an object: the watertight union, and the mass properties of that solid."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import manifold3d
import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim.objects.grasp_object import Convex, Faces, GraspObject

Array = NDArray[np.float64]

CONCAVE = 0.7  # of its convex hull's volume at most
ELONGATED = 2.5  # times its second radius of gyration at least
OFF_BALANCE = 0.12  # of its longest side at least
SLIVER = 1e-12  # [m³] a volume that is rounding, not shape


class MassProperties(NamedTuple):
    """Of a solid of density one, or of a body."""

    mass: float  # [kg], or a volume [m³]
    center: Array  # (3,) [m] centre of mass
    inertia: Array  # (3, 3) [kg m²] about that centre


def mass_properties(vertices: Array, faces: Faces) -> MassProperties:
    """Volume, centroid and inertia at density one of a closed surface, exact for its triangles.

    Signed tetrahedra to one vertex of the surface (Mirtich 1996, "Fast and accurate computation of polyhedral mass
    properties", states the integrals).

    Raises:
        ValueError: a surface that encloses no positive volume.
    """
    origin = vertices[0]
    a, b, c = (vertices[faces[:, k]] - origin for k in range(3))
    six = np.einsum("ij,ij->i", a, np.cross(b, c))
    volume = six.sum() / 6.0
    if volume <= 0.0:
        raise ValueError(f"faces: expected an outward surface that encloses a volume, got {volume:.3g} m³")
    total = a + b + c
    center = (six @ total) / (24.0 * volume)
    second = np.einsum("i,ij,ik->jk", six, total, total)
    second = (second + sum(np.einsum("i,ij,ik->jk", six, edge, edge) for edge in (a, b, c))) / 120.0
    covariance = second - volume * np.outer(center, center)
    return MassProperties(float(volume), center + origin, np.trace(covariance) * np.eye(3) - covariance)


def combine(parts: Sequence[MassProperties]) -> MassProperties:
    """The body that rigidly joined parts make (parallel axes)."""
    mass = sum(part.mass for part in parts)
    center = sum((part.mass * part.center for part in parts), np.zeros(3)) / mass
    inertia = np.zeros((3, 3))
    for part in parts:
        offset = part.center - center
        inertia += part.inertia + part.mass * (offset @ offset * np.eye(3) - np.outer(offset, offset))
    return MassProperties(mass, center, inertia)


def build_object(
    name: str,
    family: str,
    pieces: Sequence[Convex],
    *,
    mass: float = 0.7,
    densities: Sequence[float] | None = None,
    friction: float = 0.7,
) -> GraspObject:
    """The object that convex pieces make.

    Where pieces overlap the material is that of the first of them, so mass, centre of mass and inertia are exactly
    those of a solid that could exist. Tags are measured, not claimed: see `measured_tags`.

    Args:
        mass: of the whole [kg]; it fixes the scale of the densities.
        densities: relative, one a piece; None for one density throughout.

    Raises:
        ValueError: densities that are not positive or not one a piece, or pieces whose union is not one watertight
            solid.
    """
    weights = np.ones(len(pieces)) if densities is None else np.asarray(densities, dtype=np.float64)
    if weights.shape != (len(pieces),) or not (np.isfinite(weights).all() and (weights > 0.0).all()):
        raise ValueError(f"densities: expected {len(pieces)} positive numbers, got {densities}")
    solids = [_solid(piece) for piece in pieces]
    union = _union(solids)
    vertices, faces = _surface(union)
    if not is_watertight(faces):
        raise ValueError("pieces: their union is not watertight")
    volume = mass_properties(vertices, faces)
    body = volume if np.ptp(weights) == 0.0 else combine(_layers(solids, weights))
    scale = mass / body.mass
    return GraspObject(
        name=name,
        family=family,
        pieces=tuple(pieces),
        vertices=vertices,
        faces=faces,
        mass=mass,
        center_of_mass=body.center,
        inertia=body.inertia * scale,
        friction=friction,
        tags=measured_tags(vertices, volume, body.center, union.hull().volume()),
    )


def is_watertight(faces: Faces) -> bool:
    """Whether every edge is walked once in each direction: closed, and consistently wound."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    stride = int(edges.max(initial=0)) + 1
    forth, back = edges @ (stride, 1), edges @ (1, stride)
    return len(edges) > 0 and len(np.unique(forth)) == len(forth) and np.array_equal(np.sort(forth), np.sort(back))


def measured_tags(vertices: Array, solid: MassProperties, center_of_mass: Array, hull_volume: float) -> frozenset[str]:
    """What is hard about a shape.

    concave: the solid fills at most `CONCAVE` of its convex hull. elongated: the longest radius of gyration is at least
    `ELONGATED` times the second. off-balance: the centre of mass lies at least `OFF_BALANCE` of the longest side away
    from the middle of the bounding box (along the solid's principal axes).
    """
    covariance = 0.5 * np.trace(solid.inertia) * np.eye(3) - solid.inertia
    moments, axes = np.linalg.eigh(covariance)
    along = (vertices - center_of_mass) @ axes
    low, high = along.min(axis=0), along.max(axis=0)
    tags = set()
    if solid.mass <= CONCAVE * hull_volume:
        tags.add("concave")
    if moments[2] >= ELONGATED**2 * moments[1]:
        tags.add("elongated")
    if np.linalg.norm(0.5 * (low + high)) >= OFF_BALANCE * (high - low).max():
        tags.add("off-balance")
    return frozenset(tags)


def _solid(piece: Convex) -> manifold3d.Manifold:
    return manifold3d.Manifold(manifold3d.Mesh64(piece.vertices, piece.faces.astype(np.uint64)))


def _union(solids: Sequence[manifold3d.Manifold]) -> manifold3d.Manifold:
    """The one solid that all make together, without the flat slivers that rounding leaves between shared faces."""
    whole = manifold3d.Manifold.batch_boolean(solids, manifold3d.OpType.Add)
    parts = [part for part in whole.decompose() if abs(part.volume()) > SLIVER]
    if len(parts) != 1:
        raise ValueError(f"pieces: expected one connected solid without cavities, got {len(parts)} surfaces")
    return parts[0]


def _surface(solid: manifold3d.Manifold) -> tuple[Array, Faces]:
    mesh = solid.to_mesh64()
    return np.array(mesh.vert_properties[:, :3]), np.array(mesh.tri_verts, dtype=np.int32)


def _layers(solids: Sequence[manifold3d.Manifold], weights: Array) -> list[MassProperties]:
    """What every solid adds to those before it, with its density."""
    parts = []
    taken = manifold3d.Manifold()
    for solid, density in zip(solids, weights, strict=True):
        rest = solid - taken
        taken = taken + solid
        if rest.is_empty() or rest.volume() < SLIVER:  # wholly inside the earlier ones
            continue
        volume, center, inertia = mass_properties(*_surface(rest))
        parts.append(MassProperties(density * volume, center, density * inertia))
    return parts
