"""From the names that users pass to `gymnasium.make` to the configuration of a vehicle with arms."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from aerograsp_env.envs.options import choose, instance, pair, randomization, scalar, triple
from aerograsp_env.sim.arms.vehicles import AQUILES, BELEROFONTE_ARMS, VehicleConfig
from aerograsp_env.sim.autopilot import AutopilotConfig
from aerograsp_env.sim.manipulation.config import (
    ACTION_MODES,
    ManipulationConfig,
    ManipulationRandomizeConfig,
    PoseEstimateConfig,
)
from aerograsp_env.sim.sensors import SensorConfig
from aerograsp_env.sim.wind import WIND_LEVELS, WindConfig

VEHICLES = {"belerofonte": BELEROFONTE_ARMS, "aquiles": AQUILES}
POSES = ("exact", "estimated")


def manipulation_config(
    *,
    vehicle: str | VehicleConfig = "belerofonte",
    action_mode: str = "joint_velocity",
    pose: str = "exact",
    wind: str | WindConfig | dict = "light",
    localization: str = "vision",
    payload: float = 0.0,
    com_feedforward: bool = True,
    velocity_limit: Any = 0.5,
    command_delay: Any = 0.0,
    randomize: bool | ManipulationRandomizeConfig | dict = False,
    estimate: PoseEstimateConfig | dict | None = None,
    sensors: SensorConfig | None = None,
    autopilot: AutopilotConfig | dict | None = None,
    config: ManipulationConfig | None = None,
) -> ManipulationConfig:
    """The `ManipulationConfig` that these options mean. `config` supplies what no option names.

    `estimate` is used with pose="estimated" alone.
    """
    base = config if config is not None else ManipulationConfig()
    if not isinstance(base, ManipulationConfig):
        raise ValueError(f"config must be a ManipulationConfig, got {config!r}")
    if not isinstance(com_feedforward, bool):
        raise ValueError(f"com_feedforward must be True or False, got {com_feedforward!r}")
    tracker = PoseEstimateConfig() if estimate is None else instance("estimate", estimate, PoseEstimateConfig)
    return replace(
        base,
        vehicle=instance("vehicle", vehicle, VehicleConfig, VEHICLES),
        action_mode=choose("action_mode", action_mode, ACTION_MODES),
        estimate=tracker if choose("pose", pose, POSES) == "estimated" else None,
        wind=instance("wind", wind, WindConfig, WIND_LEVELS),
        localization=choose("localization", localization, ("gps", "vision", "truth")),
        payload=scalar("payload", payload),
        com_feedforward=com_feedforward,
        velocity_limit=triple("velocity_limit", velocity_limit),
        command_delay=pair("command_delay", command_delay),
        randomize=randomization(randomize, ManipulationRandomizeConfig),
        sensors=instance("sensors", sensors, SensorConfig) if sensors is not None else base.sensors,
        autopilot=instance("autopilot", autopilot, AutopilotConfig) if autopilot is not None else base.autopilot,
    )
