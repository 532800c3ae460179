"""The autopilot in flight: hover, steps, delay, frames, trim."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from dock_worlds import AT_NOMINAL, ATTACH, FREE, make, world

from aerograsp_env.sim.airframe import AIRFRAMES, GRAVITY
from aerograsp_env.sim.config import CONTROL_STEP, DockConfig
from aerograsp_env.sim.kernel import delayed_command
from aerograsp_env.sim.kernel_control import thrust_vector
from aerograsp_env.sim.layout import SUBSTEPS
from aerograsp_env.sim.scene import TIMESTEP

STILL = np.zeros(3, np.float32)
VEHICLES = [{"airframe": name} for name in AIRFRAMES] + [
    {"payload": 0.3},
    {"randomize": {"thrust": (0.9, 0.9), "mass": (1.15, 1.15)}},
    {"randomize": True},
]


@pytest.mark.parametrize("options", VEHICLES, ids=str)
def test_a_calm_episode_starts_in_trim_and_stays_put(options):
    env = make(**FREE, **options)
    for seed in range(3):
        env.reset(seed=seed, options=AT_NOMINAL)
        start, drift = env.data.qpos[:7].copy(), np.zeros(7)
        weight = GRAVITY * float(env.model.body("airframe").subtreemass[0])
        thrust = env._worlds.parameters["thrust_constant"][0] * np.sum(env.state["rotor_speed"] ** 2)
        assert thrust == pytest.approx(weight, rel=1e-9)
        for _ in range(150):
            env.step(STILL)
            drift = np.maximum(drift, np.abs(env.data.qpos[:7] - start))
        assert (
            drift[:3] < 1e-3
        ).all()  # ground effect alone, 0.02 % of the weight at this height, lifts by half a millimetre
        assert (drift[3:] < 3e-4).all()


@pytest.mark.parametrize("airframe", AIRFRAMES)
def test_hover_thrust_equals_weight_in_flight(airframe):
    env = make(**FREE, airframe=airframe)
    env.reset(seed=0, options=AT_NOMINAL)
    for _ in range(200):
        env.step(STILL)
    assert env.data.ctrl.sum() == pytest.approx(GRAVITY * env.model.body("airframe").subtreemass[0], rel=2e-5)
    np.testing.assert_allclose(env.data.qvel[:6], 0.0, atol=1e-3)


@pytest.mark.parametrize("axis", range(3))
def test_velocity_steps_are_followed_along_each_axis(axis):
    env = make(**FREE, velocity_limit=1.0)
    action = 0.5 * np.eye(3, dtype=np.float32)[axis]
    env.reset(seed=0, options=AT_NOMINAL)
    velocity = []
    for _ in range(500):
        env.step(action)
        velocity.append(env.data.qvel[:3].copy())
    v = np.array(velocity)
    assert v[:, axis].max() < 0.5 * 1.15  # PX4's default gains overshoot by some 9 %
    np.testing.assert_allclose(v[-50:].mean(axis=0), action, atol=0.01)
    assert np.argmax(v[:, axis] > 0.45) * CONTROL_STEP < 1.5
    others = np.delete(v, axis, axis=1)
    assert np.abs(others).max() < 0.05


def test_integrators_remove_a_steady_wind():
    env = make(**(FREE | {"wind": {"mean_speed": 3.0, "gust_std": 0.0}}))
    env.reset(seed=0, options=AT_NOMINAL | {"wind_direction": 0.6})
    for _ in range(600):
        env.step(STILL)
    np.testing.assert_allclose(env.data.qvel[:3], 0.0, atol=5e-3)
    up = np.zeros(9)
    mujoco.mju_quat2Mat(up, env.data.qpos[3:7])
    lean = up.reshape(3, 3)[:2, 2]
    np.testing.assert_allclose(
        lean / np.linalg.norm(lean), [-np.cos(0.6), -np.sin(0.6)], atol=0.02
    )  # it leans into the wind


def test_wanted_force_keeps_within_the_tilt_limit_and_never_points_down():
    _, _, p, s = world()
    weight = float(p.believed_mass) * GRAVITY
    for set_point in np.random.default_rng(0).uniform(-20.0, 20.0, (200, 3)):
        s.velocity_integral[:] = 0.0
        force = thrust_vector(p, s, set_point)
        assert force[2] >= 0.1 * weight * (1 - 1e-12)
        assert np.hypot(force[0], force[1]) <= force[2] * np.tan(p.tilt_max) * (1 + 1e-12)


# command delay ------------------------------------------------------------------------------------


@pytest.mark.parametrize("delay", [0.0, 0.006, 0.02, 0.05, 0.1, 0.28])
def test_each_tick_uses_the_newest_command_that_is_old_enough(delay):
    _, _, p, s = world()
    p.delay_ticks = round(delay / TIMESTEP)
    for step in range(20):
        s.step = step
        for tick in range(SUBSTEPS):
            now = step * SUBSTEPS + tick
            given = [
                k for k in range(step + 1) if k * SUBSTEPS + p.delay_ticks <= now
            ]  # command k is given as step k begins
            assert delayed_command(p, s, tick) == (step - given[-1] if given else -1)


@pytest.mark.parametrize("delay", [0.0, 0.02, 0.05, 0.06, 0.1])
def test_a_command_acts_exactly_after_its_delay(delay):
    env = make(**FREE, command_delay=delay)

    def flight(action):
        env.reset(seed=5, options=AT_NOMINAL)
        states = []
        for _ in range(12):
            env.step(np.asarray(action, np.float32))
            states.append(env.data.qpos.copy())
        return np.array(states)

    moved = (flight([1.0, 0.0, 0.0]) != flight(STILL)).any(axis=1)
    first = int(np.argmax(moved))
    assert moved[first:].all()
    assert first == int(
        delay / CONTROL_STEP + 1e-9
    )  # steps that end before the delay has passed are the same to the last bit


def test_delays_are_drawn_from_their_range_anew_each_episode():
    env = make(command_delay=(0.06, 0.10))
    drawn = []
    for seed in range(60):
        env.reset(seed=seed)
        drawn.append(int(env._worlds.parameters["delay_ticks"][0]) * TIMESTEP)
    assert 0.06 <= min(drawn) < 0.065 and 0.095 < max(drawn) <= 0.10


# frames -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("frame", ["world", "heading"])
def test_command_frame(frame):
    # A quarter to the left, then "forward": along the world's y in the heading frame, along its x in the world's.
    env = make(ATTACH, wind="calm", sensors=FREE["sensors"], command_frame=frame)
    env.reset(seed=0, options={"start": (-1.5, 0.0, 0.8)})
    for _ in range(round(np.pi / 2 / 0.5 / CONTROL_STEP)):
        env.step(np.array([0, 0, 0, 1, -1], np.float32))
    for _ in range(200):
        observation, *_ = env.step(np.array([0.5, 0, 0, 0, -1], np.float32))
    assert observation["attitude"][2] == pytest.approx(np.pi / 2, abs=0.05)
    expected = [0.0, 0.25, 0.0] if frame == "heading" else [0.25, 0.0, 0.0]
    np.testing.assert_allclose(env.data.qvel[:3], expected, atol=0.03)
    np.testing.assert_allclose(observation["velocity"], [0.25, 0.0, 0.0], atol=0.03)
    assert {d.frame for d in env.action_layout[:3]} == {frame}


def test_full_action_is_the_limit_that_was_asked_for():
    env = make(**FREE, velocity_limit=(0.3, 0.6, 0.2), config=DockConfig(bound=50.0))
    assert [d.scale for d in env.action_layout] == [0.3, 0.6, 0.2]
    env.reset(seed=0, options=AT_NOMINAL)
    for _ in range(600):
        env.step(np.ones(3, np.float32))
    np.testing.assert_allclose(env.data.qvel[:3], [0.3, 0.6, 0.2], atol=0.01)
