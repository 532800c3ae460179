"""The damped search of an inverse: from a start and then from others until the target is met, in one compiled call.

Steps are those of `dls` with a damping in proportion to the squared error (Chan & Lawrence 1988; Sugihara 2011,
"Solvability-unconcerned inverse kinematics by the Levenberg–Marquardt method"), which keeps far steps safe and lets the
last ones converge quadratically. A search that stalls, in a local minimum or against the limits, gives way to the next
start, from a low-discrepancy sequence over the joint ranges.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim.kernel_math import compiled
from baselines.kinematics.arm import Arm
from baselines.kinematics.chain import (
    bounded_step,
    columns_kernel,
    frames_kernel,
    gram_kernel,
    jacobian_kernel,
    task_kernel,
)
from baselines.kinematics.dls import weights

Array = NDArray[np.float64]

SEARCHES, ITERATIONS = 100, 30  # starts, and the most steps from each
_STALL = 4  # steps without a third off the squared error that end a search
_MAX_STEP = 0.7  # of a joint in one step of a search [rad]
_GAIN, _FLOOR = 0.1, 2.5e-6  # λ² = gain · squared error + floor · (weight of a radian)²
_NEAREST_STARTS, _NEAREST_STEPS = 24, 300


class Search(NamedTuple):
    """What `search` found; q is the nearest configuration where it did not converge."""

    q: Array  # (n,) [rad], within the limits
    converged: bool
    iterations: int
    searches: int  # starts tried


def search(
    arm: Arm,
    target: Array,
    q0: Array,
    task: int,
    position_tolerance: float,
    orientation_tolerance: float,
    searches: int = SEARCHES,
    nearest: bool = True,
) -> Search:
    """From q0, then from low-discrepancy samples of the joint ranges, until the task is met within the tolerances.

    Where no search meets it, the configuration whose weighted error is least is sought by Levenberg–Marquardt steps
    (Marquardt 1963), unless `nearest` is False; then it is the best that was passed. Deterministic.

    Args:
        arm: the arm.
        target: the tool's pose (4, 4); not checked.
        q0: (n,) where to begin, within the limits.
        task: `chain.POSE`, `POSITION` or `POSITION_ROLL`.
        position_tolerance: [m].
        orientation_tolerance: [rad].
        searches: the most starts.
        nearest: whether to look for the nearest configuration where none meets the task.
    """
    q = np.array(q0, np.float64)
    used, iterations = search_kernel(
        arm.chain,
        arm.limits,
        weights(arm),
        np.ascontiguousarray(target, np.float64),
        task,
        position_tolerance,
        orientation_tolerance,
        searches,
        nearest,
        q,
    )
    return Search(q, used > 0, iterations, used if used > 0 else searches)


@compiled
def _sample(limits, index, ratio, q):
    """The index-th of Roberts' low-discrepancy points (R_n sequence, 2018) over the joint ranges."""
    power = 1.0
    for i in range(q.shape[0]):
        power /= ratio
        share = (0.5 + index * power) % 1.0
        q[i] = limits[i, 0] + share * (limits[i, 1] - limits[i, 0])


@compiled
def search_kernel(
    chain, limits, row_weights, target, task, position_tolerance, orientation_tolerance, searches, nearest, q
):
    """`search` from q (n,), which becomes the result: starts used (−1: none converged) and iterations."""
    n = q.shape[0]
    frames, tool, jacobian, error = np.empty((n, 3, 4)), np.empty((3, 4)), np.empty((6, n)), np.empty(6)
    gram, gradient, q_next = np.empty((n, n)), np.empty(n), np.empty(n)
    step_limits = np.full(n, _MAX_STEP)
    floor = _FLOOR * row_weights[5] ** 2
    q_best, least = q.copy(), np.inf
    ratio = 1.0  # the root of x^(n + 1) = x + 1
    for _ in range(40):
        ratio = (1.0 + ratio) ** (1.0 / (n + 1))
    iterations = 0
    for start in range(searches):
        if start > 0:
            _sample(limits, start, ratio, q)
        low, stalled = np.inf, 0
        for _ in range(ITERATIONS):
            iterations += 1
            frames_kernel(chain, q, frames, tool)
            columns_kernel(frames, tool, jacobian)
            rows = task_kernel(task, tool, target, jacobian, error)
            position, orientation = error_sizes(error, rows)
            if position <= position_tolerance and orientation <= orientation_tolerance:
                return start + 1, iterations
            squared = 0.0
            for r in range(rows):
                squared += (row_weights[r] * error[r]) ** 2
            if squared < least:
                least = squared
                q_best[:] = q
            if squared < 0.7 * low:
                low, stalled = squared, 0
            else:
                stalled += 1
                if stalled >= _STALL:
                    break
            gram_kernel(jacobian, error, row_weights, rows, gram, gradient)
            if not bounded_step(gram, gradient, _GAIN * squared + floor, q, limits, step_limits, q_next):
                break
            q[:] = q_next
    if nearest:
        for start in range(_NEAREST_STARTS):
            if start == 0:
                q[:] = q_best
            else:
                _sample(limits, start, ratio, q)
            squared, steps = _descend(chain, limits, row_weights, target, task, step_limits, q)
            iterations += steps
            if squared < least:
                least = squared
                q_best[:] = q
    q[:] = q_best
    return -1, iterations


@compiled
def error_sizes(error, rows):
    """Position error [m] and orientation error [rad] of a task's error; 0 for what the task leaves free."""
    position = math.sqrt(error[0] ** 2 + error[1] ** 2 + error[2] ** 2)
    if rows == 6:
        return position, math.sqrt(error[3] ** 2 + error[4] ** 2 + error[5] ** 2)
    return position, abs(error[3]) if rows == 4 else 0.0


@compiled
def _descend(chain, limits, row_weights, target, task, step_limits, q):
    """Levenberg–Marquardt descent of the weighted squared error from q (n,), in place: the least, and steps taken."""
    n = q.shape[0]
    tool, jacobian, error = np.empty((3, 4)), np.empty((6, n)), np.empty(6)
    gram, gradient, q_next = np.empty((n, n)), np.empty(n), np.empty(n)
    damping, least = 1e-2 * row_weights[5] ** 2, np.inf
    q_try = q.copy()
    steps = 0
    while steps < _NEAREST_STEPS:
        steps += 1
        jacobian_kernel(chain, q_try, tool, jacobian)
        rows = task_kernel(task, tool, target, jacobian, error)
        squared = 0.0
        for r in range(rows):
            squared += (row_weights[r] * error[r]) ** 2
        if squared < least:
            gain = least - squared
            least = squared
            q[:] = q_try
            if gain < 1e-15 * squared:
                break
            gram_kernel(jacobian, error, row_weights, rows, gram, gradient)
            damping = max(0.3 * damping, 1e-9 * row_weights[5] ** 2)
        else:
            damping *= 4.0
            if damping > 1e6 * row_weights[5] ** 2:
                break
        if not bounded_step(gram, gradient, damping, q, limits, step_limits, q_next):
            break
        q_try[:] = q_next
    return least, steps
