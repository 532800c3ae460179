"""Everything that defines a world of a vehicle with arms, in one printable value."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from functools import cached_property

import numpy as np

from aerograsp_env.sim.airframe import AirframeConfig
from aerograsp_env.sim.arms.vehicles import BELEROFONTE_ARMS, VehicleConfig
from aerograsp_env.sim.autopilot import AutopilotConfig
from aerograsp_env.sim.config import CONTROL_STEP, DELAY_MAX, TABLE_5_2_SATURATION
from aerograsp_env.sim.docking_tool import DockingToolConfig
from aerograsp_env.sim.layout import LOCALIZATIONS
from aerograsp_env.sim.manipulation.layout import CAPTURES
from aerograsp_env.sim.sensors import SensorConfig
from aerograsp_env.sim.wind import WIND_LEVELS, WindConfig

Range = tuple[float, float]
ACTION_MODES = ("joint_velocity", "ee_twist")
HOVER = np.array([0.0, 0.0, 3.0])  # where a vehicle begins unless its task says otherwise: airframe origin, world [m]


@dataclass(frozen=True)
class ManipulationRandomizeConfig:
    """Domain randomisation: each factor is drawn uniformly per episode and multiplies the nominal value."""

    mass: Range = (0.9, 1.1)  # of the airframe
    inertia: Range = (0.85, 1.15)
    arm_mass: Range = (0.85, 1.15)
    thrust: Range = (0.9, 1.1)
    motor_time: Range = (0.7, 1.4)
    drag: Range = (0.7, 1.3)
    velocity_gains: Range = (0.85, 1.15)
    sensor_noise: Range = (0.7, 1.3)
    servo_gains: Range = (0.7, 1.3)  # stiffness and damping
    servo_torque: Range = (0.8, 1.1)
    jaw_force: Range = (0.8, 1.1)
    friction: Range = (0.8, 1.2)  # of the pads

    def __post_init__(self) -> None:
        for f in fields(self):
            low, high = getattr(self, f.name)
            if not (np.isfinite([low, high]).all() and 0 < low <= high <= 10):
                raise ValueError(
                    f"ManipulationRandomizeConfig.{f.name} must be 0 < low <= high <= 10, got {(low, high)}"
                )


@dataclass(frozen=True)
class PoseEstimateConfig:
    """What a pose tracker on board makes of an object: its rate, delay and errors, in the body frame.

    Raises:
        ValueError: a value that is negative or not finite, a rate that is zero or above the control rate, or a delay
            longer than what is remembered.
    """

    rate: float = 30.0  # [Hz]
    delay: float = 0.06  # from image to delivery [s]
    position_std: float = 0.002  # white, per axis [m]
    rotation_std: float = 0.01  # white, per axis [rad]
    position_wander: float = 0.003  # bound of a slow error, per axis [m]
    rotation_wander: float = 0.015  # [rad]
    wander_time: float = 3.0  # [s]
    position_bias: float = 0.0  # length of the episode's constant error, in a drawn direction [m]
    rotation_bias: float = 0.0  # [rad]
    loss_interval: float = 0.0  # mean time between two losses of the track [s]; 0: never lost
    loss_duration: float = 0.3  # [s]

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if not (isinstance(value, (int, float)) and np.isfinite(value) and value >= 0):
                raise ValueError(f"PoseEstimateConfig.{f.name} must be finite and not negative, got {value!r}")
        if not 0 < self.rate <= 1.0 / CONTROL_STEP:
            raise ValueError(f"PoseEstimateConfig.rate must be in (0, {1.0 / CONTROL_STEP:g}] Hz, got {self.rate}")
        longest = (CAPTURES - 2) / self.rate
        if self.delay > longest:
            raise ValueError(f"PoseEstimateConfig.delay must be at most {longest:.2f} s at this rate, got {self.delay}")


@dataclass(frozen=True)
class ManipulationConfig:
    """A vehicle, its arms, air, sensors, and how it is commanded.

    Raises:
        ValueError: a value out of range, an arm the vehicle does not have, or a position source it cannot use.
    """

    vehicle: VehicleConfig = BELEROFONTE_ARMS
    active: tuple[str, ...] = ("right",)  # sides whose arms move; the others are stowed
    tool: DockingToolConfig = field(default_factory=DockingToolConfig)  # of a vehicle that carries it
    docked: bool = False
    autopilot: AutopilotConfig = field(default_factory=AutopilotConfig)
    com_feedforward: bool = True
    hold: bool = True  # the base holds its place by itself; else it follows velocity commands
    hold_gains: tuple[float, float, float] = (0.95, 0.95, 1.0)  # MPC_XY_P, MPC_Z_P of PX4 [1/s]
    velocity_limit: tuple[float, float, float] = (0.5, 0.5, 0.5)  # of a full action [m/s]
    yaw_rate_limit: float = 0.0  # of a full action [rad/s]
    action_mode: str = "joint_velocity"
    joint_rate: float = 2.0  # of a full action [rad/s]
    twist: tuple[float, float] = (0.25, 1.0)  # of a full action [m/s], [rad/s]
    wind: WindConfig = WIND_LEVELS["light"]
    sensors: SensorConfig = field(default_factory=SensorConfig)
    localization: str = "vision"
    randomize: ManipulationRandomizeConfig | None = None
    payload: float = 0.0  # at the first arm's tool, unknown to the autopilot [kg]
    command_delay: Range = (0.0, 0.0)  # drawn uniformly per episode [s]
    estimate: PoseEstimateConfig | None = field(default_factory=PoseEstimateConfig)  # None: poses are exact
    bound: float = 3.0  # distance from where it began that ends an episode [m]

    def __post_init__(self) -> None:
        for side in self.active:
            self.vehicle.mount(side)
        if not self.active or len(set(self.active)) != len(self.active):
            raise ValueError(f"active must name one side or two, got {self.active!r}")
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
        if self.docked and not self.vehicle.tool:
            raise ValueError(f"docked=True needs a vehicle with the docking tool, got {self.vehicle.name!r}")
        if self.localization == "dock" and not self.docked:
            raise ValueError("localization='dock' needs docked=True: an undocked tool senses no position")
        if self.action_mode not in ACTION_MODES:
            raise ValueError(f"action_mode must be one of {ACTION_MODES}, got {self.action_mode!r}")
        for name, low_, high_ in (
            ("payload", 0.0, 2.0), ("yaw_rate_limit", 0.0, 3.5), ("joint_rate", 0.01, 5.0), ("bound", 0.1, 100.0),
        ):  # fmt: skip
            value = getattr(self, name)
            if not np.isfinite(value) or not low_ <= value <= high_:
                raise ValueError(f"{name} must be in [{low_:g}, {high_:g}], got {value}")

    @cached_property
    def machine(self) -> VehicleConfig:
        """The vehicle with joints on the active sides only."""
        return self.vehicle.with_active(self.active)

    @property
    def airframe(self) -> AirframeConfig:
        """The airframe with the stowed arms."""
        return self.machine.airframe

    @property
    def free_source(self) -> str:
        """The position source while the tool is not coupled."""
        return self.localization
