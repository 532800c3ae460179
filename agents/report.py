"""A comparison as one self-contained HTML page: no scripts, nothing fetched, figures inlined.

`write_report` makes the page; the table alone, as text, Markdown or JSON data, comes from `agents.table` and is
re-exported here.
"""

import base64
import html
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from agents.files import write_atomic
from agents.statistics import paired_difference
from agents.table import (
    Column,
    Estimate,
    Published,
    Row,
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

CSS = """
:root { color-scheme: light dark; --ink: #1d2126; --soft: #646c76; --line: #e3e6ea; --ground: #fff; --card: #f7f8fa;
  --accent: #2463b8; --best: #e9f1fc; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e9ed; --soft: #9aa3ae; --line: #30363d; --ground: #14171b;
  --card: #1b1f25; --accent: #79b0f7; --best: #1c2b40; } }
* { box-sizing: border-box; }
body { margin: 0; background: var(--ground); color: var(--ink);
  font: 16px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; }
main { max-width: 68rem; margin: 0 auto; padding: 3.2rem 1.6rem 4rem; }
h1 { font-size: 1.9rem; line-height: 1.2; letter-spacing: -.015em; margin: 0 0 .4rem; }
h2 { font-size: 1.15rem; letter-spacing: -.005em; margin: 2.8rem 0 .5rem; }
p { margin: .4rem 0; max-width: 46rem; }
.lead { font-size: 1.08rem; color: var(--soft); }
.lead strong { color: var(--ink); font-weight: 600; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-size: .86rem; font-variant-numeric: tabular-nums;
  margin: .6rem 0; }
th, td { padding: .5rem .45rem; text-align: right; white-space: nowrap; border-bottom: 1px solid var(--line); }
th { font-weight: 600; color: var(--soft); font-size: .78rem; border-bottom: 1.5px solid var(--ink);
  vertical-align: bottom; }
th:first-child, td:first-child { text-align: left; }
td:first-child { font-weight: 600; }
td small { display: block; color: var(--soft); font-size: .76rem; }
tr.best td { background: var(--best); }
tr.published td { color: var(--soft); font-style: italic; }
tr.missing td { color: var(--soft); font-weight: 400; }
.notes { color: var(--soft); font-size: .84rem; padding-left: 1.1rem; max-width: 52rem; }
figure { margin: .8rem 0 0; } figure img { width: 100%; height: auto; display: block; }
figcaption { color: var(--soft); font-size: .84rem; margin-top: .3rem; }
.film img { width: auto; max-width: 100%; border-radius: 6px; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: .35rem 1.4rem; background: var(--card);
  border: 1px solid var(--line); border-radius: 8px; padding: 1rem 1.2rem; font-size: .86rem; margin: .8rem 0; }
dt { color: var(--soft); } dd { margin: 0; overflow-wrap: anywhere; }
code { font: .93em ui-monospace, SFMono-Regular, Menlo, Consolas, monospace; }
@media print { main { padding: 0; max-width: none; } h2 { break-after: avoid; } figure, table { break-inside: avoid; } }
"""


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
    best = _best(ran)
    parts = [f"<h1>{_text(title)}</h1>", _lead(ran, best)]
    if film is not None:
        parts.append(f'<figure class="film">{_image(film, "gif", film_caption)}{_caption(film_caption)}</figure>')
    parts += ["<h2>Comparison</h2>", _table(rows, published, best), _notes(rows, published)]
    parts += _figures(ran, published, traces) + [_paired(ran, best), "<h2>How it was measured</h2>"]
    parts.append(_facts({**(settings or {}), **provenance}))
    body = "\n".join(part for part in parts if part)
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{_text(title)}</title>\n<style>{CSS}</style>\n</head>\n<body>\n<main>\n{body}\n</main>\n</body>\n</html>\n"
    )


def _text(value: object) -> str:
    return html.escape(str(value))


def _best(rows: Sequence[Row]) -> Row | None:
    """The row of the lowest error, among those whose every episode defines one and at most 1 % of them crash.

    An episode that crashes has its error over the time before only, which flatters a policy that crashes early.
    """
    safe = [row for row in rows if np.isfinite(row.values.get("error", np.array([np.nan]))).all()]
    safe = [row for row in safe if np.mean(row.values.get("crash", np.zeros(1))) <= 0.01]
    return min(safe, key=lambda row: float(np.mean(row.values["error"])), default=None)


def _lead(rows: Sequence[Row], best: Row | None) -> str:
    if best is None or (estimate := best.estimate("error")) is None:
        return f'<p class="lead">{len(rows)} policies.</p>'
    low, high = (f"{1e3 * bound:.1f}" for bound in estimate.interval)
    return (
        f'<p class="lead">The lowest error without crashes is <strong>{_text(best.policy)}</strong>’s: '
        f"<strong>{1e3 * estimate.mean:.1f} mm</strong> mean |error| per axis, 95 % interval {low} to {high} mm "
        f"over {estimate.episodes} pinned episodes.</p>"
    )


def _table(rows: Sequence[Row], published: Sequence[Published], best: Row | None) -> str:
    shown = columns(rows)
    lines = ["".join(f"<th>{_text(head)}</th>" for head in ["policy", *(column.head for column in shown), "episodes"])]
    body = []
    for row in rows:
        if row.values:
            cells = [_split(cell(row, column)) for column in shown] + [str(row.episodes)]
            kind = ' class="best"' if row is best else ""
        else:
            cells, kind = ["—"] * (len(shown) + 1), ' class="missing"'
        body.append(f"<tr{kind}>" + "".join(f"<td>{text}</td>" for text in [_text(row.policy), *cells]) + "</tr>")
    for other in published:
        cells = [_text(published_cell(other, column)) for column in shown] + ["—"]
        tds = "".join(f"<td>{text}</td>" for text in [_text(other.label), *cells])
        body.append(f'<tr class="published">{tds}</tr>')
    head = f"<thead><tr>{lines[0]}</tr></thead>"
    return f'<div class="scroll"><table>{head}<tbody>{"".join(body)}</tbody></table></div>'


def _split(text: str) -> str:
    """The interval goes below its mean."""
    value, bracket, rest = text.partition(" [")
    return f"{_text(value)}<small>{_text('[' + rest)}</small>" if bracket else _text(text)


def _notes(rows: Sequence[Row], published: Sequence[Published]) -> str:
    notes = ["Means over episodes; 95 % percentile bootstrap intervals in brackets."]
    notes += caveats(rows)
    notes += [f"{row.policy}: {row.note}" for row in rows if row.note]
    notes += [f"{other.label}: {other.source}" for other in published]
    return '<ul class="notes">' + "".join(f"<li>{_text(note)}</li>" for note in notes) + "</ul>"


def _figures(rows: Sequence[Row], published: Sequence[Published], traces: Sequence["Trace"]) -> list[str]:
    from agents import plots

    parts = []
    if any(row.estimate(name) for row in rows for name in plots.AXES):
        caption = "Whiskers are 95 % intervals; bars that leave the axis carry their value. Hatched: published."
        bars = _figure(lambda dark: plots.error_bars(rows, published, dark), "Mean |error| per axis.", caption)
        parts += ["<h2>Error per axis</h2>", bars]
    if any(row.estimate("error") for row in rows):
        caption = "One point an episode; box: quartiles and median."
        strips = _figure(lambda dark: plots.error_strips(rows, dark), "Error of every episode, by policy.", caption)
        parts += ["<h2>Episode by episode</h2>", strips]
    if traces:
        caption = "The first pinned episode, as each policy observed it; a cross marks an early end."
        lines = _figure(lambda dark: plots.error_over_time(traces, dark), "Observed position error over time.", caption)
        parts += ["<h2>One episode</h2>", lines]
    return parts


def _figure(draw: Callable[[bool], bytes], alt: str, caption: str) -> str:
    dark = base64.b64encode(draw(True)).decode()
    source = f'<source media="(prefers-color-scheme: dark)" srcset="data:image/png;base64,{dark}">'
    return f"<figure><picture>{source}{_image(draw(False), 'png', alt)}</picture>{_caption(caption)}</figure>"


def _image(data: bytes, kind: str, alt: str) -> str:
    return f'<img alt="{_text(alt)}" src="data:image/{kind};base64,{base64.b64encode(data).decode()}">'


def _caption(text: str) -> str:
    return f"<figcaption>{_text(text)}</figcaption>" if text else ""


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
            lines.append("<tr>" + "".join(f"<td>{text}</td>" for text in [_text(row.policy), *cells]) + "</tr>")
    if not lines:
        return ""
    heads = "".join(f"<th>{h}</th>" for h in ("policy", "difference [mm]", "95 % interval", "", "episodes"))
    return (
        f"<h2>Paired with {_text(best.policy)}</h2><p>Mean difference of |error| on the same episodes.</p>"
        f'<div class="scroll"><table><thead><tr>{heads}</tr></thead><tbody>{"".join(lines)}</tbody></table></div>'
    )


def _facts(facts: Mapping[str, Any]) -> str:
    def show(name: str, value: Any) -> str:
        if isinstance(value, Mapping):
            return _text(", ".join(f"{key} {item}" for key, item in value.items()) or "none")
        shown = _text(value if value not in ("", None) else "unknown")
        return f"<code>{shown}</code>" if name in ("command", "commit") else shown

    return (
        "<dl>"
        + "".join(f"<dt>{_text(name)}</dt><dd>{show(name, value)}</dd>" for name, value in facts.items())
        + "</dl>"
    )
