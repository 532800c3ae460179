"""The contract checks find what they are for."""

import json
from pathlib import Path

import numpy as np
import pytest
import toy_env
from toy_env import TOY, Proportional

from aerograsp_env.registration import REFERENCE_POLICIES
from agents import smoke as module
from agents.smoke import CHECKS, main, smoke, smoke_text
from baselines.policies import POLICIES


@pytest.fixture(autouse=True)
def toy_policies(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("baselines.policies.POLICIES", toy_env.POLICIES, raising=False)


class Absent(Proportional):
    """Does nothing."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        action, state = super().predict(observation, state, episode_start, deterministic)
        return 0.0 * action, state


class FirstRowOnly(Proportional):
    """Gives every row the first one's action."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        action, state = super().predict(observation, state, episode_start, deterministic)
        return np.broadcast_to(action[:1], action.shape).copy() if action.ndim == 2 else action, state


class Invalid(Proportional):
    """Not a number, after some steps."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        action, state = super().predict(observation, state, episode_start, deterministic)
        return np.where(state.reshape(-1, 1) > 5, np.nan, action).astype(np.float32), state


class Watcher(Proportional):
    """An oracle: its world tells it the error."""

    def watch(self, worlds):
        self.worlds = worlds

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        error = np.stack([world._set_point - world._position for world in self.worlds])
        return np.clip(5.0 * error, -1.0, 1.0).astype(np.float32), state


class Raises:
    """Fails."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        raise RuntimeError("out of\norder")


def failures(name: str) -> dict[str, str]:
    (row,) = smoke([TOY], [name], episodes=2)
    assert row.passed == (not row.failures)
    return row.failures


def test_sound_policies_pass_every_check() -> None:
    rows = smoke([TOY])
    assert [row.policy for row in rows] == ["zero", "random", "p"]
    assert all(row.passed for row in rows)
    assert rows[2].success == 1.0 and rows[0].success < 0.5
    assert "3 passed, 0 failed" in smoke_text(rows)


@pytest.mark.parametrize(
    ("name", "check", "why"),
    [
        ("toy_env:Wild", "actions", "dtype float32, got float64"),
        ("test_smoke:Invalid", "actions", "step 5: not finite"),
        ("toy_env:Undecided", "determinism", "episode 0"),
        ("toy_env:Forgetful", "restart", "remembers"),
        ("test_smoke:FirstRowOnly", "batch", "rows"),
        ("test_smoke:Raises", "run", "RuntimeError: out of order"),
    ],
)
def test_each_fault_is_found_by_its_check(name: str, check: str, why: str) -> None:
    found = failures(name)
    assert why in found[check]


def test_the_floor_holds_for_the_ids_own_policies_only(monkeypatch: pytest.MonkeyPatch) -> None:
    assert failures("test_smoke:Absent") == {}
    monkeypatch.setitem(toy_env.POLICIES, TOY, {"p": "test_smoke:Absent"})
    assert list(failures("p")) == ["floor"]


def test_the_floor_leaves_out_what_is_weak_by_design(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(toy_env.POLICIES, TOY, {"p": "test_smoke:Absent", "q": "test_smoke:Absent"})
    monkeypatch.setitem(module.WEAK, TOY, ("q",))
    assert list(failures("p")) == ["floor"] and failures("q") == {}


def test_every_weak_policy_exists_and_the_reference_is_none() -> None:
    for env_id, names in module.WEAK.items():
        known = POLICIES[env_id]
        assert set(names) <= known.keys()
        assert REFERENCE_POLICIES[env_id] not in {known[name] for name in names}


def test_oracles_are_told_their_world_and_not_replayed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(toy_env.POLICIES, TOY, {"w": "test_smoke:Watcher"})
    (row,) = smoke([TOY], ["w"], episodes=2)
    assert row.passed and row.oracle and row.success == 1.0
    assert smoke_text([row]).splitlines()[1].split()[2:8] == ["✓", "✓", "✓", "–", "–", "✓"]


def test_grasp_planning_passes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("baselines.policies.POLICIES", POLICIES)
    rows = smoke(["aerograsp/GraspPlan-v0"], ["zero", "gpis", "cloud", "oracle-mesh"])
    assert all(row.passed for row in rows), smoke_text(rows)
    assert [row.floor for row in rows] == [0.0, 0.5, 0.0, 0.5]


def test_a_registered_policy_that_cannot_be_loaded_is_a_failed_row(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(toy_env.POLICIES, TOY, {"p": "toy_env:Proportional", "gone": "no_such_module:make"})
    rows = {row.policy: row for row in smoke([TOY], episodes=1)}
    assert "no module" in rows["gone"].failures["run"] and rows["p"].passed


def test_observations_outside_their_space_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        toy_env.HoldEnv,
        "_observation",
        lambda self: {key: np.full(3, 9.0, np.float32) for key in ("position_error", "set_point")},
    )
    assert "worlds" in failures("zero")


def test_names_that_no_id_has_are_refused() -> None:
    with pytest.raises(ValueError, match="unknown policy"):
        smoke([TOY], ["pid"])
    with pytest.raises(ValueError, match="unknown id"):
        smoke(["toy/None-v0"])


def test_the_command_reports_and_its_status_tells(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    report = tmp_path / "smoke.json"
    assert main([TOY, "--policy", "p", "--episodes", "1", "--steps", "30", "--json", str(report)]) == 0
    assert json.loads(report.read_text())["rows"][0]["passed"] is True
    assert main([TOY, "--policy", "toy_env:Wild", "--episodes", "1"]) == 1
    output = capsys.readouterr().out
    assert f"FAILED {TOY} toy_env:Wild: actions:" in output
    assert all(name in output for name in CHECKS)


def test_every_check_is_documented() -> None:
    assert all(f"| {name} |" in (module.__doc__ or "") for name in CHECKS)
