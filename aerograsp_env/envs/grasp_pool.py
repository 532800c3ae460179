"""Which object an episode is about, on what it stands, and how it lies there.

Objects and poses are in the pool if parallel jaws can take them so, by geometry alone (`sim.manipulation.jaw_room`);
none is exchanged because a policy fails on it. What is computed for a member is kept, and always the same.
"""

from __future__ import annotations

import functools
import math
from collections import OrderedDict
from collections.abc import Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from aerograsp_env.envs.grasp_levels import GraspLevel, slopes
from aerograsp_env.envs.grasp_options import ObjectChoice
from aerograsp_env.sim.gripper import GripperConfig
from aerograsp_env.sim.manipulation.config import ManipulationConfig
from aerograsp_env.sim.manipulation.jaw_room import can_be_taken
from aerograsp_env.sim.manipulation.placing import PlacementError, place
from aerograsp_env.sim.manipulation.scene import build_model
from aerograsp_env.sim.manipulation.standing import standing
from aerograsp_env.sim.manipulation.supports import Support, inclined_table, pipe_saddle, table
from aerograsp_env.sim.objects import GraspObject
from aerograsp_env.sim.objects.crawler import pipe_crawler
from aerograsp_env.sim.objects.resting import resting_poses

Array = NDArray[np.float64]

MEMBERS = 16  # of a family
PLACEMENTS = 16  # of an object on a support
HEIGHT = 2.6  # of a support's seat above its own world's floor [m]: its legs reach below the scene's
PIPE_LENGTH = 1.2  # [m]: it ends clear of the rotors, however it is turned
MODELS = 128  # compiled scenes that are kept
_ATTEMPTS = 200


class Scene(NamedTuple):
    """What stands in a scene."""

    item: GraspObject  # as it is in the pool: its mass and surface are drawn later
    support: Support


class Setting(NamedTuple):
    """An object at rest."""

    scene: tuple[int, int, int, int]  # by which the pool knows the scene
    item: GraspObject
    support: Support
    T_world_object: Array  # (4, 4), in the support's own world


@functools.cache
def make_support(kind: str, slope: float, wide: bool = False) -> Support:
    """A support in the middle of its own world, its way down along x; `wide` enough for the crawler."""
    if kind == "saddle":
        seat = (0.36, 0.36) if wide else (0.30, 0.24)
        return pipe_saddle(slope, HEIGHT, seat, length=PIPE_LENGTH)
    return table(HEIGHT) if slope == 0.0 else inclined_table(slope, HEIGHT)


class GraspPool:
    """What episodes are drawn from.

    Args:
        objects: as for `envs.grasp_options.ObjectChoice`; a family counts with `MEMBERS` members.
        level: says what the objects stand on.
        jaws: that must be able to take them; None: whatever fits on the supports (a place for other grippers).
        wide: whether the supports are wide.
    """

    def __init__(self, objects: Any, level: GraspLevel, jaws: GripperConfig | None, wide: bool = False) -> None:
        self._choice = ObjectChoice(objects)
        self.names = self._choice.names
        self._level, self._jaws, self._wide = level, jaws, wide
        self._slopes = slopes(level)
        self._items: dict[tuple[str, int], GraspObject] = {}
        self._poses: dict[tuple[GraspObject, Support, int], Array | None] = {}
        self._models: OrderedDict[tuple[GraspObject, Support], mujoco.MjModel] = OrderedDict()

    def item(self, name: str, member: int) -> GraspObject:
        """A member of a family; of a name that stands for one object, that object."""
        if (name, member) not in self._items:
            rng = np.random.default_rng([member, *name.encode()])
            self._items[name, member] = self._choice.makers[name](rng)
        return self._items[name, member]

    def scene(self, index: Sequence[int]) -> Scene:
        """Number of the name, of the family's member, of the kind of support, and of its slope."""
        name, member, kind, slope = (int(i) for i in index)
        support = make_support(self._level.supports[kind], self._slopes[slope], self._wide)
        return Scene(self.item(self.names[name], member), support)

    def draw(self, rng: np.random.Generator, name: str | None = None) -> Setting:
        """Name, member, support and slope uniformly, then a pose in which it can be taken.

        Raises:
            ValueError: none was found: the object is too large, or too wide for the jaws however it lies.
        """
        counts = len(self.names), MEMBERS, len(self._level.supports), len(self._slopes), PLACEMENTS
        for _ in range(_ATTEMPTS):
            which, member, kind, slope, first = (int(rng.integers(count)) for count in counts)
            index = (which if name is None else self.names.index(name), member, kind, slope)
            item, support = self.scene(index)
            for k in range(PLACEMENTS):
                T = self._pose(item, support, (first + k) % PLACEMENTS)
                if T is not None:
                    return Setting(index, item, support, T)
        raise ValueError(
            f"objects: expected some that stand on {', '.join(self._level.supports)} and that jaws of 0.10 m can take "
            f"there, got {name or ', '.join(self.names)}"
        )

    def _pose(self, item: GraspObject, support: Support, number: int) -> Array | None:
        key = (item, support, number)
        if key not in self._poses:
            self._poses[key] = self._found(*key)
        return self._poses[key]

    def _found(self, item: GraspObject, support: Support, number: int) -> Array | None:
        try:
            T = self._place(item, support, number)
        except PlacementError:
            return None
        if self._jaws is not None and not can_be_taken(item, T, support, self._jaws):
            return None
        return T

    def _place(self, item: GraspObject, support: Support, number: int) -> Array:
        """T_world_object of the item's pose with this number on a support."""
        return place(item, support, np.random.default_rng([number, *item.name.encode()]))

    def model(self, config: ManipulationConfig, setting: Setting) -> mujoco.MjModel:
        """The compiled scene with the pool's own object; copy it before you change it."""
        key = setting.item, setting.support
        if key not in self._models:
            self._models[key] = build_model(config, [standing(*key)])
        self._models.move_to_end(key)
        while len(self._models) > MODELS:
            self._models.popitem(last=False)
        return self._models[key]


class CrawlerPool(GraspPool):
    """The pipe crawler on its drive units, turned by multiples of 60° from its support."""

    def __init__(self, level: GraspLevel) -> None:
        self.crawler = pipe_crawler()
        super().__init__(self.crawler, level, None, wide=True)
        poses = resting_poses(self.crawler)
        self._upright = max(poses, key=lambda pose: pose.T_support_object[2, 2])

    def _place(self, item: GraspObject, support: Support, number: int) -> Array:
        T = self._upright.T_support_object
        heading = number * math.pi / 3.0 - math.atan2(T[1, 0], T[0, 0])
        rng = np.random.default_rng([number, *item.name.encode()])
        return place(item, support, rng, pose=self._upright, heading=heading, spread=0.01)
