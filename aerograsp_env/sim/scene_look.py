"""How the docking scene looks: MJCF of materials, light, cameras and massless geoms that collide with nothing.

Physics is in `aerograsp_env.sim.scene`; nothing here changes a trajectory.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from aerograsp_env.sim.airframe import AirframeConfig

ASSETS = """
    <texture name="floor" type="2d" builtin="checker" rgb1="0.60 0.62 0.64" rgb2="0.52 0.54 0.56"
             width="256" height="256"/>
    <material name="floor" texture="floor" texrepeat="1 1" texuniform="true"/>
    <material name="pipe" rgba="0.80 0.43 0.16 1" specular="0.6" shininess="0.6"/>
    <material name="column" rgba="0.36 0.39 0.43 1"/>
    <material name="shell" rgba="0.93 0.94 0.95 1" specular="0.8" shininess="0.7"/>
    <material name="canopy" rgba="0.12 0.38 0.66 1" specular="0.9" shininess="0.8"/>
    <material name="dark" rgba="0.17 0.18 0.20 1"/> <material name="carbon" rgba="0.27 0.29 0.32 1" specular="0.7"/>
    <material name="metal" rgba="0.72 0.74 0.77 1" specular="0.9"/> <material name="arm" rgba="0.15 0.42 0.70 1"/>
    <material name="disc" rgba="0.55 0.60 0.66 0.22"/> <material name="front" rgba="0.90 0.25 0.18 0.30"/>
    <material name="printed" rgba="0.97 0.97 0.95 1"/> <material name="clamp" rgba="0.98 0.74 0.10 1"/>"""

# name: position and what it looks at [m], vertical field of view [deg] (MJCF's unit)
_CAMERAS = {
    "side": ((0.75, 1.75, 3.95), (-0.36, -0.06, 3.27), 40.0),
    "front": ((1.9, -1.6, 4.1), (-0.25, -0.10, 3.25), 34.0),
    "tool": ((0.55, 0.75, 3.45), (-0.12, 0.0, 3.14), 32.0),
}
CAMERAS = tuple(_CAMERAS)

LIGHT = """
    <light name="sun" directional="true" pos="3 -4 9" dir="-0.42 -0.30 -0.85" diffuse="0.75 0.75 0.72"
           castshadow="true"/>"""


def numbers(*values: float) -> str:
    """An MJCF attribute's value."""
    return " ".join(f"{v:.12g}" for v in values)


def _capsule(start: tuple[float, ...], end: tuple[float, ...], radius: float, material: str) -> str:
    return (
        f'<geom type="capsule" fromto="{numbers(*start, *end)}" size="{numbers(radius)}" '
        f'material="{material}" class="look"/>'
    )


def _cylinder(center: tuple[float, ...], radius: float, half: float, material: str, axis: str = "0 0 1") -> str:
    return (
        f'<geom type="cylinder" pos="{numbers(*center)}" size="{numbers(radius, half)}" zaxis="{axis}" '
        f'material="{material}" class="look"/>'
    )


def _box(
    center: tuple[float, ...], half: tuple[float, ...], material: str, euler: tuple[float, ...] = (0, 0, 0)
) -> str:
    return (
        f'<geom type="box" pos="{numbers(*center)}" size="{numbers(*half)}" euler="{numbers(*euler)}" '
        f'material="{material}" class="look"/>'
    )


def _ellipsoid(center: tuple[float, ...], radii: tuple[float, ...], material: str) -> str:
    return (
        f'<geom type="ellipsoid" pos="{numbers(*center)}" size="{numbers(*radii)}" material="{material}" class="look"/>'
    )


def camera_heading(name: str) -> float | None:
    """Heading of a fixed camera's line of sight about world z [rad]; None of one that is not fixed."""
    return line_of_sight(_CAMERAS, name)


def line_of_sight(cameras: Mapping[str, tuple[tuple[float, ...], tuple[float, ...], float]], name: str) -> float | None:
    """`camera_heading` among any cameras."""
    if name not in cameras:
        return None
    position, target, _ = cameras[name]
    return float(np.arctan2(target[1] - position[1], target[0] - position[0]))


def camera_look() -> str:
    """The fixed cameras, upright."""
    lines = []
    for name, (position, target, fovy) in _CAMERAS.items():
        back = np.subtract(position, target)
        right = np.cross([0.0, 0.0, 1.0], back)
        axes = numbers(*right, *np.cross(back, right))
        lines.append(f'<camera name="{name}" pos="{numbers(*position)}" xyaxes="{axes}" fovy="{fovy:g}"/>')
    return "\n    ".join(lines)


def airframe_look(airframe: AirframeConfig, bare: bool = False) -> str:
    """Canopy, booms, motors, propellers; and, unless `bare`, camera, legs and arms, where the airframe has them."""
    length = airframe.arm_length
    scale = length / 0.42
    lines = [
        _ellipsoid((0.0, 0.0, 0.035 * scale), (0.115 * scale, 0.095 * scale, 0.06 * scale), "canopy"),
        _cylinder((0.0, 0.0, 0.112 * scale), 0.028 * scale, 0.008 * scale, "shell"),  # GPS puck on its mast
        _cylinder((0.0, 0.0, 0.09 * scale), 0.005 * scale, 0.03 * scale, "dark"),
    ]
    if not bare:
        lines.append(_box((0.13 * scale, 0.0, -0.085 * scale), (0.014 * scale, 0.045 * scale, 0.016 * scale), "dark"))
    for i, hub in enumerate(airframe.rotor_positions()):
        x, y, z = (float(v) for v in hub)
        front = abs(airframe.angles[i]) < 1.0
        lines += [
            _capsule((0.0, 0.0, 0.0), (x, y, 0.0), 0.014 * scale, "carbon"),
            _cylinder((x, y, 0.4 * z), 0.026 * scale, 0.4 * z, "dark"),
            _cylinder((x, y, z), 0.012 * scale, 0.012 * scale, "metal"),
        ]
        radius, turn = airframe.rotor.radius, 0.6 + 1.1 * i
        for side in (1.0, -1.0):  # a blade is a thin ellipsoid, half over the hub
            at = (x + side * 0.5 * radius * np.cos(turn), y + side * 0.5 * radius * np.sin(turn), z + 0.002)
            lines.append(
                f'<geom type="ellipsoid" pos="{numbers(*at)}" size="{numbers(0.51 * radius, 0.085 * radius, 0.004)}" '
                f'euler="0 0 {turn:.4g}" material="{"clamp" if front else "dark"}" class="look"/>'
            )
    drop = 0.75 * length
    for side in (-1.0, 1.0) if not bare else ():
        y = 0.45 * length * side
        for x in (-0.25 * length, 0.25 * length):
            lines.append(_capsule((0.6 * x, 0.4 * y, -0.03), (x, y, -drop), 0.010 * scale, "carbon"))
        for x in (-0.5 * length, 0.5 * length):  # rubber feet
            lines.append(_capsule((0.86 * x, y, -drop), (x, y, -drop), 0.017 * scale, "dark"))
    if not bare and airframe.tip_position[1] != 0.0:
        lines += _arms(airframe.tip_position)
    return "\n".join(lines)


def _arms(tip: tuple[float, float, float]) -> list[str]:
    """The left arm, stretched forward with the tool in its gripper, and the right one, folded under the frame."""
    x, y, z = tip
    servo = (0.026, 0.020, 0.030)
    left = [
        _capsule((0.0, 0.4 * y, -0.03), (0.0, y, z), 0.020, "arm"),
        _box((0.0, y, z), servo, "dark"),
        _capsule((0.03, y, z), (0.45 * x, y, z), 0.026, "arm"),
        _box((0.5 * x, y, z), servo, "dark"),
        _capsule((0.56 * x, y, z), (0.82 * x, y, z), 0.022, "arm"),
        _box((x - 0.042, y, z), (0.016, 0.030, 0.024), "dark"),
        _box((x - 0.008, y + 0.022, z), (0.028, 0.005, 0.016), "metal"),  # the gripper's fingers about the tip
        _box((x - 0.008, y - 0.022, z), (0.028, 0.005, 0.016), "metal"),
    ]
    right = [
        _capsule((0.0, -0.4 * y, -0.03), (0.0, -y, z), 0.020, "arm"),
        _box((0.0, -y, z), servo, "dark"),
        _capsule((0.0, -y, z - 0.03), (-0.05, -y, z - 0.13), 0.024, "arm"),
        _box((-0.055, -y, z - 0.15), servo, "dark"),
        _capsule((-0.02, -y, z - 0.155), (0.10, -y, z - 0.13), 0.020, "arm"),
        _box((0.135, -y + 0.018, z - 0.122), (0.028, 0.005, 0.014), "metal"),
        _box((0.135, -y - 0.018, z - 0.122), (0.028, 0.005, 0.014), "metal"),
    ]
    return left + right


def clamp_look(pipe_radius: float) -> str:
    """Two jaws about the pipe, in the frame of the tool's base: x along the pipe, origin on its top."""
    thickness, width, pieces = 0.007, 0.030, 5
    radius = pipe_radius + thickness
    step = np.radians(145.0 / pieces)
    half = radius * np.tan(0.5 * step) + 0.002
    lines = [_cylinder((0.0, 0.0, -0.006), 0.030, 0.008, "dark")]
    for side in (-1.0, 1.0):
        for i in range(pieces):
            angle = side * step * (i + 0.5)
            at = (0.0, radius * np.sin(angle), radius * np.cos(angle) - pipe_radius)
            lines.append(_box(at, (width, half, thickness), "clamp", (-angle, 0.0, 0.0)))
        lines.append(_capsule((-width, side * 0.036, -0.004), (width, side * 0.036, -0.004), 0.009, "metal"))  # hinges
    return "".join(lines)


def pipe_look(height: float, radius: float, half_length: float) -> str:
    """Flanges of the pipe and feet of its columns."""
    lines = []
    for y in (-0.55 * half_length, 0.55 * half_length):
        lines += [_cylinder((0.0, y + d, height), 1.5 * radius, 0.012, "column", "0 1 0") for d in (-0.013, 0.013)]
    for y in (-half_length, half_length):
        lines.append(_cylinder((0.0, y, 0.02), 0.18, 0.02, "column"))
        lines.append(f'<geom type="sphere" pos="0 {y:.4g} {height:.4g}" size="0.075" material="column" class="look"/>')
    return "\n".join(lines)
