"""What `aerograsp bench` adds to the reports of the tasks of arms.

All conditions in one table, what became of the episodes that failed, object by object, differences between rows on the
same episodes, how far docking helps, and films of the best and the worst episode.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from agents import page
from agents.bench_setup import Condition, Measured, Study
from agents.grasp_report import heat_row
from agents.manipulation_films import films_section, reference
from agents.report import difference_head, pairing_cells, pairings
from agents.robustness import section
from agents.scoring import CAUSES
from agents.statistics import Interval
from agents.table import Row

CAUSE_COLORS = {
    "success": "#2f8f5b",
    "missed": "#e8833a",
    "slipped": "#e8b13a",
    "collided": "#c4557c",
    "jammed": "#8a6fd1",
    "timed out": "#8a8f96",
}
DOCKED = "docked"
LIMITS = {"hovering on vision": 1.0, "hovering on GPS": 1.0 / 3.0}  # of the docked error over the hovering one, wanted
RESAMPLES = 2000


class Ratio(NamedTuple):
    """Mean error of a policy under one condition over that under another, on the same seeds."""

    policy: str
    condition: str
    other: str
    value: float
    interval: Interval
    wanted: float
    episodes: int


def study(measured: Measured) -> Study:
    """Conditions, paired differences, films."""
    sections = [*films_section(measured), *conditions_section(measured.conditions), *paired_section(measured)]
    return Study(sections, {})


def lifting_study(measured: Measured) -> Study:
    """The same, causes of failures and objects."""
    objects = episode_objects(measured)
    sections = [
        *films_section(measured),
        *conditions_section(measured.conditions),
        *causes_section(measured.conditions),
        *objects_section(measured, objects),
        *paired_section(measured),
    ]
    data = {
        "outcomes": {name: outcomes(of.rows) for name, of in measured.conditions.items()},
        "objects": {name: names.tolist() for name, names in objects.items()},
        "success_by_object": object_rates(measured.conditions, objects),
    }
    return Study(sections, data)


def docked_study(measured: Measured) -> Study:
    """The same as `study`, and how the docked error compares with the hovering ones."""
    found = ratios(measured.conditions)
    common = study(measured)
    return Study([*ratios_section(found), *common.sections], {"ratios": [ratio._asdict() for ratio in found]})


def conditions_section(conditions: Mapping[str, Condition]) -> list[str]:
    """Policies by conditions, where there are several."""
    if len(conditions) < 2:
        return []
    return section({name: of.rows for name, of in conditions.items()}, {n: of.changes for n, of in conditions.items()})


def paired_section(measured: Measured) -> list[str]:
    """Every row against the reference row, condition by condition but the first, which the page has already."""
    others = list(measured.conditions.items())[1:]
    found = [(name, of, pair) for name, of in others for pair in pairings([row for row in of.rows if row.values])]
    if not found:
        return []
    tested = any(pair.test is not None for *_, pair in found)
    lines = []
    for name, of, pair in found:
        label = next(row.label for row in of.rows if row.policy == pair.policy)
        cells = [page.text(f"{name}: {label}"), page.text(pair.reference), *pairing_cells(pair, tested)]
        lines.append(page.table_row(cells))
    head = ["condition: policy", "reference", difference_head(found[0][2].column), "95 % interval"]
    if tested:
        head += ["only it", "only reference", "McNemar p"]
    said = ["Mean differences on the same episodes, policy minus reference (the best analytic row of the condition)."]
    if tested:
        said.append("“Only”: episodes in which one of the two succeeded and the other did not; p: exact.")
    return ["<h2>Paired, other conditions</h2>", page.table([*head, "", "episodes"], lines), page.notes(said)]


def outcomes(rows: Sequence[Row]) -> dict[str, dict[str, float]]:
    """Row → success and every cause of failure → share of the episodes; they sum to 1."""
    return {
        row.label: {name: float(np.mean(row.values[name])) for name in ("success", *CAUSES)}
        for row in rows
        if {"success", *CAUSES} <= set(row.values)
    }


def causes_section(conditions: Mapping[str, Condition]) -> list[str]:
    """What became of the episodes, stacked and as numbers, a group of lines a condition."""
    from agents import grasp_plots

    shares = {name: outcomes(of.rows) for name, of in conditions.items()}
    if not any(shares.values()):
        return []
    bars = {
        f"{name}: {label}" if name else label: {outcome.replace("_", " "): share for outcome, share in of.items()}
        for name, rows in shares.items()
        for label, of in rows.items()
    }
    caption = (
        "Missed: the jaws closed on nothing. Slipped: held or lifted, then lost. Collided: the vehicle or its arm "
        "struck something, or the object was pushed off. Jammed: held but not lifted, or a servo overloaded. Timed "
        "out: still at it."
    )
    draw = partial(grasp_plots.outcome_bars, bars, colors=CAUSE_COLORS)
    lines = []
    for name, of in conditions.items():
        for row in of.rows:
            if row.label not in shares[name]:
                continue
            crash = row.estimate("crash")
            figures = [*shares[name][row.label].values(), 0.0 if crash is None else crash.value]
            label = page.text(f"{name}: {row.label}" if name else row.label)
            lines.append(page.table_row([label, *(f"{100.0 * figure:.1f}" for figure in figures), str(row.episodes)]))
    head = ["policy", "success [%]", *(f"{cause.replace('_', ' ')} [%]" for cause in CAUSES), "crash [%]", "episodes"]
    alt = "Successes and causes of failure of each policy under each condition, stacked."
    said = "A cause each failure; crashes, of the vehicle, are a part of the collided ones."
    parts = ["<h2>What became of the episodes</h2>", page.figure(draw, alt, caption)]
    return [*parts, page.table(head, lines), page.notes([said])]


def episode_objects(measured: Measured) -> dict[str, NDArray[np.str_]]:
    """Condition → (E,) the object's name in each episode, by resetting; none where the id does not say."""
    found: dict[str, NDArray[np.str_]] = {}
    for name, of in measured.conditions.items():
        env = gymnasium.make(measured.env_id, disable_env_checker=True, **of.options).unwrapped
        try:
            names = [env.reset(seed=measured.seed + k)[1].get("object", "") for k in range(measured.episodes)]
        finally:
            env.close()
        if all(names):
            found[name] = np.array(names, dtype=np.str_)
    return found


def object_rates(
    conditions: Mapping[str, Condition], objects: Mapping[str, NDArray[np.str_]]
) -> dict[str, dict[str, dict[str, float]]]:
    """Condition → object → row → share of success."""
    return {
        name: {
            str(item): {
                row.policy: float(np.mean(row.values["success"][objects[name] == item]))
                for row in of.rows
                if row.values
            }
            for item in np.unique(objects[name])
        }
        for name, of in conditions.items()
        if name in objects
    }


def objects_section(measured: Measured, objects: Mapping[str, NDArray[np.str_]]) -> list[str]:
    """Objects × policies over all conditions, and objects × conditions of the reference policy."""
    conditions = {name: of for name, of in measured.conditions.items() if name in objects}
    if not conditions or len({item for names in objects.values() for item in names.tolist()}) < 2:
        return []
    names = np.concatenate([objects[name] for name in conditions])
    rows = [
        Row(row.policy, {"success": np.concatenate(values)}, oracle=row.oracle)
        for i, row in enumerate(next(iter(conditions.values())).rows)
        if all("success" in (of.rows[i].values) for of in conditions.values())
        and (values := [of.rows[i].values["success"] for of in conditions.values()])
    ]
    items, counts = np.unique(names, return_counts=True)

    def line(item: str, chosen: NDArray[np.bool_], kind: str = "") -> str:
        rates = {row.policy: float(np.mean(row.values["success"][chosen])) for row in rows}
        return heat_row(page.text(item), rates, rows, str(int(chosen.sum())), kind)

    lines = [*(line(str(item), names == item) for item in items), line("all", np.ones(names.size, bool), "group")]
    half = 100.0 * 0.98 / np.sqrt(counts.min())  # Wald's interval at one half, the widest
    said = f"Success [%], over all conditions. One object’s share is known to about ± {half:.0f} points at worst."
    parts = ["<h2>Object by object</h2>"]
    parts += [page.table(["object", *(row.label for row in rows), "episodes"], lines), page.notes([said])]
    analytic = reference(next(iter(conditions.values())).rows, measured.env_id)
    if analytic is None or len(conditions) < 2:
        return parts
    columns = [Row(name) for name in conditions]
    lines = []
    for item in items:
        rates = {}
        for name, of in conditions.items():
            row = next(row for row in of.rows if row.policy == analytic.policy)
            chosen = objects[name] == item
            rates[name] = float(np.mean(row.values["success"][chosen])) if chosen.any() else float("nan")
        lines.append(heat_row(page.text(item), rates, columns, str(int((names == item).sum()))))
    return [
        *parts,
        f"<h2>Object by object, {page.text(analytic.policy)}</h2>",
        page.table(["object", *conditions, "episodes"], lines),
    ]


def ratios(conditions: Mapping[str, Condition], name: str = "error") -> list[Ratio]:
    """The docked mean of a value over that under each of the conditions of `LIMITS`, policy by policy.

    With a percentile bootstrap over the episodes, which share their seeds.
    """
    if (docked := conditions.get(DOCKED)) is None:
        return []
    found = []
    for other, wanted in LIMITS.items():
        if other not in conditions:
            continue
        by_policy = {row.policy: row for row in conditions[other].rows}
        for row in docked.rows:
            a, b = (of.values.get(name, np.empty(0)) for of in (row, by_policy[row.policy]))
            if a.shape != b.shape or not (both := np.isfinite(a) & np.isfinite(b)).any():
                continue
            draws = np.random.default_rng(0).integers(both.sum(), size=(RESAMPLES, both.sum()))
            spread = a[both][draws].mean(axis=1) / b[both][draws].mean(axis=1)
            interval = Interval(*np.quantile(spread, [0.025, 0.975]).tolist())
            value = float(a[both].mean() / b[both].mean())
            found.append(Ratio(row.label, DOCKED, other, value, interval, wanted, int(both.sum())))
    return found


def ratios_section(found: Sequence[Ratio]) -> list[str]:
    """The ratios as a table."""
    if not found:
        return []
    lines = []
    for of in found:
        low, high = of.interval
        verdict = "met" if of.value <= of.wanted else "missed"
        cells = [f"{of.value:.2f}", f"[{low:.2f}, {high:.2f}]", f"≤ {of.wanted:.2f}", verdict, str(of.episodes)]
        lines.append(page.table_row([page.text(f"{of.policy}, {of.condition} / {of.other}"), *cells]))
    head = ["mean error", "ratio", "95 % interval", "wanted", "", "episodes"]
    return ["<h2>What docking gives</h2>", page.table(head, lines)]
