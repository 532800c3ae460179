"""The comparison as text, Markdown, JSON and page."""

import json
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from agents.files import dumps, to_json, writable_folder, write_atomic
from agents.provenance import provenance
from agents.report import Published, Row, html_report, table_data, table_text, write_report
from agents.statistics import bootstrap_interval, mean
from agents.table import with_pooled
from agents.traces import Trace

VOID = {"meta", "img", "source"}


def row(policy: str, scale: float, undefined: int = 0, episodes: int = 12, **options) -> Row:
    rng = np.random.default_rng(len(policy))
    values = {f"error_{axis}": scale * rng.lognormal(0.0, 0.3, episodes) for axis in "xyz"}
    values["error"] = np.mean(list(values.values()), axis=0)
    for array in values.values():
        array[:undefined] = np.nan
    return Row(policy, {**values, "success": np.ones(episodes), "crash": np.zeros(episodes)}, **options)


ROWS = [row("zero", 0.7, undefined=5), row("pid", 0.04), row("a<b>&c", 0.01), Row("ppo", note="no checkpoint")]
PUBLISHED = [Published("thesis", {"error_x": (0.034, 0.032)}, "Table 5.3")]


class Checker(HTMLParser):
    """Every element is closed in order; collects tags, links and the text of table cells."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[str] = []
        self.sources: list[str] = []
        self.cells: list[str] = []
        self.feed(page)
        assert self.open == []

    def handle_starttag(self, tag, attrs) -> None:
        self.tags.append(tag)
        self.sources += [value for name, value in attrs if name in ("src", "srcset", "href")]
        if tag == "td":
            self.cells.append("")
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data) -> None:
        if "td" in self.open:
            self.cells[-1] += data


def page(**changes) -> str:
    lines = [
        Trace("pid", np.linspace(0.0, 4.9, 50), np.full(50, 0.03)),
        Trace("zero", np.linspace(0.0, 0.8, 9), np.zeros(9)),
    ]
    content = {"title": "Dock <v0>", "rows": ROWS, "provenance": provenance("cmd"), "published": PUBLISHED}
    return html_report(**{**content, "settings": {"seeds": "5 to 16"}, "traces": lines, **changes})


def test_the_page_is_well_formed_and_needs_nothing_else() -> None:
    found = Checker(page())
    assert not {"script", "link", "iframe"} & set(found.tags)
    assert len(found.sources) == 6 and all(source.startswith("data:image/png;base64,iVBOR") for source in found.sources)
    assert "http" not in re.sub(r"base64,[^\"]+", "", page())


def test_the_page_says_what_was_run_and_escapes_it() -> None:
    text = page()
    for fact in ("Dock &lt;v0&gt;", "a&lt;b&gt;&amp;c", "no checkpoint", "Table 5.3", "5 to 16", "numpy", "cmd"):
        assert fact in text
    assert "<b>" not in text


def test_the_page_shows_the_means_and_intervals() -> None:
    cells = Checker(page()).cells
    values = 1e3 * ROWS[1].values["error"]
    low, high = bootstrap_interval(values, 0, mean)
    assert f"{values.mean():.1f}[{low:.1f}, {high:.1f}]" in cells


def test_a_film_is_embedded() -> None:
    assert "data:image/gif;base64,R0lGODlh" in page(film=b"GIF89a", film_caption="docked")
    with pytest.raises(ValueError, match="GIF"):
        page(film=b"PNG")
    with pytest.raises(ValueError, match="rows"):
        page(rows=[])


@pytest.mark.parametrize("rows", [[Row("ppo", note="missing")], [Row("p", {"returns": np.ones(3)})], [row("p", 0.0)]])
def test_odd_rows_make_a_page_too(rows: list[Row]) -> None:
    Checker(page(rows=rows, published=(), traces=()))


def test_the_text_table_is_aligned_and_complete() -> None:
    lines = table_text(ROWS, published=PUBLISHED).splitlines()
    assert len({len(line) for line in lines[:8]}) == 1
    assert lines[0].split()[0] == "policy"
    assert "(7)" in lines[2] and "(7)" not in lines[3]  # only 7 of 12 episodes define zero's errors
    assert "34.0 ± 32.0" in lines[6]
    assert "ppo: no checkpoint" in lines and any(line.startswith("(n)") for line in lines)


def test_the_markdown_table_has_one_shape() -> None:
    lines = [line for line in table_text(ROWS, markdown=True).splitlines() if line.startswith("|")]
    assert len({len(re.findall(r"(?<!\\)\|", line)) for line in lines}) == 1
    assert len(lines) == 2 + len(ROWS)


def test_other_tasks_show_their_own_metrics() -> None:
    text = table_text([Row("p", {"returns": np.ones(3), "success": np.ones(3), "slip": np.full(3, 0.25)})])
    assert "slip" in text and "0.250" in text and "error" not in text


def test_the_data_are_strict_json_with_every_episode() -> None:
    data = json.loads(dumps(table_data(ROWS, PUBLISHED)))
    assert data["rows"][0]["values"]["error"][0] is None
    assert data["rows"][0]["summary"]["error"]["episodes"] == 7
    assert data["rows"][1]["summary"]["error"]["mean"] == pytest.approx(ROWS[1].values["error"].mean())
    assert data["published"][0]["label"] == "thesis"


def test_training_seeds_are_pooled_by_episode() -> None:
    seeds = [row("ppo-seed0", 0.01), row("ppo-seed12", 0.02)]
    rows = with_pooled([row("pid", 0.04), *seeds, row("ppo-residual-seed0", 0.01)])
    assert [r.policy for r in rows] == ["pid", "ppo-seed0", "ppo-seed12", "ppo (2 seeds)", "ppo-residual-seed0"]
    assert np.allclose(rows[3].values["error"], 0.5 * (seeds[0].values["error"] + seeds[1].values["error"]))


def test_files_are_whole_or_absent(tmp_path: Path) -> None:
    path = write_report(tmp_path / "r.html", title="t", rows=ROWS, provenance={})
    assert path.read_text().startswith("<!doctype html>")
    with pytest.raises(TypeError):
        write_atomic(tmp_path / "r.html", object())  # type: ignore[arg-type]
    assert [file.name for file in tmp_path.iterdir()] == ["r.html"]
    with pytest.raises(OSError):
        writable_folder(tmp_path / "r.html" / "below")


def test_json_values() -> None:
    value = {"a": np.float32(0.5), 1: (np.arange(2), float("inf")), "p": Path("x")}
    assert to_json(value) == {"a": 0.5, "1": [[0, 1], None], "p": "x"}
    with pytest.raises(ValueError, match="set"):
        to_json({1, 2})


def test_a_policy_that_crashes_is_never_called_the_best() -> None:
    early = row("early", 1e-4)
    early.values["crash"][:6] = 1.0
    text = page(rows=[early, *ROWS])
    assert "without crashes is <strong>a&lt;b&gt;&amp;c" in text
    assert "before the crash" in text and "before the crash" not in page()
    assert "2 policies." in page(rows=[early, ROWS[0]])
