"""What spoils a picture: colours, backgrounds, blur, sensor noise, compression."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from agents.detect_augment import Augmentation

Rng = np.random.Generator
Pixels = NDArray[Any]  # uint8; OpenCV does not say so


def spoil(
    rgb: Pixels, inverse: NDArray[np.float32], boxes: NDArray[np.float32], settings: Augmentation, rng: Rng
) -> tuple[Pixels, NDArray[np.float32]]:
    """Each change as often as `settings` say, in the order in which a camera would make them.

    Args:
        rgb: (S, S, 3); inverse: (S, S) inverse depth, changed with the background only.
        boxes: (M, 4) of everything that is to stay in sight.
    """
    if rng.random() < settings.background and len(boxes):
        rgb, inverse = _background(rgb, inverse, boxes, rng)
    if rng.random() < settings.color:
        rgb = _colors(rgb, rng)
    if rng.random() < settings.grey:
        rgb = cv2.cvtColor(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB)
    if rng.random() < settings.blur:
        rgb = _blurred(rgb, rng)
    if rng.random() < settings.noise:
        rgb = _noisy(rgb, rng)
    if rng.random() < settings.jpeg:
        quality = int(rng.integers(25, 90))
        _, code = cv2.imencode(".jpg", rgb, [cv2.IMWRITE_JPEG_QUALITY, quality])
        rgb = np.asarray(cv2.imdecode(code, cv2.IMREAD_COLOR))
    return rgb, inverse


def _background(
    rgb: Pixels, inverse: NDArray[np.float32], boxes: NDArray[np.float32], rng: Rng
) -> tuple[Pixels, NDArray[np.float32]]:
    """Noise or an even colour around the objects. Each keeps a margin of random width, faded out, so that the edge
    of what was kept says nothing of the box."""
    size = rgb.shape[0]
    keep = np.zeros((size, size), dtype=np.float32)
    for x1, y1, x2, y2 in boxes:
        margin = rng.uniform(0.05, 0.5, 4) * (x2 - x1 + y2 - y1) / 2 + 2.0
        low_x, low_y = max(int(x1 - margin[0]), 0), max(int(y1 - margin[1]), 0)
        keep[low_y : int(y2 + margin[3]) + 1, low_x : int(x2 + margin[2]) + 1] = 1.0
    soft = 2 * int(rng.integers(1, 6)) + 1
    soft_keep: NDArray[Any] = cv2.blur(keep, (soft, soft))[..., None]
    even = rng.integers(0, 256, 3) if rng.random() < 0.5 else np.full(3, rng.integers(200, 256))
    new: NDArray[Any] = np.broadcast_to(even.astype(np.float32), rgb.shape)
    if rng.random() < 0.5:
        cells = int(rng.integers(2, 40))
        coarse = rng.uniform(0.0, 255.0, (cells, cells, 3)).astype(np.float32)
        new = cv2.resize(coarse, (size, size), interpolation=cv2.INTER_LINEAR)
    mixed = new + soft_keep * (rgb - new)
    return mixed.astype(np.uint8), np.where(soft_keep[..., 0] > 0.5, inverse, 0.0).astype(np.float32)


def _colors(rgb: Pixels, rng: Rng) -> Pixels:
    """Hue, saturation, brightness, contrast and a cast of colour."""
    hue, saturation = rng.uniform(-0.08, 0.08), rng.uniform(0.4, 1.5)
    gain, offset, gamma = rng.uniform(0.7, 1.3, 3) * rng.uniform(0.7, 1.25), rng.uniform(-25, 25), rng.uniform(0.7, 1.4)
    steps = np.arange(256, dtype=np.float32)
    hsv = cv2.cvtColor(rgb, cv2.COLOR_RGB2HSV_FULL)
    tables = np.empty((1, 256, 3), dtype=np.uint8)
    tables[0, :, 0] = (steps + hue * 256.0) % 256.0
    tables[0, :, 1] = np.clip(steps * saturation, 0.0, 255.0)
    tables[0, :, 2] = steps
    rgb = cv2.cvtColor(cv2.LUT(hsv, tables), cv2.COLOR_HSV2RGB_FULL)
    light = 255.0 * (steps / 255.0) ** gamma
    tables[0] = np.clip(light[:, None] * gain + offset, 0.0, 255.0)
    return cv2.LUT(rgb, tables)


def _blurred(rgb: Pixels, rng: Rng) -> Pixels:
    """Out of focus, or along a line as the camera moves."""
    if rng.random() < 0.5:
        return cv2.GaussianBlur(rgb, (0, 0), rng.uniform(0.5, 1.8))
    length = int(rng.integers(3, 10))
    kernel = np.zeros((length, length), dtype=np.float32)
    angle = rng.uniform(0.0, np.pi)
    middle, reach = (length - 1) / 2, np.array([np.cos(angle), np.sin(angle)]) * (length - 1) / 2
    ends = [tuple(np.rint(middle + sign * reach).astype(int).tolist()) for sign in (-1.0, 1.0)]
    cv2.line(kernel, ends[0], ends[1], 1.0)
    return cv2.filter2D(rgb, -1, kernel / kernel.sum())


@lru_cache(maxsize=1)
def _normal_noise() -> NDArray[np.int16]:
    """Drawing normal numbers for every pixel would cost more than all the rest: pieces of one drawing are used."""
    drawn = np.random.default_rng(0).standard_normal(1 << 20)
    return np.rint(drawn * 64.0).astype(np.int16)


def _noisy(rgb: Pixels, rng: Rng) -> Pixels:
    """Sensor noise, of one strength a picture."""
    pool = _normal_noise()
    start = int(rng.integers(len(pool) - rgb.size)) if rgb.size < len(pool) else 0
    grain = np.resize(pool[start:], rgb.shape) if rgb.size > len(pool) else pool[start : start + rgb.size]
    strength = int(rng.integers(2, 15))
    return np.clip(rgb + (grain.reshape(rgb.shape) * strength >> 6), 0, 255).astype(np.uint8)
