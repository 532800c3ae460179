"""An arm of Feetech's serial bus servos."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.backends.bus import ServoBus, open_port
from aerograsp_env.backends.config import SerialArmConfig
from aerograsp_env.backends.feetech import PRESENT_SIZE, PacketError, Present, Register
from aerograsp_env.backends.interface import ArmBackend
from aerograsp_env.backends.limits import ArmState, BackendError, LinkLost, ServoError

Array = NDArray[np.float64]


class SerialArm(ArmBackend):
    """An arm of serial servos, read-only unless `enable_motion` is set.

    Connecting pings every servo and checks that each is alone at its id, of the configured series and in position
    mode, and, if motion is enabled, that its own angle limits do not cut the configured ones (servos clamp silently).
    Then every servo is told to hold where it is, before its torque is switched on, so that nothing jumps.

    Args:
        config: of the arm.
        port: the path of a serial port, which the arm then opens and closes, or the bus that it shares with others.
        enable_motion: True lets the servos be commanded. Without it nothing is ever written to them.
        clock: the time [s].

    `connect` also raises `IdConflict`, and `ImportError` where `port` is a path and pyserial is not installed.
    """

    def __init__(
        self,
        config: SerialArmConfig,
        port: str | ServoBus,
        *,
        enable_motion: bool = False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(config.limits, enable_motion=enable_motion, clock=clock)
        self.config = config
        self._port = port
        self._bus: ServoBus
        self._started = False

    def _open(self) -> None:
        config = self.config
        self._started = False
        if isinstance(self._port, ServoBus):
            self._bus = self._port
        else:
            port = open_port(self._port, baud=config.baud, timeout=config.timeout)
            self._bus = ServoBus(port, max_failures=config.max_failures)
        try:
            self._bus.claim(config.ids)
            try:
                for i in range(self.limits.n):
                    self._check(i)
            except BaseException:
                self._bus.release(config.ids)
                raise
        except BaseException:
            self._leave()
            raise

    def _check(self, i: int) -> None:
        """Refuse a servo that is not what the configuration says."""
        config, model, name = self.config, self.config.model, self.limits.names[i]
        servo = config.servos[i]
        self._bus.probe(servo.servo)
        data = self._bus.read(servo.servo, Register.ANGLE_LIMITS, 4).data
        low, high = model.word(data, 0), model.word(data, 2)
        if not low < high <= model.full:
            raise BackendError(
                f"joint {name!r} (servo {servo.servo}): its angle limits read {low} and {high}, which no {model.name} "
                "servo in position mode has: it is of another series, or turns freely"
            )
        if model.has_mode and (mode := self._bus.read(servo.servo, Register.MODE, 1).data[0]):
            raise BackendError(f"joint {name!r} (servo {servo.servo}): it is in mode {mode}, not in position mode 0")
        wanted = sorted(servo.steps(angle, model) for angle in self.limits.position[i])
        if self.motion_enabled and not low <= wanted[0] < wanted[1] <= high:
            first, last = sorted(servo.angle(step, model) for step in (low, high))
            raise BackendError(
                f"joint {name!r} (servo {servo.servo}): the servo's own limits end at [{first:.4g}, {last:.4g}] rad, "
                "inside the configured ones, and it would clamp silently: narrow the configured limits"
            )

    def _shut(self) -> None:
        try:
            if self._started and self._lost is None:
                if self.config.release_on_close:
                    self._torque(False)
                else:
                    self._hold(self._reading())
        except LinkLost:
            pass  # what could be done was done as the link was lost
        finally:
            self._bus.release(self.config.ids)
            self._leave()

    def _leave(self) -> None:
        if not isinstance(self._port, ServoBus):
            self._bus.close()

    def _start(self, state: ArmState) -> None:
        self._send(state.position, self.limits.rate)
        self._started = True
        for servo in self.config.servos:
            self._bus.write(servo.servo, Register.TORQUE_ENABLE, b"\x01")

    def _measure(self) -> ArmState:
        model, servos = self.config.model, self.config.servos
        stamp, readings = self._clock(), [self._present(servo.servo) for servo in servos]
        scale = np.array([servo.scale(model) for servo in servos])
        table = np.array([present for present, _ in readings], dtype=float)
        return ArmState(
            stamp,
            np.array(
                [servo.angle(present.position, model) for servo, (present, _) in zip(servos, readings, strict=True)]
            ),
            table[:, 1] * model.speed_unit * scale,
            table[:, 2] * np.sign(scale),
            table[:, 4],
            table[:, 3],
            tuple(error for _, error in readings),
        )

    def _present(self, servo: int) -> tuple[Present, ServoError]:
        status = self._bus.read(servo, Register.PRESENT, PRESENT_SIZE)
        try:
            return self.config.model.decode_present(status.data), status.error
        except PacketError as error:
            # The checksum was right, so that asking again would not help; and without a position there is no control.
            raise LinkLost(f"joint {self.config.ids[servo]!r} (servo {servo}): {error}") from error

    def _send(self, target: Array, rate: Array) -> None:
        model, goals = self.config.model, {}
        for servo, angle, speed in zip(self.config.servos, target, rate, strict=True):
            # Rounded down, so that no servo is faster than asked; but 0 would mean as fast as it can.
            units = max(int(speed / abs(servo.scale(model)) / model.speed_unit), 1)
            steps = min(max(servo.steps(angle, model), 0), model.full)  # of the last half step, at the encoder's ends
            goals[servo.servo] = model.words(steps, 0, min(units, 0x7FFF))
        self._bus.sync_write(Register.GOAL, goals)

    def _torque(self, on: bool) -> None:
        self._bus.sync_write(Register.TORQUE_ENABLE, {servo.servo: bytes((on,)) for servo in self.config.servos})

    def _abandon(self, last: ArmState | None) -> str:
        reach = f"{self.limits.step.max():.3g} rad"
        try:
            if self.config.on_link_lost == "release":
                self._torque(False)
                return "the servos were told to let go"
            if last is not None:
                self._send(last.position, self.limits.rate)
                return "the servos were told to hold where they were last read"
        except LinkLost:
            pass
        return f"nothing could be sent: the servos hold where their last command ends, at most {reach} away"
