"""What a policy of Detect-v0 remembers from frame to frame: where it flew, and what it has seen where."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.envs.detect_motion import camera_mount
from aerograsp_env.spatial import Array, matrix_from_rpy, so3_exp, so3_log, transform

FRAME = 0.1  # [s] between observations


class Odometry(NamedTuple):
    """Where the vehicle believes to be: the frame it began in, level, its origin there."""

    position: Array  # (3,) [m]
    velocity: Array  # (3,) at the last frame [m/s]

    @classmethod
    def begin(cls) -> Odometry:
        """At the origin, at rest."""
        return cls(np.zeros(3), np.zeros(3))

    def advance(self, observation: Mapping[str, NDArray[Any]], first: bool) -> tuple[Odometry, Array]:
        """The next frame's, by the estimated attitude and velocity; T_start_camera (4, 4) of that frame."""
        R = matrix_from_rpy(np.asarray(observation["attitude"], dtype=np.float64))
        velocity = R @ np.asarray(observation["velocity"], dtype=np.float64)
        position = self.position if first else self.position + 0.5 * FRAME * (self.velocity + velocity)
        mount = camera_mount(float(observation["camera_tilt"][0]))
        return Odometry(position, velocity), transform(R, position) @ mount


class Track(NamedTuple):
    """One thing seen in several frames."""

    place: Array  # (3,) middle of its box, the start's frame [m]
    evidence: Array  # (C,) sum over frames of log class probabilities
    frames: int  # in which it was seen
    missed: int  # frames since
    label: str = ""  # class of `T_start_object`
    T_start_object: Array | None = None  # (4, 4) smoothed


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


def blend(T_before: Array, T_seen: Array, symmetries: Array, gain: float) -> Array:
    """Between two poses (4, 4) of an object at rest: `gain` of the way to what is seen, of all that look like it
    (symmetries (K, 3, 3)) the one turned least from before."""
    alike = T_seen[:3, :3] @ symmetries
    traces = np.einsum("kij,ij->k", alike, T_before[:3, :3])
    R = alike[int(traces.argmax())]
    turn = gain * so3_log(T_before[:3, :3].T @ R)
    place = (1.0 - gain) * T_before[:3, 3] + gain * T_seen[:3, 3]
    return transform(T_before[:3, :3] @ so3_exp(turn), place)
