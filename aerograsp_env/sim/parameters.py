"""From a configuration to the record that the compiled loop reads."""

from __future__ import annotations

from typing import Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim import layout as lay
from aerograsp_env.sim.airframe import AirframeConfig
from aerograsp_env.sim.autopilot import AutopilotConfig
from aerograsp_env.sim.config import CONTROL_STEP, DockConfig
from aerograsp_env.sim.docking_tool import R_TIP_BODY, R_WORLD_BASE, DockingToolConfig
from aerograsp_env.sim.scene import DOCK_POSITION, JOINT_NAMES, TIMESTEP
from aerograsp_env.sim.sensors import SensorConfig
from aerograsp_env.sim.wind import WindConfig, dryden_coefficients

# where an undocked vehicle hovers: clear of the pipe, from the docked nominal [m]
HOVER_OFFSET = np.array([-0.3, 0.0, 0.6])


def _blend(time: float, step: float) -> float:
    return float(np.exp(-step / time)) if time > 0 else 0.0


def docked_nominal(config: DockConfig) -> NDArray[np.float64]:
    """(3,) airframe origin, world, with the level vehicle's tip at the tool's nominal place and heading 0 [m]."""
    tip = DOCK_POSITION + R_WORLD_BASE @ np.asarray(config.tool.nominal_tip)
    return tip - np.asarray(config.airframe.tip_position)


def make_parameters(config: DockConfig, model: mujoco.MjModel) -> np.ndarray:
    """A zero-dimensional record (dtype layout.PARAMETERS) without the per-episode draws."""
    p = np.zeros((), lay.PARAMETERS)
    airframe, tool = config.airframe, config.tool
    mass, com, _ = airframe.properties()
    set_airframe(p, airframe, model)
    p["believed_mass"] = mass + sum(tool.link_masses)
    p["mixer"] = np.linalg.pinv(airframe.allocation(com))
    set_autopilot(p, config.autopilot)
    set_gusts(p, config.wind)
    set_sensors(p, config, config.sensors)
    set_tool(p, tool, airframe, model)

    p["localization"] = lay.LOCALIZATIONS[config.localization]
    p["velocity_limit"], p["yaw_rate_limit"] = config.velocity_limit, config.yaw_rate_limit if config.attach else 0.0
    p["nominal"] = docked_nominal(config) + (0.0 if config.docked or config.attach else HOVER_OFFSET)
    p["skip_steps"] = round(config.skip / CONTROL_STEP)
    p["bound"] = config.bound
    p["settle_steps"] = round(5.0 / CONTROL_STEP)
    p["attach"] = config.attach
    p["couple_distance"], p["couple_angle"], p["couple_speed"] = 0.04, np.radians(20.0), 0.4
    return p


def set_airframe(p: np.ndarray, airframe: AirframeConfig, model: mujoco.MjModel) -> None:
    """Rotors and air of `airframe`, in place; not the believed mass and the mixer, which depend on what it holds."""
    rotor = airframe.rotor
    p["airframe_body"] = model.body("airframe").id
    p["com"] = airframe.properties()[1]
    p["rotor_position"] = airframe.rotor_positions()
    p["thrust_constant"], p["speed_max"] = rotor.thrust_constant, rotor.speed_max
    p["spin_up"] = 1.0 - _blend(rotor.time_constant_up, TIMESTEP)
    p["spin_down"] = 1.0 - _blend(rotor.time_constant_down, TIMESTEP)
    p["rotor_drag"], p["rotor_radius"], p["drag_area"] = rotor.drag, rotor.radius, airframe.drag_area
    p["believed_thrust_constant"] = rotor.thrust_constant
    p["thrust_max"] = rotor.thrust_max
    p["torque_scale"] = airframe.torque_scale()


def set_autopilot(p: np.ndarray, pilot: AutopilotConfig) -> None:
    """The autopilot's gains, in place."""
    p["velocity_p"] = (pilot.mpc_xy_vel_p_acc, pilot.mpc_xy_vel_p_acc, pilot.mpc_z_vel_p_acc)
    p["velocity_i"] = (pilot.mpc_xy_vel_i_acc, pilot.mpc_xy_vel_i_acc, pilot.mpc_z_vel_i_acc)
    p["velocity_d"] = (pilot.mpc_xy_vel_d_acc, pilot.mpc_xy_vel_d_acc, pilot.mpc_z_vel_d_acc)
    p["velocity_d_blend"] = 1.0 - np.exp(-2 * np.pi * pilot.mpc_veld_lp * TIMESTEP)
    p["tilt_max"] = pilot.mpc_tiltmax_air
    p["attitude_p"] = (pilot.mc_roll_p, pilot.mc_pitch_p, pilot.mc_yaw_p)
    p["rate_p"] = (pilot.mc_rollrate_p, pilot.mc_pitchrate_p, pilot.mc_yawrate_p)
    p["rate_i"] = (pilot.mc_rollrate_i, pilot.mc_pitchrate_i, pilot.mc_yawrate_i)
    p["rate_d"] = (pilot.mc_rollrate_d, pilot.mc_pitchrate_d, pilot.mc_yawrate_d)
    p["rate_d_blend"] = 1.0 - np.exp(-2 * np.pi * pilot.imu_dgyro_cutoff * TIMESTEP)
    p["rate_integral_limit"] = pilot.mc_rr_int_lim
    p["rate_max"] = (pilot.mc_rollrate_max, pilot.mc_rollrate_max, pilot.mc_yawrate_max)
    p["heading_frame"] = pilot.command_frame == "heading"


def set_gusts(p: np.ndarray, wind: WindConfig) -> None:
    """The gusts' exact discretisation, in place; the mean wind's direction is drawn per episode."""
    gust = dryden_coefficients(wind, CONTROL_STEP)
    p["gust_transition"], p["gust_input"], p["gust_output"] = gust.transition, gust.input, gust.output


def set_tool(p: np.ndarray, tool: DockingToolConfig, airframe: AirframeConfig, model: mujoco.MjModel) -> None:
    """The docking tool, in place."""
    p["base_body"] = model.body("tool_base").id
    p["lengths"] = tool.lengths
    p["signal_limits"], p["mechanical_limits"] = tool.signal_limits(), tool.mechanical_limits()
    p["joint_address"] = [model.joint(name).qposadr[0] for name in JOINT_NAMES]
    p["tip_position"], p["tip_rotation"] = airframe.tip_position, R_TIP_BODY
    p["seat_rotation"], p["seat_position"] = R_WORLD_BASE, DOCK_POSITION
    p["stop_stiffness"], p["stop_damping"] = tool.stop_stiffness, tool.stop_damping
    p["stop_give"] = tool.stop_strength / tool.stop_stiffness
    p["overload_force"] = tool.overload_force
    p["lock_torque"], p["lock_stiffness"] = tool.lock_torque, tool.lock_stiffness


class Localized(Protocol):
    """A configuration that names its position source."""

    @property
    def localization(self) -> str: ...

    @property
    def free_source(self) -> str: ...


def set_sensors(p: np.ndarray, config: Localized, sensors: SensorConfig) -> None:
    """Write the noise of `sensors` into the record, in place."""
    source = getattr(sensors, config.localization)
    far = getattr(sensors, config.free_source)
    p["velocity_wander_limit"] = source.velocity_limit
    p["velocity_wander_blend"] = _blend(sensors.velocity_wander_time, CONTROL_STEP)
    p["velocity_std"], p["velocity_blend"] = sensors.velocity_std, _blend(sensors.velocity_time, CONTROL_STEP)
    imu, tool = sensors.imu, sensors.tool
    p["gyro_std"], p["acceleration_std"] = imu.gyro_std, imu.acceleration_std
    p["attitude_limit"], p["attitude_blend"] = imu.attitude_limit, _blend(imu.attitude_time, CONTROL_STEP)
    p["source_period"] = max(round(1.0 / (far.rate * CONTROL_STEP)), 1)
    p["source_wander_limit"], p["source_wander_blend"] = far.wander_limit, _blend(far.wander_time, CONTROL_STEP)
    p["source_jump_size"] = far.jump_size
    p["source_jump_period"] = max(round(far.jump_interval / CONTROL_STEP), 1)
    p["source_jump_steps"] = round(far.jump_duration / CONTROL_STEP)
    p["source_white_std"] = far.white_std
    p["potentiometer_std"] = tool.white_std
    p["potentiometer_quantum"] = tool.electrical_range / 2**tool.adc_bits
    p["base_acceleration_std"], p["tilt_blend"] = tool.acceleration_std, _blend(tool.tilt_time, CONTROL_STEP)
