"""Wrenches: combination, open-ended, ring, adjustable and pipe wrenches."""

from __future__ import annotations

import math

import manifold3d
import numpy as np

from aerograsp_env.sim.visual import looks
from aerograsp_env.sim.visual.objects import Draw, Shape, only, turns
from aerograsp_env.sim.visual.solids import box, ellipse, lathe, plate, polygon, rectangle, smooth_path, solid_of, tube

KINDS = ("combination", "open", "ring", "adjustable", "pipe")


def wrench(draw: Draw) -> Shape:
    """Of one piece of steel, or with a movable jaw."""
    kind = draw.pick(*KINDS, "adjustable", "adjustable", "combination", "combination", "open")
    if kind == "adjustable":
        return _adjustable(draw)
    return _pipe(draw) if kind == "pipe" else _fixed(kind, draw)


def _fixed(kind: str, draw: Draw) -> Shape:
    length = draw.size(0.18, 0.10, 0.28)
    gap = length * draw.size(0.082, 0.06, 0.11)  # across the nut's flats
    bar = gap * draw.size(0.72, 0.55, 0.95)  # width of the handle
    thick = gap * draw.size(0.40, 0.30, 0.52)
    head = gap * draw.size(1.02, 0.92, 1.15)
    first = -0.5 * length + head * 0.9
    last = 0.5 * length - head * 0.9
    angle = draw.size(math.radians(15.0), 0.0, math.radians(24.0))
    other = gap * draw.size(0.85, 0.7, 1.0) if kind == "open" else gap
    outline = polygon([(first, -0.42 * bar), (last, -0.5 * bar), (last, 0.5 * bar), (first, 0.42 * bar)])
    holes: list[manifold3d.CrossSection] = []
    if kind == "ring":
        holes.append(_ring(last, gap, draw))
        outline = outline + ellipse(0.98 * gap * 0.85, 0.98 * gap * 0.85, (last, 0.0))
    else:
        outline = outline + _open(last, head, angle)
        holes.append(_mouth(last, gap, head, angle))
    if kind == "open":
        rest = head * other / gap
        outline = outline + _mirror(_open(-first, rest, angle))
        holes.append(_mirror(_mouth(-first, other, rest, angle)))
    else:
        collar = draw.size(0.82, 0.72, 0.92) * other
        outline = outline + ellipse(collar, collar, (first, 0.0))
        holes.append(_ring(first, other, draw))
    for hole in holes:
        outline = outline - hole
    neck = draw.size(0.75, 0.55, 1.0)
    profile = [
        (first - head, 1.15 * thick),
        (first + 0.7 * head, 1.15 * thick),
        (first + 1.6 * head, neck * thick),
        (last - 1.6 * head, neck * thick),
        (last - 0.7 * head, thick),
        (last + head, thick),
    ]
    body = plate(outline, profile, 0.08 * thick)
    if draw.chance(0.45):  # a recess on either side
        a, b, half = first + 1.7 * head, last - 1.7 * head, bar * draw.size(0.25, 0.2, 0.3)
        slot = rectangle(a, b, -half, half) + ellipse(half, half, (a, 0.0), 12) + ellipse(half, half, (b, 0.0), 12)
        for side in (-1.0, 1.0):
            body = body - slot.extrude(thick).translate((0.0, 0.0, side * 0.5 * thick * neck * 1.7 - 0.5 * thick))
    symmetries = only() if kind != "ring" else turns(0, 2)
    steel = draw.look(looks.STEEL, looks.metal)
    return Shape(((solid_of(body), steel),), symmetries, kind, (None, 0.0 if kind == "ring" else None, 0.0))


def _mirror(section: manifold3d.CrossSection) -> manifold3d.CrossSection:
    """Turned by 180°."""
    return section.rotate(180.0)


def _open(x: float, head: float, angle: float) -> manifold3d.CrossSection:
    c = (x + 0.15 * head * math.cos(angle), 0.15 * head * math.sin(angle))
    return ellipse(head, head * 0.97, c, 32)


def _mouth(x: float, gap: float, head: float, angle: float) -> manifold3d.CrossSection:
    slot = rectangle(-0.1 * gap, 3.0 * head, -0.5 * gap, 0.5 * gap) + ellipse(
        0.35 * gap, 0.5 * gap, (-0.1 * gap, 0.0), 12
    )
    return slot.rotate(math.degrees(angle)).translate(
        (x + 0.15 * head * math.cos(angle), 0.15 * head * math.sin(angle))
    )


def _ring(x: float, gap: float, draw: Draw) -> manifold3d.CrossSection:
    teeth = draw.pick(12, 6, 12)
    radius = gap * 0.5 / math.cos(math.pi / teeth) * draw.size(1.0, 0.95, 1.1)
    angles = np.arange(2 * teeth) * (np.pi / teeth)
    star = radius * np.where(np.arange(2 * teeth) % 2 == 0, 1.06, 0.94)
    return polygon(np.stack([x + star * np.cos(angles), star * np.sin(angles)], axis=1))


def _adjustable(draw: Draw) -> Shape:
    length = draw.size(0.20, 0.14, 0.30)
    w = length * draw.size(0.125, 0.105, 0.145)  # half the head's width
    thick = length * draw.size(0.055, 0.045, 0.075)
    tilt = math.degrees(draw.size(math.radians(22.5), math.radians(12.0), math.radians(26.0)))
    gap = w * draw.size(0.5, 0.02, 1.0)
    deep = w * draw.size(0.95, 0.8, 1.15)  # of the jaws
    # the head in its own frame: jaws open towards +u; the fixed jaw is at +v, the movable one slides below it
    face = 0.25 * w
    fixed = polygon(
        [
            (-1.1 * w, 0.55 * w),
            (-0.3 * w, 1.05 * w),
            (0.45 * deep, 0.98 * w),
            (deep, 0.62 * w),
            (deep, face),
            (0.0, face),
            (0.0, -0.75 * w),
            (-0.25 * w, -0.98 * w),
            (-0.9 * w, -0.8 * w),
            (-1.3 * w, -0.2 * w),
        ]
    )
    low = face - gap
    jaw = polygon(
        [
            (-0.25 * w, low - 0.28 * w),
            (0.0, low - 0.02 * w),
            (0.05 * w, low),
            (0.97 * deep, low),
            (0.97 * deep, low - 0.22 * w),
            (0.45 * deep, low - 0.62 * w),
            (-0.05 * w, low - 0.80 * w),
            (-0.25 * w, low - 0.78 * w),
        ]
    )
    window = rectangle(-0.78 * w, -0.26 * w, -0.55 * w, 0.0)
    top = 0.5 * length - deep
    start, bar, tail = -0.5 * length, w * draw.size(0.42, 0.34, 0.52), w * draw.size(0.52, 0.42, 0.62)
    neck = draw.size(0.85, 0.7, 1.0)
    handle = polygon(
        [
            (start + 0.15 * tail, -tail),
            (top - 1.4 * w, -bar * neck),
            (top - 0.4 * w, -0.55 * w),
            (top - 0.3 * w, 0.6 * w),
            (top - 1.4 * w, bar * neck),
            (start + 0.15 * tail, tail),
        ]
    ) + ellipse(0.5 * tail, tail, (start + 0.3 * tail, 0.0), 16)
    frame = fixed.rotate(tilt).translate((top, 0.0))
    body = handle + frame
    if draw.chance(0.8) or draw.pick(True):
        hole = tail * draw.size(0.5, 0.35, 0.6)
        body = body - ellipse(hole, hole, (start + 0.75 * tail, 0.0), 16)
    body = body - window.rotate(tilt).translate((top, 0.0))
    slim = draw.size(0.62, 0.5, 0.8)
    profile = [(start, slim * thick), (top - 1.6 * w, slim * thick), (top - 0.8 * w, thick), (top + deep, 0.9 * thick)]
    solid = plate(body, profile, 0.06 * thick)
    if draw.chance(0.55):  # recessed sides
        half = 0.55 * bar * neck
        slot = rectangle(start + 2.2 * tail, top - 1.7 * w, -half, half) + ellipse(
            half, half, (start + 2.2 * tail, 0.0), 12
        )
        for side in (-1.0, 1.0):
            solid = solid - slot.extrude(thick).translate((0.0, 0.0, side * 0.5 * thick * slim * 1.65 - 0.5 * thick))
    movable = plate(jaw.rotate(tilt).translate((top, 0.0)), 0.85 * thick, 0.05 * thick)
    steel = draw.look(looks.STEEL, looks.metal)
    second = steel if not draw.chance(0.3) else draw.look(steel, looks.metal)
    c, s = math.cos(math.radians(tilt)), math.sin(math.radians(tilt))
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    worm = lathe([(-0.22 * w, 0.20 * w), (0.24 * w, 0.20 * w)], axis=1, sides=12, lobes=12, depth=0.0)
    worm = worm.moved((-0.52 * w, -0.27 * w, 0.0)).moved(rotation=R).moved((top, 0.0, 0.0))
    parts = [(solid_of(solid), steel), (solid_of(movable), second), (worm, second)]
    if draw.chance(0.3):  # a dipped grip
        path = smooth_path([(start - 0.002, 0.0, 0.0), (0.5 * (start + top), 0.0, 0.0), (top - 1.7 * w, 0.0, 0.0)], 6)
        wide = np.interp(path[:, 0], [start, top - 1.7 * w], [1.12 * tail, 1.2 * bar])
        grip = tube(path, np.column_stack([wide, np.full(6, 0.75 * thick * max(slim, 0.6))]), 14, 0.7)
        parts.append((grip, draw.look(looks.RUBBER, looks.rubber)))
    return Shape(tuple(parts), only(), "adjustable", (None, None, 0.0))


def _pipe(draw: Draw) -> Shape:
    """A Stillson wrench: a hooked jaw through a frame on a long straight handle."""
    length = draw.size(0.30, 0.22, 0.40)
    w, thick = length * draw.size(0.055, 0.045, 0.065), length * draw.size(0.06, 0.05, 0.07)
    gap = w * draw.size(1.2, 0.5, 2.0)
    start, top = -0.5 * length, 0.5 * length - 2.2 * w - gap
    lower = polygon(
        [
            (start, -0.55 * w),
            (top - 1.5 * w, -0.6 * w),
            (top - 0.6 * w, -1.0 * w),
            (top, -1.0 * w),
            (top, 1.7 * w),
            (top - 0.7 * w, 1.7 * w),
            (top - 1.5 * w, 0.7 * w),
            (start, 0.7 * w),
        ]
    )
    lower = (
        lower
        + ellipse(0.5 * w, 0.8 * w, (start, 0.05 * w), 14)
        - ellipse(0.3 * w, 0.3 * w, (start + 0.3 * w, 0.05 * w), 12)
    )
    hook = polygon(
        [
            (top - 2.4 * w, -1.15 * w),
            (top - 2.4 * w, -1.8 * w),
            (top + gap + 1.4 * w, -1.8 * w),
            (top + gap + 2.0 * w, -1.2 * w),
            (top + gap + 1.2 * w, 1.6 * w),
            (top + gap + 0.2 * w, 1.9 * w),
            (top + gap, 1.6 * w),
            (top + gap, -0.6 * w),
            (top + 0.6 * gap, -1.1 * w),
        ]
    )
    paint, steel = (
        draw.look(looks.Look((0.75, 0.12, 0.08), None, 0.2, 0.3), looks.plastic),
        draw.look(looks.STEEL, looks.metal),
    )
    frame = box((1.6 * w, 3.3 * w, 1.15 * thick), (top - 1.0 * w, -0.5 * w, 0.0))
    nut = lathe([(top - 2.4 * w, 0.8 * w), (top - 1.6 * w, 0.8 * w)], sides=14).moved((0.0, -1.45 * w, 0.0))
    profile = [(start, 0.55 * thick), (top - 1.6 * w, 0.6 * thick), (top, 0.9 * thick)]
    parts = (
        (solid_of(plate(lower, profile, 0.05 * thick)), paint),
        (solid_of(plate(hook, 0.7 * thick, 0.05 * thick)), steel),
        (frame, paint),
        (nut, steel),
    )
    return Shape(parts, only(), "pipe", (None, None, 0.0))
