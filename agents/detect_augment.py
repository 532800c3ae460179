"""Training pictures: mosaics, zooms and turns of the data set's frames, and everything that spoils a camera's picture.

One `np.random.Generator` decides all of it, so that a picture depends on nothing but its seed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from agents.detect_assign import IGNORED
from agents.detect_spoil import spoil

Rng = np.random.Generator
KEPT, SEEN = 0.45, 0.08
"""Shares of a box's area left by a cut: with less than KEPT it is ignored, with less than SEEN it is not there."""
UNITS = 8192
"""Steps of inverse depth in 1/m: whole numbers are turned and scaled several times faster than float16."""
SMALLEST = 6.0
"""Side [px] below which a box is ignored."""


class Frame(NamedTuple):
    """A picture of the data set."""

    rgb: NDArray[np.uint8]  # (H, W, 3)
    inverse: NDArray[np.int16]  # (H, W) inverse depth about its median, in steps of 1 / UNITS [1/m]
    boxes: NDArray[np.float32]  # (N, 4) xyxy [px]
    labels: NDArray[np.int64]  # (N,) classes, or IGNORED


class Frames(Protocol):
    """A data set in memory."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int) -> Frame: ...


class Example(NamedTuple):
    """A training picture."""

    image: NDArray[np.float32]  # (S, S, 4) colours in [0, 1] and inverse depth about its median [1/m]
    boxes: NDArray[np.float32]  # (M, 4) xyxy [px]
    labels: NDArray[np.int64]  # (M,)


@dataclass(frozen=True)
class Augmentation:
    """How often each change is made; 0 switches it off. Rendered pictures vary already: much of them stays as it is."""

    mosaic: float = 0.35  # four frames in one picture
    zoom: float = 0.4  # of a tile: an object fills it, as in a photograph of one
    turn: float = 0.5  # a random quarter turn and reflection
    depth_dropout: float = 0.35  # a picture without depth, so that the network also reads photographs
    color: float = 0.3
    grey: float = 0.1
    background: float = 0.03  # everything but the objects replaced by noise or an even colour
    blur: float = 0.04
    noise: float = 0.06
    jpeg: float = 0.04
    smallest_scale: float = 0.4
    largest_scale: float = 1.6

    @classmethod
    def none(cls) -> Augmentation:
        """Plain crops."""
        names = ("mosaic", "zoom", "turn", "depth_dropout", "color", "grey", "background", "blur", "noise", "jpeg")
        return cls(**dict.fromkeys(names, 0.0), smallest_scale=1.0, largest_scale=1.0)


def example(frames: Frames, index: int, size: int, settings: Augmentation, rng: Rng) -> Example:
    """A picture of `size` × `size` pixels about frame `index`.

    Args:
        frames: the data set; a mosaic takes three more frames of it.
        index: the frame.
        size: side [px].
        settings: how often what is done.
        rng: decides everything.
    """
    rgb = np.empty((size, size, 3), dtype=np.uint8)
    inverse = np.zeros((size, size), dtype=np.float32)
    boxes, labels = [], []
    mosaic = rng.random() < settings.mosaic
    cut_x, cut_y = (int(rng.uniform(0.3, 0.7) * size) for _ in range(2)) if mosaic else (size, size)
    for left, top, right, bottom in (
        (0, 0, cut_x, cut_y),
        (cut_x, 0, size, cut_y),
        (0, cut_y, cut_x, size),
        (cut_x, cut_y, size, size),
    ):
        if right <= left or bottom <= top:
            continue
        frame = frames[index]
        index = int(rng.integers(len(frames)))
        linear, shift = _placement(frame, right - left, bottom - top, settings, rng, mosaic)
        tile = (slice(top, bottom), slice(left, right))
        _draw(frame, linear, shift, rgb[tile], inverse[tile], rng)
        moved, kept = _moved(frame, linear, shift, right - left, bottom - top)
        boxes.append(moved + np.array([left, top, left, top], dtype=np.float32))
        labels.append(kept)
    all_boxes, all_labels = np.concatenate(boxes), np.concatenate(labels)
    there = all_labels != _GONE
    all_boxes, all_labels = all_boxes[there], all_labels[there]
    if rng.random() < settings.depth_dropout:
        inverse[:] = 0.0
    rgb, inverse = spoil(rgb, inverse, all_boxes, settings, rng)
    image = np.empty((size, size, 4), dtype=np.float32)
    np.multiply(rgb, np.float32(1.0 / 255.0), out=image[..., :3])
    image[..., 3] = inverse
    return Example(image, all_boxes, all_labels)


_GONE = -3


def _placement(
    frame: Frame, width: int, height: int, settings: Augmentation, rng: Rng, mosaic: bool
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The similarity q = linear · p + shift from the frame to its tile [px, corners of pixels at whole numbers]."""
    linear = np.eye(2)
    if rng.random() < settings.turn:
        linear = np.array([[1.0, 0.0], [0.0, rng.choice([-1.0, 1.0])]])
        for _ in range(rng.integers(4)):
            linear = np.array([[0.0, -1.0], [1.0, 0.0]]) @ linear
    rows, columns = frame.rgb.shape[:2]
    there = frame.boxes[frame.labels >= 0]
    low, high = np.log(settings.smallest_scale), np.log(settings.largest_scale)
    scale = float(np.exp(rng.uniform(low, high - (0.25 if mosaic and high > low + 0.25 else 0.0))))
    focus, spread = rng.uniform(0.0, 1.0, 2) * (columns, rows), 0.3
    if len(there) and rng.random() < 0.75:
        box = there[rng.integers(len(there))]
        focus = (box[:2] + box[2:]) / 2
        if rng.random() < settings.zoom:
            scale, spread = rng.uniform(0.45, 1.1) * min(width, height) / max(box[2:] - box[:2]), 0.12
    # Far zooms show nothing but the frame's own pixels and what lies around it.
    linear = linear * np.clip(scale, 0.8 * min(width / columns, height / rows), 3.0)
    target = (0.5 + rng.uniform(-spread, spread, 2)) * (width, height)
    shift = target - linear @ focus
    # No more of the tile is left empty than must be: a frame larger than it covers it, a smaller one lies within.
    corners = np.stack([shift, shift + linear @ (columns, rows)])
    room = np.array([width, height]) - (corners.max(axis=0) - corners.min(axis=0))
    low, high = np.minimum(room, 0.0), np.maximum(room, 0.0)
    return linear, shift + np.clip(corners.min(axis=0), low, high) - corners.min(axis=0)


def _draw(
    frame: Frame,
    linear: NDArray[np.float64],
    shift: NDArray[np.float64],
    rgb: NDArray[np.uint8],
    inverse: NDArray[np.float32],
    rng: Rng,
) -> None:
    """The frame into its tile; an even colour where the frame ends."""
    size = (rgb.shape[1], rgb.shape[0])
    # OpenCV's whole numbers are the centres of pixels, ours their corners.
    matrix = np.column_stack([linear, shift + linear @ [0.5, 0.5] - 0.5])
    scale = float(np.sqrt(abs(np.linalg.det(linear))))
    source: NDArray[Any] = frame.rgb
    if scale < 0.7:  # thin parts would fall between the samples
        source = cv2.blur(source, (2, 2) if scale > 0.45 else (3, 3))
    border = tuple(int(value) for value in rng.integers(0, 256, 3))
    rgb[:] = cv2.warpAffine(source, matrix, size, flags=cv2.INTER_LINEAR, borderValue=border)
    # What looks larger is nearer: 1/z grows with the scale.
    depth = cv2.warpAffine(frame.inverse, matrix, size, flags=cv2.INTER_NEAREST, borderValue=0.0)
    np.multiply(depth, np.float32(scale / UNITS), out=inverse)


def _moved(
    frame: Frame, linear: NDArray[np.float64], shift: NDArray[np.float64], width: int, height: int
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Boxes cut to the tile, and what becomes of their labels."""
    if not len(frame.boxes):
        return np.zeros((0, 4), dtype=np.float32), np.zeros(0, dtype=np.int64)
    corners = frame.boxes.reshape(-1, 2, 2).astype(np.float64) @ linear.T + shift
    whole = np.concatenate([corners.min(axis=1), corners.max(axis=1)], axis=1)
    cut = np.clip(whole, 0.0, (width, height, width, height))
    sides = cut[:, 2:] - cut[:, :2]
    share = sides.prod(axis=1) / np.maximum((whole[:, 2:] - whole[:, :2]).prod(axis=1), 1e-9)
    # A long tool that is cut across keeps its look even where little of it is left.
    labels = np.where((share < KEPT) | (sides.min(axis=1) < SMALLEST), IGNORED, frame.labels)
    labels = np.where((share < SEEN) | (sides.min(axis=1) < 1.0), _GONE, labels)
    return cut.astype(np.float32), labels.astype(np.int64)
