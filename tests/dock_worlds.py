"""What the tests of the docking simulation share: quiet sensors, records for compiled functions, bare environments."""

from __future__ import annotations

from typing import Any

import gymnasium
import mujoco
import numpy as np

import aerograsp_env  # noqa: F401  registers the ids
from aerograsp_env.envs.base import DockBase
from aerograsp_env.sim import layout as lay
from aerograsp_env.sim.config import DockConfig
from aerograsp_env.sim.parameters import make_parameters
from aerograsp_env.sim.scene import build_model
from aerograsp_env.sim.sensors import SensorConfig

DOCK, ATTACH = "aerograsp/Dock-v0", "aerograsp/DockAttach-v0"
QUIET = SensorConfig().scaled(0.0)
AT_NOMINAL = {"goal": (0.0, 0.0, 0.0), "start": (0.0, 0.0, 0.0), "tilt": (0.0, 0.0)}
FREE: dict[str, Any] = {"docked": False, "localization": "truth", "wind": "calm", "sensors": QUIET}
"""Free hover in still air, everything sensed without error."""


def make(env_id: str = DOCK, **options: Any) -> DockBase:
    """The bare environment, without Gymnasium's wrappers."""
    env = gymnasium.make(env_id, **options).unwrapped
    assert isinstance(env, DockBase)
    return env


def world(config: DockConfig | None = None) -> tuple[mujoco.MjModel, mujoco.MjData, np.record, np.record]:
    """Model, data, parameter and state records of a docking world that no episode has begun in."""
    config = config or DockConfig()
    model = build_model(config.airframe.with_payload(config.payload), config.tool)
    parameters, states = np.zeros(1, lay.PARAMETERS), np.zeros(1, lay.STATE)
    parameters[0] = make_parameters(config, model)
    return model, mujoco.MjData(model), parameters.view(np.recarray)[0], states.view(np.recarray)[0]
