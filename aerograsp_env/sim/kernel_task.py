"""What a control step means for the task, compiled: errors, rewards, success, and the approach to the seat."""

from __future__ import annotations

import math

from aerograsp_env.sim import layout as lay
from aerograsp_env.sim.kernel_math import clip, compiled

# reward terms, see envs/dock.py: "within" alone makes the sparse reward, the others the dense one
TERMS = ("position", "precision", "approach", "effort", "crash", "within")
_POSITION, _PRECISION, _APPROACH, _EFFORT, _CRASH, _WITHIN = range(len(TERMS))
METRICS = (
    "error", "error_x", "error_y", "error_z", "bias_x", "bias_y", "bias_z", "std_x", "std_y", "std_z",
    "effort", "crash", "clamp_force_max",
)  # fmt: skip
SUCCESS_ERROR = 0.05  # [m] per axis


@compiled
def bookkeeping(p, s, qpos):
    """True error about the set-point, its sums, and leaving the arena."""
    distance = 0.0
    for i in range(3):
        e = p.set_point[i] - qpos[i]
        s.true_error[i] = e
        distance += e * e
        s.held[i, s.step % p.settle_steps] = abs(e)
        if s.step >= p.skip_steps:
            s.error_sum[i] += abs(e)
            s.error_signed[i] += e
            s.error_squared[i] += e * e
    if s.step >= p.skip_steps:
        s.error_count += 1
    for i in range(5):
        d = s.actions[0, i] - s.actions[1, i]
        s.effort_sum += d * d
    if s.termination == lay.RUNNING and (distance > p.bound * p.bound or qpos[2] < 0.2):
        s.termination = lay.OUT_OF_BOUNDS
    return math.sqrt(distance)


@compiled
def reward(p, s, distance, seat_distance, terms):
    """Bounded terms, see the reward table in envs/dock.py."""
    at_work = 1.0 if p.attach == 0 or s.coupled == 1 else 0.0
    terms[_POSITION] = at_work * 0.5 * max(1.0 - 0.9 * distance / 0.20, 0.0)
    terms[_PRECISION] = at_work * 0.5 / (1.0 + 9.0 * (distance / 0.02) ** 2)
    terms[_APPROACH] = 0.0
    if p.attach == 1:
        terms[_APPROACH] = 0.3 if s.coupled == 1 else 0.3 / (1.0 + 9.0 * seat_distance**2)
    change = 0.0
    for i in range(5):
        d = s.actions[0, i] - s.actions[1, i]
        change += d * d
    terms[_EFFORT] = -0.2 * min(change, 4.0)


@compiled
def summarize(p, s, terms, metrics, flags):
    """What depends on how the step ended: crash and sparse terms, the figures so far, (success, terminated)."""
    crashed = s.termination != lay.RUNNING
    terms[_CRASH] = -10.0 if crashed else 0.0
    count = max(s.error_count, 1)
    within, held = not crashed, not crashed
    total = 0.0
    for i in range(3):
        mean_abs, bias = s.error_sum[i] / count, s.error_signed[i] / count
        total += mean_abs / 3.0
        metrics[1 + i], metrics[4 + i] = mean_abs, bias
        metrics[7 + i] = math.sqrt(max(s.error_squared[i] / count - bias * bias, 0.0))
        within = within and abs(s.true_error[i]) <= SUCCESS_ERROR
        if p.attach == 1:
            mean_abs = 0.0
            for k in range(p.settle_steps):
                mean_abs += s.held[i, k] / p.settle_steps
        held = held and mean_abs <= SUCCESS_ERROR
    metrics[0] = total
    metrics[10] = math.sqrt(s.effort_sum / max(s.step, 1))
    metrics[11] = 1.0 if crashed else 0.0
    metrics[12] = s.clamp_force_max
    if p.attach == 1:
        within = within and s.coupled == 1
        held = held and s.coupled == 1 and s.step - s.coupled_step >= p.settle_steps
    terms[_WITHIN] = 1.0 if within else 0.0
    flags[0] = held and s.error_count > 0
    flags[1] = crashed


@compiled
def approach(p, s, xpos, xmat, qvel, seat_offset):
    """Vector base → seat as truth and as the vehicle estimates it; asks for coupling when the base lies in the seat."""
    distance = 0.0
    for i in range(3):
        gap = p.seat_position[i] - xpos[3 * p.base_body + i]
        distance += gap * gap
        seat_offset[i] = gap - s.source_error[i]
    distance = math.sqrt(distance)
    along = 0.0  # cosine between the base's axes and the seat's: trace
    for i in range(3):
        for j in range(3):
            along += p.seat_rotation[i, j] * xmat[p.base_body, 3 * i + j]
    angle = math.acos(clip(0.5 * (along - 1.0), -1.0, 1.0))
    speed = math.sqrt(qvel[0] ** 2 + qvel[1] ** 2 + qvel[2] ** 2)
    near = distance < p.couple_distance and angle < p.couple_angle and speed < p.couple_speed
    s.wants_coupling = 1 if near and s.coupled == 0 and s.actions[0, 4] > 0.0 else 0
    return distance
