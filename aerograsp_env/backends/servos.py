"""Position servos in plain numpy: what a simulated arm, or a simulated bus of servos, moves with.

Each joint is on its own: a servo with a rate limit on its reference, a stiff and damped position loop, a motor whose
torque falls linearly from stall to the no-load speed, and a constant inertia. Coupling between joints, and gravity, are
torques that the caller passes in. The joints have no end stops.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.backends.limits import ServoError

Array = NDArray[np.float64]

TICK = 0.001  # [s] of the integration
OVERLOAD_SHARE = 0.98  # of the torque limit counts as overload
NEUTRAL = {"temperature": 25.0, "voltage": 7.4}  # [°C], [V]: two lithium cells


@dataclass(frozen=True, eq=False)
class ServoParameters:
    """n servos; every field is (n,) or one number for all. The defaults are a 25 kg·cm serial servo.

    Raises:
        ValueError: naming a field that is not positive and finite, or of another length than the rest.
    """

    stiffness: ArrayLike = 30.0  # [N m/rad]
    damping: ArrayLike = 1.2  # [N m s/rad]
    torque_limit: ArrayLike = 2.45  # [N m] at stall
    rate_limit: ArrayLike = 4.5  # [rad/s] with no load
    inertia: ArrayLike = 0.005  # [kg m²] that a joint moves
    quantum: ArrayLike = 2.0 * math.pi / 4096  # [rad] of the encoder
    overload_time: ArrayLike = 1.0  # [s] at the torque limit before protection
    protective_share: ArrayLike = 0.3  # of the torque limit that protection leaves

    def __post_init__(self) -> None:
        values = {f.name: np.atleast_1d(np.array(getattr(self, f.name), dtype=float)) for f in fields(self)}
        n = max(value.size for value in values.values())
        for name, value in values.items():
            if value.shape not in ((1,), (n,)) or not (np.isfinite(value) & (value > 0.0)).all():
                raise ValueError(f"{name}: expected {n} positive numbers, or one, got {getattr(self, name)!r}")
            object.__setattr__(self, name, value)


@dataclass(eq=False)
class SimulatedServos:
    """n servos and the joints they move. Set `goal` [rad], `speed` [rad/s] and `enabled`, then `advance`.

    Held at the torque limit for `overload_time`, a servo protects itself: it keeps `protective_share` of its torque
    and reports an overload, until its command asks for less than that.

    Args:
        position: (n,) where the joints start [rad].
        parameters: of the servos.
    """

    position: Array
    parameters: ServoParameters = field(default_factory=ServoParameters)

    def __post_init__(self) -> None:
        self.position = np.array(self.position, dtype=float)
        n = self.position.size
        if self.position.shape != (n,) or n == 0 or not np.isfinite(self.position).all():
            raise ValueError(f"position: expected n finite angles [rad], got {self.position!r}")
        parts = {f.name: getattr(self.parameters, f.name) for f in fields(self.parameters)}
        if any(value.size not in (1, n) for value in parts.values()):
            raise ValueError(f"parameters: expected those of {n} servos")
        self._p = {name: np.broadcast_to(value, n).copy() for name, value in parts.items()}
        self.time = 0.0  # [s]
        self.velocity = np.zeros(n)
        self.torque = np.zeros(n)
        self.goal = self.position.copy()
        self.reference = self.position.copy()
        self.speed = self._p["rate_limit"].copy()
        self.enabled = np.ones(n, dtype=bool)
        self.temperature = np.full(n, NEUTRAL["temperature"])
        self.voltage = np.full(n, NEUTRAL["voltage"])
        self.faults = [ServoError(0)] * n  # reported on top of overload; for tests of what happens then
        self._protected = np.zeros(n, dtype=bool)
        self._overloaded_for = np.zeros(n)
        self._debt = 0.0  # [s] of time asked for and not yet a whole tick

    @property
    def torque_limit(self) -> Array:
        """(n,) of now [N m]: less under protection."""
        p = self._p
        return p["torque_limit"] * np.where(self._protected, p["protective_share"], 1.0)

    @property
    def measured_position(self) -> Array:
        """(n,) as the encoders report it [rad]."""
        return np.round(self.position / self._p["quantum"]) * self._p["quantum"]

    @property
    def load(self) -> Array:
        """(n,) torque as a share of the unprotected limit."""
        return self.torque / self._p["torque_limit"]

    @property
    def errors(self) -> tuple[ServoError, ...]:
        """What each servo reports of itself."""
        protected = (ServoError.OVERLOAD if on else ServoError(0) for on in self._protected)
        return tuple(fault | overload for fault, overload in zip(self.faults, protected, strict=True))

    def advance(self, dt: float, external: ArrayLike = 0.0) -> None:
        """Move on by `dt` [s], in ticks of 1 ms, under `external` torques (n,) on the joints [N m].

        Raises:
            ValueError: a dt that is negative or not finite, or torques of another shape.
        """
        if not 0.0 <= dt < math.inf:
            raise ValueError(f"dt: expected a time [s] of 0 or more, got {dt}")
        load = np.asarray(external, dtype=float)
        if load.shape not in ((), self.position.shape) or not np.isfinite(load).all():
            raise ValueError(f"external: expected {self.position.size} finite torques [N m], got {external!r}")
        self._debt += dt
        ticks = round(self._debt / TICK)
        self._debt -= ticks * TICK
        for _ in range(max(ticks, 0)):
            self._tick(load)

    def _tick(self, external: Array) -> None:
        p, h = self._p, TICK
        reach = np.minimum(self.speed, p["rate_limit"]) * h
        self.reference += np.clip(self.goal - self.reference, -reach, reach)
        # A servo that is off is pushed about; it must not jump back when it is switched on.
        self.reference = np.where(self.enabled, self.reference, self.position)
        # Implicit in the new velocity, so that stiff servos on light joints are stable.
        kp, kv, inertia = p["stiffness"], p["damping"], p["inertia"]
        error, momentum = self.reference - self.position, inertia * self.velocity + h * external
        velocity = (momentum + h * kp * error) / (inertia + h * kv + h * h * kp)
        torque = kp * (error - h * velocity) - kv * velocity
        # A motor's torque falls by its speed: none is left at the no-load speed, and beyond it the motor brakes.
        drag = np.where(self.enabled, p["torque_limit"] / p["rate_limit"], 0.0)
        limit = np.where(self.enabled, self.torque_limit, 0.0)
        drive = np.clip(torque + drag * velocity, -limit, limit)
        saturated = drive != torque + drag * velocity
        self.velocity = np.where(saturated, (momentum + h * drive) / (inertia + h * drag), velocity)
        self.torque = np.where(saturated, drive - drag * self.velocity, torque)
        self.position = self.position + h * self.velocity
        self.time += h
        at_limit = np.abs(self.torque) >= OVERLOAD_SHARE * p["torque_limit"]
        self._overloaded_for = np.where(at_limit & self.enabled, self._overloaded_for + h, 0.0)
        asked = kp * np.abs(self.goal - self.position)
        eased = asked < p["protective_share"] * p["torque_limit"]
        self._protected = (self._overloaded_for > p["overload_time"]) | (self._protected & ~eased)
