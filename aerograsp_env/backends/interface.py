"""One interface to an arm, simulated or real, that enforces what may be commanded.

The hardware abstraction of the thesis' arm library (appendix A.3) had the same aim: a program is written once and runs
on a simulated arm and on serial servos. Here the interface also carries the checks, so that no backend can skip them:
a command beyond a joint's limits, rate or largest step is refused with the joint's name, and never clamped.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from types import TracebackType
from typing import Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.backends.limits import (
    ArmLimits,
    ArmState,
    BackendError,
    CommandRefused,
    LinkLost,
    MotionDisabled,
    NotConnected,
    ServoFault,
)

Array = NDArray[np.float64]
T = TypeVar("T")

FRESH = 0.02  # [s] for which a reading may serve the commands after it


class ArmBackend(ABC):
    """An arm. A context manager: entering connects, leaving closes.

    A lost link is final: every later call raises `LinkLost` until `close` and `connect`. A fault that a servo reports
    makes the arm hold where it is and refuses commands until `reset`; it can still be read and stopped. The watchdog
    runs without a thread: it acts in `read`, `poll` and the commands, so call one of them at your control rate. Where
    the program itself dies, position servos end at their last command, at most `limits.step` from where they were.

    Args:
        limits: what may be commanded.
        enable_motion: False leaves the arm read-only: nothing that could move it is sent, not even a stop.
        clock: the time [s], which must not run backwards.
    """

    def __init__(self, limits: ArmLimits, *, enable_motion: bool, clock: Callable[[], float]) -> None:
        self.limits = limits
        self.motion_enabled = enable_motion
        self._clock = clock
        self._connected = False
        self._lost: LinkLost | None = None
        self._fault: str | None = None
        self._goal: Array | None = None  # None: the arm holds, and the next rate starts from where it is
        self._commanded_at = -math.inf
        self._state: ArmState | None = None

    # --- what a backend provides ---------------------------------------------

    @abstractmethod
    def _open(self) -> None:
        """Reach the arm."""

    @abstractmethod
    def _shut(self) -> None:
        """Let the arm go; called once after every `_open` that returned."""

    @abstractmethod
    def _measure(self) -> ArmState:
        """The state now."""

    @abstractmethod
    def _send(self, target: Array, rate: Array) -> None:
        """Make each joint go to its target [rad] at no more than its rate [rad/s]."""

    def _start(self, state: ArmState) -> None:
        """Make the arm, which is in `state`, ready to move, without moving it."""
        self._send(state.position, self.limits.rate)

    def _abandon(self, last: ArmState | None) -> str:
        """Best effort to stop an arm that no longer answers, last read in `last`; says what was done. Never raises."""
        return "nothing could be sent"

    # --- life ----------------------------------------------------------------

    @property
    def connected(self) -> bool:
        """Whether the arm is connected and its link alive."""
        return self._connected and self._lost is None

    @property
    def holding(self) -> bool:
        """Whether the arm was last told to hold where it is, rather than to go anywhere."""
        return self._goal is None

    def connect(self) -> None:
        """Reach the arm and, where motion is enabled, make it hold where it is.

        Raises:
            BackendError: the arm is connected already, or cannot be reached or made ready.
        """
        if self._connected:
            raise BackendError("connect: the arm is connected already")
        self._lost = self._fault = self._goal = self._state = None
        self._commanded_at = -math.inf
        self._open()
        self._connected = True
        try:
            state = self._reading()
            if self.motion_enabled and self._fault is None:
                self._linked(lambda: self._start(state))
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Let the arm go, whatever its state; closing a closed arm does nothing."""
        if self._connected:
            self._connected = False
            self._shut()

    def __enter__(self) -> Self:
        self.connect()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    # --- reading -------------------------------------------------------------

    def read(self) -> ArmState:
        """The state now. An error that a servo reports makes the arm hold; a command after it raises `ServoFault`.

        Raises:
            NotConnected: the arm is not connected.
            LinkLost: it does not answer.
        """
        self._require_link()
        state = self._reading()
        self.poll()
        return state

    def poll(self) -> None:
        """Run the watchdog: hold, if the last command is older than `limits.watchdog`.

        Raises:
            NotConnected, LinkLost: as `read`.
        """
        self._require_link()
        if self._goal is not None and self._clock() - self._commanded_at > self.limits.watchdog:
            self._hold(self._reading())

    # --- commands ------------------------------------------------------------

    def command_positions(self, position: ArrayLike, rate: ArrayLike | None = None) -> None:
        """Go to `position` (n,) [rad] at no more than `rate` (n,) [rad/s]; by default, at the limits' rate.

        Raises:
            CommandRefused: beyond a joint's limits, rate or step, or not n finite numbers. Nothing is sent.
            MotionDisabled: the arm is read-only.
            ServoFault: a servo reported an error and `reset` was not called since.
            NotConnected, LinkLost: as `read`.
        """
        state = self._ready()
        target = self._vector("position", position)
        speed = self.limits.rate if rate is None else self._vector("rate", rate)
        if (speed <= 0.0).any():
            raise CommandRefused(f"rate: expected positive speeds [rad/s], got {speed.tolist()}")
        self.limits.check(target, state.position, speed)
        self._command(target, speed)

    def command_rates(self, rate: ArrayLike, dt: float) -> None:
        """Move at `rate` (n,) [rad/s] for the coming `dt` [s], and then hold unless commanded again.

        Rates add up on the commanded angles, so that errors of tracking do not accumulate; after a hold they start
        from the measured ones. Servos go as fast as brings them to the target in `dt`, within their rate limit.

        Raises:
            CommandRefused: as `command_positions`, or a `dt` outside (0, limits.watchdog].
            MotionDisabled, ServoFault, NotConnected, LinkLost: as `command_positions`.
        """
        state = self._ready()
        speed = self._vector("rate", rate)
        if not 0.0 < dt <= self.limits.watchdog:
            raise CommandRefused(f"dt: expected a time in (0, {self.limits.watchdog}] s, got {dt}")
        target = (state.position if self._goal is None else self._goal) + speed * dt
        self.limits.check(target, state.position, speed)
        catch_up = np.abs(target - state.position) / dt
        self._command(target, np.where(catch_up > 0.0, np.minimum(catch_up, self.limits.rate), self.limits.rate))

    def stop(self) -> None:
        """Hold where the arm is now, also under a fault.

        Raises:
            MotionDisabled: the arm is read-only, so this cannot stop it.
            NotConnected, LinkLost: as `read`.
        """
        self._require_link()
        self._require_motion()
        self._hold(self._reading())

    def reset(self) -> None:
        """Accept commands again after a fault.

        Raises:
            ServoFault: a servo still reports an error.
            MotionDisabled, NotConnected, LinkLost: as `stop`.
        """
        self._require_link()
        self._require_motion()
        self._fault = None
        state = self._reading()
        self._require_health()
        self._linked(lambda: self._start(state))
        self._goal = None

    # --- inside --------------------------------------------------------------

    def _command(self, target: Array, rate: Array) -> None:
        self._linked(lambda: self._send(target, rate))
        self._goal, self._commanded_at = target, self._clock()

    def _hold(self, state: ArmState) -> None:
        self._linked(lambda: self._send(state.position, self.limits.rate))
        self._goal = None

    def _reading(self) -> ArmState:
        state = self._linked(self._measure)
        self._state = state
        if any(state.errors) and self._fault is None:
            reports = (
                f"joint {name!r}: {error.name or int(error)}"
                for name, error in zip(self.limits.names, state.errors, strict=True)
                if error
            )
            self._fault = "; ".join(reports)
            if self.motion_enabled:
                self._hold(state)
        return state

    def _linked(self, action: Callable[[], T]) -> T:
        """The result of an action on the arm; a lost link stops what can be stopped, and is remembered."""
        try:
            return action()
        except LinkLost as error:
            done = self._abandon(self._state) if self.motion_enabled else "the arm is read-only: nothing was sent"
            self._lost = LinkLost(f"{error}; {done}")
            raise self._lost from error

    def _ready(self) -> ArmState:
        self._require_link()
        self._require_motion()
        self._require_health()
        self.poll()
        state = self._state
        if state is None or self._clock() - state.stamp > FRESH:
            state = self._reading()
        self._require_health()
        return state

    def _require_link(self) -> None:
        if self._lost is not None and self._connected:
            raise LinkLost(str(self._lost))
        if not self._connected:
            raise NotConnected("the arm is not connected: call connect() or use it in a with statement")

    def _require_motion(self) -> None:
        if not self.motion_enabled:
            raise MotionDisabled("the arm is read-only: open it with enable_motion=True to command it")

    def _require_health(self) -> None:
        if self._fault is not None:
            raise ServoFault(f"{self._fault}; the arm holds until reset() is called")

    def _vector(self, name: str, value: ArrayLike) -> Array:
        try:
            vector = np.array(value, dtype=float)
        except (TypeError, ValueError) as error:
            raise CommandRefused(f"{name}: expected {self.limits.n} numbers, got {value!r}") from error
        if vector.shape != (self.limits.n,) or not np.isfinite(vector).all():
            raise CommandRefused(f"{name}: expected {self.limits.n} finite numbers, got {value!r}")
        return vector
