"""The parts that self-contained HTML reports are made of: no scripts, nothing fetched, figures inlined."""

import base64
import html
from collections.abc import Callable, Mapping, Sequence
from typing import Any

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
tr.best td, td.best { background: var(--best); }
tr.published td { color: var(--soft); font-style: italic; }
tr.oracle td { color: var(--soft); }
tr.group td { font-weight: 600; border-bottom: 0; }
tr.missing td { color: var(--soft); font-weight: 400; }
.notes { color: var(--soft); font-size: .84rem; padding-left: 1.1rem; max-width: 52rem; }
figure { margin: .8rem 0 0; } figure img { width: 100%; height: auto; display: block; }
figcaption { color: var(--soft); font-size: .84rem; margin-top: .3rem; }
.film img { width: auto; max-width: 100%; border-radius: 6px; }
.films { display: flex; flex-wrap: wrap; gap: .4rem 1.6rem; } .films figure { flex: 1 1 22rem; max-width: 30rem; }
.films img { width: 100%; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: .35rem 1.4rem; background: var(--card);
  border: 1px solid var(--line); border-radius: 8px; padding: 1rem 1.2rem; font-size: .86rem; margin: .8rem 0; }
dt { color: var(--soft); } dd { margin: 0; overflow-wrap: anywhere; }
code { font: .93em ui-monospace, SFMono-Regular, Menlo, Consolas, monospace; }
@media print { main { padding: 0; max-width: none; } h2 { break-after: avoid; } figure, table { break-inside: avoid; } }
"""


def page(title: str, parts: Sequence[str]) -> str:
    """The document; empty parts are left out."""
    body = "\n".join([f"<h1>{text(title)}</h1>", *filter(None, parts)])
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{text(title)}</title>\n<style>{CSS}</style>\n</head>\n"
        f"<body>\n<main>\n{body}\n</main>\n</body>\n</html>\n"
    )


def text(value: object) -> str:
    """Escaped for HTML."""
    return html.escape(str(value))


def table(head: Sequence[str], rows: Sequence[str]) -> str:
    """A table that scrolls sideways; `rows` are made by `table_row`."""
    heads = "".join(f"<th>{text(cell)}</th>" for cell in head)
    return f'<div class="scroll"><table><thead><tr>{heads}</tr></thead><tbody>{"".join(rows)}</tbody></table></div>'


def table_row(
    cells: Sequence[str], kind: str = "", best: Sequence[int] = (), shades: Mapping[int, float] | None = None
) -> str:
    """A row of cells that are HTML already; `best` marks single cells, `shades` colours some by a value in [0, 1].

    `kind`: "best", "oracle", "published", "missing", "group" or "".
    """
    marks = [' class="best"' if i in best else "" for i in range(len(cells))]
    for i, share in (shades or {}).items():
        strength = round(60.0 * min(max(share, 0.0), 1.0))
        marks[i] += f' style="background:color-mix(in srgb,var(--accent) {strength}%,transparent)"'
    row_class = f' class="{kind}"' if kind else ""
    return f"<tr{row_class}>" + "".join(f"<td{m}>{c}</td>" for m, c in zip(marks, cells, strict=True)) + "</tr>"


def split_interval(value: str) -> str:
    """The text `mean [low, high]` as HTML, the interval below its mean."""
    mean, bracket, rest = value.partition(" [")
    return f"{text(mean)}<small>{text('[' + rest)}</small>" if bracket else text(value)


def notes(lines: Sequence[str]) -> str:
    """A list of small print."""
    return '<ul class="notes">' + "".join(f"<li>{text(line)}</li>" for line in lines) + "</ul>"


def figure(draw: Callable[[bool], bytes], alt: str, caption: str) -> str:
    """A figure for light and dark pages; `draw(dark)` gives PNG bytes."""
    dark = base64.b64encode(draw(True)).decode()
    source = f'<source media="(prefers-color-scheme: dark)" srcset="data:image/png;base64,{dark}">'
    return f"<figure><picture>{source}{image(draw(False), 'png', alt)}</picture>{_caption(caption)}</figure>"


def film_figure(film: bytes, caption: str) -> str:
    """A GIF as a figure."""
    return f'<figure class="film">{image(film, "gif", caption)}{_caption(caption)}</figure>'


def image(data: bytes, kind: str, alt: str) -> str:
    """An inlined picture."""
    return f'<img alt="{text(alt)}" src="data:image/{kind};base64,{base64.b64encode(data).decode()}">'


def _caption(value: str) -> str:
    return f"<figcaption>{text(value)}</figcaption>" if value else ""


def facts(values: Mapping[str, Any]) -> str:
    """Names and values as a list."""

    def show(name: str, value: Any) -> str:
        if isinstance(value, Mapping):
            return text(", ".join(f"{key} {item}" for key, item in value.items()) or "none")
        shown = text(value if value not in ("", None) else "unknown")
        return f"<code>{shown}</code>" if name in ("command", "commit") else shown

    return "<dl>" + "".join(f"<dt>{text(k)}</dt><dd>{show(k, v)}</dd>" for k, v in values.items()) + "</dl>"
