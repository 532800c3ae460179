"""A comparison as one self-contained HTML page: no scripts, nothing fetched, figures inlined.

`write_report` makes the page; the table alone, as text, Markdown or JSON data, comes from `agents.table` and is
re-exported here.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from agents import page
from agents.files import write_atomic
from agents.statistics import paired_difference
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
    table_data,
    table_text,
)

if TYPE_CHECKING:
    from agents.traces import Trace

__all__ = ["Column", "Estimate", "Published", "Row", "html_report", "table_data", "table_text", "write_report"]


def write_report(path: str | Path, **content: Any) -> Path:
    """Write `html_report(**content)` to `path`, atomically. Raises OSError where that cannot be written."""
    return write_atomic(path, html_report(**content))


def html_report(
    *,
    title: str,
    rows: Sequence[Row],
    provenance: Mapping[str, Any],
    settings: Mapping[str, Any] | None = None,
    published: Sequence[Published] = (),
    traces: Sequence["Trace"] = (),
    film: bytes | None = None,
    film_caption: str = "",
) -> str:
    """The page.

    Args:
        title: its heading.
        rows: measured rows, in the order of the table; rows without values are reported with their note.
        provenance: what `agents.provenance.provenance` gives.
        settings: name → value of what was measured (id, episodes, seeds, options), for the reader.
        published: figures to stand beside them.
        traces: one pinned episode of some rows.
        film: a GIF to embed.
        film_caption: what it shows.

    Raises:
        ValueError: no rows; `film` is not a GIF.
    """
    if not rows:
        raise ValueError("rows: expected at least one")
    if film is not None and film[:4] != b"GIF8":
        raise ValueError("film: expected the bytes of a GIF")
    ran = [row for row in rows if row.values]
    best = best_row(ran)
    parts = [_lead(ran, best)]
    if film is not None:
        parts.append(page.film_figure(film, film_caption))
    parts += ["<h2>Comparison</h2>", _table(rows, published, best), _notes(rows, published)]
    parts += _figures(ran, published, traces) + [_paired(ran, best), "<h2>How it was measured</h2>"]
    parts.append(page.facts({**(settings or {}), **provenance}))
    return page.page(title, parts)


def _lead(rows: Sequence[Row], best: Row | None) -> str:
    if best is None or (estimate := best.estimate("error")) is None:
        return f'<p class="lead">{len(rows)} policies.</p>'
    low, high = (f"{1e3 * bound:.1f}" for bound in estimate.interval)
    return (
        f'<p class="lead">The lowest error without crashes is <strong>{page.text(best.policy)}</strong>’s: '
        f"<strong>{1e3 * estimate.mean:.1f} mm</strong> mean |error| per axis, 95 % interval {low} to {high} mm "
        f"over {estimate.episodes} pinned episodes.</p>"
    )


def _table(rows: Sequence[Row], published: Sequence[Published], best: Row | None) -> str:
    shown = columns(rows)
    lines = []
    for row in rows:
        if row.values:
            cells = [page.split_interval(cell(row, column)) for column in shown] + [str(row.episodes)]
            kind = "best" if row is best else ""
        else:
            cells, kind = ["—"] * (len(shown) + 1), "missing"
        lines.append(page.table_row([page.text(row.policy), *cells], kind))
    for other in published:
        cells = [page.text(published_cell(other, column)) for column in shown] + ["—"]
        lines.append(page.table_row([page.text(other.label), *cells], "published"))
    return page.table(["policy", *(column.head for column in shown), "episodes"], lines)


def _notes(rows: Sequence[Row], published: Sequence[Published]) -> str:
    lines = ["Means over episodes; 95 % percentile bootstrap intervals in brackets.", *caveats(rows)]
    lines += [f"{row.policy}: {row.note}" for row in rows if row.note]
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


def _paired(rows: Sequence[Row], best: Row | None) -> str:
    """Differences to the best row, episode by episode."""
    if best is None:
        return ""
    lines = []
    for row in rows:
        if row is best or row.values.get("error", np.empty(0)).shape != best.values["error"].shape:
            continue
        both = np.isfinite(row.values["error"])
        if both.any():
            estimate, (low, high) = paired_difference(row.values["error"][both], best.values["error"][both])
            verdict = "worse" if low > 0.0 else "better" if high < 0.0 else "not resolved"
            cells = [f"{1e3 * estimate:+.1f}", f"[{1e3 * low:+.1f}, {1e3 * high:+.1f}]", verdict, str(both.sum())]
            lines.append(page.table_row([page.text(row.policy), *cells]))
    if not lines:
        return ""
    table = page.table(["policy", "difference [mm]", "95 % interval", "", "episodes"], lines)
    name = page.text(best.policy)
    return f"<h2>Paired with {name}</h2><p>Mean difference of |error| on the same episodes.</p>{table}"
