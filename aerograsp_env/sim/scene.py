"""The MuJoCo model: floor, pipe, hexarotor and docking tool, written as MJCF text and compiled.

The tool's chain is rooted in the airframe and ends in its base; an equality constraint (`coupling`) welds the base to
the mocap body `dock`, the seat of the clamp on the pipe, and is switched on when the tool is coupled. The chain's body
frames are the frames of equations 5.1–5.4 seen from the tip, so joint positions are the thesis's θ4 … θ0.
"""

from __future__ import annotations

import mujoco
import numpy as np

from aerograsp_env.sim.airframe import GRAVITY, AirframeConfig
from aerograsp_env.sim.docking_tool import R_TIP_BODY, R_WORLD_BASE, DockingToolConfig
from aerograsp_env.sim.scene_look import ASSETS, LIGHT, airframe_look, camera_look, clamp_look, numbers, pipe_look

TIMESTEP = 0.002  # [s] physics and autopilot
PIPE_HEIGHT = 3.0  # axis above the floor [m]
PIPE_RADIUS = 0.05  # [m]
DOCK_POSITION = np.array([0.0, 0.0, PIPE_HEIGHT + PIPE_RADIUS])  # base of the docked tool: on top of the pipe
JOINT_NAMES = ("theta0", "theta1", "theta2", "theta3", "theta4")


def quaternion(rotation: np.ndarray) -> np.ndarray:
    """wxyz quaternion of a rotation matrix, by MuJoCo's own routine."""
    q = np.zeros(4)
    mujoco.mju_mat2Quat(q, np.ascontiguousarray(rotation, dtype=float).ravel())
    return q


def _airframe_geoms(airframe: AirframeConfig) -> str:
    """What of the airframe collides: hub, battery and computer, rotor discs, skids, the arm that holds the tool."""
    length, tip = airframe.arm_length, airframe.tip_position
    lines = [
        f'<geom name="hub" type="cylinder" size="{numbers(0.30 * length, 0.04)}" material="shell" class="solid"/>',
        f'<geom type="box" pos="0 0 {-0.15 * length - 0.04:.4g}" size="{numbers(0.2 * length, 0.14 * length, 0.06)}" '
        'material="dark" class="solid"/>',
        f'<geom name="holder" type="capsule" fromto="0 {numbers(tip[1], tip[2])} {numbers(*tip)}" size="0.018" '
        'material="metal" class="solid"/>',
    ]
    for i, p in enumerate(airframe.rotor_positions()):
        front = abs(airframe.angles[i]) < 1.0
        lines.append(
            f'<geom name="rotor{i}" type="cylinder" pos="{numbers(*p)}" size="{numbers(airframe.rotor.radius, 0.004)}" '
            f'material="{"front" if front else "disc"}" class="solid"/>'
            f'<site name="rotor{i}" pos="{numbers(*p)}"/>'
        )
    for y in (-0.45 * length, 0.45 * length):
        x, z = 0.5 * length, -0.75 * length
        lines.append(
            f'<geom type="capsule" fromto="{numbers(-x, y, z, x, y, z)}" size="0.01" material="dark" class="solid"/>'
        )
    return "\n".join(lines)


def _link(
    name: str,
    joint: str,
    axis: int,
    limits: np.ndarray,
    pos: tuple[float, float, float],
    content: str,
    stiffness: float = 0.0,
) -> str:
    """One body of the chain seen from the tip. Turning θ moves the tip forwards, so the hinge's axis is reversed."""
    unit = np.eye(3)[axis]
    return (
        f'<body name="{name}" pos="{numbers(*pos)}">'
        f'<joint name="{joint}" class="tool" axis="{numbers(*-unit)}" range="{numbers(*limits)}" '
        f'stiffness="{stiffness:.6g}"/>'
        f'<geom name="{joint}_hub" type="cylinder" size="0.022 0.017" zaxis="{numbers(*unit)}" class="look"/>'
        f"{content}</body>"
    )


def tool_chain(tool: DockingToolConfig) -> str:
    """MJCF of the chain tip → base, to stand inside the airframe body."""
    l0, l1, l2, l3, l4 = tool.lengths
    m_base, m0, m1, m2, m3, m4 = tool.link_masses
    limits = tool.mechanical_limits()

    def bar(axis: int, length: float, mass: float) -> str:
        ends = f'type="capsule" fromto="0 0 0 {numbers(*(-length * np.eye(3)[axis]))}"'
        return (
            f'<geom {ends} size="0.008" mass="{mass:.6g}" class="weight"/>'
            f'<geom {ends} size="0.0115" material="printed" class="look"/>'
        )

    base = (
        f'<geom type="box" pos="0 0 -0.012" size="0.03 0.035 0.012" mass="{m_base:.6g}" class="weight"/>'
        f'{clamp_look(PIPE_RADIUS)}<site name="base"/>'
    )
    body = _link("tool_base", "theta0", 2, limits[0], (0.0, 0.0, -l0), base)
    body = _link("tool_riser", "theta1", 0, limits[1], (0.0, 0.0, -l1), bar(2, l0, m0) + body)
    body = _link("tool_link1", "theta2", 0, limits[2], (0.0, 0.0, -l2), bar(2, l1, m1) + body)
    body = _link("tool_link2", "theta3", 0, limits[3], (0.0, 0.0, -l3), bar(2, l2, m2) + body)
    body = _link("tool_link3", "theta4", 1, limits[4], (0.0, -l4, 0.0), bar(2, l3, m3) + body, tool.heading_stiffness)
    return f'{bar(1, l4, m4)}<site name="tip"/>{body}'


def scene_xml(airframe: AirframeConfig, tool: DockingToolConfig, look: bool = False) -> str:
    """The MJCF text of the docking scene."""
    mass, com, inertia = airframe.properties()
    full = (inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2])
    rotor = airframe.rotor
    actuators = "\n".join(
        f'<general name="rotor{i}" site="rotor{i}" gear="0 0 1 0 0 {-turn * rotor.drag_ratio:.9g}" '
        f'ctrlrange="0 {1.5 * rotor.thrust_max:.9g}" ctrllimited="true"/>'
        for i, turn in enumerate(airframe.directions)
    )
    dock_quat = quaternion(R_WORLD_BASE)
    return f"""
<mujoco model="aerograsp dock">
  <compiler angle="radian" autolimits="true" discardvisual="{"false" if look else "true"}"/>
  <option timestep="{TIMESTEP}" gravity="0 0 {-GRAVITY}" integrator="implicitfast" cone="elliptic">
    <flag autoreset="disable"/>
  </option>
  <size memory="1M"/>
  <visual><headlight ambient="0.35 0.35 0.35" diffuse="0.3 0.3 0.3"/>
    <global offwidth="1280" offheight="960"/></visual>
  <asset>{ASSETS}
  </asset>
  <default>
    <default class="solid"><geom contype="1" conaffinity="2" mass="0" group="1"/></default>
    <default class="look"><geom contype="0" conaffinity="0" mass="0" group="1"/></default>
    <default class="weight"><geom contype="0" conaffinity="0" group="4"/></default>
    <default class="scene"><geom contype="2" conaffinity="1" group="0"/></default>
    <default class="tool"><joint type="hinge" damping="{tool.joint_damping:.6g}" armature="{tool.joint_armature:.6g}"
      limited="false"/></default>
  </default>
  <worldbody>
    {LIGHT}
    {camera_look()}
    <geom name="floor" type="plane" size="0 0 0.1" material="floor" class="scene"/>
    <geom name="pipe" type="capsule" fromto="0 -2.2 {PIPE_HEIGHT} 0 2.2 {PIPE_HEIGHT}" size="{PIPE_RADIUS}"
          material="pipe" class="scene"/>
    <geom name="column_left" type="cylinder" fromto="0 2.2 0 0 2.2 {PIPE_HEIGHT}" size="0.06"
          material="column" class="scene"/>
    <geom name="column_right" type="cylinder" fromto="0 -2.2 0 0 -2.2 {PIPE_HEIGHT}" size="0.06"
          material="column" class="scene"/>
    {pipe_look(PIPE_HEIGHT, PIPE_RADIUS, 2.2)}
    <body name="dock" mocap="true" pos="{numbers(*DOCK_POSITION)}" quat="{numbers(*dock_quat)}">
      <site name="dock"/>
    </body>
    <body name="airframe" pos="-0.56 -0.2 {PIPE_HEIGHT + 0.4:.4g}">
      <freejoint name="airframe"/>
      <inertial pos="{numbers(*com)}" mass="{mass:.9g}" fullinertia="{numbers(*full)}"/>
      <site name="airframe"/>
      {_airframe_geoms(airframe)}
      {airframe_look(airframe)}
      <body name="tool_tip" pos="{numbers(*airframe.tip_position)}" quat="{numbers(*quaternion(R_TIP_BODY.T))}">
        <joint name="flex" type="hinge" axis="0 0 1" stiffness="{tool.flex_stiffness:.6g}"
               damping="{tool.flex_damping:.6g}"/>
        {tool_chain(tool)}
      </body>
    </body>
  </worldbody>
  <equality>
    <weld name="coupling" body1="tool_base" body2="dock" relpose="0 0 0 1 0 0 0" active="false"
          solref="0.01 1" solimp="0.9999 0.9999 0.001"/>
  </equality>
  <actuator>{actuators}</actuator>
  <sensor><force name="clamp_force" site="base"/></sensor>
</mujoco>"""


def build_model(airframe: AirframeConfig, tool: DockingToolConfig, look: bool = False) -> mujoco.MjModel:
    """Compile the scene; geoms that are only looked at are left out unless `look`: steps are a tenth faster without."""
    return mujoco.MjModel.from_xml_string(scene_xml(airframe, tool, look))
