"""The speed benchmark measures what it says and judges by its targets; no test here depends on how fast it is."""

import json
import sys
import time
from functools import partial

import numpy as np
import pytest

from agents import speed
from agents.speed import Row
from agents.speed_peers import PeerProcess
from agents.speed_runners import (
    PROCESSOR,
    WALL,
    BareSteps,
    Replay,
    in_turns,
    make_batch,
    make_single,
    now,
    others_load,
    record,
)


def test_a_replayed_flight_is_the_recorded_one() -> None:
    env = make_single()
    flight = record(env, steps=20, chunk=10, seed=3)
    end = env.unwrapped.data.qpos.copy()
    replay = Replay(env, flight)
    replay()
    replay()
    np.testing.assert_array_equal(env.unwrapped.data.qpos, end)
    replay()  # from the start again
    first = env.unwrapped.data.qpos.copy()
    replay()
    np.testing.assert_array_equal(env.unwrapped.data.qpos, end)
    assert (first != end).any()
    env.close()


def test_bare_steps_are_docked_and_begin_where_the_flight_was() -> None:
    env = make_single()
    flight = record(env, steps=20, chunk=10)
    bare = BareSteps(flight)
    assert bare.constraints >= 6  # the weld that holds the tool's base: three directions, three turns
    assert flight.states.shape[0] == 2
    began = bare._data.time
    bare()
    assert bare._data.time == pytest.approx(10 * env.unwrapped.dt)
    bare()  # from the second recorded state
    assert bare._data.time == pytest.approx(20 * env.unwrapped.dt) and began > 0.0
    env.close()


def test_the_batch_replays_the_flights_of_its_worlds() -> None:
    env = make_batch(2, threads=1)
    flight = record(env, steps=4, chunk=2)
    end = env.states["true_error"].copy()
    replay = Replay(env, flight)
    replay()
    replay()
    assert flight.actions.shape == (4, 2, 3)
    np.testing.assert_array_equal(env.states["true_error"], end)
    env.close()


def test_in_turns_gives_each_runner_the_same_turns() -> None:
    calls = []

    def runner(name: str, milliseconds: float):
        def run() -> np.ndarray:
            calls.append(name)
            began = now()
            time.sleep(1e-3 * milliseconds)
            return now() - began

        return run

    times = in_turns({"short": runner("short", 1.0), "long": runner("long", 4.0)}, seconds=0.02, repeats=3)
    assert calls.count("short") == calls.count("long") and calls[:4] == ["short", "long"] * 2
    assert times["short"].shape == (3, 2)
    assert (times["long"][:, WALL] >= 4e-3).all()
    assert (times["long"][:, PROCESSOR] < times["long"][:, WALL]).all()  # asleep, it takes no processor


def test_others_load_leaves_out_what_this_process_does() -> None:
    with others_load() as load:
        until = time.perf_counter() + 0.05
        while time.perf_counter() < until:
            pass
    assert load.cores is None or load.cores >= 0.0


@pytest.mark.parametrize(
    ("values", "target", "verdict"),
    [
        ((0.9, 0.7, 0.81), "≥ 0.80", "met"),
        ((0.9, 0.7, 0.79), "≥ 0.80", "missed"),
        ((2.0,), "≤ 3", "met"),
        ((4.0,), "≤ 3", "missed"),
        ((4.0,), "", ""),
        ((), "≥ 5", "not measured"),
    ],
)
def test_verdicts(values: tuple[float, ...], target: str, verdict: str) -> None:
    assert Row("speed", "", values, target).verdict == verdict


FAKE_PEER = """
import sys
print("a banner")
missing = '{"other": "ImportError: none"}'
print('and more ANSWER {"found": ["PyFlyt fake"], "missing": %s, "versions": {"numpy": "1"}}' % missing)
sys.stdout.flush()
for line in sys.stdin:
    print("ANSWER [2.0, 0.5, 1.0]", flush=True)
"""


def test_a_tiny_run_measures_every_row(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.setattr("agents.speed_peers.SCRIPT", FAKE_PEER)
    ppo = {"num_envs": 2, "n_steps": 8, "batch_size": 8, "steps": 16, "hidden": (8,)}
    monkeypatch.setattr(speed, "speed", partial(speed.speed, num_envs=2, ppo=ppo))
    path = tmp_path / "speed.json"
    argv = ["--seconds", "0.01", "--repeats", "1", "--peer-python", sys.executable, "--json", str(path)]
    assert speed.main(argv) == 0
    shown = capsys.readouterr().out
    result = json.loads(path.read_text())
    rows = {row["name"]: row for row in result["rows"]}
    assert rows["PyFlyt fake, simulated / wall time"]["median"] == 2.0
    assert rows["Dock-v0 / other, simulated time"]["note"] == "ImportError: none"
    assert rows["Dock-v0 / other, simulated time"]["verdict"] == "not measured"
    assert all(row["median"] > 0.0 for name, row in rows.items() if "other" not in name)
    ours, theirs = rows["Dock-v0 / PyFlyt fake, simulated time"], 4.0  # 2 s simulated in 0.5 s of processor time
    assert ours["verdict"] == ("met" if ours["median"] * theirs >= 5.0 * theirs else "missed")
    assert rows["PPO, wall time per million steps"]["note"] == "16 steps measured, 2 worlds"
    assert result["peer"] == {"numpy": "1"} and result["settings"]["repeats"] == 1
    assert result["provenance"]["machine"]["cores"] >= 1
    for name in rows:
        assert name in shown


def test_without_a_peer_it_says_how_to_name_one() -> None:
    env = make_single()
    rows = speed.peer_rows(Replay(env, record(env, 10, 10)), 0.2, 0.01, 1, None, "say --peer-python PATH")
    assert [row.verdict for row in rows] == ["not measured"] and "--peer-python" in rows[0].note
    env.close()


def test_a_peer_that_cannot_run_is_an_error_of_one_line(monkeypatch) -> None:
    with pytest.raises(OSError, match="No such file"):
        PeerProcess("/nowhere/python")
    monkeypatch.setattr("agents.speed_peers.SCRIPT", "raise SystemExit('broken')")
    with pytest.raises(OSError, match="ended with status 1: broken"):
        PeerProcess(sys.executable)


@pytest.mark.parametrize("argv", [["--seconds", "0"], ["--seconds", "nan"], ["--repeats", "0"]])
def test_misuse(argv: list[str], capsys) -> None:
    with pytest.raises(SystemExit) as exit:
        speed.main(argv)
    assert exit.value.code == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
