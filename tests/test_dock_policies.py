"""Docking policies: batches equal rows, restarts are complete, and the regulator is what its equations say."""

from typing import Any

import gymnasium
import numpy as np
import pytest

import aerograsp_env  # noqa: F401
from baselines.control.lqg import AxisModel
from baselines.policies import dock, dock_attach

DOCK, ATTACH = "aerograsp/Dock-v0", "aerograsp/DockAttach-v0"
CASES = [
    (DOCK, dock.pid),
    (DOCK, dock.pid_tuned),
    (DOCK, dock.lqg),
    (ATTACH, dock_attach.pid),
    (ATTACH, dock_attach.pid_tuned),
]


def observations(env_id, count=3, steps=60):
    """A list of batches of random observations; in DockAttach row i couples at a step of its own."""
    env = gymnasium.make(env_id)
    space: Any = env.observation_space
    env.close()
    rng = np.random.default_rng(0)
    batches = []
    for t in range(steps):
        batch = {key: 0.1 * rng.standard_normal((count, *box.shape)) for key, box in space.spaces.items()}
        if "coupled" in batch:
            batch["coupled"] = (t > 10 * np.arange(1, count + 1))[:, None].astype(float)
        batches.append({key: value.astype(np.float32) for key, value in batch.items()})
    return batches


@pytest.mark.parametrize(("env_id", "make"), CASES)
def test_a_batch_equals_its_rows_and_actions_fit_the_space(env_id, make):
    batches = observations(env_id)
    policy, state, rows = make(), None, [None] * 3
    for batch in batches:
        action, state = policy.predict(batch, state=state)
        assert action.dtype == np.float32 and np.abs(action).max() <= 1.0 and np.isfinite(action).all()
        for i in range(3):
            alone, rows[i] = policy.predict({key: value[i] for key, value in batch.items()}, state=rows[i])
            assert alone.shape == action.shape[1:]
            np.testing.assert_allclose(alone, action[i], atol=1e-6)


@pytest.mark.parametrize(("env_id", "make"), CASES)
def test_episode_start_restarts_its_rows_only(env_id, make):
    batches = observations(env_id)
    policy, state = make(), None
    for batch in batches[:40]:
        _, state = policy.predict(batch, state=state)
    kept, fresh = state, None
    start = np.array([False, True, False])
    for batch in batches:
        action, state = policy.predict(batch, state=state, episode_start=start)
        expected, kept = policy.predict(batch, state=kept)
        anew, fresh = policy.predict(batch, state=fresh)
        np.testing.assert_allclose(action[[0, 2]], expected[[0, 2]], atol=1e-6)
        np.testing.assert_allclose(action[1], anew[1], atol=1e-6)
        start = np.zeros(3, dtype=bool)


@pytest.mark.parametrize(("env_id", "make"), CASES)
def test_predict_leaves_its_state_alone(env_id, make):
    first, second = observations(env_id, steps=2)
    policy = make()
    _, state = policy.predict(first)
    once, _ = policy.predict(second, state=state)
    again, _ = policy.predict(second, state=state)
    np.testing.assert_array_equal(once, again)


def attach_observation(**values):
    observation = {
        "position_error": np.zeros(3),
        "seat_offset": np.zeros(3),
        "coupled": np.zeros(1),
        "attitude": np.zeros(3),
    }
    return {**observation, **{key: np.asarray(value, dtype=float) for key, value in values.items()}}


def test_the_approach_comes_down_only_over_the_seat_and_closes_there():
    policy = dock_attach.pid()
    aside, _ = policy.predict(attach_observation(seat_offset=[0.5, 0.0, -0.10]))
    assert aside[0] > 0 and aside[2] > 0 and aside[4] == -1.0  # 10 cm over the seat is too low half a metre away
    above, _ = policy.predict(attach_observation(seat_offset=[0.0, 0.0, -0.10]))
    assert above[2] < 0 and above[4] <= 0.0
    there, _ = policy.predict(attach_observation(seat_offset=[0.01, 0.0, -0.02]))
    assert there[4] > 0.0
    turned, _ = policy.predict(attach_observation(attitude=[0.0, 0.0, 0.3]))
    assert turned[3] < 0  # turns back to heading 0


def test_after_the_coupling_the_set_point_moves_from_the_vehicle_at_its_speed():
    policy = dock_attach.DockAttachPolicy(dock.pid_tuned().controller, way_speed=0.05, closing_time=0.6)
    way = np.array([0.05, 0.0, -0.2])
    _, state = policy.predict(attach_observation())
    lengths = []
    for _ in range(600):
        action, state = policy.predict(attach_observation(coupled=[1.0], position_error=way), state=state)
        lengths.append(np.linalg.norm(state.way))
    assert lengths[0] == pytest.approx(np.linalg.norm(way))
    assert lengths[int(0.55 / dock.STEP)] == pytest.approx(lengths[0])  # waits for the jaws
    arrived = np.flatnonzero(np.array(lengths) == 0.0)[0] * dock.STEP
    assert arrived == pytest.approx(0.6 + np.linalg.norm(way) / 0.05, abs=0.05)
    assert action[2] < 0


# The regulator


MODELS = [
    AxisModel(),
    AxisModel(4.0, 2.0, 0.0, 0.06),
    AxisModel(delay=0.0),
    AxisModel(delay=0.02),
    AxisModel(delay=0.2),
]


@pytest.mark.parametrize("model", MODELS)
def test_feedback_is_optimal_and_stable(model):
    """A policy is optimal if it is greedy against its own value, which a Lyapunov sum gives, not a Riccati equation."""
    r = model.design(dock.STEP)
    closed = r.transition - np.outer(r.input, r.feedback)
    assert np.abs(np.linalg.eigvals(closed)).max() < 1.0
    weight = model.change_weight / dock.STEP**2
    stage = weight * np.outer(r.feedback, r.feedback)
    stage[0, 0] += 1.0
    value, power = stage.copy(), closed.copy()
    for _ in range(40):  # doubling: the sum of 2^40 steps
        value += power.T @ value @ power
        power = power @ power
    np.testing.assert_allclose(value, stage + closed.T @ value @ closed, rtol=1e-6, atol=1e-9 * np.abs(value).max())
    greedy = (r.input @ value @ r.transition) / (weight + r.input @ value @ r.input)
    np.testing.assert_allclose(r.feedback, greedy, rtol=1e-5, atol=1e-8)


@pytest.mark.parametrize("model", MODELS)
def test_filter_is_optimal_and_stable(model):
    r = model.design(dock.STEP)
    a, c, gain = r.transition[:6, :6], r.measurement[:, :6], r.filter_gain[:6]
    error = a @ (np.eye(6) - gain @ c)
    assert np.abs(np.linalg.eigvals(error)).max() < 1.0
    noise = 1e-10 * np.eye(6)
    noise[4, 4] = model.bias_std**2 * (1 - np.exp(-2 * dock.STEP / model.bias_time))
    noise[5, 5] = model.disturbance_std**2 * (1 - np.exp(-2 * dock.STEP / model.disturbance_time))
    seen = np.diag([model.position_std**2, model.velocity_std**2])
    covariance, power = noise + a @ gain @ seen @ gain.T @ a.T, error.copy()
    for _ in range(40):
        covariance += power @ covariance @ power.T
        power = power @ power
    best = np.linalg.solve(c @ covariance @ c.T + seen, c @ covariance).T
    np.testing.assert_allclose(gain, best, rtol=1e-4, atol=1e-7)
    assert not r.filter_gain[6:].any()  # commands are known


class Axis:
    """The vehicle that the regulator is made for, integrated in steps of 1 ms, apart from its matrices."""

    def __init__(self, model, delay):
        self.model, self.waiting = model, [0.0] * round(delay / dock.STEP)
        self.p = self.v = self.a = self.z = self.b = self.d = 0.0

    def step(self, command):
        m, h = self.model, 1e-3
        self.waiting.append(command)
        u = self.waiting.pop(0)
        for _ in range(round(dock.STEP / h)):
            error = u - self.v - self.b
            wanted = m.velocity_p * error + self.z - m.velocity_d * self.a
            self.p, self.v = self.p + h * self.v, self.v + h * (self.a + self.d)
            self.a += h * (wanted - self.a) / m.lag
            self.z += h * m.velocity_i * error


def regulate(design, plant, seconds):
    """Closed loop of the policy made from `design` on one axis; positions (T,) and the last state estimate."""
    regulator = design.design(dock.STEP)
    policy, positions = dock.LQGPolicy((regulator,) * 3), []
    state: Any = None
    for _ in range(round(seconds / dock.STEP)):
        seen = {"position_error": -np.full(3, plant.p), "velocity": np.full(3, plant.v + plant.b)}
        action, state = policy.predict(seen, state=state)
        plant.step(float(action[0]) * dock.VELOCITY_LIMIT)
        positions.append(plant.p)
    return np.array(positions), state.estimate[0]


def test_a_constant_bias_is_estimated_and_cancelled():
    plant = Axis(AxisModel(), 0.08)
    plant.b = 0.05
    positions, estimate = regulate(AxisModel(), plant, 20.0)
    assert np.abs(positions[-100:]).max() < 0.002  # 0.05 m otherwise, at a gain of 1/s
    assert estimate[4] == pytest.approx(0.05, rel=0.05)


def test_a_constant_disturbance_is_estimated_and_cancelled():
    plant, design = Axis(AxisModel(), 0.08), AxisModel(disturbance_time=100.0)
    plant.d = 0.2
    positions, estimate = regulate(design, plant, 20.0)
    assert np.abs(positions[-100:]).max() < 0.002
    assert estimate[5] == pytest.approx(0.2, rel=0.1)
    assert estimate[3] == pytest.approx(plant.z, rel=0.1)  # the autopilot's own integrator carries it


def test_the_delay_that_is_designed_for_is_met():
    """From 10 cm off: with the delay known the vehicle settles; what thinks that there is none does worse."""
    costs = []
    for believed in (0.2, 0.0):
        plant = Axis(AxisModel(), 0.2)
        plant.p = 0.1
        positions, _ = regulate(AxisModel(delay=believed), plant, 20.0)
        costs.append(np.sum(positions**2))
        if believed == 0.2:
            assert np.abs(positions[-50:]).max() < 1e-3
    assert costs[0] < costs[1]


@pytest.mark.parametrize("name", AxisModel.__dataclass_fields__)
def test_bad_constants_raise(name):
    for bad in (-1.0, np.nan, np.inf):
        with pytest.raises(ValueError, match=name):
            AxisModel(**{name: bad})
    if name not in ("velocity_i", "velocity_d", "delay"):
        with pytest.raises(ValueError, match=name):
            AxisModel(**{name: 0.0})
