"""Grasps on points: cleaned, given normals, and completed by an implicit surface about a fitted prior."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from agents.plan_page import Scene, Surface
from agents.plan_settings import Array, Found, PriorName, Say, Settings
from baselines.grasping.on_cloud import grasps_on_cloud
from baselines.grasping.on_gpis import grasps_on_gpis
from baselines.grasping.planning import ObjectEstimate, PlannerConfig, estimate_object
from baselines.objects import GPIS, SurfaceError
from baselines.objects.mesh import MeshObject
from baselines.objects.point_cloud import PointCloudObject
from baselines.objects.prior_fit import PriorFit, fit_cylinder, fit_ellipsoid, fit_plane
from baselines.objects.surface import mesh as surface_mesh
from baselines.objects.surface import walk

CELLS = 28  # of the drawn surfaces, along the object
MAX_CELLS = 15_000
FLATTEST = 0.1  # slope of the mean, 1 on a clear surface, below which its standard deviation is not blown up further
COARSE = 0.25  # of the jaws' opening: points farther apart than this do not show what is between the jaws
NEAREST_VIEW = 0.1  # [m] depth sensors see nothing nearer: a closer viewpoint is the origin of some other frame

FITS: Mapping[str, Callable[..., PriorFit]] = {"ellipsoid": fit_ellipsoid, "cylinder": fit_cylinder, "plane": fit_plane}


def read_cloud(path: Path, settings: Settings) -> tuple[PointCloudObject, Array | None]:
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


def on_points(cloud: PointCloudObject, view: Array | None, settings: Settings, say: Say, notes: list[str]) -> Found:
    center = 0.5 * (cloud.points.min(axis=0) + cloud.points.max(axis=0))
    if settings.method == "cloud":
        say(f"casting {settings.rays} rays through {len(cloud)} points")
        grasps = grasps_on_cloud(
            cloud.points, cloud.normals, settings.gripper, view, n_rays=settings.rays, rng=settings.seed
        )
        notes = [*notes, "Only what was seen is held, and what was not seen is taken to be free."]
        return Found("cloud", grasps, center, Scene(None, cloud.points, viewpoint=view, center=center), notes)
    if settings.points < len(cloud):
        cloud = cloud.farthest_point_sample(settings.points)
    _check_spacing(cloud.points, settings)
    say(f"fitting a {settings.prior} and a Gaussian process to {len(cloud)} points")
    (model, center, *_), said = fit_model(settings.prior, cloud, view, settings.noise)
    say("drawing the estimated surface and its shells")
    surface, shells, missing = _surfaces(model, cloud)
    mesh = None if surface is None else MeshObject.from_arrays(surface.vertices, surface.faces, scale=1.0)
    if view is None and mesh is not None and mesh.watertight and mesh.volume > 0.0:
        center = mesh.center_of_mass  # all of it was seen: nothing to be wary of
    say("descending to contacts, and drawing samples of them")
    grasps = grasps_on_gpis(model, settings.gripper, max(settings.rays // 4, 1), settings.seed, center)
    scene = Scene(surface, cloud.points, shells, view, center)
    return Found("gpis", grasps, center, scene, [*notes, *said, *missing])


def _check_spacing(points: Array, settings: Settings) -> None:
    """Refuse a scene: what is thinned to points wider apart than half a pad's way says nothing of what is held."""
    if len(points) < 4:
        raise ValueError(f"object: expected a cloud of at least 4 points, got {len(points)}")
    spacing = float(np.median(cKDTree(points).query(points, k=2)[0][:, 1]))
    if spacing > COARSE * settings.gripper.max_width:
        raise ValueError(
            f"object: expected one object, got a cloud {np.ptp(points, axis=0).max():.2f} m across, whose "
            f"{len(points)} points lie {1e3 * spacing:.0f} mm apart for jaws of {1e3 * settings.gripper.max_width:.0f} "
            f"mm; pass --crop to cut out the object, --points for more points, or --method cloud"
        )


def fit_model(name: PriorName, cloud: PointCloudObject, view: Any, noise: float) -> tuple[ObjectEstimate, list[str]]:
    """The planner's estimate of a cloud's object, about the prior of that name, and what there is to say about it.

    A cylinder or a plane takes the ellipsoid's place in the model; the centre of mass stays that of the ellipsoid's.

    Args:
        cloud: with normals.
        view: (3,) [m] where it was seen from; None if from all round.
        noise: standard deviation of the points [m].
    """
    config = PlannerConfig("constant" if name == "constant" else "ellipsoid", len(cloud))
    assert cloud.normals is not None
    estimate = estimate_object(cloud.points, cloud.normals, np.full(len(cloud), noise), view, config)
    if name == "constant":
        return estimate, []
    like, seen = estimate.model, estimate.model.observations
    fit = FITS[name](seen.points, seen.normals, view)
    said = [f"prior: {name}, {1e3 * fit.residual:.1f} mm (r.m.s.) from the points"]
    if fit.reason:
        said.append(f"prior: {fit.reason}")
    if name == "ellipsoid":
        return estimate, said
    model = GPIS(like.kernel, fit.prior, like.noise, like.normal_noise)
    return estimate._replace(model=model.fit(seen.points, seen.normals, seen.deviations[: len(seen.points)])), said


def _surfaces(model: GPIS, cloud: PointCloudObject) -> tuple[Surface | None, dict[float, Surface], list[str]]:
    """The estimated surface with its standard deviation, the shells of one σ, and what of them there is not.

    An endless prior gives an endless surface: that is cut off at the edges of a box about the cloud, without shells.
    """
    resolution = float(cloud.extents.max()) / CELLS
    found: dict[float, Surface] = {}
    notes = []
    for sigma in (0.0, 1.0, -1.0):
        try:
            found[sigma] = _drawn(model, model.surface(resolution, sigma, MAX_CELLS))
        except SurfaceError as error:
            if sigma == 0.0:
                notes.append("The surface and its shells have no end: drawn is the surface within the cloud's box.")
                try:
                    found[sigma] = _drawn(model, _cut_off(model, cloud.points, resolution))
                except SurfaceError as again:
                    notes[-1] = f"Surface and shells are not drawn: {again}"
                break
            notes.append(f"The {sigma:+g} σ shell is not drawn: {error}")
    return found.pop(0.0, None), found, notes


def _drawn(model: GPIS, mesh: trimesh.Trimesh) -> Surface:
    vertices = np.asarray(mesh.vertices)
    says = model.predict(vertices, gradient=True, variance=True)
    assert says.gradient is not None and says.variance is not None
    slope = np.maximum(np.linalg.norm(says.gradient, axis=1), FLATTEST)
    return Surface(vertices, np.asarray(mesh.faces), np.sqrt(says.variance) / slope)


def _cut_off(model: GPIS, points: Array, resolution: float) -> trimesh.Trimesh:
    """The solid {mean < 0} within a box about the points."""
    lower, upper = points.min(axis=0), points.max(axis=0)
    middle, half = 0.5 * (lower + upper), 0.5 * (upper - lower) + 0.1 * float((upper - lower).max())

    def level(x: Array) -> Array:
        return np.maximum(model.predict(x).mean, (np.abs(x - middle) - half).max(axis=1))

    return surface_mesh(walk(level, points, resolution, MAX_CELLS))
