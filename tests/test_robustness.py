"""Policies by conditions, and the film of the ordinary comparison."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import toy_env
from toy_env import TOY

from agents import benchmark, cli, robustness
from agents.bench_setup import GRASP_PLAN
from agents.policies import spaces
from agents.scoring import GRASPING
from agents.table import Row
from baselines.policies import POLICIES

SHIPPED = robustness.CHANGES
CHANGES: dict[str, dict[str, Any]] = {"trained": {}, "noisy": {"noise": 0.3}, "quiet": {"noise": 0.0}}


@pytest.fixture(autouse=True)
def conditions(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robustness, "CHANGES", {TOY: CHANGES})
    monkeypatch.setattr("baselines.policies.POLICIES", {**POLICIES, **toy_env.POLICIES})


def test_policies_meet_every_condition_on_the_same_episodes(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    arguments = ["--policy", "p", "--policy", "zero", "--policy", "ppo", "--episodes", "4", "--out", str(tmp_path)]
    assert cli.main(["bench", "--robustness", TOY, *arguments]) == 0
    assert f"report: {tmp_path / 'robustness.html'}" in capsys.readouterr().out
    data = json.loads((tmp_path / "robustness.json").read_text())
    assert list(data["conditions"]) == list(CHANGES)
    for rows in data["conditions"].values():
        assert [row["policy"] for row in rows] == ["p", "zero", "ppo"]
        assert [row["episodes"] for row in rows] == [4, 4, 0] and "no checkpoint" in rows[2]["note"]
    errors = {name: rows[0]["summary"]["error"]["mean"] for name, rows in data["conditions"].items()}
    assert errors["quiet"] < errors["trained"] < errors["noisy"]
    ordinary = benchmark.bench(TOY, ["p"], 4, out_dir=tmp_path / "other", progress=False)
    assert errors["trained"] == ordinary.rows[0].values["error"].mean()
    head, _, first, *_ = (tmp_path / "robustness.md").read_text().splitlines()
    assert head == "| policy | trained | noisy | quiet |"
    assert first.startswith("| p | ") and first.count("[") == 3
    report = (tmp_path / "robustness.html").read_text()
    assert "noise=0.3" in report and report.count('<td class="best">') == 3 and report.count("data:image/png") == 2


def test_rows_that_are_there_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    options: dict[str, Any] = {"policies": ["p"], "episodes": 2, "out_dir": tmp_path, "progress": False}
    first = robustness.robustness(TOY, **options)
    monkeypatch.setattr("agents.rows.evaluate", lambda *_: pytest.fail("measured again"))
    assert robustness.robustness(TOY, **options).table == first.table


def test_crash_rates_stand_where_there_are_any() -> None:
    def row(policy: str, crash: list[float], error: list[float]) -> Row:
        return Row(policy, {"error": np.array(error), "crash": np.array(crash)})

    rows = {
        "a": [row("p", [0, 0], [0.01, 0.01]), row("q", [1, 0], [np.nan, 0.02])],
        "b": [row("p", [0, 1], [0.03, 0.03]), row("q", [0, 0], [0.04, 0.04])],
    }
    assert robustness.cells(rows) == [
        ["policy", "a", "b"],
        ["p", "10.0 [10.0, 10.0]", "30.0 [30.0, 30.0] 50 % crash"],
        ["q", "20.0 [20.0, 20.0] (1) 50 % crash", "40.0 [40.0, 40.0]"],
    ]
    table = robustness.section(rows, {"a": {}, "b": {"x": 1}})[1]
    assert table.count('<td class="best">') == 2  # p under a, and q, which does not crash, under b


def test_grasps_have_a_table_of_what_is_held_and_one_of_what_is_held_strictly() -> None:
    def row(policy: str, held: list[float], strict: list[float], oracle: bool = False) -> Row:
        return Row(policy, {"held": np.array(held), "strict": np.array(strict)}, oracle=oracle)

    rows = {
        "a": [row("p", [1, 1], [0, 0]), row("q", [1, 0], [1, 0]), row("o", [1, 1], [1, 1], True)],
        "b": [row("p", [0, 0], [0, 0]), row("q", [1, 1], [1, 1]), row("o", [1, 1], [1, 1], True)],
    }
    held, strict = (robustness.cells(rows, column) for column in GRASPING.paired)
    assert held[0] == ["policy, held [%]", "a", "b"] and strict[0] == ["policy, strict [%]", "a", "b"]
    assert [line[0] for line in held[1:]] == ["p", "q", "o (oracle)"]
    assert [line[1].split()[0] for line in held[1:]] == ["100.0", "50.0", "100.0"]
    assert [line[1].split()[0] for line in strict[1:]] == ["0.0", "50.0", "100.0"]
    parts = robustness.section(rows, {"a": {}, "b": {"x": 1}})
    tables = [part for part in parts if "<table" in part]
    best = [re.findall(r'<tr>(?:(?!</tr>).)*class="best"', table, re.DOTALL) for table in tables]
    assert [["p" in line.split("</t")[0] for line in table] for table in best] == [[True, False], [False]]
    assert "Strict: held" in parts[-1] and "oracles aside" in parts[-1]


def test_grasps_are_tried_under_every_condition(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robustness, "CHANGES", SHIPPED)
    options: dict[str, Any] = {"env_kwargs": {"objects": "apple", "points": 128}, "progress": False}
    measured = robustness.robustness(GRASP_PLAN, ["com", "zero"], 1, out_dir=tmp_path, quick=True, **options)
    assert list(measured.rows) == list(SHIPPED[GRASP_PLAN])
    assert measured.table.count("policy, ") == 2 and "sigma_quadratic" in measured.table
    for of in measured.rows.values():
        assert [row.policy for row in of] == ["com", "zero"]
        np.testing.assert_array_equal(of[1].values["no grasp"], 1.0)
    shown = measured.report.read_text()
    assert shown.count("<table") >= 2 and "Hollow" not in shown


def test_quick_rows_are_few() -> None:
    assert robustness.default_rows(GRASP_PLAN, quick=True) == ["com", "cloud", "gpis", "oracle-mesh"]
    assert set(robustness.default_rows(GRASP_PLAN)) > {"com", "cloud", "gpis", "oracle-mesh", "gpis-constant"}


def test_training_seeds_become_one_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seeds = {f"ppo-seed{k}": tmp_path / f"{k}" for k in range(3)}
    monkeypatch.setattr(robustness, "checkpoints", lambda env_id: {**seeds, "ppo": tmp_path})
    assert robustness.default_rows(TOY) == ["p", *seeds]
    monkeypatch.setattr("agents.rows.load_policy", lambda env_id, name, kwargs: "p")
    rows = robustness.robustness(TOY, episodes=2, out_dir=tmp_path, progress=False).rows["noisy"]
    assert [row.policy for row in rows] == ["p", "ppo (3 seeds)"]
    np.testing.assert_allclose(rows[1].values["error"], rows[0].values["error"], rtol=1e-15)


def test_every_shipped_condition_is_one_that_its_environment_takes() -> None:
    for env_id, changes in SHIPPED.items():
        assert changes[robustness.TRAINED] == {}
        for change in changes.values():
            spaces(env_id, {**benchmark.CONDITIONS[env_id], **change})


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["toy/None-v0"], "unknown id"),
        ([f"{TOY}Single"], "unknown id"),
        ([TOY, "--policy", "pp"], "did you mean 'p'"),
        ([TOY, "--episodes", "0"], "at least 1"),
        ([TOY, "--env-kwarg", "nois=1"], "noise"),
    ],
)
def test_mistakes_are_one_line(arguments: list[str], message: str, tmp_path: Path, capsys: Any) -> None:
    assert cli.main(["bench", "--robustness", *arguments, "--out", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1


def test_ids_without_conditions_are_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(robustness, "CHANGES", SHIPPED)
    with pytest.raises(ValueError, match=benchmark.DOCK):
        robustness.robustness(TOY, out_dir=tmp_path)


def test_the_report_has_a_film_where_the_id_draws_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(benchmark, "FILM_SECONDS", 0.3)
    film = benchmark.film_of(benchmark.DOCK, "pid", 1, benchmark.CONDITIONS[benchmark.DOCK])
    assert film is not None and film[:4] == b"GIF8"
    assert benchmark.film_of(TOY, "p", 1, {}) is None
