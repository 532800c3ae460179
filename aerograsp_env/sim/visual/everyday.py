"""Cans, cartons, boxes, fruit and the crawler."""

from __future__ import annotations

import functools

import manifold3d
import numpy as np

from aerograsp_env.sim.objects.crawler import pipe_crawler
from aerograsp_env.sim.visual import looks, solids
from aerograsp_env.sim.visual.looks import Look
from aerograsp_env.sim.visual.objects import STEP, Draw, Shape, only, times, turns
from aerograsp_env.sim.visual.solids import Solid, lathe, loft, tube

ALUMINIUM = Look((0.75, 0.76, 0.78), None, 0.5, 0.5, 0, "aluminium")
PRINT = Look((0.80, 0.10, 0.12), "label", 0.3, 0.4, 0, "printed")


def can(draw: Draw) -> Shape:
    """Upside down it looks the same but for its print and the depth of the lid."""
    r, h = draw.size(0.033, 0.027, 0.040), draw.size(0.115, 0.075, 0.165)
    rim, shoulder = draw.size(0.82, 0.78, 0.97), draw.size(0.010, 0.004, 0.014)
    body = [(-0.5 * h + shoulder, r), (0.5 * h - shoulder, r)]
    wall = lathe([(-0.5 * h + 0.002, rim * r), *body, (0.5 * h - 0.002, rim * r)], axis=2, sides=STEP)
    ends = []
    for side in (-1.0, 1.0):
        edge = [
            (0.5 * h - 0.004, rim * r),
            (0.5 * h, rim * r),
            (0.5 * h, 0.92 * rim * r),
            (0.5 * h - 0.0025, 0.88 * rim * r),
        ]
        ends.append(lathe([(side * z, radius) for z, radius in edge], axis=2, sides=STEP))
    metal = draw.look(ALUMINIUM, looks.aluminium)
    print_ = draw.look(PRINT, looks.printed) if not draw.chance(0.1) else metal
    parts = ((wall, print_), (ends[0], metal), (ends[1], metal))
    return Shape(parts, times(turns(2, STEP), turns(0, 2)), "can", (0.0, 0.0, 0.0))


def juice_box(draw: Draw) -> Shape:
    """A carton: a gable with a cap, or a brick with a straw."""
    kind = draw.pick("gable", "brick", "brick")
    x, y, z = draw.size(0.062, 0.045, 0.075), draw.size(0.042, 0.032, 0.055), draw.size(0.100, 0.08, 0.15)
    look = draw.look(Look((0.95, 0.60, 0.10), "label", 0.3, 0.4), looks.printed)
    body = solids.box((x, y, z))
    cap_look = draw.look(Look((0.1, 0.5, 0.2), None, 0.3, 0.4), looks.plastic)
    if kind == "gable":
        roof = 0.55 * y
        square = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * 0.5
        rings = [
            np.column_stack([square * (x, y * w), np.full(4, 0.5 * z + h)])
            for h, w in ((-0.001, 1.0), (roof, 0.04), (roof + 0.012, 0.04))
        ]
        r = draw.size(0.010, 0.008, 0.013)
        cap = lathe([(0.0, r), (0.014, r)], axis=2, sides=16)
        slope = np.arctan2(roof, 0.5 * y)
        c, s = np.cos(slope), np.sin(slope)
        turn = np.array([[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]])
        cap = cap.moved(rotation=turn).moved((0.0, 0.26 * y, 0.5 * z + 0.48 * roof))
        parts: tuple[tuple[Solid, Look], ...] = ((body, look), (loft(rings), look), (cap, cap_look))
    else:
        r = draw.size(0.0025, 0.002, 0.003)
        if draw.chance(0.5):  # the straw sticks out, bent
            px, py = 0.3 * x, 0.2 * y
            up = draw.size(0.04, 0.02, 0.06)
            straw = lathe([(0.5 * z - 0.002, r), (0.5 * z + up, r)], axis=2, sides=10).moved((px, py, 0.0))
        else:  # or is glued to the back
            straw = lathe([(-0.42 * z, r), (0.42 * z, r)], axis=2, sides=10).moved((0.1 * x, 0.5 * y + 0.5 * r, 0.0))
        parts = ((body, look), (straw, cap_look))
    return Shape(parts, only(), kind)


def box(draw: Draw) -> Shape:
    """A carton, a matchbox or a block: three different sides, so that half turns alone leave it the same."""
    sides = sorted(
        (draw.size(0.16, 0.05, 0.24), draw.size(0.11, 0.035, 0.16), draw.size(0.06, 0.02, 0.11)), reverse=True
    )
    x, y, z = sides[0], min(sides[1], 0.93 * sides[0]), min(sides[2], 0.93 * sides[1])
    look = draw.look(Look((0.72, 0.55, 0.36), "label", 0.05, 0.1), looks.cardboard)
    parts = [(solids.box((x, y, z)), look)]
    if draw.chance(0.3):  # a strip of tape all round
        t = 0.0003
        parts.append((solids.box((x + t, 0.18 * y, z + t)), draw.look(look, looks.plastic)))
    return Shape(tuple(parts), times(turns(0, 2), turns(2, 2)), "box", (0.0, 0.0, 0.0))


def fruit(draw: Draw) -> Shape:
    """An apple, orange, lemon, pear or banana."""
    kind = draw.pick("apple", "orange", "lemon", "pear", "banana")
    stem_look = draw.look(Look((0.30, 0.20, 0.10)), looks.wood)
    if kind == "banana":
        return _banana(draw)
    r = draw.size(0.038, 0.030, 0.046)
    angles = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 15)
    ring, height = np.cos(angles), np.sin(angles)
    group = turns(2, STEP)
    if kind == "orange":
        tall = draw.size(0.95, 0.88, 1.04)
        profile = [(tall * r * z, r * c) for c, z in zip(ring, height, strict=True)]
        parts = [(lathe(profile, axis=2, sides=STEP), draw.look(Look((0.95, 0.50, 0.08), "speckle"), looks.peel))]
        return Shape(tuple(parts), times(group, turns(0, 2)), kind, (0.0, 0.0, 0.0))
    if kind == "lemon":
        r *= 0.75
        tall = draw.size(1.25, 1.15, 1.4)
        profile = [(tall * r * z * (1.0 + 0.16 * abs(z) ** 6), r * c) for c, z in zip(ring, height, strict=True)]
        parts = [(lathe(profile, axis=2, sides=STEP), draw.look(Look((0.95, 0.85, 0.15), "speckle"), looks.peel))]
        return Shape(tuple(parts), times(group, turns(0, 2)), kind, (0.0, 0.0, 0.0))
    if kind == "pear":
        tall, neck = draw.size(1.35, 1.2, 1.55), draw.size(0.5, 0.42, 0.6)
        shape = [
            (tall * r * z, r * c * (1.0 - (1.0 - neck) * max(0.0, 0.5 * (z + 0.6)) ** 1.5))
            for c, z in zip(ring, height, strict=True)
        ]
        look = draw.look(Look((0.70, 0.75, 0.25), "cloud"), looks.peel)
        top = tall * r
    else:
        dip, tall = draw.size(0.28, 0.15, 0.35), draw.size(0.92, 0.8, 1.05)
        shape = [
            (tall * r * (z - dip * np.exp(-((c / 0.32) ** 2)) * np.sign(z)), r * c * (1.0 + 0.07 * z))
            for c, z in zip(ring, height, strict=True)
        ]
        look = draw.look(Look((0.75, 0.12, 0.10), "cloud"), looks.peel)
        top = tall * r * (1.0 - dip)
    parts = [(lathe(shape, axis=2, sides=STEP), look)]
    if kind == "apple" or not draw.chance(0.3):
        stem = lathe([(top - 0.004, 0.0015), (top + draw.size(0.016, 0.008, 0.022), 0.002)], axis=2, sides=STEP)
        parts.append((stem, stem_look))
    return Shape(tuple(parts), group, kind, (0.0, 0.0, None))


def _banana(draw: Draw) -> Shape:
    half, bend, r = draw.size(0.09, 0.07, 0.11), draw.size(0.045, 0.02, 0.06), draw.size(0.017, 0.014, 0.020)
    t = np.linspace(-1.0, 1.0, 13)
    line = np.column_stack([bend * t**2, half * t, np.zeros(13)])  # in the x-y plane, turned below: y along the core
    wide = np.interp(t, [-1.0, -0.93, -0.75, -0.3, 0.4, 0.75, 0.88, 1.0], [0.3, 0.55, 0.85, 1.0, 1.0, 0.75, 0.35, 0.25])
    body = tube(line, np.column_stack([r * wide, r * wide]), sides=draw.pick(10, 7, 6))
    stand = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # x → y, y → z, z → x
    look = draw.look(Look((0.92, 0.80, 0.20), "cloud"), looks.peel)
    return Shape(((body.moved(rotation=stand), look),), only(), "banana")


def crawler(draw: Draw) -> Shape:
    """The inspection robot of `aerograsp_env.sim.objects.crawler`: one shape, a third of a turn leaves it the same."""
    drive, shell, handle = ((0.10, 0.10, 0.11), (0.18, 0.20, 0.24), (0.90, 0.62, 0.08))
    parts = tuple(
        (solid, draw.look(looks.painted(color), functools.partial(looks.painted, color)))
        for solid, color in zip(_crawler_pieces(), (drive, shell, handle), strict=True)
    )
    return Shape(parts, turns(2, 3), "crawler", (0.0, 0.0, None))


@functools.cache
def _crawler_pieces() -> tuple[Solid, ...]:
    """Drives, shell and handles, by where their pieces are."""
    groups: list[list[manifold3d.Manifold]] = [[], [], []]
    for piece in pipe_crawler().pieces:
        groups[_group(piece.vertices)].append(solids.manifold_of(Solid(piece.vertices, piece.faces)))
    return tuple(solids.solid_of(manifold3d.Manifold.batch_boolean(group, manifold3d.OpType.Add)) for group in groups)


def _group(vertices: np.ndarray) -> int:
    if vertices[:, 2].min() < 0.002:
        return 0
    return 2 if vertices[:, 2].max() > 0.1155 or np.linalg.norm(vertices[:, :2], axis=1).min() > 0.128 else 1
