"""One control step of any number of docking worlds, compiled: autopilot, air, MuJoCo, sensors, errors and rewards.

A control step is `SUBSTEPS` physics ticks of autopilot → rotors → mj_step. MuJoCo is called through its C pointer, so
no tick costs a line of Python, and worlds are independent, so that any slice of them can be stepped from any thread.
"""

from __future__ import annotations

import math

import numpy as np
from numba import carray

from aerograsp_env.sim import layout as lay
from aerograsp_env.sim.kernel_control import autopilot, rotors
from aerograsp_env.sim.kernel_math import as_pointer, call_with_two_pointers, clip, compiled
from aerograsp_env.sim.kernel_sensors import advance_slow, read_base, read_imu, read_position, sample_joints
from aerograsp_env.sim.kernel_task import approach, bookkeeping, reward, summarize
from aerograsp_env.sim.scene import TIMESTEP


@compiled
def delayed_command(p, s, tick):
    """Which remembered action reaches the autopilot at this tick: −1 where none was given yet."""
    age = tick - p.delay_ticks  # of the newest action this tick may use, relative to this control step's start
    back = 0 if age >= 0 else (-age + lay.SUBSTEPS - 1) // lay.SUBSTEPS
    return back if back <= s.step else -1


@compiled
def estimated_attitude(s, xmat, r):
    """r = (I + [δ]×) R: the true attitude turned by the small error δ (world frame)."""
    d = s.attitude_error
    for j in range(3):
        a, b, c = xmat[j], xmat[3 + j], xmat[6 + j]
        r[0, j] = a - d[2] * b + d[1] * c
        r[1, j] = b + d[2] * a - d[0] * c
        r[2, j] = c - d[1] * a + d[0] * b


@compiled
def stops(p, s, qpos, qvel, qfrc):
    """Torques of the printed stops at the mechanical limits, and of the servo that locks θ0 in flight.

    A stop bent too far breaks. Limits count for a coupled tool, and once every joint has been within its signal range.
    """
    inside = True
    for j in range(5):
        a = p.joint_address[j]
        q, low, high = qpos[a], p.mechanical_limits[j, 0], p.mechanical_limits[j, 1]
        torque, bend = 0.0, 0.0
        if q < low or q > high:
            bend = q - (low if q < low else high)
            torque = -p.stop_stiffness * bend - p.stop_damping * qvel[a - 1]
            if s.armed == 1 and abs(bend) > p.stop_give:
                s.termination = lay.JOINT_LIMIT
        inside = inside and p.signal_limits[j, 0] <= q <= p.signal_limits[j, 1]
        qfrc[a - 1] = torque
    if inside and s.coupled == 1:
        s.armed = 1
    if s.locked == 1:
        a = p.joint_address[0]
        hold = -p.lock_stiffness * qpos[a] - 0.01 * p.lock_stiffness * qvel[a - 1]
        qfrc[a - 1] += clip(hold, -p.lock_torque, p.lock_torque)


@compiled
def _physics(step_function, pointers, p, s, noise):
    """The ticks of one control step."""
    model, data = pointers[lay.P_MODEL], pointers[lay.P_DATA]
    qpos = carray(as_pointer(pointers[lay.P_QPOS]), (13,), np.float64)
    qvel = carray(as_pointer(pointers[lay.P_QVEL]), (12,), np.float64)
    ctrl = carray(as_pointer(pointers[lay.P_CTRL]), (6,), np.float64)
    xfrc = carray(as_pointer(pointers[lay.P_XFRC]), (p.airframe_body + 1, 6), np.float64)[p.airframe_body]
    qfrc = carray(as_pointer(pointers[lay.P_QFRC]), (12,), np.float64)
    xmat = carray(as_pointer(pointers[lay.P_XMAT]), (p.base_body + 1, 9), np.float64)
    clamp = carray(as_pointer(pointers[lay.P_SENSOR]), (3,), np.float64)
    truth, r = np.empty((3, 3)), np.empty((3, 3))
    set_point, thrusts = np.zeros(3), np.zeros(6)
    gyro_noise = noise[lay.SLOW_NOISE :]
    joint_noise = noise[lay.SLOW_NOISE + lay.GYRO_NOISE :]
    s.joints[:] = 0.0
    samples = 0
    for tick in range(lay.SUBSTEPS):
        w, x, y, z = qpos[3], qpos[4], qpos[5], qpos[6]
        n = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
        w, x, y, z = w * n, x * n, y * n, z * n
        truth[0, 0], truth[0, 1], truth[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
        truth[1, 0], truth[1, 1], truth[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
        truth[2, 0], truth[2, 1], truth[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
        estimated_attitude(s, truth.ravel(), r)
        for i in range(3):
            s.gyro[i] = qvel[3 + i] + s.gyro_bias[i] + p.gyro_std * gyro_noise[3 * tick + i]
            s.velocity_estimate[i] = qvel[i] + s.velocity_error[i]
        back = delayed_command(p, s, tick)
        yaw_rate = 0.0
        set_point[:] = 0.0
        if back >= 0:
            for i in range(3):
                set_point[i] = p.velocity_limit[i] * s.actions[back, i]
            yaw_rate = p.yaw_rate_limit * s.actions[back, 3]
        if p.heading_frame == 1:
            h = math.atan2(r[1, 0], r[0, 0])
            a, b = set_point[0], set_point[1]
            set_point[0], set_point[1] = math.cos(h) * a - math.sin(h) * b, math.sin(h) * a + math.cos(h) * b
        autopilot(p, s, r, set_point, yaw_rate, thrusts)
        rotors(p, s, truth, qpos, qvel, thrusts, ctrl, xfrc)
        stops(p, s, qpos, qvel, qfrc)
        call_with_two_pointers(step_function, model, data)
        samples = sample_joints(p, s, qpos, qvel, tick, joint_noise, samples)
        if s.coupled == 1:
            force = math.sqrt(clamp[0] ** 2 + clamp[1] ** 2 + clamp[2] ** 2)
            s.clamp_force_max = max(s.clamp_force_max, force)
            if force > p.overload_force:
                s.termination = lay.OVERLOAD
    for i in range(13):
        if not math.isfinite(qpos[i]):
            s.termination = lay.DIVERGED
    return xmat


@compiled
def observe(p, s, r, specific_force, seat_offset, out):
    """Writes the flat observation row in the order of layout.DOCK_OBSERVATION (or ATTACH_OBSERVATION), unclipped."""
    ch, sh = 1.0, 0.0
    if p.heading_frame == 1:
        h = math.atan2(r[1, 0], r[0, 0])
        ch, sh = math.cos(h), math.sin(h)
    e0, e1 = p.set_point[0] - s.estimate[0], p.set_point[1] - s.estimate[1]
    out[0], out[1], out[2] = ch * e0 + sh * e1, -sh * e0 + ch * e1, p.set_point[2] - s.estimate[2]
    for i in range(3):
        out[3 + i] = s.error_integral[i]
        out[12 + i] = s.gyro[i]
        out[15 + i] = specific_force[i]
        out[23 + i] = s.base_acceleration[i]
    v0, v1 = s.velocity_estimate[0], s.velocity_estimate[1]
    out[6], out[7], out[8] = ch * v0 + sh * v1, -sh * v0 + ch * v1, s.velocity_estimate[2]
    out[9] = math.atan2(r[2, 1], r[2, 2])
    out[10] = math.asin(clip(-r[2, 0], -1.0, 1.0))
    out[11] = math.atan2(r[1, 0], r[0, 0])
    for j in range(5):
        out[18 + j] = s.joints[j]
    width = 5 if p.attach == 1 else 3
    k = 26
    for a in range(lay.OBSERVED_ACTIONS):
        for i in range(width):
            out[k] = s.actions[a, i]
            k += 1
    for i in range(3):
        out[k + i] = p.set_point[i] - p.nominal[i]
    k += 3
    if p.attach == 1:
        for i in range(3):
            out[k + i] = seat_offset[i]
        out[k + 3] = float(s.coupled)


@compiled
def _read(pointers, p, s, noise, bounds, out, specific_force, seat_offset, r, xmat):
    """Sensor readings at the end of a control step and the observation row."""
    qpos = carray(as_pointer(pointers[lay.P_QPOS]), (13,), np.float64)
    qacc = carray(as_pointer(pointers[lay.P_QACC]), (12,), np.float64)
    estimated_attitude(s, xmat[p.airframe_body], r)
    read_base(p, s, xmat[p.base_body].copy().reshape(3, 3), noise)
    read_position(p, s, r, qpos, noise)
    read_imu(p, s, r, qacc, noise, specific_force)
    observe(p, s, r, specific_force, seat_offset, out)
    for k in range(out.shape[0]):
        out[k] = clip(out[k], -bounds[k], bounds[k])


@compiled
def step_worlds(
    step_function, pointers, parameters, states, noise, cursors, active, actions, bounds,
    observations, terms, metrics, flags, first, last,
):  # fmt: skip
    """Advance those of the worlds first … last−1 that are `active` (N,) by one control step.

    actions (N, A) float64, clipped to [−1, 1] here; noise (N, block, NOISE) with `cursors` (N,) saying which row is
    next; writes observations (N, D) float32, reward terms (N, len(TERMS)), metrics (N, len(METRICS)) and flags (N, 2) =
    (success, terminated). Returns how many of the worlds have used up their noise.
    """
    used_up = 0
    specific_force, seat_offset, r = np.zeros(3), np.zeros(3), np.empty((3, 3))
    for n in range(first, last):
        if not active[n]:
            used_up += cursors[n] == noise.shape[1]
            continue
        p, s = parameters[n], states[n]
        row = noise[n, cursors[n]]
        cursors[n] += 1
        used_up += cursors[n] == noise.shape[1]
        for a in range(lay.HISTORY - 1, 0, -1):
            for i in range(5):
                s.actions[a, i] = s.actions[a - 1, i]
        for i in range(actions.shape[1]):
            s.actions[0, i] = clip(actions[n, i], -1.0, 1.0)
        advance_slow(p, s, row)
        xmat = _physics(step_function, pointers[n], p, s, row)
        qpos = carray(as_pointer(pointers[n, lay.P_QPOS]), (13,), np.float64)
        qvel = carray(as_pointer(pointers[n, lay.P_QVEL]), (12,), np.float64)
        xpos = carray(as_pointer(pointers[n, lay.P_XPOS]), (3 * (p.base_body + 1),), np.float64)
        distance = bookkeeping(p, s, qpos)
        seat = 0.0
        if p.attach == 1:
            seat = approach(p, s, xpos, xmat, qvel, seat_offset)
        s.step += 1
        for i in range(3):
            s.error_integral[i] = clip(
                lay.INTEGRAL_LEAK * s.error_integral[i] + observations[n, i] * lay.SUBSTEPS * TIMESTEP,
                -bounds[3 + i],
                bounds[3 + i],
            )
        _read(pointers[n], p, s, row, bounds, observations[n], specific_force, seat_offset, r, xmat)
        reward(p, s, distance, seat, terms[n])
        summarize(p, s, terms[n], metrics[n], flags[n])
    return used_up


@compiled
def read_worlds(pointers, parameters, states, noise, cursors, bounds, observations, first, last):
    """First observation of worlds first … last−1 after a reset: readings at rest, nothing advances but the noise."""
    specific_force, seat_offset, r = np.zeros(3), np.zeros(3), np.empty((3, 3))
    for n in range(first, last):
        p, s = parameters[n], states[n]
        row = noise[n, cursors[n]]
        cursors[n] += 1
        xmat = carray(as_pointer(pointers[n, lay.P_XMAT]), (p.base_body + 1, 9), np.float64)
        qpos = carray(as_pointer(pointers[n, lay.P_QPOS]), (13,), np.float64)
        qvel = carray(as_pointer(pointers[n, lay.P_QVEL]), (12,), np.float64)
        s.joints[:] = 0.0
        sample_joints(p, s, qpos, qvel, lay.SUBSTEPS - 1, row[lay.SLOW_NOISE + lay.GYRO_NOISE :], 0)
        for i in range(3):
            s.gyro[i] = qvel[3 + i] + s.gyro_bias[i]
            s.velocity_estimate[i] = qvel[i] + s.velocity_error[i]
            s.last_velocity[i] = s.velocity_estimate[i]
            s.last_rate[i] = s.gyro[i]
        _read(pointers[n], p, s, row, bounds, observations[n], specific_force, seat_offset, r, xmat)
        if p.attach == 1:
            xpos = carray(as_pointer(pointers[n, lay.P_XPOS]), (3 * (p.base_body + 1),), np.float64)
            approach(p, s, xpos, xmat, qvel, seat_offset)
            observe(p, s, r, specific_force, seat_offset, observations[n])
