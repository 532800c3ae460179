"""Inputs that are functions of the observation: their values, spaces, and the same in training and inference."""

import gymnasium
import numpy as np
import pytest
import toy_environment as toy
import toy_goal as goal
from gymnasium import spaces

from agents.checkpoint import NetworkLayout
from agents.derived_inputs import DERIVED, FINE_SCALE, derived_boxes, with_derived
from agents.network_policy import NetworkPolicy
from agents.sb3_env import make_learner_env
from agents.train_config import TrainConfig

goal.register()
toy.register()


def goals(*shape: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    return {key: rng.normal(0.0, 0.05, shape).astype(np.float32) for key in ("achieved_goal", "desired_goal")}


@pytest.mark.parametrize("shape", [(3,), (5, 3)])
def test_values(shape):
    observation = goals(*shape)
    derived = with_derived(observation, ("achieved_goal", *DERIVED))
    offset = observation["desired_goal"] - observation["achieved_goal"]
    np.testing.assert_array_equal(derived["goal_offset"], offset)
    np.testing.assert_array_equal(derived["goal_offset_fine"], np.tanh(offset / FINE_SCALE))
    assert {value.dtype for value in derived.values()} == {np.dtype(np.float32)}
    assert with_derived(observation, ("achieved_goal",)) is observation


def test_a_millimetre_is_a_visible_part_of_the_fine_offset():
    observation = {"achieved_goal": np.zeros(1), "desired_goal": np.array([0.001])}
    assert with_derived(observation, DERIVED)["goal_offset_fine"][0] == pytest.approx(0.05, abs=1e-3)


def test_what_was_derived_before_is_computed_anew():
    stale = goals(3) | {"goal_offset": np.full(3, 7.0)}
    assert with_derived(stale, stale)["goal_offset"].max() < 1.0


def test_spaces_hold_every_value():
    space = spaces.Dict(
        {
            "achieved_goal": spaces.Box(-1.0, 2.0, (2,), np.float32),
            "desired_goal": spaces.Box(-3.0, 5.0, (2,), np.float32),
        }
    )
    boxes = derived_boxes(space.spaces)
    assert tuple(boxes) == DERIVED
    np.testing.assert_array_equal(boxes["goal_offset"].low, [-5.0, -5.0])
    np.testing.assert_array_equal(boxes["goal_offset"].high, [6.0, 6.0])
    for _ in range(50):
        derived = with_derived(space.sample(), DERIVED)
        assert all(boxes[key].contains(derived[key]) for key in DERIVED)


def test_no_goals_no_derived_inputs():
    assert derived_boxes({}) == {}
    assert derived_boxes({"achieved_goal": spaces.Box(-1, 1, (3,)), "desired_goal": spaces.Box(-1, 1, (2,))}) == {}
    with pytest.raises(KeyError, match="achieved_goal"):
        with_derived({}, DERIVED)
    with pytest.raises(ValueError, match=r"keys.*'goal_offset' is not in the observation"):
        make_learner_env(toy.BATCHED, TrainConfig(num_envs=2, batch_size=2, keys=("goal_offset",)))


def test_training_and_inference_read_the_same():
    """A linear network that copies its inputs gives what the learner's environment shows."""
    config = TrainConfig(num_envs=3, batch_size=2, keys=("goal_offset_fine", "observation", "goal_offset"))
    env = make_learner_env(goal.BATCHED, config)
    single = gymnasium.make(goal.SINGLE)
    try:
        env.seed(11)
        rows = env.reset()
        assert env.sizes == {"goal_offset_fine": 2, "observation": 2, "goal_offset": 2}
        layout = NetworkLayout(keys=env.keys, sizes=(2, 2, 2), actions=6, hidden=(), epsilon=0.0, clip=np.inf)
        tensors = {"observation.mean": np.zeros(6), "observation.var": np.full(6, 16.0), "log_std": np.zeros(6)}
        tensors |= {"actor.0.weight": np.eye(6), "actor.0.bias": np.zeros(6)}
        policy = NetworkPolicy(layout, tensors)
        for i in range(3):
            observation, _ = single.reset(seed=11 + i)
            np.testing.assert_allclose(policy.predict(observation)[0], rows[i] / 4.0, atol=1e-6)
            assert np.abs(rows[i]).max() > 0.1
    finally:
        env.close()
        single.close()


def test_missing_goals_are_named():
    layout = NetworkLayout(keys=("goal_offset",), sizes=(2,), actions=2, hidden=(), epsilon=0.0)
    tensors = {"observation.mean": np.zeros(2), "observation.var": np.ones(2), "log_std": np.zeros(2)}
    tensors |= {"actor.0.weight": np.eye(2), "actor.0.bias": np.zeros(2)}
    with pytest.raises(ValueError, match="desired_goal"):
        NetworkPolicy(layout, tensors).predict({"achieved_goal": np.zeros(2)})
