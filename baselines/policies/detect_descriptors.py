"""What a cluster of points looks like: its size on what it lies on, its outline, its relief and its colours."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from aerograsp_env.spatial import transform
from baselines.policies.detect_proposals import Proposal, level_axes

Array = NDArray[np.float64]

BINS = 6  # along the outline's longer side
LEAST_HEIGHT = 0.004  # [m] of a bounding box
LAYERS = 4  # of the heights' histogram
FEATURES = 6 + 2 * BINS + LAYERS + 3 + 9 + 6


class Description(NamedTuple):
    """A cluster in the frame of what it lies on."""

    T_c_box: Array  # (4, 4) frame of its bounding box: x along the longer side of its outline, z up; origin its middle
    extents: Array  # (3,) of that box [m]; its bottom is the support, or the lowest point of what leans
    features: Array  # (FEATURES,)


def describe(proposal: Proposal, pixel_area: float) -> Description:
    """A proposal's frame and features.

    Args:
        pixel_area: solid angle of a pixel, 1 / (fx fy) [1/px²].
    """
    points, up = proposal.points, proposal.up
    x, y = level_axes(up)
    flat = np.stack([points @ x, points @ y], axis=1)
    height = points @ up - proposal.floor
    offset = flat.mean(axis=0)
    (cx, cy), (first, second), degrees = cv2.minAreaRect((flat - offset).astype(np.float32))
    angle = np.radians(degrees) + (0.0 if first >= second else 0.5 * np.pi)
    pixel = float(np.median(points[:, 2])) * np.sqrt(pixel_area)  # points are pixels' centres, things reach to edges
    long, wide = max(first, second) + pixel, min(first, second) + pixel
    along = np.cos(angle) * x + np.sin(angle) * y
    across = np.cross(up, along)
    top = max(float(np.percentile(height, 97)), LEAST_HEIGHT)
    middle = (offset + [cx, cy]) @ np.stack([x, y]) + (proposal.floor + 0.5 * top) * up
    T_c_box = transform(np.stack([along, across, up], axis=1), middle)
    u = (points - middle) @ along / long + 0.5
    v = (points - middle) @ across / wide
    bins = np.clip((u * BINS).astype(int), 0, BINS - 1)
    widths, reliefs = np.zeros(BINS), np.zeros(BINS)
    for k in range(BINS):
        inside = bins == k
        if inside.sum() > 2:
            widths[k] = np.ptp(v[inside])
            reliefs[k] = np.percentile(height[inside], 90) / top
    if widths[: BINS // 2].sum() < widths[BINS // 2 :].sum():  # the wider end first
        widths, reliefs = widths[::-1], reliefs[::-1]
        u = 1.0 - u
    area = float((points[:, 2] ** 2).sum() * pixel_area)  # of the view, at right angles to it
    hull = float(cv2.contourArea(cv2.convexHull((flat - offset).astype(np.float32))))
    low = max(float(np.percentile(height, 3)), 0.0)
    shape = [np.log(long), np.log(wide), np.log(top), np.log(area / (long * wide)), hull / (long * wide), low / top]
    layers = np.histogram(height / top, LAYERS, (0.0, 1.0))[0] / len(points)
    centered = points - points.mean(axis=0)
    spread = np.sqrt(np.maximum(np.linalg.eigvalsh(centered.T @ centered / len(points)), 1e-10))
    colors = (_colors(proposal.colors), _ends(proposal.colors, u))
    features = np.concatenate([shape, widths, reliefs, layers, np.log(spread), *colors])
    return Description(T_c_box, np.array([long, wide, top]), features)


def _ends(rgb: NDArray[np.uint8], u: Array) -> Array:
    """(6,) saturation, brightness and their difference in colour, of the two outer thirds along the longer side."""
    hsv = cv2.cvtColor(rgb[None], cv2.COLOR_RGB2HSV_FULL)[0].astype(np.float64) / 255.0
    parts = [inside if inside.any() else np.ones(len(u), dtype=np.bool_) for inside in (u < 0.33, u > 0.67)]
    means = [np.append(hsv[part, 1:].mean(axis=0), 0.0) for part in parts]
    gap = np.linalg.norm(rgb[parts[0]].mean(axis=0) - rgb[parts[1]].mean(axis=0)) / 255.0
    return np.array([*means[0][:2], *means[1][:2], gap, abs(means[0][0] - means[1][0])])


def _colors(rgb: NDArray[np.uint8]) -> Array:
    """(9,) mean and spread of brightness and saturation, hue on the circle, and shares of yellow, red and dark."""
    hsv = cv2.cvtColor(rgb[None], cv2.COLOR_RGB2HSV_FULL)[0].astype(np.float64) / 255.0
    hue, saturation, value = 2.0 * np.pi * hsv[:, 0], hsv[:, 1], hsv[:, 2]
    vivid = saturation * value
    weight = vivid.sum() + 1e-6
    strong = vivid > 0.25
    yellow = strong & (np.abs(hsv[:, 0] - 0.13) < 0.05)
    red = strong & ((hsv[:, 0] < 0.05) | (hsv[:, 0] > 0.95))
    return np.array(
        [
            value.mean(), value.std(), saturation.mean(), saturation.std(),
            (vivid * np.cos(hue)).sum() / weight, (vivid * np.sin(hue)).sum() / weight,
            yellow.mean(), red.mean(), (value < 0.2).mean(),
        ]
    )  # fmt: skip
