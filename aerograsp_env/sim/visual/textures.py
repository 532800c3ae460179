"""Procedural textures: images (S, S, 3) uint8 sRGB from a base colour and a seed.

They need not look real; together they must be so varied that a real surface is one more of them (Tobin et al. 2017,
"Domain randomization for transferring deep neural networks from simulation to the real world").
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Image = NDArray[np.float32]  # (S, S, 3) or (S, S), about 0 … 1
RNG = np.random.Generator


@functools.cache
def _frequencies(size: int) -> Image:
    fx, fy = np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)[None]
    return np.maximum(np.hypot(fx, fy), 1.0 / size).astype(np.float32)


def noise(size: int, rng: RNG, slope: float = 1.0, channels: int = 1) -> Image:
    """Tiling noise (S, S, channels) of mean 0 and deviation 1 with a spectrum 1/f^slope; natural images are near 1."""
    shape = (channels, size, size // 2 + 1)
    phases = np.exp(2j * np.pi * rng.random(shape, dtype=np.float32)).astype(np.complex64)
    image = np.fft.irfft2(phases / _frequencies(size) ** slope, s=(size, size)).astype(np.float32)
    image -= image.mean(axis=(1, 2), keepdims=True)
    image /= image.std(axis=(1, 2), keepdims=True) + 1e-9
    return np.moveaxis(image, 0, -1)


def _shade(color: NDArray[Any], amount: NDArray[Any]) -> Image:
    """The colour made darker or lighter by factors (S, S, 1)."""
    return color * np.clip(1.0 + amount, 0.0, 3.0)


def _grid(size: int) -> tuple[Image, Image]:
    line = (np.arange(size, dtype=np.float32) + 0.5) / size
    return np.meshgrid(line, line)


def _other(color: Image, rng: RNG, far: float = 1.0) -> Image:
    """A second colour, up to `far` away."""
    return np.clip(color + far * (rng.random(3) - color), 0.0, 1.0).astype(np.float32)


def cloud(color: Image, rng: RNG, size: int) -> Image:
    return _shade(color, rng.uniform(0.03, 0.25) * noise(size, rng, rng.uniform(0.6, 1.8)))


def speckle(color: Image, rng: RNG, size: int) -> Image:
    grain = noise(size, rng, rng.uniform(-0.2, 0.5))
    spots = (grain > rng.uniform(1.0, 2.5)).astype(np.float32)
    return _shade(color, 0.08 * grain) * (1.0 - spots) + spots * _other(color, rng)


def brushed(color: Image, rng: RNG, size: int) -> Image:
    lines = noise(size, rng, 0.3)[:, :1]
    return _shade(color, rng.uniform(0.05, 0.2) * (lines + 0.4 * noise(size, rng, 1.0)))


def chrome(color: Image, rng: RNG, size: int) -> Image:
    """What polished metal mirrors: soft bright and dark bands."""
    x, y = _grid(size)
    angle = rng.uniform(0.0, np.pi)
    bands = np.zeros_like(x)
    for _ in range(3):
        k = rng.integers(0, 4, 2)
        bands += np.sin(2.0 * np.pi * (k[0] * x + k[1] * y) + rng.uniform(0.0, 6.3)) * rng.uniform(0.3, 1.0)
    bands = np.tanh(rng.uniform(0.8, 3.0) * bands + np.cos(angle))[..., None]
    return _shade(color, rng.uniform(0.15, 0.5) * bands)


def rust(color: Image, rng: RNG, size: int) -> Image:
    patch = np.clip(0.5 + 0.8 * noise(size, rng, 1.3), 0.0, 1.0)
    red = np.array([0.45, 0.24, 0.12], np.float32) * rng.uniform(0.6, 1.2)
    steel = np.full(3, rng.uniform(0.25, 0.5), np.float32)
    return _shade(patch * red + (1.0 - patch) * steel, 0.15 * noise(size, rng, 0.3))


def wood(color: Image, rng: RNG, size: int) -> Image:
    """Growth rings cut along the grain, which runs along the rows."""
    _, y = _grid(size)
    bend = noise(size, rng, 2.2)[..., 0]
    ring = rng.integers(2, 9) * y + rng.uniform(0.1, 0.5) * bend + 0.03 * noise(size, rng, 1.0)[..., 0]
    grain = 0.5 + 0.5 * np.sin(2.0 * np.pi * ring)
    fine = noise(size, rng, 0.5)[:, :1, 0]
    amount = -rng.uniform(0.05, 0.4) * grain**2 + rng.uniform(0.02, 0.08) * fine
    return _shade(color, amount[..., None])


def planks(color: Image, rng: RNG, size: int) -> Image:
    image = wood(color, rng, size)
    count = int(rng.integers(2, 7))
    board = np.arange(size) * count // size
    image = image * rng.uniform(0.75, 1.15, count).astype(np.float32)[board][:, None, None]
    image[np.flatnonzero(np.diff(board, prepend=board[-1]))] *= rng.uniform(0.2, 0.7)
    return image


def cloth(color: Image, rng: RNG, size: int) -> Image:
    x, y = _grid(size)
    n = int(rng.integers(16, 60))
    weave = np.sin(2.0 * np.pi * n * x) * np.sin(2.0 * np.pi * n * y)
    folds = noise(size, rng, 2.0)
    return _shade(color, rng.uniform(0.03, 0.15) * weave[..., None] + rng.uniform(0.0, 0.15) * folds)


def stripes(color: Image, rng: RNG, size: int) -> Image:
    x, y = _grid(size)
    phase = int(rng.integers(1, 12)) * x + int(rng.integers(0, 6)) * y
    share = rng.uniform(0.2, 0.8)
    mask = ((phase % 1.0) < share)[..., None]
    return np.where(mask, color, _other(color, rng))


def ribs(color: Image, rng: RNG, size: int) -> Image:
    """Knurls or ribs: a fine dark and light wave."""
    x, y = _grid(size)
    n = int(rng.integers(6, 24))
    wave = np.sin(2.0 * np.pi * n * x) * (np.sin(2.0 * np.pi * n * y) if rng.random() < 0.4 else 1.0)
    return _shade(color, rng.uniform(0.1, 0.4) * wave[..., None])


def tiles(color: Image, rng: RNG, size: int) -> Image:
    count = int(rng.integers(2, 9))
    cell = np.arange(size) * count // size
    each = rng.uniform(0.8, 1.15, (count, count, 1)).astype(np.float32)
    image = _shade(color, 0.06 * noise(size, rng, 1.0)) * each[cell][:, cell]
    joint = np.arange(size) % max(size // count, 1) < max(1, int(0.01 * size * rng.uniform(1.0, 3.0)))
    grout = _other(color, rng) * rng.uniform(0.4, 1.0)
    image[joint], image[:, joint] = grout, grout
    return image


def checks(color: Image, rng: RNG, size: int) -> Image:
    count = 2 * int(rng.integers(1, 8))
    cell = np.arange(size) * count // size
    return np.where(((cell[:, None] + cell) % 2 == 0)[..., None], color, _other(color, rng))


def grass(color: Image, rng: RNG, size: int) -> Image:
    green = np.array([rng.uniform(0.2, 0.5), rng.uniform(0.35, 0.6), rng.uniform(0.05, 0.25)], np.float32)
    blades = noise(size, rng, 0.3, 3) * 0.25 + noise(size, rng, 1.2) * 0.2
    return green * np.clip(1.0 + blades, 0.1, 2.0)


def concrete(color: Image, rng: RNG, size: int) -> Image:
    grey = np.full(3, rng.uniform(0.35, 0.8), np.float32) + rng.normal(0.0, 0.02, 3).astype(np.float32)
    image = _shade(grey, 0.08 * noise(size, rng, 1.2) + 0.04 * noise(size, rng, 0.0))
    cracks = np.abs(noise(size, rng, 1.6)) < rng.uniform(0.0, 0.03)
    return np.where(cracks, image * 0.6, image)


def photo(color: Image, rng: RNG, size: int) -> Image:
    """Noise with the spectrum of photographs, and a few flat patches with edges."""
    image = 0.5 + rng.uniform(0.1, 0.25) * noise(size, rng, rng.uniform(0.9, 1.5), 3)
    if rng.random() < 0.6:
        image = image.mean(axis=2, keepdims=True) + 0.3 * (image - image.mean(axis=2, keepdims=True))
    image = image * (0.4 + color * rng.uniform(0.5, 1.2))
    return _patches(image, rng, int(rng.integers(0, 8)))


def label(color: Image, rng: RNG, size: int) -> Image:
    """Print: a ground colour, blocks and lines of what could be writing."""
    image = _patches(np.broadcast_to(color, (size, size, 3)).astype(np.float32).copy(), rng, int(rng.integers(1, 5)))
    ink = _other(color, rng) if rng.random() < 0.6 else np.full(3, float(rng.random() < 0.5), np.float32)
    for _ in range(int(rng.integers(1, 5))):
        height = int(rng.integers(2, max(3, size // 8)))
        row, column = int(rng.integers(0, size - height)), int(rng.integers(0, size // 2))
        while column < size - 2 and rng.random() < 0.95:
            width = int(rng.integers(1, height + 2))
            image[row : row + height, column : column + width] = ink
            if rng.random() < 0.5:
                image[row + height // 3 : row + 2 * height // 3, column : column + width] = color
            column += width + int(rng.integers(1, 4))
    return image


def _patches(image: Image, rng: RNG, count: int) -> Image:
    size = len(image)
    for _ in range(count):
        (r0, r1), (c0, c1) = np.sort(rng.integers(0, size + 1, (2, 2)), axis=1)
        image[r0:r1, c0:c1] = rng.random(3) if rng.random() < 0.7 else image[r0:r1, c0:c1] * rng.uniform(0.5, 1.5)
    return image


TEXTURES: dict[str, Callable[[Image, RNG, int], Image]] = {
    maker.__name__: maker
    for maker in (
        *(cloud, speckle, brushed, chrome, rust, wood, planks, cloth, stripes, ribs, tiles, checks, grass, concrete),
        *(photo, label),
    )
}

GROUNDS = ("cloud", "speckle", "wood", "planks", "cloth", "tiles", "checks", "grass", "concrete", "photo", "stripes")
"""Textures of floors, tables and walls."""


def texture_image(name: str, rgb: ArrayLike, seed: int, size: int = 64) -> NDArray[np.uint8]:
    """The texture (S, S, 3) sRGB.

    Raises:
        ValueError: an unknown name, or a size that is not a multiple of two.
    """
    if name not in TEXTURES:
        raise ValueError(f"texture: expected one of {', '.join(TEXTURES)}, got {name!r}")
    if size < 8 or size % 2:
        raise ValueError(f"size: expected an even number of pixels from 8, got {size}")
    color = np.asarray(rgb, dtype=np.float32)
    image = TEXTURES[name](color, np.random.default_rng(seed), size)
    return np.ascontiguousarray((255.0 * np.clip(image, 0.0, 1.0) + 0.5).astype(np.uint8))
