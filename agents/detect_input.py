"""What every detector is fed with: colours in [0, 1] and, for RGB-D, inverse depth about its median, letterboxed."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]
GREY = 0.5
"""Of the border that letterboxing adds."""
NEAR = 2.0
"""Inverse depth [1/m] is held to this distance from its median."""


class Letterbox(NamedTuple):
    """How an image was placed into the network's input: x_input = scale · x_image + (left, top) [px]."""

    scale: float
    left: float
    top: float

    def to_image(self, boxes: NDArray, width: int, height: int) -> NDArray[np.float64]:
        """Boxes (N, 4) of the input, in the image and clipped to it [px]."""
        moved = (np.asarray(boxes, dtype=np.float64) - np.tile((self.left, self.top), 2)) / self.scale
        return np.clip(moved, 0.0, np.tile((width, height), 2))


def inverse_depth(depth: NDArray[np.floating]) -> Image:
    """(H, W) inverse depth less the median of the image's own [1/m]; 0 where there is none.

    The median makes zero mean "where most of the scene is, or unknown", so that an image without depth looks like an
    even one, and keeps the numbers small, where the short mantissa of bfloat16 is fine.
    """
    depth = np.asarray(depth, dtype=np.float32)
    known = depth > 0.0
    inverse = np.divide(1.0, depth, out=np.zeros_like(depth), where=known)
    sample, there = inverse[::3, ::3], known[::3, ::3]
    if not there.any():
        return np.zeros_like(depth)
    return np.where(known, np.clip(inverse - np.median(sample[there]), -NEAR, NEAR), 0.0).astype(np.float32)


def network_input(
    rgb: NDArray[np.uint8], depth: NDArray[np.floating] | None, size: tuple[int, int], channels: int
) -> tuple[Image, Letterbox]:
    """The input (1, channels, height, width) of one image, and where the image lies in it.

    Args:
        rgb: (H, W, 3).
        depth: (H, W) [m], 0 where there is none; None is none anywhere.
        size: (height, width) of the input [px].
        channels: 3, or 4 with inverse depth.

    Raises:
        ValueError: an image that is not (H, W, 3) uint8, or depth of another size.
    """
    if rgb.ndim != 3 or rgb.shape[2] != 3 or rgb.dtype != np.uint8 or 0 in rgb.shape:
        raise ValueError(f"rgb: expected an image (H, W, 3) of uint8, got {rgb.shape} {rgb.dtype}")
    if depth is not None and depth.shape != rgb.shape[:2]:
        raise ValueError(f"depth: expected the image's size {rgb.shape[:2]}, got {depth.shape}")
    height, width = size
    scale = min(height / rgb.shape[0], width / rgb.shape[1])
    rows, columns = max(round(rgb.shape[0] * scale), 1), max(round(rgb.shape[1] * scale), 1)
    top, left = (height - rows) // 2, (width - columns) // 2
    inside = (slice(top, top + rows), slice(left, left + columns))
    shrinks = scale < 1.0
    image = np.full((channels, height, width), GREY, dtype=np.float32)
    small = cv2.resize(rgb, (columns, rows), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)
    np.multiply(small.transpose(2, 0, 1), np.float32(1.0 / 255.0), out=image[:3, inside[0], inside[1]])
    if channels > 3:
        image[3] = 0.0
        if depth is not None:
            near = cv2.resize(inverse_depth(depth), (columns, rows), interpolation=cv2.INTER_NEAREST)
            image[3, inside[0], inside[1]] = near
    return image[None], Letterbox(scale, float(left), float(top))


def suppress(
    boxes: NDArray, scores: NDArray, threshold: float, overlap: float, limit: int = 100, classes_compete: bool = False
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Greedy suppression of boxes of one class that overlap a better one.

    Args:
        boxes: (N, 4) xyxy; scores: (N, C).
        threshold: scores below it are dropped.
        overlap: intersection over union above which the lesser box is dropped.
        limit: detections that are kept at most.
        classes_compete: suppress across classes too, so that an object has one class only.

    Returns:
        Boxes (K, 4), scores (K,) and classes (K,), best first.
    """
    cells, labels = np.nonzero(scores >= threshold)
    values = scores[cells, labels].astype(np.float64)
    order = np.argsort(-values, kind="stable")[: 10 * limit]
    cells, labels, values = cells[order], labels[order], values[order]
    found = np.asarray(boxes, dtype=np.float64)[cells]
    sized = (found[:, 2:] - found[:, :2] > 1e-3).all(axis=1)
    found, labels, values = found[sized], labels[sized], values[sized]
    corner_size = np.concatenate([found[:, :2], found[:, 2:] - found[:, :2]], axis=1)
    groups = np.zeros_like(labels) if classes_compete else labels
    kept = np.array(
        cv2.dnn.NMSBoxesBatched(
            corner_size.tolist(), values.tolist(), groups.tolist(), float(threshold) - 1e-9, float(overlap)
        ),
        dtype=np.int64,
    ).reshape(-1)
    kept = kept[np.argsort(-values[kept], kind="stable")][:limit]
    return found[kept], values[kept], labels[kept].astype(np.int64)
