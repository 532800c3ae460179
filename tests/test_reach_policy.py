"""Reaching by damped least squares: parts on known answers, the whole on a kinematic stand-in and on Reach-v0."""

from __future__ import annotations

from typing import NamedTuple

import gymnasium
import numpy as np
import pytest
from scipy.linalg import solve_discrete_are
from scipy.spatial.transform import Rotation

from aerograsp_env.sim.arms.vehicles import AQUILES, BELEROFONTE_ARMS, ArmMount
from agents import reach_table
from agents.policies import load_policy
from agents.reproduce import TABLES
from agents.reproduction import Request
from baselines.kinematics import Arm
from baselines.policies.reach import ServoPolicy, dls, dls_no_feedforward
from baselines.policies.reach_kernel import alpha_beta, find_goal, level_from_body
from baselines.policies.reach_state import Settings

STEP, RATE, SERVO_TIME = 0.02, 2.0, 0.04
RIGHT, LEFT, SINGLE = BELEROFONTE_ARMS.mount("right"), BELEROFONTE_ARMS.mount("left"), AQUILES.mount("right")


class Motion(NamedTuple):
    """Position (3,) and R_world_body (3, 3) of the vehicle, and their rates in the body frame, at one time."""

    place: np.ndarray
    rotation: np.ndarray
    velocity: np.ndarray
    gyro: np.ndarray


def drift(t: float, share: float = 1.0) -> Motion:
    """A hover that sways by centimetres and degrees; rates by central differences."""

    def at(s):
        place = share * np.array([0.03 * np.sin(0.9 * s), 0.025 * np.sin(1.3 * s + 1.0), 0.015 * np.sin(0.7 * s)])
        angles = share * np.array([0.03 * np.sin(2.1 * s), 0.03 * np.sin(1.7 * s + 0.5), 0.1 * np.sin(0.5 * s)])
        return place, Rotation.from_euler("xyz", angles)

    (place, rotation), h = at(t), 1e-5
    (before, first), (after, last) = at(t - h), at(t + h)
    gyro = (first.inv() * last).as_rotvec() / (2 * h)
    return Motion(place, rotation.as_matrix(), rotation.inv().apply(after - before) / (2 * h), gyro)


class StandIn:
    """One arm on a vehicle that moves as told: servos that trail and give way, encoders, a point seen late."""

    def __init__(self, mount: ArmMount, motion=drift, speed=0.1, delay=0, sag=0.0, start=None, command_delay=0) -> None:
        self.arm, self.motion, self.delay, self.sag = Arm.from_config(mount.arm, mount.T_body_base), motion, delay, sag
        self.q = np.array(mount.arm.home if start is None else start, dtype=float)
        self.command = self.q + sag
        self.center, self.speed = mount.T_body_base[:3, 3] + [0.15, 0.0, -0.42], speed
        self.rates, self.action, self.k = np.zeros(self.arm.n), np.zeros(self.arm.n), 0
        self.pending = [np.zeros(self.arm.n)] * command_delay

    def point(self, t: float) -> np.ndarray:
        """In the world, on a circle of 0.06 m."""
        angle = self.speed * t / 0.06
        return self.center + 0.06 * np.array([np.cos(angle), np.sin(angle), 0.0])

    def seen(self, t: float) -> np.ndarray:
        m = self.motion(t)
        return m.rotation.T @ (self.point(t) - m.place)

    def observe(self) -> dict[str, np.ndarray]:
        t, late = STEP * self.k, min(self.k, self.delay)
        m = self.motion(t)
        roll, pitch = np.arctan2(m.rotation[2, 1], m.rotation[2, 2]), -np.arcsin(m.rotation[2, 0])
        lag = self.command - self.q
        parts = self.q, self.rates, lag, m.velocity, m.gyro, [roll, pitch], [STEP * late], self.action
        return {
            "observation": np.concatenate(parts).astype(np.float32),
            "achieved_goal": self.arm.forward(self.q)[:3, 3].astype(np.float32),
            "desired_goal": self.seen(t - STEP * late).astype(np.float32),
        }

    def step(self, action: np.ndarray) -> None:
        self.action, before, low_high = action, self.q.copy(), self.arm.limits
        self.pending.append(action)
        action = self.pending.pop(0)
        for _ in range(10):
            command = self.command + RATE * action * STEP / 10
            self.command = np.clip(np.clip(command, self.q - 0.35, self.q + 0.35), *low_high.T)
            self.q = self.q + (self.command - self.sag - self.q) * (1.0 - np.exp(-STEP / 10 / SERVO_TIME))
        self.rates, self.k = (self.q - before) / STEP, self.k + 1

    def error(self) -> float:
        return float(np.linalg.norm(self.arm.forward(self.q)[:3, 3] - self.seen(STEP * self.k)))


def follow(world: StandIn, policy: ServoPolicy, steps: int = 300) -> np.ndarray:
    """Distances (steps,) of the tool from the point [m]."""
    state, errors = None, []
    for _ in range(steps):
        action, state = policy.predict(world.observe(), state)
        assert action.shape == (world.arm.n,) and action.dtype == np.float32 and np.abs(action).max() <= 1.0
        world.step(action.astype(float))
        errors.append(world.error())
    return np.array(errors)


def still(t: float) -> Motion:
    return drift(t, 0.0)


# parts --------------------------------------------------------------------------------------------


def test_level_axes():
    out = np.empty((3, 3))
    level_from_body(0.3, -0.2, 1.1, out)
    np.testing.assert_allclose(out, Rotation.from_euler("ZYX", [1.1, -0.2, 0.3]).as_matrix(), atol=1e-15)


def test_steady_gains_are_those_of_the_kalman_filter():
    """Of a point under white acceleration, piecewise constant (Kalata 1984)."""
    interval, acceleration, noise = 1.0 / 30.0, 0.6, 0.002
    F, G = np.array([[1.0, interval], [0.0, 1.0]]), np.array([[0.5 * interval**2], [interval]])
    H = np.array([[1.0, 0.0]])
    P = solve_discrete_are(F.T, H.T, acceleration**2 * G @ G.T, np.array([[noise**2]]))
    gain = (P @ H.T / (P[0, 0] + noise**2)).ravel()
    np.testing.assert_allclose(alpha_beta(interval, acceleration, noise, 10**6), gain * [1.0, interval], rtol=1e-6)


def test_first_gains_fit_a_line():
    """On noise alone, the filter's line is the least-squares one while those gains hold."""
    seen = np.random.default_rng(0).standard_normal(8)
    place, rate = seen[0], 0.0
    for k in range(1, 8):
        alpha, beta = alpha_beta(1.0, 1e-9, 1.0, k)
        guess = place + rate
        place, rate = guess + alpha * (seen[k] - guess), rate + beta * (seen[k] - guess)
        slope, first = np.polyfit(np.arange(k + 1), seen[: k + 1], 1)
        assert (place, rate) == pytest.approx((first + slope * k, slope), abs=1e-9)


@pytest.mark.parametrize("mount", [RIGHT, SINGLE])
def test_a_configuration_is_found_for_what_can_be_reached(mount):
    from baselines.policies.reach import _machine

    machine = _machine(mount.arm.n, RATE)
    settings, rng, low_high = Settings(), np.random.default_rng(1), mount.arm.limits.T
    arm = Arm.from_config(mount.arm, mount.T_body_base)
    offset = arm.forward(mount.arm.home)[:3, 3]
    offset -= Arm.from_config(mount.arm, np.diag([1.0, -1.0, -1.0, 1.0])).forward(mount.arm.home)[:3, 3]
    found = 0
    for _ in range(50):
        q = rng.uniform(low_high[0] + 0.2, low_high[1] - 0.2)
        point, goal = arm.forward(q)[:3, 3], np.empty(mount.arm.n)
        args = machine.chain, machine.length, settings, machine.limits, machine.seeds
        if find_goal(*args, point, offset, np.array(mount.arm.home), goal):
            found += 1
            assert arm.within_limits(goal)
            assert np.linalg.norm(arm.forward(goal)[:3, 3] - point) < 1e-3
    assert found >= 48
    assert not find_goal(*args, np.array([2.0, 0.0, 0.0]), offset, np.array(mount.arm.home), goal)


# servoing -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("mount", [RIGHT, LEFT, SINGLE])
def test_a_fixed_point_is_reached_and_held(mount):
    for policy in (dls(), dls_no_feedforward()):
        errors = follow(StandIn(mount, still, speed=0.0), policy)
        assert errors[0] > 0.02 and errors[150:].max() < 5e-4


def test_servos_that_give_way_are_made_up_for():
    errors = follow(StandIn(RIGHT, still, speed=0.0, sag=np.array([0.0, 0.03, -0.05, 0.01, 0.03, 0.0])), dls())
    assert errors[150:].max() < 5e-4


@pytest.mark.parametrize("mount", [RIGHT, SINGLE])
def test_feedforward_follows_a_moving_point_from_a_drifting_base(mount):
    """With the gains for a vehicle that its arm does not turn."""
    with_it, without = (follow(StandIn(mount), ServoPolicy(on, settings=Settings()))[100:] for on in (True, False))
    assert with_it.mean() < 2e-3 and with_it.max() < 5e-3
    assert without.mean() > 5.0 * with_it.mean()


def test_late_estimates_are_brought_to_now():
    errors = follow(StandIn(RIGHT, delay=4), dls())[150:]
    assert errors.mean() < 6e-3  # the filter trails on the circle, by its acceleration
    assert follow(StandIn(RIGHT, delay=4), dls_no_feedforward())[150:].mean() > 3.0 * errors.mean()


def test_late_commands_do_not_destabilise():
    assert follow(StandIn(RIGHT, command_delay=4), dls())[150:].max() < 0.02


@pytest.mark.parametrize("steps", [0, 2, 4])
def test_the_delay_of_commands_is_found(steps):
    world, policy, state = StandIn(RIGHT, command_delay=steps), dls(), None
    for _ in range(150):
        action, state = policy.predict(world.observe(), state)
        world.step(action.astype(float))
    assert state["delay"][0] == pytest.approx(STEP * steps, rel=0.25, abs=1e-3)


def test_another_configuration_is_taken_where_the_nearest_is_a_dead_end():
    """Behind the yaw axis's limit the arm bends backwards: the yaw that is straight away from home is no use."""
    world = StandIn(SINGLE, still, speed=0.0)
    world.center = SINGLE.T_body_base[:3, 3] + [-0.13, -0.20, -0.40]  # the point is 0.06 m ahead of it
    assert follow(world, dls(), 250)[200:].max() < 1e-3
    assert world.q[0] > 0.0


def test_no_command_beyond_the_limits():
    """A point out of reach is approached, and the arm comes to rest."""
    world = StandIn(RIGHT, still, speed=0.0)
    world.center = RIGHT.T_body_base[:3, 3] + [0.9, 0.0, -0.1]
    follow(world, dls(), 400)
    assert world.arm.within_limits(world.command, 1e-9)
    assert np.abs(world.rates).max() < 0.2
    toward = (world.seen(0.0) - RIGHT.T_body_base[:3, 3]) / np.linalg.norm(world.seen(0.0) - RIGHT.T_body_base[:3, 3])
    assert (world.arm.forward(world.q)[:3, 3] - RIGHT.T_body_base[:3, 3]) @ toward > 0.4


# the policy's promises ----------------------------------------------------------------------------


def batch(worlds: list[StandIn]) -> dict[str, np.ndarray]:
    rows = [world.observe() for world in worlds]
    return {name: np.stack([row[name] for row in rows]) for name in rows[0]}


def test_rows_are_what_single_episodes_give():
    worlds = [StandIn(RIGHT, delay=d) for d in (0, 2, 3)]
    policy, state, singles = dls(), None, [None] * 3
    for k in range(30):
        seen, start = batch(worlds), np.array([k == 0, k == 0, k in (0, 10)])
        before = None if state is None else state.copy()
        actions, after = policy.predict(seen, state, start)
        assert actions.shape == (3, 6)
        if before is not None:
            assert before.tobytes() == state.tobytes()  # what was passed in is left alone
        state = after
        for i, world in enumerate(worlds):
            row = {name: values[i] for name, values in seen.items()}
            single, singles[i] = policy.predict(row, None if start[i] else singles[i])
            np.testing.assert_array_equal(single, actions[i])
            world.step(single.astype(float))


def test_more_leading_axes():
    seen = batch([StandIn(RIGHT), StandIn(RIGHT, speed=0.0)])
    actions, _ = dls().predict(seen)
    nested, _ = dls().predict({name: values[None] for name, values in seen.items()})
    np.testing.assert_array_equal(nested, actions[None])


def test_a_scale_of_actions():
    slow, fast = (ServoPolicy(joint_rate=rate).predict(StandIn(RIGHT).observe())[0] for rate in (1.0, 2.0))
    np.testing.assert_allclose(np.abs(slow).max(), np.abs(fast).max(), rtol=0.7)
    with pytest.raises(ValueError, match="joint_rate: expected a positive number"):
        ServoPolicy(joint_rate=0.0)


@pytest.mark.parametrize(("width", "message"), [(27, "4 n \\+ 9 entries"), (37, "joints, got 7")])
def test_other_observations_are_refused(width, message):
    goals = {name: np.zeros(3, np.float32) for name in ("achieved_goal", "desired_goal")}
    with pytest.raises(ValueError, match=message):
        dls().predict({"observation": np.zeros(width, np.float32), **goals})


# Reach-v0 -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("vehicle", ["belerofonte", "aquiles"])
def test_reach(vehicle):
    env = gymnasium.make("aerograsp/Reach-v0", vehicle=vehicle, target_speed=0.0)
    policy, state, errors = load_policy("aerograsp/Reach-v0", "dls"), None, []
    mount = env.unwrapped.config.machine.mounts[0]
    goal = mount.T_body_base[:3, 3] + [0.18, 0.0, -0.40]
    observation, _ = env.reset(seed=3, options={"goal": goal})
    for _ in range(200):
        action, state = policy.predict(observation, state)
        observation, *_ = env.step(action)
        errors.append(env.unwrapped.record["distance"])
    assert np.mean(errors[100:]) < 0.003
    env.close()


def test_the_hover_stays_where_it_is_with_feedforward_of_the_mass():
    for vehicle in reach_table.VEHICLES:
        with_it, without = (np.linalg.norm(reach_table.swing(vehicle, on), axis=1).max() for on in (True, False))
        assert with_it < reach_table.HOVER_TARGET < without


def test_the_table_holds_what_evaluation_gives(monkeypatch):
    from agents.evaluation import evaluate

    def short(env_id, policy, episodes, seed, options, progress=False):
        return evaluate(env_id, policy, episodes, seed, {**options, "max_episode_steps": 110})

    monkeypatch.setattr(reach_table, "evaluate", short)
    monkeypatch.setattr(reach_table, "POSES", ("exact",))
    monkeypatch.setattr(reach_table, "CONDITIONS", {"payload of 0.3 kg": {"payload": 0.3}})
    monkeypatch.setattr(reach_table, "swing", lambda vehicle, on: np.full((2, 3), 0.01 if on else 0.1))
    result = reach_table.run(Request(seed=5, episodes=1), ("dls",))
    assert TABLES["reach"].module == reach_table.__name__
    direct = short(reach_table.ENV_ID, "dls", 1, 5, {"vehicle": "aquiles", "target_speed": 0.0, "pose": "exact"})
    row = next(r for r in result.data["servoing"] if (r["vehicle"], r["target"]) == ("aquiles", "fixed"))
    assert row["with"]["mean"] == direct.mean("error") and len(result.data["servoing"]) == 4
    assert list(result.data["conditions"][0]["policies"]) == ["dls"]
    assert result.data["hover"][0]["with"] == pytest.approx(0.01 * np.sqrt(3.0))
    assert "payload of 0.3 kg" in result.text and result.text.count("✓") == 2
