"""Slow errors, wind and readings of one world, compiled."""

from __future__ import annotations

import math

import numpy as np

from aerograsp_env.sim.airframe import GRAVITY
from aerograsp_env.sim.kernel_math import bounded, clip, compiled, tool_forward, upright
from aerograsp_env.sim.layout import DOCK, POTENTIOMETER_SAMPLES, SUBSTEPS
from aerograsp_env.sim.scene import TIMESTEP

# where each process finds its standard normals in a step's slow noise
_GUST, _WANDER, _FAST, _ATTITUDE, _ACCELERATION, _BASE, _SOURCE, _WHITE, _JUMP = 0, 5, 8, 11, 14, 17, 20, 23, 26


@compiled
def blow(p, s):
    """World-frame wind of the present gust state."""
    gust = np.zeros(3)
    for i in range(3):
        for j in range(5):
            gust[i] += p.gust_output[i, j] * s.gust[j]
    for i in range(3):
        s.wind[i] = p.mean_wind[i]
        for j in range(3):
            s.wind[i] += p.wind_axes[i, j] * gust[j]


@compiled
def slow_errors(p, s):
    """Present errors of the velocity, attitude and position estimates, from their processes' states."""
    for i in range(3):
        slow = p.velocity_wander_limit[i] * bounded(s.velocity_wander[i])
        s.velocity_error[i] = slow + p.velocity_std * s.velocity_fast[i]
        s.attitude_error[i] = p.attitude_limit * bounded(s.attitude_wander[i])


@compiled
def advance_slow(p, s, noise):
    """One control step of wind, wandering errors and tracking slips; each is an exact discretisation."""
    gust = np.zeros(5)
    for i in range(5):
        for j in range(5):
            gust[i] += p.gust_transition[i, j] * s.gust[j] + p.gust_input[i, j] * noise[_GUST + j]
    s.gust[:] = gust
    blow(p, s)
    for i in range(3):
        a = p.velocity_wander_blend
        s.velocity_wander[i] = a * s.velocity_wander[i] + math.sqrt(1.0 - a * a) * noise[_WANDER + i]
        a = p.velocity_blend
        s.velocity_fast[i] = a * s.velocity_fast[i] + math.sqrt(1.0 - a * a) * noise[_FAST + i]
        a = p.attitude_blend
        s.attitude_wander[i] = a * s.attitude_wander[i] + math.sqrt(1.0 - a * a) * noise[_ATTITUDE + i]
        a = p.source_wander_blend
        s.source_wander[i] = a * s.source_wander[i] + math.sqrt(1.0 - a * a) * noise[_SOURCE + i]
    slow_errors(p, s)
    since = (s.step + s.jump_phase) % p.source_jump_period  # steps since the last slip of the tracker began
    if since == 0:
        for i in range(3):  # forth or back along one line
            s.source_jump[i] = math.copysign(p.source_jump_size[i], noise[_JUMP])
    elif since == p.source_jump_steps:
        s.source_jump[:] = 0.0


@compiled
def sample_joints(p, s, qpos, qvel, tick, noise, count):
    """Potentiometer samples that fall into the physics tick just done; returns how many this step has so far."""
    end = (tick + 1) * TIMESTEP
    period = SUBSTEPS * TIMESTEP / POTENTIOMETER_SAMPLES
    while count < POTENTIOMETER_SAMPLES and (count + 1) * period <= end + 1e-9:
        back = end - (count + 1) * period
        for j in range(5):
            a = p.joint_address[j]
            angle = qpos[a] - back * qvel[a - 1] + s.potentiometer_offset[j]
            angle += p.potentiometer_std * noise[5 * count + j]
            angle = clip(angle, p.signal_limits[j, 0], p.signal_limits[j, 1])
            counts = math.floor(angle / p.potentiometer_quantum + 0.5)
            s.joints[j] += p.potentiometer_quantum * counts / POTENTIOMETER_SAMPLES
        count += 1
    return count


@compiled
def tool_position(p, s, r):
    """Airframe origin (3,) in the world from the joint readings, the base's tilt and the estimated attitude r (3, 3).

    The seat's place and heading are known (they define the frame); its tilt comes from the base accelerometer, the
    airframe's roll and pitch from the autopilot, its heading from the joints (the flex between tip and airframe is not
    sensed).
    """
    tip, chain, level = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    tool_forward(p.lengths, s.joints, tip, chain)
    upright(s.base_up, level)
    base = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                base[i, j] += p.seat_rotation[i, k] * level[k, j]
    forward = np.zeros(3)  # the tool's idea of the body's x axis in the world
    for i in range(3):
        for j in range(3):
            for k in range(3):
                forward[i] += base[i, j] * chain[j, k] * p.tip_rotation[k, 0]
    turn = math.atan2(forward[1], forward[0]) - math.atan2(r[1, 0], r[0, 0])
    ct, st = math.cos(turn), math.sin(turn)
    result = np.empty(3)
    offset = np.zeros(3)
    for i in range(3):
        result[i] = p.seat_position[i]
        for j in range(3):
            result[i] += base[i, j] * tip[j]
            offset[i] += r[i, j] * p.tip_position[j]
    result[0] -= ct * offset[0] - st * offset[1]
    result[1] -= st * offset[0] + ct * offset[1]
    result[2] -= offset[2]
    return result


@compiled
def read_base(p, s, base_rotation, noise):
    """Base accelerometer (at rest when coupled: gravity's reaction) and its low-pass, the base's idea of up."""
    for i in range(3):
        s.base_acceleration[i] = (
            GRAVITY * base_rotation[2, i] + s.base_acceleration_bias[i] + p.base_acceleration_std * noise[_BASE + i]
        )
        s.base_up[i] += (1.0 - p.tilt_blend) * (s.base_acceleration[i] - s.base_up[i])


@compiled
def read_position(p, s, r, position, noise):
    """Position estimate of the chosen source: held between samples, from the tool only once it is coupled."""
    if s.step % p.source_period == 0:
        for i in range(3):
            s.source_error[i] = (
                s.source_offset[i]
                + p.source_wander_limit[i] * bounded(s.source_wander[i])
                + s.source_jump[i]
                + p.source_white_std[i] * noise[_WHITE + i]
            )
            s.source_estimate[i] = position[i] + s.source_error[i]
    if p.localization == DOCK and s.coupled == 1:
        s.estimate[:] = tool_position(p, s, r)
    else:
        s.estimate[:] = s.source_estimate


@compiled
def read_imu(p, s, r, acceleration, noise, out):
    """Accelerometer: specific force (3,) in the body frame."""
    for i in range(3):
        out[i] = s.acceleration_bias[i] + p.acceleration_std * noise[_ACCELERATION + i] + r[2, i] * GRAVITY
        for j in range(3):
            out[i] += r[j, i] * acceleration[j]
