"""What a policy of Detect-v0 remembers from frame to frame: where it flew, and what it has seen where."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.envs.detect_motion import camera_mount
from aerograsp_env.sim.visual.objects import nominal_object
from aerograsp_env.spatial import Array, matrix_from_rpy, transform
from baselines.detection import PoseTrack, PoseTracker
from baselines.detection.feature_model import FeatureModel

FRAME = 0.1  # [s] between observations

JERK, ANGULAR_JERK = 0.05, 0.2  # of things at rest, seen from where the vehicle believes to be [m/s³/√Hz], [rad/s³/√Hz]
POSITION_NOISE, ROTATION_NOISE = 0.012, 0.25  # of one frame's pose [m], [rad]


ALIKE = ("juice_box", "box", "fruit", "wrench")
"""Classes whose shape hardly tells a half turn about their axes: a track keeps to the one that it took first."""
HALF_TURNS = np.array([np.diag(signs) for signs in ([1.0, 1, 1], [1.0, -1, -1], [-1.0, 1, -1], [-1.0, -1, 1])])


@functools.cache
def tracker_of(label: str) -> PoseTracker:
    """The filter of a class's poses: constant acceleration, symmetric poses brought next to the prediction."""
    turns = nominal_object(label).symmetries
    if label in ALIKE:
        turns = (HALF_TURNS[:, None] @ turns).reshape(-1, 3, 3)
    return PoseTracker(
        turns, jerk=JERK, angular_jerk=ANGULAR_JERK, position_noise=POSITION_NOISE, rotation_noise=ROTATION_NOISE
    )


class Odometry(NamedTuple):
    """Where the vehicle believes to be: the frame it began in, level, its origin there."""

    position: Array  # (3,) [m]
    velocity: Array  # (3,) at the last frame [m/s]
    stamp: float = 0.0  # of the last frame [s]

    @classmethod
    def begin(cls) -> Odometry:
        """At the origin, at rest."""
        return cls(np.zeros(3), np.zeros(3))

    def advance(self, observation: Mapping[str, NDArray[Any]], first: bool) -> tuple[Odometry, Array]:
        """The next frame's, by the estimated attitude and velocity; T_start_camera (4, 4) of that frame."""
        R = matrix_from_rpy(np.asarray(observation["attitude"], dtype=np.float64))
        velocity = R @ np.asarray(observation["velocity"], dtype=np.float64)
        position = self.position if first else self.position + 0.5 * FRAME * (self.velocity + velocity)
        stamp = 0.0 if first else self.stamp + FRAME
        mount = camera_mount(float(observation["camera_tilt"][0]))
        return Odometry(position, velocity, stamp), transform(R, position) @ mount


class Track(NamedTuple):
    """One thing seen in several frames."""

    place: Array  # (3,) middle of its box, the start's frame [m]
    evidence: Array  # (C,) sum over frames of log class probabilities
    frames: int  # in which it was seen
    missed: int  # frames since
    label: str = ""  # class of `pose`
    pose: PoseTrack | None = None  # T_start_object
    features: FeatureModel | None = None  # of this very thing, in the object's frame, where a policy learns them
    learned: int = 0  # frames of `frames` when they were learned


def associate(tracks: tuple[Track, ...], places: Array, gate: float) -> list[int]:
    """For each new place (N, 3) the index of its track, or −1: nearest pairs first, each track once."""
    found = [-1] * len(places)
    if not tracks or not len(places):
        return found
    gaps = np.linalg.norm(places[:, None] - np.array([track.place for track in tracks])[None], axis=2)
    while np.isfinite(gaps).any():
        i, j = np.unravel_index(int(gaps.argmin()), gaps.shape)
        if gaps[i, j] > gate:
            break
        found[int(i)] = int(j)
        gaps[i, :] = gaps[:, j] = np.inf
    return found
