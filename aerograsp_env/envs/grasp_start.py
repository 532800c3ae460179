"""How an episode of `aerograsp/GraspPlan-v0` begins: an object, how it lies, and what is seen of it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from aerograsp_env.envs.grasp_options import (
    GraspRandomizeConfig,
    ObjectChoice,
    Start,
    draw_orientation,
    draw_view,
    varied,
)
from aerograsp_env.sim.depth_view import DepthCameraConfig, PartialView, UnseenError, partial_view
from aerograsp_env.sim.gripper import GripperConfig
from aerograsp_env.sim.objects import GraspObject

VIEWS = 10
"""Views that are drawn before an object counts as one that cannot be seen."""


class Beginning(NamedTuple):
    """What an episode is about."""

    item: GraspObject  # its mass and friction as drawn
    seen: PartialView


def begin(
    choice: ObjectChoice,
    start: Start,
    randomize: GraspRandomizeConfig | None,
    camera: DepthCameraConfig,
    points: int,
    gripper: GripperConfig,
    seed: int | None,
    rng: np.random.Generator,
) -> Beginning:
    """Draw what `start` does not fix. A view that shows nothing is drawn again, up to `VIEWS` in all.

    All is drawn whatever is fixed, so that one option leaves the other draws as they were.

    Raises:
        ValueError: an object that is too large; (UnseenError) one of which nothing is seen.
    """
    item = choice.pick(seed, rng, start.name)
    R, view, hidden = draw_orientation(rng), draw_view(rng), bool(rng.random() < camera.occluded_probability)
    if randomize is not None:
        item = varied(item, randomize, rng)
        camera = camera.scaled(rng.uniform(*randomize.noise))
    R = R if start.R_world_object is None else start.R_world_object
    occluded = hidden if start.occluded is None else start.occluded
    if start.view is not None:
        return Beginning(item, partial_view(item, R, start.view, points, camera, rng, occluded, gripper))
    for _ in range(VIEWS):
        try:
            return Beginning(item, partial_view(item, R, view, points, camera, rng, occluded, gripper))
        except UnseenError:
            view = draw_view(rng)
    raise UnseenError(f"object: expected one that can be seen, got {item.name!r}, unseen in {VIEWS} views")
