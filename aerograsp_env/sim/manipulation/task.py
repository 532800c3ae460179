"""What a task adds to a vehicle with arms: its part of the scene, of an episode's beginning, and what a step means."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim.actions import ActionDimension
from aerograsp_env.sim.manipulation import layout as lay
from aerograsp_env.sim.manipulation.config import ManipulationConfig
from aerograsp_env.sim.manipulation.scene import Piece


@dataclass
class Episode:
    """What `Task.begin` may read and write before an episode begins; arrays and records are written in place.

    The vehicle stands level at `parameters["hold_position"]`, its arms in their home configuration, wind and sensor
    errors are drawn. Whatever a task places, it places here.
    """

    config: ManipulationConfig
    model: mujoco.MjModel
    data: mujoco.MjData
    parameters: np.ndarray  # layout.PARAMETERS, zero-dimensional
    state: np.ndarray  # layout.STATE
    record: np.ndarray  # the task's own
    rng: np.random.Generator
    options: dict[str, Any]

    def arm_joints(self, arm: int) -> NDArray[np.float64]:
        """(n,) view of an arm's joint positions in `data.qpos` [rad]."""
        first = int(self.parameters["arm_qpos"][arm])
        return self.data.qpos[first : first + int(self.parameters["joints"][arm])]


class Task(ABC):
    """A task over `Worlds`. Subclasses fill in the names and `begin`, and give the compiled `evaluate`.

    `evaluate(parameters, states, records, noise, cursors, active, stepped, bounds, slots, observations, terms, metrics,
    flags, first, last)` is compiled. For each of the worlds first … last−1 that is `active` it writes a row of
    `observations` (clipped to ± `bounds`), and, where `stepped`, of `terms`, `metrics` and `flags` (success,
    terminated, counted). The step's row of noise is `noise[n, cursors[n] − 1]`. With `stepped` False an episode has
    just begun.
    """

    observation: tuple[tuple[str, int, float], ...]  # name, size, bound: parts of a flat observation row
    actions: tuple[ActionDimension, ...]
    slots: NDArray[np.int64]  # (A,) command slot of each entry of the action
    record: np.dtype  # the task's own parameters and state, one record a world
    terms: ClassVar[tuple[str, ...]]  # reward terms, in the order of `Worlds.terms`
    metrics: ClassVar[tuple[str, ...]]
    always_reported: ClassVar[tuple[str, ...]] = ()  # metrics that mean something before errors count
    reset_options: ClassVar[tuple[str, ...]] = ()
    evaluate: ClassVar[Callable[..., None]]

    def __init__(self, config: ManipulationConfig) -> None:
        self.config = config

    @abstractmethod
    def reward_terms(self, reward_mode: str) -> tuple[str, ...]:
        """Names of the terms that make up the reward."""

    def pieces(self) -> Sequence[Piece]:
        """What the task adds to the scene of every world."""
        return ()

    def shown_pieces(self, record: np.void) -> Sequence[Piece]:
        """What stands in the scene of the episode whose record this is, for pictures; the same values while it is."""
        return self.pieces()

    def scene(self, rng: np.random.Generator, options: dict[str, Any]) -> mujoco.MjModel | None:
        """This episode's model, where it differs from episode to episode (another object); None: the worlds' one.

        A model must stay the same while worlds use it: it is copied where a vehicle is drawn.
        """
        return None

    @abstractmethod
    def begin(self, episode: Episode) -> None:
        """Draw and place what the task is about."""

    def mark(self, record: np.void, state: np.void) -> NDArray[np.float64] | None:
        """(3,) world position of a target to be shown in pictures, or None."""
        return None


def arm_dimensions(config: ManipulationConfig) -> tuple[list[ActionDimension], list[int]]:
    """The active arms' entries of an action, and their command slots."""
    dimensions, slots = [], []
    mounts = config.machine.mounts
    for i, mount in enumerate(mounts):
        prefix = f"{mount.side}_" if len(mounts) > 1 else ""
        if config.action_mode == "ee_twist":
            for k, name in enumerate(("linear_x", "linear_y", "linear_z", "angular_x", "angular_y", "angular_z")):
                unit = "m/s" if k < 3 else "rad/s"
                dimensions.append(ActionDimension(prefix + name, config.twist[k // 3], unit, "body"))
        else:
            for joint in mount.arm.joints:
                dimensions.append(ActionDimension(prefix + joint.name, config.joint_rate, "rad/s", "joint"))
        count = 6 if config.action_mode == "ee_twist" else mount.arm.n
        slots += [lay.ARM_SLOT[i] + k for k in range(count)]
    return dimensions, slots
