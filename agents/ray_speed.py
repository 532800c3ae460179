"""What every hit of a ray costs, against Embree alone in the same run: part of `agents.speed_grasp`.

Embree alone is its first hit of each ray, cast again from behind it until nothing is left: float32 throughout, no
distances, no order, and no look at whether hits were lost. Both run in turns, warm, in one thread, and each figure is
the median over repeats.
"""

import time
from typing import NamedTuple

import numpy as np
import trimesh
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from baselines.objects import MeshObject

Array = NDArray[np.float64]
RAYS = 10_000
STEP = 1e-4  # [m] behind a hit, for Embree alone
TARGET = 1.5  # the largest ratio wanted


class Row(NamedTuple):
    """One comparison."""

    name: str
    seconds: float  # ours, median
    bound_seconds: float  # Embree alone, median
    ratio: float  # median of ours / bound over repeats
    odd: int  # our rays with an odd number of hits, from outside a watertight mesh
    bound_odd: int  # Embree's


def rays_towards(mesh: MeshObject, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Rays (count, 3) from a sphere around the mesh to points in its bounding box."""
    lower, upper = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    around = rng.normal(size=(count, 3))
    around *= 2.0 * np.linalg.norm(mesh.extents) / np.linalg.norm(around, axis=1, keepdims=True)
    origins = 0.5 * (lower + upper) + around
    directions = rng.uniform(lower, upper, (count, 3)) - origins
    return origins, directions / np.linalg.norm(directions, axis=1, keepdims=True)


def embree_hits(scene: EmbreeScene, origins: Array, directions: Array) -> NDArray[np.int64]:
    """The ray (H,) of each hit, by Embree alone."""
    p, d, rays = origins.astype(np.float32), directions.astype(np.float32), np.arange(len(origins))
    found = [rays[:0]]
    while len(rays):
        result = scene.run(p, d, output=True)
        hit = result["primID"] >= 0
        rays, d = rays[hit], d[hit]
        found.append(rays)
        p = p[hit] + (result["tfar"][hit] + np.float32(STEP))[:, None] * d
    return np.concatenate(found)


def _compare(name: str, shape: trimesh.Trimesh, rays: int, repeats: int, rng: np.random.Generator) -> Row:
    mesh = MeshObject.from_trimesh(shape)
    origins, directions = rays_towards(mesh, rays, rng)
    scene = EmbreeScene()
    TriangleMesh(scene, mesh.vertices.astype(np.float32), mesh.faces.astype(np.int32))
    seconds = np.zeros((repeats + 1, 2))
    for turn in range(repeats + 1):  # the first warms up
        start = time.perf_counter()
        ours = mesh.ray_hits(origins, directions).rays
        middle = time.perf_counter()
        bound = embree_hits(scene, origins, directions)
        seconds[turn] = middle - start, time.perf_counter() - middle
    a, b = seconds[1:].T
    odd, bound_odd = (int((np.bincount(x, minlength=rays) % 2).sum()) for x in (ours, bound))
    label = f"{rays} rays, {name} of {len(mesh.faces)} faces"
    return Row(label, float(np.median(a)), float(np.median(b)), float(np.median(a / b)), odd, bound_odd)


def measure(repeats: int = 9, rays: int = RAYS, seed: int = 0) -> list[Row]:
    """Measure everything: a row a mesh."""
    rng = np.random.default_rng(seed)
    return [
        _compare("ball", trimesh.creation.icosphere(5, 0.5), rays, repeats, rng),
        _compare("torus", trimesh.creation.torus(0.3, 0.1, 160, 64), rays, repeats, rng),
    ]
