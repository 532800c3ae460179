"""What may be commanded of an arm, what it reports, and what can go wrong."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntFlag
from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from aerograsp_env.sim.arms.description import ArmConfig

Array = NDArray[np.float64]

ROUNDING = 1e-9  # [rad], [rad/s] by which a command may be beyond a limit


class BackendError(RuntimeError):
    """An arm could not do what it was asked."""


class NotConnected(BackendError):
    """The arm is not connected."""


class MotionDisabled(BackendError):
    """The arm was opened without `enable_motion=True`: it can be read, not commanded."""


class CommandRefused(BackendError, ValueError):
    """A command beyond a limit; nothing of it was sent."""


class ServoFault(BackendError):
    """A servo reported an error; the arm holds until `reset`."""


class LinkLost(BackendError):
    """The arm no longer answers; it must be closed and connected again."""


class ServoError(IntFlag):
    """What a servo reports of itself, by the bits of the status packet of Feetech's servos."""

    VOLTAGE = 1
    SENSOR = 2
    TEMPERATURE = 4
    CURRENT = 8
    OVERLOAD = 32


class ArmState(NamedTuple):
    """What the servos report; what a servo does not measure is NaN."""

    stamp: float  # [s] on the backend's clock
    position: Array  # (n,) [rad]
    velocity: Array  # (n,) [rad/s]
    load: Array  # (n,) share of the largest torque, positive where it drives the joint forward
    temperature: Array  # (n,) [°C]
    voltage: Array  # (n,) [V]
    errors: tuple[ServoError, ...]  # of each servo


@dataclass(frozen=True, eq=False)
class ArmLimits:
    """What may be commanded of each joint. Compared by identity.

    Args:
        names: of the n joints, in the order of every vector.
        position: (n, 2) lowest and highest angle [rad].
        rate: (n,) highest speed [rad/s].
        step: (n,) largest distance of a commanded angle from the measured one [rad]. It also bounds how far an arm
            moves on when its link is lost, because servos finish their last command.
        watchdog: time without a command after which the arm is told to hold where it is [s].

    Raises:
        ValueError: wrong shapes, empty intervals, repeated names, or anything not positive and finite.
    """

    names: tuple[str, ...]
    position: Array
    rate: Array
    step: Array
    watchdog: float = 0.25

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", tuple(self.names))
        n = len(self.names)
        if n == 0 or len(set(self.names)) != n:
            raise ValueError(f"names: expected one name of its own for every joint, got {self.names}")
        for name, shape in (("position", (n, 2)), ("rate", (n,)), ("step", (n,))):
            value = np.array(getattr(self, name), dtype=float)
            if value.shape != shape or not np.isfinite(value).all():
                raise ValueError(f"{name}: expected finite numbers of shape {shape}, got {getattr(self, name)!r}")
            if name != "position" and (value <= 0.0).any():
                raise ValueError(f"{name}: expected positive values, got {value}")
            value.flags.writeable = False
            object.__setattr__(self, name, value)
        if (self.position[:, 0] >= self.position[:, 1]).any():
            raise ValueError(f"position: expected lower limits below the upper ones, got {self.position.tolist()}")
        if not 0.0 < self.watchdog < math.inf:
            raise ValueError(f"watchdog: expected a positive time [s], got {self.watchdog}")

    @classmethod
    def of(cls, arm: ArmConfig, *, rate: ArrayLike = 2.0, step: ArrayLike = 0.35, watchdog: float = 0.25) -> Self:
        """The limits of a described arm. `rate` [rad/s] and `step` [rad] are (n,), or one number for all joints.

        Raises:
            ValueError: a rate above what a servo can do without load, or as the class.
        """
        rates, steps = (np.broadcast_to(np.asarray(value, dtype=float), arm.n) for value in (rate, step))
        for joint, value in zip(arm.joints, rates, strict=True):
            if value > joint.rate_limit:
                raise ValueError(f"rate: joint {joint.name!r} reaches {joint.rate_limit} rad/s, got {value}")
        return cls(tuple(joint.name for joint in arm.joints), arm.limits, rates, steps, watchdog)

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.names)

    def check(self, target: Array, measured: Array, rate: Array) -> None:
        """Refuse a command to go from `measured` to `target` [rad] at no more than `rate` [rad/s], all (n,).

        A joint that is already beyond a limit may be commanded back, and no further out.

        Raises:
            CommandRefused: naming the first joint that would break a limit.
        """
        lower, upper = self.position.T
        for i, name in enumerate(self.names):
            if abs(rate[i]) > self.rate[i] + ROUNDING:
                raise CommandRefused(f"joint {name!r}: {rate[i]:.4g} rad/s is above its {self.rate[i]:.4g} rad/s")
            if not min(lower[i], measured[i]) - ROUNDING <= target[i] <= max(upper[i], measured[i]) + ROUNDING:
                raise CommandRefused(
                    f"joint {name!r}: {target[i]:.4g} rad is outside its limits [{lower[i]:.4g}, {upper[i]:.4g}] rad"
                )
            if abs(target[i] - measured[i]) > self.step[i] + ROUNDING:
                raise CommandRefused(
                    f"joint {name!r}: {target[i]:.4g} rad is {abs(target[i] - measured[i]):.4g} rad from where it "
                    f"is, more than the {self.step[i]:.4g} rad of one command"
                )
