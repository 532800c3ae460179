"""The search finds minima, and `aerograsp tune` writes what it found and goes on where it stopped."""

import json

import numpy as np
import pytest

from agents import tune, tuning
from agents.arguments import guarded
from agents.search import Search
from agents.seeds import TRAIN_SEEDS, VALIDATION_SEEDS

ID = "aerograsp/Dock-v0"


def test_search_finds_a_minimum_under_noise():
    rng = np.random.default_rng(0)
    target = np.array([0.03, 2.0, 15.0])
    search = Search.start(np.array([0.2, 0.5, 5.0]), np.array([[1e-3, 10.0], [1e-2, 10.0], [0.1, 100.0]]))
    for _ in range(40):
        values = search.ask(16, rng)
        costs = ((np.log(values / target) * [1.0, 2.0, 0.5]) ** 2).sum(axis=1) + 0.01 * rng.standard_normal(16)
        search = search.tell(values, costs)
    np.testing.assert_allclose(search.values, target, rtol=0.3)


def test_search_stays_within_bounds_and_survives_infinite_costs():
    rng = np.random.default_rng(0)
    bounds = np.array([[0.5, 2.0], [0.1, 1.0]])
    search = Search.start(np.array([1.0, 5.0]), bounds)  # a start beyond its bound is moved to it
    for _ in range(10):
        values = search.ask(8, rng)
        assert (values >= bounds[:, 0] * (1 - 1e-12)).all() and (values <= bounds[:, 1] * (1 + 1e-12)).all()
        search = search.tell(values, np.where(values[:, 0] > 1.0, np.inf, -values[:, 1]))
    assert np.isfinite(search.values).all() and search.values[0] <= 1.2
    back = Search.from_dict(json.loads(json.dumps(search.to_dict())))
    np.testing.assert_array_equal(back.ask(3, np.random.default_rng(1)), search.ask(3, np.random.default_rng(1)))


@pytest.mark.parametrize("bounds", [[[0.0, 1.0]], [[2.0, 1.0]], [[1.0, np.inf]], [[0.1, 1.0]] * 2])
def test_search_refuses_bad_bounds(bounds):
    with pytest.raises(ValueError, match="bounds"):
        Search.start(np.array([0.5]), np.array(bounds))


def test_cost_counts_error_crashes_and_effort():
    flight = tuning.Flight(np.full((2, 3), 0.01), np.full((2, 3), 0.1), np.array([False, True]))
    expected = 0.5 * (0.01 + tuning.CRASH_COST) + tuning.EFFORT_WEIGHT * 0.1
    np.testing.assert_allclose(flight.cost(), [expected, expected])
    axes = tuning.Flight(np.array([[0.01, 0.03, 0.05]]), np.zeros((1, 3)), np.array([False]))
    np.testing.assert_allclose(axes.cost(), [0.02, 0.05])


def settings(**changes):
    return tuning.Settings(ID, "pid-tuned", episodes=2, seconds=6.0, iterations=2, population=4, **changes)


def test_an_interrupted_search_goes_on_and_ends_the_same(tmp_path, monkeypatch):
    monkeypatch.setattr(tuning, "VALIDATION_EPISODES", 2)
    whole = tuning.tune(settings(), tmp_path / "whole.json")
    tell, calls = Search.tell, []

    def interrupted(self, *args):
        calls.append(1)
        if len(calls) == 3:  # in the second generation
            raise KeyboardInterrupt
        return tell(self, *args)

    monkeypatch.setattr(Search, "tell", interrupted)
    with pytest.raises(KeyboardInterrupt):
        tuning.tune(settings(), tmp_path / "state.json")
    monkeypatch.setattr(Search, "tell", tell)
    assert json.loads((tmp_path / "state.json").read_text())["generation"] == 1
    again = tuning.tune(settings(), tmp_path / "state.json")
    assert again["found"] == whole["found"] and again["gains"] == whole["gains"] and again["curve"] == whole["curve"]
    with pytest.raises(ValueError, match="other settings"):
        tuning.tune(settings(seed=3_100_000), tmp_path / "state.json")
    low, high = whole["training_seeds"]
    assert low in TRAIN_SEEDS and high in TRAIN_SEEDS
    assert all(seed in VALIDATION_SEEDS for seed in whole["validation_seeds"])


def test_command_merges_its_entry_into_the_file(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(tuning, "VALIDATION_EPISODES", 2)
    out = tmp_path / "gains.json"
    out.write_text('{"other": {"gains": {}}}')
    options = ["--episodes", "2", "--seconds", "6", "--iterations", "1", "--population", "4", "--out", str(out)]
    assert guarded("aerograsp tune", tune.main, [ID, "--policy", "lqg", *options]) == 0
    data = json.loads(out.read_text())
    assert set(data) == {"other", "lqg"}
    entry = data["lqg"]
    assert entry["settings"]["env_kwargs"]["wind"] == "gusty" and entry["provenance"]["commit"]
    assert {"error", "effort", "crash", "cost"} == set(entry["before"]) == set(entry["after"])
    tuning.TUNABLE[ID]["lqg"].make(entry["gains"])
    printed = capsys.readouterr().out
    assert "before" in printed and "after" in printed and str(out) in printed
    assert [file.name for file in tmp_path.iterdir()] == ["gains.json"]  # the state is gone


@pytest.mark.parametrize(
    ("argv", "status", "message"),
    [
        (["aerograsp/Dok-v0", "--policy", "lqg"], 2, "aerograsp/Dock-v0"),
        (["aerograsp/DockAttach-v0", "--policy", "lqg"], 2, "aerograsp/Dock-v0"),
        ([ID, "--policy", "pid"], 2, "pid-tuned"),
        ([ID, "--policy", "lqg", "--seconds", "3"], 2, "seconds"),
        ([ID, "--policy", "lqg", "--population", "2"], 2, "population"),
        ([ID, "--policy", "lqg", "--out", "bad.json"], 2, "not JSON"),
        ([ID, "--policy", "lqg", "--out", "/proc/x/gains.json"], 2, "/proc/x"),
    ],
)
def test_mistakes_are_one_line(argv, status, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad.json").write_text("{")
    assert guarded("aerograsp tune", tune.main, argv) == status
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1
