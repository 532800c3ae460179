"""The kinds of the test set: things with names, and shapes that no training kind makes.

A kind asks `size(nominal, low, high)` for each of its dimensions: the test objects take the nominal ones, random
members draw between the bounds. Every one has a place 15–85 mm wide at or near its centre of mass.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from aerograsp_env.sim.objects import shapes
from aerograsp_env.sim.objects.shapes import Pieces, box, cylinder, moved

Size = Callable[[float, float, float], float]

QUARTER = 0.5 * np.pi
STEEL, WATER, HOLLOW = 7.8, 1.0, 0.25  # relative densities


class Part(NamedTuple):
    """Pieces of one material."""

    pieces: Pieces
    density: float = 1.0  # relative


Parts = tuple[Part, ...]


def mug(size: Size) -> Parts:
    radius, height, wall = size(0.039, 0.034, 0.041), size(0.10, 0.09, 0.11), size(0.006, 0.005, 0.007)
    inner, outer = [(radius - wall, 0.008), (radius - wall, height)], [(radius, 0.008), (radius, height)]
    bottom = moved(cylinder(radius, 0.008, 16), (0.0, 0.0, 0.004))
    reach = size(0.032, 0.028, 0.036)  # of the handle
    path = shapes.arc(reach, -QUARTER, QUARTER, 7, center=(radius - 0.5 * wall, 0.5 * height))
    return (Part(bottom + shapes.shell(inner, outer, 16) + shapes.sweep(path, shapes.circle(0.006, 8))),)


def staple(size: Size) -> Parts:
    half, leg, thick = size(0.029, 0.024, 0.031), size(0.10, 0.08, 0.12), size(0.022, 0.018, 0.024)
    depth = size(0.040, 0.030, 0.050)
    path = [(-half, 0.0, leg), (-half, 0.0, 0.0), (half, 0.0, 0.0), (half, 0.0, leg)]
    return (
        Part(shapes.sweep(path, 0.5 * np.array([(-thick, -depth), (thick, -depth), (thick, depth), (-thick, depth)]))),
    )


def valve_wheel(size: Size) -> Parts:
    rim, hub, tube = size(0.058, 0.052, 0.066), size(0.016, 0.013, 0.018), size(0.008, 0.007, 0.009)
    loop = shapes.arc(rim, 0.0, 2.0 * np.pi * 15.0 / 16.0, 16)[:, [0, 2, 1]]
    spokes = tuple(box((2.0 * rim, 0.012, 0.012)) if i == 0 else box((0.012, 2.0 * rim, 0.012)) for i in range(2))
    middle = moved(cylinder(hub, size(0.045, 0.036, 0.050)), (0.0, 0.0, 0.006))
    return (Part(middle + spokes + shapes.sweep(loop, shapes.circle(tube, 8), closed=True)),)


def pipe_tee(size: Size) -> Parts:
    radius, half, branch = size(0.021, 0.017, 0.024), size(0.070, 0.055, 0.085), size(0.075, 0.060, 0.085)
    along = moved(cylinder(radius, 2.0 * half), turn=(0.0, QUARTER, 0.0))
    up = moved(cylinder(radius, branch), (0.0, 0.0, 0.5 * branch))
    flange = cylinder(1.4 * radius, 0.012)
    ends = [moved(flange, (side * (half - 0.006), 0.0, 0.0), (0.0, QUARTER, 0.0)) for side in (-1.0, 1.0)]
    return (Part(along + up + ends[0] + ends[1] + moved(flange, (0.0, 0.0, branch - 0.006))),)


def crawler(size: Size) -> Parts:
    """An inspection robot: a hull between two tracks."""
    length, width, height = size(0.150, 0.130, 0.170), size(0.056, 0.048, 0.062), size(0.050, 0.045, 0.056)
    track, tall = size(0.022, 0.018, 0.026), size(0.044, 0.040, 0.048)
    outline = np.array([(-0.5, 0.0), (-0.36, -0.5), (0.36, -0.5), (0.5, 0.0), (0.4, 0.5), (-0.4, 0.5)])
    belt = shapes.prism(outline * (length, tall), track)
    side = 0.5 * (width + track) + 0.006
    belts = [moved(belt, (0.0, s * side, 0.0), (QUARTER, 0.0, 0.0)) for s in (-1.0, 1.0)]
    axles = tuple(box((0.016, 2.0 * side, 0.016), (x * length, 0.0, 0.0)) for x in (-0.28, 0.28))
    hull = box((0.75 * length, width, height), (0.0, 0.0, 0.5 * height - 0.012))
    lamp = moved(cylinder(0.010, 0.03, 12), (0.40 * length, 0.0, 0.5 * height - 0.012), (0.0, QUARTER, 0.0))
    return (Part((hull, *axles, *belts[0], *belts[1], *lamp)),)


def bottle(size: Size) -> Parts:
    radius, height, neck = size(0.033, 0.029, 0.037), size(0.215, 0.19, 0.24), size(0.013, 0.011, 0.015)
    profile = [
        (radius - 0.004, 0.0),
        (radius, 0.005),
        (radius, 0.60 * height),
        (0.75 * radius, 0.72 * height),
        (neck, 0.84 * height),
        (neck, height - 0.018),
        (neck + 0.003, height - 0.014),
        (neck + 0.003, height),
    ]
    return (Part(shapes.stack(profile)),)


def half_filled_bottle(size: Size) -> Parts:
    """A square bottle, its lower half water."""
    half, height, level = size(0.030, 0.026, 0.034), size(0.20, 0.18, 0.22), size(0.45, 0.35, 0.5)
    corner = 0.6 * half
    square = [(half, corner), (corner, half), (-corner, half), (-half, corner)]
    octagon = np.array(square + [(-x, -y) for x, y in square])

    def layer(low: float, high: float, bottom: float = 1.0, top: float = 1.0) -> Pieces:
        ends = ((low, bottom), (high, top))
        return (shapes.hull([(scale * x, scale * y, z * height) for z, scale in ends for x, y in octagon]),)

    upper = layer(level, 0.75) + layer(0.75, 0.88, 1.0, 0.45) + layer(0.88, 1.0, 0.45, 0.45)
    return Part(layer(0.0, level), WATER), Part(upper, 0.15)


def flashlight(size: Size) -> Parts:
    grip, head, length = size(0.016, 0.014, 0.018), size(0.027, 0.023, 0.031), size(0.205, 0.18, 0.23)
    profile = [
        (0.8 * grip, 0.0),
        (grip, 0.006),
        (grip, 0.72 * length),
        (head, 0.82 * length),
        (head, length),
    ]
    return (Part(shapes.stack(profile)),)


def hammer(size: Size) -> Parts:
    length, head, thick = size(0.250, 0.22, 0.28), size(0.105, 0.09, 0.12), size(0.030, 0.026, 0.034)
    oval = shapes.circle(1.0, 12) * (size(0.015, 0.013, 0.017), 0.012)
    handle = moved(shapes.prism(oval, length), (0.0, 0.0, 0.5 * length))
    face = box((0.62 * head, thick, thick), (0.19 * head, 0.0, length - 0.5 * thick))
    low, high = length - thick, length
    root, edge = -0.10 * head, -0.5 * head  # a little inside the face
    half = 0.5 * thick
    peen = shapes.hull(
        [(root, s * half, z) for s in (-1, 1) for z in (low, high)]
        + [(edge, s * half, z) for s in (-1, 1) for z in (length - 0.6 * thick, length - 0.4 * thick)]
    )
    return Part((face, peen), STEEL), Part(handle, 0.8)


def drill(size: Size) -> Parts:
    radius, length, grip = size(0.026, 0.023, 0.029), size(0.120, 0.105, 0.135), size(0.110, 0.095, 0.120)
    motor = moved(cylinder(radius, length, 16), turn=(0.0, QUARTER, 0.0))
    chuck = moved(
        shapes.frustum(0.8 * radius, 0.4 * radius, 0.04, 16), (0.5 * length + 0.019, 0.0, 0.0), (0.0, QUARTER, 0.0)
    )
    oval = shapes.circle(1.0, 12) * (0.021, 0.017)
    handle = moved(shapes.prism(oval, grip), (-0.2 * length, 0.0, -0.5 * grip))
    battery = box((0.085, 0.055, 0.042), (-0.15 * length, 0.0, -grip - 0.015))
    return Part((battery,), 4.0), Part(motor + chuck), Part(handle, 0.7)


def cereal_box(size: Size) -> Parts:
    return (Part((box((size(0.055, 0.04, 0.07), size(0.095, 0.08, 0.11), size(0.155, 0.13, 0.19))),)),)


def can(size: Size) -> Parts:
    radius, height = size(0.034, 0.029, 0.040), size(0.115, 0.10, 0.125)
    return (
        Part(
            (
                shapes.lathe(
                    [(radius - 0.004, 0.0), (radius, 0.005), (radius, height - 0.005), (radius - 0.004, height)]
                ),
            )
        ),
    )


def apple(size: Size) -> Parts:
    radius, height, dimple = size(0.041, 0.037, 0.042), size(0.078, 0.070, 0.082), size(0.012, 0.008, 0.014)
    below = [(0.35, 0.0), (0.72, 0.10), (0.95, 0.32), (1.0, 0.55), (0.94, 0.76)]
    lower = shapes.lathe([(radius * r, height * z) for r, z in below], 16)
    crown = [(0.0, 0.5), (0.94, 0.76), (0.78, 0.92), (0.5, 1.0), (0.0, 1.0 - dimple / height)]
    outline = [(radius * r, height * z) for r, z in crown]
    stem = moved(cylinder(0.003, 0.034, 8), (0.0, 0.0, height - dimple + 0.014))
    return (Part((lower, *shapes.sectors(outline, 16), *stem)),)


def juice_box(size: Size) -> Parts:
    """A carton with a gable top and a screw cap."""
    x, y, z = size(0.062, 0.055, 0.068), size(0.042, 0.036, 0.048), size(0.095, 0.085, 0.11)
    roof = 0.6 * y
    gable = [(sx * 0.5 * x, sy * 0.5 * y, z) for sx in (-1, 1) for sy in (-1, 1)]
    ridge = [(sx * 0.5 * x, sy * 0.003, z + roof) for sx in (-1, 1) for sy in (-1, 1)]
    cap = moved(cylinder(0.009, 0.026, 12), (0.0, 0.27 * y, z + 0.52 * roof), (-0.25 * np.pi, 0.0, 0.0))
    return (Part((box((x, y, z), (0.0, 0.0, 0.5 * z)), shapes.hull(gable + ridge), *cap)),)


def spanner(size: Size) -> Parts:
    """Two open jaws on a bar."""
    length, width, thick = size(0.150, 0.13, 0.18), size(0.026, 0.022, 0.030), size(0.018, 0.015, 0.02)
    parts: Pieces = (box((length, width, thick)),)
    for side in (-1.0, 1.0):
        root, gap = 0.5 * length, 0.45 * width
        neck = shapes.prism(
            [(root - 0.03, -0.5 * width), (root, -width), (root, width), (root - 0.03, 0.5 * width)], thick
        )
        jaws = [
            shapes.prism(
                [(root, s * gap), (root, s * width), (root + 0.025, s * 0.85 * width), (root + 0.025, s * gap)], thick
            )
            for s in (-1.0, 1.0)
        ]
        parts += moved((neck, *jaws), turn=(0.0, 0.0, 0.0 if side > 0.0 else np.pi))
    return (Part(parts),)


KINDS: Mapping[str, Callable[[Size], Parts]] = {
    kind.__name__: kind
    for kind in (
        mug,
        staple,
        valve_wheel,
        pipe_tee,
        crawler,
        bottle,
        half_filled_bottle,
        flashlight,
        spanner,
        hammer,
        drill,
        cereal_box,
        can,
        apple,
        juice_box,
    )
}
