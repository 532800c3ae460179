"""Rows of a comparison, their summaries, and the table of them as text, Markdown or cells for HTML."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.evaluation import EvaluationResult
from agents.policies import LEARNED
from agents.statistics import Interval, bootstrap_interval, mean


@dataclass(frozen=True)
class Row:
    """One policy of a comparison."""

    policy: str
    values: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)  # name → (E,) by episode; empty: not run
    note: str = ""  # why it was not run, or what there is to know about it

    @classmethod
    def of(cls, result: EvaluationResult, note: str = "") -> "Row":
        """The row of a result."""
        return cls(result.policy, {name: result.values(name) for name in result.names}, note)

    @classmethod
    def pooled(cls, policy: str, rows: Sequence["Row"], note: str = "") -> "Row":
        """Several training seeds as one row: each episode's values averaged over the seeds.

        The interval of such a row is the cluster bootstrap over episodes; it holds for these trained policies.
        """
        names = [name for name in rows[0].values if all(name in row.values for row in rows)]
        return cls(policy, {name: np.mean([row.values[name] for row in rows], axis=0) for name in names}, note)

    @property
    def episodes(self) -> int:
        return len(next(iter(self.values.values()), ()))

    def estimate(self, name: str) -> "Estimate | None":
        """Mean and 95 % interval over the episodes in which the value is defined; None if there is none."""
        values = self.values.get(name, np.empty(0))
        values = values[np.isfinite(values)]
        if values.size == 0:
            return None
        return Estimate(float(mean(values)), bootstrap_interval(values, 0, mean), values.size)


class Estimate(NamedTuple):
    """A mean, its interval, and the number of episodes it is over."""

    mean: float
    interval: Interval
    episodes: int


class Published(NamedTuple):
    """A published row to stand beside the measured ones."""

    label: str
    values: Mapping[str, tuple[float, float]]  # name → mean and spread (standard deviation)
    source: str  # citation, and how its conditions differ


class Column(NamedTuple):
    """How one value is shown."""

    name: str
    head: str
    scale: float = 1.0
    digits: int = 3
    interval: bool = False


COLUMNS = (
    Column("error_x", "|error| x [mm]", 1e3, 1, True),
    Column("error_y", "|error| y [mm]", 1e3, 1, True),
    Column("error_z", "|error| z [mm]", 1e3, 1, True),
    Column("error", "|error| [mm]", 1e3, 1, True),
    Column("success", "success [%]", 1e2, 0),
    Column("crash", "crash [%]", 1e2, 0),
    Column("effort", "effort"),
)
_OTHERS = Column("returns", "return", 1.0, 2, True)


def columns(rows: Sequence[Row]) -> list[Column]:
    """The columns that these rows have: the known ones in their order, else return, success and every metric."""
    names = {name for row in rows for name in row.values}
    known = [column for column in COLUMNS if column.name in names]
    if any(column.name == "error" for column in known) or not names:
        return known or list(COLUMNS)
    others = sorted(names - {column.name for column in COLUMNS} - {"returns", "lengths"})
    return [_OTHERS, *known, *(Column(name, name, interval=True) for name in others)]


def best_row(rows: Sequence[Row]) -> Row | None:
    """The row of the lowest error, among those whose every episode defines one and at most 1 % of them crash.

    An episode that crashes has its error over the time before only, which flatters a policy that crashes early.
    """
    safe = [row for row in rows if np.isfinite(row.values.get("error", np.array([np.nan]))).all()]
    safe = [row for row in safe if np.mean(row.values.get("crash", np.zeros(1))) <= 0.01]
    return min(safe, key=lambda row: float(np.mean(row.values["error"])), default=None)


def cell(row: Row, column: Column) -> str:
    """What a table shows: mean, interval, and "(n)" where only n of the episodes define the value."""
    estimate = row.estimate(column.name)
    if estimate is None:
        return "—"
    show = f"{{:.{column.digits}f}}".format
    text = show(column.scale * estimate.mean)
    if column.interval:
        text += f" [{', '.join(show(column.scale * bound) for bound in estimate.interval)}]"
    return text if estimate.episodes == row.episodes else f"{text} ({estimate.episodes})"


def published_cell(row: Published, column: Column) -> str:
    """Mean ± spread of a published value."""
    if column.name not in row.values:
        return "—"
    return " ± ".join(f"{column.scale * value:.{column.digits}f}" for value in row.values[column.name])


def with_pooled(rows: Sequence[Row]) -> list[Row]:
    """The rows, and after the training seeds of one kind a row over all of them."""
    pooled = list(rows)
    for kind in LEARNED:
        seeds = [row for row in rows if row.values and re.fullmatch(rf"{kind}-seed\d+", row.policy)]
        if len(seeds) > 1:
            note = f"each episode averaged over {len(seeds)} trainings"
            pooled.insert(pooled.index(seeds[-1]) + 1, Row.pooled(f"{kind} ({len(seeds)} seeds)", seeds, note))
    return pooled


def caveats(rows: Sequence[Row]) -> list[str]:
    """What a reader must know about values over a part of the episodes or of their time."""
    notes = []
    estimates = [(row, row.estimate(column.name)) for row in rows for column in columns(rows)]
    if any(estimate is not None and estimate.episodes < row.episodes for row, estimate in estimates):
        notes.append("(n): over the n episodes that lasted long enough to define it.")
    if any((row.values.get("crash", np.zeros(1)) > 0.0).any() for row in rows):
        notes.append("An episode that crashed counts with its errors before the crash: read errors beside crash rates.")
    return notes


def table_text(rows: Sequence[Row], markdown: bool = False, published: Sequence[Published] = ()) -> str:
    """The comparison as aligned text for a terminal, or as a Markdown table; notes follow it."""
    shown = columns(rows)
    lines = [["policy", *(column.head for column in shown), "episodes"]]
    for row in rows:
        cells = [cell(row, column) for column in shown] if row.values else ["—"] * len(shown)
        lines.append([row.policy, *cells, str(row.episodes or "—")])
    for other in published:
        lines.append([other.label, *(published_cell(other, column) for column in shown), "—"])
    notes = [f"{row.policy}: {row.note}" for row in rows if row.note]
    notes += [f"{other.label}: {other.source}" for other in published]
    notes += caveats(rows)
    if any(column.interval for column in shown):
        notes.insert(0, "Means over episodes, with 95 % bootstrap intervals in brackets.")
    return aligned(lines, notes, markdown)


def aligned(lines: Sequence[Sequence[str]], notes: Sequence[str], markdown: bool = False) -> str:
    """Lines of cells, the head first, as text in columns or as a Markdown table; notes below."""
    if markdown:
        head, *body = [[text.replace("|", "\\|") for text in line] for line in lines]
        rows = [head, ["---", *["---:"] * (len(head) - 1)], *body]
        return "\n".join(["| " + " | ".join(line) + " |" for line in rows] + [""] + [f"- {note}" for note in notes])
    widths = [max(len(line[i]) for line in lines) for i in range(len(lines[0]))]
    texts = [
        "  ".join(
            text.ljust(width) if i == 0 else text.rjust(width)
            for i, (text, width) in enumerate(zip(line, widths, strict=True))
        )
        for line in lines
    ]
    rule = "─" * len(texts[0])
    return "\n".join([texts[0], rule, *texts[1:], rule, *notes])


def table_data(rows: Sequence[Row], published: Sequence[Published] = ()) -> dict[str, Any]:
    """The comparison for JSON: per row every estimate and the per-episode values."""
    return {
        "rows": [
            {
                "policy": row.policy,
                "note": row.note,
                "episodes": row.episodes,
                "summary": {
                    name: {"mean": e.mean, "low": e.interval.low, "high": e.interval.high, "episodes": e.episodes}
                    for name in row.values
                    if (e := row.estimate(name)) is not None
                },
                "values": dict(row.values),
            }
            for row in rows
        ],
        "published": [other._asdict() for other in published],
    }
