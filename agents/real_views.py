"""Single views of a mesh, what an implicit surface makes of them, and how far that is from the truth."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from baselines.grasping.planning import PlannerConfig, estimate_object
from baselines.objects import SurfaceError
from baselines.objects.mesh import MeshObject
from baselines.objects.point_cloud import PointCloudObject

Array = NDArray[np.float64]
Prior = Literal["ellipsoid", "constant"]
PRIORS: tuple[Prior, ...] = ("ellipsoid", "constant")

NOISE = 1.5e-3  # [m] standard deviation of a point along its viewing ray
POINTS = 512  # of a view
DISTANCE, CLEAR = 0.5, 2.5  # of the camera from the object's middle: [m], but at least so many radii
PIXELS = 72  # along an edge of the picture, which the object's ball fills
TRUTH_POINTS = 4000
CELLS = 24  # of a reconstruction along what was seen
MAX_CELLS = 60_000
ESCAPES = 48  # directions in which it is looked whether a face can be seen from outside
OPEN_SHARE = 0.05  # of a mesh's edges that may be without a second face


class View(NamedTuple):
    """What a camera sees from one side."""

    points: Array  # (N, 3) [m]
    normals: Array  # (N, 3) unit, towards the camera, estimated from the points
    eye: Array  # (3,) [m]


class Distances(NamedTuple):
    """How far a reconstruction is from the truth [m]; NaN where there is none."""

    chamfer: float  # mean of both mean distances, truth to reconstruction and back
    far: float  # mean distance to the reconstruction from that half of the truth which is farthest from what was seen


NONE = Distances(np.nan, np.nan)


def open_share(mesh: MeshObject) -> float:
    """Share of the edges that have only one face."""
    edges = np.sort(mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    return float((np.unique(edges, axis=0, return_counts=True)[1] == 1).mean())


def outer(mesh: MeshObject) -> MeshObject:
    """The faces that can be seen from outside: whose middle has a free way out in some direction.

    Drawn models hold walls and parts within that no camera sees.
    """
    middles = mesh.vertices[mesh.faces].mean(axis=1)
    golden = np.arange(ESCAPES) + 0.5
    z, turn = 1.0 - 2.0 * golden / ESCAPES, np.pi * (1.0 + np.sqrt(5.0)) * golden
    ways = np.column_stack([np.cos(turn) * np.sqrt(1.0 - z**2), np.sin(turn) * np.sqrt(1.0 - z**2), z])
    own = 1e-5 * float(mesh.extents.max())  # a ray's start lies on its own face
    seen = np.zeros(len(middles), dtype=bool)
    for way in ways:
        left = np.flatnonzero(~seen)
        if not len(left):
            break
        hits = mesh.ray_hits(middles[left], np.broadcast_to(way, (len(left), 3)))
        blocked = np.bincount(hits.rays, weights=hits.distances > own, minlength=len(left)) > 0
        seen[left[~blocked]] = True
    return MeshObject.from_arrays(mesh.vertices, mesh.faces[seen], scale=1.0)


def view(mesh: MeshObject, seed: int) -> View:
    """What a camera sees of a mesh from a random direction: the first hits of its rays, with noise along them.

    Raises:
        ValueError: nothing of it is seen.
    """
    rng = np.random.default_rng(seed)
    lower, upper = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    middle, radius = 0.5 * (lower + upper), 0.5 * float(np.linalg.norm(upper - lower))
    back = rng.standard_normal(3)
    back /= np.linalg.norm(back)
    distance = max(DISTANCE, CLEAR * radius)
    eye = middle + distance * back
    right = np.cross(back, np.eye(3)[np.abs(back).argmin()])
    right /= np.linalg.norm(right)
    slope = radius / np.sqrt(distance**2 - radius**2) * np.linspace(-1.0, 1.0, PIXELS)
    across, up = (a.ravel()[:, None] for a in np.meshgrid(slope, slope))
    rays = across * right + up * np.cross(back, right) - back
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    hits = mesh.ray_hits(np.broadcast_to(eye, rays.shape), rays)
    pixels, first = np.unique(hits.rays, return_index=True)  # hits of a ray come in order of distance
    if len(pixels) < 8:
        raise ValueError(f"mesh: expected one that can be seen, got {len(pixels)} hits of {len(rays)} rays")
    depth = hits.distances[first] + NOISE * rng.standard_normal(len(pixels))
    cloud = PointCloudObject(eye + depth[:, None] * rays[pixels], viewpoint=eye)
    if len(cloud) > POINTS:
        cloud = cloud.select(rng.choice(len(cloud), POINTS, replace=False))
    cloud = cloud.estimate_normals(min(20, len(cloud) - 1))
    assert cloud.normals is not None
    return View(cloud.points, cloud.normals, eye)


def reconstruct(points: Array, normals: Array, eye: Any, prior: Prior, noise: float = NOISE) -> trimesh.Trimesh | None:
    """The surface that the planner's model takes the object to have; None where it has no end or is nowhere.

    Args:
        points, normals: (N, 3) [m], and unit outward.
        eye: (3,) [m] from where they were seen; None for points from all round.
        prior: of the planner's.
        noise: standard deviation of the points [m].
    """
    config = PlannerConfig(prior=prior)
    model = estimate_object(points, normals, np.full(len(points), noise), eye, config).model
    try:
        return model.surface(float(np.ptp(points, axis=0).max()) / CELLS, max_cells=MAX_CELLS)
    except SurfaceError:
        return None


def off_surface(points: Array, surface: trimesh.Trimesh | MeshObject) -> Array:
    """(N,) [m] distance of each of points (N, 3) to a surface."""
    if isinstance(surface, trimesh.Trimesh):
        surface = MeshObject.from_arrays(surface.vertices, surface.faces, scale=1.0)
    return np.linalg.norm(surface.closest(points)[0] - points, axis=1)


def compare(truth: MeshObject, found: trimesh.Trimesh | None, seen: Array, seed: int = 0) -> Distances:
    """Distances of a reconstruction from the truth's surface, of which the points `seen` (N, 3) were known."""
    if found is None:
        return NONE
    rng = np.random.default_rng(seed)
    surface = MeshObject.from_arrays(found.vertices, found.faces, scale=1.0)
    points = truth.sample(TRUTH_POINTS, rng).points
    hidden = cKDTree(seen).query(points)[0]
    to_found = off_surface(points, surface)
    back = off_surface(surface.sample(TRUTH_POINTS, rng).points, truth)
    return Distances(0.5 * float(to_found.mean() + back.mean()), float(to_found[hidden > np.median(hidden)].mean()))
