"""Screwdrivers: fluted, ergonomic, wooden, precision, stubby, insulated and ratchet handles; four kinds of tip."""

from __future__ import annotations

import numpy as np

from aerograsp_env.sim.visual import looks
from aerograsp_env.sim.visual.looks import Look
from aerograsp_env.sim.visual.objects import STEP, Draw, Shape, turns
from aerograsp_env.sim.visual.solids import Solid, lathe, loft

RED = Look((0.80, 0.10, 0.08), None, 0.4, 0.5)

KINDS = ("fluted", "ergonomic", "wooden", "precision", "stubby", "insulated", "bulb", "ratchet")


def screwdriver(draw: Draw) -> Shape:
    """Symmetric about its axis within 5 mm: flutes and blade are below what a depth camera resolves at a metre."""
    kind = draw.pick(*KINDS, "fluted", "ergonomic", "ergonomic", "insulated")
    small = {"precision": 0.55, "stubby": 1.0}.get(kind, 1.0)
    length = draw.size(0.105, 0.085, 0.125) * (0.8 if kind == "precision" else 0.62 if kind == "stubby" else 1.0)
    radius = draw.size(0.0145, 0.0115, 0.0185) * (0.42 if kind == "precision" else small)
    shank = draw.size(0.110, 0.055, 0.20) * (0.75 if kind == "precision" else 0.28 if kind == "stubby" else 1.0)
    rod = max(0.0016, radius * draw.size(0.24, 0.17, 0.32))
    steel = draw.look(looks.STEEL, looks.metal)
    grip, second = draw.look(RED, looks.plastic), draw.look(looks.BLACK, looks.rubber)
    parts = _handle(kind, length, radius, rod, grip, second, draw)
    sides = draw.pick(14, 14, 14, 6, 4)
    parts.append((lathe([(-0.01, rod), (shank, rod)], sides=sides), steel))
    if kind == "insulated" or draw.chance(0.05):
        cover = shank * draw.size(0.85, 0.6, 0.92)
        sleeve = draw.look(RED, looks.plastic) if draw.chance(0.4) else grip
        parts.append((lathe([(-0.005, 1.35 * rod), (cover, 1.35 * rod), (cover + 0.002, 1.0 * rod)], sides=14), sleeve))
    if draw.chance(0.2):  # a hexagonal bolster
        parts.append((lathe([(0.0, 1.7 * rod), (0.012, 1.7 * rod), (0.014, 1.3 * rod)], sides=6), steel))
    tip_look = steel if not draw.chance(0.3) else draw.look(looks.BLACK, looks.metal)
    parts.append((_tip(draw.pick("flat", "phillips", "torx", "flat", "phillips"), shank, rod, draw), tip_look))
    return Shape(tuple(parts), turns(0, STEP), kind, (None, 0.0, 0.0))


def _handle(
    kind: str, length: float, r: float, rod: float, grip: Look, second: Look, draw: Draw
) -> list[tuple[Solid, Look]]:
    """From −length to 0."""

    def line(*points: tuple[float, float]) -> list[tuple[float, float]]:
        return [(length * x, r * y) for x, y in points]

    if kind in ("fluted", "stubby", "insulated"):
        lobes, depth = draw.pick(6, 4, 8, 12, 3), draw.size(0.14, 0.04, 0.22)
        neck = draw.size(0.62, 0.45, 0.9)
        body = line((-1.0, 0.55), (-0.97, 0.85), (-0.92, 1.0), (-0.3, 1.0), (-0.22, neck), (-0.06, neck), (0.0, 0.5))
        parts = [(lathe(body, sides=36, lobes=lobes, depth=depth), grip)]
        if draw.chance(0.55):
            end = line((-1.03, 0.5), (-1.01, 0.85), (-0.93, 0.97), (-0.86, 0.97))
            parts.append((lathe(end, sides=20), second))
        if draw.chance(0.5):
            band = draw.size(0.6, 0.4, 0.7)
            parts.append((lathe(line((-band, 1.04), (-band + draw.size(0.1, 0.04, 0.3), 1.04)), sides=24), second))
        return parts
    if kind == "ergonomic":
        waist, belly = draw.size(0.68, 0.55, 0.85), draw.size(1.0, 0.9, 1.12)
        body = line(
            (-1.0, 0.6),
            (-0.96, 0.9),
            (-0.85, belly),
            (-0.6, belly),
            (-0.35, 0.85),
            (-0.2, waist),
            (-0.08, 0.9 * belly),
            (0.0, 0.6),
        )
        lobes = draw.pick(3, 0, 6, 4)
        parts = [(lathe(body, sides=24, lobes=lobes, depth=0.12 if lobes else 0.0), grip)]
        if draw.chance(0.75):  # soft zones
            a, b = -draw.size(0.8, 0.7, 0.9), -draw.size(0.4, 0.3, 0.5)
            soft = line((a, belly * 0.9), (a + 0.05, belly * 1.03), (0.5 * (a + b), belly * 1.04), (b, 0.92))
            parts.append((lathe(soft, sides=24, lobes=draw.pick(3, 6, 0), depth=0.18), second))
        if draw.chance(0.4):
            parts.append((lathe(line((-1.02, 0.5), (-1.0, 0.75), (-0.94, 0.9)), sides=18), second))
        return parts
    if kind == "wooden":
        body = line(
            (-1.0, 0.5), (-0.95, 0.9), (-0.8, 1.1), (-0.6, 1.05), (-0.35, 0.7), (-0.22, 0.65), (-0.12, 0.8), (0.0, 0.6)
        )
        look = draw.look(looks.WOOD, looks.wood)
        ferrule = lathe(line((-0.12, 0.72), (0.03, 0.62), (0.06, 0.4)), sides=18)
        return [(lathe(body, sides=20), look), (ferrule, draw.look(looks.STEEL, looks.metal))]
    if kind == "precision":
        body = line((-0.9, 0.9), (-0.86, 1.0), (-0.25, 1.0), (-0.1, 0.6), (0.0, 0.45))
        cap = line((-1.0, 0.9), (-0.97, 1.1), (-0.92, 1.1), (-0.9, 0.6), (-0.88, 0.6))
        knurl = lathe(body, sides=24, lobes=draw.pick(0, 12, 6), depth=0.08)
        return [
            (knurl, draw.look(looks.STEEL, looks.metal) if draw.chance(0.4) else grip),
            (lathe(cap, sides=16), second),
        ]
    if kind == "bulb":  # clear or painted, thick at its end
        body = line((-1.0, 0.7), (-0.95, 1.1), (-0.75, 1.25), (-0.5, 1.0), (-0.25, 0.75), (-0.1, 0.8), (0.0, 0.5))
        return [(lathe(body, sides=24, lobes=draw.pick(0, 6, 8), depth=0.1), grip)]
    # ratchet: a thick body, a ring and a chuck
    body = line((-1.0, 0.7), (-0.97, 1.1), (-0.5, 1.25), (-0.3, 1.05), (-0.2, 0.9))
    ring = line((-0.2, 1.15), (-0.08, 1.15), (-0.06, 0.8))
    chuck = line((-0.08, 0.6), (0.12, 0.55), (0.16, 0.4), (0.25, 0.4))
    return [
        (lathe(body, sides=24, lobes=draw.pick(5, 0, 8), depth=0.1), grip),
        (lathe(ring, sides=24), second),
        (lathe(chuck, sides=16), draw.look(looks.STEEL, looks.metal)),
    ]


def _tip(kind: str, start: float, rod: float, draw: Draw) -> Solid:
    """The end of the shank, beyond `start`."""
    if kind == "flat":
        flare, length = draw.size(1.2, 0.8, 1.7), rod * draw.size(5.0, 3.5, 7.0)
        rings = [(0.0, 1.0, 1.0), (0.45, flare, 0.6), (1.0, 0.95 * flare, 0.2)]
        corner = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * 0.9
        return loft(
            [
                np.column_stack(
                    [np.full(4, start - 0.001 + length * t), corner[:, 0] * rod * w, corner[:, 1] * rod * h]
                )
                for t, w, h in rings
            ]
        )
    length = rod * draw.size(4.0, 2.5, 5.0)
    profile = [(start - 0.001, rod), (start + 0.45 * length, 0.9 * rod), (start + length, 0.25 * rod)]
    if kind == "torx":
        profile[-1] = (start + length, 0.75 * rod)
    return lathe(profile, sides=16, lobes=4 if kind == "phillips" else 6, depth=0.45 if kind == "phillips" else 0.2)
