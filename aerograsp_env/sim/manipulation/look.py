"""Cameras of the manipulation scene, and the mark at a target."""

from __future__ import annotations

import numpy as np

from aerograsp_env.sim.manipulation.config import HOVER
from aerograsp_env.sim.scene_look import camera_look as docking_cameras
from aerograsp_env.sim.scene_look import numbers

# name: position and what it looks at, from where the vehicle hovers [m], vertical field of view [deg] (MJCF's unit)
_CAMERAS = {
    "side": ((1.05, -1.55, 0.35), (0.12, -0.05, -0.16), 38.0),
    "front": ((1.75, 0.55, 0.15), (0.05, -0.02, -0.16), 34.0),
    "close": ((0.75, -0.95, -0.15), (0.20, -0.16, -0.32), 36.0),
}
CAMERAS = (*_CAMERAS, "vehicle")


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


def target_look() -> str:
    """A ball to be put where a target is."""
    return """<body name="target" mocap="true" pos="0 0 -1">
      <geom type="sphere" size="0.018" rgba="0.95 0.30 0.12 0.9" contype="0" conaffinity="0" mass="0" group="1"/>
    </body>"""
