"""Reach-v0: targets that can be reached, rewards that hindsight can recompute, success by the truth."""

from __future__ import annotations

from typing import Any

import gymnasium
import mujoco
import numpy as np
import pytest

import aerograsp_env  # noqa: F401  registers the ids
from aerograsp_env.envs.reach import ReachEnv, goal_reward
from aerograsp_env.envs.reach_path import BENDING_RADIUS, HIGHEST, HINDMOST, POINTS, equidistant
from aerograsp_env.envs.reach_task import SKIP
from aerograsp_env.sim.manipulation.config import PoseEstimateConfig
from aerograsp_env.sim.sensors import SensorConfig
from aerograsp_env.spatial import transform

REACH = "aerograsp/Reach-v0"
CALM: dict[str, Any] = {"wind": "calm", "localization": "truth", "sensors": SensorConfig().scaled(0.0)}
every_vehicle = pytest.mark.parametrize("vehicle", ["belerofonte", "aquiles"])


def make(**options: Any) -> ReachEnv:
    env = gymnasium.make(REACH, **options).unwrapped
    assert isinstance(env, ReachEnv)
    return env


def body(env: ReachEnv) -> np.ndarray:
    """T_world_body, true."""
    return transform(env.state["rotation"], env.state["position"])


def follow(env: ReachEnv, seed: int, steps: int, options: dict[str, Any] | None = None):
    """Towards the point by twists: yields each step's results."""
    observation, _ = env.reset(seed=seed, options=options)
    for _ in range(steps):
        way = observation["desired_goal"] - observation["achieved_goal"]
        action = np.concatenate([8.0 * way / 0.25, np.zeros(3)])
        result = env.step(np.clip(action, -1.0, 1.0).astype(np.float32))
        observation = result[0]
        yield result


# targets ------------------------------------------------------------------------------------------


@every_vehicle
def test_targets_move_at_their_speed_on_smooth_closed_paths_below_the_vehicle(vehicle):
    env = make(vehicle=vehicle, target_speed=0.1)
    places = []
    for seed in range(8):
        env.reset(seed=seed)
        path, length = env.record["path"] - env._worlds.parameters["hold_position"][0], float(env.record["length"])
        sides = np.linalg.norm(np.roll(path, -1, axis=0) - path, axis=1)
        np.testing.assert_allclose(sides, length / POINTS, rtol=0.02)
        assert path[:, 2].max() <= HIGHEST + 1e-6 and path[:, 0].min() >= HINDMOST - 1e-6
        turns = np.linalg.norm(np.roll(path, 1, axis=0) - 2.0 * path + np.roll(path, -1, axis=0), axis=1)
        assert turns.max() * BENDING_RADIUS <= 1.15 * (length / POINTS) ** 2
        targets = []
        for _ in range(100):
            env.step(np.zeros(env.action_space.shape))
            targets.append(np.array(env.record["target"][:3, 3]))
        speeds = np.linalg.norm(np.diff(targets, axis=0), axis=1) / env.dt
        np.testing.assert_allclose(speeds, 0.1, rtol=0.03)
        np.testing.assert_allclose(targets[0] - path[0] - env._worlds.parameters["hold_position"][0], 0.0, atol=0.0025)
        places.append(path.mean(axis=0))
    assert np.std(places, axis=0).max() > 0.03  # they are not all the same


@every_vehicle
def test_every_place_of_a_path_can_be_reached(vehicle):
    """An independent solver on MuJoCo's own kinematics, at the level vehicle, brings the tool there within limits."""
    env = make(vehicle=vehicle)
    model, data = env.model, mujoco.MjData(env.model)
    limits = env.config.machine.mounts[0].arm.limits
    env.reset(seed=0)
    n, first = len(limits), int(env._worlds.parameters["arm_qpos"][0, 0])
    site, jacobian = model.site("right_tool").id, np.zeros((3, model.nv))
    rng = np.random.default_rng(0)
    for seed in range(4):
        env.reset(seed=seed)
        data.qpos[:7] = (*env._worlds.parameters["hold_position"][0], 1.0, 0.0, 0.0, 0.0)
        for target in env.record["path"][::16]:
            for _ in range(30):
                q = rng.uniform(*limits.T)
                for _ in range(60):
                    data.qpos[first : first + n] = q
                    mujoco.mj_kinematics(model, data)
                    mujoco.mj_comPos(model, data)
                    error = target - data.site_xpos[site]
                    mujoco.mj_jacSite(model, data, jacobian, None, site)
                    j = jacobian[:, first - 1 : first - 1 + n]
                    q = np.clip(q + j.T @ np.linalg.solve(j @ j.T + 1e-4 * np.eye(3), error), *limits.T)
                if np.linalg.norm(error) < 1e-4:
                    break
            assert np.linalg.norm(error) < 1e-4


def test_a_fixed_target_stays():
    env = make(target_speed=0.0)
    env.reset(seed=0)
    first = np.array(env.record["target"])
    env.reset(seed=0)
    for _ in range(50):
        env.step(np.zeros(6))
    np.testing.assert_array_equal(env.record["target"], first)


def test_points_along_a_polygon_are_equidistant():
    square = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [2.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    points, length = equidistant(square, 6)
    assert length == 6.0
    np.testing.assert_allclose(points[:, :2], [[0, 0], [1, 0], [2, 0], [2, 1], [1, 1], [0, 1]])


# observations -------------------------------------------------------------------------------------


@every_vehicle
def test_goals_are_the_tool_and_the_point_in_the_body_frame(vehicle):
    env = make(vehicle=vehicle, wind="gusty")
    observation, _ = env.reset(seed=1)
    rng = np.random.default_rng(0)
    for _ in range(60):
        T = body(env)
        tool = T @ env.state["true_tool"][0]
        site = env.data.site("right_tool").xpos
        assert np.linalg.norm(site - tool[:3, 3]) < 0.01  # MuJoCo's is a tick older
        np.testing.assert_allclose(
            observation["achieved_goal"], env.state["true_tool"][0, :3, 3], atol=2e-3
        )  # encoders
        seen = np.linalg.inv(T) @ env.record["target"]
        np.testing.assert_allclose(observation["desired_goal"], seen[:3, 3], atol=1e-6)
        observation, *_ = env.step(rng.uniform(-0.5, 0.5, env.action_space.shape))


@pytest.mark.parametrize("options", [{}, {"vehicle": "aquiles", "action_mode": "ee_twist"}])
def test_the_observations_parts_stand_where_its_layout_says(options):
    env = make(**CALM, **options)
    observation, _ = env.reset(seed=0)
    parts = env.observation_layout
    n = env.config.machine.mounts[0].arm.n
    assert list(parts) == [
        "joints", "joint_rates", "command_lag", "velocity", "angular_velocity", "tilt", "target_age", "previous_action",
    ]  # fmt: skip
    assert [part.stop - part.start for part in parts.values()] == [n, n, n, 3, 3, 2, 1, env.action_space.shape[0]]
    assert parts["previous_action"].stop == env.observation_space["observation"].shape[0]
    action = np.linspace(-0.3, 0.3, env.action_space.shape[0]).astype(np.float32)
    for _ in range(10):
        observation, *_ = env.step(action)
    row, s = observation["observation"], env.state
    np.testing.assert_allclose(row[parts["joints"]], s["encoder"][0, :n], atol=1e-6)
    np.testing.assert_allclose(row[parts["joint_rates"]], s["joint_rate"][0, :n], atol=1e-6)
    np.testing.assert_allclose(row[parts["command_lag"]], (s["command"] - s["encoder"])[0, :n], atol=1e-6)
    np.testing.assert_allclose(row[parts["velocity"]], s["rotation"].T @ env.data.qvel[:3], atol=2e-3)
    np.testing.assert_allclose(row[parts["angular_velocity"]], env.data.qvel[3:6], atol=0.02)
    np.testing.assert_allclose(row[parts["previous_action"]], action, atol=1e-7)
    assert row[parts["target_age"]] == 0.0


def test_an_estimated_point_is_late_and_wrong_by_as_much_as_its_tracker():
    env = make(pose="estimated", estimate=PoseEstimateConfig(delay=0.1, position_bias=0.01), target_speed=0.2)
    observation, _ = env.reset(seed=0)
    age = env.observation_layout["target_age"]
    errors = []
    for _ in range(200):
        observation, *_ = env.step(np.zeros(6))
        seen = (np.linalg.inv(body(env)) @ env.record["target"])[:3, 3]
        errors.append(np.linalg.norm(observation["desired_goal"] - seen))
        assert 0.1 - 1e-6 <= float(observation["observation"][age][0]) <= 0.1 + 2 * 0.02 + 1e-6
    assert 0.008 < np.mean(errors) < 0.05


# rewards and success ------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", ["dense", "sparse"])
def test_the_reward_is_what_compute_reward_says_to_the_last_bit(mode):
    env = make(reward_mode=mode, action_mode="ee_twist", pose="estimated", wind="gusty")
    achieved, desired, rewards = [], [], []
    for observation, reward, _, _, info in follow(env, 0, 200):
        achieved.append(observation["achieved_goal"])
        desired.append(observation["desired_goal"])
        rewards.append(reward)
        assert reward == env.compute_reward(achieved[-1], desired[-1], info)
        assert reward == sum(info["reward_terms"].values())
    np.testing.assert_array_equal(env.compute_reward(np.array(achieved), np.array(desired), [{}] * 200), rewards)
    distances = np.linalg.norm(np.array(achieved, float) - np.array(desired, float), axis=1)
    expected = -distances if mode == "dense" else -(distances > 0.02).astype(float)
    np.testing.assert_allclose(rewards, expected, atol=1e-12)
    assert min(rewards) < max(rewards)


def test_rewards_of_known_goals():
    zero = np.zeros(3)
    assert goal_reward(zero, [0.03, 0.0, 0.04], sparse=False) == pytest.approx(-0.05)
    assert goal_reward(zero, [0.0, 0.0, 0.019], sparse=True) == 0.0
    assert goal_reward(zero, [0.0, 0.0, 0.021], sparse=True) == -1.0
    assert goal_reward(np.zeros((4, 5, 3)), np.ones((4, 5, 3)), sparse=False).shape == (4, 5)


def test_a_batch_computes_rewards_too():
    batch = gymnasium.make_vec(REACH, num_envs=3)
    batch.reset(seed=0)
    observation, rewards, *_ = batch.step(batch.action_space.sample())
    again = batch.unwrapped.compute_reward(observation["achieved_goal"], observation["desired_goal"], {})
    np.testing.assert_array_equal(rewards, again)


def test_success_and_errors_are_of_the_truth():
    env = make(action_mode="ee_twist", pose="estimated", estimate={"position_bias": 0.05, "delay": 0.0})
    errors, seen = [], set()
    for k, (_, _, terminated, _, info) in enumerate(follow(env, 2, 300)):
        tool = (body(env) @ env.state["true_tool"][0])[:3, 3]
        distance = float(np.linalg.norm(tool - env.record["target"][:3, 3]))
        assert info["success"] is bool(distance <= 0.02 and not terminated)
        seen.add(info["success"])
        assert ("error" in info["metrics"]) == (k + 1 > SKIP / env.dt)
        if k + 1 > SKIP / env.dt:
            errors.append(distance)
            assert info["metrics"]["error"] == pytest.approx(np.mean(errors), rel=1e-9)
            assert info["metrics"]["error_max"] == pytest.approx(np.max(errors), rel=1e-9)
    assert np.mean(errors) == pytest.approx(0.05, abs=0.02)  # it went where it was told to, which was wrong


def test_a_simple_servo_reaches_fixed_points():
    env = make(action_mode="ee_twist", target_speed=0.0, **CALM)
    for seed in range(3):
        *_, info = list(follow(env, seed, 400))[-1]
        assert info["success"] and info["metrics"]["contacts"] == 0


def test_the_figures_of_an_idle_arm():
    env = make()
    env.reset(seed=0)
    for _ in range(150):
        *_, info = env.step(np.zeros(6))
    assert info["metrics"]["effort"] == 0.0
    assert 0.001 < info["metrics"]["hover"] < 0.15
    assert info["success"] is False


# reset's options ----------------------------------------------------------------------------------


@every_vehicle
def test_explicit_goal_and_start_are_honoured_exactly(vehicle):
    env = make(vehicle=vehicle, wind="gusty", randomize=True)
    arm = env.config.machine.mounts[0].arm
    start, goal = arm.home + 0.05, np.array([0.2, -0.1, -0.45])
    env.reset(seed=1, options={"start": start, "goal": goal, "wind_direction": 1.0})
    np.testing.assert_array_equal(env.state["joint"][0, : arm.n], start)
    np.testing.assert_allclose(env.record["target"][:3, 3], env.data.qpos[:3] + goal, atol=1e-12)
    mean = env._worlds.parameters["mean_wind"][0]
    assert np.arctan2(mean[1], mean[0]) == pytest.approx(1.0)
    for _ in range(10):
        env.step(np.zeros(env.action_space.shape))
    np.testing.assert_allclose(env.record["target"][:3, 3], env._worlds.parameters["hold_position"][0] + goal)


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"gaol": (0, 0, 0)}, "goal"),
        ({"goal": (0.0, 0.0)}, "goal"),
        ({"goal": (0.0, np.nan, 0.0)}, "goal"),
        ({"goal": (2.0, 0.0, 0.0)}, "goal"),
        ({"start": np.zeros(4)}, "start"),
        ({"start": np.full(6, 3.0)}, "start"),
        ({"start": np.full(6, np.nan)}, "start"),
        ({"wind_direction": np.inf}, "wind_direction"),
    ],
)
def test_bad_reset_options_are_refused(options, word):
    env = make()
    with pytest.raises(ValueError, match=word):
        env.reset(seed=0, options=options)
    env.reset(seed=0)  # and the environment is still good


# pictures -----------------------------------------------------------------------------------------


def test_the_picture_shows_the_target():
    env = make(render_mode="rgb_array", width=160, height=120, camera="close")
    places = []
    for goal in ((0.2, -0.2, -0.45), (0.0, -0.5, -0.3)):
        env.reset(seed=0, options={"goal": goal})
        picture = env.render().astype(int)
        assert picture.shape == (120, 160, 3)
        red = picture[40:, :, 0] - picture[40:, :, 1:].max(axis=-1)  # the front rotors above are red too
        assert (red > 30).any()
        places.append(np.argwhere(red > 30).mean(axis=0))
    assert np.linalg.norm(places[1] - places[0]) > 30.0
    env.close()
