"""A small evolution strategy for noisy costs of a few positive numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Search:
    """Minimises a noisy cost over positive numbers, in log space.

    Rank-μ covariance adaptation (Hansen 2016, "The CMA evolution strategy: a tutorial", equations 6 and 30) without the
    evolution paths: the weighted mean of the better half of a generation is the next mean, so noise averages out, and
    the steps that led there shape the next covariance. All values are immutable: `ask` and `tell` are pure.

    Attributes:
        mean: (n,) of log values.
        covariance: (n, n).
        low, high: (n,) bounds of the log values.
    """

    mean: Array
    covariance: Array
    low: Array
    high: Array

    @classmethod
    def start(cls, values: Array, bounds: Array, spread: float = 0.5) -> Search:
        """Begin at `values` (n,) within `bounds` (n, 2), with a standard deviation of `spread` in log space.

        Raises:
            ValueError: bounds that are not 0 < low < high, or shapes that differ.
        """
        values, bounds = np.asarray(values, dtype=float), np.asarray(bounds, dtype=float)
        if values.ndim != 1 or bounds.shape != (values.size, 2):
            raise ValueError(f"bounds: expected shape ({values.size}, 2), got {bounds.shape}")
        if not np.isfinite(bounds).all() or (bounds[:, 0] <= 0).any() or (bounds[:, 0] >= bounds[:, 1]).any():
            raise ValueError(f"bounds: expected 0 < low < high, got {bounds.tolist()}")
        low, high = np.log(bounds).T
        mean = np.clip(np.log(np.clip(values, bounds[:, 0], bounds[:, 1])), low, high)
        return cls(mean, spread**2 * np.eye(values.size), low, high)

    @property
    def values(self) -> Array:
        """(n,) the present best guess."""
        return np.exp(self.mean)

    def ask(self, count: int, rng: np.random.Generator) -> Array:
        """(count, n) values to try."""
        root = np.linalg.cholesky(self.covariance + 1e-12 * np.eye(self.mean.size))
        logs = self.mean + rng.standard_normal((count, self.mean.size)) @ root.T
        return np.exp(np.clip(logs, self.low, self.high))

    def tell(self, values: Array, costs: Array, rate: float = 0.3) -> Search:
        """The search after the `costs` (count,) of `values` (count, n) are known; infinite ones are the worst."""
        order = np.argsort(costs, kind="stable")[: max(len(costs) // 2, 1)]
        weights = np.log(len(order) + 0.5) - np.log(np.arange(1, len(order) + 1))
        weights /= weights.sum()
        steps = np.log(values[order]) - self.mean
        covariance = (1.0 - rate) * self.covariance + rate * (steps.T * weights) @ steps
        return Search(self.mean + weights @ steps, covariance, self.low, self.high)

    def to_dict(self) -> dict[str, Any]:
        """For JSON; `from_dict` is its inverse."""
        return {name: getattr(self, name).tolist() for name in ("mean", "covariance", "low", "high")}

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Search:
        return cls(**{name: np.asarray(data[name], dtype=float) for name in ("mean", "covariance", "low", "high")})
