"""What a film says about itself: time, policy, error and wind, drawn into its frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

_INK, _PAPER, _WIND = (20, 24, 30), (255, 255, 255, 165), (20, 105, 200)


@dataclass(frozen=True)
class Readings:
    """What there is to say about a moment; None is not said."""

    time: float  # [s]
    policy: str
    error: float | None = None  # [m]
    wind: tuple[float, float] | None = None  # horizontal, towards (right, away) as the camera sees it [m/s]
    note: str = ""


def annotate(frame: NDArray[np.uint8], readings: Readings) -> NDArray[np.uint8]:
    """A copy of the frame (H, W, 3) with a panel in its upper left corner and the wind in the upper right one."""
    image = Image.fromarray(frame).convert("RGBA")
    layer = Image.new("RGBA", image.size)
    draw = ImageDraw.Draw(layer)
    size = max(round(image.height / 26), 9)
    font = ImageFont.load_default(size)
    lines = [f"{readings.policy}   {readings.time:5.1f} s"]
    if readings.error is not None:
        lines.append(f"|error| {1000.0 * readings.error:.0f} mm")
    if readings.note:
        lines.append(readings.note)
    text = "\n".join(lines)
    pad = size // 2
    box = draw.multiline_textbbox((2 * pad, 2 * pad), text, font=font)
    draw.rounded_rectangle((pad, pad, box[2] + pad, box[3] + pad), pad, fill=_PAPER)
    draw.multiline_text((2 * pad, 2 * pad), text, font=font, fill=_INK)
    if readings.wind is not None:
        _draw_wind(draw, image.width, size, readings.wind, font)
    return np.asarray(Image.alpha_composite(image, layer).convert("RGB"))


def _draw_wind(draw: ImageDraw.ImageDraw, width: int, size: int, wind: tuple[float, float], font) -> None:
    """A dial with an arrow downwind, seen from above with the camera's view upwards, and the speed below it."""
    radius, pad = 2.0 * size, size // 2
    center = np.array([width - pad - 1.4 * radius, pad + 1.2 * radius])
    label = f"wind {np.hypot(*wind):.1f} m/s"
    half = max(1.2 * radius, 0.5 * draw.textlength(label, font=font) + pad)
    center[0] = width - pad - half
    top, bottom = center[1] - 1.2 * radius, center[1] + 1.2 * radius + 1.6 * size
    draw.rounded_rectangle((center[0] - half, top, center[0] + half, bottom), pad, fill=_PAPER)
    ring = (*(center - radius).tolist(), *(center + radius).tolist())
    draw.ellipse(ring, outline=(120, 128, 138), width=max(size // 12, 1))
    speed = float(np.hypot(*wind))
    if speed > 0.05:
        along = np.array([wind[0], -wind[1]]) / speed
        across = np.array([-along[1], along[0]])
        length = radius * min(0.25 + speed / 5.0, 1.0)  # full at 3.75 m/s
        tip, tail = center + length * along, center - length * along
        neck = tip - 0.45 * radius * along
        draw.line((*tail.tolist(), *neck.tolist()), fill=_WIND, width=max(size // 4, 2))
        corners = [tip, neck + 0.24 * radius * across, neck - 0.24 * radius * across]
        draw.polygon([(float(x), float(y)) for x, y in corners], fill=_WIND)
    draw.text((center[0], bottom - 0.4 * size), label, font=font, fill=_INK, anchor="ms")
