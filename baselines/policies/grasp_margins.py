"""Margins of a manoeuvre: how high the tools pass over the object, and how deep they may go for it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from baselines.grasping.reaching import Reached
from baselines.grasping.scenes import Scene
from baselines.kinematics.arm import Arm
from baselines.policies.grasp_state import Manoeuvre, PilotSettings

Array = NDArray[np.float64]

PATH = 9  # places looked at on the way from one posture to another
REACH = 0.05  # [m] of the open fingers along the closing axis


def height_over(
    scene: Scene, manoeuvre: Manoeuvre, arms: Sequence[Arm], angles: Sequence[Array], settings: PilotSettings
) -> float:
    """How much higher than its place the base has to be for the tools to pass over the object [m].

    Args:
        scene: the object.
        manoeuvre: what the arms go to.
        arms: poses in the body frame.
        angles: (n,) of each arm now [rad].
        settings: margins.
    """
    T = manoeuvre.T_level_object
    top = float((scene.points @ T[:3, :3].T)[:, 2].max() + T[2, 3])
    share = np.linspace(0.0, 1.0, PATH)[:, None]
    lowest = np.inf
    for arm, q, grasp in zip(arms, angles, manoeuvre.hands, strict=True):
        path = arm.forward(q + share * (grasp.q_before - q))  # as the joints will move, all alike
        lowest = min(lowest, float((path[:, 2, 3] - REACH * np.abs(path[:, 2, 0])).min()))
    return float(np.clip(top + settings.over - lowest, settings.above, settings.highest))


def depth_after(misses: int, scene: Scene, grasp: Reached, settings: PilotSettings) -> float:
    """How much deeper than planned to go after misses [m]: fingers are long and pads small. The support bounds it."""
    T = scene.T_level_object @ grasp.T_object_grasp
    height = float((T[:3, 3] - scene.support) @ scene.up)
    slope = max(0.2, -float(T[:3, 2] @ scene.up))
    return max(0.0, min(settings.deeper * misses, 2.0 * settings.deeper, (height - settings.tip_room) / slope))
