"""What surfaces look like: metals, plastics, rubber, wood, cloth, and how one is drawn at random."""

from __future__ import annotations

import colorsys
from collections.abc import Callable
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
    material: str = "plastic"  # one of `MATERIALS`: what another look of the same part is drawn from


STEEL = Look((0.62, 0.63, 0.65), None, 0.6, 0.6, 0, "metal")
BLACK = Look((0.10, 0.10, 0.11), None, 0.3, 0.4)
RUBBER = Look((0.09, 0.09, 0.10), None, 0.05, 0.1, 0, "rubber")
WOOD = Look((0.72, 0.53, 0.33), "wood", 0.1, 0.2, 0, "wood")

_HUES = (0.0, 0.0, 0.02, 0.06, 0.09, 0.14, 0.15, 0.33, 0.48, 0.58, 0.61, 0.63, 0.75)  # what handles are dyed with


def metal(rng: np.random.Generator) -> Look:
    """Chrome, brushed or satin steel, black oxide, rust, brass or paint."""
    return _metal(rng)._replace(material="metal")


def _metal(rng: np.random.Generator) -> Look:
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
        return plastic(rng)._replace(specular=0.05, material="rubber")
    texture = str(rng.choice(["ribs", "speckle", "cloud"])) if rng.random() < 0.5 else None
    return Look(_tint(rng, rng.uniform(0.03, 0.16), 0.02), texture, float(rng.uniform(0.0, 0.2)), 0.15, seed, "rubber")


def wood(rng: np.random.Generator) -> Look:
    """Ash, hickory, beech; sometimes stained or painted over."""
    value = rng.uniform(0.35, 0.92)
    color = colorsys.hsv_to_rgb(rng.uniform(0.05, 0.12), rng.uniform(0.25, 0.72), value)
    gloss = float(rng.uniform(0.0, 0.4)), float(rng.uniform(0.1, 0.5))
    return Look(color, "wood", *gloss, int(rng.integers(2**31)), "wood")


def printed(rng: np.random.Generator) -> Look:
    """Packaging with a label."""
    texture = str(rng.choice(["label", "label", "stripes", "cloud", "photo"])) if rng.random() < 0.9 else None
    return plastic(rng)._replace(texture=texture, specular=float(rng.uniform(0.0, 0.5)), material="printed")


def cardboard(rng: np.random.Generator) -> Look:
    """Brown or printed board."""
    if rng.random() < 0.5:
        return printed(rng)._replace(material="cardboard")
    value = float(rng.uniform(0.5, 0.9))
    color = (value, value * float(rng.uniform(0.7, 0.85)), value * float(rng.uniform(0.45, 0.65)))
    return Look(color, str(rng.choice(["cloud", "label", "ribs"])), 0.02, 0.1, int(rng.integers(2**31)), "cardboard")


def aluminium(rng: np.random.Generator) -> Look:
    """Of cans."""
    grey = rng.uniform(0.55, 0.9)
    return Look(_tint(rng, grey, 0.02), "cloud", 0.5, 0.6, int(rng.integers(2**31)), "aluminium")


def peel(rng: np.random.Generator) -> Look:
    """The skin of a fruit: red, orange, yellow or green."""
    color = colorsys.hsv_to_rgb(rng.uniform(-0.04, 0.30) % 1.0, rng.uniform(0.55, 0.95), rng.uniform(0.5, 1.0))
    gloss = float(rng.uniform(0.0, 0.4)), float(rng.uniform(0.2, 0.6))
    return Look(color, str(rng.choice(["cloud", "speckle"])), *gloss, int(rng.integers(2**31)), "peel")


def any_look(rng: np.random.Generator) -> Look:
    """Anything at all: of distractors and packaging."""
    maker = (metal, plastic, plastic, wood)[int(rng.integers(4))]
    return maker(rng)


def painted(rgb: Color, rng: np.random.Generator | None = None) -> Look:
    """A given colour, varied a little."""
    if rng is None:
        return Look(rgb, None, 0.2, 0.3, 0, "painted")
    r, g, b = np.clip(np.asarray(rgb) * rng.uniform(0.75, 1.25) + rng.normal(0.0, 0.03, 3), 0.02, 1.0)
    texture = "cloud" if rng.random() < 0.5 else None
    return Look((float(r), float(g), float(b)), texture, 0.2, 0.3, int(rng.integers(2**31)), "painted")


MATERIALS: dict[str, Callable[[np.random.Generator], Look]] = {
    maker.__name__: maker for maker in (metal, plastic, rubber, wood, printed, cardboard, aluminium, peel)
}


def another(look: Look, rng: np.random.Generator) -> Look:
    """Another look of the same material."""
    return painted(look.rgb, rng) if look.material == "painted" else MATERIALS[look.material](rng)


def _tint(rng: np.random.Generator, grey: float, spread: float) -> Color:
    r, g, b = np.clip(grey + rng.normal(0.0, spread, 3), 0.0, 1.0)
    return float(r), float(g), float(b)
