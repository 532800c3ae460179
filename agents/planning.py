"""From a file to ranked grasps: a mesh as it is, a cloud through an implicit surface or by the points alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, NamedTuple, get_args

import numpy as np
import trimesh
from numpy.typing import NDArray

from aerograsp_env.sim.gripper import GripperConfig
from agents.plan_page import Scene, Surface
from baselines.grasping import antipodal_probability
from baselines.grasping.cache import GraspCache
from baselines.grasping.candidate_metrics import evaluate_candidates
from baselines.grasping.candidates import GraspCandidates
from baselines.grasping.on_cloud import grasps_on_cloud
from baselines.grasping.on_gpis import grasps_on_gpis
from baselines.grasping.on_mesh import grasps_on_mesh
from baselines.objects import GPIS, Constant, Matern52, Prior, SurfaceError
from baselines.objects.mesh import MeshObject
from baselines.objects.point_cloud import PointCloudObject
from baselines.objects.prior_fit import PriorFit, fit_cylinder, fit_ellipsoid, fit_plane
from baselines.objects.surface import mesh as surface_mesh
from baselines.objects.surface import walk

Array = NDArray[np.float64]
Method = Literal["auto", "mesh", "gpis", "cloud"]
PriorName = Literal["ellipsoid", "cylinder", "plane", "constant"]
Say = Callable[[str], None]

MESHES = (".obj", ".stl", ".off", ".glb", ".gltf", ".dae")
CLOUDS = (".pcd", ".npy", ".npz", ".xyz", ".txt")
SMALLER_IS_BETTER = frozenset({"closing_angle", "line_distance"})
METRICS = (
    *("pfc", "lmrw_sum", "lmrw_independent", "closing_angle", "line_distance", "force_closure"),
    *("q_min", "q_volume", "q_isotropy", "wrench_volume", "antipodal_margin"),
)
RANK, TIE = "pfc", "lmrw_sum"

SURFACE_SAMPLES = 6000  # points that stand for an open mesh
LEARNING_POINTS = 90  # on which the process' length scale and deviation are chosen
CELLS = 28  # of the drawn surfaces, along the object
MAX_CELLS = 15_000
FLATTEST = 0.1  # slope of the mean, 1 on a clear surface, below which its standard deviation is not blown up further
COARSE = 0.25  # of the jaws' opening: points farther apart than this do not show what is between the jaws
EVALUATED = 400  # grasps of which every metric is computed
NEAR_CENTER, NEAR_CLOSING = 0.012, np.cos(0.35)  # grasps closer in both hold the same; only their approach differs
NEAREST_VIEW = 0.1  # [m] depth sensors see nothing nearer: a closer viewpoint is the origin of some other frame


@dataclass(frozen=True)
class Settings:
    """What a plan depends on, beside the file."""

    method: Method = "auto"
    prior: PriorName = "ellipsoid"
    rank: str = RANK
    top: int = 10
    seed: int = 0
    gripper: GripperConfig = field(default_factory=GripperConfig)
    noise: float = 0.001  # [m] standard deviation of the surface, for the probability on meshes and clouds
    scale: float | None = None  # metres per unit of the file
    viewpoint: tuple[float, float, float] | None = None  # [m] where a cloud was seen from
    all_round: bool = False  # whether a cloud was seen from all round, its normals to be turned away from its middle
    crop: tuple[float, ...] | None = None  # [m] lower and upper corner
    points: int = 300  # that a cloud is thinned to for its implicit surface
    rays: int = 2000  # through a mesh or cloud
    cache: bool = True

    def __post_init__(self) -> None:
        for name, names in (("method", get_args(Method)), ("prior", get_args(PriorName)), ("rank", METRICS)):
            if getattr(self, name) not in names:
                raise ValueError(f"{name}: expected one of {', '.join(names)}, got {getattr(self, name)!r}")
        if self.all_round and self.viewpoint is not None:
            raise ValueError("viewpoint: expected none for a cloud that was seen from all round")
        if not 0.0 <= self.noise < np.inf:
            raise ValueError(f"noise: expected a standard deviation ≥ 0 [m], got {self.noise}")
        for name in ("top", "points", "rays"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name}: expected at least 1, got {getattr(self, name)}")


class Plan(NamedTuple):
    """Ranked grasps with their metrics, and what to draw them on."""

    method: str  # "mesh", "gpis" or "cloud"
    grasps: GraspCandidates  # the best, ranked; `reasons` and `counts` are those of the whole search
    metrics: Mapping[str, Array]  # name → one value a grasp; see `METRICS`
    found: int  # grasps before alike ones were left out and the best taken
    scene: Scene
    notes: tuple[str, ...]


class _Found(NamedTuple):
    method: str
    grasps: GraspCandidates
    center: Array
    scene: Scene
    notes: list[str]


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
            found = _on_points(_sampled(mesh, settings.seed), None, settings, say, notes)
    elif settings.method == "mesh":
        raise ValueError(f"method: expected gpis or cloud for points without faces, got mesh for {path.name}")
    else:
        found = _on_points(*_read_cloud(path, settings), settings, say, [])
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


def _on_mesh(mesh: MeshObject, settings: Settings, say: Say) -> _Found:
    say(f"casting {settings.rays} rays through {len(mesh.faces)} faces")
    cache = GraspCache() if settings.cache else None
    grasps = grasps_on_mesh(mesh, settings.gripper, None, settings.rays, True, settings.seed, cache)
    center = mesh.center_of_mass
    return _Found("mesh", grasps, center, Scene(Surface(mesh.vertices, mesh.faces), center=center), _mesh_notes(mesh))


def _sampled(mesh: MeshObject, seed: int) -> PointCloudObject:
    sample = mesh.sample(SURFACE_SAMPLES, np.random.default_rng(seed))
    return PointCloudObject(sample.points, sample.normals)


# --- clouds -------------------------------------------------------------------------------------------------------


def _read_cloud(path: Path, settings: Settings) -> tuple[PointCloudObject, Array | None]:
    """The cloud, cleaned and with normals, and where it was seen from, if that is known."""
    cloud = PointCloudObject.from_file(path, settings.scale)
    if settings.crop is not None:
        cloud = cloud.crop(settings.crop[:3], settings.crop[3:])
    if len(cloud) > 20:
        cloud = cloud.remove_outliers(min(20, len(cloud) - 1))
    if settings.all_round:
        middle = 0.5 * (cloud.points.min(axis=0) + cloud.points.max(axis=0))
        cloud = replace(cloud, normals=None, viewpoint=middle).estimate_normals()
        assert cloud.normals is not None
        return replace(cloud, normals=-cloud.normals), None
    if settings.viewpoint is not None:
        view = np.array(settings.viewpoint)
        if cloud.normals is not None:
            facing = np.einsum("ni,ni->n", cloud.normals, view - cloud.points) >= 0.0
            return replace(cloud, normals=np.where(facing[:, None], cloud.normals, -cloud.normals)), view
        return replace(cloud, viewpoint=view).estimate_normals(), view
    assert cloud.viewpoint is not None
    view = cloud.viewpoint
    plausible = bool(np.linalg.norm(cloud.points - view, axis=1).min() > NEAREST_VIEW)
    if cloud.normals is None and plausible:
        return cloud.estimate_normals(), view
    if cloud.normals is None or (
        not plausible and (np.einsum("ni,ni->n", cloud.normals, view - cloud.points) >= 0.0).all()
    ):
        has = "without normals" if cloud.normals is None else "whose normals are turned to there"
        raise ValueError(
            f"viewpoint: expected the place of a sensor, got {view.round(4).tolist()}, within {NEAREST_VIEW} m of a "
            f"cloud {has}; pass --viewpoint X Y Z or --all-round (the "
            f"cloud is about {cloud.points.mean(axis=0).round(3).tolist()})"
        )
    return cloud, view if plausible and _one_sided(cloud) else None


def _one_sided(cloud: PointCloudObject) -> bool:
    """Whether all that was seen faces the viewpoint, as it does in a single view."""
    assert cloud.normals is not None and cloud.viewpoint is not None
    return bool((np.einsum("ni,ni->n", cloud.normals, cloud.viewpoint - cloud.points) >= 0.0).mean() > 0.95)


def _on_points(cloud: PointCloudObject, view: Array | None, settings: Settings, say: Say, notes: list[str]) -> _Found:
    center = 0.5 * (cloud.points.min(axis=0) + cloud.points.max(axis=0))
    if settings.method == "cloud":
        say(f"casting {settings.rays} rays through {len(cloud)} points")
        grasps = grasps_on_cloud(
            cloud.points, cloud.normals, settings.gripper, view, n_rays=settings.rays, rng=settings.seed
        )
        notes = [*notes, "Only what was seen is held, and what was not seen is taken to be free."]
        return _Found("cloud", grasps, center, Scene(None, cloud.points, viewpoint=view, center=center), notes)
    if settings.points < len(cloud):
        cloud = cloud.farthest_point_sample(settings.points)
    _check_spacing(cloud.points, settings)
    say(f"fitting a {settings.prior} and a Gaussian process to {len(cloud)} points")
    prior, said = fit_prior(settings.prior, cloud, view)
    model = fit_model(cloud, prior)
    say("drawing the estimated surface and its shells")
    surface, shells, missing = _surfaces(model, cloud)
    mesh = None if surface is None else MeshObject.from_arrays(surface.vertices, surface.faces, scale=1.0)
    if mesh is not None and mesh.watertight and mesh.volume > 0.0:
        center = mesh.center_of_mass
    say("descending to contacts, and drawing samples of them")
    grasps = grasps_on_gpis(model, settings.gripper, max(settings.rays // 4, 1), settings.seed, center)
    scene = Scene(surface, cloud.points, shells, view, center)
    return _Found("gpis", grasps, center, scene, [*notes, *said, *missing])


def _check_spacing(points: Array, settings: Settings) -> None:
    """Refuse a scene: what is thinned to points wider apart than half a pad's way says nothing of what is held."""
    from scipy.spatial import cKDTree

    if len(points) < 4:
        raise ValueError(f"object: expected a cloud of at least 4 points, got {len(points)}")
    spacing = float(np.median(cKDTree(points).query(points, k=2)[0][:, 1]))
    if spacing > COARSE * settings.gripper.max_width:
        raise ValueError(
            f"object: expected one object, got a cloud {np.ptp(points, axis=0).max():.2f} m across, whose "
            f"{len(points)} points lie {1e3 * spacing:.0f} mm apart for jaws of {1e3 * settings.gripper.max_width:.0f} "
            f"mm; pass --crop to cut out the object, --points for more points, or --method cloud"
        )


def fit_prior(name: PriorName, cloud: PointCloudObject, view: Array | None) -> tuple[Prior, list[str]]:
    """The prior of that name fitted to a cloud, and what there is to say about it."""
    if name == "constant":
        return Constant(0.25 * float(cloud.extents.max())), []
    fits: dict[str, Callable[..., PriorFit]] = {
        "ellipsoid": fit_ellipsoid,
        "cylinder": fit_cylinder,
        "plane": fit_plane,
    }
    fit = fits[name](cloud.points, cloud.normals, view)
    said = [f"prior: {name}, {1e3 * fit.residual:.1f} mm (r.m.s.) from the points"]
    return fit.prior, said + ([f"prior: {fit.reason}"] if fit.reason else [])


def fit_model(cloud: PointCloudObject, prior: Prior) -> GPIS:
    """A Gaussian process about the prior; its parameters have the highest likelihood on a part of the points."""
    size = float(cloud.extents.max())
    start = GPIS(Matern52(0.3 * size, (0.1 * size) ** 2), prior, noise=max(0.005 * size, 2e-4), normal_noise=0.15)
    some = cloud.farthest_point_sample(min(LEARNING_POINTS, len(cloud)))
    bounds = {
        "length_scale": (0.1 * size, 2.0 * size),
        "variance": ((0.02 * size) ** 2, (0.5 * size) ** 2),
        "noise": (0.1, 5.0),  # noise by factors
        "normal_noise": (0.2, 3.0),
    }
    best = start.fit(some.points, some.normals).optimize(bounds, max_iterations=40).model
    return GPIS(best.kernel, prior, best.noise, best.normal_noise).fit(cloud.points, cloud.normals)


def _surfaces(model: GPIS, cloud: PointCloudObject) -> tuple[Surface | None, dict[float, Surface], list[str]]:
    """The estimated surface with its standard deviation, the shells of one σ, and what of them there is not.

    An endless prior gives an endless surface: that is cut off at the edges of a box about the cloud, without shells.
    """
    resolution = float(cloud.extents.max()) / CELLS
    found: dict[float, Surface] = {}
    notes = []
    for sigma in (0.0, 1.0, -1.0):
        try:
            found[sigma] = _drawn(model.surface(resolution, sigma, MAX_CELLS))
        except SurfaceError as error:
            if sigma == 0.0:
                notes.append("The surface and its shells have no end: drawn is the surface within the cloud's box.")
                try:
                    found[sigma] = _drawn(_cut_off(model, cloud.points, resolution))
                except SurfaceError as again:
                    notes[-1] = f"Surface and shells are not drawn: {again}"
                break
            notes.append(f"The {sigma:+g} σ shell is not drawn: {error}")
    estimate = found.pop(0.0, None)
    if estimate is not None:
        says = model.predict(estimate.vertices, gradient=True, variance=True)
        assert says.gradient is not None and says.variance is not None
        slope = np.maximum(np.linalg.norm(says.gradient, axis=1), FLATTEST)
        estimate = replace(estimate, deviation=np.sqrt(says.variance) / slope)
    return estimate, found, notes


def _drawn(mesh: trimesh.Trimesh) -> Surface:
    return Surface(np.asarray(mesh.vertices), np.asarray(mesh.faces))


def _cut_off(model: GPIS, points: Array, resolution: float) -> trimesh.Trimesh:
    """The solid {mean < 0} within a box about the points."""
    lower, upper = points.min(axis=0), points.max(axis=0)
    middle, half = 0.5 * (lower + upper), 0.5 * (upper - lower) + 0.1 * float((upper - lower).max())

    def level(x: Array) -> Array:
        return np.maximum(model.predict(x).mean, (np.abs(x - middle) - half).max(axis=1))

    return surface_mesh(walk(level, points, resolution, MAX_CELLS))


# --- ranking ------------------------------------------------------------------------------------------------------


def _ranked(found: _Found, settings: Settings, say: Say) -> Plan:
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
