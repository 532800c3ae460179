"""The speed benchmark of the tasks of arms measures what it says; no test here depends on how fast it is."""

import sys
import time
from typing import Any

import numpy as np
import pytest

from agents import cli, speed_manipulation
from agents.bench_setup import GRASP, REACH
from agents.speed_peers import FETCH_SCRIPT, PeerProcess
from agents.speed_runners import BareSteps, Replay, make_single

PEER = """
import json, sys
offer = {"found": ["FetchPickAndPlace-v4"], "missing": {}, "versions": {"mujoco": "3"}}
print("ANSWER " + json.dumps(offer), flush=True)
for line in sys.stdin:
    print("ANSWER [100.0, 0.5, 1.0]", flush=True)
"""


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(speed_manipulation, "STEPS", {REACH: 20, GRASP: 20})


@pytest.mark.usefixtures("short")
def test_bare_steps_begin_where_the_flight_was() -> None:
    env = make_single(REACH)
    flight = speed_manipulation.steady(env, REACH, 20)
    end = env.unwrapped.data.qpos.copy()
    replay = Replay(env, flight)
    replay()
    replay()
    np.testing.assert_array_equal(env.unwrapped.data.qpos, end)
    bare = BareSteps(flight)
    bare()
    assert bare._data.time == pytest.approx(10 * env.unwrapped.dt)
    assert bare._data.qpos.shape == end.shape
    env.close()


def test_a_flight_that_ends_is_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    seeds: list[int] = []

    def record(env: Any, steps: int, chunk: int, seed: int, env_id: str) -> str:
        seeds.append(seed)
        if seed < 2:
            raise RuntimeError("ended")
        return "flight"

    monkeypatch.setattr(speed_manipulation, "record", record)
    assert speed_manipulation.steady(None, REACH, 1) == "flight" and seeds == [0, 1, 2]
    monkeypatch.setattr(speed_manipulation, "SEEDS", 2)
    with pytest.raises(RuntimeError, match="ended"):
        speed_manipulation.steady(None, REACH, 1)


@pytest.mark.usefixtures("short")
def test_the_table_has_every_figure(monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    monkeypatch.setattr(speed_manipulation, "FETCH_SCRIPT", PEER)
    monkeypatch.setattr(speed_manipulation, "NUM_ENVS", 2)
    arguments = ["--seconds", "0.01", "--repeats", "2", "--peer-python", sys.executable]
    assert cli.main(["bench", REACH, "--speed", *arguments]) == 0
    shown = capsys.readouterr().out
    assert "Reach-v0 / bare loop, speed" in shown and "≥ 0.75" in shown and "peer: mujoco 3" in shown
    rows = {row.name: row for row in speed_manipulation.speed(REACH, 0.01, 2, sys.executable, 2)["rows"]}
    np.testing.assert_array_equal(rows["FetchPickAndPlace-v4, physics steps per second"].values, 200.0)
    own = np.array(rows["Reach-v0, physics steps per second"].values)
    np.testing.assert_allclose(rows["Reach-v0 / FetchPickAndPlace-v4, physics steps"].values, own / 200.0)
    assert rows["Reach-v0, batch of 2, 1 thread / single env, speed"].values


def test_a_missing_peer_is_said() -> None:
    with PeerProcess(sys.executable, FETCH_SCRIPT) as peer:
        missing = peer.peers.missing
        row = speed_manipulation.peer_rows("Reach-v0", None, 0.1, 1, peer)[0]  # type: ignore[arg-type]
    assert list(missing) == ["FetchPickAndPlace-v4"] and row.verdict == "not measured" and row.note in missing.values()
    assert "--peer-python" in speed_manipulation.peer_rows("Reach-v0", None, 0.1, 1, None)[0].note  # type: ignore[arg-type]


def test_plans_are_timed_by_the_processors_clock() -> None:
    def idle(*arguments: int) -> tuple[int, ...]:
        time.sleep(0.05)
        return arguments

    timed = speed_manipulation.Timed(idle)
    assert timed(1, 2) == (1, 2) and timed.seconds[0] < 0.04
    times = speed_manipulation.planning_times(GRASP, 1)
    assert times.shape == (1,) and times[0] > 0.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["aerograsp/GraspDual-v0"], "aerograsp/GraspDual-v0"),
        ([REACH, "--repeats", "0"], "repeats"),
        ([REACH, "--seconds", "-1"], "positive number of seconds"),
        ([REACH, "--peer-python", "/no/such/python"], "/no/such/python"),
    ],
)
@pytest.mark.usefixtures("short")
def test_mistakes_are_said(arguments: list[str], message: str, capsys: Any) -> None:
    assert cli.main(["bench", *arguments, "--speed"]) == 2
    assert message in capsys.readouterr().err


def test_other_ids_are_refused() -> None:
    with pytest.raises(ValueError, match="unknown id"):
        speed_manipulation.speed("aerograsp/GraspDual-v0")
