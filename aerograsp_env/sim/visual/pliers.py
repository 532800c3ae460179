"""Pliers: combination, lineman's, needle-nose, cutters, end cutters, slip-joint and water-pump, open or closed."""

from __future__ import annotations

import math
from typing import NamedTuple

import manifold3d
import numpy as np

from aerograsp_env.sim.visual import looks
from aerograsp_env.sim.visual.looks import Look
from aerograsp_env.sim.visual.objects import Draw, Shape, only, turns
from aerograsp_env.sim.visual.solids import Solid, ellipse, lathe, plate, polygon, smooth_path, solid_of, tube

KINDS = ("combination", "needle", "cutter", "lineman", "pump", "slip", "end-cutter", "round")

RED = Look((0.78, 0.10, 0.08), None, 0.2, 0.3)


class _Jaw(NamedTuple):
    """In units of the half-width of the joint; the jaw closes on y = 0 from below."""

    outline: list[tuple[float, float]]
    thin: float  # thickness at the tip over that at the joint


def pliers(draw: Draw) -> Shape:
    """Two equal halves on a pivot; half a turn about the long axis swaps them."""
    kind = draw.pick(*KINDS, "combination", "combination", "needle", "cutter", "lineman")
    joint = draw.size(0.0125, 0.0095, 0.016)  # [m]
    length = joint * draw.size(9.0, 7.0, 11.0)  # of the handles
    thick = joint * draw.size(0.80, 0.6, 1.0)
    opening = draw.size(math.radians(8.0), 0.0, math.radians(14.0))
    if draw.chance(0.35):
        opening = draw.size(0.0, math.radians(10.0), math.radians(44.0))
    jaw = _jaw(kind, draw)
    steel = draw.look(looks.STEEL, looks.metal)
    grip, second = draw.look(RED, looks.plastic), draw.look(looks.BLACK, looks.rubber)
    half = _steel(jaw, joint, thick)
    handles = _handle(joint, length, thick, steel, grip, second, draw)
    pieces = [(half, steel), *handles]
    parts: list[tuple[Solid, Look]] = []
    c, s = math.cos(0.5 * opening), math.sin(0.5 * opening)
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])  # clockwise: the lower jaw goes down
    flip = np.diag([1.0, -1.0, -1.0])
    for solid, look in pieces:
        moved = solid.moved(rotation=turn)
        parts += [(moved, look), (moved.moved(rotation=flip), look)]
    r = joint * draw.size(0.42, 0.3, 0.6)
    rivet = lathe(
        [(-0.56 * thick, 0.8 * r), (-0.52 * thick, r), (0.52 * thick, r), (0.56 * thick, 0.8 * r)], axis=2, sides=16
    )
    parts.append((rivet, steel if not draw.chance(0.3) else draw.look(steel, looks.metal)))
    if kind == "pump":  # the jaws of water-pump pliers are bent to one side
        parts = [
            (Solid(_bent(solid.vertices, joint, draw.size(0.5, 0.5, 0.5)), solid.faces), look) for solid, look in parts
        ]
        return Shape(tuple(parts), only(), kind, (None, None, 0.0))
    return Shape(tuple(parts), turns(0, 2), kind, (None, 0.0, 0.0))


def _bent(vertices: np.ndarray, joint: float, angle: float) -> np.ndarray:
    """What lies beyond the joint, turned about it."""
    x, y = vertices[:, 0], vertices[:, 1]
    share = np.clip(x / joint, 0.0, 1.0) * angle
    c, s = np.cos(share), np.sin(share)
    return np.column_stack([c * x - s * y, s * x + c * y, vertices[:, 2]])


def _jaw(kind: str, draw: Draw) -> _Jaw:
    long = draw.size(1.0, 0.85, 1.2)
    if kind in ("needle", "round"):
        n = long * draw.size(4.4, 3.2, 5.6)
        tip = draw.size(0.22, 0.15, 0.3)
        return _Jaw([(0.0, 0.0), (n, 0.0), (n, -tip), (1.3, -0.62), (0.6, -0.9), (0.0, -0.9)], 0.35)
    if kind == "cutter":
        n = long * draw.size(1.9, 1.5, 2.3)
        return _Jaw([(0.0, 0.0), (n, 0.0), (n, -0.12), (0.75 * n, -0.62), (0.4 * n, -0.95), (0.0, -1.0)], 0.55)
    if kind == "end-cutter":
        n = long * draw.size(1.5, 1.2, 1.8)
        return _Jaw(
            [
                (0.0, -0.2),
                (0.6 * n, -0.75),
                (0.95 * n, 0.0),
                (1.1 * n, -0.05),
                (1.05 * n, -0.8),
                (0.7 * n, -1.35),
                (0.0, -1.1),
            ],
            1.2,
        )
    if kind == "slip":
        n = long * draw.size(2.8, 2.3, 3.2)
        return _Jaw(
            [(0.0, 0.0), (0.4 * n, -0.3), (0.7 * n, -0.03), (n, 0.0), (n, -0.5), (0.5 * n, -0.95), (0.0, -1.0)], 0.7
        )
    if kind == "pump":
        n = long * draw.size(2.9, 2.4, 3.3)
        return _Jaw([(0.0, 0.0), (0.5 * n, -0.25), (n, 0.0), (n, -0.5), (0.6 * n, -1.05), (0.0, -1.0)], 0.9)
    n = long * (draw.size(2.9, 2.4, 3.4) if kind == "combination" else draw.size(2.4, 2.0, 2.8))
    tip = draw.size(0.55, 0.42, 0.72) if kind == "combination" else draw.size(0.75, 0.6, 0.9)
    bite = draw.size(0.22, 0.0, 0.3)  # the hollow for round things
    return _Jaw(
        [
            (0.0, 0.0),
            (0.32 * n, 0.0),
            (0.42 * n, -bite),
            (0.58 * n, -bite),
            (0.66 * n, 0.0),
            (n, 0.0),
            (n, -tip),
            (0.85 * n, -tip - 0.08),
            (0.45 * n, -0.95),
            (0.2 * n, -1.02),
            (0.0, -1.0),
        ],
        0.75,
    )


def _steel(jaw: _Jaw, joint: float, thick: float) -> Solid:
    """Jaw, joint and the root of the handle in one plate."""
    points = joint * np.array(jaw.outline)
    neck = joint * np.array(
        [(0.55, -0.75), (0.6, 0.0), (-0.3, 1.0), (-1.6, 1.25), (-2.2, 1.05), (-2.2, 0.55), (-1.0, 0.25), (-0.6, -0.5)]
    )
    outline: manifold3d.CrossSection = polygon(points) + polygon(neck) + ellipse(0.98 * joint, 1.0 * joint, sides=20)
    n = float(points[:, 0].max())
    profile = [
        (-2.2 * joint, 0.72 * thick),
        (-1.2 * joint, 0.85 * thick),
        (-0.8 * joint, thick),
        (0.9 * joint, thick),
        (n, jaw.thin * thick),
    ]
    return solid_of(plate(outline, profile, 0.07 * thick))


def _handle(
    joint: float, length: float, thick: float, steel: Look, grip: Look, second: Look, draw: Draw
) -> list[tuple[Solid, Look]]:
    """The upper handle: towards −x, bulging to +y."""
    belly, end = draw.size(1.75, 1.3, 2.3) * joint, draw.size(1.15, 0.8, 2.0) * joint
    if draw.chance(0.15):  # spreading straight
        belly, end = 1.6 * joint, draw.size(2.0, 2.0, 3.0) * joint
    shape = [(-1.6 * joint, 0.9 * joint), (-0.25 * length, 1.35 * joint), (-0.55 * length, belly), (-length, end)]
    line = smooth_path(shape, 15)
    path = np.column_stack([line, np.zeros(15)])
    w, h = joint * draw.size(0.36, 0.28, 0.46), thick * draw.size(0.38, 0.32, 0.46)
    share = np.linspace(0.0, 1.0, 15)
    core = tube(path[:14], np.column_stack([np.full(14, w), np.full(14, h)]), 10, 0.8)
    if draw.chance(0.10):
        return [(core, steel)]
    fat, first = draw.size(1.55, 1.25, 2.1), int(draw.size(4, 2, 6))
    bulge = 1.0 + draw.size(0.12, 0.0, 0.25) * np.sin(np.pi * (share - 0.1) * draw.pick(2.0, 1.0, 3.0)) ** 2
    sleeve = np.column_stack([w * fat * bulge, h * (0.5 + 0.5 * fat) * (0.9 + 0.1 * bulge)])
    sleeve[-1] *= 0.75
    parts = [(core, steel), (tube(path[first:], sleeve[first:], 12, 0.85), grip)]
    if draw.chance(0.4):  # a guard where the grip starts
        guard = sleeve[first : first + 2] * (1.6, 1.3)
        parts.append((tube(path[first : first + 2], guard, 12, 0.85), grip if draw.chance(0.5) else second))
    if draw.chance(0.5):  # soft zones of a second colour
        a, b = (first + 1, 15 - draw.pick(2, 1, 4))
        shift = draw.pick(-0.25, 0.25) * w
        zone = path[a:b] + (0.0, shift, 0.0)
        parts.append((tube(zone, sleeve[a:b] * (0.92, 1.1), 12, 0.85), second))
    return parts
