"""Compiled kernels of serial chains of revolute joints, on plain arrays: poses, Jacobians, pose errors, damped steps.

A chain is one array (n + 1, 3, 4): the upper rows of the transforms from each joint's frame (after its rotation) to the
next joint's, and last to the tool; every joint turns about the z axis of its own frame. `Arm.chain` makes it. The
kernels write into arrays that the caller gives and check nothing: `Arm` and `solve_ik` do.
"""

from __future__ import annotations

import math

import numpy as np

from aerograsp_env.sim.kernel_math import compiled

POSE, POSITION, POSITION_ROLL = 0, 1, 2
ROWS = {POSE: 6, POSITION: 3, POSITION_ROLL: 4}
"""Rows of the error and of the Jacobian that each task uses."""


@compiled
def frames_kernel(chain, q, frames, tool):
    """Each joint's frame (n, 3, 4) after its rotation, and the tool's (3, 4)."""
    n = q.shape[0]
    for i in range(n + 1):
        out = frames[i] if i < n else tool
        if i == 0:
            out[:3] = chain[0]
        else:
            before, step = frames[i - 1], chain[i]
            for r in range(3):
                a, b, c = before[r, 0], before[r, 1], before[r, 2]
                for k in range(4):
                    out[r, k] = a * step[0, k] + b * step[1, k] + c * step[2, k]
                out[r, 3] += before[r, 3]
        if i < n:
            sine, cosine = math.sin(q[i]), math.cos(q[i])
            for r in range(3):
                x, y = out[r, 0], out[r, 1]
                out[r, 0] = cosine * x + sine * y
                out[r, 1] = cosine * y - sine * x


@compiled
def columns_kernel(frames, tool, jacobian):
    """The tool's geometric Jacobian (6, n) from `frames_kernel`'s results: linear rows first, base axes."""
    for i in range(frames.shape[0]):
        x, y, z = frames[i, 0, 2], frames[i, 1, 2], frames[i, 2, 2]
        dx, dy, dz = tool[0, 3] - frames[i, 0, 3], tool[1, 3] - frames[i, 1, 3], tool[2, 3] - frames[i, 2, 3]
        jacobian[0, i], jacobian[1, i], jacobian[2, i] = y * dz - z * dy, z * dx - x * dz, x * dy - y * dx
        jacobian[3, i], jacobian[4, i], jacobian[5, i] = x, y, z


@compiled
def forward_kernel(chain, q, tool):
    """The tool's pose (3, 4) at q (n,)."""
    frames_kernel(chain, q, np.empty((q.shape[0], 3, 4)), tool)


@compiled
def jacobian_kernel(chain, q, tool, jacobian):
    """The tool's pose (3, 4) and its Jacobian (6, n) at q (n,)."""
    frames = np.empty((q.shape[0], 3, 4))
    frames_kernel(chain, q, frames, tool)
    columns_kernel(frames, tool, jacobian)


@compiled
def pose_error_kernel(tool, target, error):
    """Twist (6,) that would take the tool (3, 4) to the target: linear, then the rotation vector, in base axes."""
    for r in range(3):
        error[r] = target[r, 3] - tool[r, 3]
    # R = R_target R_toolᵀ: sin θ times the axis from its antisymmetric part, cos θ from its trace
    x = y = z = 0.0
    trace = 0.0
    for k in range(3):
        a0, a1, a2 = target[0, k], target[1, k], target[2, k]
        b0, b1, b2 = tool[0, k], tool[1, k], tool[2, k]
        x += a2 * b1 - a1 * b2
        y += a0 * b2 - a2 * b0
        z += a1 * b0 - a0 * b1
        trace += a0 * b0 + a1 * b1 + a2 * b2
    x, y, z, cosine = 0.5 * x, 0.5 * y, 0.5 * z, 0.5 * (trace - 1.0)
    sine = math.sqrt(x * x + y * y + z * z)
    angle = math.atan2(sine, cosine)
    if sine > 1e-6:
        scale = angle / sine
    elif cosine > 0.0:
        scale = 1.0
    else:  # half a turn: R + I = 2 a aᵀ, whose longest column is along the axis
        best = -1.0
        for j in range(3):
            column = np.empty(3)
            for r in range(3):
                column[r] = 1.0 if r == j else 0.0
                for k in range(3):
                    column[r] += target[r, k] * tool[j, k]
            length = math.sqrt(column[0] ** 2 + column[1] ** 2 + column[2] ** 2)
            if length > best:
                best = length
                sign = 1.0 if column[0] * x + column[1] * y + column[2] * z >= 0.0 else -1.0
                error[3], error[4], error[5] = (
                    sign * angle * column[0] / length,
                    sign * angle * column[1] / length,
                    sign * angle * column[2] / length,
                )
        return
    error[3], error[4], error[5] = scale * x, scale * y, scale * z


@compiled
def roll_kernel(tool, target, row):
    """The target's roll about the approach axis z as seen from the tool [rad], and the gradient of its decrease.

    The target's rotation seen from the tool is a smallest rotation that aligns the z axes, after a turn about z: that
    turn (swing and twist, Dobrowolski 2015, "Swing-twist decomposition in Clifford algebra"). `row` (3,) times the
    tool's angular velocity, base axes, is the rate at which it falls.
    """
    r00 = r01 = r10 = r11 = r02 = r12 = r22 = 0.0
    for k in range(3):
        r00 += tool[k, 0] * target[k, 0]
        r01 += tool[k, 0] * target[k, 1]
        r02 += tool[k, 0] * target[k, 2]
        r10 += tool[k, 1] * target[k, 0]
        r11 += tool[k, 1] * target[k, 1]
        r12 += tool[k, 1] * target[k, 2]
        r22 += tool[k, 2] * target[k, 2]
    weight = 1.0 / max(1.0 + r22, 1e-9)
    for k in range(3):
        row[k] = tool[k, 2] + weight * (r02 * tool[k, 0] + r12 * tool[k, 1])
    return math.atan2(r10 - r01, r00 + r11)


@compiled
def task_kernel(task, tool, target, jacobian, error):
    """Error (6,) of the task in its first rows, `jacobian` (6, n) brought to those rows; returns how many there are."""
    pose_error_kernel(tool, target, error)
    if task == POSE:
        return 6
    if task == POSITION:
        return 3
    row = np.empty(3)
    error[3] = roll_kernel(tool, target, row)
    for i in range(jacobian.shape[1]):
        jacobian[3, i] = row[0] * jacobian[3, i] + row[1] * jacobian[4, i] + row[2] * jacobian[5, i]
    return 4


@compiled
def solve_damped(gram, gradient, damping, free, step):
    """(gram + damping I) step = gradient over the joints that are `free`, by Cholesky; the others' step is 0."""
    n = gradient.shape[0]
    lower = np.empty((n, n))
    for i in range(n):
        if not free[i]:
            step[i] = 0.0
            continue
        value = gradient[i]
        for j in range(i):
            if free[j]:
                total = gram[i, j]
                for k in range(j):
                    if free[k]:
                        total -= lower[i, k] * lower[j, k]
                lower[i, j] = total * lower[j, j]
                value -= lower[i, j] * step[j]
        total = gram[i, i] + damping
        for k in range(i):
            if free[k]:
                total -= lower[i, k] ** 2
        lower[i, i] = 1.0 / math.sqrt(max(total, 1e-300))  # the inverse of the diagonal is what is needed
        step[i] = value * lower[i, i]
    for i in range(n - 1, -1, -1):
        if free[i]:
            value = step[i]
            for j in range(i + 1, n):
                if free[j]:
                    value -= lower[j, i] * step[j]
            step[i] = value * lower[i, i]


@compiled
def bounded_step(gram, gradient, damping, q, limits, step_limits, q_next):
    """Where a damped step takes q (n,), shortened as a whole until no joint moves by more than its step limit.

    A joint that stands at a limit and would leave it is blocked and the rest solved again, so that the others take over
    its part; one that would overshoot a limit is stopped there. Returns whether any joint moved.
    """
    n = q.shape[0]
    free = np.ones(n, np.bool_)
    for _ in range(n):
        solve_damped(gram, gradient, damping, free, q_next)
        again = False
        for i in range(n):
            step = q_next[i]
            if free[i] and ((step < 0.0 and q[i] <= limits[i, 0]) or (step > 0.0 and q[i] >= limits[i, 1])):
                free[i] = False
                again = True
        if not again:
            break
    shrink = 1.0
    for i in range(n):
        if abs(q_next[i]) * shrink > step_limits[i]:
            shrink = step_limits[i] / abs(q_next[i])
    moved = False
    for i in range(n):
        low, high = min(q[i], limits[i, 0]), max(q[i], limits[i, 1])  # one that is beyond a limit does not jump
        q_next[i] = min(max(q[i] + shrink * q_next[i], low), high) if free[i] else q[i]
        moved |= q_next[i] != q[i]
    return moved


@compiled
def gram_kernel(jacobian, error, weights, rows, gram, gradient):
    """JᵀW²J (n, n) and JᵀW²e (n,) over the first `rows` rows, each weighted by weights[row]."""
    n = gradient.shape[0]
    for i in range(n):
        total = 0.0
        for r in range(rows):
            total += jacobian[r, i] * weights[r] * weights[r] * error[r]
        gradient[i] = total
        for j in range(i + 1):
            total = 0.0
            for r in range(rows):
                total += jacobian[r, i] * weights[r] * weights[r] * jacobian[r, j]
            gram[i, j] = gram[j, i] = total
