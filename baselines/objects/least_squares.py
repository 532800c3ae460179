"""Least squares in few parameters, fast enough for many small fits: all differences of a Jacobian in one call."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from baselines.objects.linear_algebra import Array

STEP = 1e-6


class Solution(NamedTuple):
    """Where the search ended."""

    x: Array  # (P,)
    cost: float  # sum of squares
    converged: bool
    iterations: int


def levenberg_marquardt(
    residuals: Callable[[Array], Array], start: Array, iterations: int = 40, tolerance: float = 1e-4
) -> Solution:
    """Minimise the sum of squared residuals (Marquardt 1963), with forward differences.

    Args:
        residuals: (B, P) -> (B, R), for B parameter vectors at once.
        start: (P,), parameters of the order of one.
        iterations: most Jacobians evaluated.
        tolerance: relative decrease of the sum at which the search has converged.
    """
    x, damping, count = start, 1e-3, len(start)
    shifts = np.vstack([np.zeros(count), STEP * np.eye(count)])
    for iteration in range(1, iterations + 1):
        at = residuals(x + shifts)
        here, jacobian = at[0], (at[1:] - at[0]) / STEP  # (R,), (P, R)
        cost, normal, slope = float(here @ here), jacobian @ jacobian.T, jacobian @ here
        while True:
            step = -np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-9), slope)
            tried = residuals((x + step)[None])[0]
            new = float(tried @ tried)
            if new < cost:  # False for NaN as well
                break
            if np.linalg.norm(step) < 1e-9 or damping > 1e12:
                return Solution(x, cost, damping <= 1e12, iteration)
            damping *= 10.0
        x, damping = x + step, max(damping * 0.1, 1e-9)
        if cost - new <= tolerance * cost:
            return Solution(x, new, True, iteration)
    final = residuals(x[None])[0]
    return Solution(x, float(final @ final), False, iterations)
