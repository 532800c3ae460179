"""Interquartile mean, bootstrap intervals and paired differences against other implementations and known answers."""

import numpy as np
import pytest
from rliable import metrics as rliable_metrics
from scipy import stats

from agents.statistics import Interval, bootstrap_interval, iqm, mean, paired_difference


@pytest.mark.parametrize("n", [4, 8, 100])
def test_iqm_is_the_trimmed_mean_where_four_divides_n(n: int) -> None:
    values = np.random.default_rng(n).lognormal(size=n)
    assert iqm(values) == pytest.approx(stats.trim_mean(values, 0.25), rel=1e-12)
    assert iqm(values) == pytest.approx(rliable_metrics.aggregate_iqm(values[:, None]), rel=1e-12)


@pytest.mark.parametrize("n", [1, 2, 3, 5, 6, 7, 101])
def test_iqm_of_any_n_is_the_trimmed_mean_of_four_copies(n: int) -> None:
    values = np.random.default_rng(n).normal(size=n)
    assert iqm(values) == pytest.approx(stats.trim_mean(np.repeat(values, 4), 0.25), rel=1e-12)


def test_iqm_known_answers() -> None:
    assert iqm([7.0]) == 7.0
    assert iqm([1.0, 3.0]) == 2.0
    assert iqm([0.0, 1.0, 5.0]) == pytest.approx((0.25 * 0.0 + 1.0 + 0.25 * 5.0) / 1.5)
    assert iqm([np.inf, 1.0, 2.0, -np.inf]) == 1.5  # outliers have no weight
    assert np.isnan(iqm([np.nan, 1.0, 2.0, 3.0, 4.0]))  # but what is undefined is never dropped


def test_iqm_works_over_the_last_axis_and_leaves_its_input() -> None:
    values = np.random.default_rng(0).normal(size=(3, 10))
    before = values.copy()
    assert iqm(values) == pytest.approx([iqm(row) for row in values])
    assert np.array_equal(values, before)


def test_iqm_is_equivariant_under_affine_maps_and_permutations() -> None:
    rng = np.random.default_rng(1)
    values = rng.normal(size=13)
    assert iqm(2.0 * values - 3.0) == pytest.approx(2.0 * iqm(values) - 3.0)
    assert iqm(rng.permutation(values)) == pytest.approx(iqm(values), rel=1e-14)


def test_bootstrap_interval_of_the_mean_agrees_with_theory_and_scipy() -> None:
    values = np.random.default_rng(2).normal(5.0, 2.0, size=400)
    interval = bootstrap_interval(values, 0, mean, resamples=20_000)
    half = 1.959964 * values.std() / np.sqrt(values.size)
    assert interval == pytest.approx((values.mean() - half, values.mean() + half), abs=0.03 * half * 2)
    theirs = stats.bootstrap(
        (values,), np.mean, n_resamples=20_000, method="percentile", rng=np.random.default_rng(1)
    ).confidence_interval
    assert interval == pytest.approx((theirs.low, theirs.high), abs=0.1 * half)


def test_bootstrap_interval_covers_at_its_level() -> None:
    rng = np.random.default_rng(3)
    intervals = [bootstrap_interval(rng.normal(size=60), rng, mean, level=0.8, resamples=400) for _ in range(300)]
    covered = np.mean([low <= 0.0 <= high for low, high in intervals])
    assert abs(covered - 0.8) < 0.08  # 3.5 standard errors, 0.023 each


def test_bootstrap_interval_is_repeatable_and_contains_the_estimate() -> None:
    values = np.random.default_rng(4).exponential(size=50)
    interval = bootstrap_interval(values, 7)
    assert interval == bootstrap_interval(values, np.random.default_rng(7))
    assert interval.low < iqm(values) < interval.high
    assert isinstance(interval, Interval)


def test_bootstrap_interval_edges() -> None:
    assert bootstrap_interval([3.0]) == (3.0, 3.0)
    assert np.isnan(bootstrap_interval([1.0, np.nan])).all()


def test_paired_difference_is_sharper_than_two_intervals() -> None:
    rng = np.random.default_rng(5)
    common = rng.normal(0.0, 10.0, size=200)
    a, b = common + rng.normal(1.0, 0.1, size=200), common + rng.normal(0.0, 0.1, size=200)
    difference = paired_difference(a, b)
    assert difference.estimate == pytest.approx(np.mean(a - b))
    assert 0.9 < difference.interval.low < 1.0 < difference.interval.high < 1.1
    assert difference.significant
    assert bootstrap_interval(a, 0, mean).low < bootstrap_interval(b, 0, mean).high  # unpaired they overlap
    assert not paired_difference(a, a[::-1]).significant


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: iqm([]), "values"),
        (lambda: iqm(3.0), "values"),
        (lambda: bootstrap_interval([]), "values"),
        (lambda: bootstrap_interval([[1.0, 2.0]]), "values"),
        (lambda: bootstrap_interval([1.0], level=95), "level"),
        (lambda: bootstrap_interval([1.0], resamples=0), "resamples"),
        (lambda: paired_difference([1.0, 2.0], [1.0]), "shape"),
    ],
)
def test_bad_input_is_refused_by_name(call, named: str) -> None:
    with pytest.raises(ValueError, match=named):
        call()
