"""Checks of the clouds that this package's functions take."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.spatial import as_array

Array = NDArray[np.float64]


def check_points(value: Any, name: str = "points", least: int = 1) -> Array:
    """A cloud as an (N, 3) float64 array in C order: at least `least` points, all finite.

    Raises:
        ValueError: naming the argument, what was expected and what came.
    """
    points = as_array(value, (3,), name) if np.size(value) else np.empty((0, 3))
    if points.ndim != 2:
        raise ValueError(f"{name}: expected shape (N, 3), got {points.shape}")
    if len(points) < least:
        raise ValueError(f"{name}: expected at least {least} point{'s' * (least > 1)}, got {len(points)}")
    return np.ascontiguousarray(points)


def check_positive(value: float, name: str) -> float:
    """A finite number above zero.

    Raises:
        ValueError: naming the argument.
    """
    if not 0.0 < value < np.inf:
        raise ValueError(f"{name}: expected a positive number, got {value}")
    return float(value)


def check_colors(value: Any, count: int, name: str = "colors") -> NDArray[np.uint8]:
    """Colours (count, 3) uint8 RGB of a cloud's points.

    Raises:
        ValueError: another shape or type.
    """
    colors = np.asarray(value)
    if colors.shape != (count, 3) or colors.dtype != np.uint8:
        raise ValueError(f"{name}: expected uint8 of shape ({count}, 3), got {colors.dtype} {colors.shape}")
    return colors
