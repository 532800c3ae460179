"""Covariance functions of a Gaussian process f and of its gradient ∂f.

A kernel gives three blocks between points x (N, D) and y (M, D), from which every Gram matrix with normals is built:

- ``value``     cov(f(x), f(y)) = k                        (N, M)
- ``gradient``  cov(f(x), ∂f(y)/∂y_j) = ∂k/∂y_j            (N, M, D); by symmetry cov(∂f(x), f(y)) is its negative
  for the stationary kernels, all of those that are differentiable here
- ``hessian``   cov(∂f(x)/∂x_i, ∂f(y)/∂y_j) = ∂²k/∂x_i∂y_j (N, M, D, D)

and the diagonals ``diagonal`` (N,) and ``gradient_diagonal`` (N, D): the prior variances of f and of ∂f.

Sources: Rasmussen & Williams 2006, chapters 4 and 9.4; Williams & Fitzgibbon 2007, "Gaussian process implicit
surfaces" (thin plate).
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

Array = NDArray[np.float64]


def _require_positive(**values: float) -> None:
    for name, value in values.items():
        if not 0.0 < value < np.inf:
            raise ValueError(f"{name}: expected a positive finite number, got {value}")


@dataclass(frozen=True)
class Kernel(ABC):
    """What every kernel can do. Those with ``differentiable = False`` give values only."""

    differentiable: ClassVar[bool] = True
    dimension: ClassVar[int | None] = None  # of the points; None takes any

    @abstractmethod
    def value(self, x: Array, y: Array) -> Array:
        """cov(f(x), f(y)) (N, M) for x (N, D), y (M, D)."""

    @abstractmethod
    def diagonal(self, x: Array) -> Array:
        """var f(x) (N,)."""

    def gradient(self, x: Array, y: Array) -> Array:
        """cov(f(x), ∂f(y)) (N, M, D)."""
        raise ValueError(f"kernel: expected a differentiable one for gradients, got {self}")

    def hessian(self, x: Array, y: Array) -> Array:
        """cov(∂f(x), ∂f(y)) (N, M, D, D), the first of the last two axes belonging to x."""
        raise ValueError(f"kernel: expected a differentiable one for gradients, got {self}")

    def gradient_diagonal(self, x: Array) -> Array:
        """var ∂f(x)/∂x_i (N, D)."""
        raise ValueError(f"kernel: expected a differentiable one for gradients, got {self}")

    def weighted(
        self, x: Array, y: Array, values: Array, slopes: Array | None, gradient: bool
    ) -> tuple[Array, Array | None]:
        """The function Σ_j cov(f(x), f(y_j)) values_j + cov(f(x), ∂f(y_j))·slopes_j (N,), and its gradient (N, D).

        Weights are (M,) and (M, D) or None; the gradient is None unless asked for.
        """
        mean = self.value(x, y) @ values
        slope = np.einsum("mnd,m->nd", self.gradient(y, x), values) if gradient else None
        if slopes is not None:
            mean += np.einsum("nmd,md->n", self.gradient(x, y), slopes)
            if slope is not None:
                slope += np.einsum("nmde,me->nd", self.hessian(x, y), slopes)
        return mean, slope


class _Isotropic(Kernel):
    """k = φ(d) with d = ‖x − y‖: all blocks follow from φ, a = φ'/d and b = (φ'' − φ'/d)/d² = a'/d."""

    @abstractmethod
    def _profile(self, d: Array) -> Array:
        """φ(d)."""

    @abstractmethod
    def _first(self, d: Array) -> Array:
        """a(d) = φ'(d)/d, with its limit at 0."""

    @abstractmethod
    def _second(self, d: Array) -> Array:
        """b(d) = a'(d)/d; any finite value at 0 where b d² vanishes there."""

    def value(self, x: Array, y: Array) -> Array:
        return self._profile(cdist(x, y))

    def gradient(self, x: Array, y: Array) -> Array:
        return -self._first(cdist(x, y))[..., None] * (x[:, None] - y)

    def hessian(self, x: Array, y: Array) -> Array:
        d, difference = cdist(x, y), x[:, None] - y
        blocks = -(self._second(d)[..., None] * difference)[..., :, None] * difference[..., None, :]
        axes = np.arange(x.shape[1])
        blocks[..., axes, axes] -= self._first(d)[..., None]
        return blocks

    def weighted(
        self, x: Array, y: Array, values: Array, slopes: Array | None, gradient: bool
    ) -> tuple[Array, Array | None]:
        # With s = (x − y)·slope the sums over D factor into products of (N, M) matrices: no block is ever built.
        centre = y.mean(axis=0)  # about which x·w − y·w cancels least
        x, y = x - centre, y - centre
        d = cdist(x, y)
        mean = self._profile(d) @ values
        if slopes is None and not gradient:
            return mean, None
        first = self._first(d)
        inner = None if slopes is None else x @ slopes.T - np.einsum("md,md->m", y, slopes)
        if inner is not None:
            mean -= np.einsum("nm,nm->n", first, inner)
        if not gradient:
            return mean, None
        along = first * values
        if inner is not None:
            along -= self._second(d) * inner
        slope = x * along.sum(axis=1, keepdims=True) - along @ y
        return mean, slope if slopes is None else slope - first @ slopes

    def diagonal(self, x: Array) -> Array:
        return np.full(len(x), self._profile(np.zeros(1))[0])

    def gradient_diagonal(self, x: Array) -> Array:
        return np.full(x.shape, -self._first(np.zeros(1))[0])


@dataclass(frozen=True)
class SquaredExponential(_Isotropic):
    """k = σ² exp(−d²/2l²). Rasmussen & Williams 2006, eq. 4.9.

    Args:
        length_scale: l [m].
        variance: σ², of f.

    Raises:
        ValueError: one of them is not positive and finite.
    """

    length_scale: float
    variance: float = 1.0

    def __post_init__(self) -> None:
        _require_positive(length_scale=self.length_scale, variance=self.variance)

    def _profile(self, d: Array) -> Array:
        return self.variance * np.exp(-0.5 * (d / self.length_scale) ** 2)

    def _first(self, d: Array) -> Array:
        return -self._profile(d) / self.length_scale**2

    def _second(self, d: Array) -> Array:
        return self._profile(d) / self.length_scale**4


@dataclass(frozen=True)
class Matern52(_Isotropic):
    """k = σ² (1 + q + q²/3) exp(−q), q = √5 d/l. Rasmussen & Williams 2006, eq. 4.17.

    Args:
        length_scale: l [m].
        variance: σ², of f.

    Raises:
        ValueError: one of them is not positive and finite.
    """

    length_scale: float
    variance: float = 1.0

    def __post_init__(self) -> None:
        _require_positive(length_scale=self.length_scale, variance=self.variance)

    def _profile(self, d: Array) -> Array:
        q = np.sqrt(5.0) / self.length_scale * d
        return self.variance * (1.0 + q + q**2 / 3.0) * np.exp(-q)

    def _first(self, d: Array) -> Array:
        q = np.sqrt(5.0) / self.length_scale * d
        return -5.0 / 3.0 * self.variance / self.length_scale**2 * (1.0 + q) * np.exp(-q)

    def _second(self, d: Array) -> Array:
        return 25.0 / 3.0 * self.variance / self.length_scale**4 * np.exp(-np.sqrt(5.0) / self.length_scale * d)


@dataclass(frozen=True)
class ThinPlate(_Isotropic):
    """k = σ² (2d³ − 3Rd² + R³), for d ≤ R only. Williams & Fitzgibbon 2007, section 3 (three dimensions).

    Args:
        radius: R [m], no less than the largest distance among data and queries: beyond it variances turn negative.
        variance: σ², the factor in front; var f is σ²R³.

    Raises:
        ValueError: one of them is not positive and finite; from every block: two points farther apart than R.
    """

    radius: float
    variance: float = 1.0

    def __post_init__(self) -> None:
        _require_positive(radius=self.radius, variance=self.variance)

    def _check(self, d: Array) -> None:
        if d.size and (largest := d.max()) > self.radius:
            raise ValueError(f"radius: expected at least the largest distance, {largest:g}, got {self.radius:g}")

    def _profile(self, d: Array) -> Array:
        self._check(d)
        return self.variance * (d**2 * (2.0 * d - 3.0 * self.radius) + self.radius**3)

    def _first(self, d: Array) -> Array:
        self._check(d)
        return 6.0 * self.variance * (d - self.radius)

    def _second(self, d: Array) -> Array:
        self._check(d)
        # b = 6σ²/d, but b d² → 0: its value at 0 multiplies zeros.
        return np.divide(6.0 * self.variance, d, out=np.zeros_like(d), where=d > 0.0)


@dataclass(frozen=True)
class Periodic(Kernel):
    """k = σ² exp(−2 sin²((x − y)/2)/l²) on a line, of period 2π. Rasmussen & Williams 2006, eq. 4.31.

    Args:
        length_scale: l, without a unit: the argument is an angle [rad].
        variance: σ², of f.

    Raises:
        ValueError: one of them is not positive and finite.
    """

    length_scale: float
    variance: float = 1.0
    dimension: ClassVar[int | None] = 1

    def __post_init__(self) -> None:
        _require_positive(length_scale=self.length_scale, variance=self.variance)

    def value(self, x: Array, y: Array) -> Array:
        half = np.sin(0.5 * (x - y.T))
        return self.variance * np.exp(-2.0 * (half / self.length_scale) ** 2)

    def gradient(self, x: Array, y: Array) -> Array:
        return (self.value(x, y) * np.sin(x - y.T) / self.length_scale**2)[..., None]

    def hessian(self, x: Array, y: Array) -> Array:
        u, weight = x - y.T, self.length_scale**-2
        return (self.value(x, y) * weight * (np.cos(u) - weight * np.sin(u) ** 2))[..., None, None]

    def diagonal(self, x: Array) -> Array:
        return np.full(len(x), self.variance)

    def gradient_diagonal(self, x: Array) -> Array:
        return np.full(x.shape, self.variance / self.length_scale**2)


@dataclass(frozen=True)
class Brownian(Kernel):
    """k = σ² min(x, y) on the half-line x ≥ 0: the Wiener process, which has no derivative.

    Args:
        variance: σ², of an increment of unit length.

    Raises:
        ValueError: it is not positive and finite; from the blocks: a negative coordinate.
    """

    variance: float = 1.0
    differentiable: ClassVar[bool] = False
    dimension: ClassVar[int | None] = 1

    def __post_init__(self) -> None:
        _require_positive(variance=self.variance)

    def value(self, x: Array, y: Array) -> Array:
        return self.variance * np.minimum(self._checked(x), self._checked(y).T)

    def diagonal(self, x: Array) -> Array:
        return self.variance * self._checked(x)[:, 0]

    @staticmethod
    def _checked(x: Array) -> Array:
        if x.size and x.min() < 0.0:
            raise ValueError(f"x: expected coordinates ≥ 0 for the Brownian kernel, got {x.min():g}")
        return x
