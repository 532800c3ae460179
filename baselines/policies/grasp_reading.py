"""What the observations of the grasping tasks say, row by row."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Hand(NamedTuple):
    """What one arm's part of an observation says."""

    q: Array  # (n,) encoder angles [rad]
    lag: Array  # (n,) set-points less encoder angles [rad]
    opening: float  # [m]
    load: float  # of the jaws' motor, as a share of its stall force
    tool: Array  # (4, 4) T_body_tool


class Reading(NamedTuple):
    """One row of an observation."""

    velocity: Array  # (3,) body frame [m/s]
    rpy: Array  # (3,) [rad]
    gyro: Array  # (3,) [rad/s]
    hands: tuple[Hand, ...]
    T_body_object: Array  # (4, 4) by the newest image
    age: float  # of that image [s]
    support: Array  # (2, 3) outward normal; a point on it [m], body frame
    cloud: Array  # (N, 6) points and outward normals, object frame


def rigid(nine: Array) -> Array:
    """(4, 4) of a position and the first two columns of a rotation (9,), made orthonormal."""
    T = np.eye(4)
    T[:3, 3] = nine[:3]
    x = nine[3:6] / np.linalg.norm(nine[3:6])
    z = np.cross(x, nine[6:9])
    z /= np.linalg.norm(z)
    T[:3, 0], T[:3, 1], T[:3, 2] = x, np.cross(z, x), z
    return T


def read(observation: Mapping[str, NDArray[Any]], row: int, joints: tuple[int, ...]) -> Reading:
    """A row of a batched observation; `joints` are the arms' numbers of joints."""
    flat = {name: np.asarray(value[row], dtype=np.float64) for name, value in observation.items()}
    hands, first = [], 0
    for k, n in enumerate(joints):
        part = slice(first, first + n)
        gripper, tool = flat["gripper"][2 * k : 2 * k + 2], flat["tool"][9 * k : 9 * k + 9]
        q, lag = flat["joints"][part], flat["command_lag"][part]
        hands.append(Hand(q, lag, float(gripper[0]), float(gripper[1]), rigid(tool)))
        first += n
    return Reading(
        flat["velocity"], flat["attitude"], flat["angular_velocity"], tuple(hands), rigid(flat["object"]),
        float(flat["object_age"][0]), flat["support"].reshape(2, 3), flat["object_cloud"].reshape(-1, 6),
    )  # fmt: skip
