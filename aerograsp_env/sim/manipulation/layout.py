"""The records of a vehicle with arms: the docking simulation's vehicle, and arms, grippers, contacts, a tracked pose.

Sizes are those of the largest vehicle (two arms of six joints), so that one compiled step serves all. Arms are numbered
in the order of the vehicle's mounts.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from aerograsp_env.sim import layout as vehicle

ARMS, JOINTS = 2, 6
SUBSTEPS = vehicle.SUBSTEPS
HISTORY = vehicle.HISTORY

# Command slots: what an action's entries may stand for. A task says which of its entries goes where.
BASE_SLOT = 0  # velocity x, y, z, yaw rate
ARM_SLOT = (4, 4 + JOINTS)  # joint rates of an arm, or its tool's twist (linear, angular; body frame)
GRIPPER_SLOT = 4 + ARMS * JOINTS  # + arm: > 0 closes
SLOTS = GRIPPER_SLOT + ARMS

# Noise: the vehicle's slow processes and gyroscope, the tracked pose's, and the docking tool's where there is one.
TRACK_FIRST = vehicle.SLOW_NOISE + vehicle.GYRO_NOISE
TRACK_NOISE = 13  # white position and rotation, their wander, dropouts
TOOL_FIRST = TRACK_FIRST + TRACK_NOISE
NOISE = TOOL_FIRST
NOISE_WITH_TOOL = TOOL_FIRST + vehicle.POTENTIOMETER_NOISE
CAPTURES = 16  # remembered images of the tracked pose: bounds its delay

# How often something touched in a control step: rows of STATE.contacts.
CONTACTS = (
    "airframe",  # hub, booms, rotors against anything but the vehicle's own arms
    "arm_0", "arm_1",  # an arm or its gripper against anything but the vehicle and the object
    "arm_0_airframe", "arm_1_airframe",
    "arms",  # one against the other
    "arm_0_object", "arm_1_object",  # any part of the arm
    "left_finger_0", "right_finger_0", "left_finger_1", "right_finger_1",  # against the object
    "support",  # object against anything but the vehicle
)  # fmt: skip
(
    C_AIRFRAME, C_ARM_0, C_ARM_1, C_AIRFRAME_0, C_AIRFRAME_1, C_ARMS, C_OBJECT_0, C_OBJECT_1,
    C_LEFT_0, C_RIGHT_0, C_LEFT_1, C_RIGHT_1, C_SUPPORT,
) = range(len(CONTACTS))  # fmt: skip

# columns of the pointer table, filled by worlds.py
POINTERS = (
    "model", "data", "qpos", "qvel", "qacc", "ctrl", "force", "xfrc", "qfrc", "xmat", "xpos", "sensordata",
)  # fmt: skip
(
    P_MODEL, P_DATA, P_QPOS, P_QVEL, P_QACC, P_CTRL, P_FORCE, P_XFRC, P_QFRC, P_XMAT, P_XPOS, P_SENSOR,
) = range(len(POINTERS))  # fmt: skip

# termination codes: the docking simulation's, so that its compiled functions can be used
RUNNING, JOINT_LIMIT, COLLISION, OVERLOAD, OUT_OF_BOUNDS, DIVERGED = range(6)
TERMINATIONS = vehicle.TERMINATIONS

F, N = np.float64, np.int64
PARAMETERS = np.dtype(
    [
        *vehicle.VEHICLE_PARAMETERS,
        # model
        ("nq", N),
        ("nv", N),
        ("nu", N),
        ("nbody", N),
        ("nsensordata", N),
        ("has_tool", N),
        ("clamp_address", N),  # of the clamp's force in the sensor data
        ("object_address", N),  # of the object's free joint in qpos, −1: none; in qvel it is one less
        ("contact_address", N, (len(CONTACTS),)),  # in the sensor data, −1: not sensed
        # arms
        ("arms", N),
        ("joints", N, (ARMS,)),
        ("arm_qpos", N, (ARMS,)),  # first of an arm's joints, then the two fingers; in qvel it is one less
        ("arm_ctrl", N, (ARMS,)),
        ("placement", F, (ARMS, JOINTS, 4, 4)),  # T_parent_joint; the first one is T_body_joint
        ("axis", F, (ARMS, JOINTS, 3)),
        ("tool_placement", F, (ARMS, 4, 4)),  # T_last_tool
        ("link_mass", F, (ARMS, JOINTS)),  # of what moves rigidly with a joint, as the autopilot believes
        ("link_center", F, (ARMS, JOINTS, 3)),
        ("joint_limits", F, (ARMS, JOINTS, 2)),
        ("rate_limit", F, (ARMS, JOINTS)),
        ("torque_limit", F, (ARMS, JOINTS)),
        ("stiffness", F, (ARMS, JOINTS)),
        ("jaw_travel", F, (ARMS,)),
        ("jaw_speed", F, (ARMS,)),
        ("jaw_stall", F, (ARMS,)),
        ("jaw_stiffness", F, (ARMS,)),
        # autopilot
        ("feedforward", N),
        ("fixed_mass", F),  # of what does not move in the body frame
        ("fixed_center", F, (3,)),
        ("mixer_center", F, (3,)),  # centre of mass that the mixer was made for
        ("hold", N),  # 1: the base holds its place by itself, 0: it follows velocity commands
        ("hold_position", F, (3,)),  # true, where it should be; the autopilot knows only its estimate of it
        ("hold_p", F, (3,)),
        ("hold_limit", F, (3,)),
        # commands
        ("twist", N),  # 1: the arms' slots hold twists
        ("rate_scale", F),  # of a full action [rad/s]
        ("twist_scale", F, (2,)),  # [m/s], [rad/s]
        # tracked pose
        ("track_exact", N),
        ("track_interval", F),  # control steps between two images
        ("track_delay", N),  # control steps
        ("track_white", F, (2,)),  # std of position [m] and rotation [rad]
        ("track_wander", F, (2,)),
        ("track_wander_blend", F),
        ("track_bias", F, (2, 3)),  # of this episode: position, body frame [m]; rotation vector, its own frame [rad]
        ("track_loss", F),  # chance that tracking is lost at an image
        ("track_loss_steps", N),  # control steps without an image then
        # episode
        ("bound", F),  # distance from `hold_position` that ends an episode [m]
        (f"sources_{vehicle.source_hash(Path(__file__).parent)}", N),
    ],
    align=True,
)

STATE = np.dtype(
    [
        *vehicle.EPISODE_STATE,
        ("commands", F, (HISTORY, SLOTS)),  # newest first, in [−1, 1]
        *vehicle.VEHICLE_STATE,
        ("position", F, (3,)),  # of the airframe, true, world
        ("rotation", F, (3, 3)),  # R_world_body, true, at the end of the step
        ("attitude", F, (3, 3)),  # R_world_body as estimated
        ("specific_force", F, (3,)),
        ("autopilot_position", F, (3,)),  # the autopilot's own filtered position estimate, world
        ("hold_set_point", F, (3,)),  # what the autopilot took its place for when the episode began, world
        ("clamp_force_max", F),
        # arms
        ("command", F, (ARMS, JOINTS)),  # servo set-points [rad]
        ("twist_rate", F, (ARMS, JOINTS)),  # joint rates that a twist asks for [rad/s]
        ("joint", F, (ARMS, JOINTS)),  # true angles at the end of the step
        ("encoder", F, (ARMS, JOINTS)),  # angles that the servos report
        ("joint_rate", F, (ARMS, JOINTS)),  # speeds that they report [rad/s]
        ("load", F, (ARMS, JOINTS)),  # torque as a share of the limit, mean over the step
        ("overload_ticks", N, (ARMS, JOINTS)),
        ("protected", N, (ARMS, JOINTS)),
        ("screw", F, (ARMS,)),  # travel of the jaws' screw from the largest opening [m]
        ("finger", F, (ARMS, 2)),  # true travel of the fingers [m]
        ("gripper_load", F, (ARMS,)),  # motor's load as a share of its stall force
        ("tool", F, (ARMS, 4, 4)),  # T_body_tool by the encoders
        ("true_tool", F, (ARMS, 4, 4)),
        ("contacts", N, (len(CONTACTS),)),  # ticks with a touch in this step
        # object
        ("object", F, (4, 4)),  # T_world_object, true
        ("object_velocity", F, (6,)),  # linear (world), angular (object frame)
        # tracked pose
        ("track", F, (4, 4)),  # newest delivered estimate of T_body_tracked
        ("track_age", N),  # control steps since its image was taken
        ("track_phase", F),
        ("track_lost", N),  # control steps until tracking resumes
        ("track_slow", F, (2, 3)),  # wander's states
        ("captures", F, (CAPTURES, 4, 4)),  # newest first
        ("capture_age", N, (CAPTURES,)),  # control steps, −1: none
    ],
    align=True,
)
