"""The interface to arms, and the simulated one: what is refused, what moves, and what stops it."""

from __future__ import annotations

import inspect

import numpy as np
import pytest

from aerograsp_env.backends import (
    ArmBackend,
    ArmLimits,
    BackendError,
    CommandRefused,
    MotionDisabled,
    NotConnected,
    ServoError,
    ServoFault,
    ServoParameters,
    SimulatedArm,
    SimulatedServos,
)
from aerograsp_env.backends.simulated_arm import gravity_load, joint_inertias
from aerograsp_env.sim.arms.hecatonquiros import ARMS

LIMITS = ArmLimits(("shoulder", "elbow"), [[-1.0, 1.0], [-0.5, 2.0]], [2.0, 1.0], [0.3, 0.3], watchdog=0.2)
FIRM = ServoParameters(stiffness=100.0, damping=2.0, inertia=0.01, quantum=1e-9)


def arm(**options) -> SimulatedArm:
    return SimulatedArm(LIMITS, [0.0, 0.0], **{"parameters": FIRM, **options})


# --- limits ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"names": ()}, "names"),
        ({"names": ("a", "a")}, "names"),
        ({"position": [[-1.0, 1.0]]}, "position"),
        ({"position": [[-1.0, 1.0], [2.0, 2.0]]}, "position"),
        ({"position": [[-1.0, np.inf], [0.0, 2.0]]}, "position"),
        ({"rate": [1.0, 0.0]}, "rate"),
        ({"step": [0.1]}, "step"),
        ({"watchdog": 0.0}, "watchdog"),
        ({"watchdog": np.nan}, "watchdog"),
    ],
)
def test_limits_say_what_is_wrong(change, name):
    fields = {"names": ("a", "b"), "position": [[-1, 1], [-1, 1]], "rate": [1, 1], "step": [1, 1], "watchdog": 1.0}
    with pytest.raises(ValueError, match=f"^{name}: expected"):
        ArmLimits(**{**fields, **change})


def test_limits_are_read_only():
    with pytest.raises(ValueError, match="read-only"):
        LIMITS.rate[0] = 100.0


@pytest.mark.parametrize("name", ARMS)
def test_limits_of_a_described_arm(name):
    described = ARMS[name]
    limits = ArmLimits.of(described, rate=1.5)
    np.testing.assert_array_equal(limits.position, described.limits)
    assert limits.names == tuple(joint.name for joint in described.joints)
    with pytest.raises(ValueError, match=r"rate: joint 'joint0' reaches .* got 50"):
        ArmLimits.of(described, rate=50.0)


# --- commands ----------------------------------------------------------------


@pytest.mark.parametrize(
    ("position", "rate", "message"),
    [
        ([0.31, 0.0], None, "'shoulder': 0.31 rad is 0.31 rad from where it is, more than the 0.3 rad"),
        ([0.0, -0.51], None, r"'elbow': -0.51 rad is outside its limits \[-0.5, 2\] rad"),
        ([0.1, 0.1], [2.1, 0.5], "'shoulder': 2.1 rad/s is above its 2 rad/s"),
        ([0.1, 0.1], [2.0, 0.0], "rate: expected positive"),
        ([0.1], None, "position: expected 2 finite numbers"),
        ([0.1, np.nan], None, "position: expected 2 finite numbers"),
        ("left", None, "position: expected 2 numbers"),
    ],
)
def test_a_position_beyond_a_limit_is_refused_and_nothing_moves(position, rate, message):
    with arm() as robot:
        with pytest.raises(CommandRefused, match=message):
            robot.command_positions(position, rate)
        robot.advance(0.5)
        np.testing.assert_allclose(robot.read().position, 0.0, atol=1e-6)


@pytest.mark.parametrize(
    ("rate", "dt", "message"),
    [
        ([0.0, -1.01], 0.02, "'elbow': -1.01 rad/s is above its 1 rad/s"),
        ([0.0, 0.0], 0.0, "dt: expected a time in"),
        ([0.0, 0.0], 0.21, "dt: expected a time in"),
        ([2.0, 0.0], 0.2, "'shoulder': 0.4 rad is 0.4 rad from where it is"),
        ([np.inf, 0.0], 0.02, "rate: expected 2 finite"),
    ],
)
def test_a_rate_beyond_a_limit_is_refused(rate, dt, message):
    with arm() as robot, pytest.raises(CommandRefused, match=message):
        robot.command_rates(rate, dt)


def test_a_refused_command_is_a_value_error_too():
    assert issubclass(CommandRefused, ValueError) and issubclass(CommandRefused, BackendError)


def test_a_joint_beyond_its_limit_may_only_come_back():
    robot = SimulatedArm(LIMITS, [1.1, 0.0], parameters=FIRM)
    with robot:
        with pytest.raises(CommandRefused, match=r"'shoulder': 1\.11 rad is outside"):
            robot.command_positions([1.11, 0.0])
        robot.command_positions([1.05, 0.0])
        robot.advance(0.15)
        assert robot.read().position[0] == pytest.approx(1.05, abs=1e-3)


def test_positions_are_reached_at_the_commanded_rate():
    with arm() as robot:
        robot.command_positions([0.2, 0.1], [1.0, 1.0])
        robot.advance(0.15)
        # A servo's position lags its reference by damping / stiffness = 20 ms at a constant rate.
        assert robot.read().position[0] == pytest.approx(1.0 * (0.15 - 0.02), abs=2e-3)
        robot.command_positions([0.2, 0.1], [1.0, 1.0])
        robot.advance(0.19)
        np.testing.assert_allclose(robot.read().position, [0.2, 0.1], atol=1e-3)


def test_rates_add_up_without_drift_and_then_hold():
    with arm() as robot:
        for _ in range(50):
            robot.command_rates([0.8, -0.4], 0.02)
            robot.advance(0.02)
        robot.command_rates([0.0, 0.0], 0.02)
        robot.advance(0.15)
        np.testing.assert_allclose(robot.read().position, [0.8, -0.4], atol=1e-3)


def test_rates_run_into_a_limit_and_are_refused_there():
    with arm() as robot:
        for _ in range(25):
            robot.command_rates([0.0, -1.0], 0.02)
            robot.advance(0.02)
        with pytest.raises(CommandRefused, match=r"'elbow': -0\.52 rad is outside"):
            robot.command_rates([0.0, -1.0], 0.02)
        robot.advance(0.1)
        assert robot.read().position[1] == pytest.approx(-0.5, abs=1e-3)


def test_the_watchdog_holds_where_the_arm_is():
    with arm() as robot:
        robot.command_positions([0.3, 0.0], [0.5, 0.5])  # would take 0.6 s; the watchdog is at 0.2 s
        robot.advance(0.19)
        assert not robot.holding
        robot.advance(0.81)
        assert robot.holding
        assert robot.read().position[0] == pytest.approx(0.5 * (0.2 - 0.02), abs=5e-3)
        robot.command_positions([0.2, 0.0])  # and the arm goes on from there
        assert not robot.holding


def test_stop_holds_where_the_arm_is():
    with arm() as robot:
        robot.command_positions([0.3, 0.0], [0.5, 0.5])
        robot.advance(0.1)
        where = robot.read().position
        robot.stop()
        robot.advance(1.0)
        np.testing.assert_allclose(robot.read().position, where, atol=0.01)


def test_closing_holds_and_the_arm_can_be_connected_again():
    robot = arm()
    with robot:
        robot.command_positions([0.3, 0.0], [0.5, 0.5])
        robot.advance(0.1)
    robot.advance(1.0)
    assert robot.servos.position[0] < 0.06
    robot.close()
    with robot:
        assert robot.connected and robot.holding
        with pytest.raises(BackendError, match="connected already"):
            robot.connect()


def test_a_read_only_arm_is_read_and_never_commanded():
    with arm(enable_motion=False) as robot:
        assert robot.read().position.shape == (2,)
        for command in (
            lambda: robot.command_positions([0.0, 0.0]),
            lambda: robot.command_rates([0.0, 0.0], 0.02),
            robot.stop,
            robot.reset,
        ):
            with pytest.raises(MotionDisabled, match="enable_motion=True"):
                command()


def test_an_arm_that_is_not_connected_says_so():
    robot = arm()
    for call in (robot.read, robot.poll, robot.stop, robot.reset, lambda: robot.command_positions([0.0, 0.0])):
        with pytest.raises(NotConnected):
            call()


def test_the_interface_has_no_way_round_its_checks():
    """What a backend may define is private, so that every command goes through the interface's own."""
    public = {name for name, _ in inspect.getmembers(ArmBackend) if not name.startswith("_")}
    assert public == {
        *("close", "command_positions", "command_rates", "connect", "connected", "holding"),
        *("poll", "read", "reset", "stop"),
    }
    assert not public & set(vars(SimulatedArm))


# --- faults ------------------------------------------------------------------


def test_an_overload_stops_the_arm_until_it_is_reset():
    push = np.array([1.8, 0.0])
    robot = SimulatedArm(
        LIMITS, [0.0, 0.0], parameters=ServoParameters(torque_limit=2.0, protective_share=0.3), load=lambda q: -push
    )
    with robot:
        for _ in range(100):  # 1.8 N m is 90 % of the limit: heavy, and no overload
            robot.command_positions([0.05, 0.0])
            robot.advance(0.02)
        assert robot.read().errors == (ServoError(0), ServoError(0))
        assert robot.read().load[0] == pytest.approx(0.9, abs=0.02)
        push[0] = 2.5
        with pytest.raises(ServoFault, match="'shoulder': OVERLOAD; the arm holds until reset"):
            for _ in range(200):
                robot.command_positions(robot.read().position + [0.1, 0.0])
                robot.advance(0.02)
        assert robot.holding
        assert robot.read().errors[0] == ServoError.OVERLOAD
        with pytest.raises(ServoFault):
            robot.reset()
        push[0] = 0.1
        robot.stop()
        robot.advance(0.5)
        robot.reset()
        robot.command_positions(robot.read().position)


def test_any_error_of_a_servo_stops_the_arm():
    with arm() as robot:
        robot.command_positions([0.2, 0.0])
        robot.servos.faults[1] = ServoError.TEMPERATURE | ServoError.VOLTAGE
        robot.advance(0.05)
        assert robot.read().errors[1] == ServoError.TEMPERATURE | ServoError.VOLTAGE
        assert robot.holding
        with pytest.raises(ServoFault, match=r"'elbow': VOLTAGE\|TEMPERATURE"):
            robot.command_rates([0.0, 0.0], 0.02)
        robot.servos.faults[1] = ServoError(0)
        robot.reset()
        robot.command_rates([0.0, 0.0], 0.02)


# --- servos ------------------------------------------------------------------


def test_a_servo_gives_way_by_the_load_over_its_stiffness():
    servos = SimulatedServos([0.3, -0.2], ServoParameters(stiffness=[20.0, 50.0], torque_limit=3.0))
    servos.advance(2.0, [1.0, -2.0])
    np.testing.assert_allclose(servos.position - [0.3, -0.2], [1.0 / 20.0, -2.0 / 50.0], atol=1e-9)
    np.testing.assert_allclose(servos.torque, [-1.0, 2.0], atol=1e-6)


def test_a_saturated_servo_follows_its_motors_line_from_stall_to_the_no_load_speed():
    stall, top, inertia = 2.0, 4.0, 0.05
    servos = SimulatedServos([0.0], ServoParameters(1e5, 1e-3, stall, top, inertia, overload_time=99.0))
    servos.goal[:] = 10.0
    for _ in range(4):
        servos.advance(0.1)
        expected = top * (1 - np.exp(-stall / top / inertia * servos.time))
        assert servos.velocity[0] == pytest.approx(expected, rel=0.01)
    servos.advance(1.0, -1.5 * stall)  # driven backwards, it gives more than at stall
    assert servos.velocity[0] == pytest.approx(-0.5 * top, rel=1e-3)
    assert servos.torque[0] == pytest.approx(1.5 * stall, rel=1e-3)


def test_a_small_motion_follows_the_closed_form_of_a_damped_oscillator():
    k, c, inertia = 4.0, 0.2, 0.02
    servos = SimulatedServos([0.0], ServoParameters(k, c, 10.0, 1e6, inertia))
    servos.goal[:] = 0.1
    w, decay = np.sqrt(k / inertia - (c / (2 * inertia)) ** 2), c / (2 * inertia)
    for step in range(1, 301):
        servos.advance(0.001)
        t = 0.001 * step
        expected = 0.1 * (1 - np.exp(-decay * t) * (np.cos(w * t) + decay / w * np.sin(w * t)))
        assert servos.position[0] == pytest.approx(expected, abs=1.5e-3)


def test_the_stiffest_servo_on_the_lightest_joint_is_stable():
    servos = SimulatedServos([0.0], ServoParameters(stiffness=1e3, damping=40.0, inertia=1e-6, torque_limit=50.0))
    servos.goal[:] = 0.5
    servos.advance(1.0)
    assert servos.position[0] == pytest.approx(0.5, abs=1e-6)


def test_the_encoder_has_steps():
    servos = SimulatedServos([0.1234567], ServoParameters(quantum=0.01))
    assert servos.measured_position[0] == pytest.approx(0.12)


def test_an_overload_protects_after_its_time_and_until_the_command_eases():
    servos = SimulatedServos([0.0], ServoParameters(stiffness=30.0, torque_limit=2.0, overload_time=1.0))
    servos.advance(0.1)
    servos.goal[:] = 1.0
    blocked = SimulatedServos([0.0], ServoParameters(stiffness=30.0, torque_limit=2.0, inertia=1e6))
    blocked.goal[:] = 1.0
    blocked.advance(0.9)
    assert blocked.torque[0] == pytest.approx(2.0) and blocked.errors == (ServoError(0),)
    blocked.advance(0.4)
    assert blocked.torque[0] == pytest.approx(0.6, abs=1e-5) and blocked.errors == (ServoError.OVERLOAD,)
    blocked.advance(5.0)
    assert blocked.errors == (ServoError.OVERLOAD,)
    blocked.goal[:] = blocked.position
    blocked.advance(0.01)
    assert blocked.errors == (ServoError(0),)
    servos.advance(3.0)  # a joint that is free gets there, and is never overloaded
    assert servos.errors == (ServoError(0),) and servos.position[0] == pytest.approx(1.0, abs=1e-6)


def test_a_servo_that_is_off_gives_no_torque_and_does_not_jump_when_switched_on():
    servos = SimulatedServos([0.0], ServoParameters(inertia=0.1))
    servos.enabled[:] = False
    servos.advance(0.2, 0.5)
    assert servos.position[0] == pytest.approx(0.5 * 5.0 * 0.2**2, rel=0.01) and servos.torque[0] == 0.0
    servos.velocity[:] = 0.0
    servos.goal[:] = where = servos.position.copy()
    servos.enabled[:] = True
    servos.advance(0.5)
    np.testing.assert_allclose(servos.position, where, atol=1e-9)


def test_time_that_comes_in_small_parts_is_the_same_time():
    parts, whole = SimulatedServos([0.0]), SimulatedServos([0.0])
    for servos in (parts, whole):
        servos.goal[:] = 0.4
    for _ in range(400):
        parts.advance(0.0003)
    whole.advance(0.12)
    assert parts.time == pytest.approx(whole.time)
    np.testing.assert_array_equal(parts.position, whole.position)


@pytest.mark.parametrize("field", ["stiffness", "torque_limit", "quantum"])
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, [1.0, -1.0], [[1.0]]])
def test_servo_parameters_say_what_is_wrong(field, value):
    with pytest.raises(ValueError, match=f"^{field}: expected"):
        ServoParameters(**{field: value})


def test_servos_refuse_what_is_not_theirs():
    with pytest.raises(ValueError, match="parameters: expected those of 3"):
        SimulatedServos([0.0, 0.0, 0.0], ServoParameters(stiffness=[1.0, 2.0]))
    for position in ([], [np.nan], [[0.0]]):
        with pytest.raises(ValueError, match="position: expected"):
            SimulatedServos(position)
    servos = SimulatedServos([0.0, 0.0])
    for dt, external, name in ((-1.0, 0.0, "dt"), (np.nan, 0.0, "dt"), (0.1, [1.0], "external"), (0.1, np.inf, "ext")):
        with pytest.raises(ValueError, match=name):
            servos.advance(dt, external)
    with pytest.raises(ValueError, match="position: expected 2 angles"):
        SimulatedArm(LIMITS, [0.0])
    with pytest.raises(ValueError, match="dt: expected"):
        arm().advance(-0.1)


# --- a described arm ---------------------------------------------------------


@pytest.mark.parametrize("name", ARMS)
def test_gravitys_torques_are_the_slope_of_the_potential(name):
    described, rng = ARMS[name], np.random.default_rng(4)
    gravity = rng.normal(size=3) * 5.0
    load = gravity_load(described, gravity)

    def energy(q):
        mass, center, _ = described.mass_properties(q)
        return -mass * gravity @ center

    for q in rng.uniform(*described.limits.T, size=(5, described.n)):
        steps = 1e-6 * np.eye(described.n)
        slope = [(energy(q + step) - energy(q - step)) / 2e-6 for step in steps]
        np.testing.assert_allclose(load(q), -np.array(slope), atol=1e-7)


def test_a_joints_inertia_is_that_of_what_it_moves():
    described = ARMS[next(iter(ARMS))]
    q = described.home
    inertias = joint_inertias(described, q)
    assert (inertias > [joint.armature for joint in described.joints]).all()
    # The first joint moves everything but the base, about the base's z axis.
    mass, center, about = described.mass_properties(q)
    base = described.base
    whole = about[2, 2] + mass * (center[0] ** 2 + center[1] ** 2)
    still = base.inertia[2, 2] + base.mass * (base.center_of_mass[0] ** 2 + base.center_of_mass[1] ** 2)
    assert inertias[0] == pytest.approx(whole - still + described.joints[0].armature, rel=1e-9)


@pytest.mark.parametrize("name", ARMS)
def test_a_described_arm_moves_under_its_own_weight(name):
    robot = SimulatedArm.of(ARMS[name])
    with robot:
        target = robot.read().position + 0.2
        target = np.clip(target, *robot.limits.position.T)
        for _ in range(40):
            robot.command_positions(target)
            robot.advance(0.02)
        sag = gravity_load(ARMS[name])(robot.servos.position) / [j.stiffness for j in ARMS[name].joints]
        np.testing.assert_allclose(robot.read().position, target + sag, atol=3e-3)
        assert np.abs(robot.read().load).max() < 0.6
