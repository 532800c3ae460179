"""How an arm of serial servos is wired and calibrated, and the files that say so."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, Self
from xml.etree import ElementTree

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.backends.bus import BAUD, MAX_FAILURES, TIMEOUT
from aerograsp_env.backends.feetech import LARGEST_ID, SCS, ServoModel
from aerograsp_env.backends.limits import ArmLimits

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ServoCalibration:
    """From a servo's steps to its joint's angle: zero + (full − zero) · steps / largest step − offset.

    Args:
        servo: its id.
        zero: angle at step 0, before the offset [rad].
        full: angle at the largest step [rad]; below `zero` if the servo turns the joint backwards.
        offset: what the joint's angle lies below the servo's [rad].

    Raises:
        ValueError: an id outside 0 to 253, or angles that are equal or not finite.
    """

    servo: int
    zero: float
    full: float
    offset: float = 0.0

    def __post_init__(self) -> None:
        if not 0 <= self.servo <= LARGEST_ID:
            raise ValueError(f"servo: expected an id from 0 to {LARGEST_ID}, got {self.servo}")
        if not all(map(math.isfinite, (self.zero, self.full, self.offset))) or self.zero == self.full:
            raise ValueError(f"zero, full, offset: expected finite angles [rad], zero not full, got {self}")

    @property
    def span(self) -> tuple[float, float]:
        """Lowest and highest angle of the joint that the encoder can tell [rad]."""
        ends = (self.zero - self.offset, self.full - self.offset)
        return min(ends), max(ends)

    def scale(self, model: ServoModel) -> float:
        """[rad] of one step, negative for a joint that the servo turns backwards."""
        return (self.full - self.zero) / model.full

    def angle(self, steps: float, model: ServoModel) -> float:
        """[rad] of the joint."""
        return self.zero + self.scale(model) * steps - self.offset

    def steps(self, angle: float, model: ServoModel) -> int:
        """The nearest step to a joint's angle [rad]. It may lie outside the encoder's."""
        return round((angle + self.offset - self.zero) / self.scale(model))


def read_calibration(path: str | Path, arm: int) -> tuple[ServoCalibration, ...]:
    """The calibration of a Hecatonquiros arm, from the robot's own `config_arm*.xml`.

    `MinMaxValues` are the angles [degrees] at a servo's first (E1) and last (E2) step, and `Offsets` are what is added
    to a joint's angle [rad] to get the servo's. Servo ids are 10 · arm + joint, joints counted from 1.

    Args:
        path: of the file.
        arm: the arm's number on the line.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is not such a file, naming the element.
    """
    try:
        root = ElementTree.parse(path).getroot()
    except ElementTree.ParseError as error:
        raise ValueError(f"{path}: expected XML: {error}") from error

    def number(element: str) -> float:
        text = root.findtext(element)
        if text is None:
            raise ValueError(f"{path}: expected an element {element}")
        try:
            return float(text)
        except ValueError as error:
            raise ValueError(f"{path}: {element}: expected a number, got {text!r}") from error

    calibrations: list[ServoCalibration] = []
    while root.find(f"Offsets/Joint{(joint := len(calibrations) + 1)}") is not None or not calibrations:
        zero, full = (math.radians(number(f"MinMaxValues/Joint{joint}E{end}")) for end in (1, 2))
        try:
            calibrations.append(ServoCalibration(10 * arm + joint, zero, full, number(f"Offsets/Joint{joint}")))
        except ValueError as error:
            raise ValueError(f"{path}: joint {joint}: {error}") from error
    return tuple(calibrations)


@dataclass(frozen=True)
class SerialArmConfig:
    """An arm of serial servos.

    Args:
        limits: what may be commanded.
        servos: the calibration of each joint's servo.
        model: the servos' series.
        on_link_lost: what is tried when servos stop answering: "hold" makes every one stay where it was last read,
            "release" takes its torque. An arm under a vehicle had better hold; one that can pinch a person, release.
        release_on_close: whether `close` takes the torque; by default servos go on holding after it.
        baud, timeout, max_failures: of the line [1/s], [s], [bad answers in a row].

    Raises:
        ValueError: another number of servos than joints, an id twice, or limits beyond what an encoder can tell.
    """

    limits: ArmLimits
    servos: tuple[ServoCalibration, ...]
    model: ServoModel = SCS
    on_link_lost: Literal["hold", "release"] = "hold"
    release_on_close: bool = False
    baud: int = field(default=BAUD, kw_only=True)
    timeout: float = field(default=TIMEOUT, kw_only=True)
    max_failures: int = field(default=MAX_FAILURES, kw_only=True)

    def __post_init__(self) -> None:
        names = self.limits.names
        if len(self.servos) != self.limits.n:
            raise ValueError(f"servos: expected {self.limits.n}, one for every joint, got {len(self.servos)}")
        joints: dict[int, str] = {}
        for name, servo, (low, high) in zip(names, self.servos, self.limits.position, strict=True):
            if servo.servo in joints:
                raise ValueError(f"servos: joints {joints[servo.servo]!r} and {name!r} both have id {servo.servo}")
            joints[servo.servo] = name
            if low < servo.span[0] - 1e-9 or high > servo.span[1] + 1e-9:
                raise ValueError(
                    f"limits: joint {name!r}: [{low:.4g}, {high:.4g}] rad is beyond the "
                    f"[{servo.span[0]:.4g}, {servo.span[1]:.4g}] rad that its servo can tell"
                )
        if self.on_link_lost not in ("hold", "release"):
            raise ValueError(f"on_link_lost: expected 'hold' or 'release', got {self.on_link_lost!r}")

    @property
    def ids(self) -> dict[int, str]:
        """{servo's id: joint's name}."""
        return {servo.servo: name for servo, name in zip(self.servos, self.limits.names, strict=True)}

    @classmethod
    def from_xml(
        cls,
        path: str | Path,
        arm: int,
        *,
        names: tuple[str, ...] | None = None,
        position: ArrayLike | None = None,
        rate: ArrayLike = 2.0,
        step: ArrayLike = 0.35,
        watchdog: float = 0.25,
        model: ServoModel = SCS,
    ) -> Self:
        """The arm that a robot file describes (see `read_calibration`).

        Args:
            path, arm: of the file, and the arm's number on its line.
            names: of the joints that are there, from the base on; by default all in the file, `joint0` and so on.
            position: (n, 2) mechanical limits [rad], where they are narrower than what the servos can tell.
            rate, step: (n,), or one number for all; [rad/s], [rad].
            watchdog, model: as in `ArmLimits` and here.

        Raises:
            OSError, ValueError: as `read_calibration`; more names than joints, or limits that do not fit.
        """
        servos = read_calibration(path, arm)
        names = tuple(f"joint{i}" for i in range(len(servos))) if names is None else tuple(names)
        if len(names) > len(servos):
            raise ValueError(f"names: {path} has {len(servos)} joints, got {len(names)} names")
        servos, n = servos[: len(names)], len(names)
        spans = np.array([servo.span for servo in servos]) if position is None else np.asarray(position, dtype=float)
        rates, steps = (np.broadcast_to(np.asarray(value, dtype=float), n) for value in (rate, step))
        return cls(ArmLimits(names, spans, rates, steps, watchdog), servos, model)
