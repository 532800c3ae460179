"""`aerograsp bench --robustness`: the same policies under conditions that they were neither tuned nor trained for.

Tables of policies by conditions: what their kind of task is scored by with its interval (`agents.scoring`), and the
crash rate where there is one.
"""

import json
import re
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from agents import page
from agents.bench_setup import DOCK, GRASP_PLAN, setup_of
from agents.files import writable_folder, write_atomic, write_json
from agents.policies import LEARNED, PolicyUnavailable, UnknownName, checkpoints, env_spec, registered_policies, spaces
from agents.provenance import provenance
from agents.rows import RowStore, load_all
from agents.scoring import HOLDING, Column, Scoring
from agents.seeds import TEST_SEED
from agents.table import Row, aligned, caveats, cell, scoring, table_data, with_pooled, without_trainings

TRAINED = "trained"
CHANGES: dict[str, dict[str, dict[str, Any]]] = {  # condition → what differs from the benchmark's
    DOCK: {
        TRAINED: {},
        "no delay": {"command_delay": 0.0},
        "long delay": {"command_delay": (0.14, 0.18)},
        "heavy": {"payload": 1.5},
        "strong wind": {"wind": {"mean_speed": 5.0, "gust_std": 1.75}},
        "light wind": {"wind": "light"},
        "randomised vehicle": {"randomize": True},
        "Firefly": {"airframe": "firefly"},
    },
    GRASP_PLAN: {
        TRAINED: {},
        "no noise": {"depth_camera": {"sigma": 0.0, "sigma_quadratic": 0.0}},
        "3 × noise": {"depth_camera": {"sigma": 0.0015, "sigma_quadratic": 0.0045}},
        "one side hidden": {"depth_camera": {"occluded_probability": 1.0, "occluded_fraction": (0.4, 0.6)}},
        "heavy": {"randomize": {"mass": (1.5, 1.5), "friction": (1.0, 1.0), "noise": (1.0, 1.0)}},
        "slippery": {"randomize": {"mass": (1.0, 1.0), "friction": (0.6, 0.6), "noise": (1.0, 1.0)}},
        "shaken": {"judge": {"shake_acceleration": 8.0}},
    },
}
EPISODES = {DOCK: 40, GRASP_PLAN: 75}  # each of the fifteen test objects from five sides
QUICK_EPISODES = 5
_NOT_DONE = "—"


class Robustness(NamedTuple):
    """What was measured, and where it was written."""

    rows: dict[str, list[Row]]  # condition → a row a policy, the same policies everywhere
    folder: Path
    table: str

    @property
    def report(self) -> Path:
        return self.folder / "robustness.html"

    @property
    def data(self) -> Path:
        return self.folder / "robustness.json"


def default_rows(env_id: str, quick: bool = False) -> list[str]:
    """The analytic policies, of a quick comparison if `quick`, else all and every training seed that is shipped."""
    if quick:
        return [name for name in setup_of(env_id).quick_rows if name in registered_policies(env_id)]
    seeds = [name for name in checkpoints(env_id) if re.fullmatch(rf"({'|'.join(LEARNED)})-seed\d+", name)]
    return [*registered_policies(env_id), *seeds]


def robustness(
    env_id: str = DOCK,
    policies: Sequence[str] | None = None,
    episodes: int | None = None,
    seed: int = TEST_SEED,
    env_kwargs: Mapping[str, Any] | None = None,
    out_dir: str | Path = "runs/bench",
    quick: bool = False,
    fresh: bool = False,
    progress: bool = True,
    command: str = "agents.robustness.robustness",
) -> Robustness:
    """Compare policies under every condition; writes `robustness.json`, `.md` and `.html` into `out_dir`.

    Args:
        env_id: an id of `CHANGES`.
        policies: names for `load_policy`; by default `default_rows`. Training seeds of one kind become one row.
        episodes: per policy and condition, the same ones everywhere; by default `EPISODES`, or 5 if `quick`.
        seed: of episode 0.
        env_kwargs: options of the environment that hold in all conditions, unless a condition changes them.
        out_dir: made if need be; rows that it holds already are not measured again.
        quick: few rows, few short episodes.
        fresh: measure them all the same.
        progress: a bar a row on a terminal, a line a row on standard error.
        command: what to write into the report.

    Raises:
        ValueError: unknown id, policy or option, before anything is run.
        OSError: the folder cannot be written.
    """
    env_spec(env_id)
    setup = setup_of(env_id)
    episodes = (QUICK_EPISODES if quick else EPISODES.get(env_id, 40)) if episodes is None else episodes
    if env_id not in CHANGES:
        raise UnknownName("id with robustness conditions", env_id, CHANGES)
    folder, facts = writable_folder(out_dir), provenance(command)
    base = {**setup.options, **(setup.quick_options if quick else {}), **(env_kwargs or {})}
    conditions = {name: {**base, **changes} for name, changes in CHANGES[env_id].items()}
    for options in conditions.values():
        spaces(env_id, options)  # refuses unknown ones
    loaded = load_all(env_id, list(dict.fromkeys(policies or default_rows(env_id, quick))), base)
    store = RowStore(folder, env_id, episodes, seed, facts, fresh, progress)
    rows = {condition: measured_rows(store, condition, options, loaded) for condition, options in conditions.items()}
    settings = {
        "environment": env_id,
        "options": base,
        "conditions": conditions,
        "episodes": f"{episodes} a policy and condition, the same ones for each",
        "seeds": f"{seed} to {seed + episodes - 1}",
    }
    data = {condition: table_data(of)["rows"] for condition, of in rows.items()}
    write_json(folder / "robustness.json", {"provenance": facts, "settings": settings, "conditions": data})
    write_atomic(folder / "robustness.md", tables_text(rows, CHANGES[env_id], markdown=True) + "\n")
    settings["conditions"] = ", ".join(conditions)
    title = f"{env_id}: policies under other conditions"
    parts = [*section(rows, CHANGES[env_id]), "<h2>How it was measured</h2>", page.facts({**settings, **facts})]
    write_atomic(folder / "robustness.html", page.page(title, parts))
    return Robustness(rows, folder, tables_text(rows, CHANGES[env_id]))


def measured_rows(store: RowStore, condition: str, options: Mapping[str, Any], loaded: Mapping[str, Any]) -> list[Row]:
    """A row a policy under a condition's options; training seeds of one kind become one row.

    Args:
        store: measures them, or has them already.
        condition: its name, for who watches.
        options: of the environment.
        loaded: policies by name, of `agents.rows.load_all`.
    """
    rows = []
    for name, policy in loaded.items():
        if isinstance(policy, PolicyUnavailable):
            rows.append(Row(name, note=f"not run: {policy}"))
        else:
            result = store.row(name, policy, options, f"{condition}, {name}")
            rows.append(Row.of(result, oracle=callable(getattr(policy, "watch", None))))
    return without_trainings(with_pooled(rows))


def summary(rows: Mapping[str, Sequence[Row]]) -> str:
    """A sentence: how the best row of the first condition does under all; "" where there is no best or no other."""
    column, best = _columns(rows)[0], _kind(rows).best([row for row in next(iter(rows.values())) if row.values])
    if best is None or len(rows) < 2:
        return ""
    own = {name: next(row for row in of if row.policy == best.policy) for name, of in rows.items()}
    return (
        f"{best.label}, {column.head}: " + "; ".join(f"{name} {_cell(row, column)}" for name, row in own.items()) + "."
    )


def tables_text(
    rows: Mapping[str, Sequence[Row]], changes: Mapping[str, Mapping[str, Any]], markdown: bool = False
) -> str:
    """The tables of policies by conditions, for a terminal or in Markdown; notes follow the last."""
    tables, notes = [cells(rows, column) for column in _columns(rows)], _notes(rows, changes)
    return "\n\n".join(aligned(lines, notes if lines is tables[-1] else [], markdown).strip() for lines in tables)


def _kind(rows: Mapping[str, Sequence[Row]]) -> Scoring:
    found = scoring([row for of in rows.values() for row in of])
    return found if found.primary is not None else HOLDING


def _columns(rows: Mapping[str, Sequence[Row]]) -> tuple[Column, ...]:
    """What a table each is made of."""
    return _kind(rows).paired


def cells(rows: Mapping[str, Sequence[Row]], column: Column | None = None) -> list[list[str]]:
    """A table: a line a policy, a column a condition; its head first. By default of the kind's first value."""
    shown = column or _columns(rows)[0]
    several = len(_columns(rows)) > 1
    by_policy = zip(*rows.values(), strict=True)
    head = f"policy, {shown.head}" if several else "policy"
    return [[head, *rows], *([of[0].label, *(_cell(row, shown) for row in of)] for of in by_policy)]


def _cell(row: Row, column: Column) -> str:
    if not row.values:
        return _NOT_DONE
    crash = row.estimate("crash")
    crashed = "" if crash is None or crash.value == 0.0 else f" {100.0 * crash.value:.0f} % crash"
    return cell(row, column) + crashed


def _notes(rows: Mapping[str, Sequence[Row]], changes: Mapping[str, Mapping[str, Any]]) -> list[str]:
    notes = [_kind(rows).by_condition]
    notes += caveats([row for of in rows.values() for row in of])
    for name, change in changes.items():
        shown = " ".join(f"{option}={json.dumps(value)}" for option, value in change.items())  # as --env-kwarg takes it
        notes.append(f"{name}: {shown or 'as in the ordinary comparison'}")
    first = next(iter(rows.values()))
    return notes + [f"{row.policy}: {row.remark}" for row in first if row.remark]


def section(rows: Mapping[str, Sequence[Row]], changes: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Tables and plots, and the notes, as parts of an HTML page."""
    from agents import plots

    kind = _kind(rows)
    parts = ["<h2>Policies by conditions</h2>"]
    for column in _columns(rows):
        head, *lines = cells(rows, column)
        best = [kind.best([row for row in of if row.values], column) for of in rows.values()]
        body = []
        for line, of in zip(lines, zip(*rows.values(), strict=True), strict=True):
            marked = [i for i, row in enumerate(of, start=1) if row is best[i - 1]]
            body.append(page.table_row([page.text(line[0]), *map(page.split_interval, line[1:])], best=marked))
        parts.append(page.table(head, body))
        if any(row.estimate(column) for of in rows.values() for row in of):
            caption = f"{column.head} with 95 % intervals."
            if kind.tolerated:
                caption += " Hollow: more than 1 % of the episodes crashed."
            alt = f"{column.head} of every policy under every condition."
            draw = partial(plots.grouped_intervals, rows, column=column, log=kind.lower_is_better)
            parts.append(page.figure(draw, alt, caption))
    return [*parts, page.notes([*_notes(rows, changes), kind.shaded])]
