"""What the episodes of one policy gave, and statistics over them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.policies import UnknownName
from agents.statistics import STATISTICS, Interval, bootstrap_interval, iqm, mean


@dataclass(frozen=True)
class EvaluationResult:
    """What E episodes of one policy gave; all arrays are indexed by the episode k, which was reset with `seed + k`.

    A metric that an episode did not report is NaN there, and makes the statistics over it NaN.
    """

    env_id: str
    policy: str
    seed: int
    env_kwargs: Mapping[str, Any]
    success: NDArray[np.bool_]  # (E,)
    returns: NDArray[np.float64]  # (E,) undiscounted sums of rewards
    lengths: NDArray[np.int64]  # (E,) steps
    terminations: NDArray[np.str_]  # (E,) why the episode terminated, "" if it ran to its time limit
    metrics: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)  # name → (E,), at the episode's end

    @property
    def episodes(self) -> int:
        return len(self.success)

    @property
    def names(self) -> list[str]:
        """The names that `values`, `iqm`, `mean` and `interval` take."""
        return ["success", "returns", "lengths", *self.metrics]

    def values(self, name: str) -> NDArray[np.float64]:
        """(E,) per-episode values of "success" (0 or 1), "returns", "lengths" or a metric.

        Raises:
            UnknownName: no such name.
        """
        if name in self.metrics:
            return self.metrics[name]
        if name not in self.names:
            raise UnknownName("metric", name, self.names)
        return np.asarray(getattr(self, name), dtype=np.float64)

    def mean(self, name: str) -> float:
        """Mean over the episodes."""
        return float(mean(self.values(name)))

    def iqm(self, name: str) -> float:
        """Interquartile mean over the episodes (Agarwal et al. 2021)."""
        return float(iqm(self.values(name)))

    def interval(
        self, name: str, statistic: str = "iqm", level: float = 0.95, rng: np.random.Generator | int = 0
    ) -> Interval:
        """Percentile bootstrap interval of a statistic, "iqm" or "mean", over the episodes."""
        if statistic not in STATISTICS:
            raise UnknownName("statistic", statistic, STATISTICS)
        return bootstrap_interval(self.values(name), rng, STATISTICS[statistic], level)

    def to_dict(self) -> dict[str, Any]:
        """Everything, for JSON; `from_dict` is its inverse."""
        return {
            "env_id": self.env_id,
            "policy": self.policy,
            "seed": self.seed,
            "env_kwargs": dict(self.env_kwargs),
            "success": self.success,
            "returns": self.returns,
            "lengths": self.lengths,
            "terminations": self.terminations,
            "metrics": dict(self.metrics),
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "EvaluationResult":
        """The result written by `to_dict`, also after a way through JSON (null is NaN).

        Raises:
            ValueError: a field is missing or the arrays differ in length.
        """
        try:
            result = cls(
                env_id=data["env_id"],
                policy=data["policy"],
                seed=data["seed"],
                env_kwargs=data["env_kwargs"],
                success=np.asarray(data["success"], dtype=np.bool_),
                returns=np.asarray(data["returns"], dtype=np.float64),
                lengths=np.asarray(data["lengths"], dtype=np.int64),
                terminations=np.asarray(data["terminations"], dtype=np.str_),
                metrics={name: np.asarray(values, dtype=np.float64) for name, values in data["metrics"].items()},
            )
        except (KeyError, TypeError, AttributeError) as error:
            raise ValueError(f"data: not an evaluation result: {error!r}") from error
        arrays = (result.returns, result.lengths, result.terminations, *result.metrics.values())
        if any(array.shape != (result.episodes,) for array in arrays):
            raise ValueError(f"data: expected {result.episodes} episodes in every array")
        return result
