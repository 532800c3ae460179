"""The docking tool: its chain in MuJoCo against the kinematics, the closed loop, and what its sensors read."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from dock_worlds import AT_NOMINAL, ATTACH, FREE, QUIET, make, world

from aerograsp_env.sim import layout as lay
from aerograsp_env.sim.airframe import AIRFRAMES, GRAVITY
from aerograsp_env.sim.config import DockConfig
from aerograsp_env.sim.docking_tool import R_TIP_BODY, R_WORLD_BASE, DockingToolConfig
from aerograsp_env.sim.kernel_math import tool_forward, upright
from aerograsp_env.sim.kernel_sensors import sample_joints
from aerograsp_env.sim.scene import DOCK_POSITION, JOINT_NAMES
from baselines.kinematics import DockingTool
from baselines.policies.dock import pid_tuned

TOOL = DockingToolConfig()
KINEMATICS = DockingTool(joint_centers=TOOL.centers, lengths=TOOL.lengths)
QUANTUM = 1.5 * np.pi / 1024  # 270° over 10 bits [rad]


def site_pose(data: mujoco.MjData, name: str) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3], pose[:3, :3] = data.site(name).xpos, data.site(name).xmat.reshape(3, 3)
    return pose


def random_pose(model, data, p, rng) -> np.ndarray:
    """Put the vehicle anywhere in any attitude; returns the joint angles (5,)."""
    data.qpos[:3], data.qpos[3:7] = rng.uniform(-5, 5, 3), rng.standard_normal(4)
    data.qpos[3:7] /= np.linalg.norm(data.qpos[3:7])
    data.qpos[7:] = rng.uniform(-2.5, 2.5, 6)
    mujoco.mj_forward(model, data)
    return data.qpos[p.joint_address].copy()


# kinematics ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("airframe", AIRFRAMES)
def test_mujocos_chain_is_the_thesiss(airframe):
    model, data, p, _ = world(DockConfig(airframe=AIRFRAMES[airframe]))
    rng = np.random.default_rng(0)
    for _ in range(50):
        q = random_pose(model, data, p, rng)
        found = np.linalg.inv(site_pose(data, "base")) @ site_pose(data, "tip")
        np.testing.assert_allclose(found, KINEMATICS.forward(q), atol=1e-9)
    body = site_pose(data, "airframe")  # the tip is mounted where the configuration says, but for the flex about body x
    data.qpos[7] = 0.0
    mujoco.mj_forward(model, data)
    tip = np.linalg.inv(body) @ site_pose(data, "tip")
    np.testing.assert_allclose(tip[:3, 3], AIRFRAMES[airframe].tip_position, atol=1e-9)
    np.testing.assert_allclose(tip[:3, :3], R_TIP_BODY.T, atol=1e-9)


def test_the_compiled_forward_kinematics_are_the_same():
    rng, position, rotation = np.random.default_rng(1), np.zeros(3), np.zeros((3, 3))
    lengths = np.array(TOOL.lengths)
    for q in rng.uniform(-3, 3, (100, 5)):
        tool_forward(lengths, q, position, rotation)
        T = KINEMATICS.forward(q)
        np.testing.assert_allclose(position, T[:3, 3], atol=1e-12)
        np.testing.assert_allclose(rotation, T[:3, :3], atol=1e-12)


def test_jacobian_is_mujocos():
    model, data, p, _ = world()
    rng = np.random.default_rng(2)
    columns = [model.joint(name).dofadr[0] for name in JOINT_NAMES]
    jacobians = np.zeros((4, 3, model.nv))
    for _ in range(20):
        q = random_pose(model, data, p, rng)
        mujoco.mj_jacSite(model, data, jacobians[0], jacobians[1], model.site("tip").id)
        mujoco.mj_jacSite(model, data, jacobians[2], jacobians[3], model.site("base").id)
        tip, tip_turn, base, base_turn = jacobians[:, :, columns]
        base_pose = site_pose(data, "base")
        arm = data.site("tip").xpos - base_pose[:3, 3]
        linear = tip - base - np.cross(base_turn, arm, axisa=0, axisc=0)  # as seen from the base
        relative = np.vstack([base_pose[:3, :3].T @ linear, base_pose[:3, :3].T @ (tip_turn - base_turn)])
        np.testing.assert_allclose(relative, KINEMATICS.jacobian(q), atol=1e-9)


def test_upright_takes_up_to_z_by_the_smallest_turn():
    rng, rotation = np.random.default_rng(3), np.zeros((3, 3))
    for up in rng.normal(0, 1, (50, 3)) * [1, 1, 0.3] + [0, 0, 1.5]:
        upright(up, rotation)
        if up[2] < 0:
            np.testing.assert_array_equal(rotation, np.eye(3))
            continue
        n = up / np.linalg.norm(up)
        np.testing.assert_allclose(rotation @ n, [0, 0, 1], atol=1e-12)
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        assert np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1)) == pytest.approx(np.arccos(n[2]), abs=1e-6)
    upright(np.zeros(3), rotation)
    np.testing.assert_array_equal(rotation, np.eye(3))


# the closed loop ----------------------------------------------------------------------------------


def test_the_closed_loops_gap_stays_below_a_millimetre_in_gusts():
    env, policy, state = make(wind="gusty"), pid_tuned(), None
    observation, _ = env.reset(seed=11)
    gaps, turns, limits = [], [], TOOL.mechanical_limits()
    base, seat = env.data.site("base"), env.data.site("dock")
    for _ in range(3000):
        action, state = policy.predict(observation, state)
        observation, _, terminated, _, info = env.step(action)
        assert not terminated
        gaps.append(np.linalg.norm(base.xpos - seat.xpos))
        turns.append(np.linalg.norm(base.xmat - seat.xmat) / np.sqrt(2))  # small angles: the angle itself
        q = env.data.qpos[env._worlds.parameters["joint_address"][0]]
        assert ((q > limits[:, 0]) & (q < limits[:, 1])).all()
    assert info["success"] is True
    assert max(gaps) < 1e-3
    assert max(turns) < 2e-3  # the clamp holds the base's attitude too: it is the flex that gives [rad]


def test_every_start_and_set_point_of_the_default_task_is_within_the_signal_range():
    env, limits = make(), TOOL.signal_limits()
    for seed in range(80):
        env.reset(seed=seed)
        q = env.data.qpos[env._worlds.parameters["joint_address"][0]]
        assert ((q > limits[:, 0]) & (q < limits[:, 1])).all()
        assert np.linalg.norm(env.data.site("base").xpos - env.data.site("dock").xpos) < 1e-6


def test_a_start_out_of_the_tools_reach_is_refused():
    env = make(tool=DockingToolConfig(nominal_tip=(0.0, -0.30, 0.24)))
    with pytest.raises(ValueError, match="the tool cannot reach a start"):
        env.reset(seed=0, options={"start": (-0.12, 0.0, 0.12)})


def test_coupling_in_flight_closes_the_gap_and_keeps_it_closed():
    env = make(ATTACH, wind="calm", sensors=QUIET)
    observation, _ = env.reset(seed=0, options={"start": (-0.3, 0.01, 0.35)})
    coupled_at, gaps = None, []
    for k in range(1500):
        offset = observation["seat_offset"].astype(float)
        goal = offset + [0.0, 0.0, 0.10 * (np.hypot(offset[0], offset[1]) > 0.02)]  # from above
        if coupled_at is not None:
            goal = observation["position_error"].astype(float)
        action = np.append(np.clip(2.0 * goal, -0.4, 0.4), [0.0, 1.0])
        observation, _, terminated, _, info = env.step(action.astype(np.float32))
        assert not terminated, info["termination"]
        if coupled_at is None and observation["coupled"][0] == 1.0:
            coupled_at = k
        if coupled_at is not None and k > coupled_at + 40:
            gaps.append(np.linalg.norm(env.data.site("base").xpos - env.data.site("dock").xpos))
    assert coupled_at is not None
    assert max(gaps) < 1e-3
    np.testing.assert_allclose(
        env.data.site("base").xmat.reshape(3, 3), R_WORLD_BASE, atol=5e-3
    )  # the clamp has turned it upright
    assert info["success"] is True


def test_the_lock_holds_theta0_until_the_coupling():
    env = make(ATTACH, wind="gusty")
    env.reset(seed=0)
    address = int(env._worlds.parameters["joint_address"][0, 0])
    for _ in range(300):
        env.step(np.array([0, 0, 0, 0.3, -1], np.float32))
        assert abs(env.data.qpos[address]) < np.radians(5)
        assert abs(env.data.qvel[address - 1]) < 1.0
    assert env.state["locked"] == 1 and env.state["coupled"] == 0


# potentiometers and accelerometer -----------------------------------------------------------------


def sample_step(angles, velocity=0.0, noise: float = 0.0, config: DockConfig | None = None):
    """One control step of samples at constant joint velocity: (mean reading (5,), samples taken)."""
    _, data, p, s = world(config or DockConfig(sensors=QUIET))
    rng, count = np.random.default_rng(0), 0
    draws = noise * rng.standard_normal(lay.POTENTIOMETER_NOISE)
    for tick in range(lay.SUBSTEPS):
        data.qpos[p.joint_address] = np.asarray(angles) + velocity * 0.002 * (tick + 1)
        data.qvel[p.joint_address - 1] = velocity
        count = sample_joints(p, s, data.qpos, data.qvel, tick, draws, count)
    return s.joints.copy(), count


def test_a_step_takes_24_samples_at_1200_hz():
    _, count = sample_step(TOOL.centers)
    assert count == lay.POTENTIOMETER_SAMPLES == 1200 * 0.02


def test_readings_are_whole_steps_of_the_converter():
    for offset in np.linspace(-0.01, 0.01, 17):
        angles = np.asarray(TOOL.centers) + offset
        reading, _ = sample_step(angles)
        np.testing.assert_allclose(reading / QUANTUM, np.round(reading / QUANTUM), atol=1e-9)
        assert (np.abs(reading - angles) <= QUANTUM / 2 + 1e-12).all()


def test_a_moving_joint_is_sampled_along_its_way():
    # The mean of 24 quantised samples of a ramp lies within half a step of the ramp's mean.
    velocity = 5.0
    reading, _ = sample_step(TOOL.centers, velocity)
    times = np.arange(1, 25) / 1200
    samples = np.asarray(TOOL.centers) + velocity * times[:, None]
    np.testing.assert_allclose(reading, (QUANTUM * np.floor(samples / QUANTUM + 0.5)).mean(axis=0), atol=1e-9)


def test_readings_saturate_at_the_signal_range():
    limits = TOOL.signal_limits()
    for side, beyond in ((0, -0.1), (1, 0.1)):
        reading, _ = sample_step(limits[:, side] + beyond)
        np.testing.assert_allclose(reading, QUANTUM * np.round(limits[:, side] / QUANTUM), atol=1e-9)
        noisy, _ = sample_step(limits[:, side] + 3 * beyond, noise=1.0, config=DockConfig())
        np.testing.assert_allclose(noisy, reading, atol=1e-9)


def test_the_signal_range_is_150_degrees_within_a_mechanical_one_of_170():
    assert np.degrees(np.ptp(TOOL.signal_limits(), axis=1)) == pytest.approx([150] * 5)
    assert np.degrees(np.ptp(TOOL.mechanical_limits(), axis=1)) == pytest.approx([170] * 5)
    np.testing.assert_allclose(TOOL.signal_limits(), KINEMATICS.limits, atol=1e-9)


def test_the_base_accelerometer_gives_the_bases_tilt():
    env = make(sensors=QUIET, wind="calm")
    observation, _ = env.reset(seed=0, options=AT_NOMINAL | {"tilt": (0.05, -0.08)})
    up = env.data.site("base").xmat.reshape(3, 3)[2]
    np.testing.assert_allclose(observation["base_acceleration"], GRAVITY * up, atol=1e-4)
    assert np.abs(up[:2]).max() > 0.04
    # and with it the tool knows where the vehicle is, to the converter's resolution
    assert np.abs(env.state["estimate"] - env.data.qpos[:3]).max() < 4e-3


def test_the_tools_position_estimate_follows_the_truth():
    env, policy, state = make(sensors=QUIET, wind="light"), pid_tuned(), None
    observation, _ = env.reset(seed=3)
    errors = []
    for _ in range(500):
        action, state = policy.predict(observation, state)
        observation, *_ = env.step(action)
        errors.append(env.state["estimate"] - env.data.qpos[:3])
        np.testing.assert_allclose(
            observation["position_error"], env._worlds.parameters["set_point"][0] - env.state["estimate"], atol=1e-5
        )
    assert np.abs(errors).max() < 8e-3  # converter steps, and the flex that no joint senses


# position sources ---------------------------------------------------------------------------------


@pytest.mark.parametrize(("source", "rate"), [("gps", 10), ("vision", 25), ("truth", 50)])
def test_position_samples_are_held_between(source, rate):
    env = make(docked=False, localization=source, wind="gusty")
    env.reset(seed=0)
    held = [env.state["estimate"].copy()]
    for _ in range(60):
        env.step(np.array([0.2, 0.1, 0.1], np.float32))
        held.append(env.state["estimate"].copy())
    changed = np.flatnonzero((np.diff(held, axis=0) != 0).any(axis=1)) + 1
    np.testing.assert_array_equal(changed, np.arange(50 // rate, 61, 50 // rate))


@pytest.mark.parametrize(("source", "rate"), [("dock", 25), ("vision", 25), ("gps", 10), ("truth", 50)])
def test_before_it_is_coupled_the_tool_is_helped_by_the_source_that_was_asked_for_or_vision(source, rate):
    env = make(ATTACH, localization=source, wind="light")
    env.reset(seed=0)
    held, errors = [env.state["estimate"].copy()], []
    for _ in range(60):
        env.step(np.array([0.1, 0.0, 0.1, 0.0, -1.0], np.float32))
        held.append(env.state["estimate"].copy())
        errors.append(np.abs(held[-1] - env.data.qpos[:3]).max())
    changed = np.flatnonzero((np.diff(held, axis=0) != 0).any(axis=1)) + 1
    np.testing.assert_array_equal(changed, np.arange(50 // rate, 61, 50 // rate))
    assert (max(errors) < 1e-9) == (source == "truth")


def test_quiet_sensors_tell_the_truth():
    env = make(**FREE)
    observation, _ = env.reset(seed=0, options=AT_NOMINAL | {"start": (0.3, -0.2, 0.1)})
    np.testing.assert_allclose(observation["position_error"], [-0.3, 0.2, -0.1], atol=1e-6)
    for _ in range(20):
        observation, *_ = env.step(np.array([0.5, 0.0, 0.2], np.float32))
    set_point = env._worlds.parameters["set_point"][0]
    np.testing.assert_allclose(observation["position_error"], set_point - env.data.qpos[:3], atol=1e-6)
    np.testing.assert_allclose(observation["velocity"], env.data.qvel[:3], atol=1e-3)  # as it was a tick ago
    np.testing.assert_allclose(observation["specific_force"][2], GRAVITY, atol=0.5)


def test_noise_scales():
    from aerograsp_env.sim.sensors import SensorConfig

    double = SensorConfig().scaled(2.0)
    assert double.gps.white_std == tuple(2 * v for v in SensorConfig().gps.white_std)
    assert double.tool.white_std == 2 * SensorConfig().tool.white_std
    assert (double.gps.rate, double.gps.wander_time, double.tool.adc_bits) == (10.0, SensorConfig().gps.wander_time, 10)
    with pytest.raises(ValueError, match="must be finite and not negative"):
        SensorConfig().scaled(-1.0)


def test_docking_place():
    np.testing.assert_allclose(DOCK_POSITION, [0.0, 0.0, 3.05])
