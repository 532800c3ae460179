"""A batched PID controller with anti-windup, output saturation and a filtered derivative."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


class PIDState(NamedTuple):
    """What a `PID` remembers between steps; every field has the shape of the error."""

    integral: Array  # time integral of the error, clamped to ± integral_limit [error · s]
    previous_error: Array  # the error of the last step
    derivative: Array  # the filtered derivative of the error [error / s]
    started: NDArray[np.bool_]  # False until a first error was seen: there is no derivative before that


@dataclass(frozen=True, eq=False)
class PID:
    """u = clip(kp·e + ki·∫e dt + kd·ė, ± output_limit), element by element.

    Two guards stand against wind-up, as thesis section 5.4.2 asks: the integral state is clamped (Table 5.2's
    "anti-windup" column, in error · s), and a saturated output stops integrating in the direction that pushes it
    further out (conditional integration, Åström & Hägglund, Advanced PID Control, 2006, section 3.5). The derivative
    passes a first-order low-pass and is zero at the first step, so a start never kicks.

    Every parameter is a scalar or an array that broadcasts against the error, (n,) for n axes under any leading batch.

    Args:
        kp: proportional gain [u / error].
        ki: integral gain [u / (error · s)].
        kd: derivative gain [u · s / error].
        integral_limit: bound on |∫e dt| [error · s], ≥ 0; inf for none.
        output_limit: bound on |u|, > 0; inf for none.
        derivative_time_constant: of the derivative's low-pass [s], ≥ 0; 0 means no filter.

    Raises:
        ValueError: a parameter is NaN, negative or infinite where it may not be, or shapes do not broadcast.
    """

    kp: ArrayLike
    ki: ArrayLike
    kd: ArrayLike
    integral_limit: ArrayLike
    output_limit: ArrayLike
    derivative_time_constant: ArrayLike = 0.0

    def __post_init__(self) -> None:
        for name in ("kp", "ki", "kd", "integral_limit", "output_limit", "derivative_time_constant"):
            value = _floats(getattr(self, name), name)
            # Limits may be infinite, gains and times may not; gains may have either sign.
            if np.isnan(value).any() or (not name.endswith("limit") and np.isinf(value).any()):
                raise ValueError(f"{name}: expected finite numbers, got {value.tolist()}")
            if name not in ("kp", "ki", "kd") and (
                (value < 0).any() or (name == "output_limit" and (value == 0).any())
            ):
                expected = "positive" if name == "output_limit" else "non-negative"
                raise ValueError(f"{name}: expected {expected} numbers, got {value.tolist()}")
            value.flags.writeable = False
            object.__setattr__(self, name, value)
        try:
            np.broadcast_shapes(*(np.shape(p) for p in self._parameters))
        except ValueError:
            shapes = [np.shape(p) for p in self._parameters]
            raise ValueError(f"PID parameters: expected shapes that broadcast together, got {shapes}") from None

    @property
    def _parameters(self) -> tuple[ArrayLike, ...]:
        return (self.kp, self.ki, self.kd, self.integral_limit, self.output_limit, self.derivative_time_constant)

    def initial_state(self, shape: int | tuple[int, ...] = ()) -> PIDState:
        """The state before the first step, for errors of `shape` (broadcast with the parameters' own shape)."""
        shape = self._full_shape((shape,) if isinstance(shape, int) else tuple(shape), "shape")
        return PIDState(np.zeros(shape), np.zeros(shape), np.zeros(shape), np.zeros(shape, bool))

    def step(self, error: ArrayLike, dt: float, state: PIDState | None = None) -> tuple[Array, PIDState]:
        """One control step.

        Args:
            error: set-point − measurement, (..., n) or a scalar.
            dt: time since the last step [s], > 0.
            state: what the last step returned; None starts afresh.

        Returns:
            (u, state): the output, shaped as the error, within ± output_limit; and the next state (new arrays).

        Raises:
            ValueError: the error is not finite, dt is not a positive number, or shapes do not agree.
        """
        e = _floats(error, "error")
        if not np.isfinite(e).all():
            raise ValueError(f"error: expected finite numbers, got {e.tolist()}")
        dt = float(dt)
        if not (0.0 < dt < np.inf):
            raise ValueError(f"dt: expected a positive number of seconds, got {dt}")
        shape = self._full_shape(e.shape, "error")
        e = np.broadcast_to(e, shape)
        if state is None:
            state = self.initial_state(shape)
        elif state.integral.shape != shape:
            raise ValueError(f"state: expected arrays of the error's shape {shape}, got {state.integral.shape}")

        kp, ki, kd, integral_limit, output_limit, time_constant = (np.asarray(p) for p in self._parameters)
        blend = dt / (time_constant + dt)  # backward Euler of d' = (raw − d) / τ: stable for every dt
        raw = (e - state.previous_error) / dt
        derivative = np.where(state.started, state.derivative + blend * (raw - state.derivative), 0.0)

        integral = np.clip(state.integral + e * dt, -integral_limit, integral_limit)
        wanted = kp * e + ki * integral + kd * derivative
        pushing = (np.abs(wanted) > output_limit) & (wanted * (ki * e) > 0.0)
        integral = np.where(pushing, state.integral, integral)
        u = np.clip(kp * e + ki * integral + kd * derivative, -output_limit, output_limit)
        return u, PIDState(integral, np.array(e), derivative, np.ones(shape, bool))

    def reset(self, state: PIDState, mask: ArrayLike) -> PIDState:
        """The state with the items under `mask` started afresh.

        Args:
            state: any state of this controller.
            mask: bool, over the state's leading axes: (N,) restarts rows of an (N, n) state; () all or nothing.

        Raises:
            ValueError: the mask is not boolean or does not match the leading axes.
        """
        mask = np.asarray(mask)
        shape = state.integral.shape
        if mask.dtype != np.bool_ or mask.shape != shape[: mask.ndim]:
            raise ValueError(
                f"mask: expected booleans over the leading axes of {shape}, got {mask.dtype} of shape {mask.shape}"
            )
        keep = ~mask.reshape(mask.shape + (1,) * (len(shape) - mask.ndim))
        return PIDState(
            state.integral * keep, state.previous_error * keep, state.derivative * keep, state.started & keep
        )

    def _full_shape(self, shape: tuple[int, ...], name: str) -> tuple[int, ...]:
        own = np.broadcast_shapes(*(np.shape(p) for p in self._parameters))
        try:
            return np.broadcast_shapes(shape, own)
        except ValueError:
            raise ValueError(f"{name}: expected a shape that broadcasts with the gains' {own}, got {shape}") from None


def _floats(value: ArrayLike, name: str) -> Array:
    try:
        return np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{name}: expected numbers, got {value!r}") from None
