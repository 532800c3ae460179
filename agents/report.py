"""A comparison as one self-contained HTML page: no scripts, nothing fetched, figures inlined.

`write_report` makes the page; the table alone, as text, Markdown or JSON data, comes from `agents.table` and is
re-exported here.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from agents import page
from agents.files import write_atomic
from agents.statistics import Interval, McNemar, is_binary, mcnemar, paired_difference
from agents.table import (
    Column,
    Estimate,
    Published,
    Row,
    best_row,
    caveats,
    cell,
    columns,
    published_cell,
    scoring,
    table_data,
    table_text,
)

if TYPE_CHECKING:
    from agents.traces import Trace

__all__ = [
    "Column",
    "Estimate",
    "Published",
    "Row",
    "html_report",
    "pairings",
    "table_data",
    "table_text",
    "write_report",
]


def write_report(path: str | Path, **content: Any) -> Path:
    """Write `html_report(**content)` to `path`, atomically. Raises OSError where that cannot be written."""
    return write_atomic(path, html_report(**content))


def html_report(
    *,
    title: str,
    rows: Sequence[Row],
    provenance: Mapping[str, Any],
    settings: Mapping[str, Any] | None = None,
    condition: str = "",
    summary: str = "",
    published: Sequence[Published] = (),
    traces: Sequence["Trace"] = (),
    film: bytes | None = None,
    film_caption: str = "",
    sections: Sequence[str] = (),
) -> str:
    """The page.

    Args:
        title: its heading.
        rows: measured rows, in the order of the table; rows without values are reported with their note.
        provenance: what `agents.provenance.provenance` gives.
        settings: name → value of what was measured (id, episodes, seeds, options), for the reader.
        condition: which of several the rows were measured under.
        summary: what else stands at the top.
        published: figures to stand beside them.
        traces: one pinned episode of some rows.
        film: a GIF to embed.
        film_caption: what it shows.
        sections: HTML of what else was studied, shown after the comparison.

    Raises:
        ValueError: no rows; `film` is not a GIF.
    """
    if not rows:
        raise ValueError("rows: expected at least one")
    if film is not None and film[:4] != b"GIF8":
        raise ValueError("film: expected the bytes of a GIF")
    ran = [row for row in rows if row.values]
    best = best_row(ran)
    parts = [_lead(ran, best, condition), f"<p>{page.text(summary)}</p>" if summary else ""]
    if film is not None:
        parts.append(page.film_figure(film, film_caption))
    heading = f"Comparison: {page.text(condition)}" if condition else "Comparison"
    parts += [f"<h2>{heading}</h2>", _table(rows, published, best), _notes(rows, published)]
    parts += [*_figures(ran, published, traces), *paired(ran), *sections, "<h2>How it was measured</h2>"]
    parts.append(page.facts({**(settings or {}), **provenance}))
    return page.page(title, parts)


def _lead(rows: Sequence[Row], best: Row | None, condition: str) -> str:
    kind = scoring(rows)
    if best is None or kind.primary is None or (estimate := best.estimate(kind.primary)) is None:
        return f'<p class="lead">{len(rows)} policies.</p>'
    show = f"{{:.{kind.primary.digits}f}}".format
    low, high = (show(kind.primary.scale * bound) for bound in estimate.interval)
    said = kind.lead.format(
        policy=f"<strong>{page.text(best.policy)}</strong>",
        value=f"<strong>{show(kind.primary.scale * estimate.value)} {kind.unit}</strong>",
        low=low,
        high=high,
        episodes=estimate.episodes,
        where=f" ({page.text(condition)})" if condition else "",
    )
    return f'<p class="lead">{said}</p>'


def _table(rows: Sequence[Row], published: Sequence[Published], best: Row | None) -> str:
    shown = columns(rows)
    lines = []
    for row in rows:
        if row.values:
            cells = [page.split_interval(cell(row, column)) for column in shown] + [str(row.episodes)]
            kind = "best" if row is best else "oracle" if row.oracle else ""
        else:
            cells, kind = ["—"] * (len(shown) + 1), "missing"
        lines.append(page.table_row([page.text(row.label), *cells], kind))
    for other in published:
        cells = [page.text(published_cell(other, column)) for column in shown] + ["—"]
        lines.append(page.table_row([page.text(other.label), *cells], "published"))
    return page.table(["policy", *(column.head for column in shown), "episodes"], lines)


def _notes(rows: Sequence[Row], published: Sequence[Published]) -> str:
    lines = [scoring(rows).intervals, *caveats(rows)]
    lines += [f"{row.policy}: {row.remark}" for row in rows if row.remark]
    lines += [f"{other.label}: {other.source}" for other in published]
    return page.notes(lines)


def _figures(rows: Sequence[Row], published: Sequence[Published], traces: Sequence["Trace"]) -> list[str]:
    from agents import plots

    parts = []
    if any(row.estimate(name) for row in rows for name in plots.AXES):
        caption = "Whiskers are 95 % intervals; bars that leave the axis carry their value. Hatched: published."
        bars = page.figure(lambda dark: plots.error_bars(rows, published, dark), "Mean |error| per axis.", caption)
        parts += ["<h2>Error per axis</h2>", bars]
    if any(row.estimate("error") for row in rows):
        caption = "One point an episode; box: quartiles and median."
        strips = page.figure(lambda dark: plots.error_strips(rows, dark), "Error of every episode, by policy.", caption)
        parts += ["<h2>Episode by episode</h2>", strips]
    if traces:
        caption = "The first pinned episode, as each policy observed it; a cross marks an early end."
        alt = "Observed position error over time."
        lines = page.figure(lambda dark: plots.error_over_time(traces, dark), alt, caption)
        parts += ["<h2>One episode</h2>", lines]
    return parts


class Pairing(NamedTuple):
    """One row set against the reference row on the same episodes."""

    policy: str
    reference: str
    column: Column
    difference: float  # row − reference
    interval: Interval
    verdict: str  # "better", "worse", "not resolved"
    test: McNemar | None  # of 0/1 values
    episodes: int

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        test = None if self.test is None else {"name": "McNemar, exact", **self.test._asdict()}
        return {**self._asdict(), "column": self.column.name, "interval": list(self.interval), "test": test}


def pairings(rows: Sequence[Row]) -> list[Pairing]:
    """Every row against the reference of its kind of task (`Scoring.reference`), episode by episode.

    A 0/1 value is resolved where McNemar's exact p is below 5 %, another one where the bootstrap interval of the mean
    difference leaves zero.
    """
    kind = scoring(rows)
    if (reference := kind.reference(rows)) is None:
        return []
    found = []
    for row in rows:
        for column in kind.paired:
            a, b = row.values.get(column.name, np.empty(0)), reference.values[column.name]
            if row is reference or a.shape != b.shape or not (both := np.isfinite(a) & np.isfinite(b)).any():
                continue
            difference = paired_difference(a[both], b[both])
            test = mcnemar(a[both], b[both]) if is_binary(a[both]) and is_binary(b[both]) else None
            resolved = difference.significant if test is None else test.p < 0.05
            better = (difference.estimate < 0.0) == kind.lower_is_better
            verdict = "not resolved" if not resolved else "better" if better else "worse"
            found.append(Pairing(row.policy, reference.policy, column, *difference, verdict, test, int(both.sum())))
    return found


def paired(rows: Sequence[Row]) -> list[str]:
    """`pairings` as parts of the page; none where there is nothing to pair."""
    kind, found = scoring(rows), pairings(rows)
    reference = kind.reference(rows)
    if not found or reference is None:
        return []
    labels = {row.policy: row.label for row in rows}
    tested = any(pair.test is not None for pair in found)
    parts = [f"<h2>Paired with {page.text(reference.policy)}</h2>"]
    parts.append("<p>Mean differences on the same episodes, policy minus reference.</p>")
    for column in kind.paired:
        lines = [_pairing_row(labels[pair.policy], pair, tested) for pair in found if pair.column is column]
        tests = ["only it", f"only {reference.policy}", "McNemar p"] if tested else []
        head = ["policy", difference_head(column), "95 % interval", *tests, "", "episodes"]
        parts.append(page.table(head, lines))
    if tested:
        parts.append(
            page.notes(["“Only”: episodes in which one of the two succeeded and the other did not; p: exact."])
        )
    return parts


def difference_head(column: Column) -> str:
    """What stands over differences of a column."""
    name, _, unit = column.head.partition(" [")
    unit = "points" if unit == "%]" else unit.rstrip("]")
    return f"{name}: difference [{unit}]" if unit else f"{name}: difference"


def _pairing_row(label: str, pair: Pairing, tested: bool) -> str:
    return page.table_row([page.text(label), *pairing_cells(pair, tested)])


def pairing_cells(pair: Pairing, tested: bool) -> list[str]:
    """Difference, interval, the test's figures if `tested`, verdict and episodes, as HTML."""
    show = f"{{:+.{pair.column.digits}f}}".format
    low, high = (show(pair.column.scale * bound) for bound in pair.interval)
    cells = [show(pair.column.scale * pair.difference), f"[{low}, {high}]"]
    if tested:
        test = pair.test
        p = "" if test is None else "< 0.0001" if test.p < 1e-4 else f"{test.p:.4f}"
        cells += ["—"] * 3 if test is None else [str(test.only_a), str(test.only_b), page.text(p)]
    return [*cells, pair.verdict, str(pair.episodes)]
