"""What the single and the batched docking environments share: spaces, the action's layout, the names of results."""

from __future__ import annotations

import numpy as np
from gymnasium import spaces

from aerograsp_env.sim.actions import ActionDimension
from aerograsp_env.sim.config import DockConfig
from aerograsp_env.sim.kernel_task import TERMS

# the other metrics only once errors count, after the first seconds
ALWAYS_REPORTED = ("effort", "crash", "clamp_force_max")

Layout = tuple[tuple[str, int, float], ...]


def action_layout(config: DockConfig) -> tuple[ActionDimension, ...]:
    """The action's dimensions, in order."""
    frame = config.autopilot.command_frame
    axes = zip("xyz", config.velocity_limit, strict=True)
    velocity = tuple(ActionDimension(f"velocity_{axis}", limit, "m/s", frame) for axis, limit in axes)
    if not config.attach:
        return velocity
    couple = ActionDimension("couple", 1.0, "couples when > 0 and the base lies in the seat", "none")
    return (*velocity, ActionDimension("yaw_rate", config.yaw_rate_limit, "rad/s", "world"), couple)


def observation_space(layout: Layout) -> spaces.Dict:
    """Bounded one-dimensional float32 Boxes, one a name."""
    return spaces.Dict({name: spaces.Box(-bound, bound, (size,), np.float32) for name, size, bound in layout})


def slices(layout: Layout) -> dict[str, slice]:
    """Where each name stands in a flat observation row (Gymnasium's Dict sorts its keys, rows do not)."""
    result, first = {}, 0
    for name, size, _ in layout:
        result[name] = slice(first, first + size)
        first += size
    return result


def term_columns(attach: bool, reward_mode: str) -> tuple[tuple[str, int], ...]:
    """(name, column in Worlds.terms) of the terms that make up the reward."""
    if reward_mode == "sparse":
        names: tuple[str, ...] = ("within",)
    else:
        names = tuple(t for t in TERMS if t != "within" and (attach or t != "approach"))
    return tuple((name, TERMS.index(name)) for name in names)
