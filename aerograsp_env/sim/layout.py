"""The memory that Python and the compiled loop share: one record per world for parameters, one for state.

Structured arrays keep the compiled code readable (`s.velocity_integral[i]`) and a world's whole state in one value that
can be copied, compared and reset.
"""

from __future__ import annotations

import hashlib
import math
from pathlib import Path

import numpy as np

SUBSTEPS = 10  # physics ticks per control step
INTEGRAL_LEAK = math.exp(-0.02 / 10.0)  # a step of the observed error integral's 10 s memory
HISTORY = 16  # remembered actions: bounds the command delay
OBSERVED_ACTIONS = 6
POTENTIOMETER_SAMPLES = 24  # 1200 Hz at 50 Hz control
GYRO_NOISE = 3 * SUBSTEPS
POTENTIOMETER_NOISE = 5 * POTENTIOMETER_SAMPLES
SLOW_NOISE = 28  # one standard normal per slow process and control step, see kernel_sensors.advance_slow
NOISE = SLOW_NOISE + GYRO_NOISE + POTENTIOMETER_NOISE
NOISE_BLOCK = 50  # control steps drawn at once

# localisation codes
DOCK, GPS, VISION, TRUTH = range(4)
LOCALIZATIONS = {"dock": DOCK, "gps": GPS, "vision": VISION, "truth": TRUTH}

# termination codes
RUNNING, JOINT_LIMIT, COLLISION, OVERLOAD, OUT_OF_BOUNDS, DIVERGED = range(6)
TERMINATIONS = ("", "joint_limit", "collision", "overload", "out_of_bounds", "diverged")

# columns of the pointer table, filled by worlds.py
POINTERS = ("model", "data", "qpos", "qvel", "qacc", "ctrl", "xfrc", "qfrc", "xmat", "xpos", "sensordata")
(P_MODEL, P_DATA, P_QPOS, P_QVEL, P_QACC, P_CTRL, P_XFRC, P_QFRC, P_XMAT, P_XPOS, P_SENSOR) = range(len(POINTERS))


def source_hash(*folders: Path) -> str:
    """A hash of the sources that a compiled loop is made of: of this folder, and of others.

    numba's cache on disk knows a compiled function by its own file alone, not by the files of what it calls or takes
    constants from. With this in a field's name the hash is part of the arguments' type, and so of what the cache looks
    up.
    """
    digest = hashlib.sha256()
    for path in sorted(path for folder in (Path(__file__).parent, *folders) for path in folder.glob("*.py")):
        if path.stem.startswith("kernel") or path.stem in ("layout", "scene", "airframe"):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


F = np.float64
Fields = list[tuple]

# fields that the compiled autopilot, air, sensors and tool of `kernel_control` and `kernel_sensors` read and write
VEHICLE_PARAMETERS: Fields = [
    # airframe
    ("airframe_body", np.int64),
    ("base_body", np.int64),
    ("com", F, (3,)),
    ("rotor_position", F, (6, 3)),
    ("thrust_constant", F),
    ("speed_max", F),
    ("spin_up", F),  # fraction of the gap to the commanded speed closed in one tick
    ("spin_down", F),
    ("rotor_drag", F),
    ("rotor_radius", F),
    ("drag_area", F),
    # autopilot
    ("believed_mass", F),
    ("believed_thrust_constant", F),
    ("thrust_max", F),
    ("mixer", F, (6, 4)),
    ("torque_scale", F, (3,)),
    ("velocity_p", F, (3,)),
    ("velocity_i", F, (3,)),
    ("velocity_d", F, (3,)),
    ("velocity_d_blend", F),
    ("tilt_max", F),
    ("attitude_p", F, (3,)),
    ("rate_p", F, (3,)),
    ("rate_i", F, (3,)),
    ("rate_d", F, (3,)),
    ("rate_d_blend", F),
    ("rate_integral_limit", F),
    ("rate_max", F, (3,)),
    ("heading_frame", np.int64),
    # wind
    ("mean_wind", F, (3,)),
    ("wind_axes", F, (3, 3)),  # columns: along, across, up, in the world
    ("gust_transition", F, (5, 5)),
    ("gust_input", F, (5, 5)),
    ("gust_output", F, (3, 5)),
    # sensors: blends are exp(−dt/τ)
    ("velocity_wander_limit", F, (3,)),
    ("velocity_wander_blend", F),
    ("velocity_std", F),
    ("velocity_blend", F),
    ("gyro_std", F),
    ("acceleration_std", F),
    ("attitude_limit", F),
    ("attitude_blend", F),
    ("source_period", np.int64),  # control steps between position samples
    ("source_wander_limit", F, (3,)),
    ("source_wander_blend", F),
    ("source_jump_size", F, (3,)),
    ("source_jump_period", np.int64),  # control steps
    ("source_jump_steps", np.int64),
    ("source_white_std", F, (3,)),
    ("potentiometer_std", F),
    ("potentiometer_quantum", F),
    ("base_acceleration_std", F),
    ("tilt_blend", F),
    # docking tool
    ("lengths", F, (5,)),
    ("signal_limits", F, (5, 2)),
    ("mechanical_limits", F, (5, 2)),
    ("joint_address", np.int64, (5,)),  # in qpos; in qvel it is one less
    ("tip_position", F, (3,)),
    ("tip_rotation", F, (3, 3)),  # R_tip_body
    ("seat_rotation", F, (3, 3)),  # R_world_base as the vehicle believes it
    ("seat_position", F, (3,)),
    ("stop_stiffness", F),
    ("stop_damping", F),
    ("stop_give", F),  # bend at which a stop breaks [rad]
    ("overload_force", F),
    ("lock_torque", F),
    ("lock_stiffness", F),
    # commands
    ("localization", np.int64),
    ("velocity_limit", F, (3,)),
    ("yaw_rate_limit", F),
    ("delay_ticks", np.int64),
]
PARAMETERS = np.dtype(
    [
        *VEHICLE_PARAMETERS,
        # task
        ("nominal", F, (3,)),  # airframe origin with the tool in its nominal docked pose, world
        ("set_point", F, (3,)),  # airframe origin to hold, world
        ("skip_steps", np.int64),  # control steps before errors count
        ("bound", F),  # distance from the set-point that ends an undocked episode [m]
        ("settle_steps", np.int64),  # the window in which DockAttach must be held
        ("attach", np.int64),
        ("couple_distance", F),
        ("couple_angle", F),
        ("couple_speed", F),
        (f"sources_{source_hash()}", np.int64),
    ],
    align=True,
)

EPISODE_STATE: Fields = [
    ("step", np.int64),
    ("termination", np.int64),
    ("coupled", np.int64),
    ("armed", np.int64),  # joint limits end the episode only once every joint has been within its signal range
    ("locked", np.int64),
]
VEHICLE_STATE: Fields = [
    # autopilot
    ("rotor_speed", F, (6,)),
    ("velocity_integral", F, (3,)),
    ("velocity_slope", F, (3,)),
    ("last_velocity", F, (3,)),
    ("rate_integral", F, (3,)),
    ("rate_slope", F, (3,)),
    ("last_rate", F, (3,)),
    ("yaw_set_point", F),
    # wind and slow errors
    ("gust", F, (5,)),
    ("wind", F, (3,)),
    ("velocity_wander", F, (3,)),
    ("velocity_error", F, (3,)),
    ("velocity_fast", F, (3,)),
    ("attitude_wander", F, (3,)),
    ("attitude_error", F, (3,)),
    ("gyro_bias", F, (3,)),
    ("acceleration_bias", F, (3,)),
    ("source_offset", F, (3,)),
    ("source_wander", F, (3,)),
    ("source_jump", F, (3,)),
    ("jump_phase", np.int64),
    ("source_estimate", F, (3,)),
    ("source_error", F, (3,)),
    ("potentiometer_offset", F, (5,)),
    ("base_acceleration_bias", F, (3,)),
    # readings
    ("gyro", F, (3,)),
    ("joints", F, (5,)),
    ("base_acceleration", F, (3,)),
    ("base_up", F, (3,)),
    ("estimate", F, (3,)),
    ("velocity_estimate", F, (3,)),
]
STATE = np.dtype(
    [
        *EPISODE_STATE,
        ("wants_coupling", np.int64),
        ("actions", F, (HISTORY, 5)),  # newest first
        *VEHICLE_STATE,
        # bookkeeping
        ("error_integral", F, (3,)),
        ("true_error", F, (3,)),
        ("error_sum", F, (3,)),
        ("error_signed", F, (3,)),
        ("error_squared", F, (3,)),
        ("error_count", np.int64),
        ("held", F, (3, 256)),  # ring of |error| over the settling window of DockAttach
        ("coupled_step", np.int64),
        ("effort_sum", F),
        ("clamp_force_max", F),
    ],
    align=True,
)

# observation layout: name → (first, size, bound)
DOCK_OBSERVATION = (
    ("position_error", 3, 5.0),
    ("error_integral", 3, 5.0),
    ("velocity", 3, 5.0),
    ("attitude", 3, float(np.pi)),
    ("angular_velocity", 3, 20.0),
    ("specific_force", 3, 100.0),
    ("joints", 5, float(np.pi)),
    ("base_acceleration", 3, 20.0),
    ("previous_actions", 3 * OBSERVED_ACTIONS, 1.0),
    ("set_point", 3, 5.0),
)
ATTACH_OBSERVATION = (
    *DOCK_OBSERVATION[:8],
    ("previous_actions", 5 * OBSERVED_ACTIONS, 1.0),
    ("set_point", 3, 5.0),
    ("seat_offset", 3, 5.0),
    ("coupled", 1, 1.0),
)
