"""The pose of an object from late and few images, brought to now while the camera's body moves.

A tracker on board delivers poses in the body frame late and at a few images per second, and meanwhile the body moves.
`update_track` keeps the pose in an odometry frame, into which it integrates the velocity estimate, so that each image
is compared with where the body was when it was taken; a steady-state filter takes the images' noise off and finds the
slow error of the velocity estimate (or the object's own motion, there is no telling them apart).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.sim.kernel_math import compiled
from baselines.kinematics.arm import exactly
from baselines.kinematics.chain import pose_error_kernel

Array = NDArray[np.float64]

REMEMBERED = 64  # steps of the body's motion


@dataclass(frozen=True)
class TrackSettings:
    """Gains of the tracked pose's filter.

    Raises:
        ValueError: a step that is not positive, or a gain outside [0, 1].
    """

    step: float = 0.02  # [s] of control
    position_gain: float = 0.4  # of an image: what of its difference is believed
    drift_gain: float = 0.02  # of the same, per interval between images, into the drift
    rotation_gain: float = 0.2
    interval: float = 1.0 / 30.0  # between images [s]

    def __post_init__(self) -> None:
        for name in ("step", "interval"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name}: expected a positive time, got {getattr(self, name)}")
        for name in ("position_gain", "drift_gain", "rotation_gain"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ValueError(f"{name}: expected 0 … 1, got {getattr(self, name)}")


class Track(NamedTuple):
    """A tracked pose and other points of the same images, in the odometry frame: the body's at the start, z up."""

    step: int
    image: int  # step at which the newest image was taken
    at: Array  # (3,) body by odometry [m]
    attitude: Array  # (3, 3) R_odometry_body
    velocity: Array  # (3,) of the body by its estimate, odometry frame [m/s]
    places: Array  # (REMEMBERED, 3) of the body, by step modulo REMEMBERED
    attitudes: Array  # (REMEMBERED, 3, 3)
    points: Array  # (K, 3) the pose's origin first [m]
    drifts: Array  # (K, 3) their velocities in the odometry frame [m/s]
    rotation: Array  # (3, 3) R_odometry_object

    @property
    def pose(self) -> Array:
        """(4, 4) T_body_object now."""
        T = np.eye(4)
        T[:3, :3] = self.attitude.T @ self.rotation
        T[:3, 3] = self.attitude.T @ (self.points[0] - self.at)
        return T

    def point(self, k: int) -> Array:
        """(3,) the k-th point now, body frame [m]."""
        return np.asarray(self.attitude.T @ (self.points[k] - self.at))


def attitude_matrix(rpy: ArrayLike) -> Array:
    """(3, 3) R_odometry_body of roll, pitch, yaw (3,) [rad]."""
    R = np.empty((3, 3))
    _attitude_kernel(exactly(rpy, (3,), "rpy"), R)
    return R


@compiled
def _attitude_kernel(rpy, R):
    cr, sr, cp, sp = math.cos(rpy[0]), math.sin(rpy[0]), math.cos(rpy[1]), math.sin(rpy[1])
    cy, sy = math.cos(rpy[2]), math.sin(rpy[2])
    R[0, 0], R[0, 1], R[0, 2] = cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr
    R[1, 0], R[1, 1], R[1, 2] = sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr
    R[2, 0], R[2, 1], R[2, 2] = -sp, cp * sr, cp * cr


def start_track(T_body_object: ArrayLike, points: ArrayLike, rpy: ArrayLike, velocity: ArrayLike) -> Track:
    """The first estimate of an episode, taken at its word.

    Args:
        T_body_object: (4, 4) by the newest image.
        points: (K − 1, 3) other points of that image, body frame [m].
        rpy: (3,) the body's attitude [rad].
        velocity: (3,) by its estimate, body frame [m/s].

    Raises:
        ValueError: arrays of other shapes or not finite.
    """
    T, R = exactly(T_body_object, (4, 4), "T_body_object"), attitude_matrix(rpy)
    others = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    seen = np.concatenate([T[None, :3, 3], exactly(others, others.shape, "points")])
    v = R @ exactly(velocity, (3,), "velocity")
    attitudes = np.repeat(R[None], REMEMBERED, axis=0)
    zero = np.zeros(3)
    return Track(0, 0, zero, R, v, np.zeros((REMEMBERED, 3)), attitudes, seen @ R.T, np.zeros_like(seen), R @ T[:3, :3])


def update_track(
    track: Track,
    T_body_object: ArrayLike,
    points: ArrayLike,
    age: float,
    rpy: ArrayLike,
    velocity: ArrayLike,
    settings: TrackSettings,
) -> Track:
    """One control step: the body moves on, and an image is believed in part if it is a new one.

    Args:
        track: before; not changed.
        T_body_object: (4, 4) by the newest image, in the body frame of the moment when it was taken.
        points: (K − 1, 3) other points of that image [m].
        age: of the image [s].
        rpy: (3,) attitude now [rad].
        velocity: (3,) estimate now, body frame [m/s].
        settings: of the filter.

    Raises:
        ValueError: arrays of other shapes or not finite, or a negative age.
    """
    T = exactly(T_body_object, (4, 4), "T_body_object")
    if not 0.0 <= age < math.inf:
        raise ValueError(f"age: expected a time of zero or more, got {age}")
    count = len(track.points)
    seen = np.concatenate([T[None, :3, 3], exactly(points, (count - 1, 3), "points")]) if count > 1 else T[None, :3, 3]
    arrays = [
        np.array(a) for a in (track.at, track.attitude, track.velocity, track.places, track.attitudes, track.points,
                              track.drifts, track.rotation)
    ]  # fmt: skip
    image = _track_kernel(
        track.step + 1, track.image, T, seen, round(age / settings.step), exactly(rpy, (3,), "rpy"),
        exactly(velocity, (3,), "velocity"), settings.step, settings.position_gain,
        settings.drift_gain / settings.interval, settings.rotation_gain, *arrays,
    )  # fmt: skip
    return Track(track.step + 1, int(image), *arrays)


@compiled
def _turn_towards(rotation, wanted, share):
    """rotation (3, 3) turned by a share of what separates it from another, in place."""
    here, there, error = np.zeros((3, 4)), np.zeros((3, 4)), np.empty(6)
    here[:, :3] = rotation
    there[:, :3] = wanted
    pose_error_kernel(here, there, error)
    angle = math.sqrt(error[3] ** 2 + error[4] ** 2 + error[5] ** 2)
    if angle < 1e-12:
        return
    x, y, z = error[3] / angle, error[4] / angle, error[5] / angle
    c, s = math.cos(share * angle), math.sin(share * angle)
    for j in range(3):
        a, b, d = rotation[0, j], rotation[1, j], rotation[2, j]
        along = (1.0 - c) * (x * a + y * b + z * d)
        rotation[0, j] = c * a + s * (y * d - z * b) + along * x
        rotation[1, j] = c * b + s * (z * a - x * d) + along * y
        rotation[2, j] = c * d + s * (x * b - y * a) + along * z


@compiled
def _track_kernel(
    step, image, T, seen, age, rpy, velocity, dt, gain, drift_gain, rotation_gain,
    at, attitude, speed, places, attitudes, points, drifts, rotation,
):  # fmt: skip
    before = np.empty(3)
    before[:] = speed
    _attitude_kernel(rpy, attitude)
    for i in range(3):
        speed[i] = attitude[i, 0] * velocity[0] + attitude[i, 1] * velocity[1] + attitude[i, 2] * velocity[2]
        at[i] += 0.5 * dt * (before[i] + speed[i])
    places[step % REMEMBERED] = at
    attitudes[step % REMEMBERED] = attitude
    for k in range(points.shape[0]):
        for i in range(3):
            points[k, i] += dt * drifts[k, i]
    taken = step - age
    if taken <= image or age >= REMEMBERED - 1:
        return image
    if taken < 0:
        taken = 0
    then, R = places[taken % REMEMBERED], attitudes[taken % REMEMBERED]
    for k in range(points.shape[0]):
        for i in range(3):
            there = then[i] + R[i, 0] * seen[k, 0] + R[i, 1] * seen[k, 1] + R[i, 2] * seen[k, 2]
            off = there - (points[k, i] - age * dt * drifts[k, i])
            points[k, i] += gain * off
            drifts[k, i] += drift_gain * off
    wanted = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for m in range(3):
                wanted[i, j] += R[i, m] * T[m, j]
    _turn_towards(rotation, wanted, rotation_gain)
    return taken
