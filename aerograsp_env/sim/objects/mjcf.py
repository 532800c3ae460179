"""An object as MJCF text: its convex pieces as meshes, its mass properties, a free joint."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from aerograsp_env.sim.objects.grasp_object import GraspObject


class ObjectMjcf(NamedTuple):
    """Text for a MuJoCo scene."""

    assets: str  # for <asset>
    body: str  # for <worldbody>


def object_mjcf(item: GraspObject, name: str = "object", cls: str = "object") -> ObjectMjcf:
    """The item as a free body `name`, whose frame is the object's own, with the free joint `name`.

    Its geoms `name`0, `name`1, … are of the default class `cls`, which says what they collide with. The friction is the
    item's; whatever touches it may override that by a higher priority.
    """
    inertia = np.asarray(item.inertia, dtype=np.float64)
    full = (*np.diag(inertia), inertia[0, 1], inertia[0, 2], inertia[1, 2])
    assets, geoms = [], []
    for i, piece in enumerate(item.pieces):
        assets.append(
            f'<mesh name="{name}{i}" inertia="convex" vertex="{_text(piece.vertices)}" '
            f'face="{" ".join(map(str, np.asarray(piece.faces).ravel()))}"/>'
        )
        geoms.append(
            f'<geom name="{name}{i}" type="mesh" mesh="{name}{i}" class="{cls}" mass="0" condim="4" '
            f'friction="{item.friction:.6g} 0.002 0.0001"/>'
        )
    body = (
        f'<body name="{name}"><freejoint name="{name}"/><inertial pos="{_text(item.center_of_mass)}" '
        f'mass="{item.mass:.9g}" fullinertia="{_text(full)}"/>\n' + "\n".join(geoms) + "</body>"
    )
    return ObjectMjcf("\n".join(assets), body)


def _text(values: ArrayLike) -> str:
    return " ".join(f"{value:.10g}" for value in np.asarray(values, dtype=np.float64).ravel())
