"""From a file to ranked grasps: a mesh as it is, a cloud through an implicit surface or by the points alone."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.plan_cloud import on_points, read_cloud
from agents.plan_page import Scene, Surface
from agents.plan_settings import METRICS, TIE, Array, Found, Say, Settings
from baselines.grasping import antipodal_probability, evaluate_candidates, grasps_on_mesh
from baselines.grasping.cache import GraspCache
from baselines.grasping.candidates import GraspCandidates
from baselines.objects.mesh import MeshObject
from baselines.objects.point_cloud import PointCloudObject

MESHES = (".obj", ".stl", ".off", ".glb", ".gltf", ".dae")
CLOUDS = (".pcd", ".npy", ".npz", ".xyz", ".txt")
SMALLER_IS_BETTER = frozenset({"closing_angle", "line_distance"})
SURFACE_SAMPLES = 6000  # points that stand for an open mesh
EVALUATED = 400  # grasps of which every metric is computed
NEAR_CENTER, NEAR_CLOSING = 0.012, np.cos(0.35)  # grasps closer in both hold the same; only their approach differs


class Plan(NamedTuple):
    """Ranked grasps with their metrics, and what to draw them on."""

    method: str  # "mesh", "gpis" or "cloud"
    grasps: GraspCandidates  # the best, ranked; `reasons` and `counts` are those of the whole search
    metrics: Mapping[str, Array]  # name → one value a grasp; see `METRICS`
    found: int  # grasps before alike ones were left out and the best taken
    scene: Scene
    notes: tuple[str, ...]


def plan(path: str | Path, settings: Settings | None = None, say: Say = lambda text: None) -> Plan:
    """Grasps on the object in a file, in the file's frame [m]; `say` is told what is being done.

    A mesh is searched by rays, an open one only as a cloud of points on it. A cloud is cleaned, given normals, and
    completed by a Gaussian-process implicit surface about a fitted prior ("gpis"); "cloud" takes the points alone.

    Raises:
        FileNotFoundError: no such file.
        ValueError: a file that cannot be read, is not in metres, is a scene rather than an object, or does not fit the
            method; a cloud without normals and without a place from which it can have been seen.
    """
    settings = Settings() if settings is None else settings
    path = Path(path)
    say(f"reading {path.name}")
    if holds_mesh(path):
        mesh = MeshObject.from_file(path, settings.scale)
        if settings.method == "mesh" or (settings.method == "auto" and mesh.watertight):
            found = _on_mesh(mesh, settings, say)
        else:
            notes = [*_mesh_notes(mesh), f"mesh: taken as {SURFACE_SAMPLES} points on it, seen from all round"]
            found = on_points(_sampled(mesh, settings.seed), None, settings, say, notes)
    elif settings.method == "mesh":
        raise ValueError(f"method: expected gpis or cloud for points without faces, got mesh for {path.name}")
    else:
        found = on_points(*read_cloud(path, settings), settings, say, [])
    return _ranked(found, settings, say)


def holds_mesh(path: Path) -> bool:
    """Whether a file is read as a mesh: by its ending, and a PLY by whether it has faces.

    Raises:
        FileNotFoundError: no such file.
        ValueError: an ending that is neither a mesh's nor a cloud's.
    """
    ending = path.suffix.lower()
    if ending not in (*MESHES, *CLOUDS, ".ply"):
        raise ValueError(f"object: expected a file of {' '.join((*MESHES, '.ply', *CLOUDS))}, got {path.name}")
    if not path.is_file():
        raise FileNotFoundError(f"object: no file {path}")
    if ending == ".ply":
        with path.open("rb") as file:
            lines = [line.split() for line in file.read(65536).split(b"end_header")[0].splitlines()]
        return any(words[:2] == [b"element", b"face"] and words[2:] != [b"0"] for words in lines)
    return ending in MESHES


# --- meshes -------------------------------------------------------------------------------------------------------


def _mesh_notes(mesh: MeshObject) -> list[str]:
    return [f"mesh: {fault}" for fault in (*mesh.report.faults, *mesh.report.repairs)]


def _on_mesh(mesh: MeshObject, settings: Settings, say: Say) -> Found:
    say(f"casting {settings.rays} rays through {len(mesh.faces)} faces")
    cache = GraspCache() if settings.cache else None
    grasps = grasps_on_mesh(mesh, settings.gripper, None, settings.rays, True, settings.seed, cache)
    center = mesh.center_of_mass
    return Found("mesh", grasps, center, Scene(Surface(mesh.vertices, mesh.faces), center=center), _mesh_notes(mesh))


def _sampled(mesh: MeshObject, seed: int) -> PointCloudObject:
    sample = mesh.sample(SURFACE_SAMPLES, np.random.default_rng(seed))
    return PointCloudObject(sample.points, sample.normals)


# --- ranking ------------------------------------------------------------------------------------------------------


def _ranked(found: Found, settings: Settings, say: Say) -> Plan:
    grasps, notes = found.grasps, list(found.notes)
    distinct = unlike(grasps, EVALUATED)
    chosen = grasps.take(distinct)
    say(f"evaluating {len(chosen)} of {len(grasps)} grasps")
    metrics = evaluate_candidates(chosen, found.center, settings.gripper.friction)
    if found.method == "gpis":
        metrics["pfc"] = np.array(chosen.score)
        notes.append("PFC: probability of force closure under the posterior of the implicit surface.")
    else:
        metrics["pfc"] = noisy_closure(chosen, settings)
        notes.append(
            f"PFC: probability of force closure if the surface is off by {1e3 * settings.noise:g} mm (one standard "
            "deviation), and its slope by that over the width of a pad."
        )
    signs = {name: -1.0 if name in SMALLER_IS_BETTER else 1.0 for name in (settings.rank, TIE)}
    first, tie = (signs[name] * metrics[name] for name in (settings.rank, TIE))
    order = np.lexsort((-tie, -first))[: settings.top]
    if len(chosen) < len(grasps):
        notes.append(f"{len(grasps)} grasps found; of alike ones the best is kept, and {len(chosen)} were evaluated.")
    return Plan(
        found.method,
        chosen.take(order),
        {name: metrics[name][order] for name in METRICS},
        len(grasps),
        found.scene,
        tuple(notes),
    )


def unlike(grasps: GraspCandidates, most: int) -> NDArray[np.int64]:
    """At most that many indices, in order, of grasps that no better one is alike to."""
    kept: list[int] = []
    left = np.arange(len(grasps))
    while len(left) and len(kept) < most:
        best = left[0]
        kept.append(int(best))
        near = np.linalg.norm(grasps.centers[left] - grasps.centers[best], axis=1) < NEAR_CENTER
        near &= np.abs(grasps.closing_axes[left] @ grasps.closing_axes[best]) > NEAR_CLOSING
        near[0] = True
        left = left[~near]
    return np.array(kept, dtype=np.int64)


def noisy_closure(grasps: GraspCandidates, settings: Settings, samples: int = 400) -> Array:
    """(G,) probability of force closure where contacts move along their normals, and normals tilt, at random."""
    if not len(grasps):
        return np.empty(0)
    rng = np.random.default_rng(settings.seed)
    shape = (samples, *grasps.positions.shape)
    positions = grasps.positions + settings.noise * rng.standard_normal((*shape[:-1], 1)) * grasps.normals
    normals = grasps.normals + settings.noise / settings.gripper.pad_width * rng.standard_normal(shape)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return antipodal_probability(positions, normals, settings.gripper.friction)[0]
