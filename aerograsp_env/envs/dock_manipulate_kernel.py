"""What a step means in DockManipulate, compiled: observations, true errors, rewards and figures."""

from __future__ import annotations

import math

import numpy as np

from aerograsp_env.sim.config import CONTROL_STEP
from aerograsp_env.sim.kernel_math import clip, compiled
from aerograsp_env.sim.layout import INTEGRAL_LEAK, OBSERVED_ACTIONS
from aerograsp_env.sim.manipulation import layout as lay
from aerograsp_env.sim.manipulation.kernel_arm import forward, jacobian
from aerograsp_env.sim.manipulation.kernel_rows import (
    clip_row,
    command_change,
    mishaps,
    put_gyro,
    put_heading,
    put_joint_rates,
    put_joints,
    put_lag,
    put_loads,
    put_position,
    put_rotation,
    put_tilt,
)

SUCCESS_ERROR = 0.02  # [m], mean over an episode's counted steps
SKIP = 5.0  # errors count from here [s]

RECORD = np.dtype(
    [
        ("nominal", np.float64, (3,)),  # airframe origin with the tool in its nominal docked pose, world [m]
        ("set_point", np.float64, (3,)),  # airframe origin to hold, world [m]
        ("target", np.float64, (3,)),  # for the arm's tool, world [m]
        ("error_integral", np.float64, (3,)),  # as observed
        ("distance", np.float64),  # true, arm's tool to target [m]
        ("error_sum", np.float64),
        ("error_max", np.float64),
        ("estimate_sum", np.float64),  # of the estimated tool's distance from the true one
        ("hover_sum", np.float64),
        ("count", np.int64),
        ("effort_sum", np.float64),
        ("mishaps", np.int64),
    ],
    align=True,
)
TERMS = ("position", "precision", "effort", "crash", "within")
METRICS = (
    "error", "error_max", "estimate_error", "hover", "effort", "contacts", "crash", "clamp_force_max",
)  # fmt: skip
_SKIP_STEPS = round(SKIP / CONTROL_STEP)


@compiled
def _put_in_command_frame(p, s, vector, out, k):
    """A world vector (3) in the frame of velocity commands: the world's, or turned with the estimated heading."""
    c, d = 1.0, 0.0
    if p.heading_frame == 1:
        heading = math.atan2(s.attitude[1, 0], s.attitude[0, 0])
        c, d = math.cos(heading), math.sin(heading)
    out[k], out[k + 1], out[k + 2] = c * vector[0] + d * vector[1], c * vector[1] - d * vector[0], vector[2]
    return k + 3


@compiled
def _observe(p, s, task, slots, out, bounds):
    """Writes the row in the order of DockManipulateTask.observation."""
    away = np.empty(3)
    for i in range(3):
        away[i] = task.set_point[i] - s.estimate[i]
    k = _put_in_command_frame(p, s, away, out, 0)
    for i in range(3):
        out[k + i] = task.error_integral[i]
    k = _put_in_command_frame(p, s, s.velocity_estimate, out, k + 3)
    k = put_tilt(s, out, k)
    k = put_heading(s, out, k)
    k = put_gyro(s, out, k)
    for i in range(3):
        out[k + i] = s.specific_force[i]
    for j in range(5):
        out[k + 3 + j] = s.joints[j]
    for i in range(3):
        out[k + 8 + i] = s.base_acceleration[i]
    k += 11
    for a in range(OBSERVED_ACTIONS):
        for i in range(slots.shape[0]):
            out[k] = s.commands[a, slots[i]]
            k += 1
    for i in range(3):
        out[k + i] = task.set_point[i] - task.nominal[i]
        away[i] = task.target[i] - s.estimate[i]
    k = put_joints(p, s, 0, out, k + 3)
    k = put_joint_rates(p, s, 0, out, k)
    k = put_loads(p, s, 0, out, k)
    k = put_lag(p, s, 0, out, k)
    k = put_position(s.tool[0], out, k)
    k = put_rotation(s.tool[0], out, k)
    for j in range(3):
        out[k + j] = s.attitude[0, j] * away[0] + s.attitude[1, j] * away[1] + s.attitude[2, j] * away[2]
    clip_row(out, bounds)


@compiled
def _account(p, s, task, terms, metrics, flags):
    """True errors, rewards, figures so far."""
    distance, believed, hover = 0.0, 0.0, 0.0
    for i in range(3):
        true, estimated = s.position[i], s.estimate[i]
        for j in range(3):
            true += s.rotation[i, j] * s.true_tool[0, j, 3]
            estimated += s.attitude[i, j] * s.tool[0, j, 3]
        distance += (task.target[i] - true) ** 2
        believed += (estimated - true) ** 2
        hover += (task.set_point[i] - s.position[i]) ** 2
    distance, believed, hover = math.sqrt(distance), math.sqrt(believed), math.sqrt(hover)
    change = command_change(s)
    task.distance = distance
    task.effort_sum += change
    task.mishaps += 1 if mishaps(s) else 0
    if s.step > _SKIP_STEPS:
        task.error_sum += distance
        task.error_max = max(task.error_max, distance)
        task.estimate_sum += believed
        task.hover_sum += hover
        task.count += 1
    crashed = s.termination != lay.RUNNING
    terms[0] = 0.5 * max(1.0 - 0.9 * distance / 0.5, 0.0)
    terms[1] = 0.5 / (1.0 + 9.0 * (distance / SUCCESS_ERROR) ** 2)
    terms[2] = -0.2 * min(change, 4.0)
    terms[3] = -10.0 if crashed else 0.0
    terms[4] = 1.0 if distance <= SUCCESS_ERROR and not crashed else 0.0
    count = max(task.count, 1)
    metrics[0], metrics[1], metrics[2] = task.error_sum / count, task.error_max, task.estimate_sum / count
    metrics[3], metrics[4] = task.hover_sum / count, math.sqrt(task.effort_sum / s.step)
    metrics[5], metrics[6], metrics[7] = task.mishaps, 1.0 if crashed else 0.0, s.clamp_force_max
    flags[0] = task.count > 0 and metrics[0] <= SUCCESS_ERROR and not crashed
    flags[1] = crashed
    flags[2] = task.count > 0


@compiled
def evaluate(
    parameters, states, records, noise, cursors, active, stepped, bounds, slots, observations, terms, metrics, flags,
    first, last,
):  # fmt: skip
    """Writes the worlds' rows; see `Task`."""
    for n in range(first, last):
        if not active[n]:
            continue
        p, s, task = parameters[n], states[n], records[n]
        if stepped:
            for i in range(3):  # of what was observed until now: a row starts with the position error
                task.error_integral[i] = clip(
                    INTEGRAL_LEAK * task.error_integral[i] + observations[n, i] * CONTROL_STEP,
                    -bounds[3 + i],
                    bounds[3 + i],
                )
            _account(p, s, task, terms[n], metrics[n], flags[n])
        _observe(p, s, task, slots, observations[n], bounds)


@compiled
def reached(p, q, position):
    """Writes the tool's place (3,), body frame, at q (n,); returns its Jacobian's least singular value [m/rad]."""
    n = q.shape[0]
    poses, tool, j = np.empty((lay.JOINTS, 4, 4)), np.empty((4, 4)), np.empty((6, lay.JOINTS))
    padded = np.zeros(lay.JOINTS)
    padded[:n] = q
    forward(p, 0, padded, poses, tool)
    jacobian(p, 0, poses, tool, j)
    gram = np.zeros((3, 3))
    for a in range(3):
        position[a] = tool[a, 3]
        for b in range(3):
            for i in range(n):
                gram[a, b] += j[a, i] * j[b, i]
    return math.sqrt(max(np.linalg.eigvalsh(gram)[0], 0.0))
