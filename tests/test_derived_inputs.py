"""Inputs that are functions of the observation: their values, spaces, and the same in training and inference."""

import numpy as np
import pytest
import toy_environment as toy
import toy_goal as goal
from gymnasium import spaces

from agents.checkpoint import NetworkLayout
from agents.derived_inputs import DERIVED, FINE_SCALE, derive, derived_boxes
from agents.network_policy import Memory, NetworkPolicy
from agents.sb3_env import make_learner_env
from agents.train_config import TrainConfig

goal.register()
toy.register()


@pytest.mark.parametrize("shape", [(3,), (5, 3)])
def test_values(shape):
    rng = np.random.default_rng(0)
    achieved, desired, before = rng.normal(0.0, 0.05, (3, *shape)).astype(np.float32)
    values = [derive(key, achieved, desired, before) for key in DERIVED]
    expected = [desired - achieved, np.tanh((desired - achieved) / FINE_SCALE), desired - before]
    for value, known in zip(values, expected, strict=True):
        np.testing.assert_array_equal(value, known)
        assert value.dtype == np.float32


def test_a_millimetre_is_a_visible_part_of_the_fine_offset():
    fine = derive("goal_offset_fine", np.zeros(1), np.array([0.001]), np.zeros(1))
    assert fine[0] == pytest.approx(0.05, abs=1e-3)


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
        sample, before = space.sample(), space.sample()["desired_goal"]
        assert all(boxes[key].contains(derive(key, *sample.values(), before)) for key in DERIVED)


def test_no_goals_no_derived_inputs():
    assert derived_boxes({}) == {}
    assert derived_boxes({"achieved_goal": spaces.Box(-1, 1, (3,)), "desired_goal": spaces.Box(-1, 1, (2,))}) == {}
    with pytest.raises(ValueError, match=r"keys.*'goal_offset' is not in the observation"):
        make_learner_env(toy.BATCHED, TrainConfig(num_envs=2, batch_size=2, keys=("goal_offset",)))


def copying(keys: tuple[str, ...]) -> NetworkPolicy:
    """A linear network whose action is its inputs, a quarter as large."""
    n = 2 * len(keys)
    layout = NetworkLayout(keys=keys, sizes=(2,) * len(keys), actions=n, hidden=(), epsilon=0.0, clip=np.inf)
    known = {"observation.mean": np.zeros(n), "observation.var": np.full(n, 16.0), "log_std": np.zeros(n)}
    return NetworkPolicy(layout, known | {"actor.0.weight": np.eye(n), "actor.0.bias": np.zeros(n)})


def test_training_and_inference_read_the_same(monkeypatch):
    """Over three episodes of a goal that moves, in several worlds at once."""
    step = goal.Goal.step

    def moving(self, action):
        self.goal = self.goal + 0.1 * np.asarray(action)
        return step(self, action)

    monkeypatch.setattr(goal.Goal, "step", moving)
    config = TrainConfig(num_envs=3, batch_size=2, keys=("goal_offset_fine", "observation", "goal_offset", "goal_step"))
    policy, actions = copying(config.keys), np.random.default_rng(1).uniform(-1, 1, (3 * goal.LIMIT - 1, 3, 2))
    env = make_learner_env(goal.BATCHED, config)
    env.seed(11)
    rows, state, begins = env.reset(), None, np.ones(3, bool)
    assert env.sizes == dict.fromkeys(config.keys, 2)
    for action in actions.astype(np.float32):
        worlds = [world.unwrapped._observe() for world in env.venv.envs]
        seen = {key: np.stack([world[key] for world in worlds]) for key in worlds[0]}
        expected, state = policy.predict(seen, state, begins)
        np.testing.assert_allclose(expected, rows / 4.0, atol=1e-6)
        assert isinstance(state, Memory) and state.base is None
        assert np.array_equal(rows[:, 6:] == 0.0, np.repeat(begins[:, None], 2, axis=1))
        rows, _, begins, infos = env.step(action)
        for i in np.flatnonzero(begins):
            np.testing.assert_allclose(infos[i]["terminal_observation"][6:], 0.1 * action[i], atol=1e-6)
    env.close()


def test_what_is_remembered_is_no_view_of_the_observation():
    policy = copying(("goal_step",))
    observation = {"achieved_goal": np.zeros(2), "desired_goal": np.zeros(2)}
    first, state = policy.predict(observation)
    observation["desired_goal"] += 0.4
    second, state = policy.predict(observation, state)
    third, _ = policy.predict(observation, state)
    fresh, _ = policy.predict({key: value + 1.0 for key, value in observation.items()}, state, np.array([True]))
    for action, known in ((first, 0.0), (second, 0.1), (third, 0.0), (fresh, 0.0)):
        np.testing.assert_allclose(action, known, atol=1e-7)


def test_without_it_nothing_is_remembered():
    observation = {"achieved_goal": np.zeros(2), "desired_goal": np.ones(2)}
    assert copying(("goal_offset",)).predict(observation)[1] is None


def test_missing_goals_are_named():
    with pytest.raises(ValueError, match="desired_goal"):
        copying(("goal_offset",)).predict({"achieved_goal": np.zeros(2)})
