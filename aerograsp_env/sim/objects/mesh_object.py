"""Objects from meshes: any closed surface a user has, made of convex pieces that the physics can touch."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from aerograsp_env.sim.objects.build import SLIVER, build_object, is_watertight, mass_properties
from aerograsp_env.sim.objects.grasp_object import Convex, GraspObject
from aerograsp_env.sim.objects.shapes import Pieces, hull

Array = NDArray[np.float64]

GROWTH = 1e-5  # [m] so that pieces cut along a plane overlap there and join
LARGEST = 2.0  # [m] extent beyond which a mesh is taken to be in other units


class FromMesh(NamedTuple):
    """An object and how far its surface is from the mesh that it stands for."""

    object: GraspObject
    mean_error: float  # [m] of samples of either surface to the other one
    max_error: float  # [m]


def from_mesh(
    mesh: trimesh.Trimesh | str | Path,
    *,
    name: str | None = None,
    scale: float = 1.0,
    mass: float = 0.7,
    friction: float = 0.7,
    threshold: float = 0.05,
    seed: int = 0,
) -> FromMesh:
    """A mesh as an object of uniform density: the union of its approximate convex decomposition.

    The decomposition (Wei et al. 2022, "Approximate convex decomposition for 3D meshes with collision-aware concavity
    and tree search", ACM TOG 41(4)) takes seconds, and gives the same pieces again for the same seed. The union, not
    the mesh, is the object: it is what is rendered, touched and read by oracles alike.

    Args:
        mesh: metres once multiplied by `scale`.
        threshold: concavity, relative to the mesh's size, below which a piece counts as convex.

    Raises:
        ValueError: a mesh that is empty, not finite, open, inverted or too large to be in metres, or whose pieces do
            not make one solid.
        FileNotFoundError: no such file.
        ImportError: the decomposition's library, coacd, is not installed.
    """
    loaded, label = _load(mesh)
    surface = _checked(loaded, scale)
    pieces = _decompose(surface, threshold, seed)
    whole = build_object(name or label, "mesh", pieces, mass=mass, friction=friction)
    mean, largest = _distance(surface, trimesh.Trimesh(whole.vertices, whole.faces, process=False), seed)
    return FromMesh(whole, mean, largest)


def _load(mesh: trimesh.Trimesh | str | Path) -> tuple[trimesh.Trimesh, str]:
    if isinstance(mesh, trimesh.Trimesh):
        return mesh, "mesh"
    path = Path(mesh)
    if not path.is_file():
        raise FileNotFoundError(f"mesh: no file {path}")
    try:
        loaded: Any = trimesh.load(path, force="mesh", process=False)
    except Exception as error:  # readers of a dozen formats raise as many kinds
        raise ValueError(f"mesh: {path} cannot be read as a triangle mesh ({error})") from error
    return loaded, path.stem


def _checked(mesh: trimesh.Trimesh, scale: float) -> trimesh.Trimesh:
    """A scaled copy with equal vertices merged."""
    if not 0.0 < scale < np.inf:
        raise ValueError(f"scale: expected a positive factor, got {scale}")
    vertices, faces = np.asarray(getattr(mesh, "vertices", ())), np.asarray(getattr(mesh, "faces", ()))
    if len(vertices) == 0 or len(faces) == 0:
        raise ValueError(f"mesh: expected triangles, got {len(vertices)} vertices and {len(faces)} faces")
    if not np.isfinite(vertices).all():
        raise ValueError(f"mesh: {int((~np.isfinite(vertices)).any(axis=1).sum())} vertices are not finite")
    surface = trimesh.Trimesh(vertices * scale, faces, process=False)
    surface.merge_vertices(merge_tex=True, merge_norm=True)
    surface.update_faces(surface.nondegenerate_faces())
    extent = float(surface.extents.max())
    if extent > LARGEST:
        raise ValueError(
            f"mesh: {extent:.4g} m across, too large to grasp; if its units are millimetres, pass scale=0.001"
        )
    triangles = np.asarray(surface.faces, dtype=np.int32)
    if not is_watertight(triangles):
        lone = np.bincount(surface.edges_unique_inverse)
        raise ValueError(
            f"mesh: expected a closed, consistently wound surface, got {int((lone == 1).sum())} open edges and "
            f"{int((lone > 2).sum())} edges of more than two faces among {len(lone)}"
        )
    if surface.volume <= 0.0:
        raise ValueError(
            f"mesh: its faces point inwards (volume {surface.volume:.3g} m³); turn them with mesh.invert()"
        )
    return surface


def _decompose(surface: trimesh.Trimesh, threshold: float, seed: int) -> Pieces:
    try:
        import coacd
    except ImportError as error:
        raise ImportError("objects from meshes need the package coacd: pip install coacd") from error
    coacd.set_log_level("error")
    source = coacd.Mesh(np.asarray(surface.vertices), np.asarray(surface.faces, dtype=np.int32))
    parts = coacd.run_coacd(source, threshold=threshold, seed=seed)
    pieces = []
    for vertices, _ in parts:
        try:
            piece = hull(vertices)
        except ValueError:  # flat: nothing to touch
            continue
        if mass_properties(*piece).mass > SLIVER:
            pieces.append(_grown(piece))
    return tuple(pieces)


def _grown(piece: Convex) -> Convex:
    """The piece scaled about its centroid so that every face moves out by `GROWTH` at least."""
    center = mass_properties(*piece).center
    a, b, c = (piece.vertices[piece.faces[:, k]] - center for k in range(3))
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    sound = lengths > 1e-12  # [m²] slivers have no direction
    depth = float((np.einsum("ij,ij->i", normals, a)[sound] / lengths[sound]).min())
    return hull(center + (piece.vertices - center) * (1.0 + GROWTH / max(depth, 1e-4)))


def _distance(one: trimesh.Trimesh, other: trimesh.Trimesh, seed: int, samples: int = 1000) -> tuple[float, float]:
    """Mean and largest distance of samples of either surface to the other."""
    pairs = ((one, other), (other, one))
    both = np.concatenate([_to_surface(trimesh.sample.sample_surface(a, samples, seed=seed)[0], b) for a, b in pairs])
    return float(both.mean()), float(both.max())


def _to_surface(points: Array, mesh: trimesh.Trimesh) -> Array:
    """(N,) exact distances of points (N, 3) to a mesh.

    Its faces are cut to at most one size, so that those which can be nearest lie in a small ball around a point.
    """
    edge = float(mesh.extents.max()) / 30.0
    vertices, faces = trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, max_edge=edge)
    triangles = np.asarray(vertices[faces], dtype=np.float64)
    middles = triangles.mean(axis=1)
    tree = cKDTree(middles)
    # the nearest face is no farther than the nearest middle, and its own middle at most an edge farther than itself
    near = tree.query_ball_point(points, tree.query(points)[0] + edge)
    owner = np.repeat(np.arange(len(points)), [len(found) for found in near])
    closest = trimesh.triangles.closest_point(triangles[np.concatenate(near).astype(np.int64)], points[owner])
    distances = np.full(len(points), np.inf)
    np.minimum.at(distances, owner, np.linalg.norm(closest - points[owner], axis=1))
    return distances
