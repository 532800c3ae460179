"""Serial servos: the bytes on the line, the calibration, and what happens when the line or a servo fails."""

from __future__ import annotations

import math
import subprocess
import sys

import numpy as np
import pytest

from aerograsp_env.backends import (
    SCS,
    STS,
    ArmLimits,
    BackendError,
    CommandRefused,
    IdConflict,
    LinkLost,
    MotionDisabled,
    SerialArm,
    SerialArmConfig,
    ServoBus,
    ServoCalibration,
    ServoError,
    ServoFault,
    SimulatedServoBus,
    SimulatedServos,
    read_calibration,
)
from aerograsp_env.backends.bus import open_port
from aerograsp_env.backends.feetech import PacketError, Register, packet, parse_status

NAMES = ("base", "shoulder", "elbow")
# The first three joints of the robot's own config_arm1.xml.
XML = """
<Config>
    <MinMaxValues>
        <Joint1E1>-109.376</Joint1E1> <Joint2E1>-111.490</Joint2E1> <Joint3E1>-104.869</Joint3E1>
        <Joint1E2>106.492</Joint1E2> <Joint2E2>107.986</Joint2E2> <Joint3E2>113.775</Joint3E2>
    </MinMaxValues>
    <Offsets>
        <Joint1>-0.05</Joint1> <Joint2>0.087266463</Joint2> <Joint3>0.087266463</Joint3>
    </Offsets>
</Config>
"""


def config(first: int = 11, model=SCS, **options) -> SerialArmConfig:
    limits = ArmLimits(NAMES, [[-1.5, 1.5]] * 3, [2.0] * 3, [0.3] * 3, watchdog=0.2)
    turn = math.pi * model.full / (model.full + 1)
    servos = tuple(ServoCalibration(first + i, -turn, turn) for i in range(3))
    return SerialArmConfig(limits, servos, model, **options)


class Line:
    """An arm on a simulated line, whose clock is the servos'."""

    def __init__(self, setup: SerialArmConfig | None = None, *, enable_motion: bool = True) -> None:
        self.config = setup or config()
        self.servos = SimulatedServos(np.zeros(3))
        self.simulated = SimulatedServoBus(self.config, self.servos)
        self.bus = ServoBus(self.simulated.port())
        self.arm = SerialArm(self.config, self.bus, enable_motion=enable_motion, clock=lambda: self.servos.time)

    def run(self, target, steps: int = 20) -> None:
        """Command one target at 50 Hz."""
        for _ in range(steps):
            self.arm.command_positions(target)
            self.servos.advance(0.02)


# --- packets -----------------------------------------------------------------


def test_packets_are_those_of_the_protocols_examples():
    """The ping of servo 1 and the read of 2 bytes at 56, as Feetech's and Dynamixel's manuals print them."""
    assert packet(1, 0x01) == bytes.fromhex("ff ff 01 02 01 fb")
    assert packet(1, 0x02, bytes((0x38, 0x02))) == bytes.fromhex("ff ff 01 04 02 38 02 be")
    status = parse_status(bytes.fromhex("ff ff 01 02 20 dc"), 1, 0)
    assert status.error == ServoError.OVERLOAD and status.data == b""


def test_words_and_signs():
    assert SCS.words(0x0123, 2) == bytes.fromhex("01 23 00 02")
    assert STS.words(0x0123, 2) == bytes.fromhex("23 01 02 00")
    for model in (SCS, STS):
        assert model.signed(model.words(0x8005), 0, 15) == -5
        assert model.signed(model.words(0x0405), 0, 10) == -5
        assert model.signed(model.words(0x0005), 0, 10) == 5
    present = SCS.decode_present(bytes.fromhex("02 00 80 64 04 c8 4a 1e"))
    assert present == (512, -100, pytest.approx(-0.2), pytest.approx(7.4), 30.0)


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        ("", "no answer in time"),
        ("ff ff 01", "3 bytes came, of a packet of 8"),
        ("fe ff 01 04 00 02 00 f8", "no packet starts with fe ff"),
        ("ff ff 01 05 00 02 00 f7", "4 bytes came, of a packet that announced 5"),
        ("ff ff 01 04 00 02 00 f9", "bad checksum"),
        ("ff ff 02 04 00 02 00 f7", "servo 2 answered in its place"),
        ("ff ff 01 03 00 02 f9", "expected 2 bytes of data, got 1"),
    ],
)
def test_a_wrong_answer_is_told(answer, message):
    with pytest.raises(PacketError, match=message):
        parse_status(bytes.fromhex(answer), 1, 2)


@pytest.mark.parametrize(("data", "message"), [(bytes(7), "8 bytes"), (SCS.words(1024, 0, 0, 0), "beyond the encoder")])
def test_measurements_that_cannot_be_are_told(data, message):
    with pytest.raises(PacketError, match=message):
        SCS.decode_present(data)


def test_packets_refuse_what_does_not_fit():
    with pytest.raises(ValueError, match="servo"):
        packet(255, 1)
    with pytest.raises(ValueError, match="parameters"):
        packet(1, 3, bytes(251))


# --- calibration and configuration -------------------------------------------


def test_the_robots_own_file(tmp_path):
    path = tmp_path / "config_arm1.xml"
    path.write_text(XML)
    servos = read_calibration(path, 1)
    assert [servo.servo for servo in servos] == [11, 12, 13]
    first = servos[0]
    assert (first.zero, first.full, first.offset) == (math.radians(-109.376), math.radians(106.492), -0.05)
    # value = (angle + offset − E1) / (E2 − E1) · 1023, as the robot's own driver maps angles
    expected = (0.3 - 0.05 - math.radians(-109.376)) / math.radians(106.492 + 109.376) * 1023
    assert first.steps(0.3, SCS) == round(expected)
    for servo in servos:
        for steps in (0, 1, 511, 1023):
            assert servo.steps(servo.angle(steps, SCS), SCS) == steps
    arm = SerialArmConfig.from_xml(path, 1, names=("a", "b"))
    np.testing.assert_allclose(arm.limits.position[0], np.radians([-109.376, 106.492]) + 0.05)
    assert arm.ids == {11: "a", 12: "b"}
    assert SerialArmConfig.from_xml(path, 2, position=[[-1, 1]] * 3).limits.position[2].tolist() == [-1, 1]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("</Config>", "", "expected XML"),
        ("<Joint2E2>107.986</Joint2E2>", "", "expected an element MinMaxValues/Joint2E2"),
        ("107.986", "far", "MinMaxValues/Joint2E2: expected a number, got 'far'"),
        ("107.986", "-111.490", "joint 2: zero, full, offset"),
        ("Offsets", "Shifts", "expected an element Offsets/Joint1"),
    ],
)
def test_a_broken_file_names_its_fault(tmp_path, old, new, message):
    path = tmp_path / "arm.xml"
    path.write_text(XML.replace(old, new))
    with pytest.raises(ValueError, match=message):
        read_calibration(path, 1)


def test_configurations_say_what_is_wrong(tmp_path):
    good = config()
    two = good.servos[:2]
    with pytest.raises(ValueError, match="servos: expected 3, one for every joint, got 2"):
        SerialArmConfig(good.limits, two)
    with pytest.raises(ValueError, match="joints 'base' and 'elbow' both have id 11"):
        SerialArmConfig(good.limits, (*two, good.servos[0]))
    with pytest.raises(ValueError, match=r"limits: joint 'elbow': \[-1\.5, 1\.5\] rad is beyond"):
        SerialArmConfig(good.limits, (*two, ServoCalibration(13, -1.0, 1.0)))
    with pytest.raises(ValueError, match="on_link_lost"):
        config(on_link_lost="fall")
    for bad in ((254, -1.0, 1.0), (1, 1.0, 1.0), (1, math.nan, 1.0)):
        with pytest.raises(ValueError, match="expected"):
            ServoCalibration(*bad)
    path = tmp_path / "arm.xml"
    path.write_text(XML)
    with pytest.raises(ValueError, match=r"names: .* has 3 joints, got 4"):
        SerialArmConfig.from_xml(path, 1, names=("a", "b", "c", "d"))


# --- an arm ------------------------------------------------------------------


@pytest.mark.parametrize("model", [SCS, STS], ids=lambda model: model.name)
def test_an_arm_is_read_and_moved(model):
    line = Line(config(model=model))
    with line.arm as arm:
        line.run([0.2, -0.1, 0.05])
        state = arm.read()
        step = 2 * math.pi / (model.full + 1)
        np.testing.assert_allclose(state.position, [0.2, -0.1, 0.05], atol=step)
        np.testing.assert_allclose(state.position, line.servos.position, atol=step)
        np.testing.assert_allclose(state.velocity, 0.0, atol=step)
        np.testing.assert_allclose(state.temperature, 25.0)
        np.testing.assert_allclose(state.voltage, 7.4)
        assert state.errors == (ServoError(0),) * 3 and state.stamp == line.servos.time
        arm.command_positions([0.48, -0.1, 0.05], [1.0, 1.0, 1.0])
        line.servos.advance(0.19)
        assert arm.read().velocity[0] == pytest.approx(1.0, abs=0.01 + step)
        # A servo lags its reference by damping / stiffness = 40 ms.
        assert arm.read().position[0] == pytest.approx(0.2 + 1.0 * (0.19 - 0.04), abs=0.01)


def test_loads_have_the_joints_sign_also_where_a_servo_turns_backwards():
    good = config()
    turned = ServoCalibration(12, good.servos[1].full, good.servos[1].zero)
    line = Line(SerialArmConfig(good.limits, (good.servos[0], turned, good.servos[2])))
    with line.arm as arm:
        line.servos.advance(0.5, [0.5, 0.5, -0.5])
        np.testing.assert_allclose(arm.read().load, np.array([-0.5, -0.5, 0.5]) / 2.45, atol=1e-3)
        line.run([0.1, 0.1, 0.1], 5)
        np.testing.assert_allclose(arm.read().velocity, line.servos.velocity, atol=7e-3)
        assert (arm.read().velocity > 0.1).all()
        line.run([0.1, 0.1, 0.1])
        np.testing.assert_allclose(line.servos.position, 0.1, atol=4e-3)
        assert (arm.read().position > 0.08).all()


def test_rates_move_an_arm():
    line = Line()
    with line.arm as arm:
        for _ in range(50):
            arm.command_rates([0.5, -0.5, 0.0], 0.02)
            line.servos.advance(0.02)
        line.servos.advance(0.1)
        np.testing.assert_allclose(arm.read().position, [0.5, -0.5, 0.0], atol=0.01)


def test_a_joint_that_lags_catches_up_no_faster_than_its_limit():
    line = Line()
    with line.arm as arm:
        for _ in range(8):  # the servo stands still meanwhile
            arm.command_rates([1.5, 0.0, 0.0], 0.02)
        speeds = line.simulated.memory[11][Register.GOAL + 4 : Register.GOAL + 6]
        assert 1.9 < int.from_bytes(speeds, "big") * 2 * math.pi / 1024 <= 2.0
        with pytest.raises(CommandRefused, match=r"'base': .* more than the 0"):
            for _ in range(8):
                arm.command_rates([1.5, 0.0, 0.0], 0.02)


def test_connecting_moves_nothing_and_switches_the_torque_on_last():
    line = Line()
    line.servos.position[:] = where = [0.4, -0.3, 0.2]
    line.servos.goal[:] = 1.0  # what the servos were last told, before
    with line.arm:
        assert line.servos.enabled.all()
        first_torque = line.simulated.written.index((11, Register.TORQUE_ENABLE))
        assert {(servo, Register.GOAL) for servo in (11, 12, 13)} <= set(line.simulated.written[:first_torque])
        line.servos.advance(0.5)
        np.testing.assert_allclose(line.servos.position, where, atol=4e-3)


def test_a_read_only_arm_writes_nothing():
    line = Line(enable_motion=False)
    with line.arm as arm:
        arm.read()
        for command in (lambda: arm.command_positions([0.0] * 3), lambda: arm.command_rates([0.0] * 3, 0.1), arm.stop):
            with pytest.raises(MotionDisabled):
                command()
        line.simulated.fail("silence", 5)
        with pytest.raises(LinkLost, match="read-only: nothing was sent"):
            arm.read()
    assert line.simulated.written == [] and not line.servos.enabled.any()


def test_motion_is_off_unless_asked_for():
    arm = SerialArm(config(), ServoBus(SimulatedServoBus(config(), SimulatedServos(np.zeros(3))).port()))
    assert not arm.motion_enabled


def test_a_refused_command_reaches_no_servo():
    line = Line()
    with line.arm as arm:
        before = list(line.simulated.written)
        with pytest.raises(CommandRefused, match=r"'shoulder': 0.5 rad is .* more than the 0.3 rad"):
            arm.command_positions([0.1, 0.5, 0.1])
        assert line.simulated.written == before


def test_the_watchdog_holds_a_serial_arm():
    line = Line()
    with line.arm as arm:
        arm.command_positions([0.3, 0.0, 0.0], [0.5] * 3)
        for _ in range(50):
            line.servos.advance(0.02)
            arm.poll()
        assert arm.holding
        assert arm.read().position[0] == pytest.approx(0.5 * (0.22 - 0.04), abs=0.02)


@pytest.mark.parametrize("release", [False, True])
def test_closing_holds_or_lets_go(release):
    line = Line(config(release_on_close=release))
    with line.arm as arm:
        arm.command_positions([0.3, 0.0, 0.0], [0.5] * 3)
        line.servos.advance(0.1)
    assert line.servos.enabled.tolist() == [not release] * 3
    line.servos.advance(0.5)
    assert release or line.servos.position[0] < 0.08


# --- what is on the line is checked ------------------------------------------


def test_a_servo_of_another_series_is_refused():
    line = Line()
    sts = SerialArm(config(model=STS), line.bus, enable_motion=True)
    with pytest.raises(BackendError, match=r"'base' \(servo 11\): its angle limits read .* no STS servo"):
        sts.connect()
    assert line.simulated.written == []


def test_a_servo_that_turns_freely_is_refused():
    line = Line()
    line.simulated.memory[12][Register.ANGLE_LIMITS : Register.ANGLE_LIMITS + 4] = bytes(4)
    with pytest.raises(BackendError, match=r"'shoulder' \(servo 12\): its angle limits read 0 and 0"):
        line.arm.connect()
    line = Line(config(model=STS))
    line.simulated.memory[13][Register.MODE] = 1
    with pytest.raises(BackendError, match=r"'elbow' \(servo 13\): it is in mode 1"):
        line.arm.connect()


def test_a_servo_that_would_clamp_silently_is_refused():
    line = Line()
    line.simulated.memory[12][Register.ANGLE_LIMITS : Register.ANGLE_LIMITS + 4] = SCS.words(300, 700)
    with pytest.raises(BackendError, match=r"'shoulder' \(servo 12\): the servo's own limits end at \[-1\.29"):
        line.arm.connect()
    with SerialArm(line.config, line.bus) as reader:  # reading it is fine
        reader.read()


def test_a_servo_that_is_missing_is_named():
    line = Line()
    lonely = SerialArm(config(first=12), line.bus)
    with pytest.raises(LinkLost, match=r"joint 'elbow' \(servo 14\): 5 bad answers in a row, the last: no answer"):
        lonely.connect()
    with line.arm:  # and its ids are free again
        pass


def test_two_servos_with_one_id_are_noticed():
    line = Line()
    line.simulated.doubled.add(12)
    with pytest.raises(IdConflict, match=r"'shoulder' \(servo 12\): more than one servo"):
        line.arm.connect()


def test_two_arms_cannot_have_one_servo():
    line = Line()
    other = SerialArm(config(first=13), line.bus, enable_motion=True)
    with line.arm:
        with pytest.raises(IdConflict, match="servo 13 is joint 'elbow' already, and was asked for 'base'"):
            other.connect()
        assert line.arm.connected and not other.connected
        line.run([0.1, 0.0, 0.0])


def test_two_arms_share_a_line():
    limits = ArmLimits(tuple("abcdef"), [[-1.5, 1.5]] * 6, [2.0] * 6, [0.3] * 6)
    left, right = config(first=11), config(first=21)
    servos = SimulatedServos(np.zeros(6))
    bus = ServoBus(SimulatedServoBus(SerialArmConfig(limits, left.servos + right.servos), servos).port())
    arms = [SerialArm(c, bus, enable_motion=True, clock=lambda: servos.time) for c in (left, right)]
    with arms[0], arms[1]:
        for _ in range(20):
            for arm, sign in zip(arms, (1, -1), strict=True):
                arm.command_positions([sign * 0.1, 0.0, sign * 0.2])
            servos.advance(0.02)
        np.testing.assert_allclose(servos.position, [0.1, 0, 0.2, -0.1, 0, -0.2], atol=4e-3)


# --- faults of the line ------------------------------------------------------


@pytest.mark.parametrize("fault", ["silence", "checksum", "truncated", "wrong_id", "noise"])
def test_a_few_bad_answers_are_asked_for_again(fault):
    line = Line()
    with line.arm as arm:
        for _ in range(10):
            line.simulated.fail(fault, 4, after=1)
            line.run([0.1, 0.1, 0.1], 1)
        np.testing.assert_allclose(arm.read().position, line.servos.position, atol=4e-3)
    assert sum(line.bus.failures.values()) == 40


@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        ("silence", "no answer in time"),
        ("checksum", "bad checksum"),
        ("truncated", "8 bytes came, of a packet that announced 10"),
        ("wrong_id", "servo 13 answered in its place"),
        ("noise", "no packet starts with"),
    ],
)
def test_bad_answers_in_a_row_stop_the_arm(fault, reason):
    line = Line()
    with line.arm as arm:
        arm.command_positions([0.3, 0.0, 0.0], [1.0] * 3)
        line.servos.advance(0.1)
        where = arm.read().position
        line.servos.advance(0.05)
        line.simulated.fail(fault, 5, after=1)
        with pytest.raises(LinkLost, match=rf"'shoulder' \(servo 12\): 5 bad answers in a row, the last: {reason}"):
            arm.read()
        line.servos.advance(1.0)
        np.testing.assert_allclose(line.servos.position, where, atol=4e-3)
        for call in (arm.read, arm.stop, arm.reset, arm.poll, lambda: arm.command_positions([0.0] * 3)):
            with pytest.raises(LinkLost, match="told to hold where they were last read"):
                call()
    with line.arm as arm:  # the line is well again
        assert arm.connected
        line.run([0.1, 0.0, 0.0])


def test_a_lost_arm_lets_go_where_that_is_asked_for():
    line = Line(config(on_link_lost="release"))
    with line.arm as arm:
        line.simulated.fail("silence", 5)
        with pytest.raises(LinkLost, match="told to let go"):
            arm.read()
    assert not line.servos.enabled.any()


def test_a_port_that_vanishes_in_motion_leaves_the_arm_at_its_last_command():
    line = Line()
    with line.arm as arm:
        line.run([0.1, 0.0, 0.0], 3)
        measured = arm.read().position
        arm.command_positions(target := [measured[0] + 0.3, 0.0, 0.0])
        line.simulated.unplug()
        line.servos.advance(0.05)
        with pytest.raises(LinkLost, match=r"the port failed: .* nothing could be sent: .* at most 0\.3 rad away"):
            arm.read()
        assert not arm.connected
        line.servos.advance(2.0)
        np.testing.assert_allclose(line.servos.position, target, atol=4e-3)
    assert not arm.connected


def test_a_port_that_vanishes_before_a_command_is_sent():
    line = Line()
    with line.arm as arm:
        arm.read()
        line.simulated.unplug()
        with pytest.raises(LinkLost, match="the port failed"):
            arm.command_positions([0.1, 0.0, 0.0])
        assert line.servos.goal[0] == pytest.approx(0.0, abs=4e-3)


def test_a_late_answer_is_not_taken_for_the_next_one():
    line = Line()
    with line.arm as arm:
        arm.read()
        port = line.bus._port
        port._inbox = packet(11, 0, bytes(8))
        np.testing.assert_allclose(arm.read().position, 0.0, atol=4e-3)
    assert not line.bus.failures


def test_an_impossible_position_is_a_lost_link():
    line = Line()
    with line.arm as arm:
        line.simulated._refresh = lambda servo: line.simulated.memory[servo].__setitem__(56, 0xFF)
        with pytest.raises(LinkLost, match=r"'base' \(servo 11\): position 6\d+ is beyond the encoder's 1023 steps"):
            arm.read()


# --- faults of servos --------------------------------------------------------


def test_the_overload_bit_stops_the_arm():
    line = Line()
    with line.arm as arm:
        arm.command_positions([0.3, 0.3, 0.3], [1.0] * 3)
        line.servos.advance(0.1)
        line.servos.faults[2] = ServoError.OVERLOAD
        state = arm.read()
        assert state.errors == (ServoError(0), ServoError(0), ServoError.OVERLOAD) and arm.holding
        with pytest.raises(ServoFault, match="'elbow': OVERLOAD; the arm holds until reset"):
            arm.command_positions(state.position)
        line.servos.advance(1.0)
        np.testing.assert_allclose(line.servos.position, state.position, atol=4e-3)
        with pytest.raises(ServoFault):
            arm.reset()
        line.servos.faults[2] = ServoError(0)
        line.servos.enabled[2] = False  # as servos do that unload themselves
        arm.reset()
        line.run([0.2, 0.2, 0.2])
        np.testing.assert_allclose(line.servos.position, 0.2, atol=4e-3)


def test_a_blocked_servo_protects_itself_and_the_arm_stops():
    line = Line()
    with line.arm as arm:
        with pytest.raises(ServoFault, match="'base': OVERLOAD"):
            for _ in range(200):
                position = arm.read().position
                arm.command_positions(position + [0.2, 0.0, 0.0])
                line.servos.advance(0.02, [-2.42, 0.0, 0.0] if line.servos.time > 0.1 else 0.0)
        assert 1.0 < line.servos.time < 2.0


def test_an_arm_with_a_fault_connects_and_cannot_be_commanded():
    line = Line()
    line.servos.faults[0] = ServoError.VOLTAGE
    with line.arm as arm:
        with pytest.raises(ServoFault, match="'base': VOLTAGE"):
            arm.command_positions([0.0] * 3)
        assert not line.servos.enabled.any()
        before = list(line.simulated.written)
    assert line.simulated.written == before  # it was never made to move, so closing has nothing to stop


# --- a serial device ---------------------------------------------------------


def test_an_arm_on_a_serial_device():
    setup = config()
    servos = SimulatedServos(np.zeros(3))
    line = SimulatedServoBus(setup, servos)
    with line.serve() as path:
        with SerialArm(setup, path, enable_motion=True, clock=lambda: servos.time) as arm:
            with pytest.raises(BackendError, match=r"cannot be opened.*share one ServoBus"):
                SerialArm(setup, path).connect()
            for _ in range(10):
                arm.command_positions([0.1, 0.0, -0.1])
                arm.read()  # the command is through once this is answered
                servos.advance(0.05)
            np.testing.assert_allclose(arm.read().position, [0.1, 0.0, -0.1], atol=6e-3)
            line.fail("checksum", 2)
            arm.read()
        with SerialArm(setup, path, clock=lambda: servos.time) as arm:
            line.fail("silence", 5)
            with pytest.raises(LinkLost, match="5 bad answers in a row"):
                arm.read()


def test_a_serial_device_that_vanishes():
    setup = config()
    line = SimulatedServoBus(setup, SimulatedServos(np.zeros(3)))
    with line.serve() as path, SerialArm(setup, path, enable_motion=True) as arm:
        arm.read()
        line.unplug()
        with pytest.raises(LinkLost, match="the port failed"):
            arm.read()


def test_a_port_that_is_not_there(tmp_path):
    with pytest.raises(BackendError, match=r"port .*no-such-port' cannot be opened"):
        SerialArm(config(), str(tmp_path / "no-such-port")).connect()


def test_without_pyserial_the_error_names_the_package(monkeypatch):
    monkeypatch.setitem(sys.modules, "serial", None)
    with pytest.raises(ImportError, match=r"pip install 'aerograsp\[serial\]'"):
        open_port("/dev/null")


def test_the_backends_load_neither_pyserial_nor_a_simulator():
    code = "import sys, aerograsp_env.backends; print({'serial', 'mujoco', 'numba'} & set(sys.modules))"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "set()"


def test_a_bus_refuses_what_cannot_be():
    with pytest.raises(ValueError, match="max_failures"):
        ServoBus(Line().simulated.port(), max_failures=0)
    with pytest.raises(ValueError, match="servo: expected an id from 0 to 253"):
        Line().bus.read(254, Register.PRESENT, 8)
    with pytest.raises(ValueError, match="servos: expected 3, got 1"):
        SimulatedServoBus(config(), SimulatedServos([0.0]))


def test_an_adapter_that_echoes_is_refused():
    line = Line()
    port = line.bus._port
    receive = line.simulated.receive
    line.simulated.receive = lambda data: data + receive(data)
    with pytest.raises(IdConflict, match="or the adapter echoes"):
        line.arm.connect()
    assert line.simulated.written == [] and port._inbox != b""


def test_an_interrupted_program_leaves_the_arm_holding():
    line = Line()
    with pytest.raises(KeyboardInterrupt), line.arm as arm:
        arm.command_positions([0.3, 0.0, 0.0], [0.5] * 3)
        line.servos.advance(0.1)
        raise KeyboardInterrupt
    line.servos.advance(1.0)
    assert line.servos.position[0] < 0.08 and line.servos.enabled.all()


def test_the_speed_of_a_command_is_never_above_the_asked_and_never_zero():
    """A goal speed of 0 would mean: as fast as the servo can."""
    line = Line()
    with line.arm as arm:
        for rate in (1e-4, 0.01, 0.5, 2.0):
            arm.command_positions([0.1, 0.0, 0.0], [rate] * 3)
            words = line.simulated.memory[11][Register.GOAL : Register.GOAL + 6]
            units, step = int.from_bytes(words[4:6], "big"), 2 * math.pi / 1024
            assert units >= 1 and (units == 1 or units * step <= rate)
