"""Extended and unscented Kalman filters: filterpy's arithmetic behind immutable beliefs.

filterpy's filters are mutable objects; here one lives for one call, which costs little and leaves no hidden state.
"""

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import Any

import filterpy.kalman
import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import chi2

from baselines.filtering.model import Array, Belief, Innovation, Model, square_root, vector


def gate_distance(gate: float | None, size: int) -> float:
    """The squared Mahalanobis distance that a fraction `gate` of consistent (size,) innovations stays below."""
    if gate is None:
        return np.inf
    if not 0.0 < gate < 1.0:
        raise ValueError(f"gate: expected a probability inside (0, 1) or None, got {gate}")
    return float(chi2.ppf(gate, size))


def time_step(dt: float) -> float:
    dt = float(dt)
    if not (0.0 <= dt < np.inf):
        raise ValueError(f"dt: expected a non-negative number of seconds, got {dt}")
    return dt


class _KalmanFilter(ABC):
    """What the two share: the first belief, prediction and update around filterpy's, and the innovation gate.

    Args:
        model: the model to filter with.
        gate: probability in (0, 1); a measurement whose innovation lies outside that chi-square region leaves the
            belief as it was, and `belief.innovation.accepted` says so. None accepts all.

    Raises:
        ValueError: a gate that is no probability.
    """

    def __init__(self, model: Model, gate: float | None = None) -> None:
        self.model = model
        self.gate = gate
        self._gate_distance = gate_distance(gate, model.measurement_size)

    def initial(self, mean: ArrayLike, covariance: ArrayLike) -> Belief:
        """The belief to start from: mean (n,), covariance (n, n)."""
        return Belief(np.asarray(mean), np.asarray(covariance))

    def predict(self, belief: Belief, dt: float, u: Any = None) -> Belief:
        """The belief dt seconds [s] later, under the model's input u.

        Raises:
            ValueError: dt is negative or not finite, or the model returns something of a wrong shape or not finite.
        """
        dt = time_step(dt)
        kf = self._load(belief)
        kf.Q = self.model.Q(dt, belief.mean.size)
        self._predict(kf, dt, u)
        return Belief(kf.x, kf.P)

    def update(self, belief: Belief, z: ArrayLike) -> Belief:
        """The belief given the measurement z (m,); its `innovation` tells what came of it.

        Raises:
            ValueError: z has another shape or is not finite.
        """
        z = vector(np.atleast_1d(z), "z", self.model.measurement_size)
        kf = self._load(belief)
        self._update(kf, z)
        return self._result(belief, kf)

    @abstractmethod
    def _load(self, belief: Belief) -> Any:
        """filterpy's filter with this belief in it, for one call."""

    @abstractmethod
    def _predict(self, kf: Any, dt: float, u: Any) -> None:
        """Move it on by dt [s] under the model's input u."""

    @abstractmethod
    def _update(self, kf: Any, z: Array) -> None:
        """Take in the measurement z (m,)."""

    def _result(self, belief: Belief, kf: Any) -> Belief:
        distance = float(kf.mahalanobis) ** 2
        accepted = distance <= self._gate_distance
        innovation = Innovation(kf.y, kf.S, distance, accepted)
        if not accepted:
            return replace(belief, innovation=innovation)
        return Belief(kf.x, kf.P, innovation)


class _FilterpyEKF(filterpy.kalman.ExtendedKalmanFilter):
    """filterpy moves the state by F x + B u unless this is overridden, as its documentation says."""

    next_x: Array

    def predict_x(self, u: Any = 0) -> None:
        self.x = self.next_x


class ExtendedKalmanFilter(_KalmanFilter):
    """First-order extended Kalman filter with Joseph's covariance update (Jazwinski 1970, section 8.3).

    The thesis smooths the docking tool's pose with one (section 5.4.2).
    """

    def _predict(self, kf: _FilterpyEKF, dt: float, u: Any) -> None:
        kf.next_x = self.model.f(kf.x, u, dt)
        kf.F = self.model.F(kf.x, u, dt)
        kf.predict()

    def _update(self, kf: _FilterpyEKF, z: Array) -> None:
        kf.update(z, self.model.H, self.model.h, residual=self.model.residual)

    def _load(self, belief: Belief) -> _FilterpyEKF:
        kf = _FilterpyEKF(belief.mean.size, self.model.measurement_size)
        kf.x, kf.P, kf.R = belief.mean, belief.covariance, self.model.measurement_noise
        return kf


class UnscentedKalmanFilter(_KalmanFilter):
    """Scaled unscented Kalman filter (Wan & van der Merwe 2000), sigma points redrawn before every update.

    The default α = 1, β = 2, κ = 0 has no negative weight in any dimension, so covariances stay PSD.

    Args:
        model, gate: as for every filter here.
        alpha, beta, kappa: the spread, prior-knowledge and secondary parameters of the scaled transform.
    """

    def __init__(
        self, model: Model, gate: float | None = None, alpha: float = 1.0, beta: float = 2.0, kappa: float = 0.0
    ) -> None:
        super().__init__(model, gate)
        if not (np.isfinite([alpha, beta, kappa]).all() and alpha > 0.0):
            raise ValueError(f"alpha, beta, kappa: expected finite numbers, alpha > 0, got {alpha}, {beta}, {kappa}")
        self.alpha, self.beta, self.kappa = alpha, beta, kappa

    def _predict(self, kf: filterpy.kalman.UnscentedKalmanFilter, dt: float, u: Any) -> None:
        kf.predict(dt, fx=lambda x, dt: self.model.f(x, u, dt))

    def _update(self, kf: filterpy.kalman.UnscentedKalmanFilter, z: Array) -> None:
        kf.sigmas_f = kf.points_fn.sigma_points(kf.x, kf.P)
        kf.update(z)

    def _load(self, belief: Belief) -> filterpy.kalman.UnscentedKalmanFilter:
        size = belief.mean.size
        if size + self.kappa <= 0.0:
            raise ValueError(f"kappa: expected more than −{size} for a state of {size}, got {self.kappa}")
        points = filterpy.kalman.MerweScaledSigmaPoints(
            size, self.alpha, self.beta, self.kappa, sqrt_method=square_root
        )
        kf = filterpy.kalman.UnscentedKalmanFilter(
            size,
            self.model.measurement_size,
            dt=0.0,
            hx=self.model.h,
            fx=None,
            points=points,
            z_mean_fn=self._measurement_mean,
            residual_z=self.model.residual,
        )
        kf.x, kf.P, kf.R = belief.mean, belief.covariance, self.model.measurement_noise
        return kf

    def _measurement_mean(self, sigmas: Array, weights: Array) -> Array:
        # About the first point, by the model's own difference: right for measurements that wrap, too.
        return sigmas[0] + weights @ self.model.residual(sigmas, sigmas[0])
