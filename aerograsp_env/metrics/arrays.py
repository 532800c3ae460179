"""Arrays as metrics take them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.spatial import as_array

Array = NDArray[np.float64]


def as_rows(value: ArrayLike, width: int, name: str, minimum: int = 1) -> Array:
    """`value` as a finite (N, width) float64 array with N ≥ minimum."""
    rows = as_array(value, (width,), name)
    if rows.ndim != 2 or len(rows) < minimum:
        raise ValueError(f"{name}: expected shape (N, {width}) with N ≥ {minimum}, got {rows.shape}")
    return rows
