"""The native batched environments: equal to the single ones, to the last bit, across episodes."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from dock_worlds import ATTACH, DOCK
from gymnasium.vector import AutoresetMode

from aerograsp_env.manipulation_vector import ReachVectorEnv
from aerograsp_env.vector import DockAttachVectorEnv, DockVectorEnv
from aerograsp_env.wrappers import ResidualAction, ResidualActionVector
from baselines.policies.dock import pid, pid_tuned

REACH = "aerograsp/Reach-v0"
NATIVE = {DOCK: DockVectorEnv, ATTACH: DockAttachVectorEnv, REACH: ReachVectorEnv}
IDS = tuple(NATIVE)
HARD: dict[str, Any] = {"randomize": True, "command_delay": (0.02, 0.10), "wind": "gusty"}
MORE: dict[str, dict[str, Any]] = {REACH: {"pose": "estimated", "action_mode": "ee_twist", "payload": 0.2}}  # HARD too
every_id = pytest.mark.parametrize("env_id", IDS)


def native(env_id: str, n: int, **options: Any):
    return gymnasium.make_vec(env_id, num_envs=n, **options)


def actions_of(env_id: str, observation: dict[str, np.ndarray], rng: np.random.Generator) -> np.ndarray:
    """Some that keep a world going and explore: towards the set-point, the seat or the target, with noise."""
    if env_id == REACH:
        n, size = observation["observation"].shape[0], 6
        goal = np.zeros((n, size))
        goal[:, :3] = observation["desired_goal"] - observation["achieved_goal"]
        return np.clip(2.0 * goal + rng.normal(0.0, 0.2, goal.shape), -1.0, 1.0).astype(np.float32)
    key = "position_error" if env_id == DOCK else "seat_offset"
    goal = 1.5 * observation[key]
    action = np.clip(goal + rng.normal(0.0, 0.1, goal.shape), -0.6, 0.6)
    if env_id == ATTACH:
        extra = np.stack([rng.uniform(-0.1, 0.1, len(goal)), np.ones(len(goal))], axis=1)
        action = np.concatenate([action, extra], axis=1)
    return action.astype(np.float32)


def row(value: Any, i: int) -> Any:
    """World i of a batched value: nested dicts of arrays, with what Gymnasium's masks say it has."""
    if isinstance(value, dict):
        return {k: row(v, i) for k, v in value.items() if not k.startswith("_") and value.get(f"_{k}", {i: True})[i]}
    return value[i]


def assert_same(single: Any, batched: Any) -> None:
    if isinstance(single, dict):
        assert single.keys() == batched.keys()
        for key in single:
            assert_same(single[key], batched[key])
    else:
        assert np.array_equal(single, batched), (single, batched)


# equality with the single environment -------------------------------------------------------------


@every_id
@pytest.mark.parametrize("mode", ["next_step", "same_step", "disabled"])
@pytest.mark.parametrize("hard", [False, True], ids=["default", "hard"])
def test_a_batch_equals_single_worlds_exactly_across_episodes(env_id, mode, hard):
    n, limit, seed = 3, 150, 40
    options = HARD | MORE.get(env_id, {}) if hard else {}
    batch = native(env_id, n, max_episode_steps=limit, autoreset_mode=mode, **options)
    singles = [gymnasium.make(env_id, max_episode_steps=limit, **options) for _ in range(n)]
    rng = np.random.default_rng(0)
    observation, info = batch.reset(seed=seed)
    for i, env in enumerate(singles):
        single_observation, single_info = env.reset(seed=seed + i)
        assert_same(single_observation, row(observation, i))
        assert_same(single_info, row(info, i))
    done, episodes = np.zeros(n, bool), np.zeros(n, int)
    for _ in range(400):
        actions = actions_of(env_id, observation, rng)
        if mode == "disabled" and done.any():
            observation, info = batch.reset(options={"reset_mask": done})
            for i in np.flatnonzero(done):
                single_observation, single_info = singles[i].reset()
                assert_same(single_observation, row(observation, i))
                assert_same(single_info, row(info, i))
            done[:] = False
        observation, rewards, terminations, truncations, info = batch.step(actions)
        for i, env in enumerate(singles):
            if mode == "next_step" and done[i]:  # this step was the reset
                single_observation, single_info = env.reset()
                single = single_observation, 0.0, False, False, single_info
            else:
                single = env.step(actions[i])
            over = single[2] or single[3]
            assert (rewards[i], terminations[i], truncations[i]) == single[1:4]
            if mode == "same_step" and over:
                assert_same(single[0], info["final_obs"][i])
                assert_same(single[4], row(info["final_info"], i))
                single_observation, single_info = env.reset()
                single = (single_observation, *single[1:4], single_info)
            assert_same(single[0], row(observation, i))
            assert_same(single[4], row({k: v for k, v in info.items() if not k.startswith("final")}, i))
            done[i] = over
            episodes[i] += over
    assert (episodes >= 2).all()
    batch.close()


def test_a_whole_episode_of_sixty_seconds_is_equal():
    batch, env, policy = native(DOCK, 2, **HARD), gymnasium.make(DOCK, **HARD), pid_tuned()
    observation, _ = batch.reset(seed=[5, 17])
    single, _ = env.reset(seed=17)
    state, own = None, None
    for _ in range(3000):
        action, state = policy.predict(observation, state)
        one, own = policy.predict(single, own)
        assert np.array_equal(one, action[1])
        observation, rewards, terminations, truncations, info = batch.step(action)
        single, reward, terminated, truncated, single_info = env.step(one)
        assert_same(single, row(observation, 1))
        assert (reward, terminated, truncated) == (rewards[1], terminations[1], truncations[1])
    assert truncated
    assert_same(single_info, row(info, 1))


@pytest.mark.parametrize("env_id", IDS)
def test_threads_change_nothing(env_id):
    n = 16
    options = HARD | MORE.get(env_id, {})
    one, two = native(env_id, n, threads=1, **options), native(env_id, n, threads=2, **options)
    rng = np.random.default_rng(0)
    observation, _ = one.reset(seed=0)
    assert_same(observation, two.reset(seed=0)[0])
    assert one.unwrapped._worlds._pool is None and two.unwrapped._worlds._pool is not None
    for _ in range(120):
        actions = actions_of(env_id, observation, rng)
        a, b = one.step(actions), two.step(actions)
        for x, y in zip(a, b, strict=True):
            assert_same(x, y)
        observation = a[0]
    one.close()
    two.close()


# Gymnasium's vector interface ---------------------------------------------------------------------


@every_id
def test_make_vec_gives_the_native_environment(env_id):
    env = native(env_id, 4, max_episode_steps=7)
    assert type(env.unwrapped) is NATIVE[env_id]
    single = gymnasium.make(env_id)
    assert env.single_observation_space == single.observation_space
    assert env.single_action_space == single.action_space
    assert env.unwrapped.action_layout == single.unwrapped.action_layout
    assert (env.num_envs, env.unwrapped.dt, env.spec.id) == (4, single.unwrapped.dt, env_id)
    assert env.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    observation, _ = env.reset(seed=0)
    assert env.observation_space.contains(observation)
    for k in range(7):
        observation, rewards, terminations, truncations, _ = env.step(env.action_space.sample())
        assert env.observation_space.contains(observation)
        assert (rewards.dtype, terminations.dtype, truncations.dtype) == (np.float64, bool, bool)
        assert truncations.all() == (k == 6)
    assert native(env_id, 1).unwrapped.max_episode_steps == single.spec.max_episode_steps


def test_infos_carry_their_masks():
    env = native(DOCK, 3)
    _, info = env.reset(seed=0)
    step = env.step(np.zeros((3, 3), np.float32))[4]
    for infos in (info, step):
        assert infos.keys() == {"success", "reward_terms", "metrics", "termination"} | {
            f"_{k}" for k in ("success", "reward_terms", "metrics", "termination")
        }
        for group in (infos, infos["reward_terms"], infos["metrics"]):
            for key, value in group.items():
                if key.startswith("_"):
                    assert value.dtype == bool and value.shape == (3,)
                    assert key[1:] in group
                elif not isinstance(value, dict):
                    assert value.shape == (3,) and f"_{key}" in group
        assert infos["success"].dtype == bool


def test_a_masked_reset_leaves_the_other_worlds_alone():
    env = native(DOCK, 3, autoreset_mode="disabled", wind="gusty")
    env.reset(seed=0)
    before, *_ = env.step(np.full((3, 3), 0.2, np.float32))
    states = env.unwrapped.states.copy()
    mask = np.array([False, True, False])
    observation, info = env.reset(seed=9, options={"reset_mask": mask, "goal": (0.0, 0.0, 0.01)})
    assert_same(row(before, 0), row(observation, 0))
    assert_same(row(before, 2), row(observation, 2))
    assert states[0] == env.unwrapped.states[0] and env.unwrapped.states["step"][1] == 0
    np.testing.assert_array_equal(info["_success"], mask)
    single, _ = gymnasium.make(DOCK, wind="gusty").reset(seed=10, options={"goal": (0.0, 0.0, 0.01)})
    assert_same(single, row(observation, 1))


def test_returned_arrays_are_the_callers_own():
    env = native(DOCK, 2)
    observation, _ = env.reset(seed=0)
    kept = {key: value.copy() for key, value in observation.items()}
    for _ in range(3):
        _, rewards, _, _, step_info = env.step(np.full((2, 3), 0.3, np.float32))
    saved = rewards.copy(), step_info["metrics"]["effort"].copy(), step_info["reward_terms"]["position"].copy()
    env.step(np.zeros((2, 3), np.float32))
    assert_same(kept, observation)
    assert np.array_equal(saved[0], rewards)
    assert np.array_equal(saved[1], step_info["metrics"]["effort"])
    assert np.array_equal(saved[2], step_info["reward_terms"]["position"])


def test_rewards_are_the_sums_of_their_terms():
    env = native(DOCK, 4, wind="gusty")
    env.reset(seed=0)
    for _ in range(50):
        _, rewards, *_, info = env.step(env.action_space.sample())
        terms = [value for key, value in info["reward_terms"].items() if not key.startswith("_")]
        assert np.array_equal(rewards, sum(terms))


# refusals -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"num_envs": 0}, "num_envs"),
        ({"num_envs": 2.0}, "num_envs"),
        ({"max_episode_steps": 0}, "max_episode_steps"),
        ({"autoreset_mode": "nextstep"}, "'next_step'"),
        ({"render_mode": "rgb_array"}, "render_mode"),
        ({"reward_mode": "spars"}, "'sparse'"),
        ({"wnd": "calm"}, "'wind'"),
        ({"threads": 0}, "threads"),
        ({"threads": -1}, "threads"),
    ],
)
def test_bad_options_are_refused_by_name(options, word):
    with pytest.raises(ValueError, match=word):
        DockVectorEnv(**options)


def test_bad_calls_are_refused():
    env = DockVectorEnv(3, max_episode_steps=2, autoreset_mode="disabled")
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros((3, 3)))
    for seed, options, word in (
        ([1, 2], None, "seed"),
        (0, {"reset_mask": [True]}, "reset_mask"),
        (0, {"reset_mask": np.ones(3)}, "reset_mask"),
        (0, {"gaol": 1}, "goal"),
    ):
        with pytest.raises(ValueError, match=word):
            env.reset(seed=seed, options=options)
    env.reset(seed=0)
    for bad, word in ((np.zeros(3), "shape"), (np.full((3, 3), np.nan), "finite"), (np.zeros((3, 3), bool), "numeric")):
        with pytest.raises(ValueError, match=word):
            env.step(bad)
    env.step(np.zeros((3, 3)))
    env.step(np.zeros((3, 3)))
    with pytest.raises(gymnasium.error.ResetNeeded, match="done"):
        env.step(np.zeros((3, 3)))


# what stands on it --------------------------------------------------------------------------------


def test_residual_actions_on_the_batch_equal_those_on_single_worlds():
    n = 3
    batch = ResidualActionVector(native(DOCK, n, max_episode_steps=40, wind="gusty"), pid(), scale=0.3)
    singles = [
        ResidualAction(gymnasium.make(DOCK, max_episode_steps=40, wind="gusty"), pid(), scale=0.3) for _ in range(n)
    ]
    rng = np.random.default_rng(0)
    observation, _ = batch.reset(seed=3)
    for i, env in enumerate(singles):
        assert_same(env.reset(seed=3 + i)[0], row(observation, i))
    done = np.zeros(n, bool)
    for _ in range(100):
        actions = rng.uniform(-1.0, 1.0, (n, 3)).astype(np.float32)
        observation, rewards, terminations, truncations, _ = batch.step(actions)
        for i, env in enumerate(singles):
            if done[i]:
                single, reward = env.reset()[0], 0.0
            else:
                single, reward, *_ = env.step(actions[i])
            assert_same(single, row(observation, i))
            assert reward == rewards[i]
        done = terminations | truncations


@pytest.mark.parametrize("mode", ["same_step", "disabled"])
def test_stable_baselines3_sees_resets_within_the_step(mode):
    from agents.sb3_env import SB3VecEnv

    n, limit = 3, 20
    env = SB3VecEnv(native(DOCK, n, max_episode_steps=limit, autoreset_mode=mode), keys=("position_error", "velocity"))
    env.seed(4)
    observation = env.reset()
    assert observation.shape == (n, 6) and observation.dtype == np.float32
    singles = [gymnasium.make(DOCK, max_episode_steps=limit) for _ in range(n)]
    for i, single in enumerate(singles):
        first, _ = single.reset(seed=4 + i)
        np.testing.assert_array_equal(observation[i, :3], first["position_error"])
    action = np.full((n, 3), 0.1, np.float32)
    for k in range(2 * limit):
        observation, rewards, dones, infos = env.step(action)
        for i, single in enumerate(singles):
            result, reward, terminated, truncated, _ = single.step(action[i])
            assert rewards[i] == np.float32(reward)
            assert dones[i] == (terminated or truncated) == ((k + 1) % limit == 0)
            if truncated:
                np.testing.assert_array_equal(infos[i]["terminal_observation"][3:], result["velocity"])
                assert infos[i]["TimeLimit.truncated"] is True
                result, _ = single.reset()
            np.testing.assert_array_equal(observation[i, 3:], result["velocity"])
    env.close()


def test_a_next_step_batch_is_reset_within_the_step_for_stable_baselines3_too():
    from agents.sb3_env import SB3VecEnv

    env = SB3VecEnv(native(DOCK, 2, max_episode_steps=5), keys=("position_error",))
    env.reset()
    lengths = []
    for _ in range(15):
        *_, infos = env.step(np.zeros((2, 3), np.float32))
        lengths += [info["episode"]["l"] for info in infos if "episode" in info]
    assert lengths == [5] * 6  # no step is lost to a reset
    env.close()
