"""Pairs of contacts on a Gaussian-process implicit surface, and how sure one can be that they close.

Ramon Soria 2018, section 2.3.3 and algorithm 1.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.grasping.candidates import Pairs
from baselines.grasping.contacts import Array
from baselines.grasping.probability import antipodal_probability
from baselines.objects import GPIS

Mask = NDArray[np.bool_]

SURFACE = 1e-4
"""[m] A point this close to the surface, to first order, is on it."""
TINY = np.finfo(np.float64).tiny


class Descent(NamedTuple):
    """Where a descent ended."""

    points: Array  # (M, 3) [m]
    gradients: Array  # (M, 3) of the mean there
    converged: Mask  # (M,) whether the point is on the surface


def descend(gp: GPIS, starts: Array, largest_step: float, iterations: int = 25) -> Descent:
    """Points moved onto {f = 0} along the mean's gradient, all at once: Newton steps f ∇f/‖∇f‖², cut to a length.

    Args:
        gp: a fitted model.
        starts: (M, 3) [m].
        largest_step: [m].
        iterations: after which what is not on the surface has not converged.
    """
    points, gradients = starts.copy(), np.zeros_like(starts)
    converged = np.zeros(len(starts), dtype=bool)
    for _ in range(iterations):
        rows = np.flatnonzero(~converged)
        if not len(rows):
            break
        found = gp.predict(points[rows], gradient=True)
        assert found.gradient is not None
        gradients[rows] = found.gradient
        steepness = np.linalg.norm(found.gradient, axis=1)
        distance = found.mean / np.maximum(steepness, TINY)
        done = (np.abs(distance) < SURFACE) & (steepness > 0.0)
        converged[rows[done]] = True
        step = np.clip(distance, -largest_step, largest_step) / np.maximum(steepness, TINY)
        points[rows[~done]] -= (step[:, None] * found.gradient)[~done]
    return Descent(points, gradients, converged)


def opposite(gp: GPIS, points: Array, inward: Array, farthest: float, samples: int = 24) -> Descent:
    """Where rays from the surface along `inward` (M, 3) first leave the object again: f = 0, going up.

    f is looked at in `samples` places on each ray up to `farthest` [m]; where its sign changes, Newton's method along
    the ray, held within the bracket, finds the place. A wall or gap thinner than farthest/samples may be missed. Rays
    that do not leave have not converged, and end at `farthest`.
    """
    steps = farthest * np.arange(1, samples + 1) / samples
    values = gp.predict((points[:, None] + steps[:, None] * inward[:, None]).reshape(-1, 3)).mean
    outside = values.reshape(len(points), samples) > 0.0
    last = outside.argmax(axis=1)
    found = outside.any(axis=1) & (last > 0)  # outside at once: nothing to hold there
    low, high = steps[np.maximum(last - 1, 0)], steps[last]
    at = np.where(outside.any(axis=1), 0.5 * (low + high), farthest)
    slopes = np.zeros_like(points)
    converged = np.zeros(len(points), dtype=bool)
    for _ in range(20):
        rows = np.flatnonzero(found & ~converged)
        if not len(rows):
            break
        here = gp.predict(points[rows] + at[rows, None] * inward[rows], gradient=True)
        assert here.gradient is not None
        slopes[rows] = here.gradient
        slope = np.einsum("mi,mi->m", here.gradient, inward[rows])
        converged[rows] = np.abs(here.mean) < SURFACE * np.linalg.norm(here.gradient, axis=1)
        up = here.mean > 0.0
        high[rows[up]], low[rows[~up]] = at[rows[up]], at[rows[~up]]
        newton = at[rows] - here.mean / np.where(slope > 0.0, slope, TINY)
        inside = (slope > 0.0) & (newton > low[rows]) & (newton < high[rows])
        at[rows] = np.where(converged[rows], at[rows], np.where(inside, newton, 0.5 * (low[rows] + high[rows])))
    return Descent(points + at[:, None] * inward, slopes, converged)


def closing_probability(
    gp: GPIS, pairs: Pairs, gradients: Array, friction: float, samples: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Probability of force closure of each pair under the posterior, and its standard error: (P,) both.

    f and its gradient are drawn jointly at both contacts from the posterior (exact, their correlation included). A
    drawn value moves the contact along the mean's normal by −δf/‖∇f‖ (first order), and a drawn gradient is the normal
    of the moved contact (that it turns on the way is left out): good where the surface's standard deviation is small
    beside its curvature's radius.

    Args:
        gp: a fitted model.
        pairs: contacts on the mean's surface.
        gradients: (P, 2, 3) of the mean there.
        friction: Coulomb coefficient of both contacts.
        samples: draws, the same for all pairs.
        rng: what draws.
    """
    if not len(pairs.positions):
        return np.empty(0), np.empty(0)
    values, vectors = np.linalg.eigh(gp.covariance(pairs.positions, gradients=True))  # of f₀, f₁, ∂f₀ (3), ∂f₁ (3)
    roots = vectors * np.sqrt(np.maximum(values, 0.0))[:, None]
    drawn = np.matmul(rng.standard_normal((samples, 8)), roots.transpose(0, 2, 1))  # (P, S, 8)
    squared = (gradients**2).sum(axis=-1, keepdims=True)
    positions = pairs.positions[:, None] - drawn[..., :2, None] * (gradients / squared)[:, None]  # (P, S, 2, 3)
    slopes = gradients[:, None] + drawn[..., 2:].reshape(*drawn.shape[:2], 2, 3)
    lengths = np.sqrt(np.einsum("psci,psci->psc", slopes, slopes))
    normals = slopes / -np.maximum(lengths, TINY)[..., None]
    return antipodal_probability(positions.transpose(1, 0, 2, 3), normals.transpose(1, 0, 2, 3), friction)
