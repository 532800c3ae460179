"""`aerograsp bench --robustness`: the same policies under conditions that they were neither tuned nor trained for.

One table, policies by conditions: mean |error| with its interval, and the crash rate where there is one.
"""

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from agents import page
from agents.benchmark import CONDITIONS, DOCK
from agents.files import writable_folder, write_atomic, write_json
from agents.policies import LEARNED, PolicyUnavailable, UnknownName, checkpoints, env_spec, registered_policies, spaces
from agents.provenance import provenance
from agents.rows import RowStore, load_all
from agents.seeds import TEST_SEED
from agents.table import Column, Row, aligned, best_row, caveats, cell, table_data, with_pooled

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
    }
}
EPISODES = 40
ERROR = Column("error", "mean |error| [mm]", 1e3, 1, True)
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


def default_rows(env_id: str) -> list[str]:
    """The analytic policies, and every training seed that is shipped."""
    seeds = [name for name in checkpoints(env_id) if re.fullmatch(rf"({'|'.join(LEARNED)})-seed\d+", name)]
    return [*registered_policies(env_id), *seeds]


def robustness(
    env_id: str = DOCK,
    policies: Sequence[str] | None = None,
    episodes: int | None = None,
    seed: int = TEST_SEED,
    env_kwargs: Mapping[str, Any] | None = None,
    out_dir: str | Path = "runs/bench",
    fresh: bool = False,
    progress: bool = True,
    command: str = "agents.robustness.robustness",
) -> Robustness:
    """Compare policies under every condition; writes `robustness.json`, `.md` and `.html` into `out_dir`.

    Args:
        env_id: an id of `CHANGES`.
        policies: names for `load_policy`; by default `default_rows`. Training seeds of one kind become one row.
        episodes: per policy and condition, the same ones everywhere; 40.
        seed: of episode 0.
        env_kwargs: options of the environment that hold in all conditions, unless a condition changes them.
        out_dir: made if need be; rows that it holds already are not measured again.
        fresh: measure them all the same.
        progress: a bar a row on a terminal, a line a row on standard error.
        command: what to write into the report.

    Raises:
        ValueError: unknown id, policy or option, before anything is run.
        OSError: the folder cannot be written.
    """
    env_spec(env_id)
    episodes = EPISODES if episodes is None else episodes
    if env_id not in CHANGES:
        raise UnknownName("id with robustness conditions", env_id, CHANGES)
    folder, facts = writable_folder(out_dir), provenance(command)
    base = {**CONDITIONS.get(env_id, {}), **(env_kwargs or {})}
    conditions = {name: {**base, **changes} for name, changes in CHANGES[env_id].items()}
    for options in conditions.values():
        spaces(env_id, options)  # refuses unknown ones
    loaded = load_all(env_id, list(dict.fromkeys(policies or default_rows(env_id))), base)
    store = RowStore(folder, env_id, episodes, seed, facts, fresh, progress)
    rows = {condition: _rows(store, condition, options, loaded) for condition, options in conditions.items()}
    settings = {
        "environment": env_id,
        "options": base,
        "conditions": conditions,
        "episodes": f"{episodes} a policy and condition, the same ones for each",
        "seeds": f"{seed} to {seed + episodes - 1}",
    }
    data = {condition: table_data(of)["rows"] for condition, of in rows.items()}
    write_json(folder / "robustness.json", {"provenance": facts, "settings": settings, "conditions": data})
    lines, notes = cells(rows), _notes(rows, CHANGES[env_id])
    write_atomic(folder / "robustness.md", aligned(lines, notes, markdown=True) + "\n")
    settings["conditions"] = ", ".join(conditions)
    title = f"{env_id}: policies under other conditions"
    parts = [*section(rows, CHANGES[env_id]), "<h2>How it was measured</h2>", page.facts({**settings, **facts})]
    write_atomic(folder / "robustness.html", page.page(title, parts))
    return Robustness(rows, folder, aligned(lines, notes))


def _rows(store: RowStore, condition: str, options: Mapping[str, Any], loaded: Mapping[str, Any]) -> list[Row]:
    rows = []
    for name, policy in loaded.items():
        if isinstance(policy, PolicyUnavailable):
            rows.append(Row(name, note=f"not run: {policy}"))
        else:
            rows.append(Row.of(store.row(name, policy, options, f"{condition}, {name}")))
    pooled = with_pooled(rows)
    kinds = [row.policy.partition(" (")[0] for row in pooled if row not in rows]
    return [row for row in pooled if not any(re.fullmatch(rf"{kind}-seed\d+", row.policy) for kind in kinds)]


def cells(rows: Mapping[str, Sequence[Row]]) -> list[list[str]]:
    """The table: a line a policy, a column a condition; its head first."""
    by_policy = zip(*rows.values(), strict=True)
    return [["policy", *rows], *([of[0].policy, *map(_cell, of)] for of in by_policy)]


def _cell(row: Row) -> str:
    if not row.values:
        return _NOT_DONE
    crash = row.estimate("crash")
    crashed = "" if crash is None or crash.value == 0.0 else f" {100.0 * crash.value:.0f} % crash"
    return cell(row, ERROR) + crashed


def _notes(rows: Mapping[str, Sequence[Row]], changes: Mapping[str, Mapping[str, Any]]) -> list[str]:
    notes = ["Mean |error| per axis over episodes [mm], 95 % bootstrap intervals in brackets; crash rates where any."]
    notes += caveats([row for of in rows.values() for row in of])
    for name, change in changes.items():
        shown = " ".join(f"{option}={json.dumps(value)}" for option, value in change.items())  # as --env-kwarg takes it
        notes.append(f"{name}: {shown or 'as in the ordinary comparison'}")
    first = next(iter(rows.values()))
    return notes + [f"{row.policy}: {row.note}" for row in first if row.note]


def section(rows: Mapping[str, Sequence[Row]], changes: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """The table, its notes and the plot, as parts of an HTML page."""
    from agents import plots

    head, *lines = cells(rows)
    best = [best_row([row for row in of if row.values]) for of in rows.values()]
    body = []
    for line, of in zip(lines, zip(*rows.values(), strict=True), strict=True):
        marked = [i for i, row in enumerate(of, start=1) if row is best[i - 1]]
        body.append(page.table_row([page.text(line[0]), *map(page.split_interval, line[1:])], best=marked))
    parts = ["<h2>Policies by conditions</h2>", page.table(head, body)]
    parts.append(page.notes([*_notes(rows, changes), "Shaded: the lowest error with at most 1 % of crashes."]))
    if any(row.estimate("error") for of in rows.values() for row in of):
        caption = "Means with 95 % intervals. Hollow: more than 1 % of the episodes crashed."
        alt = "Mean error of every policy under every condition."
        parts.append(page.figure(lambda dark: plots.grouped_intervals(rows, dark), alt, caption))
    return parts
