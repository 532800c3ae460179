"""Thesis figure 2.8: half an apple, restored with an ellipsoid for a prior and with a constant one."""

from __future__ import annotations

from itertools import product
from typing import Any, NamedTuple

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from agents.pictures import png
from agents.reproduction import Reproduction, Request, text_table
from agents.seeds import VALIDATION_SEED
from agents.shapes import apple, noisy, surface_points
from agents.statistics import bootstrap_interval, mean, paired_difference
from baselines.objects import GPIS, Constant, Prior, SquaredExponential, SurfaceError, fit_ellipsoid

APPLES = 12  # tested
VALIDATION = 6  # to choose the settings on
POINTS = 300
RESOLUTION = 0.005  # [m]
DEVIATION = 0.01  # of f about its prior [m]
LENGTH_SCALES = (0.01, 0.015, 0.02, 0.025, 0.03, 0.04, 0.06)  # [m]
LEVELS = (0.002, 0.005, 0.01, 0.02, 0.04, 0.08)  # [m]
NOISE, TURN = 5e-4, 0.03  # of the observed points [m] and normals
WITHIN = 0.1

NOTES = """\
{apples} procedural apples (superellipses of revolution with dents, radius 28 to 46 mm), seen on one side of a plane
through its middle, {points} points with normals. Length scale, and the constant prior's level, were chosen on
{validation} other apples by the mean volume error: ellipsoid {ellipsoid}, constant {constant}.
"Best level": for each apple the level, out of {levels},
that its own true volume favours, which nobody knows in practice: with normals, some level always fits the volume.
Depth error: mean distance of the unseen half from the surface found."""


class Half(NamedTuple):
    """What is seen of an apple."""

    mesh: trimesh.Trimesh
    points: np.ndarray  # (N, 3)
    normals: np.ndarray
    unseen: np.ndarray  # (M, 3) points of the other half


def half(seed: int) -> Half:
    """An apple of random proportions, seen on one side of a plane that is within 40° of upright."""
    rng = np.random.default_rng(seed)
    radius = rng.uniform(0.028, 0.046)
    mesh = apple(radius, rng.uniform(0.8, 1.05) * radius, rng.uniform(2.1, 2.6), rng.uniform(0.15, 0.28) * radius)
    azimuth, tilt = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(-np.radians(40.0), np.radians(40.0))
    to_viewer = np.array([np.cos(tilt) * np.cos(azimuth), np.cos(tilt) * np.sin(azimuth), np.sin(tilt)])
    points, normals = surface_points(mesh, 4 * POINTS, rng)
    seen = (points - mesh.center_mass) @ to_viewer > 0.0
    return Half(mesh, *noisy(points[seen][:POINTS], normals[seen][:POINTS], NOISE, TURN, rng), points[~seen])


def reconstruct(seen: Half, prior: Prior, length_scale: float) -> trimesh.Trimesh | None:
    """The surface, or None where there is none that is closed."""
    model = GPIS(SquaredExponential(length_scale, DEVIATION**2), prior, noise=1e-3, normal_noise=0.1)
    try:
        found = model.fit(seen.points, seen.normals).surface(RESOLUTION, max_cells=60_000)
    except SurfaceError:
        return None
    return found if found.is_watertight else None


def volume_ratio(seen: Half, prior: Prior, length_scale: float) -> float:
    """Restored over true volume; 0 without a closed surface."""
    found = reconstruct(seen, prior, length_scale)
    return 0.0 if found is None else float(found.volume / seen.mesh.volume)


def choose(halves: list[Half]) -> tuple[float, tuple[float, float]]:
    """The length scale for the ellipsoid, and length scale and level for the constant, of least mean volume error."""
    priors = [fit_ellipsoid(seen.points, seen.normals).prior for seen in halves]

    def error(ratios: list[float]) -> float:
        return float(np.mean(np.abs(np.array(ratios) - 1.0)))

    ellipsoid = min(
        LENGTH_SCALES, key=lambda s: error([volume_ratio(h, p, s) for h, p in zip(halves, priors, strict=True)])
    )
    constant = min(
        product(LENGTH_SCALES, LEVELS), key=lambda c: error([volume_ratio(h, Constant(c[1]), c[0]) for h in halves])
    )
    return ellipsoid, constant


def run(request: Request, apples: int = APPLES, validation: int = VALIDATION) -> Reproduction:
    """Volumes of apples that were seen by half, by prior, and a picture of the first."""
    scale, (constant_scale, level) = choose([half(VALIDATION_SEED + i) for i in range(validation)])
    halves = [half(request.seed + i) for i in range(apples)]
    rows: dict[str, list[tuple[float, float]]] = {"ellipsoid": [], "constant": [], "constant, best level": []}
    for seen in halves:
        prior = fit_ellipsoid(seen.points, seen.normals).prior
        best = min(LEVELS, key=lambda c: abs(volume_ratio(seen, Constant(c), constant_scale) - 1.0))
        for name, candidate, length_scale in (
            ("ellipsoid", prior, scale),
            ("constant", Constant(level), constant_scale),
            ("constant, best level", Constant(best), constant_scale),
        ):
            found = reconstruct(seen, candidate, length_scale)
            rows[name].append(
                (0.0, np.nan) if found is None else (found.volume / seen.mesh.volume, _depth(seen, found))
            )
    table = [["prior", "volume", "|error|", "95 %", "within 10 %", "depth error [mm]"]]
    data: dict[str, Any] = {"length_scale": scale, "constant_length_scale": constant_scale, "level": level, "rows": {}}
    for name, values in rows.items():
        ratios, depths = np.array(values).T
        errors = np.abs(ratios - 1.0)
        low, high = bootstrap_interval(errors, statistic=mean)
        within = int((errors <= WITHIN).sum())
        data["rows"][name] = {"volume_ratios": ratios, "depth_errors": depths, "within": within}
        table.append(
            [name, f"{ratios.mean():.3f}", f"{errors.mean():.3f}", f"{low:.3f} … {high:.3f}", f"{within}/{apples}",
             f"{1e3 * depths.mean():.2f}"]
        )  # fmt: skip
    text = text_table(table, 1) + "\n"
    for quantity, key in (("volume error", "volume_ratios"), ("depth error", "depth_errors")):
        for other in ("constant", "constant, best level"):
            a, b = (np.asarray(data["rows"][name][key]) for name in ("ellipsoid", other))
            if key == "volume_ratios":
                a, b = np.abs(a - 1.0), np.abs(b - 1.0)
            difference = paired_difference(a, b)
            data[f"{quantity}: ellipsoid − {other}"] = difference
            unit, scale_by = ("", 1.0) if key == "volume_ratios" else (" mm", 1e3)
            low, high = difference.interval
            text += (
                f"{quantity}, ellipsoid − {other}: {scale_by * difference.estimate:+.3f}{unit} "
                f"[{scale_by * low:+.3f}, {scale_by * high:+.3f}]\n"
            )
    text += NOTES.format(
        apples=apples, points=POINTS, validation=validation, levels=", ".join(f"{1e3 * v:g}" for v in LEVELS) + " mm",
        ellipsoid=f"{1e3 * scale:g} mm", constant=f"{1e3 * constant_scale:g} mm and level {1e3 * level:g} mm",
    )  # fmt: skip
    worst = int(np.abs(np.asarray(data["rows"]["constant"]["volume_ratios"]) - 1.0).argmax())
    picture = _picture(halves[worst], scale, constant_scale, level) if request.picture else None
    return Reproduction(text, data, picture)


def _depth(seen: Half, found: trimesh.Trimesh) -> float:
    samples, _ = surface_points(found, 4000, np.random.default_rng(0))
    return float(cKDTree(samples).query(seen.unseen)[0].mean())


def _picture(seen: Half, scale: float, constant_scale: float, level: float) -> bytes:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    prior = fit_ellipsoid(seen.points, seen.normals).prior
    shapes = (
        ("the apple, and what is seen of it", seen.mesh),
        ("ellipsoid prior", reconstruct(seen, prior, scale)),
        ("constant prior (its worst apple)", reconstruct(seen, Constant(level), constant_scale)),
    )
    figure = Figure(figsize=(11.0, 4.6), layout="constrained")
    FigureCanvasAgg(figure)
    toward = seen.normals.mean(axis=0)  # looked at from the side, the seen half on the right
    azimuth = np.degrees(np.arctan2(toward[1], toward[0])) - 75.0
    reach = 1.0 * np.abs(seen.mesh.vertices).max()
    for i, (title, mesh) in enumerate(shapes, 1):
        axis: Any = figure.add_subplot(1, 3, i, projection="3d")
        if mesh is not None:
            light = np.clip(mesh.face_normals @ np.array([0.3, -0.4, 0.85]), 0.0, 1.0)
            colors = np.outer(0.35 + 0.65 * light, [0.55, 0.72, 0.85])
            axis.plot_trisurf(
                *np.asarray(mesh.vertices).T, triangles=mesh.faces, shade=False, alpha=0.55
            ).set_facecolor(np.column_stack([colors, np.full(len(colors), 0.55)]))
            title += f"\nvolume {mesh.volume / seen.mesh.volume:.2f}"
        axis.scatter(*seen.points.T, s=2.0, color="#c03020")
        axis.set(title=title, xlim=(-reach, reach), ylim=(-reach, reach), zlim=(-reach, reach))
        axis.set_box_aspect((1, 1, 1))
        axis.view_init(12.0, azimuth)
        axis.set_axis_off()
    return png(figure)
