"""PID: closed forms of its three terms, its two anti-windup guards, batches, and what it refuses."""

import dataclasses

import numpy as np
import pytest

from baselines.control import PID, PIDState

INF = float("inf")


def free(kp=0.0, ki=0.0, kd=0.0, **kwargs):
    return PID(kp, ki, kd, integral_limit=INF, output_limit=INF, **kwargs)


def run(pid, errors, dt, state=None):
    outputs = []
    for error in errors:
        u, state = pid.step(error, dt, state)
        outputs.append(u)
    return np.array(outputs), state


def test_proportional_is_the_gain_times_the_error():
    u, _ = free(kp=[0.8, 0.8, 0.3]).step([1.0, -2.0, 3.0], 0.02)
    np.testing.assert_allclose(u, [0.8, -1.6, 0.9])


def test_integral_of_a_constant_error_is_a_ramp():
    u, state = run(free(ki=0.5), [2.0] * 100, 0.01)
    np.testing.assert_allclose(u, 0.5 * 2.0 * 0.01 * np.arange(1, 101))
    np.testing.assert_allclose(state.integral, 2.0)


def test_derivative_of_a_ramp_is_its_slope_and_zero_at_the_first_step():
    u, _ = run(free(kd=0.7), 3.0 * 0.02 * np.arange(20) + 5.0, 0.02)
    assert u[0] == 0.0
    np.testing.assert_allclose(u[1:], 0.7 * 3.0)


def test_filtered_derivative_follows_the_first_order_recursion():
    dt, tau = 0.01, 0.05
    u, _ = run(free(kd=1.0, derivative_time_constant=tau), dt * np.arange(60), dt)
    np.testing.assert_allclose(u, 1.0 - (tau / (tau + dt)) ** np.arange(60), atol=1e-12)


def test_filtered_derivative_attenuates_alternating_noise():
    noise = 0.01 * (-1.0) ** np.arange(200)
    raw, _ = run(free(kd=1.0), noise, 0.02)
    filtered, _ = run(free(kd=1.0, derivative_time_constant=0.1), noise, 0.02)
    # The discrete low-pass has gain a / (2 − a) at the Nyquist frequency, a = dt / (tau + dt).
    a = 0.02 / 0.12
    np.testing.assert_allclose(np.abs(filtered[-1]), np.abs(raw[-1]) * a / (2 - a), rtol=1e-3)


def test_integral_state_is_clamped():
    pid = PID(0.0, 0.01, 0.0, integral_limit=10.0, output_limit=2.0)
    _, state = run(pid, [50.0] * 1000, 0.02)
    assert state.integral == 10.0
    _, state = run(pid, [-50.0] * 1000, 0.02, state)
    assert state.integral == -10.0


def test_saturated_output_stops_integrating_outwards_but_not_inwards():
    pid = PID(1.0, 1.0, 0.0, integral_limit=INF, output_limit=1.0)
    u, state = run(pid, [5.0] * 200, 0.02)
    assert np.all(u == 1.0)
    assert state.integral == 0.0
    # Output held at the limit by the proportional term while the integral unwinds: that must go on.
    wound = PIDState(np.array(-1.0), np.array(5.0), np.array(0.0), np.array(True))
    _, state = pid.step(-0.5, 0.02, wound)
    assert state.integral == -1.0  # pushes outwards: held
    wound = wound._replace(integral=np.array(3.0))
    u, state = pid.step(-0.5, 0.02, wound)
    assert u == 1.0
    assert state.integral == pytest.approx(3.0 - 0.01)  # relieves: goes on


def test_conditional_integration_handles_a_negative_loop_gain():
    pid = PID(-1.0, -1.0, 0.0, integral_limit=INF, output_limit=1.0)
    _, state = run(pid, [5.0] * 50, 0.02)
    assert state.integral == 0.0


def test_anti_windup_reduces_the_overshoot_of_a_saturated_loop():
    def overshoot(pid):
        x, state, peak = 0.0, None, 0.0
        for _ in range(4000):
            u, state = pid.step(1.0 - x, 0.01, state)
            x += 0.01 * np.clip(u, -0.1, 0.1)
            peak = max(peak, x)
        return peak - 1.0

    guarded = overshoot(PID(1.0, 0.5, 0.0, INF, 0.1))
    assert guarded < 0.2 * overshoot(free(kp=1.0, ki=0.5))


def test_output_never_exceeds_its_limits_per_axis():
    pid = PID([0.8, 0.8, 0.3], [0.01, 0.01, 0.03], 0.7, 10.0, [2.0, 2.0, 1.0])
    rng = np.random.default_rng(0)
    u, _ = run(pid, rng.normal(scale=20.0, size=(300, 3)), 0.02)
    assert (np.abs(u) <= [2.0, 2.0, 1.0]).all()
    assert (np.abs(u) == [2.0, 2.0, 1.0]).any(axis=0).all()


def test_closed_loop_removes_a_constant_disturbance():
    pid = PID(2.0, 1.0, 0.1, 10.0, 5.0)
    x, state = 0.0, None
    for _ in range(3000):
        u, state = pid.step(1.0 - x, 0.02, state)
        x += 0.02 * (u - 0.4)
    assert x == pytest.approx(1.0, abs=1e-6)
    assert state.integral * 1.0 == pytest.approx(0.4, abs=1e-6)


def test_a_batch_equals_its_items():
    pid = PID([0.8, 0.8, 0.3], [0.1, 0.2, 0.3], 0.7, 0.05, [0.2, 0.5, 1.0], derivative_time_constant=0.03)
    errors = np.random.default_rng(1).normal(scale=0.3, size=(40, 2, 5, 3))
    batched, state = run(pid, errors, 0.02)
    assert batched.shape == errors.shape
    for index in np.ndindex(2, 5):
        single, last = run(pid, errors[(slice(None), *index)], 0.02)
        np.testing.assert_array_equal(batched[(slice(None), *index)], single)
        np.testing.assert_array_equal(state.integral[index], last.integral)


def test_scalar_error_with_axis_gains_broadcasts():
    u, state = PID([1.0, 2.0], 0.0, 0.0, INF, INF).step(3.0, 0.1)
    np.testing.assert_array_equal(u, [3.0, 6.0])
    assert state.integral.shape == (2,)


def test_reset_restarts_only_the_masked_rows():
    pid = PID([0.8, 0.3], 0.5, 0.7, 10.0, 2.0)
    errors = np.random.default_rng(2).normal(size=(12, 4, 2))
    mask = np.array([False, True, False, True])
    _, state = run(pid, errors[:10], 0.02)
    u, _ = run(pid, errors[10:], 0.02, pid.reset(state, mask))
    kept, _ = run(pid, errors[10:], 0.02, state)
    fresh, _ = run(pid, errors[10:], 0.02)
    np.testing.assert_array_equal(u[:, ~mask], kept[:, ~mask])
    np.testing.assert_array_equal(u[:, mask], fresh[:, mask])
    everything = pid.reset(state, True)
    for a, b in zip(everything, pid.initial_state((4, 2)), strict=True):
        np.testing.assert_array_equal(a, b)


def test_step_changes_neither_its_inputs_nor_the_old_state():
    pid = PID(1.0, 1.0, 1.0, 10.0, 10.0)
    error = np.ones(3)
    _, state = pid.step(error, 0.02)
    before = [np.array(field) for field in state]
    error += 1.0
    pid.step(error, 0.02, state)
    for field, old in zip(state, before, strict=True):
        np.testing.assert_array_equal(field, old)


def test_it_is_frozen():
    gains = np.ones(3)
    pid = PID(gains, 0.0, 0.0, 1.0, 1.0)
    gains[:] = 9.0
    np.testing.assert_array_equal(pid.kp, 1.0)
    with pytest.raises(dataclasses.FrozenInstanceError):
        pid.kp = 2.0
    with pytest.raises(ValueError, match="read-only"):
        pid.kp[0] = 2.0


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"kp": float("nan")}, "kp"),
        ({"ki": INF}, "ki"),
        ({"kd": "fast"}, "kd"),
        ({"integral_limit": -1.0}, "integral_limit"),
        ({"output_limit": 0.0}, "output_limit"),
        ({"derivative_time_constant": -0.1}, "derivative_time_constant"),
        ({"derivative_time_constant": INF}, "derivative_time_constant"),
        ({"kp": [1.0, 2.0], "kd": [1.0, 2.0, 3.0]}, "broadcast"),
    ],
)
def test_bad_parameters_are_refused_by_name(change, name):
    arguments = {"kp": 1.0, "ki": 0.0, "kd": 0.0, "integral_limit": 1.0, "output_limit": 1.0} | change
    with pytest.raises(ValueError, match=name):
        PID(**arguments)


def test_bad_steps_are_refused_by_name():
    pid = PID([1.0, 1.0, 1.0], 0.0, 0.0, 1.0, 1.0)
    with pytest.raises(ValueError, match="error"):
        pid.step([0.0, float("nan"), 0.0], 0.02)
    with pytest.raises(ValueError, match="error"):
        pid.step([0.0, 1.0], 0.02)
    for dt in (0.0, -0.02, float("nan"), INF):
        with pytest.raises(ValueError, match="dt"):
            pid.step(np.zeros(3), dt)
    with pytest.raises(ValueError, match="state"):
        pid.step(np.zeros((4, 3)), 0.02, pid.initial_state(3))
    with pytest.raises(ValueError, match="mask"):
        pid.reset(pid.initial_state((4, 3)), [True, False])
    with pytest.raises(ValueError, match="mask"):
        pid.reset(pid.initial_state((4, 3)), np.ones(4))
