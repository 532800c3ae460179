"""One control step of any number of vehicles with arms, compiled: autopilot, servos, grippers, MuJoCo, readings.

A control step is `SUBSTEPS` ticks of autopilot → servos → grippers → mj_step. What a step means for a task (targets,
observations, rewards) is the task's own compiled function, called after this one.
"""

from __future__ import annotations

import math

import numpy as np
from numba import carray

from aerograsp_env.sim.kernel import delayed_command, estimated_attitude, stops
from aerograsp_env.sim.kernel_control import attitude_rates, mix, rotors, thrust_vector, wanted_torque
from aerograsp_env.sim.kernel_math import as_pointer, bounded, call_with_two_pointers, clip, compiled
from aerograsp_env.sim.kernel_sensors import advance_slow, read_base, read_imu, read_position, sample_joints
from aerograsp_env.sim.layout import SLOW_NOISE
from aerograsp_env.sim.manipulation import layout as lay
from aerograsp_env.sim.manipulation.kernel_arm import center_of_mass, read_arms, servo, twist_rates, worm
from aerograsp_env.sim.scene import TIMESTEP


@compiled
def rotation_of(q, out):
    """(3, 3) of a wxyz quaternion (4,), which need not be of unit length."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    n = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w * n, x * n, y * n, z * n
    out[0, 0], out[0, 1], out[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    out[1, 0], out[1, 1], out[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    out[2, 0], out[2, 1], out[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)


@compiled
def feedforward_torque(p, center, collective):
    """Torque about body x and y that keeps a vehicle level whose centre of mass (3,) left where the mixer assumes it.

    The mixer gives its torque about its own centre; about the true one the collective adds (c₀ − c) × F ẑ.
    """
    return collective * (center[1] - p.mixer_center[1]), -collective * (center[0] - p.mixer_center[0])


@compiled
def _autopilot(p, s, r, velocity_set_point, yaw_rate, center, thrusts):
    """One tick of the cascade of `kernel_control.autopilot`, with the arms' feed-forward."""
    s.yaw_set_point += yaw_rate * TIMESTEP
    force = thrust_vector(p, s, velocity_set_point)
    rates = attitude_rates(p, s, r, force, yaw_rate)
    collective = max(force[0] * r[0, 2] + force[1] * r[1, 2] + force[2] * r[2, 2], 0.0)
    roll = wanted_torque(p, s, 0, rates[0])
    pitch = wanted_torque(p, s, 1, rates[1])
    yaw = wanted_torque(p, s, 2, rates[2])
    if p.feedforward == 1:
        x, y = feedforward_torque(p, center, collective)
        roll += x
        pitch += y
    mix(p, (collective, roll, pitch, yaw), thrusts)


@compiled
def _velocity_set_point(p, s, r, back, qpos, out):
    """What the base is told: to hold its place (PX4's position loop), or the velocity of the command that arrived."""
    out[:] = 0.0
    if p.hold == 1:
        for i in range(3):
            out[i] = clip(
                p.hold_p[i] * (s.hold_set_point[i] - s.autopilot_position[i]), -p.hold_limit[i], p.hold_limit[i]
            )
    elif back >= 0:
        for i in range(3):
            out[i] = p.velocity_limit[i] * s.commands[back, lay.BASE_SLOT + i]
        if p.heading_frame == 1:
            h = math.atan2(r[1, 0], r[0, 0])
            a, b = out[0], out[1]
            out[0], out[1] = math.cos(h) * a - math.sin(h) * b, math.sin(h) * a + math.cos(h) * b


@compiled
def _drive_arms(p, s, back, qpos, force, ctrl):
    """One tick of every servo and gripper."""
    for arm in range(p.arms):
        n, first = p.joints[arm], p.arm_qpos[arm]
        for i in range(n):
            rate = 0.0
            if p.twist == 1:
                rate = s.twist_rate[arm, i]
            elif back >= 0:
                rate = p.rate_scale * s.commands[back, lay.ARM_SLOT[arm] + i]
            servo(p, s, arm, i, rate, qpos[first + i], force[p.arm_ctrl[arm] + i], ctrl)
        drive = s.commands[back, lay.GRIPPER_SLOT + arm] if back >= 0 else 0.0
        worm(p, s, arm, drive, qpos[first + n], qpos[first + n + 1], ctrl)


@compiled
def _resolve_twists(p, s, back):
    """Joint rates for the twist commands that hold at this tick."""
    twist = np.zeros(6)
    for arm in range(p.arms):
        for k in range(6):
            command = s.commands[back, lay.ARM_SLOT[arm] + k] if back >= 0 else 0.0
            twist[k] = p.twist_scale[k // 3] * command
        twist_rates(p, arm, s.encoder[arm], twist, s.twist_rate[arm])


@compiled
def _found(p, sensor, k):
    a = p.contact_address[k]
    return sensor[a] if a >= 0 else 0.0


@compiled
def _touches(p, s, sensor):
    """Counts in which ticks what touched what. A sensor says how many contacts its two sides have."""
    with_airframe = _found(p, sensor, lay.C_AIRFRAME_0) + _found(p, sensor, lay.C_AIRFRAME_1)
    with_object = _found(p, sensor, lay.C_OBJECT_0) + _found(p, sensor, lay.C_OBJECT_1)
    arms = _found(p, sensor, lay.C_ARMS)
    for k in range(s.contacts.shape[0]):
        found = _found(p, sensor, k)
        if k == lay.C_AIRFRAME:
            found -= with_airframe
        elif k == lay.C_ARM_0 or k == lay.C_ARM_1:
            arm = k - lay.C_ARM_0
            found -= _found(p, sensor, lay.C_AIRFRAME_0 + arm) + _found(p, sensor, lay.C_OBJECT_0 + arm) + arms
        elif k == lay.C_SUPPORT:
            found -= with_object
        if found > 0.0:
            s.contacts[k] += 1


@compiled
def _physics(step_function, pointers, p, s, noise):
    """The ticks of one control step."""
    model, data = pointers[lay.P_MODEL], pointers[lay.P_DATA]
    qpos = carray(as_pointer(pointers[lay.P_QPOS]), (p.nq,), np.float64)
    qvel = carray(as_pointer(pointers[lay.P_QVEL]), (p.nv,), np.float64)
    ctrl = carray(as_pointer(pointers[lay.P_CTRL]), (p.nu,), np.float64)
    force = carray(as_pointer(pointers[lay.P_FORCE]), (p.nu,), np.float64)
    xfrc = carray(as_pointer(pointers[lay.P_XFRC]), (p.nbody, 6), np.float64)[p.airframe_body]
    qfrc = carray(as_pointer(pointers[lay.P_QFRC]), (p.nv,), np.float64)
    sensor = carray(as_pointer(pointers[lay.P_SENSOR]), (p.nsensordata,), np.float64)
    truth, r = np.empty((3, 3)), np.empty((3, 3))
    set_point, thrusts, center = np.zeros(3), np.zeros(6), np.zeros(3)
    gyro_noise = noise[SLOW_NOISE:]
    s.joints[:] = 0.0
    s.load[:] = 0.0
    s.contacts[:] = 0
    samples, resolved = 0, -2
    for tick in range(lay.SUBSTEPS):
        rotation_of(qpos[3:7], truth)
        estimated_attitude(s, truth.ravel(), r)
        for i in range(3):
            s.gyro[i] = qvel[3 + i] + s.gyro_bias[i] + p.gyro_std * gyro_noise[3 * tick + i]
            s.velocity_estimate[i] = qvel[i] + s.velocity_error[i]
        back = delayed_command(p, s, tick)
        _velocity_set_point(p, s, r, back, qpos, set_point)
        yaw_rate = p.yaw_rate_limit * s.commands[back, lay.BASE_SLOT + 3] if back >= 0 else 0.0
        if p.feedforward == 1:
            center_of_mass(p, s, qpos, center)
        _autopilot(p, s, r, set_point, yaw_rate, center, thrusts)
        rotors(p, s, truth, qpos, qvel, thrusts, ctrl, xfrc)
        if p.twist == 1 and back != resolved:
            _resolve_twists(p, s, back)
            resolved = back
        _drive_arms(p, s, back, qpos, force, ctrl)
        if p.has_tool == 1:
            stops(p, s, qpos, qvel, qfrc)
        call_with_two_pointers(step_function, model, data)
        _touches(p, s, sensor)
        if p.has_tool == 1:
            samples = sample_joints(p, s, qpos, qvel, tick, noise[lay.TOOL_FIRST :], samples)
            if s.coupled == 1:
                c = p.clamp_address
                pull = math.sqrt(sensor[c] ** 2 + sensor[c + 1] ** 2 + sensor[c + 2] ** 2)
                s.clamp_force_max = max(s.clamp_force_max, pull)
                if pull > p.overload_force:
                    s.termination = lay.OVERLOAD
    for i in range(p.nq):
        if not math.isfinite(qpos[i]):
            s.termination = lay.DIVERGED


@compiled
def _read(pointers, p, s, noise, moved):
    """Readings at the end of a control step."""
    qpos = carray(as_pointer(pointers[lay.P_QPOS]), (p.nq,), np.float64)
    qvel = carray(as_pointer(pointers[lay.P_QVEL]), (p.nv,), np.float64)
    qacc = carray(as_pointer(pointers[lay.P_QACC]), (p.nv,), np.float64)
    xmat = carray(as_pointer(pointers[lay.P_XMAT]), (p.nbody, 9), np.float64)
    rotation_of(qpos[3:7], s.rotation)
    s.position[:] = qpos[:3]
    r = np.empty((3, 3))
    estimated_attitude(s, s.rotation.copy().ravel(), r)
    s.attitude[:] = r
    if p.has_tool == 1:
        read_base(p, s, xmat[p.base_body].copy().reshape(3, 3), noise)
    read_position(p, s, r, qpos, noise)
    read_imu(p, s, r, qacc, noise, s.specific_force)
    for i in range(3):  # its filter rejects slips of the source and averages white noise
        wander = p.source_wander_limit[i] * bounded(s.source_wander[i])
        s.autopilot_position[i] = qpos[i] + s.source_offset[i] + wander
    read_arms(p, s, qpos, moved)
    a = p.object_address
    if a >= 0:
        rotation_of(qpos[a + 3 : a + 7], s.object)
        for i in range(3):
            s.object[i, 3] = qpos[a + i]
            s.object[3, i] = 0.0
            s.object_velocity[i], s.object_velocity[3 + i] = qvel[a - 1 + i], qvel[a + 2 + i]
        s.object[3, 3] = 1.0


@compiled
def step_worlds(
    step_function, pointers, parameters, states, noise, cursors, active, actions, slots, first, last,
):  # fmt: skip
    """Advance those of the worlds first … last−1 that are `active` (N,) by one control step.

    actions (N, A) float64, clipped to [−1, 1] here, go into the command slots `slots` (A,). noise (N, block, NOISE)
    with `cursors` (N,) saying which row is next. Returns how many of the worlds have used up their noise.
    """
    used_up = 0
    for n in range(first, last):
        if not active[n]:
            used_up += cursors[n] == noise.shape[1]
            continue
        p, s = parameters[n], states[n]
        row = noise[n, cursors[n]]
        cursors[n] += 1
        used_up += cursors[n] == noise.shape[1]
        for a in range(lay.HISTORY - 1, 0, -1):
            for i in range(lay.SLOTS):
                s.commands[a, i] = s.commands[a - 1, i]
        for i in range(actions.shape[1]):
            s.commands[0, slots[i]] = clip(actions[n, i], -1.0, 1.0)
        advance_slow(p, s, row)
        _physics(step_function, pointers[n], p, s, row)
        if s.termination == lay.RUNNING and s.contacts[lay.C_AIRFRAME] > 0:
            s.termination = lay.COLLISION
        s.step += 1
        _read(pointers[n], p, s, row, 1.0)
        distance = 0.0
        for i in range(3):
            distance += (s.position[i] - p.hold_position[i]) ** 2
        if s.termination == lay.RUNNING and distance > p.bound**2:
            s.termination = lay.OUT_OF_BOUNDS
    return used_up


@compiled
def read_worlds(pointers, parameters, states, noise, cursors, first, last):
    """First readings of worlds first … last−1 after a reset, at rest; nothing advances but the noise."""
    for n in range(first, last):
        p, s = parameters[n], states[n]
        row = noise[n, cursors[n]]
        cursors[n] += 1
        qpos = carray(as_pointer(pointers[n, lay.P_QPOS]), (p.nq,), np.float64)
        qvel = carray(as_pointer(pointers[n, lay.P_QVEL]), (p.nv,), np.float64)
        for i in range(3):
            s.gyro[i] = qvel[3 + i] + s.gyro_bias[i]
            s.velocity_estimate[i] = qvel[i] + s.velocity_error[i]
            s.last_velocity[i] = s.velocity_estimate[i]
            s.last_rate[i] = s.gyro[i]
        if p.has_tool == 1:
            s.joints[:] = 0.0
            sample_joints(p, s, qpos, qvel, lay.SUBSTEPS - 1, row[lay.TOOL_FIRST :], 0)
        _read(pointers[n], p, s, row, 0.0)
        for i in range(3):
            s.hold_set_point[i] = s.autopilot_position[i] + p.hold_position[i] - s.position[i]
