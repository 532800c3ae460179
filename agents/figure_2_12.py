"""Thesis figures 2.10 to 2.12: an aligned model as virtual data, its noise varying or fixed."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import trimesh
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from agents.pictures import figure_grid, png
from agents.reproduction import Reproduction, Request, text_table
from agents.seeds import VALIDATION_SEED
from agents.shapes import bottle, box, mug, noisy, surface_points
from agents.statistics import bootstrap_interval, mean, paired_difference
from baselines.objects import (
    GPIS,
    Constant,
    Prior,
    SquaredExponential,
    SurfaceError,
    fit_ellipsoid,
    fit_with_model,
    merge_model,
)

SHAPES: dict[str, Callable[[], trimesh.Trimesh]] = {"box": box, "bottle": bottle, "mug": mug}
VIEWS = 72
VALIDATION = 12
NOISE, TURN = 1e-3, 0.05  # of the observed points [m] and normals
VOXEL = 0.014  # [m]
RESOLUTION = 0.006  # [m]
SCALE_ERROR = 0.1  # standard deviation of the logarithm of the model's size along each axis
LENGTH_SCALE, DEVIATION, LEVEL = 0.025, 0.02, 0.02  # [m]

FIXED = (5e-4, 1e-3, 2e-3, 4e-3, 8e-3, 1.6e-2)  # σ [m]
VARYING = tuple(product((1e-3, 2e-3, 4e-3, 8e-3), (0.02, 0.04, 0.08)))  # σ_align [m], l [m]

NOTES = """\
{views} single views of procedural boxes, bottles and mugs, self-occlusion included; the model is the truth, each axis
scaled (σ {scale:.0%}), placed by point-to-plane ICP from a pose off by some 8° and 8 mm. Chamfer: mean of both mean
nearest distances between true and found surface. Chosen on {validation} other views by it: fixed σ = {fixed:g} mm (of
{fixed_grid}), varying σ_align = {sigma:g} mm, l = {length:g} mm (of {varying_count} pairs).
The prior mean is an ellipsoid fitted to the model, the same for both; without model: observations and a constant of
{level:g} mm. Far side: mean distance from the found surface of that half of the true surface which is farthest from the
observed points. Calibration: root mean square there of the mean over the standard deviation of f (1 is honest, above
is overconfident)."""


class View(NamedTuple):
    """What is seen of an object, and its model where registration put it."""

    shape: str
    truth: trimesh.Trimesh
    points: np.ndarray
    normals: np.ndarray
    model_points: np.ndarray
    model_normals: np.ndarray


class Score(NamedTuple):
    """How a reconstruction came out; infinite where there is no surface."""

    chamfer: float  # [m]
    far: float  # mean distance of the unseen true surface from the surface found [m]
    calibration: float


def view(seed: int) -> View:
    """One view from a random direction, the shape by the seed."""
    rng = np.random.default_rng(seed)
    name = list(SHAPES)[seed % len(SHAPES)]
    truth = SHAPES[name]()
    eye = rng.standard_normal(3)
    eye *= 0.7 / np.linalg.norm(eye)
    points, normals = surface_points(truth, 6000, rng)
    ray = (eye - points) / np.linalg.norm(eye - points, axis=1, keepdims=True)
    facing = np.einsum("ij,ij->i", normals, ray) > 0.15
    points, normals, ray = points[facing], normals[facing], ray[facing]
    free = ~truth.ray.intersects_any(points + 1e-4 * ray, ray)
    points, normals = noisy(points[free], normals[free], NOISE, TURN, rng)
    model = truth.copy()
    model.apply_scale(np.exp(SCALE_ERROR * rng.standard_normal(3)))
    virtual, virtual_normals = surface_points(model, 6000, rng)
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(np.radians(8.0) / np.sqrt(3.0) * rng.standard_normal(3)).as_matrix()
    T[:3, 3] = 8e-3 / np.sqrt(3.0) * rng.standard_normal(3)
    T = align(virtual, virtual_normals, points, T)
    return View(name, truth, points, normals, virtual @ T[:3, :3].T + T[:3, 3], virtual_normals @ T[:3, :3].T)


def align(
    model: np.ndarray, normals: np.ndarray, observed: np.ndarray, T: np.ndarray, iterations: int = 15
) -> np.ndarray:
    """Point-to-plane ICP (Chen & Medioni 1992) of a model to the observed points, from T_observed_model."""
    for _ in range(iterations):
        x, n = model @ T[:3, :3].T + T[:3, 3], normals @ T[:3, :3].T
        _, index = cKDTree(x).query(observed)
        residual = np.einsum("ij,ij->i", observed - x[index], n[index])
        jacobian = np.hstack([np.cross(x[index], n[index]), n[index]])
        weight = 1.0 / (1.0 + (residual / 5e-3) ** 2)
        normal = (jacobian * weight[:, None]).T @ jacobian + 1e-6 * np.eye(6)
        step = np.linalg.solve(normal, (jacobian * weight[:, None]).T @ residual)
        move = np.eye(4)
        move[:3, :3], move[:3, 3] = Rotation.from_rotvec(step[:3]).as_matrix(), step[3:]
        T = move @ T
    return T


def reconstruct(seen: View, sigma: float | None, length: float) -> tuple[GPIS, trimesh.Trimesh | None]:
    """The process and its surface: without a model for sigma None, with fixed noise for an infinite length."""
    data = merge_model(
        seen.points, seen.normals, seen.model_points, seen.model_normals,
        voxel=VOXEL, alignment_noise=sigma or 1e-3, decay_length=length, noise=NOISE, normal_noise=0.1,
    )  # fmt: skip
    prior: Prior = fit_ellipsoid(seen.model_points[:300], seen.model_normals[:300]).prior
    if sigma is None:
        prior = Constant(LEVEL)
        data = data._replace(
            **{k: getattr(data, k)[: data.observed] for k in ("points", "normals", "noise", "normal_noise")}
        )
    model = fit_with_model(GPIS(SquaredExponential(LENGTH_SCALE, DEVIATION**2), prior), data)
    try:
        return model, model.surface(RESOLUTION, max_cells=100_000)
    except SurfaceError:
        return model, None


def score(seen: View, sigma: float | None, length: float) -> Score:
    """One reconstruction against the truth."""
    rng = np.random.default_rng(0)
    truth, _ = surface_points(seen.truth, 4000, rng)
    model, surface = reconstruct(seen, sigma, length)
    away = cKDTree(seen.points).query(truth)[0]
    far = truth[away > np.median(away)]
    got = model.predict(far, gradient=True, variance=True)
    assert got.gradient is not None and got.variance is not None
    calibration = float(np.sqrt(np.mean(got.mean**2 / got.variance)))
    if surface is None:
        return Score(np.inf, np.inf, calibration)
    found, _ = surface_points(surface, 4000, rng)
    to_found = cKDTree(found).query(truth)[0].mean()
    return Score(
        0.5 * float(to_found + cKDTree(truth).query(found)[0].mean()),
        float(cKDTree(found).query(far)[0].mean()),
        calibration,
    )


def choose(views: list[View]) -> tuple[float, tuple[float, float]]:
    """Fixed σ, and σ_align and l, of least mean Chamfer distance."""
    fixed = min(FIXED, key=lambda s: np.mean([score(v, s, np.inf).chamfer for v in views]))
    varying = min(VARYING, key=lambda p: np.mean([score(v, *p).chamfer for v in views]))
    return fixed, varying


def run(request: Request, views: int = VIEWS, validation: int = VALIDATION) -> Reproduction:
    """Chamfer distances of the three on paired views."""
    fixed, varying = choose([view(VALIDATION_SEED + i) for i in range(validation)])
    seen = [view(request.seed + i) for i in range(views)]
    methods: dict[str, tuple[float | None, float]] = {
        "varying noise": varying, "fixed noise": (fixed, np.inf), "without model": (None, np.inf),
    }  # fmt: skip
    scores = {name: np.array([score(v, *settings) for v in seen]) for name, settings in methods.items()}
    rows = [["", "Chamfer [mm]", "95 %", "far side [mm]", "calibration", "no surface"]]
    data: dict[str, Any] = {"fixed": fixed, "varying": varying, "shapes": [v.shape for v in seen], "scores": {}}
    for name, values in scores.items():
        low, high = bootstrap_interval(values[:, 0], statistic=mean)
        data["scores"][name] = dict(zip(Score._fields, values.T, strict=True))
        rows.append(
            [name, f"{1e3 * values[:, 0].mean():.2f}", f"{1e3 * low:.2f} … {1e3 * high:.2f}",
             f"{1e3 * values[:, 1].mean():.2f}", f"{np.median(values[:, 2]):.2f}",
             str(int(np.isinf(values[:, 0]).sum()))]
        )  # fmt: skip
    text = text_table(rows, 1) + "\n"
    for column, label in enumerate(("Chamfer", "far side")):
        difference = paired_difference(scores["varying noise"][:, column], scores["fixed noise"][:, column])
        low, high = difference.interval
        verdict = "" if difference.significant else " (not resolved)"
        data[f"{label}: varying − fixed"] = difference
        text += f"{label}, varying − fixed: {1e3 * difference.estimate:+.3f} mm "
        text += f"[{1e3 * low:+.3f}, {1e3 * high:+.3f}]{verdict}\n"
    text += NOTES.format(
        views=views, scale=SCALE_ERROR, validation=validation, fixed=1e3 * fixed, sigma=1e3 * varying[0],
        level=1e3 * LEVEL, length=1e3 * varying[1], fixed_grid=", ".join(f"{1e3 * s:g}" for s in FIXED),
        varying_count=len(VARYING),
    )  # fmt: skip
    return Reproduction(text, data, _picture(seen, methods, scores) if request.picture else None)


def _picture(seen: list[View], methods: dict[str, tuple[float | None, float]], scores: dict[str, np.ndarray]) -> bytes:
    """Sections through the first view of each shape, and the paired distances."""
    figure, axes = figure_grid(1, len(SHAPES) + 1, (13.0, 4.0))
    colors = {"varying noise": "#1f77b4", "fixed noise": "#d98a1f", "without model": "#999999"}
    for axis, item in zip(axes[:-1], seen, strict=False):
        middle = item.truth.bounds.mean(axis=0)
        axis.set(title=item.shape, aspect="equal", xlabel="x [mm]", ylabel="z [mm]")
        meshes = {name: reconstruct(item, *settings)[1] for name, settings in methods.items()}
        for name, mesh in {"truth": item.truth, **meshes}.items():
            if mesh is not None:
                lines = trimesh.intersections.mesh_plane(mesh, [0.0, 1.0, 0.0], middle)[..., [0, 2]]
                style = {"color": colors.get(name, "black"), "lw": 2.2 if name == "truth" else 1.3}
                axis.plot(
                    *1e3 * np.concatenate([lines, np.full_like(lines[:, :1], np.nan)], 1).reshape(-1, 2).T, **style
                )
        near = np.abs(item.points[:, 1] - middle[1]) < 3e-3
        axis.plot(*1e3 * item.points[near][:, [0, 2]].T, ".", color="#c03020", ms=3)
    last = axes[-1]
    pairs = 1e3 * np.column_stack([scores["fixed noise"][:, 0], scores["varying noise"][:, 0]])
    limit = 1.05 * float(pairs[np.isfinite(pairs)].max())
    last.plot([0.0, limit], [0.0, limit], color="#bbbbbb", lw=1.0)
    for name in SHAPES:
        chosen = np.array([v.shape == name for v in seen])
        last.plot(*pairs[chosen].T, "o", ms=4, label=name)
    last.set(title="Chamfer [mm]", xlabel="fixed noise", ylabel="varying noise", aspect="equal")
    last.legend(frameon=False, fontsize=8)
    handles = [last.plot([], [], color=c, label=n)[0] for n, c in {"truth": "black", **colors}.items()]
    figure.legend(handles=handles, ncols=4, loc="outside lower center", frameon=False)
    return png(figure)
