"""Things that are in the picture but are none of the classes: bolts, tape rolls, blocks, cables, and other tools.

The other tools are there so that a detector learns more of the classes than that they are long and have a handle.
"""

from __future__ import annotations

import numpy as np

from aerograsp_env.sim.visual import looks, solids
from aerograsp_env.sim.visual.looks import Look
from aerograsp_env.sim.visual.objects import Shape, VisualObject, finish, only
from aerograsp_env.sim.visual.solids import (
    Solid,
    ellipse,
    lathe,
    plate,
    polygon,
    rectangle,
    smooth_path,
    solid_of,
    tube,
)

LABEL = "distractor"


def distractor(rng: np.random.Generator) -> VisualObject:
    """One at random, 1–20 cm large."""
    things = (_bolt, _ring, _block, _cable, _ball, _disc, _plate, _rod, _cup, _cluster)
    makers = things if rng.random() < 0.65 else (_caliper, _saw, _knife, _ratchet, _scissors, _brush, _reel)
    return finish(LABEL, makers[int(rng.integers(len(makers)))](rng))


def _shape(*parts: tuple[Solid, Look]) -> Shape:
    return Shape(parts, only(), LABEL)


def _bolt(rng: np.random.Generator) -> Shape:
    r = rng.uniform(0.003, 0.010)
    length = r * rng.uniform(3.0, 14.0)
    look = looks.metal(rng)
    head = lathe([(-1.3 * r, 1.8 * r), (0.0, 1.8 * r)], sides=int(rng.choice([6, 16])))
    return _shape((head, look), (lathe([(-0.001, r), (length, r)], sides=12), look))


def _ring(rng: np.random.Generator) -> Shape:
    """A tape roll, a washer or a nut."""
    r = rng.uniform(0.01, 0.06)
    outline = ellipse(r, r, sides=int(rng.choice([6, 24, 24])))
    hole = r * rng.uniform(0.4, 0.85)
    body = solid_of(plate(outline - ellipse(hole, hole), r * rng.uniform(0.1, 0.9)))
    return _shape((body, looks.any_look(rng)))


def _block(rng: np.random.Generator) -> Shape:
    return _shape((solids.box(rng.uniform(0.012, 0.12, 3).tolist()), looks.any_look(rng)))


def _cable(rng: np.random.Generator) -> Shape:
    length, r = rng.uniform(0.1, 0.4), rng.uniform(0.0015, 0.006)
    knots = np.column_stack([np.linspace(-0.5, 0.5, 7) * length, rng.normal(0.0, 0.12 * length, 7), np.zeros(7)])
    path = smooth_path(knots, 24)
    return _shape((tube(path, np.full((24, 2), r), sides=8), looks.any_look(rng)))


def _ball(rng: np.random.Generator) -> Shape:
    r, angles = rng.uniform(0.01, 0.04), np.linspace(-0.5 * np.pi, 0.5 * np.pi, 9)
    profile = np.column_stack([r * np.sin(angles) * rng.uniform(0.5, 1.5), r * np.cos(angles)])
    return _shape((lathe(profile, sides=16), looks.any_look(rng)))


def _disc(rng: np.random.Generator) -> Shape:
    r = rng.uniform(0.012, 0.07)
    height = r * rng.uniform(0.15, 1.2)
    return _shape((lathe([(0.0, r), (height, r * rng.uniform(0.6, 1.0))], axis=2), looks.any_look(rng)))


def _plate(rng: np.random.Generator) -> Shape:
    """A sheet: paper, a card, a book."""
    x, y = rng.uniform(0.04, 0.25, 2)
    return _shape((solids.box((x, y, rng.uniform(0.001, 0.03))), looks.cardboard(rng)))


def _rod(rng: np.random.Generator) -> Shape:
    """A pen, a chisel, a knife: long and thin, of two colours."""
    length, r = rng.uniform(0.08, 0.30), rng.uniform(0.003, 0.014)
    split = rng.uniform(0.2, 0.8) * length
    flat = rng.uniform(0.2, 1.0)
    path = np.column_stack([np.linspace(0.0, split, 4), np.zeros((4, 2))])
    first = tube(path, np.full((4, 2), r) * (1.0, flat), roundness=float(rng.choice([0.5, 1.0])))
    path = np.column_stack([np.linspace(split, length, 4), np.zeros((4, 2))])
    end = np.linspace(rng.uniform(0.4, 1.0), rng.uniform(0.1, 1.0), 4)[:, None] * r * np.array([1.0, 0.5 * flat])
    return _shape((first, looks.any_look(rng)), (tube(path, end, roundness=0.6), looks.metal(rng)))


def _cup(rng: np.random.Generator) -> Shape:
    r = rng.uniform(0.025, 0.045)
    h, lip = r * rng.uniform(1.0, 3.0), rng.uniform(0.8, 1.3)
    look = looks.any_look(rng)
    return _shape((lathe([(0.0, r), (h, lip * r), (h, 0.9 * lip * r), (0.1 * h, 0.85 * r)], axis=2), look))


def _cluster(rng: np.random.Generator) -> Shape:
    """Blocks and cylinders stuck together at random: a shape with no name."""
    parts: list[tuple[Solid, Look]] = []
    for _ in range(int(rng.integers(2, 5))):
        at = rng.normal(0.0, 0.02, 3)
        if rng.random() < 0.5:
            solid = solids.box(rng.uniform(0.008, 0.08, 3).tolist(), at)
        else:
            r, axis = rng.uniform(0.004, 0.025), int(rng.integers(3))
            solid = lathe([(0.0, r), (rng.uniform(0.02, 0.12), r)], axis=axis, sides=14).moved(at)
        parts.append((solid, looks.any_look(rng)))
    return _shape(*parts)


def _caliper(rng: np.random.Generator) -> Shape:
    long, thick = rng.uniform(0.15, 0.28), rng.uniform(0.003, 0.006)
    bar, jaw, at = rng.uniform(0.010, 0.016), rng.uniform(0.03, 0.06), rng.uniform(0.02, 0.6) * long
    fixed = polygon([(0.0, 0.02), (0.012, bar), (0.02, -jaw), (-0.012, -0.25 * jaw)])
    slider = rectangle(at, at + 0.05, -0.006, bar + 0.006) + polygon([(at, 0.0), (at - 0.002, -jaw), (at + 0.03, 0.0)])
    look = looks.metal(rng)
    body = solid_of(plate(rectangle(0.0, long, 0.0, bar) + fixed, thick))
    return _shape(
        (body, look), (solid_of(plate(slider, 2.0 * thick)), look if rng.random() < 0.5 else looks.any_look(rng))
    )


def _saw(rng: np.random.Generator) -> Shape:
    """A hacksaw, or a handsaw."""
    long, high = rng.uniform(0.22, 0.36), rng.uniform(0.06, 0.10)
    steel, grip = looks.metal(rng), looks.plastic(rng) if rng.random() < 0.6 else looks.wood(rng)
    hand = ellipse(0.045, 0.055, (-0.04, 0.02)) - ellipse(0.022, 0.034, (-0.045, 0.02))
    handle = solid_of(plate(hand, rng.uniform(0.014, 0.024)))
    if rng.random() < 0.5:
        blade = polygon([(-0.02, 0.0), (long, 0.0), (long, 0.25 * high), (-0.02, high)])
        return _shape((solid_of(plate(blade, 0.0015)), steel), (handle, grip))
    r = rng.uniform(0.004, 0.007)
    line = smooth_path(
        [(0.0, 0.01, 0.0), (0.01, high, 0.0), (0.5 * long, 1.05 * high, 0.0), (long, high, 0.0), (long, 0.0, 0.0)], 16
    )
    frame = tube(line, np.full((16, 2), r), sides=8)
    return _shape(
        (frame, looks.any_look(rng)),
        (solids.box((long, 0.012, 0.001), (0.5 * long, 0.004, 0.0)), steel),
        (handle, grip),
    )


def _knife(rng: np.random.Generator) -> Shape:
    """A utility knife."""
    long, wide = rng.uniform(0.12, 0.17), rng.uniform(0.010, 0.016)
    path = smooth_path([(0.0, 0.0, 0.0), (0.4 * long, 0.004, 0.0), (long, 0.0, 0.0)], 8)
    size = np.column_stack([np.linspace(1.1, 0.8, 8) * wide, np.full(8, 0.6 * wide)])
    blade = polygon(
        [(long - 0.01, -0.6 * wide), (long + 0.02, -0.6 * wide), (long + 0.035, 0.5 * wide), (long - 0.01, 0.5 * wide)]
    )
    slot = solids.box((0.5 * long, 0.5 * wide, 1.3 * wide), (0.5 * long, 0.0, 0.0))
    return _shape(
        (tube(path, size, roundness=0.6), looks.plastic(rng)),
        (slot, looks.any_look(rng)),
        (solid_of(plate(blade, 0.0012)), looks.metal(rng)),
    )


def _ratchet(rng: np.random.Generator) -> Shape:
    """A ratchet handle with a socket."""
    long, r = rng.uniform(0.14, 0.26), rng.uniform(0.005, 0.009)
    steel = looks.metal(rng)
    head = rng.uniform(2.2, 3.2) * r
    bar = lathe([(0.0, 1.8 * r), (0.4 * long, 1.7 * r), (0.45 * long, r), (long, r)], sides=16)
    disc = lathe([(-1.4 * r, head), (1.4 * r, head)], axis=2).moved((long, 0.0, 0.0))
    socket = lathe([(1.2 * r, 0.7 * head), (1.4 * r + rng.uniform(0.005, 0.03), 0.8 * head)], axis=2).moved(
        (long, 0.0, 0.0)
    )
    return _shape((bar, steel if rng.random() < 0.5 else looks.plastic(rng)), (disc, steel), (socket, steel))


def _scissors(rng: np.random.Generator) -> Shape:
    long, half = rng.uniform(0.08, 0.13), rng.uniform(0.05, 0.35)
    blade = polygon([(-0.02, -0.006), (0.0, -0.008), (long, 0.0), (0.0, 0.006), (-0.02, 0.006)])
    ring = ellipse(0.032, 0.02, (-0.055, 0.018)) - ellipse(0.022, 0.012, (-0.055, 0.018))
    parts: list[tuple[Solid, Look]] = []
    steel, grip = looks.metal(rng), looks.plastic(rng)
    for side in (1.0, -1.0):
        turn = 0.5 * half * side
        R = np.array([[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]])
        flip = np.diag([1.0, side, side])
        parts.append((solid_of(plate(blade, 0.003)).moved((0.0, 0.0, 0.0015 * side), R @ flip), steel))
        parts.append((solid_of(plate(ring, 0.008)).moved(rotation=R @ flip), grip))
    return _shape(*parts)


def _brush(rng: np.random.Generator) -> Shape:
    """A paint brush, a chisel or a file: a handle and something flat."""
    long, r = rng.uniform(0.09, 0.15), rng.uniform(0.008, 0.014)
    wide, ahead = rng.uniform(0.008, 0.035), rng.uniform(0.05, 0.14)
    grip = looks.wood(rng) if rng.random() < 0.5 else looks.plastic(rng)
    handle = lathe([(0.0, 0.7 * r), (0.1 * long, r), (0.5 * long, 0.8 * r), (0.8 * long, r), (long, 0.7 * r)], sides=16)
    flat = solids.box((ahead, 2.0 * wide, rng.uniform(0.003, 0.014)), (long + 0.45 * ahead, 0.0, 0.0))
    return _shape((handle, grip), (flat, looks.any_look(rng)))


def _reel(rng: np.random.Generator) -> Shape:
    """A tape measure."""
    r, thick = rng.uniform(0.025, 0.04), rng.uniform(0.02, 0.035)
    case = solid_of(plate(ellipse(r, r) + rectangle(0.0, 1.1 * r, -r, 0.3 * r), thick, 0.002))
    spot = lathe([(-0.52 * thick, 0.6 * r), (0.52 * thick, 0.6 * r)], axis=2)
    tongue = solids.box((rng.uniform(0.01, 0.12), 0.001, 0.6 * thick), (1.1 * r, -0.95 * r, 0.0))
    return _shape((case, looks.plastic(rng)), (spot, looks.plastic(rng)), (tongue, looks.any_look(rng)))
