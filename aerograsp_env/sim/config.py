"""Everything that defines a docking world, in one printable value."""

from __future__ import annotations

from dataclasses import dataclass, field, fields

import numpy as np

from aerograsp_env.sim.airframe import BELEROFONTE, AirframeConfig
from aerograsp_env.sim.autopilot import AutopilotConfig
from aerograsp_env.sim.docking_tool import DockingToolConfig
from aerograsp_env.sim.layout import HISTORY, LOCALIZATIONS, SUBSTEPS
from aerograsp_env.sim.scene import TIMESTEP
from aerograsp_env.sim.sensors import SensorConfig
from aerograsp_env.sim.wind import WIND_LEVELS, WindConfig

CONTROL_STEP = SUBSTEPS * TIMESTEP  # [s]
TABLE_5_2_SATURATION = (2.0, 2.0, 1.0)  # [m/s]: no velocity limit may be larger
DELAY_MAX = (HISTORY - 2) * CONTROL_STEP  # [s]

Range = tuple[float, float]


@dataclass(frozen=True)
class RandomizeConfig:
    """Domain randomisation: each factor is drawn uniformly per episode and multiplies the nominal value."""

    mass: Range = (0.85, 1.15)
    inertia: Range = (0.85, 1.15)
    thrust: Range = (0.9, 1.1)
    motor_time: Range = (0.7, 1.4)
    drag: Range = (0.7, 1.3)
    velocity_gains: Range = (0.85, 1.15)
    sensor_noise: Range = (0.7, 1.3)
    flex_stiffness: Range = (0.5, 2.0)
    joint_damping: Range = (0.5, 2.0)

    def __post_init__(self) -> None:
        for f in fields(self):
            low, high = getattr(self, f.name)
            if not (np.isfinite([low, high]).all() and 0 < low <= high <= 10):
                raise ValueError(f"RandomizeConfig.{f.name} must be 0 < low <= high <= 10, got {(low, high)}")


@dataclass(frozen=True)
class DockConfig:
    """A docking world: vehicle, tool, air, sensors, and the task's settings."""

    airframe: AirframeConfig = BELEROFONTE
    tool: DockingToolConfig = field(default_factory=DockingToolConfig)
    autopilot: AutopilotConfig = field(default_factory=AutopilotConfig)
    wind: WindConfig = WIND_LEVELS["light"]
    sensors: SensorConfig = field(default_factory=SensorConfig)
    randomize: RandomizeConfig | None = None
    payload: float = 0.0  # mass under the airframe that the autopilot does not know [kg]
    localization: str = "dock"
    docked: bool = True
    attach: bool = False  # the episode begins in flight and the tool may be coupled
    velocity_limit: tuple[float, float, float] = (0.5, 0.5, 0.5)  # of a full action [m/s]
    yaw_rate_limit: float = 0.5  # of a full action [rad/s]
    command_delay: Range = (0.0, 0.0)  # drawn uniformly per episode [s]
    set_point_spread: float = 0.02  # half-width of the cube that set-points are drawn from [m]
    start_spread: float = 0.02  # the same for the start about the set-point [m]
    tilt_std: float = 0.035  # of the clamped base about the two horizontal axes [rad]
    skip: float = 5.0  # errors count from here [s]
    bound: float = 3.0  # distance from the set-point that ends an undocked episode [m]

    def __post_init__(self) -> None:
        limit = np.asarray(self.velocity_limit, dtype=float)
        if limit.shape != (3,) or not ((limit > 0) & (limit <= TABLE_5_2_SATURATION)).all():
            raise ValueError(
                f"velocity_limit must be three values in (0, {TABLE_5_2_SATURATION}] m/s (Table 5.2), "
                f"got {self.velocity_limit!r}"
            )
        low, high = self.command_delay
        if not (np.isfinite([low, high]).all() and 0.0 <= low <= high <= DELAY_MAX):
            raise ValueError(f"command_delay must be 0 <= low <= high <= {DELAY_MAX:.2f} s, got {self.command_delay!r}")
        if self.localization not in LOCALIZATIONS:
            raise ValueError(f"localization must be one of {sorted(LOCALIZATIONS)}, got {self.localization!r}")
        if self.localization == "dock" and not (self.docked or self.attach):
            raise ValueError("localization='dock' needs docked=True: an undocked tool senses no position")
        for name, low_, high_ in (
            ("payload", 0, 5), ("yaw_rate_limit", 0, 3.5), ("set_point_spread", 0, 0.08),
            ("start_spread", 0, 0.08), ("tilt_std", 0, 0.3), ("skip", 0, 60), ("bound", 0.1, 100),
        ):  # fmt: skip
            value = getattr(self, name)
            if not np.isfinite(value) or not low_ <= value <= high_:
                raise ValueError(f"{name} must be in [{low_}, {high_}], got {value}")

    @property
    def free_source(self) -> str:
        """The position source while the tool is not coupled: what `localization` names, for the tool a camera."""
        return "vision" if self.attach and self.localization == "dock" else self.localization
