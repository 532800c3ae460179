"""Hammers: claw, framing, ball-peen, cross-peen and club hammers, mallets; wooden, steel and glass-fibre handles."""

from __future__ import annotations

import numpy as np

from aerograsp_env.sim.visual import looks
from aerograsp_env.sim.visual.looks import Look
from aerograsp_env.sim.visual.objects import Draw, Shape, only, turns
from aerograsp_env.sim.visual.solids import Solid, box, lathe, loft, smooth_path, tube

KINDS = ("claw", "framing", "ball-peen", "cross-peen", "club", "mallet", "wooden-mallet")

Parts = list[tuple[Solid, Look]]


def hammer(draw: Draw) -> Shape:
    """The head's middle is at x = 0 before it is centred, the handle runs to −x."""
    kind = draw.pick(*KINDS, "claw", "claw", "claw", "framing", "ball-peen")
    scale = draw.size(1.0, 0.8, 1.2)
    steel = draw.look(looks.STEEL, looks.metal)
    length = draw.size(0.29, 0.22, 0.37) * scale
    thick = draw.size(0.0125, 0.0105, 0.0155) * scale  # half the head's height
    head = _head(kind, thick, steel, draw)
    low = min(float(solid.vertices[:, 0].max()) for solid, _ in head[:1])
    material = draw.pick("wood", "rubber", "fibre", "steel", "wood")
    if kind == "wooden-mallet":
        material = "wood"
    doubled = kind in ("club", "mallet", "wooden-mallet")
    sway = draw.size(0.0, -0.05, 0.05) * (0.0 if doubled else 4.0 * thick)  # what is symmetric is straight
    parts = head + _handle(material, length, thick, low, sway, steel, draw)
    return Shape(tuple(parts), turns(0, 2) if doubled else only(), kind, (None, 0.0 if doubled else None, 0.0))


def _head(kind: str, t: float, steel: Look, draw: Draw) -> Parts:
    """Along y, the face towards +y; the eye at the origin comes first."""
    if kind in ("claw", "framing"):
        face = draw.size(0.058, 0.045, 0.068)
        neck = draw.size(0.62, 0.5, 0.85)
        poll = lathe(
            [
                (-0.004, 0.95 * t),
                (0.3 * face, neck * t),
                (0.62 * face, neck * t),
                (0.72 * face, 1.1 * t),
                (0.96 * face, 1.1 * t),
                (face, 0.95 * t),
            ],
            axis=1,
            sides=draw.pick(18, 8, 18),
        )
        eye = box((2.3 * t, 2.1 * t, 1.9 * t), (0.0, -0.2 * t, 0.0))
        return [(eye, steel), (poll, steel), *((prong, steel) for prong in _claws(kind, t, draw))]
    if kind == "ball-peen":
        face, back = draw.size(0.045, 0.035, 0.055), draw.size(0.042, 0.03, 0.05)
        ball = draw.size(0.95, 0.75, 1.05) * t
        angles = np.linspace(0.15 * np.pi, np.pi - 0.02, 7)
        sphere = [(-back - ball * 0.2 - ball * np.cos(np.pi - a) * -1.0, ball * np.sin(a)) for a in angles][::-1]
        body = lathe(
            [
                *sphere,
                (-0.75 * back, 0.55 * t),
                (-0.4 * back, 0.95 * t),
                (0.3 * face, 0.95 * t),
                (0.5 * face, 0.7 * t),
                (0.68 * face, 1.1 * t),
                (0.95 * face, 1.1 * t),
                (face, 1.0 * t),
            ],
            axis=1,
            sides=20,
        )
        return [(body, steel)]
    if kind == "cross-peen":
        face, back = draw.size(0.052, 0.04, 0.06), draw.size(0.058, 0.045, 0.07)
        square = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * 1.0
        drop = draw.size(0.0, -0.5, 0.3)
        rings = [
            np.column_stack([square[:, 0] * t * wx + t * dx, np.full(4, y), square[:, 1] * t * wz])
            for y, wx, wz, dx in (
                (-back, 0.18, 0.9, drop),
                (-0.3 * back, 0.95, 1.0, 0.0),
                (0.55 * face, 1.0, 1.0, 0.0),
                (face, 0.95, 0.95, 0.0),
            )
        ]
        return [(loft(rings), steel)]
    half = draw.size(0.048, 0.038, 0.06)
    if kind == "club":
        r = 1.5 * t
        return [
            (
                lathe(
                    [(-half, 0.85 * r), (-0.85 * half, r), (0.85 * half, r), (half, 0.85 * r)],
                    axis=1,
                    sides=draw.pick(8, 8, 20),
                ),
                steel,
            )
        ]
    if kind == "mallet":
        r = draw.size(2.2, 1.8, 2.9) * t
        look = draw.look(looks.RUBBER, looks.rubber)
        body = lathe([(-half, 0.88 * r), (-0.93 * half, r), (0.93 * half, r), (half, 0.88 * r)], axis=1, sides=24)
        parts = [(body, look)]
        if draw.chance(0.4):  # a two-faced one
            cap = lathe([(0.6 * half, 1.01 * r), (0.95 * half, 1.01 * r), (1.02 * half, 0.85 * r)], axis=1, sides=24)
            other = Solid(cap.vertices * (1.0, -1.0, 1.0), cap.faces[:, ::-1])
            parts += [(cap, draw.look(look, looks.plastic)), (other, draw.look(look, looks.plastic))]
        return parts
    big, slope = draw.size(0.030, 0.024, 0.036), draw.size(0.92, 0.85, 1.0)
    square = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    half *= 1.3
    rings = [
        np.column_stack([square[:, 0] * big, np.full(4, y), square[:, 1] * big * w])
        for y, w in ((-half, slope), (0.0, 1.0), (half, slope))
    ]
    return [(loft(rings), draw.look(looks.WOOD, looks.wood))]


def _claws(kind: str, t: float, draw: Draw) -> list[Solid]:
    """Two prongs that leave the eye towards −y and bend down to the handle, a slit between them."""
    reach = draw.size(0.062, 0.052, 0.075)
    bend = draw.size(0.030, 0.022, 0.042) if kind == "claw" else draw.size(0.010, 0.003, 0.016)
    spread = draw.size(1.0, 0.8, 1.25)
    shape = [
        (0.25 * t, 0.6 * t),
        (0.35 * t, -0.25 * reach),
        (0.15 * t, -0.6 * reach),
        (-0.45 * bend, -0.87 * reach),
        (-bend, -reach),
    ]
    path = smooth_path(shape, 9)
    share = np.linspace(0.0, 1.0, 9)
    offset = (0.42 + 0.38 * share * spread) * t
    wide = (0.46 - 0.08 * share) * t * spread
    tall = np.interp(share, [0.0, 0.3, 1.0], [0.95, 0.62, 0.10]) * t
    prongs = []
    for side in (-1.0, 1.0):
        line = np.column_stack([path, side * offset])
        prongs.append(tube(line, np.column_stack([tall, wide]), sides=8, roundness=0.6))
    return prongs


def _handle(material: str, length: float, t: float, top: float, sway: float, steel: Look, draw: Draw) -> Parts:
    wide, thin = draw.size(1.15, 0.95, 1.35) * t, draw.size(0.80, 0.68, 0.95) * t
    end = draw.size(1.2, 1.05, 1.4)

    def bar(points: list[tuple[float, float, float]], roundness: float = 0.9, count: int = 12) -> Solid:
        line = smooth_path(np.array(points), count)
        x = line[:, 0]
        path = np.column_stack([x, sway * np.sin(np.pi * x / length), np.zeros(count)])
        return tube(path, line[:, 1:], sides=14, roundness=roundness)

    if material == "wood":
        look = draw.look(looks.WOOD, looks.wood) if not draw.chance(0.12) else draw.look(looks.WOOD, looks.plastic)
        waist = draw.size(0.78, 0.65, 0.95)
        body = bar(
            [
                (top + 0.003, 0.9 * t, 0.7 * t),
                (-1.2 * t, 0.85 * wide, 0.9 * thin),
                (-0.4 * length, waist * wide, waist * thin),
                (-0.8 * length, wide, thin),
                (-0.96 * length, end * wide, end * thin),
                (-length, 0.9 * wide, 0.8 * thin),
            ]
        )
        parts = [(body, look)]
        if draw.chance(0.15):
            grip = bar([(-0.6 * length, 1.05 * wide, 1.08 * thin), (-length * 1.005, 1.2 * wide, 1.15 * thin)], count=5)
            parts.append((grip, draw.look(looks.RUBBER, looks.rubber)))
        return parts
    if material == "steel":
        stem = bar(
            [(0.5 * top, 0.75 * t, 0.6 * t), (-0.5 * length, 0.55 * t, 0.45 * t), (-0.97 * length, 0.55 * t, 0.45 * t)],
            0.6,
        )
        core = (stem, steel)
    elif material == "rubber":  # a tube
        r = draw.size(0.62, 0.5, 0.7) * t
        core = (bar([(0.5 * top, r, r), (-0.97 * length, r, r)], 1.0, 5), steel)
    else:
        core = (
            bar(
                [
                    (0.8 * top, 0.8 * t, 0.7 * t),
                    (-0.2 * length, 0.72 * wide, 0.8 * thin),
                    (-0.97 * length, 0.8 * wide, 0.8 * thin),
                ],
                0.8,
            ),
            draw.look(Look((0.85, 0.65, 0.05), None, 0.3, 0.4), looks.plastic),
        )
    start = -draw.size(0.45, 0.3, 0.62) * length
    grip_look = draw.look(looks.RUBBER, looks.rubber)
    w, h = draw.size(1.0, 0.9, 1.15) * wide, draw.size(1.0, 0.95, 1.15) * thin
    grip = bar(
        [
            (start, 0.85 * w, 0.9 * h),
            (start - 0.02, w, h),
            (0.5 * (start - length), 0.85 * w, 0.92 * h),
            (-0.95 * length, w * 1.05, h),
            (-length, 1.1 * w, 0.95 * h),
        ]
    )
    parts = [core, (grip, grip_look)]
    if draw.chance(0.4):
        collar = bar([(start + 0.012, 0.95 * w, 0.95 * h), (start - 0.008, 1.05 * w, 1.05 * h)], 0.9, 4)
        parts.append((collar, draw.look(looks.BLACK, looks.plastic)))
    return parts
