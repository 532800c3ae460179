"""The arms' gripper: parallel jaws on a worm drive (thesis section 5.2, figure 5.3).

Figures are ours, the text gives none: speed and force of a hobby servo behind an M6 screw, the give of printed fingers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim.gripper import GripperConfig

Array = NDArray[np.float64]


class Finger(NamedTuple):
    """One finger of a gripper, in the tool frame."""

    name: str
    closing: float  # ±1: it closes along ± x
    center: Array  # (3,) centre of its mass when open [m]: its box's, the pad weighs nothing


@dataclass(frozen=True)
class WormGripper:
    """A parallel gripper on a worm drive: the screw moves both fingers alike, and cannot be driven back by them.

    The screw's position w is the travel of each finger from the largest opening [m]. A finger at x hangs on the screw
    by the give of the printed parts: it presses with stiffness · (w − x).

    Raises:
        ValueError: a value that is not positive.
    """

    jaws: GripperConfig
    jaw_speed: float = 0.03  # of each finger [m/s]; a worm is slow
    stall_force: float = 25.0  # per finger, at which the motor stops [N]
    stiffness: float = 12500.0  # of a finger against the screw [N/m]: 2 mm at the stall force
    damping: float = 80.0  # [N s/m], critical for the finger and its part of the drive
    finger_mass: float = 0.02  # each [kg]
    finger_armature: float = 0.10  # inertia of nut and linkage seen at a finger [kg]

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name != "jaws" and not 0.0 < value < math.inf:
                raise ValueError(f"WormGripper.{field.name}: expected a positive value, got {value}")

    @property
    def travel(self) -> float:
        """[m] of each finger, from the largest opening until the pads meet."""
        return 0.5 * self.jaws.max_width

    def fingers(self) -> tuple[Finger, Finger]:
        """The left finger, which closes towards +x of the tool frame, and the right one."""
        center = {box.name: np.array(box.center) for box in self.jaws.boxes(self.jaws.max_width)}
        return Finger("left_finger", 1.0, center["left_finger"]), Finger("right_finger", -1.0, center["right_finger"])

    def finger_inertia(self) -> Array:
        """(3, 3) of one finger about its centre [kg m²]."""
        box = next(b for b in self.jaws.boxes(self.jaws.max_width) if b.name == "left_finger")
        x, y, z = (s * s for s in box.half_size)
        return np.asarray(self.finger_mass / 3.0 * np.diag([y + z, x + z, x + y]))
