"""Grasps on a Gaussian-process implicit surface, ranked by their probability of force closure.

Ramon Soria 2018, section 2.3.3 and algorithm 1: from random points away from the data down to the surface, from there
to the opposite side, and down again.
"""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import ArrayLike

from aerograsp_env.sim.gripper import GripperConfig
from baselines.grasping.candidates import GraspCandidates, GraspSearch, Pairs, assemble, note
from baselines.grasping.clearance import point_collisions
from baselines.grasping.contacts import Array, finite
from baselines.grasping.gpis_contacts import TINY, closing_probability, descend, opposite
from baselines.objects import GPIS

NODES = 6000
"""Points at which the mean is looked at for what may be in the gripper's way."""


def _lattice(gp: GPIS, lower: Array, upper: Array, nodes: int) -> tuple[Array, Array, float]:
    """Nodes (I, J, K, 3), the mean there (I, J, K), and their spacing [m]."""
    spacing = float(np.prod(upper - lower) / nodes) ** (1.0 / 3.0)
    axes = [np.arange(low, high + spacing, spacing) for low, high in zip(lower, upper, strict=True)]
    lattice = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    return lattice, gp.predict(lattice.reshape(-1, 3)).mean.reshape(lattice.shape[:3]), spacing


def surface_points(gp: GPIS, lower: Array, upper: Array, nodes: int = NODES) -> Array:
    """Points on {f = 0} within the box (K, 3).

    A coarse lattice says which part of the box holds the object; of a fine one in that part, the nodes that have a
    neighbour on the other side of the surface are moved onto it by one Newton step.
    """
    coarse, values, spacing = _lattice(gp, lower, upper, max(nodes // 6, 8))
    if not (held := coarse[values < 0.0]).size:
        return np.empty((0, 3))
    low, high = np.maximum(lower, held.min(axis=0) - spacing), np.minimum(upper, held.max(axis=0) + spacing)
    lattice, values, spacing = _lattice(gp, low, high, nodes)
    inside = values < 0.0
    near = np.zeros(inside.shape, dtype=bool)
    for axis in range(3):
        a, b = [slice(None)] * 3, [slice(None)] * 3
        a[axis], b[axis] = slice(1, None), slice(None, -1)
        crossed = inside[tuple(a)] != inside[tuple(b)]
        near[tuple(a)] |= crossed
        near[tuple(b)] |= crossed
    points = lattice[near]
    if not len(points):
        return points
    slope = gp.predict(points, gradient=True).gradient
    assert slope is not None
    move = -values[near][:, None] * slope / np.maximum((slope**2).sum(axis=1), TINY)[:, None]
    length = np.linalg.norm(move, axis=1, keepdims=True)
    return points + move * np.minimum(1.0, spacing / np.maximum(length, TINY))


def grasps_on_gpis(
    gp: GPIS,
    gripper: GripperConfig | None = None,
    n_starts: int = 200,
    rng: np.random.Generator | int = 0,
    center: ArrayLike | None = None,
    friction: float | None = None,
    samples: int = 200,
    *,
    approaches: int = 8,
    clearance: float = 0.008,
) -> GraspCandidates:
    """Grasps of a parallel-jaw gripper on what a GPIS takes the object to be, seen or not; in the frame of its points.

    The score is the probability of force closure under the posterior (see `closing_probability` for what is
    approximated), and `score_error` its standard error; equal ones are ordered by the distance of the closing line from
    `center`. The second contact lies on the first one's inward normal. The
    gripper has room where neither an observed point nor the mean's surface, looked at on a lattice of some 6000 points,
    is inside of its boxes: exact for the points, and blind to what is finer than the lattice, or farther from the data
    than 1.5 times its radius.

    Args:
        gp: fitted to points in space, with a differentiable kernel.
        gripper: None is `GripperConfig()`.
        n_starts: random points on a sphere about the data, from which the descents start.
        rng: what draws starts and samples, or a seed.
        center: (3,) of the sphere [m]; None is the middle of the data's bounding box.
        friction: Coulomb coefficient; None is the gripper's.
        samples: draws for the probability.
        approaches: approach axes tried for each pair of contacts.
        clearance: as `grasps_on_mesh` has it.

    Returns:
        Possibly none at all: `reasons` then says why, as `grasps_on_mesh` has them, with "did not converge" (a descent
        that found no surface near the data) and "no opposite side" (no inside lies behind the surface). `counts` has
        "starts", "converged" and "pairs".

    Raises:
        ValueError: a model of other than points in space, a kernel without gradients, or an argument out of its range.
        RuntimeError: the model is not fitted.
    """
    if not isinstance(gp, GPIS):
        raise ValueError(f"gp: expected a GPIS, got {type(gp).__name__}")
    data = gp.observations.points
    if data.shape[1] != 3:
        raise ValueError(f"gp: expected a model of points in space, got {data.shape[1]}-D ones")
    if not gp.kernel.differentiable:
        raise ValueError(f"gp: expected a kernel with gradients, got {gp.kernel}")
    for name, count in (("n_starts", n_starts), ("samples", samples)):
        if not isinstance(count, (int, np.integer)) or count < 1:
            raise ValueError(f"{name}: expected a whole number ≥ 1, got {count!r}")
    search = GraspSearch.of(gripper, friction, approaches, clearance)
    generator = np.random.default_rng(rng)
    lower, upper = data.min(axis=0), data.max(axis=0)
    middle = 0.5 * (lower + upper) if center is None else finite("center", center, (3,))
    radius = max(float(np.linalg.norm(data - middle, axis=1).max()), search.gripper.pad_width)

    reasons: Counter[str] = Counter()
    directions = generator.standard_normal((n_starts, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    first = descend(gp, middle + 1.5 * radius * directions, 0.25 * radius)
    on = first.converged & (np.linalg.norm(first.points - middle, axis=1) < 3.0 * radius)
    points, slopes = first.points[on], first.gradients[on]
    inward = -slopes / np.linalg.norm(slopes, axis=1, keepdims=True)
    reach = 1.2 * search.gripper.max_width
    second = opposite(gp, points, inward, reach)
    wide = ~second.converged & (np.linalg.norm(second.points - points, axis=1) > 0.999 * reach)
    missing = ~second.converged & ~wide
    note(reasons, {"did not converge": (~on).sum(), "too wide": wide.sum(), "no opposite side": missing.sum()})

    gradients = np.stack([slopes, second.gradients], axis=1)[second.converged]
    positions = np.stack([points, second.points], axis=1)[second.converged]
    all_pairs = Pairs(positions, -gradients / np.linalg.norm(gradients, axis=-1, keepdims=True))
    counts = {"starts": n_starts, "converged": int(on.sum()), "pairs": len(positions)}
    pairs, _ = search.eligible(all_pairs, reasons)
    contacts = pairs.positions.reshape(-1, 3)
    found = np.concatenate([data, points])
    body = found
    if len(contacts):
        surface = surface_points(gp, found.min(axis=0) - 1.5 * radius, found.max(axis=0) + 1.5 * radius)
        body = np.concatenate([found, surface])
    placed = search.place(pairs, lambda *bodies: point_collisions(body, *bodies), reasons)
    used, rows = np.unique(placed[0], return_inverse=True)
    pairs = pairs.take(used)
    at_contacts = gp.predict(pairs.positions.reshape(-1, 3), gradient=True).gradient
    assert at_contacts is not None
    gradients = at_contacts.reshape(-1, 2, 3)
    score, error = closing_probability(gp, pairs, gradients, search.friction, samples, generator)
    return assemble(pairs, (rows, *placed[1:]), score, reasons, counts, middle, error)
