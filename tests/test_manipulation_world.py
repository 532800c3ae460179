"""A vehicle with arms in the air: hover, feed-forward, command delay, pose estimates, docked and drawn vehicles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from manipulation_worlds import QUIET, World, records

from aerograsp_env.sim.arms.vehicles import AQUILES, BELEROFONTE_ARMS, BELEROFONTE_TOOL
from aerograsp_env.sim.config import CONTROL_STEP
from aerograsp_env.sim.manipulation import layout as lay
from aerograsp_env.sim.manipulation.config import (
    ManipulationConfig,
    ManipulationRandomizeConfig,
    PoseEstimateConfig,
)
from aerograsp_env.sim.manipulation.kernel_track import begin_track, relative, track
from aerograsp_env.sim.manipulation.parameters import set_estimate
from aerograsp_env.sim.sensors import PositionSourceConfig, SensorConfig
from aerograsp_env.spatial import so3_exp, so3_log, transform


def strayed(world: World) -> float:
    return float(np.linalg.norm(world.state["position"] - world.parameters["hold_position"]))


# hover --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("vehicle", [BELEROFONTE_ARMS, AQUILES], ids=lambda v: v.name)
@pytest.mark.parametrize("feedforward", [True, False])
def test_an_episode_begins_in_equilibrium(vehicle, feedforward):
    world = World(vehicle=vehicle, com_feedforward=feedforward)
    for _ in range(100):
        world.step()
        assert strayed(world) < 1e-3
        assert np.arccos(world.state["rotation"][2, 2]) < 2e-3


def test_the_hover_holds_what_it_takes_for_its_place():
    offset = (0.15, 0.10, 0.16)
    constant = replace(QUIET["sensors"], gps=PositionSourceConfig(rate=10.0, offset=offset))
    world = World(localization="gps", sensors=constant)
    world.step(steps=200)
    assert strayed(world) < 2e-3  # an error that was there when it began does not move it
    np.testing.assert_allclose(np.abs(world.state["autopilot_position"] - world.state["position"]), offset)
    wandering = replace(QUIET["sensors"], gps=PositionSourceConfig(rate=10.0, wander_limit=(0.3, 0.3, 0.0)))
    world = World(localization="gps", sensors=wandering)
    world.step(steps=300)
    assert 0.01 < strayed(world) < 0.8
    error = world.state["autopilot_position"] - world.state["position"]
    assert (np.abs(error) <= (0.3, 0.3, 1e-12)).all()


def test_a_base_that_is_commanded_follows_velocities():
    world = World(hold=False)
    world.step(velocity=(0.4, -0.2, 0.2), steps=200)
    velocity = world.data.qvel[:3]
    np.testing.assert_allclose(velocity, 0.5 * np.array([0.4, -0.2, 0.2]), atol=0.02)


def extension(feedforward: bool, vehicle=BELEROFONTE_ARMS, active=("right",)) -> float:
    """How far the hover strays while every arm goes from folded to stretched forward in a second [m]."""
    mounts = ManipulationConfig(vehicle=vehicle, active=active).machine.mounts
    n = mounts[0].arm.n
    start, end = np.zeros(n), np.zeros(n)
    start[1:3], end[1] = np.radians([-80.0, 105.0]), np.radians(-90.0)
    world = World(
        vehicle=vehicle,
        active=active,
        com_feedforward=feedforward,
        joint_rate=4.5,
        options={"start": [start] * len(mounts)},
    )
    far = 0.0
    for k in range(150):
        share = (k + 0.5) * CONTROL_STEP
        rate = (end - start) * 30.0 * share**2 * (1.0 - share) ** 2 if share < 1.0 else np.zeros(n)
        world.step(arms=np.tile(rate / 4.5, len(mounts)))
        far = max(far, strayed(world))
    np.testing.assert_allclose(world.state["joint"][0, :n], end, atol=0.1)
    assert world.state["contacts"].sum() == 0
    return far


@pytest.mark.parametrize(
    ("vehicle", "active"),
    [(BELEROFONTE_ARMS, ("right",)), (BELEROFONTE_ARMS, ("right", "left")), (AQUILES, ("right",))],
)
def test_extending_arms_in_a_second_moves_the_hover_by_less_than_three_centimetres(vehicle, active):
    with_it, without = extension(True, vehicle, active), extension(False, vehicle, active)
    assert with_it < 0.03
    assert without > 3.0 * with_it


def test_commands_arrive_after_their_delay():
    world = World(command_delay=(0.1, 0.1))
    before, moved = np.array(world.state["command"][0]), []
    for _ in range(10):
        world.step(arms=0.5)
        moved.append(float(np.abs(world.state["command"][0] - before).max()))
    assert moved[4] == 0.0 and moved[5] == pytest.approx(2.0 * 0.5 * CONTROL_STEP)


# pose estimates -----------------------------------------------------------------------------------


def tracked(config: PoseEstimateConfig | None, poses, seed: int = 0, bias=None):
    """Estimates (T, 4, 4) and their ages [s] for true poses (T, 4, 4), one a control step."""
    _, p, s = records()
    set_estimate(p, config)
    if bias is not None:
        p.track_bias[:] = bias
    rng = np.random.default_rng(seed)
    estimates, ages = [], []
    for k, pose in enumerate(poses):
        row = rng.standard_normal(lay.NOISE)
        if k == 0:
            begin_track(p, s, pose, row)
        else:
            track(p, s, pose, row)
        estimates.append(np.array(s.track))
        ages.append(int(s.track_age) * CONTROL_STEP)
    return np.array(estimates), np.array(ages)


def path(steps: int) -> np.ndarray:
    """A pose that moves along x and turns about z."""
    return np.array([transform(so3_exp([0.0, 0.0, 0.01 * k]), (0.001 * k, 0.2, -0.4)) for k in range(steps)])


CLEAN = PoseEstimateConfig(position_std=0.0, rotation_std=0.0, position_wander=0.0, rotation_wander=0.0)


def test_an_exact_pose_is_the_true_one():
    poses = path(20)
    estimates, ages = tracked(None, poses)
    np.testing.assert_array_equal(estimates, poses)
    assert (ages == 0.0).all()


def test_a_clean_estimate_is_the_truth_as_old_as_it_says():
    poses = path(200)
    estimates, ages = tracked(CLEAN, poses)
    for k in range(20, 200):
        np.testing.assert_allclose(estimates[k], poses[k - round(ages[k] / CONTROL_STEP)], atol=1e-12)
    late = ages[20:]
    assert late.min() == pytest.approx(CLEAN.delay)
    assert late.max() < CLEAN.delay + 1.0 / CLEAN.rate + CONTROL_STEP
    changes = (np.abs(np.diff(estimates[50:, 0, 3])) > 0.0).mean() / CONTROL_STEP
    assert changes == pytest.approx(CLEAN.rate, rel=0.05)


def test_the_errors_are_those_of_the_configuration():
    poses = np.broadcast_to(np.eye(4), (6000, 4, 4)).copy()
    noisy = PoseEstimateConfig(rate=50.0, delay=0.0, position_wander=0.0, rotation_wander=0.0)
    estimates, _ = tracked(noisy, poses)
    turns = np.array([so3_log(T[:3, :3]) for T in estimates[1:]])
    np.testing.assert_allclose(estimates[1:, :3, 3].std(axis=0), noisy.position_std, rtol=0.05)
    np.testing.assert_allclose(turns.std(axis=0), noisy.rotation_std, rtol=0.05)
    assert np.abs(turns.mean(axis=0)).max() < 1e-3
    wandering = PoseEstimateConfig(rate=50.0, delay=0.0, position_std=0.0, rotation_std=0.0, wander_time=0.2)
    estimates, _ = tracked(wandering, poses)
    error = estimates[200:, :3, 3]
    assert 0.8 * wandering.position_wander < np.abs(error).max() <= wandering.position_wander
    lag = round(0.2 / CONTROL_STEP)  # after one time constant the correlation is e⁻¹
    correlation = np.mean(error[lag:] * error[:-lag]) / np.mean(error**2)
    assert correlation == pytest.approx(np.exp(-1.0), abs=0.1)


def test_a_bias_is_constant_and_in_its_frames():
    poses = path(60)
    bias = np.array([[0.01, 0.0, 0.0], [0.0, 0.0, 0.1]])
    estimates, ages = tracked(CLEAN, poses, bias=bias)
    for k in range(20, 60):
        truth = poses[k - round(ages[k] / CONTROL_STEP)]
        np.testing.assert_allclose(estimates[k, :3, 3] - truth[:3, 3], bias[0], atol=1e-12)
        np.testing.assert_allclose(estimates[k, :3, :3], truth[:3, :3] @ so3_exp(bias[1]), atol=1e-12)


def test_an_episodes_bias_has_the_configured_length():
    lengths = []
    for seed in range(5):
        world = World(estimate=PoseEstimateConfig(position_bias=0.01, rotation_bias=0.05), seed=seed)
        lengths.append(np.linalg.norm(world.parameters["track_bias"], axis=1))
    np.testing.assert_allclose(lengths, [[0.01, 0.05]] * 5, atol=1e-12)


def test_a_lost_track_is_held_and_recovered():
    poses = path(5000)
    config = PoseEstimateConfig(loss_interval=2.0, loss_duration=0.5)
    _, ages = tracked(config, poses)
    held = ages > 0.25
    starts = int((np.diff(held.astype(int)) == 1).sum())
    assert starts == pytest.approx(5000 * CONTROL_STEP / (2.0 + 0.5), rel=0.35)  # of 100 s
    assert ages.max() >= 0.5 + config.delay


def test_poses_are_seen_from_the_body():
    rng = np.random.default_rng(0)
    R, position, out = so3_exp(rng.normal(size=3)), rng.normal(size=3), np.empty((4, 4))
    target = transform(so3_exp(rng.normal(size=3)), rng.normal(size=3))
    relative(R, position, target, out)
    np.testing.assert_allclose(transform(R, position) @ out, target, atol=1e-12)


# the docked vehicle -------------------------------------------------------------------------------


DOCKED = {"vehicle": BELEROFONTE_TOOL, "docked": True, "hold": False}


def test_a_docked_vehicle_with_an_arm_stays_coupled_and_knows_its_place():
    world = World(**{**DOCKED, "localization": "dock"})
    sensed = World(**{**DOCKED, "localization": "dock", "sensors": SensorConfig()})
    for each, tolerance in ((world, 0.004), (sensed, 0.03)):
        for _ in range(150):
            each.step()
        s = each.state
        assert s["termination"] == lay.RUNNING and s["coupled"] == 1 and s["contacts"].sum() == 0
        gap = each.data.site("base").xpos - each.data.site("dock").xpos
        assert np.linalg.norm(gap) < 2e-3
        assert np.linalg.norm(s["estimate"] - s["position"]) < tolerance
        assert np.linalg.norm(s["position"] - each.parameters["hold_position"]) < 0.25
    assert world.data.time == pytest.approx(3.0)


def test_the_tool_hangs_clear_of_the_pipe_in_free_flight():
    world = World(vehicle=BELEROFONTE_TOOL)
    world.step(steps=100)
    assert world.state["coupled"] == 0 and world.state["termination"] == lay.RUNNING
    assert strayed(world) < 0.02


# drawn vehicles -----------------------------------------------------------------------------------


def test_each_episode_draws_its_vehicle_from_the_nominal_one():
    drawn = ManipulationRandomizeConfig(arm_mass=(0.8, 1.2), servo_gains=(0.7, 1.3), friction=(0.5, 2.0))
    world, nominal = World(randomize=drawn), World()
    link, pad = world.model.body("right_forearm").id, world.model.geom("right_left_pad").id
    gains, masses, grips = [], [], []
    for _ in range(60):
        world.reset()
        masses.append(world.model.body_mass[link] / nominal.model.body_mass[link])
        gains.append(world.model.actuator_gainprm[7, 0] / nominal.model.actuator_gainprm[7, 0])
        grips.append(world.model.geom_friction[pad, 0] / nominal.model.geom_friction[pad, 0])
        assert world.parameters["stiffness"][0, 1] == pytest.approx(world.model.actuator_gainprm[7, 0])
        assert world.model.actuator_biasprm[7, 1] == -world.model.actuator_gainprm[7, 0]
    for values, low, high in ((masses, 0.8, 1.2), (gains, 0.7, 1.3), (grips, 0.5, 2.0)):
        assert low <= min(values) < low + 0.1 * (high - low) and high - 0.1 * (high - low) < max(values) <= high
    assert nominal.model.body_mass[link] == records()[0].body_mass[link]


def test_a_payload_is_unknown_to_the_vehicle_and_carried_by_the_arm():
    light, heavy = World(), World(payload=0.3)
    assert heavy.parameters["believed_mass"] == light.parameters["believed_mass"]
    body = light.model.body("airframe").id
    assert heavy.model.body_subtreemass[body] - light.model.body_subtreemass[body] == pytest.approx(0.3)
    heavy.step(steps=100)
    assert strayed(heavy) < 0.01
    light.step()
    assert np.abs(heavy.state["load"]).max() > np.abs(light.state["load"]).max()


# refusals -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"active": ("middle",)}, "middle"),
        ({"active": ()}, "active"),
        ({"active": ("right", "right")}, "active"),
        ({"vehicle": AQUILES, "active": ("left",)}, "left"),
        ({"docked": True}, "docking tool"),
        ({"localization": "dock"}, "docked=True"),
        ({"localization": "stars"}, "localization"),
        ({"velocity_limit": (3.0, 1.0, 1.0)}, "velocity_limit"),
        ({"action_mode": "torque"}, "action_mode"),
        ({"payload": 3.0}, "payload"),
        ({"joint_rate": 0.0}, "joint_rate"),
        ({"command_delay": (0.2, 0.1)}, "command_delay"),
    ],
)
def test_bad_configurations_are_refused(options, word):
    with pytest.raises(ValueError, match=word):
        ManipulationConfig(**options)


@pytest.mark.parametrize(
    "options", [{"rate": 0.0}, {"rate": 100.0}, {"delay": 0.6}, {"position_std": -1.0}, {"loss_interval": np.nan}]
)
def test_bad_estimates_are_refused(options):
    with pytest.raises(ValueError, match=next(iter(options))):
        PoseEstimateConfig(**options)
