"""Grasps on a mesh: rays through the object, every fold that they cross, and what of it a parallel gripper can hold.

Ramon Soria 2018, section 2.3.2 (figures 2.19 and 2.20). A ray that crosses k folds of the object enters k times and
leaves k times; each way in and each later way out are a pair of opposed contacts, k(k + 1)/2 in all.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict
from typing import Any, Literal, get_args

import numpy as np

from aerograsp_env.sim.gripper import GripperConfig
from baselines.grasping.cache import GraspCache
from baselines.grasping.candidates import GraspCandidates, GraspSearch, Pairs, assemble, note
from baselines.grasping.clearance import mesh_collisions
from baselines.grasping.contacts import Array
from baselines.objects.mesh import MeshObject

VERSION = 1
"""Part of the cache's key: to be raised with every change that gives other grasps."""
RayPattern = Literal["straight", "oblique", "both"]


def as_mesh(mesh: Any) -> MeshObject:
    """A watertight `MeshObject` from one, from (vertices, faces), or from what has both (trimesh.Trimesh, GraspObject).

    Raises:
        ValueError: none of these, or a mesh that is open or has its faces turned inwards.
    """
    if not isinstance(mesh, MeshObject):
        if isinstance(mesh, (tuple, list)) and len(mesh) == 2:
            vertices, faces = mesh
        elif hasattr(mesh, "vertices") and hasattr(mesh, "faces"):
            vertices, faces = mesh.vertices, mesh.faces
        else:
            raise ValueError(f"mesh: expected a MeshObject, or vertices and faces, got {type(mesh).__name__}")
        mesh = MeshObject.from_arrays(vertices, faces, repair=False)
    if not mesh.watertight:
        raise ValueError(f"mesh: expected a watertight mesh, got one that is not ({'; '.join(mesh.report.faults)})")
    return mesh


def box_rays(lower: Array, upper: Array, n: int, pattern: RayPattern, rng: np.random.Generator) -> tuple[Array, Array]:
    """Origins and unit directions (n, 3) of rays that start outside the box and go through it.

    "straight" rays cross it parallel to its edges, evenly over the three axes; "oblique" ones go through a random point
    in it in a random direction; "both" is half of each.

    Raises:
        ValueError: n is not a whole number ≥ 1, or an unknown pattern.
    """
    if not isinstance(n, (int, np.integer)) or n < 1:
        raise ValueError(f"n_rays: expected a whole number ≥ 1, got {n!r}")
    if pattern not in get_args(RayPattern):
        raise ValueError(f"pattern: expected one of {get_args(RayPattern)}, got {pattern!r}")
    through = lower + (upper - lower) * rng.random((n, 3))
    directions = rng.standard_normal((n, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    straight = {"straight": n, "oblique": 0, "both": (n + 1) // 2}[pattern]
    directions[:straight] = np.eye(3)[np.arange(straight) % 3]
    return through - 1.01 * np.linalg.norm(upper - lower) * directions, directions


def opposed_pairs(mesh: MeshObject, origins: Array, directions: Array, inner: bool = True) -> tuple[Pairs, int]:
    """Every way in and later way out of rays (N, 3) that start outside, and how many folds they crossed in all.

    `inner=False` takes only where each ray first enters and last leaves. Surfaces inside of another part are passed
    over, and so is a ray that ends inside.
    """
    hits = mesh.ray_hits(origins, directions)
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    normals = mesh.face_normals[hits.faces]
    entering = np.einsum("hi,hi->h", normals, unit[hits.rays]) < 0.0
    turn = np.where(entering, 1, -1)
    total = np.cumsum(turn)
    ends = np.bincount(hits.rays, weights=turn, minlength=len(origins)).astype(np.int64)
    before = np.concatenate([[0], np.cumsum(ends)[:-1]])
    depth = total - before[hits.rays]
    wrong = np.zeros(len(origins), dtype=bool)
    wrong[hits.rays[depth < 0]] = True
    wrong |= ends != 0
    keep = ~wrong[hits.rays] & np.where(entering, depth == 1, depth == 0)
    rays, normals = hits.rays[keep], normals[keep]
    points = origins[rays] + hits.distances[keep][:, None] * unit[rays]
    folds = np.bincount(rays, minlength=len(origins)) // 2  # now way in and way out take turns
    first = np.concatenate([[0], np.cumsum(2 * folds)[:-1]])
    if inner:
        ways_in = np.arange(len(rays))[::2]
        outs = folds[rays[::2]] - (ways_in - first[rays[::2]]) // 2  # ways out that come after each way in
        i = np.repeat(ways_in, outs)
        j = i + 1 + 2 * (np.arange(len(i)) - np.repeat(np.cumsum(outs) - outs, outs))
    else:
        i = first[folds > 0]
        j = i + 2 * folds[folds > 0] - 1
    rows = np.stack([i, j], axis=1)
    return Pairs(points[rows], -normals[rows]), int(folds.sum())


def grasps_on_mesh(
    mesh: Any,
    gripper: GripperConfig | None = None,
    friction: float | None = None,
    n_rays: int = 1000,
    inner: bool = True,
    rng: np.random.Generator | int = 0,
    cache: GraspCache | None = None,
    *,
    pattern: RayPattern = "both",
    approaches: int = 8,
    clearance: float = 0.008,
) -> GraspCandidates:
    """Grasps of a parallel-jaw gripper on a watertight mesh, in the mesh's frame; scored by the friction to spare.

    The score is the friction angle less the larger angle between the closing line and the normals [rad]; equal ones are
    ordered by the distance of the closing line from the centre of mass. Contacts are exact. If the gripper has room is
    exact too, up to `clearance.TOLERANCE`, for flat boxes moving straight.

    Args:
        mesh: a `MeshObject`, a `trimesh.Trimesh`, a `GraspObject`, or (vertices, faces); metres.
        gripper: None is `GripperConfig()`.
        friction: Coulomb coefficient; None is the gripper's.
        n_rays: rays through the object's bounding box.
        inner: whether all folds that a ray crosses count; if not, only where it first enters and last leaves.
        rng: what draws the rays, or a seed; a seed is needed for the cache.
        cache: keeps the result on disk, by the content of mesh, gripper and parameters; None does not.
        pattern: rays parallel to the box's edges ("straight"), in any direction ("oblique"), or half and half ("both").
        approaches: approach axes tried for each pair of contacts.
        clearance: [m] wanted between each open pad and its contact; less, down to a quarter, where the room is narrow.

    Returns:
        Possibly none at all: `reasons` then says why ("too wide", "too thin", "outside cone", "no clearance", "palm
        collision"); `counts` has "rays", "folds" and "pairs".

    Raises:
        ValueError: a mesh that is open, inverted or not in metres, or another argument out of its range.
    """
    mesh = as_mesh(mesh)
    search = GraspSearch.of(gripper, friction, approaches, clearance)
    key = ""
    if cache is not None:
        if isinstance(rng, np.random.Generator):
            raise ValueError("rng: expected a seed with a cache, got a Generator, whose state cannot be part of a key")
        parameters = {**asdict(search), "n_rays": n_rays, "inner": bool(inner), "pattern": pattern, "seed": int(rng)}
        key = cache.key(f"grasps_on_mesh/{VERSION}", (mesh.vertices, mesh.faces), parameters)
        if (known := cache.load(key)) is not None:
            return known
    lower, upper = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    rays = box_rays(lower, upper, n_rays, pattern, np.random.default_rng(rng))
    reasons: Counter[str] = Counter()
    all_pairs, folds = opposed_pairs(mesh, *rays, inner)
    pairs, margin = search.eligible(all_pairs, reasons)
    placed = search.place(pairs, lambda *bodies: mesh_collisions(mesh, *bodies), reasons)
    if not folds:
        note(reasons, {"ray missed": n_rays})
    counts = {"rays": n_rays, "folds": folds, "pairs": len(all_pairs.positions)}
    found = assemble(pairs, placed, margin, reasons, counts, mesh.center_of_mass)
    if cache is not None:
        cache.store(key, found)
    return found
