"""`tolerance`: what defines each sigmoid, its limits, and its errors."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable

import numpy as np
import pytest

from aerograsp_env.rewards import SIGMOIDS, tolerance

# The definitions of dm_control, written out for a margin of 1.
DEFINITIONS: dict[str, Callable[[float, float], float]] = {
    "gaussian": lambda d, v: math.exp(-0.5 * (d * math.sqrt(-2 * math.log(v))) ** 2),
    "hyperbolic": lambda d, v: 1 / math.cosh(d * math.acosh(1 / v)),
    "long_tail": lambda d, v: 1 / ((d * math.sqrt(1 / v - 1)) ** 2 + 1),
    "tanh_squared": lambda d, v: 1 - math.tanh(d * math.atanh(math.sqrt(1 - v))) ** 2,
    "linear": lambda d, v: max(0.0, 1 - d * (1 - v)),
    "quadratic": lambda d, v: max(0.0, 1 - (d * math.sqrt(1 - v)) ** 2),
    "cosine": lambda d, v: (
        (1 + math.cos(math.pi * d * math.acos(2 * v - 1) / math.pi)) / 2 if d * math.acos(2 * v - 1) < math.pi else 0.0
    ),
}


@pytest.fixture(autouse=True)
def no_warnings() -> object:
    with warnings.catch_warnings(), np.errstate(all="warn", under="ignore"):
        warnings.simplefilter("error")
        yield


def test_every_sigmoid_is_defined_here() -> None:
    assert SIGMOIDS.keys() == DEFINITIONS.keys()


@pytest.mark.parametrize("sigmoid", SIGMOIDS)
@pytest.mark.parametrize("v", [0.01, 0.1, 0.9])
def test_sigmoids(sigmoid: str, v: float) -> None:
    x = np.linspace(-4, 6, 101)
    value = tolerance(x, bounds=(-1.0, 2.0), margin=0.8, sigmoid=sigmoid, value_at_margin=v)
    assert isinstance(value, np.ndarray)
    distance = np.maximum(0.0, np.maximum(-1.0 - x, x - 2.0)) / 0.8
    np.testing.assert_allclose(value, [DEFINITIONS[sigmoid](d, v) for d in distance], atol=1e-12)
    assert ((value >= 0) & (value <= 1)).all()
    assert (np.diff(value[x >= 2]) <= 0).all()
    assert tolerance(2.8, (-1.0, 2.0), 0.8, sigmoid, v) == pytest.approx(v)
    assert tolerance(-1.8, (-1.0, 2.0), 0.8, sigmoid, v) == pytest.approx(v)
    np.testing.assert_array_equal(tolerance([-1.0, 0.3, 2.0], (-1.0, 2.0), 0.8, sigmoid, v), 1.0)


@pytest.mark.parametrize("sigmoid", SIGMOIDS)
def test_far_away_is_worth_nothing_and_infinite_bounds_hold(sigmoid: str) -> None:
    np.testing.assert_allclose(tolerance([1e200, -1e300, np.inf, -np.inf], (0, 0), 1.0, sigmoid), 0.0, atol=1e-12)
    inside = tolerance([3.0, 1e300, np.inf], (1.0, math.inf), 1.0, sigmoid)
    np.testing.assert_array_equal(inside, 1.0)
    assert tolerance(0.0, (1.0, math.inf), 1.0, sigmoid) == pytest.approx(0.1)


def test_without_a_margin_it_is_a_step() -> None:
    np.testing.assert_array_equal(tolerance([-1e-9, 0.0, 1.0, 1.1], bounds=(0.0, 1.0)), [0, 1, 1, 0])


@pytest.mark.parametrize("sigmoid", ["linear", "quadratic", "cosine"])
def test_some_reach_zero_at_the_margin(sigmoid: str) -> None:
    np.testing.assert_allclose(tolerance([1.0, 2.0], margin=1.0, sigmoid=sigmoid, value_at_margin=0.0), 0.0, atol=1e-15)


def test_scalars_give_floats_and_shapes_are_kept() -> None:
    assert type(tolerance(np.float32(0.5), margin=1.0)) is float
    assert tolerance(np.zeros((2, 0, 3)), margin=1.0).shape == (2, 0, 3)  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"x": math.nan}, "x: expected numbers, got NaN"),
        ({"bounds": (1.0, 0.0)}, r"bounds: expected lower ≤ upper, got \(1.0, 0.0\)"),
        ({"bounds": (math.nan, 0.0)}, "bounds: expected lower ≤ upper"),
        ({"margin": -1.0}, "margin: expected a finite value ≥ 0, got -1.0"),
        ({"margin": math.inf}, "margin: expected"),
        ({"margin": math.nan}, "margin: expected"),
        ({"sigmoid": "sigmoid"}, "sigmoid: expected one of gaussian, .*cosine, got 'sigmoid'"),
        ({"value_at_margin": 0.0}, r"value_at_margin: expected a value in \(0, 1\) for gaussian, got 0.0"),
        ({"value_at_margin": 1.0, "sigmoid": "linear"}, r"value_at_margin: expected a value in \[0, 1\) for linear"),
        ({"value_at_margin": math.nan}, "value_at_margin: expected"),
    ],
)
def test_bad_arguments(arguments: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        tolerance(**{"x": 0.0, "margin": 1.0, **arguments})
