"""What a colour camera makes of a picture: exposure and gain, shot and read noise, and motion blur."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.interfaces import Intrinsics
from aerograsp_env.sim.shading import LINEAR_OF_BYTE, SRGB_OF_LINEAR
from aerograsp_env.spatial import as_array

_MOST_SAMPLES = 48  # along a blurred pixel's path


@dataclass(frozen=True)
class ImageNoiseConfig:
    """A colour camera's faults. `none` has none.

    Noise is that of photon counting: a pixel of linear brightness L collects ``full_well`` · L electrons, with the
    square root of that as σ, and the read-out adds its own. The automatic gain then multiplies signal and noise, so
    that dark scenes come out bright and noisy.

    Raises:
        ValueError: a value out of its range.
    """

    exposure_time: float = 0.008  # [s] over which motion blurs
    target: float = 0.18  # mean linear brightness that the automatic gain aims at; 0: it stays at 1
    gain_range: tuple[float, float] = (0.5, 16.0)  # of the automatic gain
    exposure_sigma: float = 0.15  # [stops] by which the gain misses
    white_balance_sigma: float = 0.02  # relative, a channel
    full_well: float = 6000.0  # [electrons] at full scale with gain 1
    read_noise: float = 8.0  # [electrons]

    def __post_init__(self) -> None:
        low, high = self.gain_range
        for name, fits, expected in (
            ("exposure_time", 0.0 <= self.exposure_time <= 1.0, "0 to 1 s"),
            ("target", 0.0 <= self.target < 1.0, "0 to 1"),
            ("gain_range", 0.0 < low <= high < np.inf, "0 < low ≤ high"),
            ("exposure_sigma", 0.0 <= self.exposure_sigma <= 3.0, "0 to 3 stops"),
            ("white_balance_sigma", 0.0 <= self.white_balance_sigma <= 0.5, "0 to 0.5"),
            ("full_well", self.full_well > 0.0, "positive (math.inf: no shot noise)"),
            ("read_noise", 0.0 <= self.read_noise < np.inf, "0 or more electrons"),
        ):
            if not fits:
                raise ValueError(f"{name}: expected {expected}, got {getattr(self, name)!r}")

    @classmethod
    def none(cls) -> ImageNoiseConfig:
        """A camera without faults."""
        return cls(0.0, 0.0, (1.0, 1.0), 0.0, 0.0, np.inf, 0.0)


def noisy_image(rgb: NDArray[np.uint8], config: ImageNoiseConfig, rng: np.random.Generator) -> NDArray[np.uint8]:
    """`rgb` (H, W, 3) sRGB as the camera's sensor gives it: gain, colour balance, shot and read noise, clipping."""
    stops, balance = config.exposure_sigma * rng.standard_normal(), config.white_balance_sigma * rng.standard_normal(3)
    noise = rng.standard_normal(rgb.shape, dtype=np.float32)
    gain = 1.0
    if config.target > 0.0:
        mean = _mean(rgb, LINEAR_OF_BYTE)
        gain = float(np.clip(config.target / max(mean, 1e-6), *config.gain_range))
    gains = (gain * 2.0**stops * (1.0 + balance)).astype(np.float32)
    read = config.read_noise / config.full_well
    return _expose(rgb, noise, gains, np.float32(1.0 / config.full_well), np.float32(read * read), *_TABLES)


def motion_blur(
    rgb: NDArray[np.uint8],
    depth: NDArray[np.float32],
    intrinsics: Intrinsics,
    twist_c: ArrayLike,
    exposure_time: float,
) -> NDArray[np.uint8]:
    """`rgb` (H, W, 3) smeared by the camera's own motion while the shutter is open.

    Each pixel is the mean, in linear light, of the picture along the path that a point of the still scene at the
    pixel's depth takes through the image: Longuet-Higgins & Prazdny 1980, "The interpretation of a moving retinal
    image". The middle of the exposure is the picture itself. What stands still before the moving camera blurs, what
    moves with it blurs too, since objects' own motion is not known here.

    Args:
        depth: (H, W) [m], 0 where it is infinite.
        twist_c: (6,) the camera's velocity in its own frame: linear [m/s], angular [rad/s].
        exposure_time: [s].

    Raises:
        ValueError: a twist that is not six finite numbers, images of the wrong size, or a negative time.
    """
    twist = as_array(twist_c, (6,), "twist_c")
    expected = (intrinsics.height, intrinsics.width)
    if twist.ndim != 1 or rgb.shape != (*expected, 3) or depth.shape != expected:
        raise ValueError(
            f"rgb, depth: expected {expected} pixels and one twist_c, got {rgb.shape}, {depth.shape}, {twist.shape}"
        )
    if not 0.0 <= exposure_time < np.inf:
        raise ValueError(f"exposure_time: expected 0 or more [s], got {exposure_time!r}")
    focal = (intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy)
    return _smear(rgb, depth, focal, exposure_time * twist, *_TABLES)


_TABLES = (LINEAR_OF_BYTE, SRGB_OF_LINEAR)


@numba.njit(cache=True)
def _mean(rgb, linear):
    total = 0.0
    for value in rgb.flat:
        total += linear[value]
    return total / rgb.size


@numba.njit(cache=True, error_model="numpy")
def _expose(rgb, noise, gains, per_electron, read_variance, linear, srgb):
    out, top = np.empty_like(rgb), np.float32(len(srgb) - 1)
    for v in range(rgb.shape[0]):
        for u in range(rgb.shape[1]):
            for k in range(3):
                light = linear[rgb[v, u, k]]
                light += noise[v, u, k] * np.sqrt(light * per_electron + read_variance)
                light = min(max(light * gains[k], np.float32(0.0)), np.float32(1.0))
                out[v, u, k] = srgb[int(light * top + np.float32(0.5))]
    return out


@numba.njit(cache=True, error_model="numpy")
def _smear(rgb, depth, focal, motion, linear, srgb):
    height, width = depth.shape
    fx, fy, cx, cy = focal
    out, top = np.empty_like(rgb), len(srgb) - 1
    for v in range(height):
        y = (v - cy) / fy
        for u in range(width):
            x = (u - cx) / fx
            inverse = 1.0 / depth[v, u] if depth[v, u] > 0.0 else 0.0
            along = fx * (
                inverse * (x * motion[2] - motion[0]) + x * y * motion[3] - (1.0 + x * x) * motion[4] + y * motion[5]
            )
            down = fy * (
                inverse * (y * motion[2] - motion[1]) + (1.0 + y * y) * motion[3] - x * y * motion[4] - x * motion[5]
            )
            length = max(abs(along), abs(down))
            if length < 0.05:
                out[v, u] = rgb[v, u]
                continue
            samples = min(int(length) + 2, _MOST_SAMPLES)
            total = np.zeros(3)
            for s in range(samples):
                part = (s + 0.5) / samples - 0.5
                a = min(max(u - part * along, 0.0), width - 1.0)
                b = min(max(v - part * down, 0.0), height - 1.0)
                c0, r0 = int(a), int(b)
                c1, r1 = min(c0 + 1, width - 1), min(r0 + 1, height - 1)
                a, b = a - c0, b - r0
                for k in range(3):
                    upper = (1.0 - a) * linear[rgb[r0, c0, k]] + a * linear[rgb[r0, c1, k]]
                    lower = (1.0 - a) * linear[rgb[r1, c0, k]] + a * linear[rgb[r1, c1, k]]
                    total[k] += (1.0 - b) * upper + b * lower
            for k in range(3):
                out[v, u, k] = srgb[int(min(total[k] / samples, 1.0) * top + 0.5)]
    return out
