"""DockManipulate-v0: what is observed, drawn, rewarded and counted is what its documentation says; its policy."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import gymnasium
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import aerograsp_env
from aerograsp_env.envs.dock_manipulate_task import HIGHEST, HINDMOST, PIPE_CLEARANCE
from aerograsp_env.rewards import tolerance
from aerograsp_env.sim.scene import PIPE_HEIGHT, PIPE_RADIUS
from aerograsp_env.sim.sensors import SensorConfig
from agents import figure_5_24
from agents.reproduction import Request
from baselines.kinematics import Arm, DockingTool, solve_ik
from baselines.policies import dock_manipulate

ID = "aerograsp/DockManipulate-v0"
EXACT: dict[str, Any] = {"wind": "calm", "sensors": SensorConfig().scaled(0.0)}
HOVER: dict[str, Any] = {"docked": False, "localization": "truth"}
LEVEL: dict[str, Any] = {"start": np.zeros(3), "tilt": np.zeros(2)}


def make(**options: Any) -> Any:
    return gymnasium.make(ID, **options).unwrapped


def drive(env: Any, steps: int, seed: int = 0, scale: float = 0.3) -> Iterator[tuple[Any, ...]]:
    """Steps under smooth random actions: the action and what it gave, one by one."""
    rng, action = np.random.default_rng(seed), np.zeros(9)
    for _ in range(steps):
        action = 0.9 * action + 0.1 * rng.uniform(-scale, scale, 9)
        yield action.astype(np.float32), *env.step(action.astype(np.float32))


def driven(env: Any, steps: int, seed: int = 0) -> dict[str, np.ndarray]:
    """The last observation."""
    return list(drive(env, steps, seed))[-1][1]


def true_tool(env: Any) -> np.ndarray:
    """Of the arm, in the world, by MuJoCo."""
    return env.data.site("right_tool").xpos.copy()


# what is seen -------------------------------------------------------------------------------------


@pytest.mark.parametrize("options", [{}, HOVER, {"docked": False, "localization": "gps"}])
def test_errors_and_the_point_are_seen_from_the_estimate(options):
    env = make(**options)
    env.reset(seed=3)
    observation = driven(env, 40)
    s, task = env.state, env.record
    np.testing.assert_allclose(observation["position_error"], task["set_point"] - s["estimate"], atol=1e-6)
    seen = s["attitude"].T @ (task["target"] - s["estimate"])
    np.testing.assert_allclose(observation["target"], seen, atol=1e-6)
    np.testing.assert_allclose(observation["set_point"], task["set_point"] - task["nominal"], atol=1e-6)
    angles = Rotation.from_matrix(s["attitude"]).as_euler("ZYX")[::-1]
    np.testing.assert_allclose(observation["attitude"], angles, atol=1e-4)
    np.testing.assert_allclose(observation["velocity"], s["velocity_estimate"], atol=1e-6)


def test_without_errors_the_point_and_the_tool_are_where_they_are():
    env = make(**EXACT, **HOVER)
    observation, _ = env.reset(seed=0, options=LEVEL)
    for _ in range(2):
        position, R = env.data.qpos[:3], Rotation.from_quat(env.data.qpos[[4, 5, 6, 3]]).as_matrix()
        np.testing.assert_allclose(observation["target"], R.T @ (env.record["target"] - position), atol=1e-5)
        tool = observation["end_effector"]
        world = position + R @ tool[:3]
        site = env.data.site("right_tool")
        np.testing.assert_allclose(world, site.xpos, atol=2e-3)  # encoders' steps, and the site lags by a tick
        np.testing.assert_allclose(R @ tool[3:6], site.xmat.reshape(3, 3)[:, 0], atol=1e-2)
        np.testing.assert_allclose(R @ tool[6:], site.xmat.reshape(3, 3)[:, 1], atol=1e-2)
        observation = driven(env, 60)


def test_the_end_effector_is_the_arms_kinematics():
    env = make()
    env.reset(seed=1)
    observation = driven(env, 50)
    mount = env.config.machine.mounts[0]
    T = Arm.from_config(mount.arm, mount.T_body_base).forward(observation["arm_joints"].astype(float))
    np.testing.assert_allclose(observation["end_effector"][:3], T[:3, 3], atol=1e-5)
    np.testing.assert_allclose(observation["end_effector"][3:], T[:3, :2].T.ravel(), atol=1e-5)


def test_the_docking_tool_locates_the_vehicle():
    """Without sensors' errors only the unsensed flex and quantisation are left."""
    env = make(**EXACT)
    env.reset(seed=2, options={"tilt": np.zeros(2)})
    errors = []
    for _ in drive(env, 100):
        errors.append(np.abs(env.state["estimate"] - env.state["position"]).max())
    assert max(errors) < 0.01 and np.mean(errors) < 0.004


def test_the_joints_are_the_docking_tools():
    env = make(**EXACT)
    observation, _ = env.reset(seed=0, options={"tilt": np.zeros(2)})
    tool = DockingTool(joint_centers=env.config.tool.centers, lengths=env.config.tool.lengths)
    tip = tool.forward(observation["joints"].astype(float))[:3, 3]  # base frame: x along −y of the world, y along x
    seen = env.data.qpos[:3] + np.asarray(env.config.airframe.tip_position)
    base = env.data.site("dock").xpos
    np.testing.assert_allclose([tip[1], -tip[0], tip[2]], seen - base, atol=2e-3)


def test_previous_actions_and_the_error_integral():
    env = make(wind="gusty")
    observation, _ = env.reset(seed=0)
    total = np.zeros(3)
    given: list[np.ndarray] = []
    for _ in range(30):
        total = math.exp(-env.dt / 10.0) * total + observation["position_error"].astype(float) * env.dt
        action, observation, *_ = next(drive(env, 1, seed=len(given)))
        given.insert(0, action)
        np.testing.assert_allclose(observation["error_integral"], total, atol=1e-6)
        recent = observation["previous_actions"].reshape(6, 9)[: len(given)]
        np.testing.assert_allclose(recent, given[:6], atol=1e-7)


def test_the_heading_frame_turns_commands_and_what_is_seen():
    """Turned by hand to 90°, "ahead" is the world's +y."""
    env = make(**EXACT, **HOVER, command_frame="heading")
    env.reset(seed=0, options=LEVEL)
    half = math.radians(45.0)
    env.data.qpos[3:7] = math.cos(half), 0.0, 0.0, math.sin(half)
    env.state["yaw_set_point"] = 2.0 * half
    for _ in range(100):
        observation, *_ = env.step(np.eye(9, dtype=np.float32)[0])
    assert env.data.qvel[1] > 0.3 and abs(env.data.qvel[0]) < 0.1
    assert observation["velocity"][0] > 0.3 and abs(observation["velocity"][1]) < 0.1
    error = env.record["set_point"] - env.state["position"]
    np.testing.assert_allclose(observation["position_error"], [error[1], -error[0], error[2]], atol=0.02)
    parts = dock_manipulate.dls(heading_frame=True).as_reaching(observation)["observation"]
    body = Rotation.from_quat(env.data.qpos[[4, 5, 6, 3]]).as_matrix().T @ env.data.qvel[:3]
    np.testing.assert_allclose(parts[18:21], body, atol=0.01)


# beginning ----------------------------------------------------------------------------------------


def test_drawn_points_are_in_reach_and_in_the_open():
    env = make()
    mount = env.config.machine.mounts[0]
    arm = Arm.from_config(mount.arm, mount.T_body_base)
    points = []
    for seed in range(25):
        env.reset(seed=seed)
        task = env.record
        point = task["target"] - task["set_point"]
        points.append(point)
        T = np.eye(4)
        T[:3, 3] = point
        assert solve_ik(arm, T, method="dls", task="position").converged
        assert point[2] <= HIGHEST and point[0] >= HINDMOST
        assert math.hypot(task["target"][0], task["target"][2] - PIPE_HEIGHT) >= PIPE_RADIUS + PIPE_CLEARANCE
    assert np.ptp(points, axis=0).min() > 0.2


def test_explicit_start_and_goal_are_honoured_exactly():
    env = make(wind="gusty", randomize=True)
    goal, start = np.array([0.25, -0.15, -0.50]), np.array([0.02, -0.01, 0.03])
    arm = np.radians([5.0, 10.0, -70.0, 0.0, 60.0, 10.0])
    options = {"goal": goal, "start": start, "arm_start": arm, "tilt": [0.02, -0.01], "wind_direction": 1.0}
    observation, _ = env.reset(seed=5, options=options)
    task, worlds = env.record, env._worlds
    np.testing.assert_array_equal(task["target"], task["nominal"] + goal)
    np.testing.assert_array_equal(env.data.qpos[:3], task["set_point"] + start)
    np.testing.assert_allclose(observation["arm_joints"], arm, atol=2e-3)  # encoders' steps
    mean = worlds.parameters["mean_wind"][0]
    assert math.atan2(mean[1], mean[0]) == pytest.approx(1.0)
    up = env.data.site("dock").xmat.reshape(3, 3)[:, 2]
    assert math.acos(up[2]) == pytest.approx(math.hypot(0.02, 0.01), rel=1e-3)
    gap = env.data.site("base").xpos - env.data.site("dock").xpos
    assert np.abs(gap).max() < 1e-6


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"gaol": (0, 0, 0)}, "goal"),
        ({"goal": (0.2, -0.2)}, "goal"),
        ({"goal": (2.0, 0.0, 0.0)}, "goal"),
        ({"goal": (np.nan, 0.0, 0.0)}, "goal"),
        ({"start": (1.0, 0.0, 0.0)}, "start"),
        ({"arm_start": (0.0,) * 5}, "arm_start"),
        ({"arm_start": (9.0,) * 6}, "arm_start"),
        ({"arm_start": (np.nan,) * 6}, "arm_start"),
        ({"tilt": (1.0, 0.0)}, "tilt"),
        ({"wind_direction": np.inf}, "wind_direction"),
    ],
)
def test_bad_reset_options_are_refused(options, word):
    env = make()
    with pytest.raises(ValueError, match=word):
        env.reset(seed=0, options=options)
    env.reset(seed=0)  # and the environment is still good


# what counts --------------------------------------------------------------------------------------


def test_rewards_and_metrics_are_those_of_the_true_distance():
    env = make(localization="truth")
    env.reset(seed=0)
    distances, hovers, efforts, before = [], [], [], np.zeros(9)
    for action, _, reward, terminated, _, info in drive(env, 300, scale=0.2):
        s, task = env.state, env.record
        world = s["position"] + s["rotation"] @ s["true_tool"][0, :3, 3]
        e = float(np.linalg.norm(world - task["target"]))
        np.testing.assert_allclose(true_tool(env), world, atol=2e-3)
        change = float(np.sum((action.astype(float) - before) ** 2))
        before = action.astype(float)
        terms = info["reward_terms"]
        assert terms["position"] == pytest.approx(0.5 * tolerance(e, margin=0.5, sigmoid="linear"))
        assert terms["precision"] == pytest.approx(0.5 * tolerance(e, margin=0.02, sigmoid="long_tail"))
        assert terms["effort"] == pytest.approx(-0.2 * min(change, 4.0))
        assert reward == sum(terms.values()) and not terminated
        distances.append(e)
        hovers.append(float(np.linalg.norm(s["position"] - task["set_point"])))
        efforts.append(change)
        assert ("error" in info["metrics"]) == (len(distances) > 250)
    figures = info["metrics"]
    assert figures["error"] == pytest.approx(np.mean(distances[250:]))
    assert figures["error_max"] == pytest.approx(np.max(distances[250:]))
    assert figures["hover"] == pytest.approx(np.mean(hovers[250:]))
    assert figures["effort"] == pytest.approx(math.sqrt(np.mean(efforts)))
    assert figures["clamp_force_max"] > 0.0


def test_sparse_reward_and_success_are_within_two_centimetres():
    env = make(**EXACT, reward_mode="sparse")
    arm = np.radians([5.0, 10.0, -70.0, 0.0, 60.0, 10.0])
    mount = env.config.machine.mounts[0]
    tool = Arm.from_config(mount.arm, mount.T_body_base).forward(arm)[:3, 3]
    for shift, good in ((0.0, True), (0.05, False)):
        env.reset(seed=0, options={"arm_start": arm, **LEVEL})
        env.record["target"] = env.record["set_point"] + tool + [shift, 0.0, 0.0]
        rewards = []
        for _ in range(300):
            state = env.state
            hold = np.zeros(9, np.float32)
            hold[:3] = 4.0 * (env.record["set_point"] - state["position"])
            _, reward, _, _, info = env.step(hold)
            rewards.append(reward)
        assert set(rewards[150:]) == {float(good)}
        assert info["success"] is good


def test_pulling_too_hard_ends_the_episode():
    env = make(velocity_limit=(2.0, 2.0, 1.0))
    env.reset(seed=0)
    action = np.zeros(9, np.float32)
    action[2] = 1.0
    for _ in range(500):
        _, _, terminated, _, info = env.step(action)
        if terminated:
            break
    assert info["termination"] in ("joint_limit", "overload")
    assert info["reward_terms"]["crash"] == -10.0 and info["metrics"]["crash"] == 1.0 and info["success"] is False


def test_flying_into_the_pipe_ends_the_episode():
    env = make(**HOVER)
    env.reset(seed=0)
    action = np.zeros(9, np.float32)
    action[0], action[2] = 1.0, -1.0
    for _ in range(500):
        _, _, terminated, _, info = env.step(action)
        if terminated:
            break
    assert info["termination"] == "collision" and info["reward_terms"]["crash"] == -10.0


def test_a_batch_equals_its_worlds():
    options: dict[str, Any] = {"wind": "gusty", "randomize": True, "command_delay": (0.02, 0.1)}
    batch = gymnasium.make_vec(ID, num_envs=2, max_episode_steps=60, **options)
    singles = [gymnasium.make(ID, max_episode_steps=60, **options) for _ in range(2)]
    seen, _ = batch.reset(seed=4)
    alone = [env.reset(seed=4 + i)[0] for i, env in enumerate(singles)]
    rng = np.random.default_rng(0)
    for t in range(60):
        for i in range(2):
            for name in alone[i]:
                np.testing.assert_array_equal(seen[name][i], alone[i][name])
        actions = rng.uniform(-0.2, 0.2, (2, 9)).astype(np.float32)
        seen, rewards, _, truncated, _ = batch.step(actions)
        for i, env in enumerate(singles):
            alone[i], reward, _, ended, _ = env.step(actions[i])
            assert reward == rewards[i] and ended == truncated[i] == (t == 59)


# the policy ---------------------------------------------------------------------------------------


def batches(count: int = 3, steps: int = 40) -> list[dict[str, np.ndarray]]:
    """Observations of a few worlds under the policy."""
    env = gymnasium.make_vec(ID, num_envs=count)
    policy, state = dock_manipulate.dls(), None
    observation, _ = env.reset(seed=0)
    found = []
    for _ in range(steps):
        found.append(observation)
        action, state = policy.predict(observation, state)
        observation, *_ = env.step(action)
    return found


@pytest.mark.parametrize("factory", [dock_manipulate.dls, dock_manipulate.pid_dls])
def test_a_batch_equals_its_rows_and_episode_start_restarts_a_row(factory):
    policy, state, rows = factory(), None, [None] * 3
    for t, batch in enumerate(batches()):
        start = np.array([False, t == 20, False])
        if t == 20:
            rows[1] = None
        action, after = policy.predict(batch, state, episode_start=start)
        again, _ = policy.predict(batch, state, episode_start=start)
        np.testing.assert_array_equal(action, again)  # its state is left alone
        assert action.dtype == np.float32 and action.shape == (3, 9) and np.abs(action).max() <= 1.0
        for i in range(3):
            alone, rows[i] = policy.predict({name: value[i] for name, value in batch.items()}, rows[i])
            np.testing.assert_allclose(alone, action[i], atol=1e-6)
        state = after


def test_in_body_axes_is_the_inverse_rotation():
    rng = np.random.default_rng(0)
    angles, vectors = rng.uniform(-1.0, 1.0, (20, 3)), rng.standard_normal((20, 3))
    R = Rotation.from_euler("ZYX", angles[:, ::-1]).as_matrix()
    found = dock_manipulate.in_body_axes(vectors, *angles.T)
    np.testing.assert_allclose(found, np.einsum("nji,nj->ni", R, vectors), atol=1e-12)


def test_the_reference_policy_succeeds_in_gusts():
    env, policy, state = make(wind="gusty"), aerograsp_env.reference_policy(ID), None
    observation, _ = env.reset(seed=0)
    for _ in range(500):
        action, state = policy.predict(observation, state)
        observation, _, _, _, info = env.step(action)
    assert info["success"] and info["metrics"]["error"] < 0.01


# figure 5.24 --------------------------------------------------------------------------------------


def test_figure_5_24():
    result = figure_5_24.run(Request(seed=0, episodes=2, picture=True), steps=350)
    assert all(result.data["checks"].values()) and len(result.data["checks"]) == 2
    facts = result.data["conditions"]
    assert list(facts) == ["dock", "vision", "gps"]
    assert facts["dock"]["held"] == 1.0 and facts["dock"]["crash"] == 0.0
    assert facts["dock"]["error"] == pytest.approx(np.mean(facts["dock"]["errors"]))
    low, high = facts["dock"]["interval"]
    assert low <= facts["dock"]["error"] <= high
    assert result.picture is not None and result.picture.startswith(b"\x89PNG")
    assert "docked, by the tool" in result.text and result.text.count("✓") == 2


def test_a_course_is_the_episode():
    way = figure_5_24.course({"localization": "truth", **EXACT}, seed=0, steps=100)
    assert way.time[1] == 0.02 and len(way.time) == len(way.true) == 100
    np.testing.assert_allclose(way.true, way.estimated, atol=2.5)  # encoders' steps [mm]
