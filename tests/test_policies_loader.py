"""Policies by name, path and factory."""

import json
import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import toy_env
from toy_env import TOY, Proportional

from agents import policies
from agents.policies import PolicyUnavailable, UnknownName, checkpoints, load_policy
from agents.trivial_policies import RandomPolicy, batch_size


@pytest.fixture(autouse=True)
def toy_policies(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("baselines.policies.POLICIES", toy_env.POLICIES, raising=False)


def observations(n: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(n)
    return {key: rng.uniform(-1, 1, (n, 3)).astype(np.float32) for key in ("position_error", "set_point")}


def test_zero() -> None:
    policy = load_policy(TOY, "zero")
    action, state = policy.predict(observations(4))
    assert action.shape == (4, 3) and action.dtype == np.float32 and not action.any() and state is None
    assert policy.predict({key: value[0] for key, value in observations(1).items()})[0].shape == (3,)


def test_random_is_uniform_bounded_and_repeatable() -> None:
    draws, state = [], None
    for _ in range(300):
        action, state = load_policy(TOY, "random").predict(observations(4), state)
        draws.append(action)
    sample = np.stack(draws)
    assert sample.dtype == np.float32 and np.abs(sample).max() <= 1.0
    assert abs(sample.mean()) < 0.05 and abs(sample.std() - 1.0 / np.sqrt(3.0)) < 0.02
    assert len(np.unique(sample)) > 0.99 * sample.size  # no stream repeats another
    assert np.array_equal(load_policy(TOY, "random").predict(observations(4))[0], draws[0])


def test_random_numbers_its_episodes_in_the_order_of_their_start() -> None:
    policy = load_policy(TOY, "random")
    batch, state = policy.predict(observations(3))  # episodes 0, 1, 2
    later, state = policy.predict(observations(3), state, np.array([False, True, False]))  # row 1 begins episode 3
    single, alone = policy.predict(observations(1))
    rows = [single[0]]
    for _ in range(3):
        single, alone = policy.predict(observations(1), alone, np.array([True]))
        rows.append(single[0])
    assert np.array_equal(batch, rows[:3])
    assert np.array_equal(later[1], rows[3])
    assert state.episodes == 4 and state.step.tolist() == [2, 1, 2]


def test_random_seeds_differ_and_negative_ones_are_refused() -> None:
    env = gymnasium.make(TOY)
    one, two = (RandomPolicy(env.action_space, env.observation_space, seed) for seed in (0, 1))
    assert not np.array_equal(one.predict(observations(2))[0], two.predict(observations(2))[0])
    with pytest.raises(ValueError, match="seed"):
        RandomPolicy(env.action_space, env.observation_space, -1)


def test_batch_size() -> None:
    space = gymnasium.make(TOY).observation_space
    assert batch_size(observations(5), space) == 5
    assert batch_size({key: value[0] for key, value in observations(1).items()}, space) is None
    with pytest.raises(ValueError, match="observation"):
        batch_size({key: value[:, :2] for key, value in observations(2).items()}, space)


def test_registered_names_and_factories() -> None:
    assert isinstance(load_policy(TOY, "p"), Proportional)
    assert isinstance(load_policy(TOY, "toy_env:Proportional"), Proportional)
    assert policies.policy_names(TOY) == ["zero", "random", "p"]


def test_a_factory_in_the_working_directory_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "my_own_policy.py").write_text("from toy_env import Proportional as make\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path])
    assert isinstance(load_policy(TOY, "my_own_policy:make"), Proportional)


@pytest.mark.parametrize(
    ("env_id", "name", "message"),
    [
        ("toy/Hold-v1", "zero", "unknown id 'toy/Hold-v1'"),
        (TOY, "zeor", "did you mean 'zero'.*valid: zero, random, p, "),
        (TOY, "no_such_module:make", "no module 'no_such_module'"),
        (TOY, "toy_env:Proportionl", "did you mean 'Proportional'"),
        (TOY, "toy_env:not_a_policy", "predict"),
        (TOY, "", "unknown policy"),
    ],
)
def test_unknown_names_list_what_would_have_worked(env_id: str, name: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        load_policy(env_id, name)


def test_what_is_known_but_not_here_is_told_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(policies, "CHECKPOINTS", tmp_path)
    with pytest.raises(PolicyUnavailable, match="no checkpoint"):
        load_policy(TOY, "ppo")
    with pytest.raises(FileNotFoundError, match=r"none\.safetensors"):
        load_policy(TOY, "none.safetensors")
    (tmp_path / "half_made.py").write_text("import a_module_nobody_has\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(PolicyUnavailable, match="a_module_nobody_has"):
        load_policy(TOY, "half_made:make")


def test_shipped_checkpoints_are_found_and_the_best_stands_for_its_kind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(policies, "CHECKPOINTS", tmp_path)
    errors = {"ppo-seed0": 0.02, "ppo-seed1": 0.01, "ppo-seed2": None, "ppo-residual-seed0": 0.005}
    for name, error in errors.items():
        (tmp_path / f"toy-hold-v0-{name}.safetensors").touch()
        (tmp_path / f"toy-hold-v0-{name}.json").write_text(json.dumps({"validation_error": error}))
    found = {name: path.stem.removeprefix("toy-hold-v0-") for name, path in checkpoints(TOY).items()}
    assert found == {name: name for name in errors} | {"ppo": "ppo-seed1", "ppo-residual": "ppo-residual-seed0"}
    assert checkpoints("toy/Other-v0") == {}


def test_checkpoints_are_handed_to_the_network_loader(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "mine.safetensors"
    file.touch()
    monkeypatch.setattr("agents.network_policy.load_network_policy", lambda path: ("loaded", path))
    assert load_policy(TOY, file) == ("loaded", file)
    monkeypatch.setitem(sys.modules, "agents.network_policy", None)  # as if its dependencies were missing
    with pytest.raises(PolicyUnavailable, match=r"aerograsp\[learn\]"):
        load_policy(TOY, file)


def test_loading_and_evaluating_need_no_torch() -> None:
    code = (
        "import sys; sys.modules['torch'] = None; sys.path.insert(0, sys.argv[1]); import toy_env\n"
        "import baselines.policies; baselines.policies.POLICIES = toy_env.POLICIES\n"
        "from agents import evaluate, load_policy\n"
        "load_policy(toy_env.TOY, 'toy_env:Proportional'); evaluate(toy_env.TOY, 'random', 2)\n"
        "assert 'stable_baselines3' not in sys.modules and 'matplotlib' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code, str(Path(__file__).parent)], check=True)


def test_unknown_name_is_a_value_error_without_wrong_hints() -> None:
    message = str(UnknownName("thing", "xyz", ["abc"]))
    assert message == "unknown thing 'xyz'; valid: abc"
