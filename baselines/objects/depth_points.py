"""The points that a depth image shows."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.interfaces import Intrinsics

FARTHEST = 50.0
"""[m] What is farther from its viewpoint (half of it) is taken to be in millimetres, unless a scale is given."""


def unproject(depth: ArrayLike, intrinsics: Intrinsics) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Points (N, 3) [m] in the camera's frame, in row order, and the pixels (H, W) that have one.

    Args:
        depth: (H, W) [m] along the optical axis; 0 or NaN where there is no return.
        intrinsics: of the camera that `depth` belongs to. Lens distortion is undone.

    Raises:
        ValueError: sizes that do not match, negative or infinite depth, millimetres, or no return at all.
    """
    z = np.asarray(depth, dtype=np.float64)
    size = (intrinsics.height, intrinsics.width)
    if z.shape != size:
        raise ValueError(f"depth: expected shape {size} as the intrinsics say, got {z.shape}")
    z = np.where(np.isnan(z), 0.0, z)
    if (z < 0.0).any() or np.isinf(z).any():
        raise ValueError("depth: expected values ≥ 0 [m], with 0 or NaN where there is no return")
    valid = z > 0.0
    if not valid.any():
        raise ValueError("depth: expected at least one return, got none")
    middle = float(np.median(z[valid]))
    if middle > FARTHEST:
        raise ValueError(f"depth: expected metres, got a median of {middle:.4g}: looks like millimetres")
    rows, columns = np.nonzero(valid)
    pixels = np.stack([columns, rows], axis=1).astype(np.float64)
    if intrinsics.distortion is not None:
        rays = cv2.undistortPoints(pixels[:, None], intrinsics.matrix, intrinsics.distortion)[:, 0]
    else:
        rays = (pixels - [intrinsics.cx, intrinsics.cy]) / [intrinsics.fx, intrinsics.fy]
    return np.concatenate([rays, np.ones((len(rays), 1))], axis=1) * z[valid][:, None], valid
