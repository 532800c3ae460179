"""Poses of detections: each class's nominal shape is aligned with the depth inside the detection's box."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from aerograsp_env.interfaces import RGBD, Detection
from aerograsp_env.sim.visual.objects import nominal_object
from baselines.detection import ShapeModel, pose_from_box

SURFACE_POINTS = 600
RIGID = ("crawler",)  # classes of one shape
STRETCH = 1.5  # how far the others' sides may differ from the nominal shape's, either way


@functools.cache
def shape_of(label: str) -> ShapeModel:
    """The nominal shape of a class, made once.

    Raises:
        ValueError: an unknown class.
    """
    item = nominal_object(label)
    points, normals, _ = item.surface(SURFACE_POINTS, np.random.default_rng(0))
    return ShapeModel(points, normals, item.symmetries, 1.0 if label in RIGID else STRETCH)


def posed(detections: Sequence[Detection], frame: RGBD) -> list[Detection]:
    """The detections with poses where the frame's depth shows the class's shape, and as they were elsewhere."""
    found = []
    for detection in detections:
        box = np.clip(detection.box, 0.0, np.tile([frame.intrinsics.width - 1.0, frame.intrinsics.height - 1.0], 2))
        if (box[:2] < box[2:]).all():
            pose = pose_from_box(frame, box, shape_of(detection.label))
            detection = replace(detection, T_c_object=pose.T_c_object)
        found.append(detection)
    return found
