"""Detections as actions and images as observations: the layouts of Detect-v0, and the way back.

Boxes are edges of pixels, of which the first reaches from 0 to 1; intrinsics count from the first pixel's centre.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.interfaces import RGBD, Detection, Intrinsics
from aerograsp_env.sim.actions import ActionDimension
from aerograsp_env.sim.visual import CLASSES
from aerograsp_env.spatial import Array, as_array, transform

SLOTS = 8
POSITION_SCALE = 6.0  # of a full action [m]: how far the depth camera sees
PARTS = {"presence": 1, "class": len(CLASSES), "box": 4, "position": 3, "rotation": 6}
"""What a slot of the action says, in order, and in how many entries."""
SLOT_SIZE = sum(PARTS.values())
ACTION_SIZE = SLOTS * SLOT_SIZE
SHORTEST = 1e-3  # an axis of the rotation that is shorter says nothing
LEAST_SCORE = 1e-3  # of a detection that is written: a presence of 0 would be none
_AT: dict[str, slice] = {}
for _name, _size in PARTS.items():
    _AT[_name] = slice(sum(PARTS[earlier] for earlier in _AT), sum(PARTS[earlier] for earlier in _AT) + _size)


def slot_layout() -> tuple[ActionDimension, ...]:
    """The entries of one slot."""
    names = (
        *(("presence", 1.0, "score where > 0", "none"),),
        *((f"is_{label}", 1.0, "the largest names the class", "none") for label in CLASSES),
        *((f"box_{edge}", 1.0, "image from edge to edge", "image") for edge in ("x1", "y1", "x2", "y2")),
        *((f"position_{axis}", POSITION_SCALE, "m", "camera") for axis in "xyz"),
        *((f"{column}_axis_{axis}", 1.0, "direction", "camera") for column in "xy" for axis in "xyz"),
    )
    return tuple(ActionDimension(*row) for row in names)


def action_layout() -> tuple[ActionDimension, ...]:
    """The action's dimensions, slot after slot."""
    return slot_layout() * SLOTS


def detections_to_action(detections: Sequence[Detection], intrinsics: Intrinsics) -> NDArray[np.float32]:
    """The action (184,) that reports these detections; of more than eight those with the best scores, best first.

    Scores below 0.001 become 0.001, boxes are cut at the image's edges, a detection without a pose has none in the
    action either.

    Raises:
        ValueError: a label that is not one of `CLASSES`, or a position farther than 6 m along an axis.
    """
    action = np.zeros((SLOTS, SLOT_SIZE))
    ranked = sorted(detections, key=lambda detection: -detection.score)[:SLOTS]
    for row, detection in zip(action, ranked, strict=False):
        if detection.label not in CLASSES:
            raise ValueError(f"detections: expected labels among {', '.join(CLASSES)}, got {detection.label!r}")
        row[_AT["presence"]] = max(detection.score, LEAST_SCORE)
        row[_AT["class"]] = -1.0
        row[CLASSES.index(detection.label) + 1] = 1.0
        row[_AT["box"]] = np.clip(detection.box / _half(intrinsics) - 1.0, -1.0, 1.0)
        if (T := detection.T_c_object) is not None:
            if np.abs(T[:3, 3]).max() > POSITION_SCALE:
                raise ValueError(f"detections: expected positions within ±{POSITION_SCALE} m, got {T[:3, 3].tolist()}")
            row[_AT["position"]] = T[:3, 3] / POSITION_SCALE
            row[_AT["rotation"]] = T[:3, :2].T.ravel()
    return action.ravel().astype(np.float32)


def action_to_detections(action: ArrayLike, intrinsics: Intrinsics) -> list[Detection]:
    """What an action (184,), or of any number of whole slots, reports; best score first.

    A slot holds a detection where its presence is above 0, which then is the score. The box may be given by any two
    opposite corners; one without area is no detection. The rotation is that of the two axes, made orthonormal (Zhou et
    al. 2019); axes shorter than 0.001, or parallel, are no pose. Values beyond ±1 count as ±1.

    Raises:
        ValueError: not a whole number of slots, or values that are not finite.
    """
    if np.ndim(action) != 1 or np.size(action) % SLOT_SIZE:
        raise ValueError(f"action: expected shape (n · {SLOT_SIZE},), got {np.shape(action)}")
    rows = as_array(action, (np.size(action),), "action")
    found = []
    for row in np.clip(rows.reshape(-1, SLOT_SIZE), -1.0, 1.0):
        score = float(row[_AT["presence"]][0])
        corners = (row[_AT["box"]] + 1.0) * _half(intrinsics)
        low, high = np.minimum(corners[:2], corners[2:]), np.maximum(corners[:2], corners[2:])
        if score <= 0.0 or not (low < high).all():
            continue
        label = CLASSES[int(row[_AT["class"]].argmax())]
        pose = _pose(row[_AT["position"]] * POSITION_SCALE, row[_AT["rotation"]])
        found.append(Detection(label, score, np.concatenate([low, high]), pose))
    return sorted(found, key=lambda detection: -detection.score)


def _half(intrinsics: Intrinsics) -> Array:
    return 0.5 * np.array([intrinsics.width, intrinsics.height] * 2, dtype=np.float64)


def _pose(position: Array, axes: Array) -> Array | None:
    x, y = axes[:3], axes[3:]
    if (length := np.linalg.norm(x)) < SHORTEST:
        return None
    x = x / length
    y = y - (y @ x) * x
    if (length := np.linalg.norm(y)) < SHORTEST:
        return None
    y = y / length
    return transform(np.stack([x, y, np.cross(x, y)], axis=1), position)


def observed_intrinsics(observation: Mapping[str, NDArray[Any]]) -> Intrinsics:
    """The camera of one observation (not of a batch)."""
    height, width, _ = observation["rgb"].shape
    fx, fy, cx, cy = (float(value) for value in observation["intrinsics"])
    return Intrinsics(width, height, fx, fy, cx, cy)


def observed_frame(observation: Mapping[str, NDArray[Any]], stamp: float = 0.0) -> RGBD:
    """The frame of one observation (not of a batch) with its shapes back; of sensors="rgbd" only.

    Raises:
        ValueError: an observation of a stereo camera, which has no depth.
    """
    if "depth" not in observation:
        raise ValueError("observation: expected 'depth', got an observation of sensors='stereo'")
    intrinsics = observed_intrinsics(observation)
    depth = np.asarray(observation["depth"], dtype=np.float32).reshape(intrinsics.height, intrinsics.width)
    return RGBD(np.asarray(observation["rgb"]), depth, intrinsics, stamp)
