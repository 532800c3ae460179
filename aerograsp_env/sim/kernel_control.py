"""The autopilot and the rotors, one physics tick at a time, compiled.

Velocity → attitude → rates → mixer after PX4's multicopter cascade (mc_pos_control, mc_att_control after Brescianini et
al. 2013, mc_rate_control), then the rotors' first-order lag, thrust with ground effect (Cheeseman & Bennett 1955),
rotor drag (Faessler et al. 2018: in-plane, proportional to rotor speed and airspeed) and the body's quadratic drag.
"""

from __future__ import annotations

import math

from aerograsp_env.sim.airframe import AIR_DENSITY, GRAVITY
from aerograsp_env.sim.kernel_math import clip, compiled
from aerograsp_env.sim.scene import TIMESTEP


@compiled
def _wanted_acceleration(p, s, i, velocity_set_point):
    """Velocity loop of axis i: PID with the derivative on the estimate."""
    error = velocity_set_point - s.velocity_estimate[i]
    slope = (s.velocity_estimate[i] - s.last_velocity[i]) / TIMESTEP
    s.last_velocity[i] = s.velocity_estimate[i]
    s.velocity_slope[i] += p.velocity_d_blend * (slope - s.velocity_slope[i])
    acceleration = p.velocity_p[i] * error + s.velocity_integral[i] - p.velocity_d[i] * s.velocity_slope[i]
    s.velocity_integral[i] = clip(s.velocity_integral[i] + p.velocity_i[i] * error * TIMESTEP, -GRAVITY, GRAVITY)
    return acceleration


@compiled
def thrust_vector(p, s, velocity_set_point):
    """Velocity loop: the wanted force (3,) in the world [N]."""
    x = p.believed_mass * _wanted_acceleration(p, s, 0, velocity_set_point[0])
    y = p.believed_mass * _wanted_acceleration(p, s, 1, velocity_set_point[1])
    z = p.believed_mass * _wanted_acceleration(p, s, 2, velocity_set_point[2])
    z = max(z + p.believed_mass * GRAVITY, 0.1 * p.believed_mass * GRAVITY)
    level = math.sqrt(x**2 + y**2)
    limit = z * math.tan(p.tilt_max)
    if level > limit:
        x *= limit / level
        y *= limit / level
    return x, y, z


@compiled
def attitude_rates(p, s, r, force, yaw_rate):
    """Attitude loop: the wanted body rates (3,) [rad/s] for the estimated attitude r (3, 3)."""
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
    # a yaw rate turns about the world's vertical: its part along each body axis
    roll = 0.5 * p.attitude_p[0] * (e21 - e12) + yaw_rate * r[2, 0]
    pitch = 0.5 * p.attitude_p[1] * (e02 - e20) + yaw_rate * r[2, 1]
    yaw = 0.5 * p.attitude_p[2] * (e10 - e01) + yaw_rate * r[2, 2]
    return (
        clip(roll, -p.rate_max[0], p.rate_max[0]),
        clip(pitch, -p.rate_max[1], p.rate_max[1]),
        clip(yaw, -p.rate_max[2], p.rate_max[2]),
    )


@compiled
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


@compiled
def wanted_torque(p, s, i, rate):
    """Rate loop of body axis i."""
    error = rate - s.gyro[i]
    slope = (s.gyro[i] - s.last_rate[i]) / TIMESTEP
    s.last_rate[i] = s.gyro[i]
    s.rate_slope[i] += p.rate_d_blend * (slope - s.rate_slope[i])
    torque = p.rate_p[i] * error + s.rate_integral[i] - p.rate_d[i] * s.rate_slope[i]
    s.rate_integral[i] = clip(
        s.rate_integral[i] + p.rate_i[i] * error * TIMESTEP, -p.rate_integral_limit, p.rate_integral_limit
    )
    return torque * p.torque_scale[i]


@compiled
def autopilot(p, s, r, velocity_set_point, yaw_rate, thrusts):
    """One tick of the cascade: reads the estimates in `s`, writes the six commanded thrusts [N]."""
    s.yaw_set_point += yaw_rate * TIMESTEP
    force = thrust_vector(p, s, velocity_set_point)
    rates = attitude_rates(p, s, r, force, yaw_rate)
    collective = max(force[0] * r[0, 2] + force[1] * r[1, 2] + force[2] * r[2, 2], 0.0)
    roll = wanted_torque(p, s, 0, rates[0])
    pitch = wanted_torque(p, s, 1, rates[1])
    yaw = wanted_torque(p, s, 2, rates[2])
    mix(p, (collective, roll, pitch, yaw), thrusts)


@compiled
def ground_effect(height, radius):
    """Thrust gain at `height` z over the floor for a rotor of `radius` R [m]: 1 / (1 − (R/4z)²), held below z = R/2."""
    ratio = radius / (4.0 * max(height, 0.5 * radius))
    return 1.0 / (1.0 - ratio * ratio)


@compiled
def rotors(p, s, r, position, velocity, thrusts, ctrl, wrench):
    """Rotor lag and air.

    Writes rotor thrusts into `ctrl` (6,), and into `wrench` (6,) the drag force and its torque about the centre of
    mass, world frame.
    """
    vx, vy, vz = velocity[0] - s.wind[0], velocity[1] - s.wind[1], velocity[2] - s.wind[2]
    ax = r[0, 0] * vx + r[1, 0] * vy + r[2, 0] * vz  # velocity through the air, body frame
    ay = r[0, 1] * vx + r[1, 1] * vy + r[2, 1] * vz
    az = r[0, 2] * vx + r[1, 2] * vy + r[2, 2] * vz
    body = 0.5 * AIR_DENSITY * p.drag_area * math.sqrt(ax**2 + ay**2 + az**2)
    force_x, force_y, force_z = -body * ax, -body * ay, -body * az
    torque_x, torque_y, torque_z = 0.0, 0.0, 0.0
    for k in range(6):
        command = min(math.sqrt(thrusts[k] / p.believed_thrust_constant), p.speed_max)
        gap = command - s.rotor_speed[k]
        s.rotor_speed[k] += (p.spin_up if gap > 0.0 else p.spin_down) * gap
        omega = s.rotor_speed[k]
        hub = p.rotor_position[k]
        height = position[2] + r[2, 0] * hub[0] + r[2, 1] * hub[1] + r[2, 2] * hub[2]
        ctrl[k] = p.thrust_constant * omega * omega * ground_effect(height, p.rotor_radius)
        fx, fy = -p.rotor_drag * omega * ax, -p.rotor_drag * omega * ay
        x, y, z = hub[0] - p.com[0], hub[1] - p.com[1], hub[2] - p.com[2]
        force_x += fx
        force_y += fy
        torque_x -= z * fy
        torque_y += z * fx
        torque_z += x * fy - y * fx
    for i in range(3):
        wrench[i] = r[i, 0] * force_x + r[i, 1] * force_y + r[i, 2] * force_z
        wrench[3 + i] = r[i, 0] * torque_x + r[i, 1] * torque_y + r[i, 2] * torque_z
