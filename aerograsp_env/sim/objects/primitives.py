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


def pebble(rng: Generator) -> Parts:
    """The hull of a few points on an ellipsoid: large flat facets."""
    points = rng.normal(size=(14, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    axes = (rng.uniform(0.022, 0.042), rng.uniform(0.03, 0.05), rng.uniform(0.06, 0.09))
    ends = np.array([(0.0, 0.0, 1.0), (0.0, 0.0, -1.0)])
    return (Part((shapes.hull(np.concatenate([points, ends]) * axes),)),)


def dumbbell(rng: Generator) -> Parts:
    """Two knobs, balls or blocks, on a bar."""
    length, bar = rng.uniform(0.08, 0.16), rng.uniform(0.009, 0.018)
    parts = [Part((box((2.0 * bar, 1.6 * bar, length)),))]
    for end in (-0.5, 0.5):
        radius = rng.uniform(1.4 * bar, 0.04)
        knob = shapes.ellipsoid((radius, radius, radius)) if rng.random() < 0.5 else box((2.0 * radius,) * 3)
        parts.append(Part(moved(knob, (0.0, 0.0, end * length))))
    return tuple(parts)


def l_bracket(rng: Generator) -> Parts:
    """Two arms at an angle of 70° to 130°."""
    thick, deep = rng.uniform(0.018, 0.032), rng.uniform(0.025, 0.06)
    arms = rng.uniform(0.08, 0.15, 2)
    angle = np.radians(rng.uniform(70.0, 130.0))
    second = arms[1] * np.array([np.cos(angle), 0.0, np.sin(angle)])
    return tuple(
        Part((arm,)) for arm in shapes.sweep([(arms[0], 0.0, 0.0), (0.0, 0.0, 0.0), second], _bar(thick, deep))
    )


def cross(rng: Generator) -> Parts:
    """Two or three bars through each other."""
    thick = rng.uniform(0.018, 0.030)
    sizes = np.full((3, 3), thick) + np.diag(rng.uniform(0.10, 0.17, 3) - thick)
    return tuple(Part((box(sizes[k]),)) for k in range(int(rng.integers(2, 4))))


def i_beam(rng: Generator) -> Parts:
    """Two flanges, which may differ in width, and a web."""
    length, height = rng.uniform(0.10, 0.18), rng.uniform(0.05, 0.085)
    flange, web = rng.uniform(0.010, 0.016), rng.uniform(0.016, 0.026)
    upper, lower = rng.uniform(0.04, 0.075, 2)
    middle = 0.5 * (height - flange)
    return (
        Part((box((length, web, height - flange)),)),
        Part((box((length, upper, flange), (0.0, 0.0, middle)),)),
        Part((box((length, lower, flange), (0.0, 0.0, -middle)),)),
    )


def stacked_prisms(rng: Generator) -> Parts:
    """Three to five polygonal discs of unlike widths."""
    sides = int(rng.integers(4, 9))
    parts, base = [], 0.0
    for height in rng.dirichlet(np.full(n := int(rng.integers(3, 6)), 8.0)) * rng.uniform(0.11, 0.035 * n + 0.06):
        radius = rng.uniform(0.018, 0.042)
        parts.append(Part((shapes.lathe([(radius, base), (radius, base + height)], sides),)))
        base += height
    return tuple(parts)


def chain(rng: Generator) -> Parts:
    """Two to four chunks, each centred near the surface of the one before."""
    parts, center, heading = [], np.zeros(3), _direction(rng)
    for _ in range(int(rng.integers(2, 5))):
        size = rng.uniform(0.026, 0.038, 3)
        chunk = shapes.ellipsoid(size, (rng.uniform(0.3, 1.0), rng.uniform(0.3, 1.0)), rings=5)
        parts.append(Part(moved(chunk, center, Rotation.random(rng=rng).as_rotvec())))
        heading = heading + 0.7 * _direction(rng)
        heading /= np.linalg.norm(heading)
        center = center + rng.uniform(0.038, 0.044) * heading
    return tuple(parts)


def bent_tube(rng: Generator) -> Parts:
    """A rod of six to ten sides with one to three bends of 20° to 65°, in any plane."""
    points, heading = [np.zeros(3)], np.array([0.0, 0.0, 1.0])
    for _ in range(int(rng.integers(2, 5))):
        points.append(points[-1] + rng.uniform(0.05, 0.08) * heading)
        side = np.cross(heading, _direction(rng))
        angle = np.radians(rng.uniform(20.0, 65.0))
        heading = np.cos(angle) * heading + np.sin(angle) * side / np.linalg.norm(side)
    section = shapes.circle(rng.uniform(0.012, 0.020), int(rng.integers(6, 11)))
    return tuple(Part((piece,)) for piece in shapes.sweep(points, section))


def ribbed_plate(rng: Generator) -> Parts:
    """A plate with one to three ribs across it."""
    x, y, z = rng.uniform(0.11, 0.18), rng.uniform(0.05, 0.08), rng.uniform(0.014, 0.024)
    count = int(rng.integers(1, 4))
    parts = [Part((box((x, y, z)),))]
    for k in range(count):
        height, thick = rng.uniform(0.02, 0.05), rng.uniform(0.014, 0.02)
        place = (k + 0.5) / count - 0.5 + rng.uniform(-0.1, 0.1) / count
        parts.append(Part((box((thick, y, z + height), (place * x, 0.0, 0.5 * height)),)))
    return tuple(parts)


def star(rng: Generator) -> Parts:
    """A thick plate with three to six points."""
    count, core, reach = int(rng.integers(3, 7)), rng.uniform(0.018, 0.026), rng.uniform(0.058, 0.08)
    thick = rng.uniform(0.02, 0.05)
    parts = [Part((shapes.prism(shapes.circle(core, 2 * count), thick),))]
    for angle in np.arange(count) * (2.0 * np.pi / count):
        point = shapes.prism([(0.0, -0.7 * core), (0.0, 0.7 * core), (reach, 0.004), (reach, -0.004)], thick)
        parts.append(Part(moved(point, turn=(0.0, 0.0, angle))))
    return tuple(parts)


def mushroom(rng: Generator) -> Parts:
    """A dome on a stem."""
    radius, dome = rng.uniform(0.035, 0.042), rng.uniform(0.03, 0.05)
    stem, length = rng.uniform(0.012, 0.020), rng.uniform(0.075, 0.11)
    angles = np.linspace(0.0, 0.5 * np.pi, 6)
    cap = shapes.lathe(np.column_stack([radius * np.cos(angles), dome * np.sin(angles)]), 20)
    return Part((cap,)), Part(
        moved(shapes.frustum(1.2 * stem, stem, length + 0.01, 10), (0.0, 0.0, 0.01 - 0.5 * length))
    )


def stair(rng: Generator) -> Parts:
    """Three or four steps of one depth."""
    count, tread, rise = int(rng.integers(3, 5)), rng.uniform(0.035, 0.05), rng.uniform(0.018, 0.024)
    deep = rng.uniform(0.03, 0.07)
    return tuple(
        Part((box((tread, deep, (k + 1) * rise), (k * tread, 0.0, 0.5 * (k + 1) * rise)),)) for k in range(count)
    )


def hourglass(rng: Generator) -> Parts:
    """Two pyramids that meet in a waist."""
    sides, waist = int(rng.integers(3, 9)), rng.uniform(0.012, 0.022)
    ends, heights = rng.uniform(0.028, 0.042, 2), rng.uniform(0.05, 0.10, 2)
    profile = [(ends[0], -heights[0]), (waist, 0.0), (ends[1], heights[1])]
    return tuple(Part((piece,)) for piece in shapes.stack(profile, sides))


def _bar(thick: float, deep: float) -> NDArray[np.float64]:
    """(4, 2) a rectangle around the origin."""
    return 0.5 * np.array([(-thick, -deep), (thick, -deep), (thick, deep), (-thick, deep)])


def _direction(rng: Generator) -> NDArray[np.float64]:
    vector = rng.normal(size=3)
    return vector / np.linalg.norm(vector)


TRAIN: Mapping[str, Kind] = {
    kind.__name__: kind
    for kind in (
        tapered_box,
        prism,
        superellipsoid,
        capsule,
        cone,
        pebble,
        dumbbell,
        l_bracket,
        cross,
        i_beam,
        stacked_prisms,
        chain,
        bent_tube,
        ribbed_plate,
    )
}
VALIDATION: Mapping[str, Kind] = {kind.__name__: kind for kind in (star, mushroom, stair, hourglass)}
