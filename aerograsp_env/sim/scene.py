"""The MuJoCo model: floor, pipe, hexarotor and docking tool, written as MJCF text and compiled.

The tool's chain is rooted in the airframe and ends in its base; an equality constraint (`coupling`) welds the base to the mocap
body `dock`, the seat of the clamp on the pipe, and is switched on when the tool is coupled. The chain's body frames are
the frames of equations 5.1–5.4 seen from the tip, so joint positions are the thesis's θ4 … θ0.
"""

from __future__ import annotations

import mujoco
import numpy as np

from aerograsp_env.sim.airframe import GRAVITY, AirframeConfig
from aerograsp_env.sim.docking_tool import R_TIP_BODY, R_WORLD_BASE, DockingToolConfig

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


def _numbers(*values: float) -> str:
    return " ".join(f"{v:.12g}" for v in values)


def _airframe_geoms(airframe: AirframeConfig) -> str:
    """Collision and looks: a hub, six booms, six rotor discs, landing skids, and the arm that holds the tool."""
    length, tip = airframe.arm_length, airframe.tip_position
    hub = 0.30 * length
    lines = [
        f'<geom name="hub" type="cylinder" size="{_numbers(hub, 0.04)}" material="shell" class="solid"/>',
        f'<geom type="box" pos="0 0 {-0.15 * length - 0.04:.4g}" size="{_numbers(0.2 * length, 0.14 * length, 0.06)}" material="dark" class="solid"/>',
        f'<geom name="holder" type="capsule" fromto="0 {_numbers(tip[1], tip[2])} {_numbers(*tip)}" size="0.018" '
        'material="metal" class="solid"/>',
        f'<geom type="capsule" fromto="0 {_numbers(tip[1])} {_numbers(tip[2])} 0 {_numbers(tip[1] * 0.5)} -0.02" size="0.014" '
        'material="metal" class="look"/>',
    ]
    for i, p in enumerate(airframe.rotor_positions()):
        front = abs(airframe.angles[i]) < 1.0
        lines.append(
            f'<geom type="capsule" fromto="0 0 0 {_numbers(p[0], p[1], 0.0)}" size="0.013" material="boom" class="look"/>'
            f'<geom type="cylinder" pos="{_numbers(p[0], p[1], 0.5 * p[2])}" size="{_numbers(0.024, 0.5 * p[2])}" material="dark" class="look"/>'
            f'<geom name="rotor{i}" type="cylinder" pos="{_numbers(*p)}" size="{_numbers(airframe.rotor.radius, 0.004)}" '
            f'material="{"front" if front else "disc"}" class="solid"/>'
            f'<site name="rotor{i}" pos="{_numbers(*p)}"/>'
        )
    for side in (-1.0, 1.0):
        y = 0.45 * length * side
        lines.append(
            f'<geom type="capsule" fromto="{_numbers(-0.5 * length, y, -0.75 * length)} {_numbers(0.5 * length, y, -0.75 * length)}" '
            'size="0.01" material="dark" class="solid"/>'
            f'<geom type="capsule" fromto="0 {_numbers(0.4 * y)} -0.03 0 {_numbers(y, -0.75 * length)}" size="0.009" material="dark" class="look"/>'
        )
    return "\n".join(lines)


def _link(
    name: str, joint: str, axis: int, limits: np.ndarray, pos: tuple[float, float, float], content: str, stiffness: float = 0.0
) -> str:
    """One body of the chain seen from the tip. Turning θ moves the tip forwards, so the hinge's axis is reversed here."""
    unit = np.eye(3)[axis]
    return (
        f'<body name="{name}" pos="{_numbers(*pos)}">'
        f'<joint name="{joint}" class="tool" axis="{_numbers(*-unit)}" range="{_numbers(*limits)}" stiffness="{stiffness:.6g}"/>'
        f'<geom name="{joint}_hub" type="cylinder" size="0.016 0.014" zaxis="{_numbers(*unit)}" rgba="0.2 0.7 0.3 1" class="look"/>'
        f"{content}</body>"
    )


def _tool(tool: DockingToolConfig) -> str:
    """MJCF of the chain tip → base, to stand inside the airframe body."""
    l0, l1, l2, l3, l4 = tool.lengths
    m_base, m0, m1, m2, m3, m4 = tool.link_masses
    limits = tool.mechanical_limits()

    def bar(axis: int, length: float, mass: float, radius: float = 0.008) -> str:
        end = -length * np.eye(3)[axis]
        return (
            f'<geom type="capsule" fromto="0 0 0 {_numbers(*end)}" size="{radius:.4g}" mass="{mass:.6g}" material="printed" class="look"/>'
        )

    base = (
        f'<geom type="box" pos="0 0 -0.012" size="0.03 0.035 0.012" mass="{m_base:.6g}" material="clamp" class="look"/>'
        '<geom type="box" pos="0 0.045 -0.035" size="0.025 0.006 0.035" material="clamp" class="look" mass="0"/>'
        '<geom type="box" pos="0 -0.045 -0.035" size="0.025 0.006 0.035" material="clamp" class="look" mass="0"/>'
        '<site name="base"/>'
    )
    body = _link("tool_base", "theta0", 2, limits[0], (0.0, 0.0, -l0), base)
    body = _link("tool_riser", "theta1", 0, limits[1], (0.0, 0.0, -l1), bar(2, l0, m0) + body)
    body = _link("tool_link1", "theta2", 0, limits[2], (0.0, 0.0, -l2), bar(2, l1, m1) + body)
    body = _link("tool_link2", "theta3", 0, limits[3], (0.0, 0.0, -l3), bar(2, l2, m2) + body)
    body = _link("tool_link3", "theta4", 1, limits[4], (0.0, -l4, 0.0), bar(2, l3, m3) + body, tool.heading_stiffness)
    return f'{bar(1, l4, m4)}<site name="tip"/>{body}'


def scene_xml(airframe: AirframeConfig, tool: DockingToolConfig) -> str:
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
  <compiler angle="radian" autolimits="true"/>
  <option timestep="{TIMESTEP}" gravity="0 0 {-GRAVITY}" integrator="implicitfast" cone="elliptic"><flag autoreset="disable"/></option>
  <size memory="1M"/>
  <visual><headlight ambient="0.35 0.35 0.35" diffuse="0.3 0.3 0.3"/><global offwidth="1280" offheight="960"/></visual>
  <asset>
    <texture name="floor" type="2d" builtin="checker" rgb1="0.80 0.82 0.84" rgb2="0.70 0.73 0.76" width="256" height="256"/>
    <material name="floor" texture="floor" texrepeat="12 12"/>
    <material name="pipe" rgba="0.83 0.55 0.25 1"/> <material name="column" rgba="0.45 0.48 0.52 1"/>
    <material name="shell" rgba="0.16 0.20 0.27 1"/> <material name="dark" rgba="0.10 0.10 0.12 1"/>
    <material name="boom" rgba="0.22 0.24 0.28 1"/> <material name="metal" rgba="0.66 0.69 0.72 1"/>
    <material name="disc" rgba="0.30 0.34 0.40 0.45"/> <material name="front" rgba="0.85 0.33 0.25 0.45"/>
    <material name="printed" rgba="0.93 0.93 0.90 1"/> <material name="clamp" rgba="0.95 0.76 0.20 1"/>
  </asset>
  <default>
    <default class="solid"><geom contype="1" conaffinity="2" mass="0" group="1"/></default>
    <default class="look"><geom contype="0" conaffinity="0" mass="0" group="1"/></default>
    <default class="scene"><geom contype="2" conaffinity="1" group="0"/></default>
    <default class="tool"><joint type="hinge" damping="{tool.joint_damping:.6g}" armature="{tool.joint_armature:.6g}"
      limited="false"/></default>
  </default>
  <worldbody>
    <light name="sun" directional="true" pos="3 -4 9" dir="-0.35 0.45 -0.82" diffuse="0.75 0.75 0.72" castshadow="true"/>
    <camera name="side" pos="-0.35 -2.3 3.75" xyaxes="1 0.02 0 -0.006 0.28 0.96" fovy="42"/>
    <camera name="front" pos="1.9 -1.6 4.1" xyaxes="0.62 0.78 0 -0.22 0.18 0.96" fovy="42"/>
    <geom name="floor" type="plane" size="12 12 0.1" material="floor" class="scene"/>
    <geom name="pipe" type="capsule" fromto="0 -2.2 {PIPE_HEIGHT} 0 2.2 {PIPE_HEIGHT}" size="{PIPE_RADIUS}" material="pipe" class="scene"/>
    <geom name="column_left" type="cylinder" fromto="0 2.2 0 0 2.2 {PIPE_HEIGHT}" size="0.06" material="column" class="scene"/>
    <geom name="column_right" type="cylinder" fromto="0 -2.2 0 0 -2.2 {PIPE_HEIGHT}" size="0.06" material="column" class="scene"/>
    <body name="dock" mocap="true" pos="{_numbers(*DOCK_POSITION)}" quat="{_numbers(*dock_quat)}"><site name="dock"/></body>
    <body name="airframe" pos="-0.56 -0.2 {PIPE_HEIGHT + 0.4:.4g}">
      <freejoint name="airframe"/>
      <inertial pos="{_numbers(*com)}" mass="{mass:.9g}" fullinertia="{_numbers(*full)}"/>
      <site name="airframe"/>
      {_airframe_geoms(airframe)}
      <body name="tool_tip" pos="{_numbers(*airframe.tip_position)}" quat="{_numbers(*quaternion(R_TIP_BODY.T))}">
        <joint name="flex" type="hinge" axis="0 0 1" stiffness="{tool.flex_stiffness:.6g}" damping="{tool.flex_damping:.6g}"/>
        {_tool(tool)}
      </body>
    </body>
  </worldbody>
  <equality><weld name="coupling" body1="tool_base" body2="dock" relpose="0 0 0 1 0 0 0" solref="0.01 1" active="false"/></equality>
  <actuator>{actuators}</actuator>
  <sensor><force name="clamp_force" site="base"/></sensor>
</mujoco>"""


def build_model(airframe: AirframeConfig, tool: DockingToolConfig) -> mujoco.MjModel:
    """Compile the scene."""
    return mujoco.MjModel.from_xml_string(scene_xml(airframe, tool))
