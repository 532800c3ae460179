"""Errors about a set-point."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from aerograsp_env.metrics.arrays import Array


def _errors(value: ArrayLike) -> Array:
    errors = np.asarray(value, dtype=np.float64)
    if errors.ndim != 2 or not len(errors) or not np.isfinite(errors).all():
        raise ValueError(f"errors: expected finite values of shape (T, n), T ≥ 1, got shape {errors.shape}")
    return errors


def mean_absolute_error(errors: ArrayLike, dt: float, skip: float = 5.0) -> Array:
    """Mean |error| per axis (n,) of errors (T, n), leaving out the rows before `skip` [s]; row k is at time k · dt.

    Raises:
        ValueError: if nothing is left after `skip`.
    """
    errors = _errors(errors)
    if not (dt > 0.0 and skip >= 0.0):
        raise ValueError(f"dt, skip: expected dt > 0 and skip ≥ 0 [s], got {dt} and {skip}")
    first = math.ceil(skip / dt - 1e-9)  # so that 5 / 0.02 is 250, whatever its rounding
    if first >= len(errors):
        raise ValueError(f"errors: expected more than {first} rows (skip = {skip} s), got {len(errors)}")
    return np.abs(errors[first:]).mean(axis=0)


class TruenessPrecision(NamedTuple):
    trueness: Array  # (n,) |mean error|: how far off on average
    precision: Array  # (n,) standard deviation of the error (over N, not N − 1): how widely spread


def trueness_precision(errors: ArrayLike) -> TruenessPrecision:
    """|mean| and standard deviation per axis (n,) of errors (T, n), the two parts of accuracy in ISO 5725-1."""
    errors = _errors(errors)
    return TruenessPrecision(np.abs(errors.mean(axis=0)), errors.std(axis=0))
