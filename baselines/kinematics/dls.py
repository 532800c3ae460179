"""Damped least squares for servoing: one step towards where the tool should go, a compiled call.

It solves (JᵀW²J + λ²I) Δq = JᵀW²e (thesis equation 2.23 with the Jᵀ that it drops; Wampler 1986; Nakamura & Hanafusa
1986). λ rises from 0 as the least singular value falls below a threshold (Chiaverini, Siciliano & Egeland 1994, "Review
of the damped least-squares inverse kinematics", section III). W weighs radians against metres.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.sim.kernel_math import compiled
from baselines.kinematics.arm import Arm, exactly
from baselines.kinematics.chain import (
    bounded_step,
    gram_kernel,
    jacobian_kernel,
)

Array = NDArray[np.float64]

RADIAN = 0.4  # of the arm's length: what a radian weighs beside a metre


def weights(arm: Arm) -> Array:
    """Weight of each row of an error (6,): 1 for metres, RADIAN times the arm's length for radians."""
    radian = RADIAN * arm.length
    return np.array([1.0, 1.0, 1.0, radian, radian, radian])


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
        q: (n,) where it is [rad]; a joint beyond a limit moves back only, and by its step limit at most.
        twist: (6,) displacement wanted: linear [m], rotation vector [rad], axes of the base frame; or (3,), position
            alone.
        step_limits: the most that each joint may move, (n,) or one for all [rad].
        damping: λ at a singularity, as a share of the arm's length.
        threshold: least singular value below which damping begins, as a share of the arm's length.

    Raises:
        ValueError: q or the twist of another shape or not finite, or a step limit, the damping or the threshold not
            positive.
    """
    q = exactly(q, (arm.n,), "q")
    rows = 3 if np.shape(twist) == (3,) else 6
    error = np.zeros(6)
    error[:rows] = exactly(twist, (rows,), "twist")
    steps = np.full(arm.n, step_limits) if np.ndim(step_limits) == 0 else exactly(step_limits, (arm.n,), "step_limits")
    if not (np.isfinite(steps).all() and (steps > 0.0).all()):
        raise ValueError(f"step_limits: expected positive angles, got {steps.tolist()}")
    for name, value in (("damping", damping), ("threshold", threshold)):
        if not 0.0 < value < np.inf:
            raise ValueError(f"{name}: expected a positive number, got {value}")
    q_next = np.empty(arm.n)
    length = arm.length
    dls_step(
        arm.chain,
        arm.limits,
        steps,
        weights(arm),
        q,
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
        q_next: written, (n,).
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
