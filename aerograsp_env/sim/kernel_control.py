"""The autopilot and the rotors, one physics tick at a time, compiled.

Velocity → attitude → rates → mixer after PX4's multicopter cascade (mc_pos_control, mc_att_control after Brescianini et al.
2013, mc_rate_control), then the rotors' first-order lag, thrust with ground effect (Cheeseman & Bennett 1955), rotor drag
(Faessler et al. 2018: in-plane, proportional to rotor speed and airspeed) and the body's quadratic drag.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from aerograsp_env.sim.airframe import AIR_DENSITY, GRAVITY
from aerograsp_env.sim.kernel_math import clip
from aerograsp_env.sim.scene import TIMESTEP


@njit(cache=True, nogil=True)
def thrust_vector(p, s, velocity_set_point, force):
    """Velocity loop: writes the wanted force (3,) in the world [N]."""
    for i in range(3):
        error = velocity_set_point[i] - s.velocity_estimate[i]
        slope = (s.velocity_estimate[i] - s.last_velocity[i]) / TIMESTEP
        s.last_velocity[i] = s.velocity_estimate[i]
        s.velocity_slope[i] += p.velocity_d_blend * (slope - s.velocity_slope[i])
        acceleration = p.velocity_p[i] * error + s.velocity_integral[i] - p.velocity_d[i] * s.velocity_slope[i]
        s.velocity_integral[i] = clip(s.velocity_integral[i] + p.velocity_i[i] * error * TIMESTEP, -GRAVITY, GRAVITY)
        force[i] = p.believed_mass * acceleration
    force[2] = max(force[2] + p.believed_mass * GRAVITY, 0.1 * p.believed_mass * GRAVITY)
    level = math.sqrt(force[0] ** 2 + force[1] ** 2)
    limit = force[2] * math.tan(p.tilt_max)
    if level > limit:
        force[0] *= limit / level
        force[1] *= limit / level


@njit(cache=True, nogil=True)
def attitude_rates(p, s, r, force, yaw_rate, rates):
    """Attitude loop: writes the wanted body rates (3,) [rad/s] for the estimated attitude r (3, 3)."""
    n = math.sqrt(force[0] ** 2 + force[1] ** 2 + force[2] ** 2)
    z0, z1, z2 = force[0] / n, force[1] / n, force[2] / n
    cy, sy = math.cos(s.yaw_set_point), math.sin(s.yaw_set_point)
    # y = z × (heading), x = y × z
    y0, y1, y2 = -z2 * sy, z2 * cy, z0 * sy - z1 * cy
    ny = math.sqrt(y0 * y0 + y1 * y1 + y2 * y2)
    y0, y1, y2 = y0 / ny, y1 / ny, y2 / ny
    x0, x1, x2 = y1 * z2 - y2 * z1, y2 * z0 - y0 * z2, y0 * z1 - y1 * z0
    # E = Rᵀ R_d; the error vector is the axis of E times the sine of its angle
    e21 = r[0, 2] * y0 + r[1, 2] * y1 + r[2, 2] * y2
    e12 = r[0, 1] * z0 + r[1, 1] * z1 + r[2, 1] * z2
    e02 = r[0, 0] * z0 + r[1, 0] * z1 + r[2, 0] * z2
    e20 = r[0, 2] * x0 + r[1, 2] * x1 + r[2, 2] * x2
    e10 = r[0, 1] * x0 + r[1, 1] * x1 + r[2, 1] * x2
    e01 = r[0, 0] * y0 + r[1, 0] * y1 + r[2, 0] * y2
    rates[0] = 0.5 * p.attitude_p[0] * (e21 - e12)
    rates[1] = 0.5 * p.attitude_p[1] * (e02 - e20)
    rates[2] = 0.5 * p.attitude_p[2] * (e10 - e01)
    for i in range(3):  # a yaw rate turns about the world's vertical: its part along each body axis
        rates[i] = clip(rates[i] + yaw_rate * r[2, i], -p.rate_max[i], p.rate_max[i])


@njit(cache=True, nogil=True)
def mix(p, wrench, thrusts):
    """Collective thrust and torques (4,) to six thrusts in range: collective gives way before roll and pitch do."""
    low, high = 1e9, -1e9
    for i in range(6):
        t = 0.0
        for j in range(4):
            t += p.mixer[i, j] * wrench[j]
        thrusts[i] = t
        low, high = min(low, t), max(high, t)
    shift = 0.0
    if high > p.thrust_max:
        shift = p.thrust_max - high
    elif low < 0.0:
        shift = min(-low, p.thrust_max - high)
    for i in range(6):
        thrusts[i] = clip(thrusts[i] + shift, 0.0, p.thrust_max)


@njit(cache=True, nogil=True)
def autopilot(p, s, r, velocity_set_point, yaw_rate, thrusts):
    """One tick of the cascade: reads the estimates in `s`, writes the six commanded thrusts [N]."""
    force = np.empty(3)
    rates = np.empty(3)
    wrench = np.empty(4)
    s.yaw_set_point += yaw_rate * TIMESTEP
    thrust_vector(p, s, velocity_set_point, force)
    attitude_rates(p, s, r, force, yaw_rate, rates)
    wrench[0] = max(force[0] * r[0, 2] + force[1] * r[1, 2] + force[2] * r[2, 2], 0.0)
    for i in range(3):
        error = rates[i] - s.gyro[i]
        slope = (s.gyro[i] - s.last_rate[i]) / TIMESTEP
        s.last_rate[i] = s.gyro[i]
        s.rate_slope[i] += p.rate_d_blend * (slope - s.rate_slope[i])
        torque = p.rate_p[i] * error + s.rate_integral[i] - p.rate_d[i] * s.rate_slope[i]
        s.rate_integral[i] = clip(
            s.rate_integral[i] + p.rate_i[i] * error * TIMESTEP, -p.rate_integral_limit, p.rate_integral_limit
        )
        wrench[1 + i] = torque * p.torque_scale[i]
    mix(p, wrench, thrusts)


@njit(cache=True, nogil=True)
def ground_effect(height, radius):
    """Thrust gain at `height` [m] over the floor for a rotor of `radius` [m]: 1 / (1 − (R/4z)²), held below half a radius."""
    ratio = radius / (4.0 * max(height, 0.5 * radius))
    return 1.0 / (1.0 - ratio * ratio)


@njit(cache=True, nogil=True)
def rotors(p, s, r, position, velocity, thrusts, ctrl, wrench):
    """Rotor lag and air: writes rotor thrusts into `ctrl` (6,) and drag force, torque about the centre of mass into `wrench`
    (6,), world frame."""
    air = np.empty(3)  # velocity through the air, body frame
    for i in range(3):
        air[i] = 0.0
        for j in range(3):
            air[i] += r[j, i] * (velocity[j] - s.wind[j])
    speed = math.sqrt(air[0] ** 2 + air[1] ** 2 + air[2] ** 2)
    body = 0.5 * AIR_DENSITY * p.drag_area * speed
    force, torque = np.zeros(3), np.zeros(3)
    for i in range(3):
        force[i] = -body * air[i]
    for k in range(6):
        command = min(math.sqrt(thrusts[k] / p.believed_thrust_constant), p.speed_max)
        gap = command - s.rotor_speed[k]
        s.rotor_speed[k] += (p.spin_up if gap > 0.0 else p.spin_down) * gap
        omega = s.rotor_speed[k]
        hub = p.rotor_position[k]
        height = position[2] + r[2, 0] * hub[0] + r[2, 1] * hub[1] + r[2, 2] * hub[2]
        ctrl[k] = p.thrust_constant * omega * omega * ground_effect(height, p.rotor_radius)
        fx, fy = -p.rotor_drag * omega * air[0], -p.rotor_drag * omega * air[1]
        x, y, z = hub[0] - p.com[0], hub[1] - p.com[1], hub[2] - p.com[2]
        force[0] += fx
        force[1] += fy
        torque[0] -= z * fy
        torque[1] += z * fx
        torque[2] += x * fy - y * fx
    for i in range(3):
        wrench[i] = r[i, 0] * force[0] + r[i, 1] * force[1] + r[i, 2] * force[2]
        wrench[3 + i] = r[i, 0] * torque[0] + r[i, 1] * torque[1] + r[i, 2] * torque[2]
