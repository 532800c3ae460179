"""What `aerograsp bench aerograsp/GraspPlan-v0` adds to its report.

Which objects are held by whom, what became of the other grasps, what a plan costs, and whether the probability of
force closure says how often a grasp holds.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

from agents import page
from agents.bench_setup import Measured, Study
from agents.grasp_calibration import NEAR, VIEWS, Reliability, curves, judge_candidates
from agents.scoring import GRASPING
from agents.table import Row, without_trainings

TIMED_VIEWS, WARM_UP = 30, 3
PLANNER = "gpis"
GROUPS = ("concave", "elongated", "off-balance")  # tags of objects


class Episodes(NamedTuple):
    """Which object each episode was about."""

    objects: list[str]  # (E,) names
    tags: dict[str, frozenset[str]]  # by name, in the order of their first episodes


class PlanningTime(NamedTuple):
    """Processor time of one plan on one core."""

    median: float  # [s]
    p95: float  # [s]
    views: int


def study(measured: Measured) -> Study:
    """The sections and their numbers; calibration in full comparisons only."""
    env = _make(measured)
    try:
        seeds = [measured.seed + k for k in range(measured.episodes)]
        episodes = episode_objects(env, seeds)
        times = planning_times(env, measured.policies, seeds[:TIMED_VIEWS])
        reliabilities = {} if measured.quick else _calibration(measured, env)
    finally:
        env.close()
    shares = {row.label: outcome_shares(row) for row in measured.rows}
    rows = without_trainings(measured.rows)
    held = object_rates(rows, episodes)
    sections = [
        *rates_section(measured.rows),
        *outcomes_section(shares),
        *objects_section(rows, episodes),
        *times_section(times),
        *calibration_section(reliabilities, min(VIEWS, measured.episodes)),
    ]
    data = {
        "objects": {name: sorted(tags) for name, tags in episodes.tags.items()},
        "held_by_object": held,
        "outcomes": {row.policy: outcome_shares(row) for row in measured.rows},
        "planning_time": {name: of._asdict() for name, of in times.items()},
        "calibration": {name: curve.to_dict() for name, curve in reliabilities.items()},
    }
    return Study(sections, data)


def _make(measured: Measured) -> Any:
    import gymnasium

    return gymnasium.make(measured.env_id, disable_env_checker=True, **measured.env_kwargs).unwrapped


def _calibration(measured: Measured, env: Any) -> dict[str, Reliability]:
    from baselines.policies.grasp_plan import planner

    seeds = [measured.seed + k for k in range(min(VIEWS, measured.episodes))]
    return curves(judge_candidates(env, seeds, planner(PLANNER), progress=measured.progress))


def episode_objects(env: Any, seeds: Sequence[int]) -> Episodes:
    """The object of each episode, by resetting `env` (unwrapped) with its seed."""
    objects, tags = [], {}
    for seed in seeds:
        env.reset(seed=int(seed))
        objects.append(str(env.object.name))
        tags[objects[-1]] = frozenset(env.object.tags)
    return Episodes(objects, tags)


def groups(episodes: Episodes) -> dict[str, list[str]]:
    """The objects of each tag that there is, and all of them."""
    tagged = {tag: [name for name, tags in episodes.tags.items() if tag in tags] for tag in GROUPS}
    return {tag: names for tag, names in tagged.items() if names} | {"all": list(episodes.tags)}


def object_rates(rows: Sequence[Row], episodes: Episodes) -> dict[str, dict[str, float]]:
    """Object or group → policy → share held; a group's is the mean over its objects, each counting the same."""
    names = np.array(episodes.objects)
    rates = {
        item: {row.policy: float(np.mean(row.values["held"][names == item])) for row in rows} for item in episodes.tags
    }
    means = {
        group: {row.policy: float(np.mean([rates[item][row.policy] for item in of])) for row in rows}
        for group, of in groups(episodes).items()
    }
    return rates | means


def outcome_shares(row: Row) -> dict[str, float]:
    """Outcome → share of the episodes; the shares sum to 1."""
    held, strict = (float(np.mean(row.values[name])) for name in ("held", "strict"))
    return {"strict": strict, "held, moved": held - strict} | {
        name: float(np.mean(row.values[name])) for name in ("dropped", "missed", "collision", "no grasp")
    }


def planning_times(env: Any, policies: Mapping[str, Any], seeds: Sequence[int]) -> dict[str, PlanningTime]:
    """Processor time of `policy.predict` on pinned views, one thread, after `WARM_UP` views that do not count.

    Oracles, which plan from no view, are left out.
    """
    found = {}
    with one_thread():
        for name, policy in policies.items():
            if callable(getattr(policy, "watch", None)):
                continue
            state, spent = None, []
            for seed in [*seeds[:WARM_UP], *seeds]:
                observation, _ = env.reset(seed=int(seed))
                batch = {key: np.asarray(value)[None] for key, value in observation.items()}
                began = time.process_time()
                _, state = policy.predict(batch, state=state, episode_start=np.array([True]), deterministic=True)
                spent.append(time.process_time() - began)
            counted = np.array(spent[min(WARM_UP, len(seeds)) :])
            found[name] = PlanningTime(float(np.median(counted)), float(np.quantile(counted, 0.95)), counted.size)
    return found


@contextmanager
def one_thread() -> Iterator[None]:
    """Numerical libraries, and torch where it is loaded, do with one thread meanwhile."""
    from threadpoolctl import threadpool_limits

    torch = sys.modules.get("torch")
    before = torch.get_num_threads() if torch is not None else 1
    with threadpool_limits(1):
        if torch is not None:
            torch.set_num_threads(1)
        try:
            yield
        finally:
            if torch is not None:
                torch.set_num_threads(before)


def rates_section(rows: Sequence[Row]) -> list[str]:
    """Held and strict by policy."""
    from agents import grasp_plots

    caption = "95 % intervals. Hollow: an oracle. Strict: held, slipped less than 20 mm and turned less than 20°."
    alt = "Share of the episodes in which each policy's grasp held, and held strictly."
    return ["<h2>Held</h2>", page.figure(lambda dark: grasp_plots.rates(rows, GRASPING.paired, dark), alt, caption)]


def outcomes_section(shares: Mapping[str, Mapping[str, float]]) -> list[str]:
    """What became of the grasps."""
    from agents import grasp_plots

    caption = (
        "Held, moved: held at the end, but beyond the strict limits. Dropped: lost while closing, under load or when "
        "shaken. Missed: never between both fingers. Collision: the open gripper met the object on its way. No grasp: "
        "none found, or none that can be tried."
    )
    alt = "Outcomes of each policy's grasps, stacked."
    return ["<h2>What became of them</h2>", page.figure(lambda d: grasp_plots.outcome_bars(shares, d), alt, caption)]


def objects_section(rows: Sequence[Row], episodes: Episodes) -> list[str]:
    """Objects × policies, and the groups' means."""
    rates, counts = object_rates(rows, episodes), {item: episodes.objects.count(item) for item in episodes.tags}
    lines = []
    for item, tags in episodes.tags.items():
        said = page.text(", ".join(sorted(tags)) or "plain")
        lines.append(heat_row(f"{page.text(item)}<small>{said}</small>", rates[item], rows, str(counts[item])))
    for group, of in groups(episodes).items():
        name = f"{page.text(group)}<small>{len(of)} objects</small>"
        lines.append(heat_row(name, rates[group], rows, str(sum(counts[item] for item in of)), "group"))
    most = max(counts.values())
    half = 100.0 * 0.98 / np.sqrt(most)  # Wald's interval at one half, the widest
    notes = [
        f"Held [%]. A single object's share is known to about ± {half:.0f} points at worst ({most} views).",
        "Group rows: means over the objects of a kind; an object can be of several.",
    ]
    head = ["object", *(row.label for row in rows), "views"]
    return ["<h2>Object by object</h2>", page.table(head, lines), page.notes(notes)]


def heat_row(name: str, rates: Mapping[str, float], rows: Sequence[Row], views: str, kind: str = "") -> str:
    """A line of shares in %, a column a row, shaded; a share that is not a number is a dash."""
    known = {i: rates[row.policy] for i, row in enumerate(rows, 1) if np.isfinite(rates[row.policy])}
    cells = [f"{100.0 * known[i]:.0f}" if i in known else "—" for i in range(1, len(rows) + 1)]
    return page.table_row([name, *cells, views], kind, shades=known)


def times_section(times: Mapping[str, PlanningTime]) -> list[str]:
    """What a plan costs."""
    if not times:
        return []
    lines = [
        page.table_row([page.text(name), f"{1e3 * of.median:.1f}", f"{1e3 * of.p95:.1f}", str(of.views)])
        for name, of in times.items()
    ]
    said = "Processor time of one plan, from observation to action, in one thread; the first views warm up."
    head = ["policy", "median [ms]", "95th percentile [ms]", "views"]
    return ["<h2>Planning time</h2>", page.table(head, lines), page.notes([said])]


def calibration_section(reliabilities: Mapping[str, Reliability], views: int) -> list[str]:
    """Predicted against observed."""
    from agents import grasp_plots

    if not reliabilities:
        return []
    count = next(iter(reliabilities.values())).samples
    caption = (
        f"{count} candidates of {PLANNER} on the first {views} pinned views, drawn across the range of their "
        "probability and judged by physics; whiskers are 95 % Wilson intervals (grasps of one view are not quite "
        "independent), the numbers count grasps. The probability knows neither collisions on the way nor gravity’s "
        f"torque: near means a closing line at most {1e3 * NEAR:.0f} mm from the true centre of mass."
    )
    lines = []
    for name, curve in reliabilities.items():
        numbers = (curve.brier, curve.brier_base, curve.calibration_error)
        cells = [page.text(name), *(f"{value:.3f}" for value in numbers), f"{100.0 * curve.base_rate:.1f}"]
        lines.append(page.table_row([*cells, str(curve.samples)]))
    head = ["outcome", "Brier score", "Brier of the base rate", "calibration error", "base rate [%]", "grasps"]
    alt = "Observed share of grasps that held, over their predicted probability of force closure."
    said = (
        "Brier score: mean squared difference of probability and outcome. Calibration error: mean |predicted − "
        "observed| over bins, weighted by their counts."
    )
    return [
        "<h2>Does the probability of force closure tell?</h2>",
        page.figure(lambda dark: grasp_plots.reliability_diagram(reliabilities, dark), alt, caption),
        page.table(head, lines),
        page.notes([said]),
    ]
