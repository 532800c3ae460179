"""A known object's pose from a partial cloud of it, without a start: many starts, pruned by how well they agree."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.interfaces import Intrinsics
from aerograsp_env.spatial import Array, as_array, check_transform, inverse, matrix_from_quat_wxyz, transform
from baselines.detection import alignment_kernel as kernel
from baselines.detection.checks import check_points
from baselines.detection.registration import LEAST, RegistrationResult, failed
from baselines.detection.shape_model import ShapeModel, shape_model

STARTS = 256
"""Orientations tried: every orientation has one within about 30°."""
GATE = 0.05
"""Largest distance of a pair at the end, as a fraction of the model's diameter: instances differ from the model."""


class Stage(NamedTuple):
    """One round: the best poses of the one before go on."""

    kept: int  # poses
    points: int  # of the cloud that are used
    looked: int  # points of the model that are looked for in the depth image
    steps: int
    first: float  # gate at its start and its end, as fractions of the diameter; 0: the last gate of all
    last: float


STAGES = (
    Stage(2 * STARTS, 60, 60, 0, 0.15, 0.15),
    Stage(80, 70, 80, 7, 0.25, 0.10),
    Stage(10, 150, 200, 9, 0.12, 0.0),
    Stage(3, 300, 300, 10, 0.08, 0.0),
)


class DepthView(NamedTuple):
    """A part of a depth image, for asking whether the model hides what is seen behind it."""

    depth: NDArray[np.float32]  # (H, W) [m], 0 where there is no return
    intrinsics: Intrinsics  # of the whole image
    left: int = 0  # [px] where the part starts in the whole image
    top: int = 0


class BestPose(NamedTuple):
    """The best pose found, and how well it agrees."""

    T: Array  # (4, 4) maps the model's frame to the cloud's
    stretch: Array  # (3,) the object's size along the model's axes, relative to the model
    score: float  # in [0, 1]: closeness of the cloud to the model × share of the model seen where it should be
    inlier_fraction: float  # share of the cloud within the gate
    rmse: float  # [m] of the inliers' distances to tangent planes; NaN without inliers
    seen: float  # share of the model's unhidden points that is there in the depth image; 1 without an image
    iterations: int


def uniform_rotations(count: int) -> Array:
    """(count, 3, 3) rotations evenly spread: the super-Fibonacci spiral of Alexa 2022, algorithm 1."""
    s = np.arange(count) + 0.5
    inner, outer = np.sqrt(s / count), np.sqrt(1.0 - s / count)
    alpha, beta = 2.0 * np.pi * s / np.sqrt(2.0), 2.0 * np.pi * s / 1.533751168755204288118041413
    q = [inner * np.sin(alpha), inner * np.cos(alpha), outer * np.sin(beta), outer * np.cos(beta)]
    return matrix_from_quat_wxyz(np.stack(q, axis=1))


_ROTATIONS = uniform_rotations(STARTS)


def align_model(
    cloud: Any,
    model: Any,
    T_init: ArrayLike | None = None,
    *,
    viewpoint: ArrayLike = (0.0, 0.0, 0.0),
    view: DepthView | None = None,
    gate: float | None = None,
    min_inlier_fraction: float = 0.6,
    min_seen: float = 0.5,
) -> RegistrationResult:
    """The pose of an object whose shape is roughly known, from a partial noisy cloud of it.

    Orientations spread over all rotations, each placed so that the surface which would face the camera lies on the
    cloud, are refined by point-to-plane iterations (Chen & Medioni 1992, with Tukey's weights) on few points; the best
    go on with more. A pose is judged by how near the cloud lies to the model and, with a depth image, by whether the
    model is seen where it should be: where the camera looks through it, the pose is wrong.

    Args:
        cloud: (N, 3) [m], at least ten points, mostly the object's.
        model: a `ShapeModel` (make it once), a pair (points, normals), or points (M, 3) of the whole surface.
        T_init: (4, 4) rough pose of the model in the cloud's frame; None: search all orientations.
        viewpoint: (3,) [m] where the cloud was seen from.
        view: the depth image, when the cloud is in its camera's frame.
        gate: [m] how far the object's surface may be from the model's; None: a twentieth of the model's diameter.
        min_inlier_fraction: smallest share of the cloud within the gate that counts as success.
        min_seen: smallest share of the model's visible points that must be there in the depth image.

    Returns:
        T_target_source maps the model's frame to the cloud's; rmse is of distances to tangent planes within the gate.
        Where it failed, `converged` is false and the pose is NaN.

    Raises:
        ValueError: a cloud or model of fewer than ten points, values that are not finite, or arguments out of range.
    """
    found = best_pose(cloud, model, T_init, viewpoint=viewpoint, view=view, gate=gate)
    if found.inlier_fraction < min_inlier_fraction or found.seen < min_seen:
        return failed(found.rmse, found.inlier_fraction, found.iterations)
    return RegistrationResult(found.T, True, found.rmse, found.inlier_fraction, found.iterations)


def best_pose(
    cloud: Any,
    model: Any,
    T_init: ArrayLike | None = None,
    *,
    viewpoint: ArrayLike = (0.0, 0.0, 0.0),
    view: DepthView | None = None,
    gate: float | None = None,
) -> BestPose:
    """What `align_model` decides on: the pose that agrees best with what is seen, however badly."""
    shape = shape_model(model)
    points = check_points(cloud, "cloud", LEAST)
    eye = np.ascontiguousarray(as_array(viewpoint, (3,), "viewpoint"))
    if gate is not None and not gate > 0.0:
        raise ValueError(f"gate: expected a positive length [m], got {gate}")
    gate = GATE * shape.diameter if gate is None else float(gate)
    camera, depth = _view(view)
    points = _spread(points, STAGES[-1].points)
    if T_init is None:
        Rs, ts = _starts(points, shape, eye)
        stages: tuple[Stage, ...] = STAGES
    else:
        start = inverse(check_transform(T_init, "T_init"))
        Rs, ts, stages = start[None, :3, :3].copy(), start[None, :3, 3].copy(), STAGES[2:]
    ds, scores = np.ones((len(Rs), 3)), np.zeros(len(Rs))
    for stage in stages:
        best = np.argsort(-scores, kind="stable")[: stage.kept]
        Rs, ts, ds = Rs[best], ts[best], ds[best]
        most = shape.stretch if stage is stages[-1] else 1.0
        if most > 1.0:  # as they are, and stretched to the cloud's outline: the better one stays
            more = [_stretched(points, eye, R, t, shape) for R, t in zip(Rs, ts, strict=True)]
            Rs = np.concatenate([Rs, Rs])
            ts = np.concatenate([ts, [t for t, _ in more]])
            ds = np.concatenate([ds, [d for _, d in more]])
        last = max(stage.last * shape.diameter, gate)
        first = max(stage.first * shape.diameter, last)
        some, size = _spread(points, stage.points), shape.diameter
        looked = _spread(np.arange(len(shape.points)), stage.looked)
        scores = kernel.refine(
            some, eye, Rs, ts, ds, *_surface(shape), looked, camera, depth, first, last, stage.steps, size, most
        )
    winner = int(np.argmax(scores))
    R, t, d, score = Rs[winner], ts[winner], ds[winner], float(scores[winner])
    inside, cost, rmse = kernel.fit(points, R, t, d, *_surface(shape), gate)
    seen = score / (1.0 - cost) if cost < 1.0 else 0.0
    steps = sum(stage.steps for stage in stages)
    return BestPose(inverse(transform(R, t)), 1.0 / d, score, float(inside), float(rmse), float(seen), steps)


def _surface(shape: ShapeModel) -> tuple[Array, Array, Array, float, NDArray[np.int32]]:
    return shape.points, shape.normals, shape.origin, shape.cell, shape.nearest


def _spread(rows: NDArray, count: int) -> NDArray:
    """`count` rows, evenly picked by index."""
    if len(rows) <= count:
        return rows
    return rows[np.linspace(0, len(rows) - 1, count).astype(np.int64)]


def _stretched(points: Array, viewpoint: Array, R: Array, t: Array, shape: ShapeModel) -> tuple[Array, Array]:
    """Shift (3,) and stretch (3,) that bring the cloud's extents along the model's axes to those of what would be seen.

    Along an axis where less than half of the model would be seen, only the side that is seen is brought into place, and
    the stretch is the mean of the others.
    """
    some = _spread(np.arange(len(shape.points)), 400)
    surface, normals = shape.points[some], shape.normals[some]
    eye = R @ viewpoint + t
    facing = np.einsum("ni,ni->n", normals, eye - surface) > 0.0
    if not facing.any():
        return t, np.ones(3)
    cloud = points @ R.T + t
    near = cloud[np.abs(cloud - np.median(cloud, axis=0)).max(axis=1) < shape.stretch * shape.diameter]
    (low, high), (least, most) = np.percentile(near, (1.0, 99.0), axis=0), _ends(surface[facing])
    whole = np.ptp(shape.points, axis=0)
    shown = (most - least > 0.5 * whole) & (high > low)
    ratio = np.where(shown, (high - low) / np.where(shown, most - least, 1.0), np.nan)
    ratio = np.where(shown, ratio, np.exp(np.nanmean(np.log(ratio))) if shown.any() else 1.0)
    ratio = np.clip(ratio, 1.0 / shape.stretch, shape.stretch)
    # What is seen of the model, times the ratio, shall lie on the cloud: its middle, or its side towards the camera.
    middle = 0.5 * (low + high) - 0.5 * ratio * (least + most)
    side = np.where(eye > 0.0, high - ratio * most, low - ratio * least)
    return t - np.where(shown, middle, side), 1.0 / ratio


def _ends(points: Array) -> tuple[Array, Array]:
    return points.min(axis=0), points.max(axis=0)


def _view(view: DepthView | None) -> tuple[Array, NDArray[np.float32]]:
    """What the kernel takes: fx, fy, cx, cy, left, top, and the depth; one without pixels where there is none."""
    if view is None:
        return np.zeros(6), np.zeros((0, 0), dtype=np.float32)
    camera, depth = view.intrinsics, np.ascontiguousarray(view.depth, dtype=np.float32)
    if depth.ndim != 2 or not np.isfinite(depth).all():
        raise ValueError(f"view: expected a finite depth (H, W), got {depth.shape}")
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy, view.left, view.top], dtype=np.float64), depth


def _starts(points: Array, shape: ShapeModel, viewpoint: Array) -> tuple[Array, Array]:
    """Each rotation with two shifts: poses (2 K, 3, 3) and (2 K, 3).

    One puts the middle of the surface that would face the camera on the cloud's, which is right for flat views. The
    other puts outline on outline and front on front, which is right where the object hides parts of itself.
    """
    middle = np.median(points, axis=0)
    some = _spread(np.arange(len(shape.points)), 200)
    surface = shape.points[some]
    toward = viewpoint - middle
    toward = toward / max(float(np.linalg.norm(toward)), 1e-12)
    facing = shape.normals[some] @ (_ROTATIONS @ toward).T > 0.0  # (M, K)
    middles = (facing.T @ surface) / np.maximum(facing.sum(axis=0), 1)[:, None]
    across = np.linalg.svd(toward[None])[2][1:]
    axes = np.concatenate([across, toward[None]])  # (3, 3) rows: right, up, towards the camera
    inner = points[np.linalg.norm(points - middle, axis=1) <= shape.diameter]
    seen, turned = inner @ axes.T, surface @ (_ROTATIONS @ axes.T)  # (N, 3), (K, M, 3)
    outline = _outline(seen) - _outline(turned)  # (K, 3) along the axes, in the cloud's frame
    shifts = -np.einsum("kij,kj->ki", _ROTATIONS, outline @ axes)
    return np.concatenate([_ROTATIONS, _ROTATIONS]), np.concatenate([middles - _ROTATIONS @ middle, shifts])


def _outline(points: Array) -> Array:
    """(..., 3) middle of the extents of (..., N, 3) along two axes, and how far they reach along the third."""
    low, high = points.min(axis=-2), points.max(axis=-2)
    return np.concatenate([0.5 * (low + high)[..., :2], high[..., 2:]], axis=-1)
