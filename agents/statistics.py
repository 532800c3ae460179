"""Statistics of few, skewed samples: interquartile mean, percentile bootstrap, paired differences.

Agarwal et al. 2021, "Deep Reinforcement Learning at the Edge of the Statistical Precipice" (NeurIPS), recommend
the interquartile mean with bootstrap intervals; the percentile bootstrap is Efron & Tibshirani 1993, chapter 13.
A sample that holds NaN has NaN statistics: nothing is dropped silently. Shares of 0/1 samples have Wilson's
interval and McNemar's test.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Statistic = Callable[[NDArray], NDArray]  # reduces the last axis

RESAMPLES = 2000
_BLOCK = 1_000_000  # resampled values held at once


class Interval(NamedTuple):
    """A confidence interval, in the unit of the sample."""

    low: float
    high: float


class PairedDifference(NamedTuple):
    """A statistic of the differences a − b of paired samples, with its confidence interval."""

    estimate: float
    interval: Interval

    @property
    def significant(self) -> bool:
        """Whether the interval excludes zero."""
        return self.interval.low > 0.0 or self.interval.high < 0.0


def mean(values: ArrayLike) -> NDArray:
    """Arithmetic mean over the last axis."""
    return np.mean(np.asarray(values, dtype=np.float64), axis=-1)


def iqm(values: ArrayLike) -> NDArray:
    """Interquartile mean over the last axis: the mean of the middle half of the probability mass.

    The order statistic x_(i) stands for the mass [i, i + 1] / n and counts with the part of it that lies within
    [1/4, 3/4]; so it is exact for every n, where a trimmed mean cuts whole samples (equal to it if 4 divides n).

    Args:
        values: (..., n), n ≥ 1. Any NaN makes the result NaN.

    Returns:
        (...), a 0-d array for 1-D input.

    Raises:
        ValueError: no values.
    """
    array = np.asarray(values, dtype=np.float64)
    if array.ndim == 0 or array.shape[-1] == 0:
        raise ValueError(f"values: expected at least one, got shape {array.shape}")
    n = array.shape[-1]
    edges = np.arange(n + 1, dtype=np.float64)
    weights = np.diff(np.clip(edges, 0.25 * n, 0.75 * n)) / (0.5 * n)
    # NaNs sort last, where their weight may be zero; 0 · NaN is NaN all the same, and so they are never hidden. An
    # infinite outlier must not become one by the same rule.
    ordered = np.sort(array, axis=-1)
    ordered[..., weights == 0.0] = np.where(np.isnan(ordered[..., weights == 0.0]), np.nan, 0.0)
    return ordered @ weights


STATISTICS: dict[str, Statistic] = {"iqm": iqm, "mean": mean}


def bootstrap_interval(
    values: ArrayLike,
    rng: np.random.Generator | int = 0,
    statistic: Statistic = iqm,
    level: float = 0.95,
    resamples: int = RESAMPLES,
) -> Interval:
    """Percentile bootstrap interval of a statistic of independent samples.

    Args:
        values: (n,) samples, n ≥ 1. Any NaN makes the interval NaN.
        rng: the generator that resamples, or the seed of one.
        statistic: reduces the last axis of a (B, n) array.
        level: confidence level in (0, 1).
        resamples: number of resamples B.

    Raises:
        ValueError: empty or not one-dimensional `values`, `level` outside (0, 1), `resamples` < 1.
    """
    sample = np.asarray(values, dtype=np.float64)
    if sample.ndim != 1 or sample.size == 0:
        raise ValueError(f"values: expected shape (n,) with n ≥ 1, got {sample.shape}")
    if not 0.0 < level < 1.0:
        raise ValueError(f"level: expected a number in (0, 1), got {level!r}")
    if resamples < 1:
        raise ValueError(f"resamples: expected at least 1, got {resamples!r}")
    if np.isnan(sample).any():
        return Interval(float("nan"), float("nan"))
    rng = np.random.default_rng(rng)
    block = max(1, _BLOCK // sample.size)
    draws = [
        statistic(sample[rng.integers(sample.size, size=(min(block, resamples - start), sample.size))])
        for start in range(0, resamples, block)
    ]
    tail = 0.5 * (1.0 - level)
    low, high = np.quantile(np.concatenate(draws), [tail, 1.0 - tail])
    return Interval(float(low), float(high))


def paired_difference(
    a: ArrayLike,
    b: ArrayLike,
    rng: np.random.Generator | int = 0,
    statistic: Statistic = mean,
    level: float = 0.95,
    resamples: int = RESAMPLES,
) -> PairedDifference:
    """Statistic of a − b where a[k] and b[k] come from the same episode seed, with its bootstrap interval.

    Pairing removes what the episodes have in common (wind, delay), and so resolves much smaller differences.

    Raises:
        ValueError: `a` and `b` differ in shape, or what `bootstrap_interval` refuses.
    """
    first, second = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    if first.shape != second.shape:
        raise ValueError(f"b: expected the shape of a, {first.shape}, got {second.shape}")
    difference = first - second
    interval = bootstrap_interval(difference, rng, statistic, level, resamples)
    return PairedDifference(float(statistic(difference)), interval)


def is_binary(values: ArrayLike) -> bool:
    """Whether every value is 0 or 1."""
    return bool(np.isin(np.asarray(values), (0.0, 1.0)).all())


def wilson_interval(successes: int, trials: int, level: float = 0.95) -> Interval:
    """Score interval of a probability (Wilson 1927, JASA 22), which does not collapse where all or none succeed.

    Raises:
        ValueError: no trials, more successes than trials, or `level` outside (0, 1).
    """
    if not 0 <= successes <= trials or trials < 1:
        raise ValueError(f"successes: expected 0 to trials, and trials ≥ 1, got {successes} of {trials}")
    if not 0.0 < level < 1.0:
        raise ValueError(f"level: expected a number in (0, 1), got {level!r}")
    from scipy.special import ndtri

    z = float(ndtri(0.5 * (1.0 + level)))
    share, scale = successes / trials, 1.0 + z * z / trials
    middle = (share + 0.5 * z * z / trials) / scale
    half = z / scale * math.sqrt(share * (1.0 - share) / trials + 0.25 * (z / trials) ** 2)
    return Interval(0.0 if successes == 0 else middle - half, 1.0 if successes == trials else middle + half)


class McNemar(NamedTuple):
    """Paired 0/1 samples a, b: how often they disagree which way, and whether that could be chance."""

    only_a: int  # a = 1, b = 0
    only_b: int  # a = 0, b = 1
    p: float  # exact, two-sided


def mcnemar(a: ArrayLike, b: ArrayLike) -> McNemar:
    """McNemar's exact test: given that the pair disagrees, either way is as likely (McNemar 1947, Psychometrika 12).

    Args:
        a, b: (n,) 0 or 1, from the same episodes.

    Raises:
        ValueError: other shapes or values.
    """
    first, second = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    if first.ndim != 1 or first.shape != second.shape:
        raise ValueError(f"b: expected shape (n,) like a, got {first.shape} and {second.shape}")
    if not (is_binary(first) and is_binary(second)):
        raise ValueError("a, b: expected values 0 or 1")
    from scipy.stats import binomtest

    only_a, only_b = int((first > second).sum()), int((second > first).sum())
    p = float(binomtest(only_a, only_a + only_b, 0.5).pvalue) if only_a + only_b else 1.0
    return McNemar(only_a, only_b, p)
