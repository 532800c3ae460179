"""The beginning of an episode: draws, placing the vehicle, closing the tool's loop, trimming.

A world starts in equilibrium: rotors at hover, the autopilot's integrators as they stand after a while in the wind that
blows, the slow errors drawn from their stationary distributions. Only then do the first seconds resemble the rest.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim import layout as lay
from aerograsp_env.sim.airframe import AIR_DENSITY, GRAVITY
from aerograsp_env.sim.config import CONTROL_STEP, DockConfig, RandomizeConfig
from aerograsp_env.sim.docking_tool import R_WORLD_BASE
from aerograsp_env.sim.kernel_sensors import blow, slow_errors
from aerograsp_env.sim.parameters import make_parameters, set_sensors
from aerograsp_env.sim.scene import DOCK_POSITION, JOINT_NAMES, TIMESTEP, quaternion
from aerograsp_env.sim.sensors import SensorConfig
from aerograsp_env.sim.wind import dryden_coefficients

HANGING = np.array([0.0, 0.0, np.radians(33.0), np.radians(57.0), 0.0])  # θ of the tool at rest below the vehicle [rad]
RESET_OPTIONS = ("goal", "start", "wind_direction", "tilt")


def offset_option(options: dict, name: str, limit: float) -> NDArray[np.float64] | None:
    """A (3,) offset from the nominal [m] out of reset's options, or None."""
    if name not in options:
        return None
    value = np.asarray(options[name], dtype=float)
    if value.shape != (3,) or not np.isfinite(value).all() or np.abs(value).max() > limit:
        wanted = f"3 finite offsets within ±{limit} m of the nominal"
        raise ValueError(f"options[{name!r}] must be {wanted}, got {options[name]!r}")
    return value


def check_options(options: dict | None) -> dict:
    """Reset's options, or an error that names the unknown one and lists the known."""
    options = dict(options or {})
    for key in options:
        if key not in RESET_OPTIONS:
            raise ValueError(f"unknown reset option {key!r}; known: {', '.join(RESET_OPTIONS)}")
    return options


def randomize(
    config: RandomizeConfig, base: DockConfig, p: np.ndarray, model: mujoco.MjModel, nominal, rng
) -> SensorConfig:
    """Draw one vehicle: writes into the record and this world's own model; returns its sensors. `nominal` stays."""
    draw = {name: rng.uniform(*getattr(config, name)) for name in config.__dataclass_fields__}
    body = int(p["airframe_body"])
    model.body_mass[body] = nominal.body_mass[body] * draw["mass"]
    model.body_inertia[body] = nominal.body_inertia[body] * draw["mass"] * draw["inertia"]
    flex = model.joint("flex").id
    model.jnt_stiffness[flex] = nominal.jnt_stiffness[flex] * draw["flex_stiffness"]
    for name in JOINT_NAMES:
        dof = model.joint(name).dofadr[0]
        model.dof_damping[dof] = nominal.dof_damping[dof] * draw["joint_damping"]
    mujoco.mj_setConst(model, mujoco.MjData(model))
    p["thrust_constant"] *= draw["thrust"]
    rotor = base.airframe.rotor
    for name, time in (("spin_up", rotor.time_constant_up), ("spin_down", rotor.time_constant_down)):
        p[name] = 1.0 - np.exp(-TIMESTEP / (time * draw["motor_time"]))
    p["drag_area"] *= draw["drag"]
    p["rotor_drag"] *= draw["drag"]
    for name in ("velocity_p", "velocity_i", "velocity_d"):
        p[name] *= draw["velocity_gains"]
    sensors = base.sensors.scaled(draw["sensor_noise"])
    set_sensors(p, base, sensors)
    return sensors


def close_loop(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """Bend the flex and the five joints so that the tool's base lies in the seat (Gauss–Newton); the gap left [m]."""
    base, seat = model.site("base").id, model.site("dock").id
    jacobian, wanted = np.zeros((6, model.nv)), np.zeros(3)
    for _ in range(50):
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        rotation = data.site_xmat[seat].reshape(3, 3) @ data.site_xmat[base].reshape(3, 3).T
        mujoco.mju_quat2Vel(wanted, quaternion(rotation), 1.0)
        error = np.concatenate([data.site_xpos[seat] - data.site_xpos[base], wanted])
        if np.abs(error).max() < 1e-12:
            break
        mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], base)
        j = jacobian[:, 6:12]
        change = np.linalg.solve(j.T @ j + 1e-10 * np.eye(6), j.T @ error)
        data.qpos[7:13] += np.clip(change, -0.3, 0.3)
    return float(np.linalg.norm(data.site_xpos[seat] - data.site_xpos[base]))


def _place(config: DockConfig, p: np.ndarray, model, data, start, tilt) -> None:
    """Put the level airframe at `start` and the tool into the seat, or hanging."""
    data.qpos[:3], data.qpos[3:7] = start, (1.0, 0.0, 0.0, 0.0)
    address = p["joint_address"]
    level = np.zeros(4)
    mujoco.mju_euler2Quat(level, np.array([tilt[0], tilt[1], 0.0]), "xyz")
    seat = np.zeros(4)
    mujoco.mju_mulQuat(seat, quaternion(R_WORLD_BASE), level)
    data.mocap_pos[0], data.mocap_quat[0] = DOCK_POSITION, seat
    if not config.docked or config.attach:
        data.qpos[address] = HANGING
        data.eq_active[0] = 0
        return
    data.eq_active[0] = 1
    data.qpos[address] = np.radians([0.0, 5.0, 109.0, -24.0, 0.0])  # close to the nominal: the solution's branch
    gap = close_loop(model, data)
    limits = p["mechanical_limits"]
    q = data.qpos[address]
    if gap > 1e-6 or (q < limits[:, 0]).any() or (q > limits[:, 1]).any():
        raise ValueError(f"the tool cannot reach a start at {np.round(start - p['nominal'], 3)} m from the nominal")


def _trim(p: np.ndarray, s: np.ndarray, config: DockConfig, model, data) -> None:
    """Hover: rotor speeds that carry the vehicle, integrators that carry the wind and what it cannot know."""
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    body = int(p["airframe_body"])
    mass = model.body_subtreemass[body]
    com = data.subtree_com[body] - data.qpos[:3]
    thrusts = np.linalg.pinv(config.airframe.allocation(com)) @ np.array([mass * GRAVITY, 0.0, 0.0, 0.0])
    s["rotor_speed"] = np.sqrt(np.maximum(thrusts, 0.0) / p["thrust_constant"])
    scale = config.airframe.rotor.thrust_constant / float(p["thrust_constant"])  # commanded thrust per thrust
    s["rate_integral"] = scale * (config.airframe.allocation(p["com"]) @ thrusts)[1:] / p["torque_scale"]
    wind = s["wind"]
    drag = 0.5 * AIR_DENSITY * p["drag_area"] * np.linalg.norm(wind) * wind
    drag[:2] += p["rotor_drag"] * s["rotor_speed"].sum() * wind[:2]
    believed = float(p["believed_mass"])
    vertical = (mass * GRAVITY - drag[2]) * scale / believed - GRAVITY
    s["velocity_integral"] = np.array([-drag[0] * scale / believed, -drag[1] * scale / believed, vertical])
    s["velocity_integral"] += p["velocity_p"] * s["velocity_error"]  # the loop has settled with the estimate's error


def reset_world(config: DockConfig, nominal: mujoco.MjModel, model, data, rng, options: dict, out_p, out_s) -> None:
    """Begin an episode in one world: writes its parameter and state records (zero-dimensional views) and its MjData."""
    p = make_parameters(config, nominal)
    s = np.zeros((), lay.STATE)
    sensors = config.sensors
    if config.randomize is not None:
        sensors = randomize(config.randomize, config, p, model, nominal, rng)
    mujoco.mj_resetData(model, data)

    set_point = rng.uniform(-config.set_point_spread, config.set_point_spread, 3)
    start = rng.uniform(-config.start_spread, config.start_spread, 3)
    delay = rng.uniform(*config.command_delay)
    azimuth = rng.uniform(-np.pi, np.pi)
    tilt = rng.normal(0.0, config.tilt_std, 2)
    gusts, slow, bias = rng.standard_normal(5), rng.standard_normal(12), rng.standard_normal(17)
    signs = rng.choice([-1.0, 1.0], 3)
    phase = rng.uniform()
    reach = 2.0 if config.attach or not config.docked else 0.12
    given = offset_option(options, "goal", 0.12)
    set_point = set_point if given is None else given
    if config.attach:
        start = np.array([-0.45, 0.0, 0.45]) + start / max(config.start_spread, 1e-9) * np.array([0.15, 0.15, 0.10])
    else:
        start = start + set_point
    given = offset_option(options, "start", reach)
    start = start if given is None else given
    direction = config.wind.direction if config.wind.direction is not None else azimuth
    direction = float(options.get("wind_direction", direction))
    tilt = np.asarray(options.get("tilt", tilt), dtype=float)
    if not np.isfinite(direction) or tilt.shape != (2,) or not np.isfinite(tilt).all() or np.abs(tilt).max() > 0.35:
        raise ValueError("options 'wind_direction' must be finite [rad] and 'tilt' two angles within ±0.35 rad")

    p["set_point"] = p["nominal"] + set_point
    p["delay_ticks"] = round(delay / TIMESTEP)
    c, d = np.cos(direction), np.sin(direction)
    p["wind_axes"] = [[c, -d, 0.0], [d, c, 0.0], [0.0, 0.0, 1.0]]
    p["mean_wind"] = config.wind.mean_speed * np.array([c, d, 0.0])
    s["gust"] = dryden_coefficients(config.wind, CONTROL_STEP).initial @ gusts
    s["velocity_wander"], s["velocity_fast"], s["attitude_wander"], s["source_wander"] = slow.reshape(4, 3)
    source = getattr(sensors, config.free_source)
    s["jump_phase"] = 1 + int(phase * (p["source_jump_period"] - 1))
    s["source_offset"] = signs * source.offset
    s["gyro_bias"] = sensors.imu.gyro_bias_std * bias[:3]
    s["acceleration_bias"] = sensors.imu.acceleration_bias_std * bias[3:6]
    s["base_acceleration_bias"] = sensors.tool.acceleration_bias_std * bias[6:9]
    s["potentiometer_offset"] = sensors.tool.offset_std * bias[9:14]
    records = np.empty(1, lay.PARAMETERS), np.empty(1, lay.STATE)
    records[0][0], records[1][0] = p, s
    blow(records[0][0], records[1][0])
    slow_errors(records[0][0], records[1][0])
    s = records[1][0]

    _place(config, p, model, data, p["nominal"] + start, tilt)
    s["coupled"] = s["armed"] = int(config.docked and not config.attach)
    s["locked"] = 1 - s["coupled"]
    _trim(p, s, config, model, data)
    up = np.zeros(3)
    mujoco.mju_rotVecQuat(up, np.array([0.0, 0.0, GRAVITY]), _conjugate(data.mocap_quat[0]))
    s["base_up"] = up + s["base_acceleration_bias"]  # the low-pass has settled before the episode
    mujoco.mj_forward(model, data)
    out_p[...], out_s[...] = p, s


def _conjugate(q: np.ndarray) -> np.ndarray:
    return np.array([q[0], -q[1], -q[2], -q[3]])
