"""Features of one very thing, learned from a frame by their depth and found again in later frames by PnP."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from aerograsp_env.interfaces import RGBD, Intrinsics
from aerograsp_env.spatial import Array, inverse, transform_points
from baselines.detection.extraction import extract
from baselines.detection.feature_model import FeatureModel

FEATURE = "sift"
ENLARGED = 2  # times that a thing's part of the image is enlarged: things are small
MARGIN = 12  # about its box [px]
MOST, FEWEST = 150, 8  # features
NEAR = 0.012  # of a feature's point from the thing's own points [m]
LARGEST_MOVE, LARGEST_TURN = 0.05, np.radians(30.0)  # from the guess, beyond which a pose is not believed
SLACK = np.diag([0.003**2] * 3 + [0.05**2] * 3)  # what a pose by PnP may err beside its covariance: its model is noisy


class Located(NamedTuple):
    """A pose by features."""

    T_c_object: Array  # (4, 4)
    covariance: Array  # (6, 6) camera-frame position [m²], then rotation vector [rad²]
    inliers: int


def _crop(frame: RGBD, box: Array) -> tuple[NDArray[np.uint8], Intrinsics, NDArray[np.intp]]:
    """The enlarged part of the image about a box, its camera, and where it begins (2,) [px]."""
    camera = frame.intrinsics
    low = np.maximum(np.floor(box[:2]).astype(int) - MARGIN, 0)
    high = np.minimum(np.ceil(box[2:]).astype(int) + MARGIN, [camera.width, camera.height])
    part = frame.rgb[low[1] : high[1], low[0] : high[0]]
    width, height = (ENLARGED * (high - low)).tolist()
    image = cv2.resize(part, (width, height), interpolation=cv2.INTER_CUBIC).astype(np.uint8, copy=False)
    k, shift = float(ENLARGED), 0.5 * (ENLARGED - 1)  # pixel centres: u' = k u + (k − 1) / 2
    center = k * (np.array([camera.cx, camera.cy]) - low) + shift
    return image, Intrinsics(width, height, k * camera.fx, k * camera.fy, float(center[0]), float(center[1])), low


def learn(frame: RGBD, box: Array, points: Array, T_c_object: Array) -> FeatureModel | None:
    """The features on the thing whose points (N, 3) [m] are given, in its frame; None where there are too few."""
    image, _, low = _crop(frame, box)
    found = extract(image, FEATURE, MOST)
    pixels = (found.pixels - 0.5 * (ENLARGED - 1)) / ENLARGED + low
    camera = frame.intrinsics
    columns, rows = np.clip(np.round(pixels).astype(int), 0, [camera.width - 1, camera.height - 1]).T
    z = frame.depth[rows, columns].astype(np.float64)
    rays = (pixels - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
    lifted = np.concatenate([rays, np.ones((len(rays), 1))], axis=1) * z[:, None]
    own = (z > 0.0) & (cKDTree(points).query(lifted)[0] < NEAR)
    if own.sum() < FEWEST:
        return None
    return FeatureModel(transform_points(inverse(T_c_object), lifted[own]), found.descriptors[own], FEATURE)


def locate(model: FeatureModel, frame: RGBD, box: Array, T_guess: Array) -> Located | None:
    """The pose of a thing whose features were learned, near a guess; None where too few agree."""
    image, camera, _ = _crop(frame, box)
    found = model.locate(image, camera, T_guess=T_guess, n=MOST)
    if found.T_c_object is None or found.covariance is None:
        return None
    move = float(np.linalg.norm(found.T_c_object[:3, 3] - T_guess[:3, 3]))
    turn = float(np.arccos(np.clip(0.5 * (np.trace(found.T_c_object[:3, :3].T @ T_guess[:3, :3]) - 1.0), -1.0, 1.0)))
    if move > LARGEST_MOVE or turn > LARGEST_TURN:
        return None
    return Located(found.T_c_object, found.covariance + SLACK, found.inliers)


def in_start(covariance: Array, T_start_camera: Array) -> Array:
    """A pose's covariance (6, 6) in the camera's axes, in those of the frame that the flight began in."""
    turn = np.kron(np.eye(2), T_start_camera[:3, :3])
    rotated = turn @ covariance @ turn.T
    return 0.5 * (rotated + rotated.T)
