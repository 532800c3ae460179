"""Covariance functions of a Gaussian process f and of its gradient ∂f.

A kernel gives three blocks between points x (N, D) and y (M, D), from which every Gram matrix with normals is built:

- ``value``     cov(f(x), f(y)) = k                        (N, M)
- ``gradient``  cov(f(x), ∂f(y)/∂y_j) = ∂k/∂y_j            (N, M, D); by symmetry cov(∂f(x), f(y)) is its negative
  for the stationary kernels, all of those that are differentiable here
- ``hessian``   cov(∂f(x)/∂x_i, ∂f(y)/∂y_j) = ∂²k/∂x_i∂y_j (N, M, D, D)

and the diagonals ``diagonal`` (N,) and ``gradient_diagonal`` (N, D): the prior variances of f and of ∂f. ``gram`` and
``cross`` put the blocks together, and ``contract`` gives what the likelihood's gradient needs.

The kernels here are functions of the distance, for points in space; those on a line are in `line_kernels`.

Sources: Rasmussen & Williams 2006, chapters 4 and 9.4; Williams & Fitzgibbon 2007, "Gaussian process implicit
surfaces" (thin plate).
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from baselines.objects.pairwise import fill_cross, fill_gram, reduce_weights, weighted_slopes

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Kernel(ABC):
    """What every kernel can do. Those with ``differentiable = False`` give values only."""

    differentiable: ClassVar[bool] = True
    dimension: ClassVar[int | None] = None  # of the points; None takes any

    def __post_init__(self) -> None:
        for name, value in self.parameters.items():
            if not 0.0 < value < np.inf:
                raise ValueError(f"{name}: expected a positive finite number, got {value}")

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

    def gram(self, x: Array, gradients: bool) -> Array:
        """Covariance (n, n) of all values at x (N, D), then, where said, of all gradients point by point."""
        if not gradients:
            return self.value(x, x)
        (count, dimension), slope = x.shape, self.gradient(x, x)
        n = count * dimension
        return np.block(
            [
                [self.value(x, x), slope.reshape(count, n)],
                [slope.transpose(1, 2, 0).reshape(n, count), self.hessian(x, x).transpose(0, 2, 1, 3).reshape(n, n)],
            ]
        )

    def cross(self, x: Array, y: Array, gradients: bool) -> Array:
        """Covariance (M, n) of f at x (M, D) with values, and where said gradients, at y (N, D), in `gram`'s order."""
        if not gradients:
            return self.value(x, y)
        return np.concatenate([self.value(x, y), self.gradient(x, y).reshape(len(x), -1)], axis=1)

    @property
    def parameters(self) -> dict[str, float]:
        """The hyper-parameters by name; all are positive."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @abstractmethod
    def contract(self, x: Array, lower: Array, gradients: bool) -> dict[str, float]:
        """Σ W∘∂K/∂log θ for each hyper-parameter θ, K = gram(x, gradients) and the symmetric W (n, n) whose lower
        triangle is given."""


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

    @abstractmethod
    def _scale_derivatives(self, d: Array) -> tuple[str, tuple[Array, Array, Array]]:
        """Name of the length among the parameters, and the derivatives of φ, a and b by its logarithm."""

    def _profiles(self, d: Array) -> tuple[Array, Array, Array]:
        """φ, a and b."""
        return self._profile(d), self._first(d), self._second(d)

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

    def gram(self, x: Array, gradients: bool) -> Array:
        if not gradients:
            return self.value(x, x)
        out = np.empty((x.size + len(x),) * 2)
        fill_gram(x, *self._profiles(cdist(x, x)), out)
        return out

    def cross(self, x: Array, y: Array, gradients: bool) -> Array:
        if not gradients:
            return self.value(x, y)
        out, (value, first, _) = np.empty((len(x), y.size + len(y))), self._profiles(cdist(x, y))
        fill_cross(x, y, value, first, out)
        return out

    def contract(self, x: Array, lower: Array, gradients: bool) -> dict[str, float]:
        d = cdist(x, x)
        reduced = reduce_weights(x, lower) if gradients else (2.0 * np.tril(lower, -1) + np.diag(np.diag(lower)),)
        name, derivatives = self._scale_derivatives(d)
        profiles = {name: derivatives, "variance": self._profiles(d)}  # every block is proportional to the variance
        return {
            name: float(sum(np.vdot(w, p) for w, p in zip(reduced, blocks, strict=False)))
            for name, blocks in profiles.items()
        }

    def weighted(
        self, x: Array, y: Array, values: Array, slopes: Array | None, gradient: bool
    ) -> tuple[Array, Array | None]:
        if x.shape[1] != 3:  # the compiled loop is for points in space
            return super().weighted(x, y, values, slopes, gradient)
        d = cdist(x, y)
        if slopes is None and not gradient:
            return self._profile(d) @ values, None
        value, first, second = self._profiles(d)
        mean, slope = value @ values, np.zeros(x.shape)
        columns = np.zeros((3, len(y))) if slopes is None else np.ascontiguousarray(slopes.T)
        weighted_slopes(x, np.ascontiguousarray(y.T), first, second, values, columns, mean, slope)
        return mean, slope if gradient else None

    def diagonal(self, x: Array) -> Array:
        return np.full(len(x), self._profile(np.zeros(1))[0])

    def gradient_diagonal(self, x: Array) -> Array:
        return np.full(x.shape, -self._first(np.zeros(1))[0])


@dataclass(frozen=True)
class _Stationary(_Isotropic):
    """φ = σ² g(d/l)."""

    length_scale: float
    variance: float = 1.0


@dataclass(frozen=True)
class SquaredExponential(_Stationary):
    """k = σ² exp(−d²/2l²). Rasmussen & Williams 2006, eq. 4.9.

    Args:
        length_scale: l [m].
        variance: σ², of f.

    Raises:
        ValueError: one of them is not positive and finite.
    """

    def _profile(self, d: Array) -> Array:
        return self.variance * np.exp(-0.5 * (d / self.length_scale) ** 2)

    def _first(self, d: Array) -> Array:
        return -self._profile(d) / self.length_scale**2

    def _second(self, d: Array) -> Array:
        return self._profile(d) / self.length_scale**4

    def _profiles(self, d: Array) -> tuple[Array, Array, Array]:
        value, weight = self._profile(d), self.length_scale**-2  # one exponential for the three
        first = -weight * value
        return value, first, -weight * first

    def _scale_derivatives(self, d: Array) -> tuple[str, tuple[Array, Array, Array]]:
        (value, first, second), u = self._profiles(d), (d / self.length_scale) ** 2
        return "length_scale", (value * u, first * (u - 2.0), second * (u - 4.0))


@dataclass(frozen=True)
class Matern52(_Stationary):
    """k = σ² (1 + q + q²/3) exp(−q), q = √5 d/l. Rasmussen & Williams 2006, eq. 4.17.

    Args:
        length_scale: l [m].
        variance: σ², of f.

    Raises:
        ValueError: one of them is not positive and finite.
    """

    def _profile(self, d: Array) -> Array:
        q = np.sqrt(5.0) / self.length_scale * d
        return self.variance * (1.0 + q + q**2 / 3.0) * np.exp(-q)

    def _first(self, d: Array) -> Array:
        q = np.sqrt(5.0) / self.length_scale * d
        return -5.0 / 3.0 * self.variance / self.length_scale**2 * (1.0 + q) * np.exp(-q)

    def _second(self, d: Array) -> Array:
        return 25.0 / 3.0 * self.variance / self.length_scale**4 * np.exp(-np.sqrt(5.0) / self.length_scale * d)

    def _profiles(self, d: Array) -> tuple[Array, Array, Array]:
        q, weight = np.sqrt(5.0) / self.length_scale * d, 5.0 / 3.0 * self.length_scale**-2
        exponential = self.variance * np.exp(-q)  # one for the three
        linear = (1.0 + q) * exponential
        return linear + q**2 / 3.0 * exponential, -weight * linear, 3.0 * weight**2 * exponential

    def _scale_derivatives(self, d: Array) -> tuple[str, tuple[Array, Array, Array]]:
        q, weight = np.sqrt(5.0) / self.length_scale * d, 5.0 / 3.0 * self.length_scale**-2
        exponential = self.variance * np.exp(-q)
        value = q**2 * (1.0 + q) / 3.0 * exponential
        return "length_scale", (
            value,
            weight * (2.0 + 2.0 * q - q**2) * exponential,
            3.0 * weight**2 * (q - 4.0) * exponential,
        )


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

    def _scale_derivatives(self, d: Array) -> tuple[str, tuple[Array, Array, Array]]:
        self._check(d)
        R, s = self.radius, self.variance
        return "radius", (3.0 * s * R * (R**2 - d**2), np.full_like(d, -6.0 * s * R), np.zeros_like(d))
