"""Does the probability of force closure say how often a grasp holds? Candidates on pinned views, judged by physics.

Reliability diagrams and their binned summaries: Murphy & Winkler 1977 (Applied Statistics 26); Brier 1950 (Monthly
Weather Review 78).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.interfaces import Grasp
from agents.statistics import Interval, is_binary, wilson_interval

Array = NDArray[np.float64]

BINS = 10
VIEWS, CANDIDATES = 75, 12
NEAR = 0.02  # [m] from the closing line to the centre of mass: gravity hardly turns such a grasp
NOT_CLOSED = ("collision", "degenerate", "too wide")  # outcomes in which the fingers never closed


class Bin(NamedTuple):
    """The predictions between two edges."""

    low: float  # of the bin; the last one includes its upper edge
    high: float
    samples: int
    predicted: float  # their mean
    observed: float  # share of ones among their outcomes
    interval: Interval  # Wilson, 95 %


class Reliability(NamedTuple):
    """How probabilities compare with what happened."""

    bins: list[Bin]  # those that have predictions
    samples: int
    brier: float  # mean squared difference; 0 is perfect
    base_rate: float  # share of ones
    brier_base: float  # of predicting that share always
    calibration_error: float  # mean |predicted − observed| over bins, weighted by their counts

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        bins = [{**of._asdict(), "interval": list(of.interval)} for of in self.bins]
        return {**self._asdict(), "bins": bins}


class Judged(NamedTuple):
    """Candidate grasps with their prediction and their outcome."""

    pfc: Array  # (M,) in [0, 1]
    held: Array  # (M,) 0 or 1
    strict: Array  # (M,)
    closed: Array  # (M,) 1 where the gripper came to close at all
    offset: Array  # (M,) [m] distance of the true centre of mass from the closing line
    view: NDArray[np.int64]  # (M,) seed of the view


def reliability(predicted: ArrayLike, outcome: ArrayLike, bins: int = BINS) -> Reliability:
    """Compare predicted probabilities with 0/1 outcomes, in bins of equal width.

    Args:
        predicted: (M,) in [0, 1], M ≥ 1.
        outcome: (M,) 0 or 1.
        bins: their number, ≥ 1.

    Raises:
        ValueError: other shapes or values.
    """
    p, y = np.asarray(predicted, dtype=np.float64), np.asarray(outcome, dtype=np.float64)
    if p.ndim != 1 or p.size == 0 or p.shape != y.shape:
        raise ValueError(f"predicted, outcome: expected equal shapes (M,) with M ≥ 1, got {p.shape} and {y.shape}")
    if not ((p >= 0.0) & (p <= 1.0)).all():
        raise ValueError("predicted: expected probabilities in [0, 1]")
    if not is_binary(y):
        raise ValueError("outcome: expected values 0 or 1")
    if bins < 1:
        raise ValueError(f"bins: expected at least 1, got {bins}")
    member = bin_of(p, bins)
    found = []
    for index in np.unique(member):
        of = member == index
        interval = wilson_interval(int(y[of].sum()), int(of.sum()))
        edges = (float(index) / bins, float(index + 1) / bins)
        found.append(Bin(*edges, int(of.sum()), float(p[of].mean()), float(y[of].mean()), interval))
    base = float(y.mean())
    return Reliability(
        bins=found,
        samples=p.size,
        brier=float(np.mean((p - y) ** 2)),
        base_rate=base,
        brier_base=base * (1.0 - base),
        calibration_error=sum(of.samples * abs(of.predicted - of.observed) for of in found) / p.size,
    )


def bin_of(predicted: Array, bins: int) -> NDArray[np.int64]:
    """(M,) which of `bins` equal intervals of [0, 1] each lies in; 1 belongs to the last."""
    return np.minimum((predicted * bins).astype(np.int64), bins - 1)


def across(predicted: Array, count: int, rng: np.random.Generator, bins: int = BINS) -> NDArray[np.int64]:
    """Up to `count` indices that cover the range of predictions: one from each bin in turn, at random within it.

    A planner's candidates crowd at its favourite probabilities; drawn so, every bin gets outcomes, and what is observed
    within a bin is as it would be without.
    """
    shuffled = rng.permutation(len(predicted))
    member = bin_of(predicted[shuffled], bins)
    place = [np.count_nonzero(member[:i] == of) for i, of in enumerate(member)]  # of each within its bin
    order = np.lexsort((rng.permutation(bins)[member], np.array(place, dtype=np.int64)))
    return shuffled[order[:count]].astype(np.int64)


def judge_candidates(
    env: Any, seeds: Sequence[int], propose: Any, candidates: int = CANDIDATES, progress: bool = False
) -> Judged:
    """Propose grasps on pinned views and try some of them across the range of their PFC.

    Args:
        env: an unwrapped `aerograsp/GraspPlan-v0`.
        seeds: of the views.
        propose: (cloud, rng) → proposals with `pfc` (G,) and `grasp(i)`.
        candidates: tried per view, at most.
        progress: a bar, if standard error is a terminal.
    """
    from tqdm import tqdm

    from aerograsp_env.envs.grasp_plan import unpack_cloud

    found: list[tuple[float, ...]] = []
    for seed in tqdm(seeds, desc="calibration", unit="view", leave=False, disable=None if progress else True):
        observation, _ = env.reset(seed=int(seed))
        rng = np.random.default_rng(int(seed))
        proposals = propose(unpack_cloud(observation), rng)
        predicted = np.clip(np.asarray(proposals.pfc, dtype=np.float64), 0.0, 1.0)
        for index in across(predicted, candidates, rng).tolist():
            grasp = proposals.grasp(index)
            verdict = env.judge(grasp)
            closes = verdict.outcome not in NOT_CLOSED
            distance = center_of_mass_offset(env, grasp)
            found.append((predicted[index], verdict.held, verdict.strict, closes, distance, int(seed)))
    pfc, held, strict, closed, offset, view = np.array(found, dtype=np.float64).reshape(-1, 6).T
    return Judged(pfc, held, strict, closed, offset, view.astype(np.int64))


def center_of_mass_offset(env: Any, grasp: Grasp) -> float:
    """Distance of the object's true centre of mass from the closing line [m]."""
    center = env.T_cloud_object[:3, :3] @ env.object.center_of_mass + env.T_cloud_object[:3, 3]
    return float(np.linalg.norm(np.cross(center - grasp.center, grasp.closing_axis)))


def curves(judged: Judged) -> dict[str, Reliability]:
    """Reliability of PFC for: held; strict; held, of what PFC can speak of.

    PFC knows neither collisions nor gravity: the third curve is over the grasps that closed with the centre of mass
    within 20 mm of the closing line. A curve without grasps is left out.
    """
    apt = (judged.closed == 1.0) & (judged.offset < NEAR)
    kinds: Mapping[str, tuple[Array, Array]] = {
        "held": (judged.pfc, judged.held),
        "strict": (judged.pfc, judged.strict),
        "held, closed near the centre of mass": (judged.pfc[apt], judged.held[apt]),
    }
    return {name: reliability(p, y) for name, (p, y) in kinds.items() if p.size}
