"""How hard an episode of `aerograsp/Grasp-v0` or `aerograsp/GraspDual-v0` is.

Levels differ in the air, the pose estimate, what the object stands on, its mass and its surface. The values are fixed:
policies are compared on them. Each but the last of Grasp-v0 is hard in one way; "combined" is in all, with an estimate
twice as far off as "biased": where the others are solved, it still separates policies.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from aerograsp_env.envs.options import choose

Range = tuple[float, float]

SUPPORTS = ("table", "saddle")
SLOPE_STEP = 5.0  # slopes are drawn in steps of this [deg], so that compiled scenes can be kept


def _degrees(low: float, high: float) -> Range:
    return math.radians(low), math.radians(high)


_NEARLY_AHEAD, _NEARLY_RIGHT = _degrees(-10.0, 10.0), _degrees(0.0, 0.5)


@dataclass(frozen=True)
class GraspLevel:
    """What is drawn per episode, uniformly within ranges.

    Raises:
        ValueError: a range that is reversed, negative or too large, or an unknown support.
    """

    wind: str = "light"
    supports: tuple[str, ...] = SUPPORTS
    slope: Range = (0.0, 0.0)  # of the support, in steps of 5° [rad]
    heading: Range = _NEARLY_AHEAD  # of the support: the way down, or a level pipe's axis [rad]
    mass: Range | None = (0.10, 0.25)  # of the object [kg]; None: its own
    friction: Range | None = (0.7, 0.7)  # Coulomb coefficient of the object's surface; None: its own
    position_bias: Range = (0.0, 0.002)  # length of the estimate's constant error, in any direction [m]
    rotation_bias: Range = _NEARLY_RIGHT  # angle of the constant error, about any axis [rad]
    delay: float = 0.06  # of the estimate, from image to delivery [s]
    spread: tuple[float, float, float] = (0.04, 0.04, 0.02)  # of the object's place, ± along body x, y, z [m]

    def __post_init__(self) -> None:
        for name in self.supports:
            choose("GraspLevel.supports", name, SUPPORTS)
        if not self.supports:
            raise ValueError("GraspLevel.supports must name one support or more, got none")
        limits = {
            "slope": (0.0, math.radians(35.0)), "heading": (-math.pi, math.pi), "mass": (0.005, 2.0),
            "friction": (0.05, 2.0), "position_bias": (0.0, 0.1), "rotation_bias": (0.0, 1.0),
        }  # fmt: skip
        for name, (lowest, highest) in limits.items():
            value = getattr(self, name)
            if value is None and name in ("mass", "friction"):
                continue
            low, high = value
            if not (np.isfinite([low, high]).all() and lowest <= low <= high <= highest):
                raise ValueError(f"GraspLevel.{name} must be {lowest:.3g} <= low <= high <= {highest:.3g}, got {value}")
        if len(self.spread) != 3 or not all(0.0 <= s <= 0.3 for s in self.spread):
            raise ValueError(f"GraspLevel.spread must be three lengths in [0, 0.3] m, got {self.spread}")


LEVELS: Mapping[str, GraspLevel] = MappingProxyType(
    {
        "easy": GraspLevel(),
        "gusty": GraspLevel(wind="gusty"),
        "biased": GraspLevel(position_bias=(0.005, 0.015), rotation_bias=_degrees(0.0, 3.0), delay=0.10),
        "oblique": GraspLevel(slope=_degrees(15.0, 30.0), heading=_degrees(-180.0, 180.0)),
        "heavy": GraspLevel(mass=(0.2, 0.8), friction=(0.25, 0.45)),
        "combined": GraspLevel(
            wind="gusty",
            slope=_degrees(15.0, 30.0),
            heading=_degrees(-180.0, 180.0),
            mass=(0.2, 0.8),
            friction=(0.25, 0.45),
            position_bias=(0.015, 0.030),
            rotation_bias=_degrees(0.0, 6.0),
            delay=0.15,
            spread=(0.08, 0.08, 0.03),
        ),
    }
)


_CRAWLER = GraspLevel(mass=(1.0, 1.4), spread=(0.03, 0.03, 0.02))
DUAL_LEVELS: Mapping[str, GraspLevel] = MappingProxyType(
    {
        "easy": _CRAWLER,
        "gusty": replace(_CRAWLER, wind="gusty"),
        "biased": replace(_CRAWLER, position_bias=(0.005, 0.015), rotation_bias=_degrees(0.0, 3.0), delay=0.10),
        "oblique": replace(_CRAWLER, slope=_degrees(5.0, 15.0), heading=_degrees(-180.0, 180.0)),
        "heavy": replace(_CRAWLER, mass=(1.4, 1.8), friction=(0.25, 0.45)),
    }
)


def grasp_level(value: Any, levels: Mapping[str, GraspLevel] = LEVELS) -> GraspLevel:
    """A level by its name, as a `GraspLevel`, or as a mapping of changes to the easy one of `levels`."""
    if isinstance(value, GraspLevel):
        return value
    if isinstance(value, Mapping):
        known = [field.name for field in fields(GraspLevel)]
        for name in value:
            choose("level", name, known)
        return replace(levels["easy"], **value)
    return levels[choose("level", value, levels)]


def slopes(level: GraspLevel) -> list[float]:
    """The slopes that are drawn from, each as often [rad]."""
    low, high = (math.degrees(value) for value in level.slope)
    steps = np.arange(math.ceil(low / SLOPE_STEP - 1e-9), math.floor(high / SLOPE_STEP + 1e-9) + 1)
    return [math.radians(SLOPE_STEP * step) for step in steps] or [math.radians(0.5 * (low + high))]
