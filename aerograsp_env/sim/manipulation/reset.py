"""The beginning of an episode: draws, the vehicle in equilibrium, the arms at rest, then what the task places."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from aerograsp_env.sim.airframe import AIR_DENSITY, GRAVITY
from aerograsp_env.sim.config import CONTROL_STEP
from aerograsp_env.sim.docking_tool import R_WORLD_BASE
from aerograsp_env.sim.kernel_sensors import blow, slow_errors
from aerograsp_env.sim.manipulation import layout as lay
from aerograsp_env.sim.manipulation.config import HOVER, ManipulationConfig, ManipulationRandomizeConfig
from aerograsp_env.sim.manipulation.kernel import feedforward_torque
from aerograsp_env.sim.manipulation.kernel_arm import center_of_mass
from aerograsp_env.sim.manipulation.task import Episode, Task
from aerograsp_env.sim.parameters import HOVER_OFFSET, set_sensors
from aerograsp_env.sim.reset import close_loop
from aerograsp_env.sim.scene import DOCK_POSITION, TIMESTEP, quaternion
from aerograsp_env.sim.sensors import SensorConfig
from aerograsp_env.sim.wind import dryden_coefficients

COMMON_OPTIONS = ("wind_direction",)


def check_options(options: dict | None, known: tuple[str, ...]) -> dict:
    """Reset's options, or an error that names the unknown one and lists the known."""
    options = dict(options or {})
    for key in options:
        if key not in known:
            raise ValueError(f"unknown reset option {key!r}; known: {', '.join(known)}")
    return options


def randomize(
    drawn: ManipulationRandomizeConfig, base: ManipulationConfig, p: np.ndarray, model: mujoco.MjModel, nominal, rng
) -> SensorConfig:
    """Draw one vehicle: writes into the record and this world's own model; returns its sensors. `nominal` stays."""
    draw = {name: rng.uniform(*getattr(drawn, name)) for name in drawn.__dataclass_fields__}
    body = int(p["airframe_body"])
    model.body_mass[:], model.body_inertia[:] = nominal.body_mass, nominal.body_inertia
    model.body_mass[body] *= draw["mass"]
    model.body_inertia[body] *= draw["mass"] * draw["inertia"]
    model.actuator_gainprm[:], model.actuator_biasprm[:] = nominal.actuator_gainprm, nominal.actuator_biasprm
    model.actuator_forcerange[:], model.geom_friction[:] = nominal.actuator_forcerange, nominal.geom_friction
    for i, mount in enumerate(base.machine.mounts):
        prefix, n = mount.prefix, mount.arm.n
        names = [link.name for link in mount.arm.links] + ["left_finger", "right_finger"]
        bodies = [model.body(prefix + name).id for name in names]
        model.body_mass[bodies] *= draw["arm_mass"]
        model.body_inertia[bodies] *= draw["arm_mass"]
        servos = slice(int(p["arm_ctrl"][i]), int(p["arm_ctrl"][i]) + n)
        model.actuator_gainprm[servos] *= draw["servo_gains"]
        model.actuator_biasprm[servos] *= draw["servo_gains"]
        model.actuator_forcerange[servos] *= draw["servo_torque"]
        p["stiffness"][i] *= draw["servo_gains"]
        p["torque_limit"][i] *= draw["servo_torque"]
        for name in ("left_pad", "right_pad", "left_finger", "right_finger"):
            model.geom_friction[model.geom(prefix + name).id] *= draw["friction"]
    p["jaw_stall"] *= draw["jaw_force"]
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


def _direction(options: dict[str, Any], config: ManipulationConfig, azimuth: float) -> float:
    direction = config.wind.direction if config.wind.direction is not None else azimuth
    value = np.asarray(options.get("wind_direction", direction), dtype=float)
    if value.shape != () or not np.isfinite(value):
        raise ValueError(f"options['wind_direction'] must be a finite angle [rad], got {options['wind_direction']!r}")
    return float(value)


def _draw_air_and_sensors(
    config: ManipulationConfig, p: np.ndarray, sensors: SensorConfig, rng: np.random.Generator, options: dict[str, Any]
) -> np.ndarray:
    """A state record with wind and sensor errors from their stationary distributions."""
    s = np.zeros((), lay.STATE)
    delay = rng.uniform(*config.command_delay)
    direction = _direction(options, config, rng.uniform(-np.pi, np.pi))
    gusts, slow, bias, wander = (rng.standard_normal(k) for k in (5, 12, 17, 6))
    signs, phases = rng.choice([-1.0, 1.0], 3), rng.uniform(size=2)
    directions = rng.standard_normal((2, 3))
    p["delay_ticks"] = round(delay / TIMESTEP)
    c, d = np.cos(direction), np.sin(direction)
    p["wind_axes"] = [[c, -d, 0.0], [d, c, 0.0], [0.0, 0.0, 1.0]]
    p["mean_wind"] = config.wind.mean_speed * np.array([c, d, 0.0])
    s["gust"] = dryden_coefficients(config.wind, CONTROL_STEP).initial @ gusts
    s["velocity_wander"], s["velocity_fast"], s["attitude_wander"], s["source_wander"] = slow.reshape(4, 3)
    source = getattr(sensors, config.localization)
    s["jump_phase"] = 1 + int(phases[0] * (p["source_jump_period"] - 1))
    s["source_offset"] = signs * source.offset
    s["gyro_bias"] = sensors.imu.gyro_bias_std * bias[:3]
    s["acceleration_bias"] = sensors.imu.acceleration_bias_std * bias[3:6]
    s["base_acceleration_bias"] = sensors.tool.acceleration_bias_std * bias[6:9]
    s["potentiometer_offset"] = sensors.tool.offset_std * bias[9:14]
    if config.estimate is not None:
        s["track_slow"], s["track_phase"] = wander.reshape(2, 3), phases[1] * p["track_interval"]
        lengths = np.array([config.estimate.position_bias, config.estimate.rotation_bias])
        p["track_bias"] = lengths[:, None] * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    records = np.empty(1, lay.PARAMETERS), np.empty(1, lay.STATE)
    records[0][0], records[1][0] = p, s
    blow(records[0][0], records[1][0])
    slow_errors(records[0][0], records[1][0])
    return records[1].reshape(())


def _dock(p: np.ndarray, s: np.ndarray, config: ManipulationConfig, data: mujoco.MjData) -> None:
    """The seat on the pipe; the tool's joints near the nominal ones, on the solution's branch."""
    data.mocap_pos[0], data.mocap_quat[0] = DOCK_POSITION, quaternion(R_WORLD_BASE)
    data.eq_active[0] = config.docked
    s["coupled"] = s["armed"] = int(config.docked)
    s["locked"] = 1 - int(config.docked)
    angles = [0.0, 5.0, 109.0, -24.0, 0.0] if config.docked else [0.0, 0.0, 33.0, 57.0, 0.0]
    data.qpos[p["joint_address"]] = np.radians(angles)
    tip = DOCK_POSITION + R_WORLD_BASE @ np.asarray(config.tool.nominal_tip)
    data.qpos[:3] = tip - np.asarray(config.airframe.tip_position) + (0.0 if config.docked else HOVER_OFFSET)


def _couple(p: np.ndarray, model: mujoco.MjModel, data: mujoco.MjData) -> None:
    gap = close_loop(model, data)
    limits, q = p["mechanical_limits"], data.qpos[p["joint_address"]]
    if gap > 1e-6 or (q < limits[:, 0]).any() or (q > limits[:, 1]).any():
        raise ValueError(f"the tool cannot reach an airframe at {np.round(data.qpos[:3], 3)} m")


def _rest_arms(p: np.ndarray, s: np.ndarray, model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Servo commands that hold the arms where they are against gravity; the screws where the fingers are."""
    mujoco.mj_forward(model, data)
    for arm in range(int(p["arms"])):
        n, first, control = int(p["joints"][arm]), int(p["arm_qpos"][arm]), int(p["arm_ctrl"][arm])
        q, bias = data.qpos[first : first + n], data.qfrc_bias[first - 1 : first - 1 + n]
        limits = p["joint_limits"][arm, :n]
        s["command"][arm, :n] = np.clip(q + bias / p["stiffness"][arm, :n], limits[:, 0], limits[:, 1])
        s["joint"][arm, :n] = q
        s["screw"][arm] = data.qpos[first + n : first + n + 2].mean()
        data.ctrl[control : control + n], data.ctrl[control + n : control + n + 2] = (
            s["command"][arm, :n],
            s["screw"][arm],
        )


def _trim(p: np.ndarray, s: np.ndarray, config: ManipulationConfig, model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Hover: rotor speeds that carry the vehicle, integrators that carry the wind and what it cannot know."""
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    airframe, body = config.airframe, int(p["airframe_body"])
    mass = model.body_subtreemass[body]
    com = data.subtree_com[body] - data.qpos[:3]
    weight = mass * GRAVITY
    thrusts = np.linalg.pinv(airframe.allocation(com)) @ np.array([weight, 0.0, 0.0, 0.0])
    s["rotor_speed"] = np.sqrt(np.maximum(thrusts, 0.0) / p["thrust_constant"])
    scale = airframe.rotor.thrust_constant / float(p["thrust_constant"])  # commanded thrust per thrust
    torque = scale * (airframe.allocation(p["mixer_center"]) @ thrusts)[1:]
    if p["feedforward"]:
        records, believed = _pair(p, s), np.zeros(3)
        center_of_mass(*records, data.qpos, believed)
        torque[:2] -= feedforward_torque(records[0], believed, scale * weight)
    s["rate_integral"] = torque / p["torque_scale"]
    wind = s["wind"]
    drag = 0.5 * AIR_DENSITY * p["drag_area"] * np.linalg.norm(wind) * wind
    drag[:2] += p["rotor_drag"] * s["rotor_speed"].sum() * wind[:2]
    believed_mass = float(p["believed_mass"])
    vertical = (weight - drag[2]) * scale / believed_mass - GRAVITY
    s["velocity_integral"] = np.array([-drag[0] * scale / believed_mass, -drag[1] * scale / believed_mass, vertical])
    s["velocity_integral"] += p["velocity_p"] * s["velocity_error"]  # the loop has settled with the estimate's error


def _pair(p: np.ndarray, s: np.ndarray) -> tuple[Any, Any]:
    """The two records as compiled functions take them."""
    return p.reshape(1)[0], s.reshape(1)[0]


def reset_world(
    config: ManipulationConfig, task: Task, blank: np.ndarray, nominal: mujoco.MjModel, model: mujoco.MjModel,
    data: mujoco.MjData, rng: np.random.Generator, options: dict[str, Any],
    out_p: np.ndarray, out_s: np.ndarray, record: np.ndarray,
) -> None:  # fmt: skip
    """Begin an episode in one world: writes its records (zero-dimensional views) and its MjData.

    `blank` are the parameters of the vehicle in the `nominal` model, without an episode's draws; `model` is the world's
    own.
    """
    p = blank.copy()
    sensors = config.sensors
    if config.randomize is not None:
        sensors = randomize(config.randomize, config, p, model, nominal, rng)
    mujoco.mj_resetData(model, data)
    s = _draw_air_and_sensors(config, p, sensors, rng, options)
    data.qpos[:7] = (*HOVER, 1.0, 0.0, 0.0, 0.0)
    episode = Episode(config, model, data, p, s, record, rng, options)
    for i, mount in enumerate(config.machine.mounts):
        episode.arm_joints(i)[:] = mount.arm.home
    if p["has_tool"]:
        _dock(p, s, config, data)
        p["hold_position"] = data.qpos[:3]
    record[...] = np.zeros((), record.dtype)
    task.begin(episode)
    if config.docked:
        _couple(p, model, data)
    _rest_arms(p, s, model, data)
    _trim(p, s, config, model, data)
    if p["has_tool"]:
        up = np.zeros(3)
        mujoco.mju_rotVecQuat(up, np.array([0.0, 0.0, GRAVITY]), data.mocap_quat[0] * [1.0, -1.0, -1.0, -1.0])
        s["base_up"] = up + s["base_acceleration_bias"]  # the low-pass has settled before the episode
    mujoco.mj_forward(model, data)
    out_p[...], out_s[...] = p, s
