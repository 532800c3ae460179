"""The same object, but harder to hold: another mass, another surface."""

from __future__ import annotations

import dataclasses
import math

from aerograsp_env.sim.objects.grasp_object import GraspObject


def heavier(item: GraspObject, mass: float | None = None, friction: float | None = None) -> GraspObject:
    """The item with another mass [kg] and friction; the shape, and how the mass is spread in it, stay.

    The name stays as well: it says what the object looks like.

    Raises:
        ValueError: a mass or friction that is not positive and finite.
    """
    new = item.mass if mass is None else mass
    if not 0.0 < new < math.inf:
        raise ValueError(f"mass: expected a positive value [kg], got {mass}")
    return dataclasses.replace(
        item,
        mass=new,
        inertia=item.inertia * (new / item.mass),
        friction=item.friction if friction is None else friction,
    )
