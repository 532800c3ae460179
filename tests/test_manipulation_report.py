"""What the comparison adds for the tasks of arms: conditions, causes, objects, ratios and films."""

import json
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import toy_env
from gymnasium.spaces import Box, Dict
from toy_env import TOY

from agents import bench_setup, benchmark, manipulation_films, manipulation_report
from agents.bench_setup import DOCK, GRASP, GRASP_DUAL, REACH, SETUPS, Condition, Measured, Setup
from agents.policies import spaces
from agents.scoring import CAUSES, HOLDING, LIFTING, REACHING, scoring_of
from agents.table import Row
from baselines.policies import POLICIES

CONDITIONS: dict[str, dict[str, Any]] = {"usual": {}, "noisy": {"noise": 0.3}, "quiet": {"noise": 0.0}}
THINGS = "toy/Things-v0"


class ThingsEnv(gymnasium.Env):
    """Names an object on reset, by its seed."""

    def __init__(self, **options: Any) -> None:
        self.action_space = Box(-1.0, 1.0, (1,), np.float32)
        self.observation_space = Dict({"x": Box(-1.0, 1.0, (1,), np.float32)})

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[dict, dict]:
        return {"x": np.zeros(1, np.float32)}, {"object": "cup" if (seed or 0) % 2 else "can"}


if THINGS not in gymnasium.registry:
    gymnasium.register(THINGS, ThingsEnv)


def lifting(policy: str, success: list[int], cause: str = "missed", crash: tuple[int, ...] = ()) -> Row:
    """A row whose failures have one cause; the k-th success took k + 1 seconds."""
    ok = np.array(success, dtype=float)
    values = {name: (1.0 - ok) * (name == cause) for name in CAUSES}
    values |= {"success": ok, "crash": np.isin(np.arange(ok.size), crash).astype(float)}
    values |= {"lift": np.where(ok, 0.2, 0.01 * np.arange(ok.size)), "slip": 0.01 * ok}
    return Row(policy, values | {"lift_time": np.where(ok, 1.0 + np.arange(ok.size), 20.0)})


def measured(conditions: dict[str, list[Row]], env_id: str = THINGS, episodes: int = 4) -> Measured:
    found = {name: Condition({"level": name}, {}, rows) for name, rows in conditions.items()}
    first = next(iter(conditions.values()))
    return Measured(env_id, {}, 0, episodes, first, {}, True, False, found)


@pytest.fixture
def toy(monkeypatch: pytest.MonkeyPatch) -> None:
    setup = Setup(
        learned=(), conditions=CONDITIONS, film_episodes=0, quick_options={}, study="agents.manipulation_report:study"
    )
    monkeypatch.setitem(bench_setup.SETUPS, TOY, setup)
    monkeypatch.setattr("baselines.policies.POLICIES", {**POLICIES, **toy_env.POLICIES})


@pytest.mark.usefixtures("toy")
def test_all_conditions_stand_in_one_report(tmp_path: Path) -> None:
    result = benchmark.bench(TOY, ["p", "zero"], 4, out_dir=tmp_path, progress=False)
    data = json.loads(result.data.read_text())
    assert list(data["conditions"]) == list(CONDITIONS)
    errors = {name: of["rows"][0]["summary"]["error"]["mean"] for name, of in data["conditions"].items()}
    assert errors["quiet"] < errors["usual"] < errors["noisy"]
    assert errors["usual"] == result.rows[0].values["error"].mean()
    assert data["conditions"]["noisy"]["options"] == {"noise": 0.3}
    pair = data["conditions"]["quiet"]["paired"][0]
    assert (pair["policy"], pair["reference"], pair["verdict"]) == ("zero", "p", "worse")
    assert result.table.startswith("usual\n") and "noisy: noise=0.3" in result.table
    assert "| policy | usual | noisy | quiet |" in (tmp_path / "table.md").read_text()
    page = result.report.read_text()
    assert "Comparison: usual" in page and "Paired, other conditions" in page and "quiet: zero" in page
    assert page.count("p, |error| [mm]: usual ") == 1


@pytest.mark.usefixtures("toy")
def test_rows_of_every_condition_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = benchmark.bench(TOY, ["p"], 2, out_dir=tmp_path, progress=False)
    monkeypatch.setattr("agents.rows.evaluate", lambda *_: pytest.fail("measured again"))
    assert benchmark.bench(TOY, ["p"], 2, out_dir=tmp_path, progress=False).table == first.table


@pytest.mark.usefixtures("toy")
def test_a_callers_option_leaves_the_conditions_that_agree(tmp_path: Path) -> None:
    setup = SETUPS[TOY]
    assert list(setup.conditions_under({"noise": 0.3})) == ["usual", "noisy"]
    assert list(setup.conditions_under({"other": 1})) == list(CONDITIONS)
    assert SETUPS[GRASP].conditions_under({"level": "heavy"}) == {"heavy": {"level": "heavy"}}
    assert SETUPS[GRASP].conditions_under({"level": {"mass": [0.1, 0.2]}}) == {"": {}}
    assert Setup().conditions_under({}) == {"": {}}
    result = benchmark.bench(TOY, ["p"], 2, env_kwargs={"noise": 0.3}, out_dir=tmp_path, progress=False)
    rows = [of["rows"][0]["values"] for of in json.loads(result.data.read_text())["conditions"].values()]
    assert rows[0] == rows[1]


def test_every_shipped_condition_is_one_that_its_environment_takes() -> None:
    for env_id, setup in SETUPS.items():
        assert set(setup.filmed) <= set(setup.conditions)
        for changes in setup.conditions.values():
            spaces(env_id, {**setup.options, **changes})
        spaces(env_id, {**setup.options, **setup.look})


def test_kinds_of_tasks_are_told_by_their_values() -> None:
    assert scoring_of({"error", "error_x", "crash"}) is HOLDING
    assert scoring_of({"error", "error_max", "hover", "crash"}) is REACHING
    assert scoring_of({"success", "lift", "crash", *CAUSES}) is LIFTING


def test_outcomes_are_a_partition_and_stand_in_the_report() -> None:
    rows = [lifting("p", [1, 0, 0, 1], "slipped"), lifting("q", [0, 0, 0, 1], "timed_out")]
    shares = manipulation_report.outcomes(rows)
    assert shares["p"] == {
        "success": 0.5,
        "missed": 0.0,
        "slipped": 0.5,
        "collided": 0.0,
        "jammed": 0.0,
        "timed_out": 0,
    }
    assert all(sum(of.values()) == 1.0 for of in shares.values())
    page = "".join(manipulation_report.causes_section(measured({"easy": rows, "gusty": rows}).conditions))
    assert "gusty: q" in page and "<td>75.0</td>" in page
    assert manipulation_report.causes_section({"": Condition({}, {}, [Row("p", {"error": np.ones(2)})])}) == []


def test_success_is_counted_by_object_and_condition() -> None:
    study = manipulation_report.lifting_study(
        measured({"easy": [lifting("p", [1, 0, 1, 0])], "gusty": [lifting("p", [1, 1, 1, 1])]})
    )
    assert study.data["objects"]["easy"] == ["can", "cup", "can", "cup"]
    assert study.data["success_by_object"] == {
        "easy": {"can": {"p": 1.0}, "cup": {"p": 0.0}},
        "gusty": {"can": {"p": 1.0}, "cup": {"p": 1.0}},
    }
    page = "".join(study.sections)
    assert "Object by object, p" in page and ">50<" in page


def test_rows_that_did_not_run_are_passed_over() -> None:
    rows = [lifting("p", [1, 0, 1, 0]), Row("ppo", note="not run: none")]
    study = manipulation_report.lifting_study(measured({"easy": rows, "gusty": rows}))
    assert study.data["outcomes"]["gusty"].keys() == {"p"} and "ppo" in "".join(study.sections)


def test_docking_is_compared_with_hovering() -> None:
    def row(*errors: float) -> Row:
        return Row("p", {"error": np.array(errors)})

    conditions = {"docked": row(1, 1, 1), "hovering on vision": row(2, 2, 2), "hovering on GPS": row(2, 4, np.nan)}
    found = manipulation_report.ratios({name: Condition({}, {}, [of]) for name, of in conditions.items()})
    vision, gps = found
    assert (vision.value, vision.interval, vision.wanted) == (0.5, (0.5, 0.5), 1.0)
    assert gps.value == pytest.approx(1 / 3) and gps.episodes == 2 and gps.interval.low < gps.value < gps.interval.high
    page = "".join(manipulation_report.ratios_section(found))
    assert "p, docked / hovering on GPS" in page and page.count("met") == 2
    assert manipulation_report.ratios({"": Condition({}, {}, [row(1)])}) == []
    assert manipulation_report.ratios_section([]) == []


def test_the_best_and_the_worst_episode_are_chosen_over_the_conditions(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("baselines.policies.POLICIES", {THINGS: {"p": ""}})
    better = lifting("q", [1, 1, 1])
    easy, gusty = lifting("p", [1, 1, 0]), lifting("p", [0, 0, 1], "slipped", crash=(1,))
    of = measured({"easy": [better, easy], "gusty": [better, gusty]}).conditions
    best, worst = manipulation_films.choose(of, THINGS)
    assert best == ("Best", "easy", "p", 0, "lifted and held after 1.0 s", 1.0 + manipulation_films.AFTER)
    assert worst == ("Worst", "gusty", "p", 1, "it crashed", manipulation_films.SECONDS)
    gusty = lifting("p", [0, 0, 1], "slipped")
    assert manipulation_films.choose({"gusty": Condition({}, {}, [gusty])}, THINGS)[1].said == "slipped, lifted by 0 mm"
    alike = manipulation_films.choose({"": Condition({}, {}, [Row("p", {"success": np.ones(2)})])}, THINGS)
    assert [shot.title for shot in alike] == ["Like all others"] and alike[0].said == "success"
    assert manipulation_films.choose({"": Condition({}, {}, [Row("p", note="not run")])}, THINGS) == []


def test_reaching_is_ranked_by_crashes_then_error(monkeypatch: pytest.MonkeyPatch) -> None:
    values = {"error": [0.003, np.nan, 0.001], "error_max": [0, 0, 0], "hover": [0, 0, 0], "crash": [0, 1, 0]}
    row = Row("dls", {name: np.array(of, dtype=float) for name, of in values.items()} | {"success": np.ones(3)})
    best, worst = manipulation_films.choose({"moving": Condition({}, {}, [row])}, REACH)
    assert (best.number, best.said, worst.number, worst.said) == (2, "error 1.0 mm", 1, "it crashed")


def test_films_are_small_and_embedded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(manipulation_films, "SHAPES", ((10.0, 64, 48), (5.0, 32, 24)))
    film = manipulation_films.film(REACH, "zero", 1, {}, 0.4)
    assert film[:4] == b"GIF8"
    monkeypatch.setattr(manipulation_films, "LARGEST", 10)
    assert len(manipulation_films.film(REACH, "zero", 1, {}, 0.4)) < len(film)
    monkeypatch.setattr(manipulation_films, "film", lambda *_: film)
    row = Row("dls", {"success": np.array([1.0, 0.0])})
    page = "".join(manipulation_films.films_section(measured({"easy": [row]}, REACH)))
    assert page.count("data:image/gif") == 2 and "Worst test episode of dls (easy, seed 1): failure" in page
    assert manipulation_films.films_section(measured({"easy": [row]})) == []  # draws no pictures


def test_setups_are_those_of_the_tasks() -> None:
    assert SETUPS[GRASP].episodes >= 200 and SETUPS[GRASP].options["objects"] == "test"
    assert list(SETUPS[GRASP].conditions) == ["easy", "gusty", "biased", "oblique", "heavy", "combined"]
    assert SETUPS[GRASP_DUAL].filmed == ("easy", "gusty") and SETUPS[DOCK].conditions == {}
