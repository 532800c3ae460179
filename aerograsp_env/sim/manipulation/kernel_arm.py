"""Arms, one tick or one reading at a time, compiled: kinematics, servos, worm grippers, centre of mass.

Servos are hobby servos on a bus: the commanded rate is integrated into a set-point that stays near the joint, MuJoCo's
position actuator follows it within its torque, and one that was overloaded for long holds with a fraction of it until
its command backs off.
"""

from __future__ import annotations

import math

import numpy as np

from aerograsp_env.sim.kernel_math import clip, compiled
from aerograsp_env.sim.manipulation import layout as lay
from aerograsp_env.sim.scene import TIMESTEP

ENCODER_QUANTUM = 2.0 * math.pi / 4096  # 12 bits a turn [rad]
RATE_QUANTUM = 0.229 * 2.0 * math.pi / 60.0  # 0.229 rev/min [rad/s]
FOLLOWING_ERROR = 0.35  # the set-point stays this near to the joint [rad]
OVERLOAD_SHARE = 0.98  # of the torque limit …
OVERLOAD_TICKS = round(1.0 / TIMESTEP)  # … for longer than this
PROTECTIVE_SHARE = 0.30
BACKED_OFF = 0.02  # a protected servo recovers once its set-point is this near to the joint [rad]
TWIST_DAMPING = 0.005  # [m]
TWIST_LENGTH = 0.05  # weight of turning against moving where an arm cannot do both [m]


@compiled
def multiply(a, b, out):
    """out = a b of rigid transforms (4, 4); `out` is neither."""
    for i in range(3):
        for j in range(4):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]
        out[i, 3] += a[i, 3]
    for j in range(4):
        out[3, j] = 1.0 if j == 3 else 0.0


@compiled
def turn(axis, angle, out):
    """Rotation about the unit vector `axis` (3,) as a transform: writes (4, 4). Rodrigues' formula."""
    c, s = math.cos(angle), math.sin(angle)
    x, y, z = axis[0], axis[1], axis[2]
    k = 1.0 - c
    out[0, 0], out[0, 1], out[0, 2] = c + k * x * x, k * x * y - s * z, k * x * z + s * y
    out[1, 0], out[1, 1], out[1, 2] = k * x * y + s * z, c + k * y * y, k * y * z - s * x
    out[2, 0], out[2, 1], out[2, 2] = k * x * z - s * y, k * y * z + s * x, c + k * z * z
    for i in range(3):
        out[i, 3] = 0.0
        out[3, i] = 0.0
    out[3, 3] = 1.0


@compiled
def hinge(a, b, axis, angle, out):
    """out = a b turn(axis, angle) of rigid transforms (4, 4), in one go: every tick does it for every joint."""
    c, s = math.cos(angle), math.sin(angle)
    x, y, z = axis[0], axis[1], axis[2]
    k = 1.0 - c
    r00, r01, r02 = c + k * x * x, k * x * y - s * z, k * x * z + s * y
    r10, r11, r12 = k * x * y + s * z, c + k * y * y, k * y * z - s * x
    r20, r21, r22 = k * x * z - s * y, k * y * z + s * x, c + k * z * z
    for i in range(3):
        u, v, w = a[i, 0], a[i, 1], a[i, 2]
        f = u * b[0, 0] + v * b[1, 0] + w * b[2, 0]
        g = u * b[0, 1] + v * b[1, 1] + w * b[2, 1]
        h = u * b[0, 2] + v * b[1, 2] + w * b[2, 2]
        at = u * b[0, 3] + v * b[1, 3] + w * b[2, 3] + a[i, 3]
        out[i, 0], out[i, 1] = f * r00 + g * r10 + h * r20, f * r01 + g * r11 + h * r21
        out[i, 2], out[i, 3] = f * r02 + g * r12 + h * r22, at
        out[3, i] = 0.0
    out[3, 3] = 1.0


@compiled
def forward(p, arm, q, poses, tool):
    """Kinematics in the body frame: writes T_body_link (JOINTS, 4, 4) and T_body_tool (4, 4)."""
    n = p.joints[arm]
    turn(p.axis[arm, 0], q[0], tool)
    multiply(p.placement[arm, 0], tool, poses[0])
    for i in range(1, n):
        hinge(poses[i - 1], p.placement[arm, i], p.axis[arm, i], q[i], poses[i])
    multiply(poses[n - 1], p.tool_placement[arm], tool)


@compiled
def jacobian(p, arm, poses, tool, out):
    """Of the tool's twist (linear, angular; body frame): writes (6, JOINTS), zero beyond the arm's joints."""
    out[:] = 0.0
    for i in range(p.joints[arm]):
        a = p.axis[arm, i]
        x = poses[i, 0, 0] * a[0] + poses[i, 0, 1] * a[1] + poses[i, 0, 2] * a[2]
        y = poses[i, 1, 0] * a[0] + poses[i, 1, 1] * a[1] + poses[i, 1, 2] * a[2]
        z = poses[i, 2, 0] * a[0] + poses[i, 2, 1] * a[1] + poses[i, 2, 2] * a[2]
        u, v, w = tool[0, 3] - poses[i, 0, 3], tool[1, 3] - poses[i, 1, 3], tool[2, 3] - poses[i, 2, 3]
        out[0, i], out[1, i], out[2, i] = y * w - z * v, z * u - x * w, x * v - y * u
        out[3, i], out[4, i], out[5, i] = x, y, z


@compiled
def twist_rates(p, arm, q, twist, out):
    """Joint rates (JOINTS,) for the tool's twist (6,): damped least squares (Nakamura & Hanafusa 1986).

    A joint that has reached its limit and would leave it stands still, and all slow down alike where one is too fast.
    """
    poses, tool, j = np.empty((lay.JOINTS, 4, 4)), np.empty((4, 4)), np.empty((6, lay.JOINTS))
    forward(p, arm, q, poses, tool)
    jacobian(p, arm, poses, tool, j)
    n = p.joints[arm]
    gram = np.zeros((n, n))
    right = np.zeros(n)
    for a in range(n):
        for k in range(6):
            weight = 1.0 if k < 3 else TWIST_LENGTH**2
            for b in range(n):
                gram[a, b] += weight * j[k, a] * j[k, b]
            right[a] += weight * j[k, a] * twist[k]
        gram[a, a] += TWIST_DAMPING**2
    rates = np.linalg.solve(gram, right)
    fastest = 1.0
    for a in range(n):
        outward = q[a] <= p.joint_limits[arm, a, 0] and rates[a] < 0.0
        outward = outward or (q[a] >= p.joint_limits[arm, a, 1] and rates[a] > 0.0)
        out[a] = 0.0 if outward else rates[a]
        fastest = max(fastest, abs(out[a]) / p.rate_limit[arm, a])
    for a in range(n):
        out[a] /= fastest


@compiled
def servo(p, s, arm, joint, rate, q, force, ctrl):
    """One tick of a joint's servo: integrates the rate, watches the torque of the tick before, writes its control."""
    limits = p.joint_limits[arm, joint]
    rate = clip(rate, -p.rate_limit[arm, joint], p.rate_limit[arm, joint])
    command = s.command[arm, joint] + rate * TIMESTEP
    command = clip(clip(command, q - FOLLOWING_ERROR, q + FOLLOWING_ERROR), limits[0], limits[1])
    s.command[arm, joint] = command
    share = force / p.torque_limit[arm, joint]
    s.load[arm, joint] += share / lay.SUBSTEPS
    wanted = command
    if s.protected[arm, joint] == 1:
        if abs(command - q) < BACKED_OFF:
            s.protected[arm, joint] = 0
        give = PROTECTIVE_SHARE * p.torque_limit[arm, joint] / p.stiffness[arm, joint]
        wanted = clip(command, q - give, q + give)
        s.overload_ticks[arm, joint] = 0
    elif abs(share) >= OVERLOAD_SHARE:
        s.overload_ticks[arm, joint] += 1
        if s.overload_ticks[arm, joint] > OVERLOAD_TICKS:
            s.protected[arm, joint] = 1
    else:
        s.overload_ticks[arm, joint] = 0
    ctrl[p.arm_ctrl[arm] + joint] = wanted


@compiled
def worm(p, s, arm, drive, left, right, ctrl):
    """One tick of a gripper: the screw turns while its motor is not stalled, and only the motor turns it.

    `drive` in [−1, 1] is the share of the jaws' speed; the fingers at `left` and `right` [m] load the motor with
    stiffness · (screw − finger), by their mean.
    """
    w, k, stall = s.screw[arm], p.jaw_stiffness[arm], p.jaw_stall[arm]
    mean = 0.5 * (left + right)
    step = drive * p.jaw_speed[arm] * TIMESTEP
    step = clip(step, min(mean - stall / k - w, 0.0), max(mean + stall / k - w, 0.0))
    w = clip(w + step, 0.0, p.jaw_travel[arm])
    s.screw[arm] = w
    s.gripper_load[arm] = k * (w - mean) / stall
    first = p.arm_ctrl[arm] + p.joints[arm]
    ctrl[first] = w
    ctrl[first + 1] = w


@compiled
def center_of_mass(p, s, qpos, out):
    """Centre of mass (3,) of the whole vehicle in the body frame, as the autopilot believes: by the encoders."""
    poses, tool, q = np.empty((lay.JOINTS, 4, 4)), np.empty((4, 4)), np.empty(lay.JOINTS)
    mass = p.fixed_mass
    for k in range(3):
        out[k] = p.fixed_mass * p.fixed_center[k]
    for arm in range(p.arms):
        for i in range(p.joints[arm]):
            q[i] = encoded(qpos[p.arm_qpos[arm] + i])
        forward(p, arm, q, poses, tool)
        for i in range(p.joints[arm]):
            m, c, T = p.link_mass[arm, i], p.link_center[arm, i], poses[i]
            mass += m
            for k in range(3):
                out[k] += m * (T[k, 0] * c[0] + T[k, 1] * c[1] + T[k, 2] * c[2] + T[k, 3])
    for k in range(3):
        out[k] /= mass


@compiled
def encoded(angle):
    """What a 12-bit encoder says."""
    return ENCODER_QUANTUM * math.floor(angle / ENCODER_QUANTUM + 0.5)


@compiled
def read_arms(p, s, qpos, moved):
    """Readings at the end of a control step: angles, speeds, tools. `moved`: 0 at rest after a reset, else 1."""
    poses = np.empty((lay.JOINTS, 4, 4))
    for arm in range(p.arms):
        for i in range(p.joints[arm]):
            angle = qpos[p.arm_qpos[arm] + i]
            speed = moved * (angle - s.joint[arm, i]) / (lay.SUBSTEPS * TIMESTEP)
            s.joint_rate[arm, i] = RATE_QUANTUM * math.floor(speed / RATE_QUANTUM + 0.5)
            s.joint[arm, i] = angle
            s.encoder[arm, i] = encoded(angle)
        for f in range(2):
            s.finger[arm, f] = qpos[p.arm_qpos[arm] + p.joints[arm] + f]
        forward(p, arm, s.joint[arm], poses, s.true_tool[arm])
        forward(p, arm, s.encoder[arm], poses, s.tool[arm])
