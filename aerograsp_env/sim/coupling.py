"""Coupling the tool to the pipe in flight: the clamp grips where it lies and closes.

While its jaws close over CLOSING_TIME the seat of the equality constraint moves from where the base was to where the
pipe's shape holds it: on top of the pipe, upright and in line with it. Where along the pipe it gripped stays as it is;
from then on the tool measures from there, so the set-point moves along.
"""

from __future__ import annotations

import mujoco
import numpy as np

from aerograsp_env.sim.config import CONTROL_STEP
from aerograsp_env.sim.docking_tool import R_WORLD_BASE
from aerograsp_env.sim.scene import DOCK_POSITION, quaternion

CLOSING_TIME = 0.5  # [s]


def clamp(data: mujoco.MjData, parameters: np.ndarray, states: np.ndarray, index: int) -> None:
    """Begin or go on closing the clamp of world `index`, in place."""
    s, p = states[index], parameters[index]
    if not s["coupled"]:
        site = data.site("base")
        data.mocap_pos[0], data.mocap_quat[0] = site.xpos, quaternion(site.xmat.reshape(3, 3))
        data.eq_active[0] = 1
        s["coupled"], s["locked"], s["wants_coupling"], s["coupled_step"] = 1, 0, 0, s["step"]
        along_pipe = np.array([0.0, site.xpos[1] - DOCK_POSITION[1], 0.0])
        p["set_point"] += along_pipe
        p["nominal"] += along_pipe
        p["seat_position"] += along_pipe
        s["error_integral"] = 0.0
        return
    left = CLOSING_TIME / CONTROL_STEP - float(s["step"] - s["coupled_step"])
    if left < 0:
        return
    share = 1.0 / max(left, 1.0)  # of the remaining way: a straight line in time
    target = quaternion(R_WORLD_BASE)
    data.mocap_pos[0] += share * (p["seat_position"] - data.mocap_pos[0])
    difference, turn = np.zeros(4), np.zeros(3)
    mujoco.mju_negQuat(difference, data.mocap_quat[0])
    mujoco.mju_mulQuat(difference, difference.copy(), target)
    mujoco.mju_quat2Vel(turn, difference, 1.0)
    mujoco.mju_quatIntegrate(data.mocap_quat[0], turn, share)
