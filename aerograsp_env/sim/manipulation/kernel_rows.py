"""Pieces of an observation row that tasks share, compiled. Each writes from column `k` on and returns the next one."""

from __future__ import annotations

import math

from aerograsp_env.sim.kernel_math import clip, compiled
from aerograsp_env.sim.manipulation import layout as lay


@compiled
def put_velocity(s, out, k):
    """The autopilot's velocity estimate in the body frame (3) [m/s]."""
    v, r = s.velocity_estimate, s.attitude
    for i in range(3):
        out[k + i] = r[0, i] * v[0] + r[1, i] * v[1] + r[2, i] * v[2]
    return k + 3


@compiled
def put_gyro(s, out, k):
    """Gyroscope, body frame (3) [rad/s]."""
    for i in range(3):
        out[k + i] = s.gyro[i]
    return k + 3


@compiled
def put_tilt(s, out, k):
    """Estimated roll and pitch (2) [rad]."""
    r = s.attitude
    out[k] = math.atan2(r[2, 1], r[2, 2])
    out[k + 1] = math.asin(clip(-r[2, 0], -1.0, 1.0))
    return k + 2


@compiled
def put_heading(s, out, k):
    """Estimated yaw (1) [rad]."""
    out[k] = math.atan2(s.attitude[1, 0], s.attitude[0, 0])
    return k + 1


@compiled
def put_joints(p, s, arm, out, k):
    """Encoder angles (n) [rad]."""
    for i in range(p.joints[arm]):
        out[k + i] = s.encoder[arm, i]
    return k + p.joints[arm]


@compiled
def put_joint_rates(p, s, arm, out, k):
    """Reported speeds (n) [rad/s]."""
    for i in range(p.joints[arm]):
        out[k + i] = s.joint_rate[arm, i]
    return k + p.joints[arm]


@compiled
def put_lag(p, s, arm, out, k):
    """Servo set-points − encoder angles (n) [rad]."""
    for i in range(p.joints[arm]):
        out[k + i] = s.command[arm, i] - s.encoder[arm, i]
    return k + p.joints[arm]


@compiled
def put_loads(p, s, arm, out, k):
    """Servo torques as shares of their limits (n)."""
    for i in range(p.joints[arm]):
        out[k + i] = s.load[arm, i]
    return k + p.joints[arm]


@compiled
def put_gripper(p, s, arm, out, k):
    """The opening by the fingers' sensors [m] and the motor's load as a share of its stall force (2)."""
    out[k] = 2.0 * p.jaw_travel[arm] - s.finger[arm, 0] - s.finger[arm, 1]
    out[k + 1] = s.gripper_load[arm]
    return k + 2


@compiled
def put_position(T, out, k):
    """Translation of a transform (3)."""
    for i in range(3):
        out[k + i] = T[i, 3]
    return k + 3


@compiled
def put_rotation(T, out, k):
    """The first two columns of a transform's rotation, one after the other (6; Zhou et al. 2019)."""
    for j in range(2):
        for i in range(3):
            out[k + 3 * j + i] = T[i, j]
    return k + 6


@compiled
def put_action(s, slots, out, k):
    """The action just given (A)."""
    for i in range(slots.shape[0]):
        out[k + i] = s.commands[0, slots[i]]
    return k + slots.shape[0]


@compiled
def clip_row(out, bounds):
    """Into the space's bounds, in place."""
    for k in range(out.shape[0]):
        out[k] = clip(out[k], -bounds[k], bounds[k])


@compiled
def mishaps(s):
    """Whether an arm touched in this step what it should not: the airframe, the other arm, or the surroundings."""
    return (
        s.contacts[lay.C_ARM_0] + s.contacts[lay.C_ARM_1] + s.contacts[lay.C_AIRFRAME_0]
        + s.contacts[lay.C_AIRFRAME_1] + s.contacts[lay.C_ARMS] > 0
    )  # fmt: skip


@compiled
def command_change(s):
    """Squared change of the action against the one before."""
    total = 0.0
    for i in range(lay.SLOTS):
        total += (s.commands[0, i] - s.commands[1, i]) ** 2
    return total
