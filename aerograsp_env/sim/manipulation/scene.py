"""The MuJoCo model of a vehicle with arms: floor, airframe, arms with grippers; tool and pipe where it docks.

Joint positions are ordered: the airframe's free joint (7), the docking tool (6, if any), each active arm's joints and
its two fingers, then what a task adds, such as an object's free joint.

A task adds to the model through `pieces`: functions that are given the `mujoco.MjSpec` before it is compiled. A free
body named `object` among them is sensed (contacts) and followed (`STATE.object`); geoms take their collision bits from
`OBJECT` and `ENVIRONMENT`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import mujoco
import numpy as np

from aerograsp_env.sim.airframe import GRAVITY
from aerograsp_env.sim.arms.mjcf import Contact, arm_mjcf, shape_geom
from aerograsp_env.sim.arms.vehicles import VehicleConfig
from aerograsp_env.sim.docking_tool import R_TIP_BODY, R_WORLD_BASE
from aerograsp_env.sim.manipulation.config import HOVER, ManipulationConfig
from aerograsp_env.sim.manipulation.layout import CONTACTS
from aerograsp_env.sim.manipulation.look import camera_look, mount_look, target_look
from aerograsp_env.sim.scene import DOCK_POSITION, PIPE_HEIGHT, PIPE_RADIUS, TIMESTEP, quaternion, tool_chain
from aerograsp_env.sim.scene_look import ASSETS, LIGHT, airframe_look, numbers, pipe_look

Piece = Callable[[mujoco.MjSpec], None]

# MuJoCo's collision bits: everything meets everything else, but no body meets itself
AIRFRAME = Contact(1, 0)
ARM = (Contact(2, 1), Contact(4, 1 | 2))
OBJECT = Contact(16, 1 | 2 | 4)
ENVIRONMENT = Contact(0, 1 | 2 | 4 | 16, 0)


def _rotors(vehicle: VehicleConfig) -> tuple[str, str]:
    """Sites and actuators."""
    airframe, rotor = vehicle.airframe, vehicle.airframe.rotor
    sites = "\n".join(f'<site name="rotor{i}" pos="{numbers(*p)}"/>' for i, p in enumerate(airframe.rotor_positions()))
    actuators = "\n".join(
        f'<general name="rotor{i}" site="rotor{i}" gear="0 0 1 0 0 {-turn * rotor.drag_ratio:.9g}" '
        f'ctrlrange="0 {1.5 * rotor.thrust_max:.9g}" ctrllimited="true"/>'
        for i, turn in enumerate(airframe.directions)
    )
    return sites, actuators


def _pipe(contact: str) -> str:
    return f"""
    <geom name="pipe" type="capsule" fromto="0 -2.2 {PIPE_HEIGHT} 0 2.2 {PIPE_HEIGHT}" size="{PIPE_RADIUS}"
          material="pipe" {contact}/>
    <geom name="column_left" type="cylinder" fromto="0 2.2 0 0 2.2 {PIPE_HEIGHT}" size="0.06" material="column"
          {contact}/>
    <geom name="column_right" type="cylinder" fromto="0 -2.2 0 0 -2.2 {PIPE_HEIGHT}" size="0.06" material="column"
          {contact}/>
    {pipe_look(PIPE_HEIGHT, PIPE_RADIUS, 2.2)}
    <body name="dock" mocap="true" pos="{numbers(*DOCK_POSITION)}" quat="{numbers(*quaternion(R_WORLD_BASE))}">
      <site name="dock"/>
    </body>"""


def scene_xml(config: ManipulationConfig, look: bool = False) -> str:
    """The MJCF text of the scene, without a task's pieces."""
    vehicle, tool = config.machine, config.tool
    airframe = vehicle.airframe
    mass, com, inertia = airframe.properties()
    full = (inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2])
    sites, rotors = _rotors(vehicle)
    arms = [
        arm_mjcf(mount.arm, mount.prefix, mount.T_body_base, ARM[i], more='material="arm"')
        for i, mount in enumerate(vehicle.mounts)
    ]
    environment = f'contype="{ENVIRONMENT.contype}" conaffinity="{ENVIRONMENT.conaffinity}" group="0"'
    chain = f"""
      <body name="tool_tip" pos="{numbers(*airframe.tip_position)}" quat="{numbers(*quaternion(R_TIP_BODY.T))}">
        <joint name="flex" type="hinge" axis="0 0 1" stiffness="{tool.flex_stiffness:.6g}"
               damping="{tool.flex_damping:.6g}"/>
        {tool_chain(tool)}
      </body>"""
    coupling = """
  <equality>
    <weld name="coupling" body1="tool_base" body2="dock" relpose="0 0 0 1 0 0 0" active="false"
          solref="0.01 1" solimp="0.9999 0.9999 0.001"/>
  </equality>"""
    clamp = '<force name="clamp_force" site="base"/>'
    return f"""
<mujoco model="aerograsp manipulation">
  <compiler angle="radian" autolimits="true" discardvisual="{"false" if look else "true"}"/>
  <option timestep="{TIMESTEP}" gravity="0 0 {-GRAVITY}" integrator="implicitfast" cone="elliptic" impratio="100">
    <flag autoreset="disable"/>
  </option>
  <size memory="2M"/>
  <visual><headlight ambient="0.35 0.35 0.35" diffuse="0.3 0.3 0.3"/>
    <global offwidth="1280" offheight="960"/></visual>
  <asset>{ASSETS}
  </asset>
  <default>
    <geom solref="0.01 1" solimp="0.9 0.95 0.001"/>
    <default class="look"><geom contype="0" conaffinity="0" mass="0" group="1"/></default>
    <default class="weight"><geom contype="0" conaffinity="0" group="4"/></default>
    <default class="tool"><joint type="hinge" damping="{tool.joint_damping:.6g}" armature="{tool.joint_armature:.6g}"
      limited="false"/></default>
  </default>
  <worldbody>
    {LIGHT}
    {camera_look(vehicle.tool)}
    {target_look() if look else ""}
    <geom name="floor" type="plane" size="0 0 0.1" material="floor" {environment}/>
    {_pipe(environment) if vehicle.tool else ""}
    <body name="airframe" pos="{numbers(*HOVER)}">
      <freejoint name="airframe"/>
      <inertial pos="{numbers(*com)}" mass="{mass:.9g}" fullinertia="{numbers(*full)}"/>
      <site name="airframe"/>
      {_camera(vehicle)}
      {sites}
      {"".join(shape_geom(shape, "", AIRFRAME, _material(shape.name)) for shape in vehicle.shapes)}
      {airframe_look(airframe, bare=True)}
      {mount_look(config.vehicle)}
      {chain if vehicle.tool else ""}
      {"".join(arm.body for arm in arms)}
    </body>
  </worldbody>
  <contact>{"".join(arm.excludes for arm in arms)}</contact>
  {coupling if vehicle.tool else ""}
  <actuator>{rotors}{"".join(arm.actuators for arm in arms)}</actuator>
  <sensor>{clamp if vehicle.tool else ""}</sensor>
</mujoco>"""


def _material(name: str) -> str:
    """How a colliding shape of the airframe looks."""
    if name.startswith("rotor"):
        return f'material="{"front" if name in ("rotor0", "rotor5") else "disc"}"'
    return 'material="shell"' if name == "hub" else 'material="dark"'


def _camera(vehicle: VehicleConfig) -> str:
    """The vehicle's own camera; MuJoCo's looks along −z with y up."""
    T = vehicle.T_body_camera @ np.diag([1.0, -1.0, -1.0, 1.0])
    return f'<camera name="vehicle" pos="{numbers(*T[:3, 3])}" quat="{numbers(*quaternion(T[:3, :3]))}" fovy="58"/>'


def _contact_sides(vehicle: VehicleConfig, object_: bool) -> dict[str, tuple[str, str, str, str] | None]:
    """For each of `CONTACTS` what a sensor compares: (kind, name, kind, name); None where there is nothing to sense.

    Of "airframe", "arm" and "support" the sensor's other side is anything: the compiled step subtracts what is counted
    elsewhere.
    """
    sides: dict[str, tuple[str, str, str, str] | None] = dict.fromkeys(CONTACTS)
    sides["airframe"] = ("body", "airframe", "", "")
    for i, mount in enumerate(vehicle.mounts):
        arm = ("subtree", f"{mount.prefix}base")
        sides[f"arm_{i}"] = (*arm, "", "")
        sides[f"arm_{i}_airframe"] = (*arm, "body", "airframe")
        if object_:
            sides[f"arm_{i}_object"] = (*arm, "body", "object")
            sides[f"left_finger_{i}"] = ("body", f"{mount.prefix}left_finger", "body", "object")
            sides[f"right_finger_{i}"] = ("body", f"{mount.prefix}right_finger", "body", "object")
    if len(vehicle.mounts) == 2:
        first, second = (f"{mount.prefix}base" for mount in vehicle.mounts)
        sides["arms"] = ("subtree", first, "subtree", second)
    if object_:
        sides["support"] = ("body", "object", "", "")
    return sides


def _add_contact_sensors(spec: mujoco.MjSpec, vehicle: VehicleConfig) -> None:
    types = {
        "body": mujoco.mjtObj.mjOBJ_BODY,
        "subtree": mujoco.mjtObj.mjOBJ_XBODY,
        "": mujoco.mjtObj.mjOBJ_UNKNOWN,
    }
    object_ = spec.body("object") is not None
    for name, sides in _contact_sides(vehicle, object_).items():
        if sides is not None:
            spec.add_sensor(
                name=f"touch_{name}",
                type=mujoco.mjtSensor.mjSENS_CONTACT,
                objtype=types[sides[0]],
                objname=sides[1],
                reftype=types[sides[2]],
                refname=sides[3],
                intprm=[1 << int(mujoco.mjtConDataField.mjCONDATA_FOUND), 0, 1],
            )


def _add_payload(spec: mujoco.MjSpec, vehicle: VehicleConfig, mass: float) -> None:
    """A small heavy ball between the pads of the first arm."""
    mount = vehicle.mounts[0]
    last = spec.body(mount.prefix + mount.arm.links[-1].name)
    T = mount.arm.T_last_tool
    ball = last.add_body(
        name="payload", pos=T[:3, 3], mass=mass, inertia=[mass * 0.4 * 0.02**2] * 3, explicitinertial=True
    )
    ball.add_geom(
        type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.02, 0.0, 0.0], mass=0.0, contype=0, conaffinity=0, group=1,
        material="clamp",
    )  # fmt: skip


def build_model(config: ManipulationConfig, pieces: Sequence[Piece] = (), look: bool = False) -> mujoco.MjModel:
    """Compile the scene; geoms that are only looked at are left out unless `look`."""
    spec = mujoco.MjSpec.from_string(scene_xml(config, look))
    vehicle = config.machine
    if config.payload > 0.0:
        _add_payload(spec, vehicle, config.payload)
    for piece in pieces:
        piece(spec)
    _add_contact_sensors(spec, vehicle)
    return spec.compile()
