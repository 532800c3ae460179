"""The protocol of Feetech's serial bus servos: packets, registers and the units of their numbers.

Instruction packet: 0xFF 0xFF id length instruction parameters checksum; a status packet has the servo's error bits in
the instruction's place. `length` counts what follows it; the checksum is the complement of the low byte of the sum of
everything between the header and itself. These are the framing and the instructions of Dynamixel's protocol 1.0, with
a register map of Feetech's own (FT-SCS protocol; memory tables of the SCS and of the SMS and STS series; SCS15 manual
v1.02). SCS servos, which the thesis' arms have, store words high byte first and turn a potentiometer of 1024 steps;
STS servos store the low byte first and have a magnetic encoder of 4096 steps. Signed numbers are sign and magnitude.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Literal, NamedTuple

from aerograsp_env.backends.limits import ServoError

HEADER = b"\xff\xff"
BROADCAST = 0xFE  # every servo obeys, none answers
LARGEST_ID = 0xFD


class Instruction(IntEnum):
    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    SYNC_WRITE = 0x83


class Register(IntEnum):
    """Addresses that both series share; words take two bytes from there on."""

    ANGLE_LIMITS = 9  # two words: lowest and highest goal [steps]; equal in wheel mode
    MODE = 33  # STS only: 0 is position control
    TORQUE_ENABLE = 40
    GOAL = 42  # three words: position [steps], time [ms], speed [steps/s]
    PRESENT = 56  # position, speed, load (words), voltage [0.1 V], temperature [°C]


GOAL_SIZE = 6
PRESENT_SIZE = 8
SPEED_SIGN = 15  # bits that carry the sign
LOAD_SIGN = 10
LOAD_UNIT = 1e-3  # of the largest torque
VOLTAGE_UNIT = 0.1  # [V]


class PacketError(ValueError):
    """Bytes that are not the status packet that was due."""


class Status(NamedTuple):
    """A servo's answer."""

    servo: int
    error: ServoError
    data: bytes


class Present(NamedTuple):
    """What a servo measures."""

    position: int  # [steps]
    speed: int  # [register units]
    load: float  # share of the largest torque
    voltage: float  # [V]
    temperature: float  # [°C]


@dataclass(frozen=True)
class ServoModel:
    """A series of servos.

    Args:
        name: of the series.
        full: largest position [steps].
        byte_order: of words.
        has_mode: whether the register of the operating mode exists.
        speed_unit: [steps/s] of one unit of speed. Some STS firmware counts in 50 steps/s (bit 2 of its phase byte).
    """

    name: str
    full: int
    byte_order: Literal["big", "little"]
    has_mode: bool = False
    speed_unit: float = 1.0

    def words(self, *values: int) -> bytes:
        """Unsigned words, in this series' byte order."""
        return b"".join(value.to_bytes(2, self.byte_order) for value in values)

    def word(self, data: bytes, offset: int = 0) -> int:
        """The unsigned word at `offset`."""
        return int.from_bytes(data[offset : offset + 2], self.byte_order)

    def signed(self, data: bytes, offset: int, sign_bit: int) -> int:
        """The word at `offset`, a magnitude whose sign is in `sign_bit`."""
        value = self.word(data, offset)
        magnitude = value & ((1 << sign_bit) - 1)
        return -magnitude if value >> sign_bit & 1 else magnitude

    def decode_present(self, data: bytes) -> Present:
        """What the registers from `Register.PRESENT` on say.

        Raises:
            PacketError: another number of bytes, or a position that the encoder cannot have.
        """
        if len(data) != PRESENT_SIZE:
            raise PacketError(f"expected {PRESENT_SIZE} bytes of measurements, got {len(data)}")
        position = self.word(data)
        if position > self.full:
            raise PacketError(f"position {position} is beyond the encoder's {self.full} steps")
        speed, load = self.signed(data, 2, SPEED_SIGN), self.signed(data, 4, LOAD_SIGN)
        return Present(position, speed, load * LOAD_UNIT, data[6] * VOLTAGE_UNIT, float(data[7]))


SCS = ServoModel("SCS", 1023, "big")
STS = ServoModel("STS", 4095, "little", has_mode=True)


def checksum(body: bytes) -> int:
    """Of the bytes between the header and the checksum."""
    return ~sum(body) & 0xFF


def packet(servo: int, code: int, parameters: bytes = b"") -> bytes:
    """A packet: `code` is the instruction, or in a status packet the error bits.

    Raises:
        ValueError: an id outside 0 to 254, or parameters too long for one packet.
    """
    if not 0 <= servo <= BROADCAST:
        raise ValueError(f"servo: expected an id from 0 to {BROADCAST}, got {servo}")
    if len(parameters) > 250:
        raise ValueError(f"parameters: expected at most 250 bytes, got {len(parameters)}")
    body = bytes((servo, len(parameters) + 2, code)) + parameters
    return HEADER + body + bytes((checksum(body),))


def parse_status(data: bytes, servo: int, size: int) -> Status:
    """The status packet of `servo` with `size` bytes of parameters.

    Raises:
        PacketError: saying how the bytes differ from that.
    """
    if len(data) < 6:
        raise PacketError(f"{len(data)} bytes came, of a packet of {size + 6}" if data else "no answer in time")
    if data[:2] != HEADER:
        raise PacketError(f"no packet starts with {data[:2].hex(' ')}")
    if data[3] != len(data) - 4:
        raise PacketError(f"{len(data) - 4} bytes came, of a packet that announced {data[3]}")
    if data[-1] != checksum(data[2:-1]):
        raise PacketError("bad checksum")
    if data[2] != servo:
        raise PacketError(f"servo {data[2]} answered in its place")
    if len(data) != size + 6:
        raise PacketError(f"expected {size} bytes of data, got {len(data) - 6}")
    return Status(servo, ServoError(data[4]), data[5:-1])
