"""A line of Feetech servos: requests, answers, and when the line counts as lost."""

from __future__ import annotations

import importlib
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from typing import Protocol

from aerograsp_env.backends.feetech import (
    BROADCAST,
    LARGEST_ID,
    Instruction,
    PacketError,
    Register,
    Status,
    packet,
    parse_status,
)
from aerograsp_env.backends.limits import BackendError, LinkLost

BAUD = 1_000_000  # [1/s] as Feetech's servos leave the factory
TIMEOUT = 0.02  # [s] for an answer: servos take less than 1 ms, USB adapters up to 16 ms
MAX_FAILURES = 5  # bad or missing answers in a row until the link counts as lost

try:
    from termios import error as _TerminalError
except ImportError:  # there is none on Windows
    PORT_ERRORS: tuple[type[Exception], ...] = (OSError,)
else:
    PORT_ERRORS = (OSError, _TerminalError)  # pyserial's errors are OSErrors, but it lets the terminal's own through


class IdConflict(BackendError):
    """One id for two servos."""


class Port(Protocol):
    """What is used of pyserial's `Serial`."""

    def read(self, size: int, /) -> bytes:
        """At most `size` bytes: fewer if they do not come within the port's timeout."""

    def write(self, data: bytes, /) -> int | None: ...
    def reset_input_buffer(self) -> None: ...
    def close(self) -> None: ...


def open_port(path: str, *, baud: int = BAUD, timeout: float = TIMEOUT) -> Port:
    """The serial port at `path`, locked against other programs.

    Raises:
        ImportError: pyserial is not installed.
        BackendError: the port cannot be opened, or another arm or program has it.
    """
    try:
        serial = importlib.import_module("serial")
    except ImportError as error:
        raise ImportError("serial servos need the package pyserial: pip install 'aerograsp[serial]'") from error
    failures: tuple[type[Exception], ...] = (*PORT_ERRORS, ValueError)
    try:
        return serial.Serial(path, baud, timeout=timeout, write_timeout=timeout, exclusive=True)
    except failures as error:
        raise BackendError(
            f"port {path!r} cannot be opened: {error}. Arms on one line share one ServoBus instead of opening it twice"
        ) from error


class ServoBus:
    """A half-duplex line, to which one or more arms are connected; for one thread.

    A bad or missing answer is asked for again; `max_failures` in a row, or a port that fails, raise `LinkLost`.

    Args:
        port: open, with a timeout.
        max_failures: attempts at one request.

    Attributes:
        failures: how often answers were bad, by reason.

    Raises:
        ValueError: max_failures below 1.
    """

    def __init__(self, port: Port, *, max_failures: int = MAX_FAILURES) -> None:
        if max_failures < 1:
            raise ValueError(f"max_failures: expected at least 1, got {max_failures}")
        self._port = port
        self._max_failures = max_failures
        self._owners: dict[int, str] = {}
        self.failures: Counter[str] = Counter()

    def claim(self, owners: Mapping[int, str]) -> None:
        """Take ids for joints, {id: joint's name}; one id can be taken once.

        Raises:
            IdConflict: naming both joints; nothing is taken then.
        """
        for servo, name in owners.items():
            if servo in self._owners:
                raise IdConflict(f"servo {servo} is joint {self._owners[servo]!r} already, and was asked for {name!r}")
        self._owners.update(owners)

    def release(self, owners: Mapping[int, str]) -> None:
        """Give ids back that `claim` took."""
        for servo in owners:
            self._owners.pop(servo, None)

    def probe(self, servo: int) -> Status:
        """Ask whether a servo is there, and alone.

        Raises:
            IdConflict: more bytes came than one servo sends.
            LinkLost: no good answer; garbled ones are also what two servos of one id send at once.
        """
        status = self._request(servo, Instruction.PING, b"", 0)
        if self._port_read(1):
            raise IdConflict(f"{self._label(servo)}: more than one servo answers to its id, or the adapter echoes")
        return status

    def read(self, servo: int, register: Register, size: int) -> Status:
        """`size` bytes from a register on.

        Raises:
            LinkLost: no good answer.
        """
        return self._request(servo, Instruction.READ, bytes((register, size)), size)

    def write(self, servo: int, register: Register, data: bytes) -> Status:
        """Write from a register on, acknowledged (servos answer writes unless their register 8 says otherwise).

        Raises:
            LinkLost: no good answer.
        """
        return self._request(servo, Instruction.WRITE, bytes((register,)) + data, 0)

    def sync_write(self, register: Register, data: Mapping[int, bytes]) -> None:
        """Write as many bytes to each of several servos, {id: bytes}, at once. None answers.

        Raises:
            LinkLost: the port failed.
        """
        size = len(next(iter(data.values())))
        parameters = bytes((register, size)) + b"".join(bytes((servo,)) + value for servo, value in data.items())
        self._port_write(packet(BROADCAST, Instruction.SYNC_WRITE, parameters))

    def close(self) -> None:
        """Close the port, also one that vanished."""
        with suppress(*PORT_ERRORS):
            self._port.close()

    def _request(self, servo: int, instruction: Instruction, parameters: bytes, size: int) -> Status:
        if not 0 <= servo <= LARGEST_ID:
            raise ValueError(f"servo: expected an id from 0 to {LARGEST_ID}, got {servo}")
        request, reasons = packet(servo, instruction, parameters), []
        for _ in range(self._max_failures):
            self._port_write(request)
            try:
                return parse_status(self._port_read(size + 6), servo, size)
            except PacketError as error:
                self.failures[str(error)] += 1
                reasons.append(str(error))
        raise LinkLost(f"{self._label(servo)}: {len(reasons)} bad answers in a row, the last: {reasons[-1]}")

    def _label(self, servo: int) -> str:
        return f"joint {self._owners[servo]!r} (servo {servo})" if servo in self._owners else f"servo {servo}"

    def _port_write(self, data: bytes) -> None:
        try:
            self._port.reset_input_buffer()  # what is left there answered an earlier request, too late
            self._port.write(data)
        except PORT_ERRORS as error:
            raise LinkLost(f"the port failed: {error}") from error

    def _port_read(self, size: int) -> bytes:
        try:
            return self._port.read(size)
        except PORT_ERRORS as error:
            raise LinkLost(f"the port failed: {error}") from error
