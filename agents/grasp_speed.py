"""What grasp analysis costs, against the same computed through Qhull in the same run: part of `agents.speed_grasp`.

What is compared runs in turns, warm, and each figure is the median over repeats; all of it runs in one thread.
"""

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from baselines.grasping import (
    Contact,
    antipodal_probability,
    force_closure,
    largest_min_resisted_wrench,
    probability_of_force_closure,
    wrench_points,
)

Array = NDArray[np.float64]
SAMPLES, GRASPS = 1000, 50
FRICTION, TORSION, SPREAD = 0.5, 0.1, 0.2
CLOSED = 1e-9  # offset of the nearest facet from which Qhull's hull counts as closed


class Row(NamedTuple):
    """One comparison."""

    name: str
    seconds: float  # ours, median
    bound_seconds: float  # what it is compared with, median
    ratio: float  # median of bound / ours over repeats
    target: float  # the least ratio wanted; 0 where it is for information


def pair_samples(rng: np.random.Generator, *shape: int) -> tuple[Array, Array]:
    """Samples (*shape, 2, 3) of two roughly opposed contacts and their normals."""
    p = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]) + 0.5 * SPREAD * rng.normal(size=(*shape, 2, 3))
    n = np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]) + SPREAD * rng.normal(size=p.shape)
    return p, n / np.linalg.norm(n, axis=-1, keepdims=True)


def soft_grasps(rng: np.random.Generator, count: int, fingers: int = 3) -> list[list[Contact]]:
    """Closed grasps of a unit ball by soft fingers."""
    grasps: list[list[Contact]] = []
    while len(grasps) < count:
        p = rng.normal(size=(fingers, 3))
        p /= np.linalg.norm(p, axis=1)[:, None]
        contacts = [Contact(x, -x, FRICTION, TORSION) for x in p]
        if force_closure(contacts):
            grasps.append(contacts)
    return grasps


def qhull_radius(contacts: list[Contact]) -> float:
    """The largest ball about zero in the wrench space by Qhull's whole hull; negative or zero: none."""
    hull = ConvexHull(wrench_points(contacts, np.zeros(3)), qhull_options="Qt")
    return float(-hull.equations[:, 6].max())


def _compare(name: str, ours: Callable[[], object], bound: Callable[[], object], repeats: int, target: float) -> Row:
    """Both in turns, after one run of each to warm up."""
    seconds = np.zeros((repeats + 1, 2))
    for turn in range(repeats + 1):
        for i, call in enumerate((ours, bound)):
            start = time.perf_counter()
            call()
            seconds[turn, i] = time.perf_counter() - start
    a, b = seconds[1:].T
    return Row(name, float(np.median(a)), float(np.median(b)), float(np.median(b / a)), target)


def measure(repeats: int = 5, samples: int = SAMPLES, grasps: int = GRASPS, seed: int = 0) -> list[Row]:
    """Measure everything: a row a comparison."""
    rng = np.random.default_rng(seed)
    p, n = pair_samples(rng, samples)
    contacts = [
        [Contact(*c, FRICTION, TORSION) for c in zip(p_i, n_i, strict=True)] for p_i, n_i in zip(p, n, strict=True)
    ]
    many_p, many_n = pair_samples(rng, 200, 100)
    three = soft_grasps(rng, grasps)

    def probability() -> object:
        return probability_of_force_closure(p, n, FRICTION, TORSION)

    return [
        _compare(
            f"{samples}-sample PFC of two soft contacts / Qhull of every sample",
            probability,
            lambda: np.mean([qhull_radius(pair) > CLOSED for pair in contacts]),
            repeats,
            30.0,
        ),
        _compare(
            f"{samples}-sample PFC of two soft contacts / force_closure of every sample",
            probability,
            lambda: np.mean([force_closure(pair) for pair in contacts]),
            repeats,
            0.0,
        ),
        _compare(
            "PFC of 100 grasps × 200 samples, batched / one by one",
            lambda: antipodal_probability(many_p, many_n, FRICTION),
            lambda: [
                probability_of_force_closure(many_p[:, g], many_n[:, g], FRICTION, TORSION)
                for g in range(many_p.shape[1])
            ],
            repeats,
            0.0,
        ),
        _compare(
            f"largest minimum resisted wrench of {grasps} grasps by 3 soft contacts / Qhull Qt",
            lambda: [largest_min_resisted_wrench(grasp, np.zeros(3)) for grasp in three],
            lambda: [qhull_radius(grasp) for grasp in three],
            repeats,
            2.0,
        ),
    ]
