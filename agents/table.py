"""Rows of a comparison, their summaries, and the table of them as text, Markdown or cells for HTML."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.evaluation import EvaluationResult
from agents.policies import LEARNED
from agents.scoring import Column, Scoring, columns_of, median_of, scoring_of
from agents.statistics import Interval

ORACLE_NOTE = "an oracle: it reads the simulator's truth, bounds what is possible, and is never called the best"


@dataclass(frozen=True)
class Row:
    """One policy of a comparison."""

    policy: str
    values: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)  # name → (E,) by episode; empty: not run
    note: str = ""  # why it was not run, or what there is to know about it
    oracle: bool = False  # reads the simulator's truth (`aerograsp_env.interfaces.Oracle`)

    @classmethod
    def of(cls, result: EvaluationResult, note: str = "", oracle: bool = False) -> "Row":
        """The row of a result, with a 0/1 value for each outcome that its kind of task counts."""
        values = {name: result.values(name) for name in result.names}
        return cls(result.policy, values | scoring_of(values).indicators(result.terminations), note, oracle)

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

    @property
    def label(self) -> str:
        """The policy as a table names it."""
        return f"{self.policy} (oracle)" if self.oracle else self.policy

    @property
    def remark(self) -> str:
        """The note, with what an oracle is."""
        return "; ".join(filter(None, (ORACLE_NOTE if self.oracle else "", self.note)))

    def estimate(self, column: Column | str) -> "Estimate | None":
        """What a column shows: by name the mean, over the episodes in which the value is defined; None if in none."""
        if isinstance(column, str):
            column = Column(column, column)
        sample = column.sample(self.values)
        return Estimate(*column.estimator(sample), sample.size) if sample.size else None


class Estimate(NamedTuple):
    """A mean (or what else a column estimates), its 95 % interval, and the number of episodes it is over."""

    value: float
    interval: Interval
    episodes: int


class Published(NamedTuple):
    """A published row to stand beside the measured ones."""

    label: str
    values: Mapping[str, tuple[float, float]]  # name → mean and spread (standard deviation)
    source: str  # citation, and how its conditions differ


def scoring(rows: Sequence[Row]) -> Scoring:
    """The kind of task that these rows are of."""
    return scoring_of({name for row in rows for name in row.values})


def columns(rows: Sequence[Row]) -> list[Column]:
    """The columns that these rows have (`agents.scoring.columns_of`)."""
    return columns_of({name for row in rows for name in row.values})


def best_row(rows: Sequence[Row]) -> Row | None:
    """The best row that is no oracle (`agents.scoring.Scoring.best`)."""
    return scoring(rows).best(rows)


def cell(row: Row, column: Column) -> str:
    """What a table shows: mean, interval, and "(n)" where only n of the episodes define the value."""
    estimate = row.estimate(column)
    if estimate is None:
        return "—"
    show = f"{{:.{column.digits}f}}".format
    text = show(column.scale * estimate.value)
    if column.interval:
        text += f" [{', '.join(show(column.scale * bound) for bound in estimate.interval)}]"
    return text if column.given or estimate.episodes == row.episodes else f"{text} ({estimate.episodes})"


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


def without_trainings(rows: Sequence[Row]) -> list[Row]:
    """The rows without the single trainings that a pooled row stands for."""
    kinds = [row.policy.partition(" (")[0] for row in rows if " (" in row.policy]
    return [row for row in rows if not any(re.fullmatch(rf"{re.escape(kind)}-seed\d+", row.policy) for kind in kinds)]


def caveats(rows: Sequence[Row]) -> list[str]:
    """What a reader must know about values over a part of the episodes or of their time."""
    notes = []
    whole = [column for column in columns(rows) if not column.given]
    if any(0 < column.sample(row.values).size < row.episodes for row in rows for column in whole):
        notes.append(scoring(rows).undefined)
    if any((row.values.get("crash", np.zeros(1)) > 0.0).any() for row in rows):
        notes.append("An episode that crashed counts with its errors before the crash: read errors beside crash rates.")
    return notes


def table_text(rows: Sequence[Row], markdown: bool = False, published: Sequence[Published] = ()) -> str:
    """The comparison as aligned text for a terminal, or as a Markdown table; notes follow it."""
    shown = columns(rows)
    lines = [["policy", *(column.head for column in shown), "episodes"]]
    for row in rows:
        cells = [cell(row, column) for column in shown] if row.values else ["—"] * len(shown)
        lines.append([row.label, *cells, str(row.episodes or "—")])
    for other in published:
        lines.append([other.label, *(published_cell(other, column) for column in shown), "—"])
    notes = [f"{row.policy}: {row.remark}" for row in rows if row.remark]
    notes += [f"{other.label}: {other.source}" for other in published]
    notes += caveats(rows)
    if any(column.interval for column in shown):
        notes.insert(0, scoring(rows).intervals)
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
    shown = {column.name: column for column in columns(rows)}
    return {
        "rows": [
            {
                "policy": row.policy,
                "note": row.note,
                "oracle": row.oracle,
                "episodes": row.episodes,
                "summary": {
                    name: summary
                    for name in row.values
                    if (summary := _summary(row, shown.get(name, Column(name, name)))) is not None
                },
                "values": dict(row.values),
            }
            for row in rows
        ],
        "published": [other._asdict() for other in published],
    }


def _summary(row: Row, column: Column) -> dict[str, Any] | None:
    if (estimate := row.estimate(column)) is None:
        return None
    value, (low, high), episodes = estimate
    what = "median" if column.estimator is median_of else "mean"
    given = {"given": column.given} if column.given else {}
    return {what: value, "low": low, "high": high, "episodes": episodes, **given}
