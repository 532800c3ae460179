"""Pictures of what was detected: boxes, labels with scores, and the poses' axes, drawn by OpenCV."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.interfaces import Detection, Intrinsics
from aerograsp_env.sim.visual import CLASSES

AXIS_LENGTH = 0.06  # [m]
AXIS_COLORS = ((230, 60, 50), (60, 190, 70), (60, 110, 235))  # x red, y green, z blue
NEAREST = 0.02  # [m] in front of the camera, at which an axis is still drawn


def label_color(label: str) -> tuple[int, int, int]:
    """A colour for a class, sRGB; labels that are none of `CLASSES` are white."""
    if label not in CLASSES:
        return 255, 255, 255
    red, green, blue = colorsys.hsv_to_rgb(CLASSES.index(label) / len(CLASSES), 0.75, 1.0)
    return round(255 * red), round(255 * green), round(255 * blue)


def draw_detections(
    rgb: NDArray[np.uint8],
    detections: Sequence[Detection],
    intrinsics: Intrinsics,
    size: tuple[int, int] | None = None,
    axis_length: float = AXIS_LENGTH,
) -> NDArray[np.uint8]:
    """A copy of the image (H, W, 3), enlarged to `size` = (width, height) [px], with the detections drawn into it.

    Raises:
        ValueError: an image that is not the camera's.
    """
    import cv2

    if rgb.shape != (intrinsics.height, intrinsics.width, 3):
        raise ValueError(f"rgb: expected shape {(intrinsics.height, intrinsics.width, 3)}, got {rgb.shape}")
    width, height = size or (intrinsics.width, intrinsics.height)
    scale = np.array([width / intrinsics.width, height / intrinsics.height])
    picture = np.ascontiguousarray(cv2.resize(rgb, (width, height), interpolation=cv2.INTER_LINEAR))
    line = max(round(height / 240), 1)
    text = max(height / 720.0, 0.35)

    def pixel(edge: NDArray[np.float64]) -> tuple[int, int]:
        """The picture's nearest pixel to a place (2,) in the image, where the first pixel reaches from 0 to 1."""
        x, y = np.clip(np.asarray(edge) * scale - 0.5, -1e4, 1e4)
        return round(float(x)), round(float(y))

    for detection in detections:
        color = label_color(detection.label)
        cv2.rectangle(picture, pixel(detection.box[:2]), pixel(detection.box[2:]), color, line)
        if detection.T_c_object is not None:
            _draw_axes(picture, detection.T_c_object, intrinsics.matrix, axis_length, line, pixel)
    for detection in detections:  # words above all lines
        color = label_color(detection.label)
        words = f"{detection.label} {detection.score:.2f}"
        (wide, high), below = cv2.getTextSize(words, cv2.FONT_HERSHEY_SIMPLEX, text, line)
        x, y = pixel(detection.box[:2])
        x, y = min(max(x, 0), max(width - wide, 0)), min(max(y, high + below), height)
        cv2.rectangle(picture, (x, y - high - below), (x + wide, y), color, -1)
        cv2.putText(
            picture, words, (x, y - below // 2 - 1), cv2.FONT_HERSHEY_SIMPLEX, text, (0, 0, 0), line, cv2.LINE_AA
        )
    return picture.astype(np.uint8, copy=False)


def _draw_axes(picture, T_c_object, matrix, length, line, pixel) -> None:
    import cv2

    origin = T_c_object[:3, 3]
    for axis, color in enumerate(AXIS_COLORS):
        tip = origin + length * T_c_object[:3, axis]
        if min(origin[2], tip[2]) < NEAREST:
            continue
        start, end = (pixel((matrix @ point)[:2] / point[2] + 0.5) for point in (origin, tip))
        cv2.arrowedLine(picture, start, end, color, line + 1, cv2.LINE_AA, tipLength=0.2)
