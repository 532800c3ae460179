"""From the names that users pass to `gymnasium.make` to a checked configuration."""

from __future__ import annotations

import difflib
import inspect
import os
import sys
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim.airframe import AIRFRAMES, AirframeConfig
from aerograsp_env.sim.autopilot import AutopilotConfig
from aerograsp_env.sim.config import DockConfig, RandomizeConfig
from aerograsp_env.sim.docking_tool import DockingToolConfig
from aerograsp_env.sim.sensors import SensorConfig
from aerograsp_env.sim.wind import WIND_LEVELS, WindConfig

REWARD_MODES = ("dense", "sparse")
RENDER_MODES = ("rgb_array", "depth_array", "human")


def available_render_modes() -> list[str]:
    """`RENDER_MODES`, "human" only where a display is: without one MuJoCo's viewer ends the whole process."""
    display = sys.platform != "linux" or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    return [mode for mode in RENDER_MODES if mode != "human" or display]


def check_render_mode(mode: str | None) -> str | None:
    """`mode` if it is one that works here, else a ValueError."""
    if mode is not None and choose("render_mode", mode, RENDER_MODES) not in available_render_modes():
        raise ValueError("render_mode 'human' needs a display (DISPLAY or WAYLAND_DISPLAY is not set); use 'rgb_array'")
    return mode


def choose(name: str, value: Any, valid: Iterable[str]) -> str:
    """`value` if it is one of the valid names, else a ValueError with the nearest ones."""
    names = list(valid)
    if isinstance(value, str) and value in names:
        return value
    near = difflib.get_close_matches(str(value), names, n=1, cutoff=0.4)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    raise ValueError(f"{name} must be one of {', '.join(map(repr, names))}, got {value!r}{hint}")


def instance(name: str, value: Any, kind: type, names: dict[str, Any] | None = None) -> Any:
    """A configuration value: an instance, a name that stands for one, or a mapping of changes to the default."""
    if isinstance(value, kind):
        return value
    if names is not None and isinstance(value, str):
        return names[choose(name, value, names)]
    if isinstance(value, dict):  # from a command line or a JSON file
        try:
            return kind(**value)
        except TypeError as error:
            raise ValueError(f"{name}: {error}") from None
    known = f" or one of {', '.join(map(repr, names))}" if names else ""
    raise ValueError(f"{name} must be a {kind.__name__}{known}, got {value!r}")


def randomization(value: Any, kind: type) -> Any:
    """What the option `randomize` means: None for False, the default for True, else what `instance` gives."""
    if isinstance(value, bool | np.bool_):
        return kind() if value else None
    return instance("randomize", value, kind)


def scalar(name: str, value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be a number, got {value!r}") from None


def pair(name: str, value: Any) -> tuple[float, float]:
    try:
        both: Any = (value, value) if np.isscalar(value) else value
        low, high = (float(v) for v in both)
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be a number or a pair (low, high) in seconds, got {value!r}") from None
    return low, high


def triple(name: str, value: Any) -> tuple[float, float, float]:
    try:
        array = np.broadcast_to(np.asarray(value, dtype=float), (3,))
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be a number or three numbers, got {value!r}") from None
    return float(array[0]), float(array[1]), float(array[2])


def dock_config(
    *,
    attach: bool,
    wind: str | WindConfig | dict = "light",
    localization: str = "dock",
    docked: bool = True,
    randomize: bool | RandomizeConfig | dict = False,
    airframe: str | AirframeConfig = "belerofonte",
    payload: float = 0.0,
    velocity_limit: Any = 0.5,
    command_frame: str = "world",
    command_delay: Any = 0.0,
    sensors: SensorConfig | None = None,
    tool: DockingToolConfig | dict | None = None,
    autopilot: AutopilotConfig | dict | None = None,
    config: DockConfig | None = None,
) -> DockConfig:
    """The `DockConfig` that these options mean. `config` supplies what no option names (spreads, skip, bounds)."""
    if not isinstance(docked, (bool, np.bool_)):
        raise ValueError(f"docked must be True or False, got {docked!r}")
    base = config if config is not None else DockConfig()
    if not isinstance(base, DockConfig):
        raise ValueError(f"config must be a DockConfig, got {config!r}")
    pilot = instance("autopilot", autopilot, AutopilotConfig) if autopilot is not None else base.autopilot
    choose("command_frame", command_frame, ("world", "heading"))
    if command_frame != "world":
        pilot = replace(pilot, command_frame=command_frame)
    return replace(
        base,
        attach=attach,
        wind=instance("wind", wind, WindConfig, WIND_LEVELS),
        localization=choose("localization", localization, ("dock", "gps", "vision", "truth")),
        docked=bool(docked),
        randomize=randomization(randomize, RandomizeConfig),
        airframe=instance("airframe", airframe, AirframeConfig, AIRFRAMES),
        payload=scalar("payload", payload),
        velocity_limit=triple("velocity_limit", velocity_limit),
        command_delay=pair("command_delay", command_delay),
        autopilot=pilot,
        sensors=instance("sensors", sensors, SensorConfig) if sensors is not None else base.sensors,
        tool=instance("tool", tool, DockingToolConfig) if tool is not None else base.tool,
    )


def built(build: Callable[..., Any], options: dict[str, Any], **fixed: Any) -> Any:
    """`build(**options, **fixed)`, with an error that lists the valid names where an option is unknown."""
    known = [name for name in inspect.signature(build).parameters if name not in fixed]
    for name in options:
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise ValueError(f"unknown option {name!r}{hint}; options: {', '.join(known)}")
    return build(**options, **fixed)


def check_action(action: Any, shape: tuple[int, ...]) -> NDArray[Any]:
    """`action` as a numeric array of `shape`; the compiled step refuses what is not finite and clips to [−1, 1].

    Raises ValueError where its dtype is not numeric or its shape differs.
    """
    array = np.asarray(action)
    if array.dtype.kind not in "fiu":
        got = f"{type(action).__name__} of dtype {array.dtype}"
        raise ValueError(f"action must be a numeric array of shape {shape}, got {got}")
    if array.shape != shape:
        raise ValueError(f"action must have shape {shape}, got {array.shape}")
    return array
