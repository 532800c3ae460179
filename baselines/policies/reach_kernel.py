"""Compiled parts of the reaching policy: one control step of any number of rows.

Axes: "level" axes are the body's without roll and pitch; they turn with the vehicle from where it headed when the
episode began, as the gyroscope tells. Places in them are counted from where the vehicle was then, as its velocity
estimate tells: dead reckoning, good enough for the fractions of a second over which it is used.
"""

from __future__ import annotations

import math

import numpy as np

from aerograsp_env.sim.kernel_math import clip, compiled
from baselines.kinematics.chain import bounded_step, forward_kernel, gram_kernel, jacobian_kernel
from baselines.kinematics.dls import least_singular_value
from baselines.policies.reach_state import PAST

SEARCH_STEP, SEARCH_STEPS = 0.3, 60  # [rad] of a joint at most, and how many
FOUND = 0.001  # [m] from the point at most
NEAR_LIMIT = 0.5  # [rad] from a limit at which a configuration begins to be worse
AGILE = 0.3  # least singular value below which a configuration begins to be worse, as a share of the arm's length
WAY_COST = 0.3  # [1/rad] of the way there, beside 1 for a limit or a singularity
STUCK, STUCK_STEPS = 0.01, 15  # [m] off the point for so many control steps: another configuration is looked for
MOVED = 1.0  # [rad²/s²] sum of squared rates over control steps from which on a delay shows
FOLLOWING_ERROR = 0.35  # [rad] servos' set-points stay this near to their joints


@compiled
def level_from_body(roll, pitch, heading, out):
    """R_level_body (3, 3) = Rz(heading) Ry(pitch) Rx(roll)."""
    cr, sr, cp, sp, ch, sh = (
        math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch), math.cos(heading), math.sin(heading),
    )  # fmt: skip
    out[0, 0], out[0, 1], out[0, 2] = ch * cp, ch * sp * sr - sh * cr, ch * sp * cr + sh * sr
    out[1, 0], out[1, 1], out[1, 2] = sh * cp, sh * sp * sr + ch * cr, sh * sp * cr - ch * sr
    out[2, 0], out[2, 1], out[2, 2] = -sp, cp * sr, cp * cr


@compiled
def alpha_beta(interval, acceleration, noise, seen):
    """Gains (of position, and of velocity times the interval) of a constant-velocity filter.

    The steady ones follow from the tracking index acceleration · interval² / noise (Kalata 1984, "The tracking index"),
    and the first ones are those of a straight line's least-squares fit to the `seen` estimates.
    """
    index = acceleration * interval * interval / noise
    r = 0.25 * (4.0 + index - math.sqrt(8.0 * index + index * index))
    alpha = 1.0 - r * r
    beta = 2.0 * (2.0 - alpha) - 4.0 * math.sqrt(1.0 - alpha)
    k = float(seen)  # 1 with the first one after the start's
    return max(alpha, (4.0 * k + 2.0) / ((k + 1.0) * (k + 2.0))), max(beta, 6.0 / ((k + 1.0) * (k + 2.0)))


@compiled
def _command_delay(s, q, lag):
    """How late commands arrive [s]: how far the servos' set-points are behind those given, by least squares."""
    for i in range(q.shape[0]):
        s.behind += (s.command[i] - q[i] - lag[i]) * s.rate[i]
        s.moved += s.rate[i] ** 2
    return max(s.behind, 0.0) / (s.moved + MOVED)


@compiled
def _dead_reckon(s, step, velocity, gyro, roll, pitch, rotation):
    """Own motion in the step that has ended; writes R_level_body (3, 3)."""
    s.heading += step * (math.sin(roll) * gyro[1] + math.cos(roll) * gyro[2]) / math.cos(pitch)
    level_from_body(roll, pitch, s.heading, rotation)
    now = s.past[s.step % PAST]
    for i in range(3):
        s.place[i] += step * (
            rotation[i, 0] * velocity[0] + rotation[i, 1] * velocity[1] + rotation[i, 2] * velocity[2]
        )
        now[3, i] = s.place[i]
        for j in range(3):
            now[i, j] = rotation[i, j]


@compiled
def _track(settings, s, step, age, goal):
    """The filter of the point's place and velocity, which lives at the time that it was last seen."""
    fresh = s.seen == 0 or age < s.age + 0.5 * step
    if fresh:
        back = min(round(age / step), PAST - 1, s.step)
        then = s.past[(s.step - back) % PAST]
        interval = s.age + step - age
        alpha, beta = 1.0, 0.0
        if s.seen > 0:
            noise = settings.noise if age > 0.5 * step else settings.exact_noise
            alpha, beta = alpha_beta(interval, settings.acceleration, noise, s.seen)
        for i in range(3):
            seen = then[3, i] + then[i, 0] * goal[0] + then[i, 1] * goal[1] + then[i, 2] * goal[2]
            guess = s.point[i] + s.velocity[i] * interval
            s.point[i] = seen if s.seen == 0 else guess + alpha * (seen - guess)
            if s.seen > 0:
                s.velocity[i] += beta / interval * (seen - guess)
        s.seen += 1
    s.age = age


@compiled
def _seen_from_body(s, rotation, velocity, gyro, point, drift):
    """The point as it is now (3,), and how it moves relative to the body (3,), body axes: Rᵀv − v_b − ω × p."""
    for i in range(3):
        point[i] = drift[i] = 0.0
        for j in range(3):
            point[i] += rotation[j, i] * (s.point[j] + s.velocity[j] * s.age - s.place[j])
            drift[i] += rotation[j, i] * s.velocity[j]
    x, y, z = point[0], point[1], point[2]
    drift[0] -= velocity[0] + gyro[1] * z - gyro[2] * y
    drift[1] -= velocity[1] + gyro[2] * x - gyro[0] * z
    drift[2] -= velocity[2] + gyro[0] * y - gyro[1] * x


@compiled
def _damped_step(chain, length, settings, q, away, twist, limits, step_limits, q_next):
    """One damped least-squares step of q (n,) by the displacement `twist` (6,), of which the first three count.

    What the displacement leaves free moves joints the share `away` of the way out of their limits' neighbourhood.
    """
    n = q.shape[0]
    tool, jacobian, weights = np.empty((3, 4)), np.empty((6, n)), np.ones(6)
    gram, gradient = np.empty((n, n)), np.empty(n)
    jacobian_kernel(chain, q, tool, jacobian)
    gram_kernel(jacobian, twist, weights, 3, gram, gradient)
    threshold, damping = settings.threshold * length, settings.damping * length
    sigma = least_singular_value(jacobian, weights, 3)
    squared = settings.posture_weight**2
    for i in range(n):
        low, high = NEAR_LIMIT - (q[i] - limits[i, 0]), NEAR_LIMIT - (limits[i, 1] - q[i])
        gradient[i] += squared * away * (clip(low, 0.0, NEAR_LIMIT) - clip(high, 0.0, NEAR_LIMIT))
    if sigma < threshold:
        squared += (1.0 - (sigma / threshold) ** 2) * damping * damping
    bounded_step(gram, gradient, squared, q, limits, step_limits, q_next)
    return sigma


@compiled
def find_goal(chain, length, settings, limits, seeds, point, offset, q_now, q_goal):
    """The best configuration with the tool at `point` (3,), of those that damped steps from `seeds` (K, n) end in.

    Best is what is near to q_now (n,), measured by the joint that has the longest way, and far from limits and
    singularities. `offset` (3,) takes the chain's places to those of `point`. Writes q_goal (n,) and returns True,
    or returns False where none reaches the point.
    """
    n = q_now.shape[0]
    q, q_next, tool, twist, steps = np.empty(n), np.empty(n), np.empty((3, 4)), np.zeros(6), np.full(n, SEARCH_STEP)
    least = np.inf
    for k in range(seeds.shape[0] + 1):
        q[:] = q_now if k == 0 else seeds[k - 1]
        sigma, distance = 0.0, np.inf
        for iteration in range(SEARCH_STEPS):
            forward_kernel(chain, q, tool)
            distance = 0.0
            for i in range(3):
                twist[i] = point[i] - offset[i] - tool[i, 3]
                distance += twist[i] ** 2
            distance = math.sqrt(distance)
            if iteration >= SEARCH_STEPS // 2 and distance < FOUND:
                break
            sigma = _damped_step(chain, length, settings, q, 0.5, twist, limits, steps, q_next)
            q[:] = q_next
        if distance >= FOUND:
            continue
        way, near = 0.0, 0.0
        for i in range(n):
            way = max(way, abs(q[i] - q_now[i]))
            near = max(near, 1.0 - min(q[i] - limits[i, 0], limits[i, 1] - q[i]) / NEAR_LIMIT)
        cost = WAY_COST * way + near + max(1.0 - sigma / (AGILE * length), 0.0)
        if cost < least:
            least = cost
            q_goal[:] = q
    return least < np.inf


@compiled
def _advance_goal(chain, limits, length, settings, gain, s, step, offset, point, drift, q_next):
    """One damped step of the goal configuration (n,) to the `point`, which moves by `drift`; returns its distance."""
    n = q_next.shape[0]
    q, tool, twist = s.goal[:n], np.empty((3, 4)), np.zeros(6)
    forward_kernel(chain, q, tool)
    distance = 0.0
    for i in range(3):
        error = point[i] - offset[i] - tool[i, 3]
        twist[i] = step * (gain * error + drift[i])
        distance += error * error
    away = settings.posture_gain * step
    _damped_step(chain, length, settings, q, away, twist, limits, np.full(n, SEARCH_STEP), q_next)
    return math.sqrt(distance)


@compiled
def _advance_reference(settings, gain, s, step, rate_limits, q_goal, q_next):
    """The reference goes along with the goal configuration and closes in on it, all joints slowed down alike."""
    shrink = 1.0
    for i in range(q_next.shape[0]):
        q_next[i] = q_goal[i] - s.goal[i] + gain * step * (s.goal[i] - s.reference[i])
        shrink = min(shrink, settings.share * rate_limits[i] * step / max(abs(q_next[i]), 1e-12))
    for i in range(q_next.shape[0]):
        q_next[i] = s.reference[i] + shrink * q_next[i]


@compiled
def servo_rows(
    chain, limits, seeds, servo_time, rate_limits, length, joint_rate, settings, feedforward, step, rows, tools,
    goals, states, actions,
):  # fmt: skip
    """One control step of every row: writes `states` (N,) and `actions` (N, n)."""
    n = limits.shape[0]
    rotation, point, drift, offset = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(3)
    tool, q_goal, q_next = np.empty((3, 4)), np.empty(n), np.empty(n)
    for row in range(rows.shape[0]):
        s, o = states[row], rows[row]
        q, rates, lag = o[:n], o[n : 2 * n], o[2 * n : 3 * n]
        velocity, gyro = o[3 * n : 3 * n + 3], o[3 * n + 3 : 3 * n + 6]
        roll, pitch, age = o[3 * n + 6], o[3 * n + 7], o[3 * n + 8]
        fresh = s.started == 0
        if fresh:
            s.started, s.step, s.seen, s.stuck, s.heading, s.age = 1, 0, 0, 0, 0.0, age
            s.place[:] = 0.0
            s.velocity[:] = 0.0
            s.rotation[:] = 0.0
            s.rate[:] = 0.0
            s.behind, s.moved, s.delay = 0.0, 0.0, 0.0
            for i in range(n):
                s.goal[i], s.reference[i], s.command[i], s.sag[i] = q[i], q[i], q[i] + lag[i], lag[i]
        else:
            s.step += 1
        gain, low_pass = settings.gain, settings.rotation_time
        if feedforward:
            s.delay = _command_delay(s, q, lag)
            gain = min(gain, settings.delay_margin / max(s.delay, 1e-3))
            low_pass = max(low_pass, settings.rotation_delays * s.delay)
        _dead_reckon(s, step, velocity, gyro, roll, pitch, rotation)
        for i in range(3):
            s.rotation[i] += step / (low_pass + step) * (gyro[i] - s.rotation[i])
        if feedforward:
            _track(settings, s, step, age, goals[row])
            _seen_from_body(s, rotation, velocity, s.rotation, point, drift)
        else:
            point[:] = goals[row]
            drift[:] = 0.0
        # the tool by the encoders is where the body's frame has it, wherever the arm is mounted
        forward_kernel(chain, q, tool)
        for i in range(3):
            offset[i] = tools[row, i] - tool[i, 3]
        if fresh or s.stuck >= STUCK_STEPS:
            s.stuck = 0
            if find_goal(chain, length, settings, limits, seeds, point, offset, s.reference[:n], q_goal):
                s.goal[:n] = q_goal
        off = _advance_goal(chain, limits, length, settings, gain, s, step, offset, point, drift, q_goal)
        s.stuck = s.stuck + 1 if off > STUCK else 0
        _advance_reference(settings, gain, s, step, rate_limits, q_goal, q_next)
        for i in range(n):
            s.sag[i] += settings.sag_gain * (s.command[i] - q[i] - servo_time[i] * rates[i] - s.sag[i])
            moving = (q_next[i] - s.reference[i]) / step
            wanted = q_next[i] + servo_time[i] * moving + s.sag[i]
            rate = clip((wanted - s.command[i]) / step, -rate_limits[i], rate_limits[i])
            command = clip(s.command[i] + step * rate, q[i] - FOLLOWING_ERROR, q[i] + FOLLOWING_ERROR)
            command = clip(command, limits[i, 0], limits[i, 1])
            s.rate[i] = (command - s.command[i]) / step
            s.command[i] = command
            s.goal[i], s.reference[i] = q_goal[i], q_next[i]
            actions[row, i] = clip(rate / joint_rate, -1.0, 1.0)
