"""The model every filter here is built from, the Gaussian belief, and the constant-velocity model."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

# Relative to the largest entry: what rounding may do to a covariance, above which it is a mistake.
_COVARIANCE_TOLERANCE = 1e-8


class Innovation(NamedTuple):
    """What the last update saw, accepted or not."""

    residual: Array  # z − predicted measurement, (m,)
    covariance: Array  # predicted covariance of the residual, (m, m)
    distance: float  # squared Mahalanobis distance of the residual (chi-square of m degrees when consistent)
    accepted: bool  # False: beyond the gate, and the belief is what it was


@dataclass(frozen=True, eq=False)
class Belief:
    """A Gaussian belief; read-only arrays.

    Raises:
        ValueError: shapes disagree, a value is not finite, or the covariance is not symmetric and PSD.
    """

    mean: Array  # (n,)
    covariance: Array  # (n, n)
    innovation: Innovation | None = None  # of the update this belief came from

    def __post_init__(self) -> None:
        mean = vector(self.mean, "mean")
        object.__setattr__(self, "mean", read_only(mean))
        object.__setattr__(self, "covariance", read_only(covariance(self.covariance, "covariance", mean.size)))


@dataclass(frozen=True, eq=False)
class Model:
    """A nonlinear state-space model with additive Gaussian noise: x' = f(x, u, dt) + q, z = h(x) + r.

    `transition` and `measurement` work on the last axis and broadcast over leading ones, so that a particle filter can
    move all its particles in one call: write `x[..., 0]`, not `x[0]`.

    Args:
        transition: f(x, u, dt) → x', (..., n) → (..., n). `u` is what `predict` was given (None if nothing).
        measurement: h(x) → z, (..., n) → (..., m).
        process_noise: Q(dt) → (n, n), the covariance added by one step of dt seconds; PSD.
        measurement_noise: R, (m, m), symmetric and positive definite.
        transition_jacobian: F(x, u, dt) → (n, n); central differences of `transition` when None.
        measurement_jacobian: H(x) → (m, n); central differences of `measurement` when None.
        residual: (z, predicted) → their difference, (..., m); give one that wraps where measurements are angles.

    Raises:
        ValueError: R is not a symmetric positive definite matrix.
    """

    transition: Callable[[Array, Any, float], Array]
    measurement: Callable[[Array], Array]
    process_noise: Callable[[float], Array]
    measurement_noise: Array
    transition_jacobian: Callable[[Array, Any, float], Array] | None = None
    measurement_jacobian: Callable[[Array], Array] | None = None
    residual: Callable[[Array, Array], Array] = np.subtract

    def __post_init__(self) -> None:
        noise = covariance(self.measurement_noise, "measurement_noise", None)
        if np.linalg.eigvalsh(noise)[0] <= 0.0:
            raise ValueError(f"measurement_noise: expected a positive definite matrix, got {noise.tolist()}")
        object.__setattr__(self, "measurement_noise", read_only(noise))

    @property
    def measurement_size(self) -> int:
        return self.measurement_noise.shape[0]

    # What follows is the model as the filters call it: every answer of the user's functions is checked.

    def f(self, x: Array, u: Any, dt: float) -> Array:
        return _checked(self.transition(x, u, dt), "transition", x.shape)

    def h(self, x: Array) -> Array:
        return _checked(self.measurement(x), "measurement", (*x.shape[:-1], self.measurement_size))

    def Q(self, dt: float, size: int) -> Array:
        return covariance(self.process_noise(dt), "process_noise", size)

    def F(self, x: Array, u: Any, dt: float) -> Array:
        if self.transition_jacobian is None:
            return numeric_jacobian(lambda at: self.f(at, u, dt), x)
        return _checked(self.transition_jacobian(x, u, dt), "transition_jacobian", (x.size, x.size))

    def H(self, x: Array) -> Array:
        if self.measurement_jacobian is None:
            return numeric_jacobian(self.h, x, difference=self.residual)
        return _checked(self.measurement_jacobian(x), "measurement_jacobian", (self.measurement_size, x.size))


def numeric_jacobian(
    function: Callable[[Array], Array], x: ArrayLike, difference: Callable[[Array, Array], Array] = np.subtract
) -> Array:
    """d function / d x at x (n,) by central differences, (m, n); error of order 1e-10 of the function's scale.

    `difference` compares two values of the function (one that wraps, for angles).
    """
    x = vector(x, "x")
    steps = np.cbrt(np.finfo(float).eps) * np.maximum(1.0, np.abs(x))  # balances truncation and rounding
    columns = []
    for i, step in enumerate(steps):
        above, below = x.copy(), x.copy()
        above[i] += step
        below[i] -= step
        # Divide by the step that was taken after rounding, not by the one asked for.
        columns.append(difference(function(above), function(below)) / (above[i] - below[i]))
    return np.array(columns, dtype=np.float64).T


def constant_velocity_model(
    acceleration_noise: ArrayLike, measurement_noise: ArrayLike, axes: int = 3, measure_velocity: bool = False
) -> Model:
    """A point whose acceleration is white noise, with its position measured (Bar-Shalom et al. 2001, section 6.2.2).

    State (2·axes,): position [m], then velocity [m/s]. `u`, when given, is a known acceleration (axes,) [m/s²], held
    over the step. Q(dt) is that of continuous white noise, so two half steps equal one.

    Args:
        acceleration_noise: square root of the acceleration's spectral density [m/s² / √Hz], scalar or (axes,).
        measurement_noise: standard deviation [m, then m/s], scalar or one a measured quantity.
        axes: number of space dimensions.
        measure_velocity: True where the velocity is measured too: z = (position, velocity).

    Raises:
        ValueError: a size or a noise that cannot be.
    """
    if axes < 1:
        raise ValueError(f"axes: expected at least 1, got {axes}")
    measured = 2 * axes if measure_velocity else axes
    density = _deviations(acceleration_noise, "acceleration_noise", axes) ** 2
    variance = _deviations(measurement_noise, "measurement_noise", measured) ** 2
    identity = np.eye(axes)
    H = np.eye(measured, 2 * axes)

    def F(x: Array, u: Any, dt: float) -> Array:
        return np.block([[identity, dt * identity], [0.0 * identity, identity]])

    def f(x: Array, u: Any, dt: float) -> Array:
        acceleration = np.zeros(axes) if u is None else vector(u, "u", axes)
        position, velocity = x[..., :axes], x[..., axes:]
        moved = position + dt * velocity + 0.5 * dt**2 * acceleration
        return np.concatenate([moved, velocity + dt * acceleration], axis=-1)

    def Q(dt: float) -> Array:
        return np.kron(np.array([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]]), np.diag(density))

    return Model(f, lambda x: x[..., :measured], Q, np.diag(variance), F, lambda x: H)


def vector(value: ArrayLike, name: str, size: int | None = None) -> Array:
    """A finite float64 copy of shape (size,), or a ValueError that names it."""
    array = np.array(value, dtype=np.float64)
    if array.ndim != 1 or (size is not None and array.size != size):
        raise ValueError(f"{name}: expected shape ({'n' if size is None else size},), got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name}: expected finite numbers, got {array.tolist()}")
    return array


def covariance(value: ArrayLike, name: str, size: int | None) -> Array:
    """A float64 copy of a symmetric PSD (size, size) matrix, exactly symmetric, or a ValueError that names it."""
    array = np.array(value, dtype=np.float64)
    expected = array.shape[:1] * 2 if size is None else (size, size)
    if array.ndim != 2 or array.shape != expected:
        raise ValueError(f"{name}: expected a {'square' if size is None else expected} matrix, got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name}: expected finite numbers, got {array.tolist()}")
    slack = _COVARIANCE_TOLERANCE * max(np.abs(array).max(initial=0.0), np.finfo(float).tiny)
    if np.abs(array - array.T).max(initial=0.0) > slack:
        raise ValueError(f"{name}: expected a symmetric matrix, got {array.tolist()}")
    array = 0.5 * (array + array.T)
    smallest = np.linalg.eigvalsh(array)[0]
    if smallest < -slack:
        raise ValueError(f"{name}: expected a positive semi-definite matrix, got the eigenvalue {smallest:.3g}")
    return array


def square_root(matrix: Array) -> Array:
    """U with UᵀU = matrix, for any PSD matrix: by eigenvalues, so that singular ones (a known start) work too."""
    values, vectors = np.linalg.eigh(matrix)
    return np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T


def read_only(array: Array) -> Array:
    array.flags.writeable = False
    return array


def _checked(value: ArrayLike, name: str, shape: tuple[int, ...]) -> Array:
    array = np.asarray(value, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(
            f"{name}: expected it to return shape {shape} (functions act on the last axis), got {array.shape}"
        )
    if not np.isfinite(array).all():
        raise ValueError(f"{name}: expected it to return finite numbers")
    return array


def _deviations(value: ArrayLike, name: str, size: int) -> Array:
    array = np.asarray(value, dtype=np.float64)
    if array.shape not in ((), (size,)):
        raise ValueError(f"{name}: expected a scalar or shape ({size},), got {array.shape}")
    return vector(np.broadcast_to(array, (size,)), name)
