"""What surfaces look like: metals, plastics, rubber, wood, cloth, and how one is drawn at random."""

from __future__ import annotations

import colorsys
from typing import NamedTuple

import numpy as np

Color = tuple[float, float, float]


class Look(NamedTuple):
    """The look of a surface."""

    rgb: Color  # sRGB in [0, 1]; the texture is painted over it
    texture: str | None = None  # one of `aerograsp_env.sim.visual.textures.TEXTURES`
    specular: float = 0.2  # as in MuJoCo's materials, [0, 1]
    shininess: float = 0.3  # [0, 1]
    seed: int = 0  # of the texture


STEEL = Look((0.62, 0.63, 0.65), None, 0.6, 0.6)
BLACK = Look((0.10, 0.10, 0.11), None, 0.3, 0.4)
RUBBER = Look((0.09, 0.09, 0.10), None, 0.05, 0.1)
WOOD = Look((0.72, 0.53, 0.33), "wood", 0.1, 0.2)

_HUES = (0.0, 0.0, 0.02, 0.06, 0.09, 0.14, 0.15, 0.33, 0.48, 0.58, 0.61, 0.63, 0.75)  # what handles are dyed with


def metal(rng: np.random.Generator) -> Look:
    """Chrome, brushed or satin steel, black oxide, rust, brass or paint."""
    kind = rng.choice(6, p=(0.30, 0.26, 0.24, 0.08, 0.04, 0.08))
    seed = int(rng.integers(2**31))
    if kind == 0:
        grey = rng.uniform(0.55, 0.92)
        return Look(_tint(rng, grey, 0.02), "chrome" if rng.random() < 0.8 else None, rng.uniform(0.5, 1.0), 0.8, seed)
    if kind == 1:
        grey = rng.uniform(0.38, 0.75)
        texture = str(rng.choice(["brushed", "cloud", "speckle"]))
        return Look(_tint(rng, grey, 0.03), texture, rng.uniform(0.2, 0.7), rng.uniform(0.2, 0.6), seed)
    if kind == 2:
        grey = rng.uniform(0.05, 0.30)
        return Look(_tint(rng, grey, 0.02), str(rng.choice(["cloud", "chrome"])), rng.uniform(0.2, 0.7), 0.5, seed)
    if kind == 3:
        return Look((rng.uniform(0.3, 0.5), rng.uniform(0.2, 0.3), rng.uniform(0.12, 0.2)), "rust", 0.1, 0.2, seed)
    if kind == 4:
        return Look((0.70, 0.58, 0.32), "chrome", 0.6, 0.6, seed)
    return plastic(rng)


def plastic(rng: np.random.Generator) -> Look:
    """A dyed, black, grey or white plastic or paint."""
    seed, kind = int(rng.integers(2**31)), rng.random()
    if kind < 0.30:
        color = _tint(rng, rng.uniform(0.03, 0.18), 0.01)
    elif kind < 0.38:
        color = _tint(rng, rng.uniform(0.3, 0.95), 0.03)
    elif kind < 0.45:
        color = (float(rng.random()), float(rng.random()), float(rng.random()))
    else:
        hue = (float(rng.choice(_HUES)) + rng.normal(0.0, 0.012)) % 1.0
        color = colorsys.hsv_to_rgb(hue, rng.uniform(0.65, 1.0), rng.uniform(0.35, 1.0))
    texture = str(rng.choice(["cloud", "speckle", "ribs", "label"])) if rng.random() < 0.35 else None
    return Look(color, texture, float(rng.uniform(0.0, 0.7)), float(rng.uniform(0.1, 0.9)), seed)


def rubber(rng: np.random.Generator) -> Look:
    """Dark, dull, sometimes dyed."""
    seed = int(rng.integers(2**31))
    if rng.random() < 0.3:
        return plastic(rng)._replace(specular=0.05)
    texture = str(rng.choice(["ribs", "speckle", "cloud"])) if rng.random() < 0.5 else None
    return Look(_tint(rng, rng.uniform(0.03, 0.16), 0.02), texture, float(rng.uniform(0.0, 0.2)), 0.15, seed)


def wood(rng: np.random.Generator) -> Look:
    """Ash, hickory, beech; sometimes stained or painted over."""
    value = rng.uniform(0.35, 0.92)
    color = colorsys.hsv_to_rgb(rng.uniform(0.05, 0.12), rng.uniform(0.25, 0.72), value)
    return Look(color, "wood", float(rng.uniform(0.0, 0.4)), float(rng.uniform(0.1, 0.5)), int(rng.integers(2**31)))


def any_look(rng: np.random.Generator) -> Look:
    """Anything at all: of distractors and packaging."""
    maker = (metal, plastic, plastic, wood)[int(rng.integers(4))]
    return maker(rng)


def _tint(rng: np.random.Generator, grey: float, spread: float) -> Color:
    r, g, b = np.clip(grey + rng.normal(0.0, spread, 3), 0.0, 1.0)
    return float(r), float(g), float(b)
