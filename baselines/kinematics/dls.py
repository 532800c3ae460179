"""Damped least squares: one step for servoing, and a whole search with restarts, each a compiled call.

A step solves (JᵀW²J + λ²I) Δq = JᵀW²e (thesis equation 2.23 with the Jᵀ that it drops; Wampler 1986; Nakamura &
Hanafusa 1986). The servo's λ rises as the least singular value falls below a threshold (Chiaverini, Siciliano & Egeland
1994, "Review of the damped least-squares inverse kinematics", section III); the search's is proportional to the squared
error (Chan & Lawrence 1988; Sugihara 2011, "Solvability-unconcerned inverse kinematics by the Levenberg–Marquardt
method"), which keeps far steps safe and lets the last ones converge quadratically. W weighs radians against metres.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.sim.kernel_math import compiled
from aerograsp_env.spatial import as_array
from baselines.kinematics.arm import Arm
from baselines.kinematics.chain import (
    bounded_step,
    columns_kernel,
    frames_kernel,
    gram_kernel,
    jacobian_kernel,
    task_kernel,
)

Array = NDArray[np.float64]

RADIAN = 0.4  # of the arm's length: what a radian weighs beside a metre
SEARCHES, ITERATIONS = 100, 30  # starts, and the most steps from each
_STALL = 4  # steps without a third off the squared error that end a search
_MAX_STEP = 0.7  # of a joint in one step of a search [rad]
_GAIN, _FLOOR = 0.1, 2.5e-6  # λ² = gain · squared error + floor · (RADIAN · length)²
_NEAREST_STARTS, _NEAREST_STEPS = 24, 300


class Search(NamedTuple):
    """What `search` found; q is the nearest configuration where it did not converge."""

    q: Array  # (n,) [rad], within the limits
    converged: bool
    iterations: int
    searches: int  # starts tried


def weights(arm: Arm, rows: int = 6) -> Array:
    """Weight of each row of an error (rows,): 1 for metres, RADIAN times the arm's length for radians."""
    return np.where(np.arange(rows) < 3, 1.0, RADIAN * arm.length)


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


def servo_step(
    arm: Arm,
    q: ArrayLike,
    twist: ArrayLike,
    step_limits: ArrayLike,
    damping: float = 0.05,
    threshold: float = 0.05,
) -> Array:
    """Joint angles (n,) [rad] after one damped step that moves the tool by `twist` as nearly as limits allow.

    Args:
        arm: the arm.
        q: (n,) where it is, within its limits [rad].
        twist: (6,) displacement wanted: linear [m], rotation vector [rad], axes of the base frame; or (3,), position
            alone.
        step_limits: the most that each joint may move, (n,) or one for all [rad].
        damping: λ at a singularity, as a share of the arm's length.
        threshold: least singular value below which damping begins, as a share of the arm's length.

    Raises:
        ValueError: q or the twist of another shape or not finite, q beyond the limits, or a step limit, the damping or
            the threshold not positive.
    """
    q = as_array(q, (arm.n,), "q")
    twist = np.asarray(twist, np.float64)
    rows = 3 if twist.shape == (3,) else 6
    twist = as_array(twist, (rows,), "twist")
    steps = np.broadcast_to(np.asarray(step_limits, np.float64), (arm.n,))
    if not (np.isfinite(steps).all() and (steps > 0.0).all()):
        raise ValueError(f"step_limits: expected positive angles, got {steps.tolist()}")
    for name, value in (("damping", damping), ("threshold", threshold)):
        if not 0.0 < value < np.inf:
            raise ValueError(f"{name}: expected a positive number, got {value}")
    if not arm.within_limits(q, 1e-9):
        raise ValueError(f"q: expected angles within the limits, got {q.tolist()}")
    q_next = np.empty(arm.n)
    length = arm.length
    error = np.zeros(6)
    error[:rows] = twist
    dls_step(
        arm.chain,
        arm.limits,
        steps.copy(),
        weights(arm),
        q.copy(),
        error,
        rows,
        damping * length,
        threshold * length,
        q_next,
    )
    return q_next


@compiled
def dls_step(chain, limits, step_limits, row_weights, q, twist, rows, damping, threshold, q_next):
    """One damped step of q (n,) by a twist (6,), of which the first `rows` count; returns the least singular value.

    Args:
        chain, limits: the arm's (see `chain`).
        step_limits: (n,) the most each joint may move [rad].
        row_weights: (6,) of the error's rows; 1 and RADIAN × length are good ones.
        damping: λ [m] at a singularity.
        threshold: singular value of the weighted Jacobian [m] below which damping begins.
        q_next: written, (n,) within the limits.
    """
    n = q.shape[0]
    tool, jacobian = np.empty((3, 4)), np.empty((6, n))
    gram, gradient = np.empty((n, n)), np.empty(n)
    jacobian_kernel(chain, q, tool, jacobian)
    gram_kernel(jacobian, twist, row_weights, rows, gram, gradient)
    sigma = least_singular_value(jacobian, row_weights, rows)
    squared = 1e-9 * damping * damping  # keeps the factorisation regular
    if sigma < threshold:
        squared += (1.0 - (sigma / threshold) ** 2) * damping * damping
    bounded_step(gram, gradient, squared, q, limits, step_limits, q_next)
    return sigma


@compiled
def least_singular_value(jacobian, row_weights, rows):
    """The least of the weighted Jacobian's min(rows, n) singular values, by Jacobi's rotations of its Gram matrix."""
    n = jacobian.shape[1]
    m = min(rows, n)
    a = np.zeros((m, m))
    for i in range(m):
        for j in range(i + 1):
            total = 0.0
            if n <= rows:
                for r in range(rows):
                    total += row_weights[r] ** 2 * jacobian[r, i] * jacobian[r, j]
            else:
                for k in range(n):
                    total += row_weights[i] * row_weights[j] * jacobian[i, k] * jacobian[j, k]
            a[i, j] = a[j, i] = total
    for _ in range(12):
        off, diagonal = 0.0, 0.0
        for i in range(m):
            diagonal += a[i, i] ** 2
            for j in range(i):
                off += a[i, j] ** 2
        if off <= 1e-28 * diagonal:
            break
        for i in range(1, m):
            for j in range(i):
                if a[i, j] == 0.0:
                    continue
                theta = 0.5 * (a[j, j] - a[i, i]) / a[i, j]
                t = 1.0 / (abs(theta) + math.sqrt(theta * theta + 1.0))
                if theta < 0.0:
                    t = -t
                c = 1.0 / math.sqrt(t * t + 1.0)
                s = t * c
                for k in range(m):
                    u, v = a[k, i], a[k, j]
                    a[k, i], a[k, j] = c * u - s * v, s * u + c * v
                for k in range(m):
                    u, v = a[i, k], a[j, k]
                    a[i, k], a[j, k] = c * u - s * v, s * u + c * v
    least = np.inf
    for i in range(m):
        least = min(least, a[i, i])
    return math.sqrt(max(least, 0.0))


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
