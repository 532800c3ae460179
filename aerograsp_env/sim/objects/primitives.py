"""The kinds of the training and validation sets: abstract bodies with random proportions.

None is an exact box, a straight round cylinder or any other kind of the test set. Sizes are such that every member has
a place 15–85 mm wide near its centre of mass.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from aerograsp_env.sim.objects import shapes
from aerograsp_env.sim.objects.everyday import Part, Parts
from aerograsp_env.sim.objects.shapes import box, moved

Kind = Callable[[Generator], Parts]


def tapered_box(rng: Generator) -> Parts:
    """Two rectangles, one above the other, unlike and shifted."""
    x, y, z = rng.uniform(0.025, 0.075), rng.uniform(0.03, 0.10), rng.uniform(0.10, 0.20)
    corners = np.array([(sx, sy, sz) for sx in (-0.5, 0.5) for sy in (-0.5, 0.5) for sz in (-0.5, 0.5)]) * (x, y, z)
    top = corners[:, 2] > 0.0
    corners[top, :2] = corners[top, :2] * rng.uniform(0.6, 0.95, 2) + rng.uniform(-0.15, 0.15, 2) * (x, y)
    return (Part((shapes.hull(corners),)),)


def prism(rng: Generator) -> Parts:
    """Three, five, six or seven uneven sides."""
    sides = int(rng.choice([3, 5, 6, 7]))
    outline = shapes.circle(1.0, sides) * rng.uniform(0.85, 1.0, (sides, 1)) * rng.uniform(0.022, 0.042, 2)
    return (Part((shapes.prism(outline, rng.uniform(0.10, 0.22)),)),)


def superellipsoid(rng: Generator) -> Parts:
    axes = (rng.uniform(0.015, 0.04), rng.uniform(0.02, 0.055), rng.uniform(0.05, 0.10))
    return (Part((shapes.ellipsoid(axes, (rng.uniform(0.4, 1.6), rng.uniform(0.4, 1.6))),)),)


def capsule(rng: Generator) -> Parts:
    """A capsule pressed flat."""
    radius = rng.uniform(0.018, 0.040)
    piece = shapes.capsule(radius, rng.uniform(0.06, 0.18))
    flat = piece.vertices * (rng.uniform(0.6, 1.0), 1.0, 1.0)
    return (Part((shapes.hull(flat),)),)


def cone(rng: Generator) -> Parts:
    """A truncated cone of oval section."""
    piece = shapes.frustum(1.0, rng.uniform(0.3, 0.75), rng.uniform(0.10, 0.20), 16)
    return (Part((shapes.hull(piece.vertices * (rng.uniform(0.025, 0.042), rng.uniform(0.025, 0.05), 1.0)),)),)


TRAIN: Mapping[str, Kind] = {kind.__name__: kind for kind in (tapered_box, prism, superellipsoid, capsule, cone)}
VALIDATION: Mapping[str, Kind] = {}
