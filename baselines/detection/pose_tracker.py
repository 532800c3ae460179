"""A moving object's pose over time: a filter with constant acceleration that keeps symmetric objects from flipping."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.spatial import as_array, check_rotation, check_transform, skew, so3_exp, transform
from baselines.detection.checks import check_positive
from baselines.detection.tracking import (
    AxisBelief,
    AxisParticleFilter,
    constant_acceleration_model,
    nearest_symmetric,
    turn_between,
)
from baselines.filtering import Belief, ExtendedKalmanFilter, UnscentedKalmanFilter

Array = NDArray[np.float64]
Beliefs = Belief | AxisBelief

FIRST_SPEED, FIRST_ACCELERATION = 0.5, 0.5
"""Standard deviations of a new track's rates [m/s, rad/s] and accelerations [m/s², rad/s²], about zero."""


@dataclass(frozen=True, eq=False)
class PoseTrack:
    """What a tracker knows at one time; a value that a policy can keep in its state."""

    stamp: float  # [s]
    R: Array  # (3, 3) the rotation about which small turns are estimated
    position: Beliefs  # (9,) position [m], velocity, acceleration
    turn: Beliefs  # (9,) rotation vector from R in the outer frame [rad], its rate, its acceleration
    accepted: bool = True  # False: the last measurement lay beyond the gate and was left out
    rejected: int = 0  # measurements left out since the last that was taken

    @property
    def T(self) -> Array:
        """(4, 4) the pose."""
        return transform(so3_exp(np.array(self.turn.mean[:3])) @ self.R, self.position.mean[:3])

    @property
    def twist(self) -> Array:
        """(6,) velocity of the object's origin [m/s] and angular velocity [rad/s], both in the outer frame."""
        return np.concatenate([self.position.mean[3:6], self.turn.mean[3:6]])

    @property
    def covariance(self) -> Array:
        """(6, 6) of the position [m²] and of the rotation vector in the outer frame [rad²]; no terms between them."""
        out = np.zeros((6, 6))
        out[:3, :3], out[3:, 3:] = self.position.covariance[:3, :3], self.turn.covariance[:3, :3]
        return out


class PoseTracker:
    """Filters poses and brings those of a symmetric object next to the prediction. Thesis, section 3.3, algorithm 2.

    Position and rotation are filtered apart, each by a model of constant acceleration. The rotation is estimated as a
    small turn from the predicted one, in its tangent space, and folded into it after each step (an error-state filter;
    Solà 2017, "Quaternion kinematics for the error-state Kalman filter", section 6), so that there is no singularity
    and no mean of angles. A measurement is first replaced by the symmetric pose nearest to the prediction::

        tracker = PoseTracker(symmetries=model.symmetries)
        track = None
        for stamp, T in measurements:
            track = tracker.update(track, T, stamp)     # T None: only predict
            track.T

    Poses may be in any frame that moves smoothly (the world, the camera), always the same one.

    Args:
        symmetries: (K, 3, 3) rotations about the object's origin after which it looks the same, the identity among
            them; None: none.
        filter: "ekf", "ukf" or "particle".
        jerk, angular_jerk: square roots of the spectral densities of jerk [m/s³/√Hz] and angular jerk [rad/s³/√Hz].
        position_noise, rotation_noise: standard deviations [m, rad] of measurements that come without a covariance.
        gate: probability in (0, 1); measurements outside that region of their prediction are left out. None: all taken.
        patience: after so many left out in a row, the next starts the track anew.
        rng: for the particle filter. None: the same noise for every tracker.
        particles: of each of the six particle filters, one an axis of position and rotation.

    Raises:
        ValueError: an argument outside its range.
    """

    def __init__(
        self,
        symmetries: ArrayLike | None = None,
        filter: Literal["ekf", "ukf", "particle"] = "ekf",
        *,
        jerk: float = 1.0,
        angular_jerk: float = 3.0,
        position_noise: float = 0.005,
        rotation_noise: float = 0.03,
        gate: float | None = 0.9999,
        patience: int = 5,
        rng: np.random.Generator | None = None,
        particles: int = 2000,
    ) -> None:
        turns = np.eye(3)[None] if symmetries is None else check_rotation(symmetries, "symmetries")
        if turns.ndim != 3 or not len(turns):
            raise ValueError(f"symmetries: expected shape (K, 3, 3), got {turns.shape}")
        if filter not in ("ekf", "ukf", "particle"):
            raise ValueError(f'filter: expected "ekf", "ukf" or "particle", got {filter!r}')
        if patience < 1:
            raise ValueError(f"patience: expected at least 1, got {patience}")
        self.symmetries = turns
        self.filter = filter
        self.jerks = (check_positive(jerk, "jerk"), check_positive(angular_jerk, "angular_jerk"))
        deviations = [
            check_positive(position_noise, "position_noise"),
            check_positive(rotation_noise, "rotation_noise"),
        ]
        self.noise = np.diag(np.repeat(np.square(deviations), 3))
        self.gate = gate
        self.patience = patience
        self.particles = particles
        self._rng = np.random.default_rng(0) if rng is None else rng
        self._filters(self.noise)  # so that a wrong gate or number of particles is refused now

    def start(self, T: ArrayLike, stamp: float, covariance: ArrayLike | None = None) -> PoseTrack:
        """A new track at the pose T (4, 4), at rest.

        Raises:
            ValueError: a pose that is not rigid, a stamp that is not finite, or a covariance that is none.
        """
        pose, noise = _pose(T), self._noise(covariance)
        stamp = _stamp(stamp)
        beliefs = []
        for filter, block, value in zip(
            self._filters(noise), (noise[:3, :3], noise[3:, 3:]), (pose[:3, 3], np.zeros(3)), strict=True
        ):
            spread = np.zeros((9, 9))
            spread[:3, :3] = block
            spread[3:6, 3:6], spread[6:, 6:] = FIRST_SPEED**2 * np.eye(3), FIRST_ACCELERATION**2 * np.eye(3)
            beliefs.append(filter.initial(np.concatenate([value, np.zeros(6)]), spread))
        return PoseTrack(stamp, pose[:3, :3].copy(), beliefs[0], beliefs[1])

    def predict(self, track: PoseTrack, stamp: float) -> PoseTrack:
        """The track at a later time: its pose is the start to align from.

        Raises:
            ValueError: a stamp before the track's.
        """
        dt = _stamp(stamp) - track.stamp
        if dt < 0.0:
            raise ValueError(f"stamp: expected one not before the track's {track.stamp}, got {stamp}")
        first, second = self._filters(self.noise)
        position, turn = first.predict(track.position, dt), second.predict(track.turn, dt)
        return _folded(replace(track, stamp=float(stamp), position=position, turn=turn))

    def update(
        self, track: PoseTrack | None, T: ArrayLike | None, stamp: float, covariance: ArrayLike | None = None
    ) -> PoseTrack:
        """The track after a measurement; where there was no track, a new one.

        Args:
            track: what was known; None: nothing.
            T: (4, 4) the measured pose; None: no measurement, so the track is only predicted.
            stamp: [s] its time, not before the track's.
            covariance: (6, 6) of its position [m²], then of its rotation vector in the outer frame [rad²]; None: from
                the noises given at construction.

        Raises:
            ValueError: neither track nor measurement, a pose that is not rigid, a stamp that runs backwards, or a
                covariance that is none.
        """
        if track is None:
            if T is None:
                raise ValueError("T: expected a pose to start from, got None")
            return self.start(T, stamp, covariance)
        before = self.predict(track, stamp)
        if T is None:
            return before
        pose, _ = nearest_symmetric(_pose(T), self.symmetries, before.R)
        noise = self._noise(covariance)
        first, second = self._filters(noise)
        position = first.update(before.position, pose[:3, 3])
        turn = second.update(before.turn, turn_between(before.R, pose[:3, :3]))
        assert position.innovation is not None and turn.innovation is not None
        if not (position.innovation.accepted and turn.innovation.accepted):
            if track.rejected + 1 > self.patience:
                return self.start(pose, stamp, covariance)
            return replace(before, accepted=False, rejected=track.rejected + 1)
        return _folded(replace(before, position=position, turn=turn, accepted=True, rejected=0))

    def restart(self, track: PoseTrack, T: ArrayLike, stamp: float, covariance: ArrayLike | None = None) -> PoseTrack:
        """A new track at the measurement T (4, 4), in the symmetric pose nearest to what was known.

        For whoever knows more than the gate does: that the track is wrong, and this is right.

        Raises:
            ValueError: as `start`.
        """
        return self.start(nearest_symmetric(_pose(T), self.symmetries, track.T[:3, :3])[0], stamp, covariance)

    def _noise(self, covariance: ArrayLike | None) -> Array:
        if covariance is None:
            return self.noise
        noise = as_array(covariance, (6, 6), "covariance")
        if noise.ndim != 2:
            raise ValueError(f"covariance: expected shape (6, 6), got {noise.shape}")
        if np.linalg.eigvalsh(noise)[0] <= 0.0:
            raise ValueError("covariance: expected a positive definite matrix")
        return noise

    def _filters(self, noise: Array) -> tuple[Any, Any]:
        """One filter for the position, one for the rotation, with these measurement covariances."""
        return self._filter(self.jerks[0], noise[:3, :3]), self._filter(self.jerks[1], noise[3:, 3:])

    def _filter(self, jerk: float, noise: Array) -> Any:
        if self.filter == "particle":
            return AxisParticleFilter(jerk, noise, self.gate, self._rng, self.particles)
        model = constant_acceleration_model(jerk, noise)
        if self.filter == "ekf":
            return ExtendedKalmanFilter(model, self.gate)
        return UnscentedKalmanFilter(model, self.gate)


def _folded(track: PoseTrack) -> PoseTrack:
    """The same track with the mean turn moved into R, so that the next small turn starts from zero."""
    mean = np.array(track.turn.mean[:3])
    R = so3_exp(mean) @ track.R
    turn: Beliefs
    if isinstance(track.turn, AxisBelief):
        turn = track.turn.shifted(mean)
    else:
        # exp(mean + e) = exp(J e) exp(mean) to first order: J is the left Jacobian, to second order in the mean.
        cross = skew(mean)
        J = np.eye(9)
        J[:3, :3] += 0.5 * cross + cross @ cross / 6.0
        moved = np.array(track.turn.mean)
        moved[:3] = 0.0
        turn = Belief(moved, J @ track.turn.covariance @ J.T, track.turn.innovation)
    return replace(track, R=R, turn=turn)


def _pose(T: ArrayLike) -> Array:
    pose = check_transform(T, "T")
    if pose.ndim != 2:
        raise ValueError(f"T: expected shape (4, 4), got {pose.shape}")
    return pose


def _stamp(stamp: float) -> float:
    if not np.isfinite(stamp):
        raise ValueError(f"stamp: expected a finite time [s], got {stamp}")
    return float(stamp)
