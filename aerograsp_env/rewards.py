"""One primitive for bounded rewards: `tolerance`, after dm_control (Tassa et al. 2018, "DeepMind Control Suite")."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def _sech(a: Array) -> Array:
    """1/cosh(a) for a ≥ 0, written so that large arguments do not overflow."""
    decay = np.exp(-a)
    return 2 * decay / (1 + decay**2)


def _gaussian(d: Array, v: float) -> Array:
    return v ** (d * d)


def _hyperbolic(d: Array, v: float) -> Array:
    return _sech(d * math.acosh(1 / v))


def _long_tail(d: Array, v: float) -> Array:
    return 1 / (1 + (1 / v - 1) * d * d)


def _tanh_squared(d: Array, v: float) -> Array:
    return _sech(d * math.atanh(math.sqrt(1 - v))) ** 2  # 1 − tanh², without its cancellation


def _linear(d: Array, v: float) -> Array:
    return np.maximum(0.0, 1 - (1 - v) * d)


def _quadratic(d: Array, v: float) -> Array:
    return np.maximum(0.0, 1 - (1 - v) * d * d)


def _cosine(d: Array, v: float) -> Array:
    return 0.5 * (1 + np.cos(np.minimum(math.acos(2 * v - 1) * d, math.pi)))


# Each maps a distance d ≥ 0, in margins, to (0, 1] or [0, 1], with 1 at d = 0 and v at d = 1.
SIGMOIDS: dict[str, Callable[[Array, float], Array]] = {
    "gaussian": _gaussian,
    "hyperbolic": _hyperbolic,
    "long_tail": _long_tail,
    "tanh_squared": _tanh_squared,
    "linear": _linear,
    "quadratic": _quadratic,
    "cosine": _cosine,
}
_REACH_ZERO = frozenset({"linear", "quadratic", "cosine"})


def tolerance(
    x: ArrayLike,
    bounds: tuple[float, float] = (0.0, 0.0),
    margin: float = 0.0,
    sigmoid: str = "gaussian",
    value_at_margin: float = 0.1,
) -> float | Array:
    """1 where `x` lies within `bounds`, falling to `value_at_margin` at a distance of `margin` outside them.

    Args:
        x: values of any shape; infinities are allowed and are far from finite bounds.
        bounds: lower and upper bound, both included, in the unit of x; either may be infinite.
        margin: distance at which the value is `value_at_margin`, in the unit of x; 0 gives a step (0 outside).
        sigmoid: one of `SIGMOIDS`: "gaussian", "hyperbolic", "long_tail" and "tanh_squared" never reach 0 (but for
            underflow); "linear", "quadratic" and "cosine" do.
        value_at_margin: in (0, 1); [0, 1) for the sigmoids that reach 0.

    Returns:
        Values in [0, 1]: a float for a scalar x, else a float64 array of x's shape.

    Raises:
        ValueError: for NaN in x, reversed or NaN bounds, a negative or infinite margin, an unknown sigmoid, or a
            `value_at_margin` out of its range.
    """
    lower, upper = bounds
    if not lower <= upper:
        raise ValueError(f"bounds: expected lower ≤ upper, got ({lower}, {upper})")
    if not (0.0 <= margin < math.inf):
        raise ValueError(f"margin: expected a finite value ≥ 0, got {margin}")
    if sigmoid not in SIGMOIDS:
        raise ValueError(f"sigmoid: expected one of {', '.join(SIGMOIDS)}, got {sigmoid!r}")
    if not (0.0 < value_at_margin < 1.0 or (value_at_margin == 0.0 and sigmoid in _REACH_ZERO)):
        interval = "[0, 1)" if sigmoid in _REACH_ZERO else "(0, 1)"
        raise ValueError(f"value_at_margin: expected a value in {interval} for {sigmoid}, got {value_at_margin}")
    x = np.asarray(x, dtype=np.float64)
    if np.isnan(x).any():
        raise ValueError("x: expected numbers, got NaN")

    inside = (lower <= x) & (x <= upper)
    if margin == 0.0:
        value = inside.astype(np.float64)
    else:
        # Inside, the distance is 0 rather than computed: inf − inf would be NaN. The cap keeps its square finite.
        distance = np.abs(np.where(inside, 0.0, x) - np.where(inside, 0.0, np.clip(x, lower, upper)))
        distance = np.minimum(distance / margin, 1e100)
        value = SIGMOIDS[sigmoid](distance, value_at_margin)
    return float(value) if value.ndim == 0 else value
