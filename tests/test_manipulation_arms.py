"""Arms in the compiled step: kinematics against MuJoCo, servos and grippers against closed forms."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from manipulation_worlds import CUBE, QUIET, World, records

from aerograsp_env.sim.airframe import GRAVITY
from aerograsp_env.sim.arms.vehicles import AQUILES, BELEROFONTE_ARMS
from aerograsp_env.sim.manipulation import kernel_arm as arms
from aerograsp_env.sim.manipulation import layout as lay
from aerograsp_env.sim.manipulation.config import ManipulationConfig
from aerograsp_env.sim.scene import TIMESTEP
from aerograsp_env.spatial import quat_wxyz_from_matrix

BOTH = ManipulationConfig(active=("right", "left"), **QUIET)
ONE = ManipulationConfig(vehicle=AQUILES, **QUIET)
every_vehicle = pytest.mark.parametrize("config", [BOTH, ONE], ids=["belerofonte", "aquiles"])
TICKS = round(1.0 / TIMESTEP)


def drawn(config: ManipulationConfig, rng: np.random.Generator) -> list[np.ndarray]:
    """Joint angles of every arm on the encoders' steps, so that reading changes nothing."""
    angles = [rng.uniform(*mount.arm.limits.T) for mount in config.machine.mounts]
    return [arms.ENCODER_QUANTUM * np.round(q / arms.ENCODER_QUANTUM) for q in angles]


def pose(data: mujoco.MjData, site: str) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = data.site(site).xmat.reshape(3, 3), data.site(site).xpos
    return T


# kinematics ---------------------------------------------------------------------------------------


@every_vehicle
def test_kinematics_and_centre_of_mass_are_mujocos(config):
    model, p, s = records(config)
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    poses, tool, j, com = np.empty((6, 4, 4)), np.empty((4, 4)), np.empty((6, 6)), np.zeros(3)
    for _ in range(20):
        data.qpos[:3], data.qpos[3:7] = rng.normal(size=3), rng.normal(size=4)
        data.qpos[3:7] /= np.linalg.norm(data.qpos[3:7])
        angles = drawn(config, rng)
        for i, q in enumerate(angles):
            data.qpos[p.arm_qpos[i] : p.arm_qpos[i] + len(q)] = q
        mujoco.mj_forward(model, data)
        body = pose(data, "airframe")
        for i, (mount, q) in enumerate(zip(config.machine.mounts, angles, strict=True)):
            padded = np.zeros(6)
            padded[: len(q)] = q
            arms.forward(p, i, padded, poses, tool)
            np.testing.assert_allclose(body @ tool, pose(data, f"{mount.prefix}tool"), atol=1e-9)
            arms.jacobian(p, i, poses, tool, j)
            full = np.zeros((6, model.nv))
            mujoco.mj_jacSite(model, data, full[:3], full[3:], model.site(f"{mount.prefix}tool").id)
            first = p.arm_qpos[i] - 1
            turned = np.kron(np.eye(2), body[:3, :3]) @ j[:, : len(q)]
            np.testing.assert_allclose(turned, full[:, first : first + len(q)], atol=1e-9)
        arms.center_of_mass(p, s, data.qpos, com)
        expected = data.subtree_com[model.body("airframe").id]
        np.testing.assert_allclose(body[:3, :3] @ com + body[:3, 3], expected, atol=1e-9)


def test_readings_have_the_encoders_steps():
    world = World()
    world.step(arms=0.5, steps=20)
    s, n = world.state, 6
    np.testing.assert_allclose(s["encoder"][0, :n], s["joint"][0, :n], atol=arms.ENCODER_QUANTUM / 2 + 1e-12)
    counts = s["encoder"][0, :n] / arms.ENCODER_QUANTUM
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-9)
    np.testing.assert_allclose(s["joint_rate"][0, :n], 1.0, atol=0.15)  # half of 2 rad/s


@every_vehicle
def test_a_tool_follows_the_twist_it_is_given(config):
    world = World(vehicle=config.vehicle, action_mode="ee_twist")
    n = config.machine.mounts[0].arm.n
    start = np.array(world.state["true_tool"][0])
    twist = np.array([0.2, 0.0, 0.2, 0.0, 0.0, 0.0])  # of a full action
    world.step(arms=twist, steps=50)
    world.step(steps=20)  # the servos lag
    moved = world.state["true_tool"][0]
    way = moved[:3, 3] - start[:3, 3]
    np.testing.assert_allclose(way, 0.25 * twist[:3], atol=0.01 if n == 6 else 0.02)
    if n == 6:  # four joints cannot keep the attitude too
        np.testing.assert_allclose(moved[:3, :3], start[:3, :3], atol=0.06)


def test_a_twist_beyond_the_joints_speed_slows_all_of_them_alike():
    _, p, _ = records()
    q, slow, fast = np.array([0.0, 0.2, -1.4, 0.1, 1.2, 0.0]), np.empty(6), np.empty(6)
    twist = np.array([0.1, 0.05, -0.1, 0.0, 0.2, 0.0])
    arms.twist_rates(p, 0, q, twist, slow)
    arms.twist_rates(p, 0, q, 100.0 * twist, fast)
    assert np.abs(fast / p.rate_limit[0]).max() == pytest.approx(1.0)
    np.testing.assert_allclose(fast / np.linalg.norm(fast), slow / np.linalg.norm(slow), atol=1e-9)


# servos -------------------------------------------------------------------------------------------


def test_an_arm_at_rest_stays_where_it_is():
    world = World()
    start = np.array(world.state["joint"][0])
    sag = world.state["command"][0] - start  # what carries the weight: torque / stiffness
    first = world.parameters["arm_qpos"][0] - 1
    np.testing.assert_allclose(
        sag, world.data.qfrc_bias[first : first + 6] / world.parameters["stiffness"][0], atol=1e-9
    )
    assert np.abs(sag).max() > 1e-3
    world.step(steps=100)
    np.testing.assert_allclose(world.state["joint"][0], start, atol=2e-3)


def test_the_commanded_rate_is_integrated_and_followed():
    world = World()
    before = np.array(world.state["command"][0])
    share = np.array([0.25, -0.5, 0.3, 0.4, -0.5, 1.0])
    world.step(arms=share, steps=25)
    np.testing.assert_allclose(world.state["command"][0] - before, 2.0 * share * 0.5, atol=1e-9)
    world.step(steps=50)
    np.testing.assert_allclose(world.state["joint"][0] - before, 2.0 * share * 0.5, atol=0.03)


def test_commands_stay_within_the_limits_and_near_the_joint():
    _, p, s = records()
    ctrl = np.zeros(20)
    for _ in range(2 * TICKS):  # a joint that does not move
        arms.servo(p, s, 0, 0, 2.0, 0.1, 0.0, ctrl)
        assert s.command[0, 0] <= 0.1 + arms.FOLLOWING_ERROR + 1e-12
    assert s.command[0, 0] == pytest.approx(0.1 + arms.FOLLOWING_ERROR)
    for _ in range(2 * TICKS):
        arms.servo(p, s, 0, 1, 9.0, float(s.command[0, 1]), 0.0, ctrl)
    assert s.command[0, 1] == p.joint_limits[0, 1, 1]
    s.command[0, 2] = 0.0
    arms.servo(p, s, 0, 2, 100.0, 0.0, 0.0, ctrl)
    assert s.command[0, 2] == pytest.approx(p.rate_limit[0, 2] * TIMESTEP)


def test_a_servo_overloaded_for_a_second_holds_with_less_until_its_command_backs_off():
    _, p, s = records()
    ctrl, limit = np.zeros(20), float(p.torque_limit[0, 2])
    k, c = float(p.stiffness[0, 2]), int(p.arm_ctrl[0]) + 2
    s.command[0, 2] = 0.3
    for _ in range(TICKS):
        arms.servo(p, s, 0, 2, 0.0, 0.0, limit, ctrl)
    assert s.protected[0, 2] == 0 and ctrl[c] == 0.3
    arms.servo(p, s, 0, 2, 0.0, 0.0, limit, ctrl)
    arms.servo(p, s, 0, 2, 0.0, 0.0, limit, ctrl)
    assert s.protected[0, 2] == 1
    assert k * ctrl[c] == pytest.approx(arms.PROTECTIVE_SHARE * limit)  # about a joint that stands at zero
    for _ in range(TICKS):
        arms.servo(p, s, 0, 2, 0.0, 0.0, arms.PROTECTIVE_SHARE * limit, ctrl)
    assert s.protected[0, 2] == 1
    for _ in range(round(0.3 / 0.5 * TICKS)):  # its command comes back
        arms.servo(p, s, 0, 2, -0.5, 0.0, 0.0, ctrl)
    assert s.protected[0, 2] == 0
    s.command[0, 2] = 0.3
    for _ in range(3 * TICKS):  # load just below the threshold, for ever
        arms.servo(p, s, 0, 2, 0.0, 0.0, 0.97 * limit, ctrl)
    assert s.protected[0, 2] == 0


# worm grippers ------------------------------------------------------------------------------------


def test_a_screw_turns_at_its_speed_and_stops_where_its_motor_stalls():
    _, p, s = records()
    ctrl, k, stall = np.zeros(20), float(p.jaw_stiffness[0]), float(p.jaw_stall[0])
    for _ in range(100):
        arms.worm(p, s, 0, 0.5, float(s.screw[0]), float(s.screw[0]), ctrl)
    assert s.screw[0] == pytest.approx(0.5 * p.jaw_speed[0] * 100 * TIMESTEP)
    first = int(p.arm_ctrl[0] + p.joints[0])
    assert ctrl[first] == ctrl[first + 1] == s.screw[0]
    at = float(s.screw[0])
    for _ in range(1000):  # fingers that stand
        arms.worm(p, s, 0, 1.0, at, at, ctrl)
    assert s.screw[0] == pytest.approx(at + stall / k)
    assert s.gripper_load[0] == pytest.approx(1.0)
    for _ in range(10):  # the fingers are pushed open with ten times the force: the screw does not turn
        arms.worm(p, s, 0, 1.0, at - 9 * stall / k, at - 9 * stall / k, ctrl)
        arms.worm(p, s, 0, 0.0, at - 9 * stall / k, at - 9 * stall / k, ctrl)
    assert s.screw[0] == pytest.approx(at + stall / k)
    for _ in range(5000):
        arms.worm(p, s, 0, -1.0, float(s.screw[0]), float(s.screw[0]), ctrl)
    assert s.screw[0] == 0.0
    for _ in range(5000):
        arms.worm(p, s, 0, 1.0, float(s.screw[0]), float(s.screw[0]), ctrl)
    assert s.screw[0] == pytest.approx(p.jaw_travel[0])


def test_a_gripper_holds_a_cube_with_its_stall_force():
    world = World(with_cube=True)
    T = world.tool()
    world.reset(object=np.concatenate([T[:3, 3], quat_wxyz_from_matrix(T[:3, :3])]))
    cube, weight = world.model.body("object").id, float(world.model.body("object").mass[0]) * GRAVITY
    touched = []
    for _ in range(100):  # weightless until it is held, so that it waits between the pads
        world.step(grippers=1.0)
        touched.append((world.state["contacts"][lay.C_LEFT_0] > 0, world.state["contacts"][lay.C_RIGHT_0] > 0))
    world.model.body_gravcomp[cube] = 0.0
    world.step(steps=100)
    p, s = world.parameters, world.state
    assert not any(touched[0]) and all(touched[-1])
    width = 2.0 * p["jaw_travel"][0] - s["finger"][0].sum()
    assert width == pytest.approx(CUBE, abs=2e-3)  # pads give
    first = int(p["arm_ctrl"][0]) + 6
    assert world.data.actuator_force[first : first + 2].mean() == pytest.approx(float(p["jaw_stall"][0]), rel=0.05)
    assert s["contacts"][lay.C_LEFT_0] == s["contacts"][lay.C_RIGHT_0] == lay.SUBSTEPS
    assert s["contacts"][lay.C_SUPPORT] == 0 and s["contacts"][lay.C_ARM_0] == 0
    assert 0.0 < weight < float(p["jaw_stall"][0])
    np.testing.assert_allclose(s["object"][:3, 3], world.tool()[:3, 3], atol=0.005)  # not fallen in two seconds
    world.step(grippers=-1.0, steps=60)
    assert s["object"][2, 3] < world.tool()[2, 3] - 0.1
    assert s["contacts"][lay.C_LEFT_0] == s["contacts"][lay.C_OBJECT_0] == 0


# collisions ---------------------------------------------------------------------------------------


def test_arms_commanded_into_each_other_touch_and_survive():
    # bent inwards, towards the middle between the bases
    start = [np.zeros(6), np.zeros(6)]
    world = World(active=("right", "left"), options={"start": start})
    inward = np.zeros(12)
    inward[0], inward[6] = 1.0, -1.0  # yaw, so that the arms bend towards each other …
    inward[1] = inward[7] = -1.0
    seen = np.zeros(len(lay.CONTACTS))
    for k in range(200):
        world.step(arms=inward if k < 40 else np.where(np.arange(12) % 6 == 1, -1.0, 0.0))
        seen += world.state["contacts"]
    assert seen[lay.C_ARMS] > 0
    assert seen[lay.C_AIRFRAME] == 0 and seen[lay.C_ARM_0] == 0  # counted as what it is
    assert np.isfinite(world.data.qpos).all() and world.state["termination"] == lay.RUNNING
    assert np.linalg.norm(world.state["position"] - world.parameters["hold_position"]) < 0.2


def test_an_arm_folded_into_the_airframe_is_noticed():
    world = World(options={"start": [np.radians([-90.0, -100.0, 0.0, 0.0, 0.0, 0.0])]})
    seen = 0
    for _ in range(100):
        world.step(arms=[1.0, -1.0, -1.0, 0.0, 0.0, 0.0])
        seen += world.state["contacts"][lay.C_AIRFRAME_0]
    assert seen > 0 and world.state["contacts"][lay.C_AIRFRAME] == 0
    assert np.isfinite(world.data.qpos).all()


@pytest.mark.parametrize("vehicle", [BELEROFONTE_ARMS, AQUILES], ids=lambda v: v.name)
def test_home_and_stowed_arms_touch_nothing(vehicle):
    sides = tuple(mount.side for mount in vehicle.mounts)
    for name in ("home", "stowed"):
        world = World(vehicle=vehicle, active=sides, options={"start": [getattr(m.arm, name) for m in vehicle.mounts]})
        world.step(steps=5)
        assert world.state["contacts"].sum() == 0
