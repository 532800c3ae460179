"""Cameras of the manipulation scene, and the mark at a target."""

from __future__ import annotations

import numpy as np

from aerograsp_env.sim.arms.vehicles import VehicleConfig
from aerograsp_env.sim.manipulation.config import HOVER
from aerograsp_env.sim.scene_look import camera_look as docking_cameras
from aerograsp_env.sim.scene_look import line_of_sight, numbers

# name: position and what it looks at, from where the vehicle hovers [m], vertical field of view [deg] (MJCF's unit)
_CAMERAS = {
    "side": ((1.05, -1.55, 0.35), (0.12, -0.05, -0.16), 38.0),
    "front": ((1.75, 0.55, 0.15), (0.05, -0.02, -0.16), 34.0),
    "close": ((0.80, -1.05, -0.15), (0.20, -0.16, -0.34), 42.0),
}
CAMERAS = (*_CAMERAS, "vehicle")


def camera_heading(name: str) -> float | None:
    """Heading of a fixed camera's line of sight about world z [rad]; None of one that is not fixed."""
    return line_of_sight(_CAMERAS, name)


def camera_look(docking: bool) -> str:
    """The fixed cameras, upright; the docking scene's by a pipe."""
    if docking:
        return docking_cameras()
    lines = []
    for name, (position, target, fovy) in _CAMERAS.items():
        back = np.subtract(position, target)
        right = np.cross([0.0, 0.0, 1.0], back)
        axes = numbers(*right, *np.cross(back, right))
        lines.append(f'<camera name="{name}" pos="{numbers(*(HOVER + position))}" xyaxes="{axes}" fovy="{fovy:g}"/>')
    return "\n    ".join(lines)


def mount_look(vehicle: VehicleConfig) -> str:
    """Struts from the frame to the arms' bases."""
    lines = []
    for mount in vehicle.mounts:
        x, y, z = mount.T_body_base[:3, 3]
        for side in (-0.04, 0.04):
            lines.append(
                f'<geom type="capsule" fromto="{numbers(x + side, 0.6 * y, -0.01, x + 0.3 * side, y, z)}" size="0.010" '
                'material="carbon" class="look"/>'
            )
    return "\n".join(lines)


def target_look() -> str:
    """A ball to be put where a target is."""
    return """<body name="target" mocap="true" pos="0 0 -1">
      <geom type="sphere" size="0.018" rgba="0.95 0.30 0.12 0.9" contype="0" conaffinity="0" mass="0" group="1"/>
    </body>"""
