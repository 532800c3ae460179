"""From a configuration to the record that the compiled loop reads."""

from __future__ import annotations

import mujoco
import numpy as np

from aerograsp_env.sim.arms.description import combined
from aerograsp_env.sim.config import CONTROL_STEP
from aerograsp_env.sim.layout import LOCALIZATIONS
from aerograsp_env.sim.manipulation import layout as lay
from aerograsp_env.sim.manipulation.config import HOVER, ManipulationConfig, PoseEstimateConfig
from aerograsp_env.sim.parameters import set_airframe, set_autopilot, set_gusts, set_sensors, set_tool
from aerograsp_env.sim.scene import JOINT_NAMES
from aerograsp_env.spatial import transform_points


def make_parameters(config: ManipulationConfig, model: mujoco.MjModel) -> np.ndarray:
    """A zero-dimensional record (dtype layout.PARAMETERS) without the per-episode draws."""
    p = np.zeros((), lay.PARAMETERS)
    vehicle = config.machine
    set_airframe(p, vehicle.airframe, model)
    set_autopilot(p, config.autopilot)
    set_gusts(p, config.wind)
    set_sensors(p, config, config.sensors)
    if config.vehicle.tool:
        p["has_tool"] = 1
        set_tool(p, config.tool, config.airframe, model)
    _set_arms(p, config)
    _set_mass(p, config)
    set_addresses(p, config, model)

    p["localization"] = LOCALIZATIONS[config.localization]
    p["velocity_limit"], p["yaw_rate_limit"] = config.velocity_limit, config.yaw_rate_limit
    p["hold"], p["hold_p"], p["hold_limit"] = config.hold, config.hold_gains, (2.0, 2.0, 1.0)
    p["hold_position"] = HOVER
    p["twist"], p["rate_scale"] = config.action_mode == "ee_twist", config.joint_rate
    p["twist_scale"] = config.twist
    p["bound"] = config.bound
    set_estimate(p, config.estimate)
    return p


def set_addresses(p: np.ndarray, config: ManipulationConfig, model: mujoco.MjModel) -> None:
    """Sizes of a model and where the vehicle's parts stand in it, in place: all that differs between models."""
    for name in ("nq", "nv", "nu", "nbody", "nsensordata"):
        p[name] = getattr(model, name)
    p["airframe_body"] = model.body("airframe").id
    if config.vehicle.tool:
        p["clamp_address"] = model.sensor("clamp_force").adr[0]
        p["base_body"] = model.body("tool_base").id
        p["joint_address"] = [model.joint(name).qposadr[0] for name in JOINT_NAMES]
    for i, mount in enumerate(config.machine.mounts):
        first = mount.prefix + mount.arm.joints[0].name
        p["arm_qpos"][i] = model.joint(first).qposadr[0]
        p["arm_ctrl"][i] = model.actuator(first).id
    loose = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, "object")
    p["object_address"] = model.jnt_qposadr[model.body_jntadr[loose]] if loose >= 0 else -1
    sensors = {model.sensor(i).name: int(model.sensor_adr[i]) for i in range(model.nsensor)}
    p["contact_address"] = [sensors.get(f"touch_{name}", -1) for name in lay.CONTACTS]


def _set_arms(p: np.ndarray, config: ManipulationConfig) -> None:
    mounts = config.machine.mounts
    p["arms"] = len(mounts)
    for i, mount in enumerate(mounts):
        arm, n = mount.arm, mount.arm.n
        p["joints"][i] = n
        p["placement"][i, :n] = [joint.T_parent_joint for joint in arm.joints]
        p["placement"][i, 0] = mount.T_body_base @ arm.joints[0].T_parent_joint
        p["axis"][i, :n] = [joint.axis for joint in arm.joints]
        p["tool_placement"][i] = arm.T_last_tool
        p["joint_limits"][i, :n] = arm.limits
        for name, attribute in (("rate_limit", "rate_limit"), ("torque_limit", "torque_limit"), ("stiffness",) * 2):
            p[name][i, :n] = [getattr(joint, attribute) for joint in arm.joints]
        gripper = arm.gripper
        p["jaw_travel"][i], p["jaw_speed"][i] = gripper.travel, gripper.jaw_speed
        p["jaw_stall"][i], p["jaw_stiffness"][i] = gripper.stall_force, gripper.stiffness
        links = arm.with_fingers()
        p["link_mass"][i, :n] = [link.mass for link in links]
        p["link_center"][i, :n] = [link.center_of_mass for link in links]


def _set_mass(p: np.ndarray, config: ManipulationConfig) -> None:
    """What the autopilot believes to carry; its mixer is made for the vehicle with its arms stowed."""
    vehicle = config.machine
    parts = [vehicle.airframe.properties()]
    for mount in vehicle.mounts:
        base = mount.arm.base
        parts.append((base.mass, transform_points(mount.T_body_base, base.center_of_mass), np.zeros((3, 3))))
    p["fixed_mass"], p["fixed_center"], _ = combined(parts)
    mass, center, _ = vehicle.mass_properties()
    p["believed_mass"] = mass + (sum(config.tool.link_masses) if vehicle.tool else 0.0)
    p["mixer_center"] = center
    p["mixer"] = np.linalg.pinv(vehicle.airframe.allocation(center))
    p["feedforward"] = config.com_feedforward


def set_estimate(p: np.ndarray, estimate: PoseEstimateConfig | None) -> None:
    """The pose tracker, in place; its biases are drawn per episode."""
    p["track_exact"] = estimate is None
    if estimate is None:
        return
    p["track_interval"] = 1.0 / (estimate.rate * CONTROL_STEP)
    p["track_delay"] = round(estimate.delay / CONTROL_STEP)
    p["track_white"] = (estimate.position_std, estimate.rotation_std)
    p["track_wander"] = (estimate.position_wander, estimate.rotation_wander)
    p["track_wander_blend"] = np.exp(-CONTROL_STEP / estimate.wander_time) if estimate.wander_time > 0 else 0.0
    if estimate.loss_interval > 0.0:
        p["track_loss"] = min(1.0 / (estimate.rate * estimate.loss_interval), 1.0)
    p["track_loss_steps"] = round(estimate.loss_duration / CONTROL_STEP)
