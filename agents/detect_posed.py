"""Poses of detections: each class's nominal shape is aligned with the depth inside the detection's box."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from aerograsp_env.interfaces import RGBD, Detection
from aerograsp_env.sim.visual.objects import nominal_object
from aerograsp_env.spatial import Array, inverse
from baselines.detection import BoxPose, PoseTrack, PoseTracker, ShapeModel, pose_from_box

SURFACE_POINTS = 600
RIGID = ("crawler",)  # classes of one shape
STRETCH = 1.5  # how far the others' sides may differ from the nominal shape's, either way
LEAST_FIT = 0.3
"""Share of a cloud that must lie on the model, and of the model that must be seen: less is no pose."""
LEAST_SEEN_RIGID = 0.8
"""The second for a rigid shape, of which what is not hidden is seen where it should be, or the pose is wrong."""
NOISE = np.diag([0.01**2] * 3 + [0.1**2] * 3)
"""Covariance [m², rad²] of a pose that fits perfectly; of others it is larger by the square of their score."""
RIGID_NOISE = np.diag([0.003**2] * 3 + [0.015**2] * 3)
"""The same of a rigid shape's pose, however much of its support is left in the cloud."""


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


@functools.cache
def tracker_of(label: str, filter: Literal["ekf", "ukf", "particle"] = "ekf") -> PoseTracker:
    """A class's filter: objects rest, so accelerations are those of the odometry's errors."""
    return PoseTracker(nominal_object(label).symmetries, filter, jerk=0.2, angular_jerk=0.5)


def predicted(tracker: PoseTracker, track: PoseTrack | None, T_start_camera: Array, stamp: float) -> Array | None:
    """T_c_object (4, 4) that a track in the frame of the start expects at a time; None without a track."""
    return None if track is None else inverse(T_start_camera) @ tracker.predict(track, stamp).T


def measured(frame: RGBD, box: Array, label: str, T_init: Array | None = None) -> BoxPose:
    """The pose of the object in a box (4,) [px]; `T_init` is where it is expected in the camera's frame."""
    seen = LEAST_SEEN_RIGID if label in RIGID else LEAST_FIT
    return pose_from_box(frame, box, shape_of(label), T_init, min_inlier_fraction=LEAST_FIT, min_seen=seen)


def followed(
    tracker: PoseTracker, track: PoseTrack | None, found: BoxPose, label: str, T_start_camera: Array, stamp: float
) -> PoseTrack | None:
    """The track after what one frame measured; without a pose it is only predicted.

    A measurement that is far from the track, and that agrees much better with the image, is where the track begins
    anew: the track was wrong.
    """
    if found.T_c_object is None:
        return None if track is None else tracker.update(track, None, stamp)
    T = T_start_camera @ found.T_c_object
    noise = RIGID_NOISE if label in RIGID else NOISE / max(found.score, 0.1) ** 2
    after = tracker.update(track, T, stamp, noise)
    if track is not None and found.disproved and not after.accepted:
        return tracker.restart(track, T, stamp, noise)
    return after
