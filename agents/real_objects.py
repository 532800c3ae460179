"""Scanned and drawn objects of others: grasps on every mesh and cloud, and single views made whole again."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from agents.plan import reasons
from agents.plan_cloud import read_cloud
from agents.plan_settings import Settings
from agents.planning import CLOUDS, MESHES, holds_mesh, plan
from agents.real_pictures import picture
from agents.real_tables import Grasps, HalfCloud, Reconstruction, all_row, grasp_row, half_row, view_row
from agents.real_views import (
    NOISE,
    OPEN_SHARE,
    POINTS,
    PRIORS,
    Array,
    Distances,
    Prior,
    compare,
    off_surface,
    open_share,
    outer,
    reconstruct,
    view,
)
from agents.reproduction import DATA_VARIABLE, Reproduction, Request, data_folder, text_table
from baselines.objects.mesh import MeshObject
from baselines.objects.point_cloud import PointCloudObject

VIEWS = 20
SETS = ("meshes_*", "clouds_*")
LARGEST = 0.5  # [m] a cloud wider than that is a scene
APART = 1e-3  # [m] median distance at which a scan and its model count as aligned

# What the files do not say: the unit, or from where a cloud was seen.
TOLD: dict[str, dict[str, Any]] = {
    "hammer": {"scale": 0.0254},
    "valve_wheel": {"scale": 0.0254},
    **{name: {"viewpoint": (0.0, 0.1, 1.0)} for name in ("bun0", "bun01", "bun02", "bun03", "bun4", "bunny")},
    "krylon": {"all_round": True},  # its points lie evenly all round its axis
}
BUNNY, SCAN = "bun_zipper.ply", "bun0.pcd"  # the first scan of the Stanford bunny lies where the whole one does
BUNNY_SIZE = 5.0 / 3.0  # of the whole one's file, which has been made smaller,
BUNNY_TURN = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # turned, and moved:
BUNNY_LOWER = np.array([-0.0947, 0.0330, -0.0619])  # [m] lower corner of the original

NOTES = """\
Grasps: `aerograsp plan` as it comes ({gripper:.0f} mm jaws); "told" is what a file does not say and had to be told.
Single views: {views} of each mesh from random directions, {noise:g} mm noise along the rays, {points} points with
normals estimated from them, made whole by the planner's implicit surface about a fitted ellipsoid, or a constant.
Truth: the faces that can be seen from outside; meshes with more than {open:.0%} open edges are left out. Chamfer: mean
of both mean distances between true and found surface, with a 95 % bootstrap interval over views (last line: over
objects); size: the bounding box's diagonal. Far half: mean distance to the found surface from that half of the true
one which is farthest from the points seen: what was guessed. Views without a surface count as lost, and are left out.
Half clouds: the surface is fitted to a random half of a real cloud's points, and the distances to it of the other half
are averaged, {views} times; it says how well noise and gaps are bridged where something was seen, and nothing of what
was not."""


def files(folder: Path) -> list[Path]:
    """Every mesh and cloud in the sets within a folder, or in all of it where it holds none of the sets.

    Raises:
        FileNotFoundError: there is none; says how to name the folder.
    """
    roots = [root for pattern in SETS for root in sorted(folder.glob(pattern)) if root.is_dir()] or [folder]
    endings = (*MESHES, ".ply", *(e for e in CLOUDS if e != ".txt"))  # a .txt beside data says where it is from
    found = [path for root in roots for path in sorted(root.rglob("*")) if path.suffix.lower() in endings]
    if not found:
        raise FileNotFoundError(
            f"no meshes or clouds in {folder}: pass --data FOLDER, or set {DATA_VARIABLE} to the folder that holds "
            f"{' and '.join(SETS)}"
        )
    return found


# --- grasps -------------------------------------------------------------------------------------------------------


def grasps(path: Path, settings: Settings) -> list[Grasps]:
    """Grasps on one file or why there are none; once more with what it is `TOLD`, where it was refused without."""
    told = TOLD.get(path.stem, {})
    first = _grasps(path, settings, "")
    if not first.method and told:
        words = "seen from all round" if "all_round" in told else ", ".join(f"{k} {v}" for k, v in told.items())
        return [first, _grasps(path, replace(settings, **told), words)]
    return [first]


def _grasps(path: Path, settings: Settings, told: str) -> Grasps:
    name, nothing = "/".join(path.parts[-2:]), (np.nan, np.nan)
    try:
        found = plan(path, settings)
    except (ValueError, ImportError) as error:
        return Grasps(name, told, "", 0, nothing, " ".join(str(error).split()))
    if not len(found.grasps):
        why = "; ".join(reasons(found)) or "nothing was found to hold"
        return Grasps(name, told, found.method, 0, nothing, why)
    best = float(found.metrics["pfc"][0]), float(found.metrics["lmrw_sum"][0])
    return Grasps(name, told, found.method, found.found, best, "")


# --- reconstructions ----------------------------------------------------------------------------------------------


def solids(paths: list[Path]) -> Iterator[tuple[str, MeshObject]]:
    """The meshes that single views can be compared with: each object once, and not too open."""
    for path in paths:
        twin = path.suffix.lower() == ".dae" and path.with_suffix(".obj") in paths
        if twin or path.stem.startswith("collision") or not holds_mesh(path):
            continue
        try:
            mesh = MeshObject.from_file(path, TOLD.get(path.stem, {}).get("scale"))
        except (ValueError, ImportError):
            continue  # the table of grasps has the reason
        if open_share(mesh) <= OPEN_SHARE:
            yield (path.parent.name if path.stem.startswith("textured") else path.stem), mesh


def single_views(name: str, mesh: MeshObject, seed: int, views: int) -> Reconstruction:
    """Random views of a mesh, each made whole about every prior."""
    truth = outer(mesh)
    size = float(np.linalg.norm(mesh.extents))
    distances: dict[Prior, list[Distances]] = {prior: [] for prior in PRIORS}
    for k in range(views):
        seen = view(mesh, seed + k)
        for prior in PRIORS:
            distances[prior].append(compare(truth, reconstruct(*seen, prior), seen.points))
    return Reconstruction(name, size, distances)


def clouds(paths: list[Path]) -> Iterator[tuple[str, PointCloudObject, Array | None]]:
    """The clouds of one object, with normals, and from where each was seen."""
    for path in paths:
        if holds_mesh(path):
            continue
        try:
            cloud, eye = read_cloud(path, replace(Settings(), **TOLD.get(path.stem, {})))
        except ValueError:
            continue
        if cloud.extents.max() <= LARGEST:
            yield path.name, cloud, eye


def half_cloud(name: str, cloud: PointCloudObject, eye: Array | None, seed: int, splits: int) -> HalfCloud:
    """Fit to one half of a cloud, measure with the other."""
    assert cloud.normals is not None
    distances: dict[Prior, list[float]] = {prior: [] for prior in PRIORS}
    for k in range(splits):
        rows = np.random.default_rng(seed + k).permutation(len(cloud))
        fitted, held = np.array_split(rows, 2)
        for prior in PRIORS:
            found = reconstruct(cloud.points[fitted], cloud.normals[fitted], eye, prior)
            away = np.nan if found is None else float(off_surface(cloud.points[held], found).mean())
            distances[prior].append(away)
    return HalfCloud(name, len(cloud), distances)


def scanned_bunny(paths: list[Path]) -> tuple[float, dict[Prior, Distances]] | None:
    """The real first scan of the bunny made whole, against the whole one.

    Returns:
        Median distance of the scan's points to the whole [m], and the reconstructions' distances; None where a file is
        absent or they do not lie on one another.
    """
    by_name = {path.name: path for path in paths}
    if BUNNY not in by_name or SCAN not in by_name:
        return None
    raw = MeshObject.from_file(by_name[BUNNY])
    turned = BUNNY_SIZE * raw.vertices @ BUNNY_TURN.T
    whole = MeshObject.from_arrays(turned + BUNNY_LOWER - turned.min(axis=0), raw.faces, scale=1.0)
    cloud, eye = read_cloud(by_name[SCAN], replace(Settings(), **TOLD["bun0"]))
    assert cloud.normals is not None
    apart = float(np.median(off_surface(cloud.points, whole)))
    if apart > APART:
        return None
    found = {prior: reconstruct(cloud.points, cloud.normals, eye, prior) for prior in PRIORS}
    return apart, {prior: compare(whole, surface, cloud.points) for prior, surface in found.items()}


# --- what is said of them -----------------------------------------------------------------------------------------


def run(request: Request, settings: Settings | None = None) -> Reproduction:
    """Grasps on everything, single views of the meshes, halves of the clouds."""
    from tqdm import tqdm

    views = VIEWS if request.episodes is None else request.episodes
    settings = Settings(cache=False) if settings is None else settings
    paths = files(data_folder(request.data))
    hidden = {"disable": None, "leave": False}  # no bar where there is no terminal
    held = [row for path in tqdm(paths, "grasps", **hidden) for row in grasps(path, settings)]
    whole = list(solids(paths))
    seen = [single_views(name, mesh, request.seed, views) for name, mesh in tqdm(whole, "views", **hidden)]
    parts = tqdm(list(clouds(paths)), "clouds", **hidden)
    halves = [half_cloud(name, cloud, eye, request.seed, views) for name, cloud, eye in parts]
    bunny = scanned_bunny(paths)
    good = {row.name for row in held if row.found}
    text = text_table([["file", "told", "by", "grasps", "best PFC", "LMRW"], *map(grasp_row, held)], 3)
    text += f"\n{len(paths)} files: grasps on {len(good)}. Why not on the others, or not without being told:\n"
    text += "".join(f"  {row.name}: {row.reason}\n" for row in held if row.reason)
    if seen:
        head = ["single views", "size [mm]", "ellipsoid: Chamfer [mm]", "% of size", "far half", "lost"]
        head += ["constant: Chamfer [mm]", "far half", "lost", "ellipsoid − constant [mm]"]
        text += "\n" + text_table([head, *map(view_row, seen), all_row(seen)], 1) + "\n"
    if halves:
        head = ["half clouds", "points", *(f"{prior}: mean distance [mm] (range)" for prior in PRIORS)]
        text += "\n" + text_table([head, *map(half_row, halves)], 1) + "\n"
    if bunny is not None:
        text += f"\n{SCAN} against the whole bunny, which its points lie {1e3 * bunny[0]:.2f} mm (median) from: "
        text += "; ".join(
            f"{p} Chamfer {1e3 * d.chamfer:.1f} mm, far half {1e3 * d.far:.1f}" for p, d in bunny[1].items()
        )
        text += "\n"
    text += NOTES.format(
        gripper=1e3 * settings.gripper.max_width, views=views, noise=1e3 * NOISE, points=POINTS, open=OPEN_SHARE
    )
    data: dict[str, Any] = {
        "grasps": [row._asdict() for row in held],
        "views": [_as_data(row) for row in seen],
        "halves": [row._asdict() for row in halves],
    }
    if bunny is not None:
        data["bunny"] = {"apart": bunny[0], "distances": {prior: d._asdict() for prior, d in bunny[1].items()}}
    drawn = picture(whole, {row.name: row.distances for row in seen}, request.seed) if request.picture else None
    return Reproduction(text, data, drawn)


def _as_data(row: Reconstruction) -> dict[str, Any]:
    return row._asdict() | {"distances": {p: [d._asdict() for d in ds] for p, ds in row.distances.items()}}
