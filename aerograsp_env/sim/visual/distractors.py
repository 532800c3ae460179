"""Things that are in the picture but are none of the classes: bolts, nuts, tape rolls, blocks, cables, balls, cups."""

from __future__ import annotations

import numpy as np

from aerograsp_env.sim.visual import looks, solids
from aerograsp_env.sim.visual.looks import Look
from aerograsp_env.sim.visual.objects import Shape, VisualObject, finish, only
from aerograsp_env.sim.visual.solids import Solid, ellipse, lathe, plate, smooth_path, solid_of, tube

LABEL = "distractor"


def distractor(rng: np.random.Generator) -> VisualObject:
    """One at random, 1–20 cm large."""
    makers = (_bolt, _ring, _block, _cable, _ball, _disc, _plate, _rod, _cup, _cluster)
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
