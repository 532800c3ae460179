"""From one view of an object to ranked grasps: prior, implicit surface, centre of mass, candidates, ranking.

Ramon Soria 2018, sections 2.3 and 2.4. The thesis ranks by the probability of force closure; how far a grasp is from
the centre of mass decides as much about whether the object turns in the fingers or slips out, so both count here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Literal, NamedTuple

import numpy as np

from aerograsp_env.interfaces import Grasp
from aerograsp_env.sim.gripper import GripperConfig
from baselines.grasping.antipodal import closing_angles, line_distance
from baselines.grasping.candidates import GraspCandidates
from baselines.grasping.clearance import FINGERS, PALM, point_collisions, point_distances, swept_boxes
from baselines.grasping.contacts import Array
from baselines.grasping.on_gpis import grasps_on_gpis, surface_points
from baselines.grasping.ranking import CONTEXT, TERMS, WEIGHTS, ranking
from baselines.objects import GPIS, Constant, Prior, SquaredExponential, fit_ellipsoid
from baselines.objects.observations import check_points
from baselines.objects.sampling import farthest_point_indices

_FAR = 0.03  # [m] clearance from which it makes no difference
_LATTICE = 1500  # nodes at which it is asked what is inside, for the centre of mass
_LEAST_SPREAD = 1e-4  # [m] root mean square distance of points from their centroid
_LEAST_BREADTH = 1e-4  # of a cloud, in lengths of it
_LEAST_NOISE = 1e-5  # [m] far below any sensor's: points seen twice without noise would make the model singular
_OPTIONAL = ("trust", "clearance", "room")  # settings that may be zero


@dataclass(frozen=True)
class PlannerConfig:
    """Settings of the planner; lengths in sizes of the object, which is the root mean square distance of the seen
    points from their centroid.

    Raises:
        ValueError: a value out of its range, or an unknown prior.
    """

    prior: Literal["ellipsoid", "constant"] = "ellipsoid"
    points: int = 200  # of the cloud, evenly spread
    length_scale: float = 0.6
    deviation: float = 0.25  # of the surface about the prior
    level: float = 0.3  # of the constant prior
    bare_length_scale: float = 0.4  # with the constant prior
    trust: float = 0.3  # of the centre of mass with the ellipsoid for a prior, over that with the constant
    normal_noise: float = 0.12  # of each component
    starts: int = 300
    samples: int = 100
    clearance: float = 0.018  # [m] wanted between each open pad and its contact
    room: float = 0.005  # [m] that is little
    weights: Mapping[str, float] = field(
        default_factory=lambda: WEIGHTS
    )  # of the ranking; names of `TERMS`, others count nothing

    def __post_init__(self) -> None:
        for entry in fields(self):
            name, value = entry.name, getattr(self, entry.name)
            if name == "prior":
                if value not in ("ellipsoid", "constant"):
                    raise ValueError(f"prior: expected 'ellipsoid' or 'constant', got {value!r}")
                continue
            if name == "weights":
                if unknown := sorted(set(value) - set(TERMS)):
                    raise ValueError(f"weights: expected names of {', '.join(TERMS)}, got {', '.join(unknown)}")
                if not all(math.isfinite(weight) for weight in value.values()):
                    raise ValueError(f"weights: expected finite numbers, got {dict(value)}")
                continue
            least = 4 if name == "points" else int(isinstance(entry.default, int))  # points: of an ellipsoid
            kind = "whole number" if least else "number"
            fits = isinstance(value, int | np.integer if least else int | float | np.number)
            if isinstance(value, bool) or not fits or not least <= value < math.inf:
                raise ValueError(f"{name}: expected a {kind} of at least {least}, got {value!r}")
            if value == 0 and name not in _OPTIONAL:
                raise ValueError(f"{name}: expected a positive value, got {value!r}")
        if self.trust > 1.0:
            raise ValueError(f"trust: expected a share of at most 1, got {self.trust!r}")


class ObjectEstimate(NamedTuple):
    """What one view says of an object."""

    model: GPIS
    center: Array  # (3,) [m] centre of mass at uniform density
    axes: Array  # (3,) [m] semi-axes of the fitted ellipsoid, ascending
    points: Array  # (n, 3) [m] that the model was fitted to


@dataclass(frozen=True, eq=False)
class Proposals:
    """G candidate grasps, best first."""

    candidates: GraspCandidates
    pfc: Array  # (G,) probability of force closure
    score: Array  # (G,) what they are ranked by
    context: Array  # (G, F), see `CONTEXT`
    clearance: Array  # (G,) [m] of the open fingers and palm from what was seen and from the estimated surface
    estimate: ObjectEstimate

    def __len__(self) -> int:
        return len(self.candidates)

    def take(self, rows: Any) -> Proposals:
        """Some of them: indices or a mask, in the order given."""
        found = self.candidates.take(rows)
        return Proposals(
            found, self.pfc[rows], self.score[rows], self.context[rows], self.clearance[rows], self.estimate
        )

    def grasp(self, index: int) -> Grasp:
        """One of them."""
        c = self.candidates
        return Grasp(c.centers[index], c.closing_axes[index], c.approach_axes[index], float(c.widths[index]))


def usable(points: Array) -> bool:
    """Whether points (N, 3) [m] say enough to plan on: at least four, neither in one place nor on a line.

    Raises:
        ValueError: another shape, or values that are not finite.
    """
    points = check_points(points, "points")
    if len(points) < 4:
        return False
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False) / math.sqrt(len(points))
    return bool(np.linalg.norm(spread) > _LEAST_SPREAD and spread[1] > _LEAST_BREADTH * spread[0])


def estimate_object(
    points: Array, normals: Array, noise: Array, viewpoint: Array, config: PlannerConfig
) -> ObjectEstimate:
    """Fit prior and implicit surface to a view.

    Args:
        points, normals: (N, 3) [m], and unit outward.
        noise: (N,) standard deviation of each point [m].
        viewpoint: (3,) [m].
        config: settings.

    Raises:
        ValueError: points that are not `usable`, or arrays that are otherwise unfit.
    """
    if not usable(points):
        raise ValueError(f"points: expected at least 4 that spread over a surface, got {len(points)} that do not")
    rows = farthest_point_indices(np.ascontiguousarray(points), min(config.points, len(points)), 0)
    points, normals, noise = points[rows], normals[rows], np.maximum(noise[rows], _LEAST_NOISE)
    size = float(np.sqrt(((points - points.mean(axis=0)) ** 2).sum(axis=1).mean()))
    ellipsoid = fit_ellipsoid(points, normals, viewpoint).prior
    axes = np.sort(np.asarray(ellipsoid.axes, dtype=np.float64))

    def model(prior: Prior, length_scale: float) -> tuple[GPIS, Array]:
        kernel = SquaredExponential(length_scale * size, (config.deviation * size) ** 2)
        found = GPIS(kernel, prior, noise=1e-3, normal_noise=config.normal_noise).fit(points, normals, noise)
        return found, _centroid(found, points, float(axes[-1]))

    bare, bare_center = model(Constant(config.level * size), config.bare_length_scale)
    if config.prior == "constant":
        return ObjectEstimate(bare, bare_center, axes, points)
    shaped, center = model(ellipsoid, config.length_scale)
    # With a shape for a prior the unseen side comes out too large, without one too small.
    return ObjectEstimate(shaped, config.trust * center + (1.0 - config.trust) * bare_center, axes, points)


def _centroid(model: GPIS, points: Array, reach: float) -> Array:
    """Centroid of {f < 0} about the points, on a lattice; the points' own where nothing is inside."""
    margin = min(reach, 0.5 * float(np.ptp(points, axis=0).max()))
    lower, upper = points.min(axis=0) - margin, points.max(axis=0) + margin
    spacing = float(np.prod(upper - lower) / _LATTICE) ** (1.0 / 3.0)
    axes = [np.arange(low + 0.5 * spacing, high, spacing) for low, high in zip(lower, upper, strict=True)]
    lattice = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    inside = model.predict(lattice).mean < 0.0
    return lattice[inside].mean(axis=0) if inside.any() else points.mean(axis=0)


def propose(
    points: Array,
    normals: Array,
    noise: Array,
    viewpoint: Array,
    rng: np.random.Generator,
    config: PlannerConfig | None = None,
    gripper: GripperConfig | None = None,
    friction: float | None = None,
) -> Proposals:
    """Grasps on what one view says of an object, ranked by closure and distance to the centre of mass.

    Args:
        points, normals, noise, viewpoint: as `estimate_object` has them.
        rng: of the search's starts and samples.
        config, gripper: defaults if None.
        friction: Coulomb coefficient; None is the gripper's.

    Raises:
        ValueError: as `estimate_object`.
    """
    config = config or PlannerConfig()
    gripper = gripper or GripperConfig()
    estimate = estimate_object(points, normals, noise, viewpoint, config)
    found = grasps_on_gpis(
        estimate.model,
        gripper,
        config.starts,
        rng,
        estimate.center,
        friction,
        config.samples,
        approaches=8,
        clearance=config.clearance,
    )
    pfc = np.asarray(found.score)
    if not len(found):
        return Proposals(found, pfc, pfc, np.empty((0, len(CONTEXT))), pfc, estimate)
    body = np.concatenate([points, _surface(estimate)])
    tight, clearance = _tightness(found, body, gripper, config.room), _clearance(found, body, gripper)
    context = _context(found, tight, estimate, viewpoint)
    score = ranking(context, clearance, config.weights)
    order = np.argsort(-score, kind="stable")
    return Proposals(found.take(order), pfc[order], score[order], context[order], clearance[order], estimate)


def _surface(estimate: ObjectEstimate) -> Array:
    """Points on the estimated surface (K, 3)."""
    data = estimate.points
    margin = 0.25 * float(np.ptp(data, axis=0).max())
    return surface_points(estimate.model, data.min(axis=0) - margin, data.max(axis=0) + margin, 4000)


def _rotations(found: GraspCandidates) -> Array:
    x, z = found.closing_axes, found.approach_axes
    return np.stack([x, np.cross(z, x), z], axis=2)


def _tightness(found: GraspCandidates, body: Array, gripper: GripperConfig, room: float) -> Array:
    """How many of two grippers, grown by `room` [m] and by twice that, would touch the body (N, 3): (G,)."""
    hits = np.zeros(len(found))
    for grown in (room, 2.0 * room):
        boxes = swept_boxes(gripper, found.widths, found.contact_widths, tolerance=-grown)
        boxes[:, 5:] = boxes[:, 2:4]  # not the closing fingers: they are meant to come close
        hits += point_collisions(body, _rotations(found), found.centers, boxes) >= 0
    return hits


def _clearance(found: GraspCandidates, body: Array, gripper: GripperConfig) -> Array:
    """Distance of the open fingers and the palm, as they come, from the body (N, 3): (G,) [m], `_FAR` at most."""
    boxes = swept_boxes(gripper, found.widths, found.contact_widths)[:, [*FINGERS, PALM]]
    return point_distances(body, _rotations(found), found.centers, boxes, _FAR)


def _context(found: GraspCandidates, tight: Array, estimate: ObjectEstimate, viewpoint: Array) -> Array:
    contacts = found.positions.reshape(-1, 3)
    unique, inverse = np.unique(contacts, axis=0, return_inverse=True)
    variance = estimate.model.predict(unique, variance=True).variance
    assert variance is not None
    deviation = np.sqrt(variance)[inverse.ravel()].reshape(-1, 2)
    apart = np.linalg.norm(unique[:, None] - estimate.points[None], axis=2).min(axis=1)
    unseen = apart[inverse.ravel()].reshape(-1, 2)
    sight = viewpoint - estimate.center
    sight = sight / np.linalg.norm(sight)
    to_center = estimate.center - found.centers
    along = np.einsum("gi,gi->g", to_center, found.closing_axes)
    below = to_center - along[:, None] * found.closing_axes  # from the closing line straight to the centre of mass
    columns = [
        found.score,
        closing_angles(found.positions, found.normals),
        line_distance(found.positions, estimate.center),
        np.linalg.norm(found.centers - estimate.center, axis=1),
        found.contact_widths,
        *np.sort(deviation, axis=1).T,
        *np.sort(unseen, axis=1).T,
        found.approach_axes @ sight,
        np.abs(found.closing_axes @ sight),
        found.approach_axes[:, 2],
        np.abs(found.closing_axes[:, 2]),
        np.full(len(found), estimate.axes[1]),
        np.full(len(found), estimate.axes[2] / estimate.axes[0]),
        tight,
        found.widths - found.contact_widths,
        -below[:, 2],  # hanging from the fingers, an object is at rest; standing on them, it turns over
        np.linalg.norm(below[:, :2], axis=1),
    ]
    return np.stack(columns, axis=1)
