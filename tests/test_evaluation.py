"""Evaluation: pinned episodes, whatever runs them."""

import itertools
import json
from typing import Any

import gymnasium
import numpy as np
import pytest
import toy_env
from toy_env import STEPS, TOY, TOY_SINGLE, Forgetful, HoldVectorEnv, Proportional, Undecided

import agents
from agents.evaluation import EvaluationResult, evaluate
from agents.files import dumps
from agents.seeds import TEST_SEEDS, TRAIN_SEEDS, VALIDATION_SEEDS
from agents.traces import trace
from agents.trivial_policies import RandomPolicy


@pytest.fixture(autouse=True)
def toy_policies(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("baselines.policies.POLICIES", toy_env.POLICIES, raising=False)


def same(a: EvaluationResult, b: EvaluationResult) -> bool:
    return (
        all(np.array_equal(a.values(name), b.values(name), equal_nan=True) for name in a.names)
        and a.names == b.names
        and a.terminations.tolist() == b.terminations.tolist()
    )


def by_hand(policy, seed: int, episodes: int) -> list[dict]:
    rows = []
    for k in range(episodes):
        env = gymnasium.make(TOY_SINGLE)
        observation, _ = env.reset(seed=seed + k)
        total, length, state, done = 0.0, 0, None, False
        while not done:
            action, state = policy.predict(observation, state)
            observation, reward, terminated, truncated, info = env.step(action)
            total, length, done = total + float(reward), length + 1, terminated or truncated
        rows.append({"returns": total, "lengths": length, "success": info["success"], **info["metrics"]})
    return rows


def test_every_number_is_what_a_loop_by_hand_gives() -> None:
    result = evaluate(TOY_SINGLE, Proportional(), episodes=4, seed=5)
    for k, row in enumerate(by_hand(Proportional(), 5, 4)):
        for name, value in row.items():
            assert result.values(name)[k] == value


@pytest.mark.parametrize("policy", ["zero", "random", "toy_env:Proportional"])
@pytest.mark.parametrize("noise", [0.05, 0.4])  # the latter terminates episodes early, at different times
def test_results_do_not_depend_on_how_the_episodes_are_run(policy: str, noise: float) -> None:
    options: dict[str, Any] = {"env_kwargs": {"noise": noise}, "episodes": 7, "seed": 11}
    single = evaluate(TOY_SINGLE, policy, **options)
    for env_id, num_envs in [(TOY, None), (TOY, 1), (TOY, 3), (TOY_SINGLE, 4), (TOY, 100)]:
        assert same(single, evaluate(env_id, policy, num_envs=num_envs, **options))
    assert (single.terminations == "out_of_bounds").any() == (noise > 0.1)


def test_episode_k_resets_with_seed_plus_k() -> None:
    whole = evaluate(TOY, "toy_env:Proportional", episodes=6, seed=20)
    part = evaluate(TOY, "toy_env:Proportional", episodes=2, seed=23)
    assert np.array_equal(whole.returns[3:5], part.returns)


def test_many_episodes_run_in_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    sizes = []
    make = HoldVectorEnv.__init__

    def spy(self, num_envs: int = 1, **options) -> None:
        sizes.append(num_envs)
        make(self, num_envs, **options)

    monkeypatch.setattr(HoldVectorEnv, "__init__", spy)
    result = evaluate(TOY, "zero", episodes=101, env_kwargs={"max_episode_steps": 3})
    assert sizes == [34]
    assert result.episodes == 101
    assert (result.lengths == 3).all()


def test_a_state_that_outlives_its_episode_shows() -> None:
    assert not same(
        evaluate(TOY, Forgetful(), episodes=4, num_envs=1), evaluate(TOY, Proportional(), episodes=4, num_envs=1)
    )


def test_evaluation_twice_is_the_same_for_every_deterministic_policy() -> None:
    for policy in (Proportional(), "random"):
        assert same(evaluate(TOY, policy, episodes=3), evaluate(TOY, policy, episodes=3))
    assert not same(evaluate(TOY, Undecided(), episodes=3), evaluate(TOY, Undecided(), episodes=3))


def test_a_random_policy_object_starts_afresh_in_every_evaluation() -> None:
    env = gymnasium.make(TOY)
    policy = RandomPolicy(env.action_space, env.observation_space, seed=4)
    assert same(evaluate(TOY, policy, episodes=3), evaluate(TOY, policy, episodes=3))


@pytest.mark.parametrize("env_id", [TOY, TOY_SINGLE])
def test_max_episode_steps_is_an_option(env_id: str) -> None:
    assert evaluate(env_id, "zero", episodes=2, env_kwargs={"max_episode_steps": 7}).lengths.tolist() == [7, 7]
    assert evaluate(env_id, "zero", episodes=2).lengths.tolist() == [STEPS, STEPS]


def test_statistics_of_a_result() -> None:
    result = evaluate(TOY, Proportional(), episodes=20)
    assert result.policy == "Proportional"
    assert result.mean("success") == result.success.mean()
    low, high = result.interval("error_x")
    assert low < result.iqm("error_x") < high
    assert result.interval("error_x", "mean") != result.interval("error_x")
    assert set(result.names) == {"success", "returns", "lengths", "error", "error_x", "error_y", "error_z", "crash"}
    with pytest.raises(ValueError, match="error_x"):
        result.iqm("eror_x")
    with pytest.raises(ValueError, match="iqm, mean"):
        result.interval("error", "median")


def test_a_result_survives_json_undefined_values_included() -> None:
    result = evaluate(TOY, "zero", episodes=3, env_kwargs={"noise": 0.3})
    result.metrics["error"][1] = np.nan
    again = EvaluationResult.from_dict(json.loads(dumps(result.to_dict())))
    assert same(result, again)
    assert np.isnan(again.mean("error"))
    broken = json.loads(dumps(result.to_dict()))
    with pytest.raises(ValueError, match="3 episodes"):
        EvaluationResult.from_dict({**broken, "returns": [1.0]})
    with pytest.raises(ValueError, match="not an evaluation result"):
        EvaluationResult.from_dict({"env_id": TOY})


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"env_id": "toy/Hod-v0"}, "unknown id"),
        ({"policy": "toy_env:Proportionl"}, "did you mean 'Proportional'"),
        ({"episodes": 0}, "episodes"),
        ({"episodes": 2.5}, "episodes"),
        ({"seed": -1}, "seed"),
        ({"num_envs": 0}, "num_envs"),
        ({"env_kwargs": {"noize": 1.0}}, "did you mean 'noise'"),
        ({"env_kwargs": {"noize": 1.0}, "policy": Proportional()}, "valid: noise, render_mode, max_episode_steps"),
        ({"env_kwargs": {"noise": -1.0}}, "noise"),
    ],
)
def test_bad_input_is_refused_by_name(options: dict, named: str) -> None:
    with pytest.raises(ValueError, match=named):
        evaluate(**{"env_id": TOY, "policy": "zero", "episodes": 2, **options})


def test_an_action_of_the_wrong_shape_is_refused() -> None:
    class Flat:
        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            return np.zeros(3, np.float32), None

    with pytest.raises(ValueError, match=r"\(2, 3\)"):
        evaluate(TOY, Flat(), episodes=2)


def test_the_trace_is_the_observed_error() -> None:
    line = trace(TOY, "toy_env:Proportional", seed=3)
    assert line.time.tolist() == pytest.approx((0.1 * np.arange(STEPS)).tolist())
    observation, _ = gymnasium.make(TOY).reset(seed=3)
    assert line.error[0] == pytest.approx(np.linalg.norm(observation["position_error"]))
    assert line.error[-1] < line.error[0]


def test_seed_ranges_are_disjoint() -> None:
    ranges = sorted((TEST_SEEDS, VALIDATION_SEEDS, TRAIN_SEEDS), key=lambda seeds: seeds.start)
    assert all(a.stop <= b.start for a, b in itertools.pairwise(ranges))


def test_the_package_gives_the_functions() -> None:
    assert agents.evaluate is evaluate
    assert callable(agents.load_policy)
    assert "evaluate" in dir(agents)
    with pytest.raises(AttributeError):
        agents.no_such_name  # noqa: B018
