"""A line of simulated Feetech servos, with the faults that real lines have: to try a program on before an arm."""

from __future__ import annotations

import os
import select
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Literal

from aerograsp_env.backends.config import SerialArmConfig
from aerograsp_env.backends.feetech import (
    BROADCAST,
    HEADER,
    LOAD_SIGN,
    LOAD_UNIT,
    SPEED_SIGN,
    VOLTAGE_UNIT,
    Instruction,
    Register,
    checksum,
    packet,
)
from aerograsp_env.backends.servos import SimulatedServos

Fault = Literal["silence", "checksum", "truncated", "wrong_id", "noise"]
MEMORY = 80  # bytes of registers


class SimulatedServoBus:
    """Servos that answer packets. Reach them through `port()` in this process, or `serve()` as a serial device.

    Args:
        config: ids, calibration and series of the servos.
        servos: that are moved, one for every joint.
        clock: the time [s] that moves them, at every packet; without it, call `servos.advance`.

    Attributes:
        written: ids that were written to, in order, as (id, first register).
    """

    def __init__(
        self, config: SerialArmConfig, servos: SimulatedServos, *, clock: Callable[[], float] | None = None
    ) -> None:
        if servos.position.size != config.limits.n:
            raise ValueError(f"servos: expected {config.limits.n}, got {servos.position.size}")
        self.config = config
        self.servos = servos
        self.plugged = True
        self.doubled: set[int] = set()  # ids to which a second servo answers too
        self.written: list[tuple[int, int]] = []
        self._clock = clock
        self._then = clock() if clock else 0.0
        self._faults: deque[Fault | None] = deque()
        self._inbox = bytearray()
        self._hang_up: Callable[[], None] | None = None
        self._index = {servo.servo: i for i, servo in enumerate(config.servos)}
        self.memory = {servo: bytearray(MEMORY) for servo in self._index}
        for memory in self.memory.values():
            memory[Register.ANGLE_LIMITS : Register.ANGLE_LIMITS + 4] = config.model.words(0, config.model.full)
            memory[8] = 1  # answers writes
        servos.enabled[:] = False  # as after power-up

    def fail(self, fault: Fault, times: int = 1, *, after: int = 0) -> None:
        """Spoil the next `times` answers, once `after` more have been good."""
        self._faults.extend([None] * after + [fault] * times)

    def unplug(self) -> None:
        """Let the port vanish, as a pulled cable does."""
        self.plugged = False
        if self._hang_up is not None:
            self._hang_up()
            self._hang_up = None

    def port(self) -> SimulatedPort:
        """A port in this process, used as pyserial's; a timeout there takes no time."""
        return SimulatedPort(self)

    @contextmanager
    def serve(self) -> Iterator[str]:
        """Answer on a pseudo-terminal; yields its path, which opens as a serial port (not on Windows)."""
        import tty

        line, device = os.openpty()
        tty.setraw(device)
        path = os.ttyname(device)
        wake, waker = os.pipe()

        def answer() -> None:
            while True:
                ready, _, _ = select.select([line, wake], [], [])
                if wake in ready:
                    return
                if reply := self.receive(os.read(line, 4096)):
                    os.write(line, reply)

        thread = threading.Thread(target=answer, daemon=True)

        def hang_up() -> None:
            os.write(waker, b"x")
            thread.join()
            for descriptor in (line, device, wake, waker):
                os.close(descriptor)

        thread.start()
        self._hang_up = hang_up
        try:
            yield path
        finally:
            if self._hang_up is not None:  # and not unplugged
                self._hang_up()
                self._hang_up = None

    def receive(self, data: bytes) -> bytes:
        """Take bytes from the line and return the answers to them. Damaged packets are ignored, as servos do."""
        if self._clock:
            now = self._clock()
            self.servos.advance(max(now - self._then, 0.0))
            self._then = now
        self._inbox += data
        replies = b""
        while (start := self._inbox.find(HEADER)) >= 0:
            del self._inbox[:start]
            if len(self._inbox) < 4 or len(self._inbox) < self._inbox[3] + 4:
                break
            size = self._inbox[3] + 4
            body = bytes(self._inbox[2:size])
            del self._inbox[:size]
            if len(body) >= 4 and body[-1] == checksum(body[:-1]):
                replies += self._obey(body[0], body[2], body[3:-1])
        return replies

    def _obey(self, servo: int, instruction: int, parameters: bytes) -> bytes:
        if servo == BROADCAST and instruction == Instruction.SYNC_WRITE:
            size = parameters[1] + 1
            for start in range(2, len(parameters), size):
                target, *values = parameters[start : start + size]
                self._write(target, parameters[0], bytes(values))
            return b""
        if servo not in self._index:
            return b""
        data = b""
        if instruction == Instruction.READ:
            self._refresh(servo)
            data = bytes(self.memory[servo][parameters[0] : parameters[0] + parameters[1]])
        elif instruction == Instruction.WRITE:
            self._write(servo, parameters[0], parameters[1:])
        answer = self._spoil(servo, packet(servo, self.servos.errors[self._index[servo]], data))
        return answer * 2 if servo in self.doubled else answer

    def _spoil(self, servo: int, answer: bytes) -> bytes:
        match self._faults.popleft() if self._faults else None:
            case "silence":
                return b""
            case "checksum":
                return answer[:-1] + bytes((answer[-1] ^ 0x01,))
            case "truncated":
                return answer[:-2]
            case "wrong_id":
                return packet((servo + 1) % BROADCAST, answer[4], answer[5:-1])
            case "noise":
                return bytes(byte ^ 0x5A for byte in answer)
        return answer

    def _write(self, servo: int, register: int, data: bytes) -> None:
        if servo not in self._index:
            return
        self.written.append((servo, register))
        i, model = self._index[servo], self.config.model
        self.memory[servo][register : register + len(data)] = data
        memory = bytes(self.memory[servo])
        touched = range(register, register + len(data))
        if Register.TORQUE_ENABLE in touched:
            self.servos.enabled[i] = memory[Register.TORQUE_ENABLE] == 1
        if Register.GOAL in touched:
            calibration = self.config.servos[i]
            low, high = (model.word(memory, Register.ANGLE_LIMITS + k) for k in (0, 2))
            steps = min(max(model.word(memory, Register.GOAL), low), high)  # servos clamp
            speed = model.word(memory, Register.GOAL + 4) * model.speed_unit * abs(calibration.scale(model))
            self.servos.goal[i] = calibration.angle(steps, model)
            self.servos.speed[i] = speed or float("inf")

    def _refresh(self, servo: int) -> None:
        """Write what the servo measures into its registers."""
        i, model, servos = self._index[servo], self.config.model, self.servos
        calibration = self.config.servos[i]
        scale = calibration.scale(model)
        steps = min(max(calibration.steps(servos.position[i], model), 0), model.full)
        speed = _signed(round(servos.velocity[i] / scale / model.speed_unit), SPEED_SIGN)
        load = _signed(round(servos.load[i] / LOAD_UNIT * (1 if scale > 0 else -1)), LOAD_SIGN)
        status = bytes((round(servos.voltage[i] / VOLTAGE_UNIT), round(servos.temperature[i])))
        present = model.words(steps, speed, load) + status
        self.memory[servo][Register.PRESENT : Register.PRESENT + len(present)] = present


def _signed(value: int, sign_bit: int) -> int:
    return min(abs(value), (1 << sign_bit) - 1) | (1 << sign_bit if value < 0 else 0)


class SimulatedPort:
    """The part of pyserial's `Serial` that a `ServoBus` uses, on a simulated line."""

    def __init__(self, line: SimulatedServoBus) -> None:
        self._line = line
        self._inbox = b""

    def _check(self) -> None:
        if not self._line.plugged:
            raise OSError(5, "Input/output error")

    def write(self, data: bytes, /) -> int:
        self._check()
        self._inbox += self._line.receive(data)
        return len(data)

    def read(self, size: int, /) -> bytes:
        self._check()
        data, self._inbox = self._inbox[:size], self._inbox[size:]
        return data

    def reset_input_buffer(self) -> None:
        self._check()
        self._inbox = b""

    def close(self) -> None:
        self._inbox = b""
