"""Covariance functions on a line (D = 1): for time series, angles and one-dimensional illustrations."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from baselines.objects.kernels import Array, Kernel


def _full(lower: Array) -> Array:
    """The symmetric matrix of which the lower triangle is given."""
    below = np.tril(lower)
    return below + np.tril(below, -1).T


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

    def value(self, x: Array, y: Array) -> Array:
        half = np.sin(0.5 * (x - y.T))
        return self.variance * np.exp(-2.0 * (half / self.length_scale) ** 2)

    def gradient(self, x: Array, y: Array) -> Array:
        return (self.value(x, y) * np.sin(x - y.T) / self.length_scale**2)[..., None]

    def hessian(self, x: Array, y: Array) -> Array:
        u, weight = x - y.T, self.length_scale**-2
        return (self.value(x, y) * weight * (np.cos(u) - weight * np.sin(u) ** 2))[..., None, None]

    def contract(self, x: Array, lower: Array, gradients: bool) -> dict[str, float]:
        weights, n, u, w = _full(lower), len(x), x - x.T, self.length_scale**-2
        k, sine, cosine = self.value(x, x), np.sin(u), np.cos(u)
        by_scale = 4.0 * w * np.sin(0.5 * u) ** 2  # ∂ log k / ∂ log l
        length_scale = np.vdot(weights[:n, :n], k * by_scale)
        if gradients:
            length_scale += 2.0 * np.vdot(weights[:n, n:], k * w * sine * (by_scale - 2.0))
            curvature = w * cosine - w**2 * sine**2
            by_weight = 4.0 * w**2 * sine**2 - 2.0 * w * cosine
            length_scale += np.vdot(weights[n:, n:], k * (by_scale * curvature + by_weight))
        return {"length_scale": float(length_scale), "variance": float(np.vdot(weights, self.gram(x, gradients)))}

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

    def value(self, x: Array, y: Array) -> Array:
        return self.variance * np.minimum(self._checked(x), self._checked(y).T)

    def diagonal(self, x: Array) -> Array:
        return self.variance * self._checked(x)[:, 0]

    def contract(self, x: Array, lower: Array, gradients: bool) -> dict[str, float]:
        return {"variance": float(np.vdot(_full(lower), self.gram(x, gradients)))}

    @staticmethod
    def _checked(x: Array) -> Array:
        if x.size and x.min() < 0.0:
            raise ValueError(f"x: expected coordinates ≥ 0 for the Brownian kernel, got {x.min():g}")
        return x
