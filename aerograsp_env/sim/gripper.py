"""The parallel-jaw gripper: one geometry for the physics that judges grasps and for the planners that propose them.

Gripper frame: origin midway between the pads' faces, x along the closing axis, z along the approach axis (the palm is
at negative z), y = z × x.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.interfaces import Grasp

Array = NDArray[np.float64]


class Box(NamedTuple):
    """One axis-aligned box of the gripper, in its frame."""

    name: str
    center: tuple[float, float, float]  # [m]
    half_size: tuple[float, float, float]  # [m]


@dataclass(frozen=True)
class GripperConfig:
    """A floating parallel-jaw gripper with small flat pads, which stand proud of their fingers.

    Raises:
        ValueError: a size, force or friction that is not positive and finite.
    """

    max_width: float = 0.10  # [m] largest opening between the pads' faces
    pad_height: float = 0.008  # [m] of a pad, along the approach axis
    pad_width: float = 0.008  # [m] of a pad, across
    pad_depth: float = 0.003  # [m] by which a pad stands proud of its finger
    finger_length: float = 0.060  # [m] from the palm to the middle of the pads
    finger_width: float = 0.010  # [m] across
    finger_thickness: float = 0.008  # [m] along the closing axis
    palm_depth: float = 0.030  # [m] along the approach axis
    palm_width: float = 0.040  # [m] across
    force: float = 25.0  # [N] each finger presses with
    friction: float = 0.7  # Coulomb coefficient between pad and object

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not 0.0 < value < math.inf:
                raise ValueError(f"{field.name}: expected a positive value, got {value}")

    def boxes(self, width: float) -> tuple[Box, ...]:
        """The gripper's body, open by `width` [m]: two pads, two fingers and the palm.

        Raises:
            ValueError: a width outside (0, max_width].
        """
        if not 0.0 < width <= self.max_width:
            raise ValueError(f"width: expected an opening in (0, {self.max_width}] m, got {width}")
        tip = 0.5 * self.pad_height
        finger_middle = 0.5 * (tip - self.finger_length)
        parts = []
        for side, sign in (("left", -1.0), ("right", 1.0)):
            pad = sign * 0.5 * (width + self.pad_depth)
            finger = sign * (0.5 * width + self.pad_depth + 0.5 * self.finger_thickness)
            parts.append(Box(f"{side}_pad", (pad, 0.0, 0.0), (0.5 * self.pad_depth, 0.5 * self.pad_width, tip)))
            half = (0.5 * self.finger_thickness, 0.5 * self.finger_width, 0.5 * (tip + self.finger_length))
            parts.append(Box(f"{side}_finger", (finger, 0.0, finger_middle), half))
        half_palm = 0.5 * self.max_width + self.pad_depth + self.finger_thickness
        middle = -self.finger_length - 0.5 * self.palm_depth
        parts.append(Box("palm", (0.0, 0.0, middle), (half_palm, 0.5 * self.palm_width, 0.5 * self.palm_depth)))
        return tuple(parts)


def gripper_pose(grasp: Grasp) -> Array:
    """(4, 4) T_a_gripper of a grasp that is given in frame a."""
    pose = np.eye(4)
    x, z = grasp.closing_axis, grasp.approach_axis
    pose[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    pose[:3, 3] = grasp.center
    return pose
