"""What tracking needs: the constant-acceleration model, and symmetric poses brought next to a predicted one."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.spatial import so3_log
from baselines.filtering import Innovation, Model, ParticleBelief, ParticleFilter
from baselines.filtering.kalman import gate_distance

Array = NDArray[np.float64]


def constant_acceleration_model(jerk: float, measurement_noise: Array) -> Model:
    """Axes whose acceleration changes by white noise, with their values measured (Bar-Shalom et al. 2001, 6.2.3).

    State (3 m,): values, rates, accelerations, m axes each. Thesis, section 3.3: X + Ẋ Δt + ½ Ẍ Δt².

    Args:
        jerk: square root of the jerk's spectral density [unit/s³ / √Hz].
        measurement_noise: (m, m) covariance of a measured value.
    """
    axes = len(measurement_noise)
    identity, H = np.eye(axes), np.eye(axes, 3 * axes)

    def F(x: Array, u: Any, dt: float) -> Array:
        steps = np.array([[1.0, dt, 0.5 * dt * dt], [0.0, 1.0, dt], [0.0, 0.0, 1.0]])
        return np.asarray(np.kron(steps, identity), dtype=np.float64)

    def Q(dt: float) -> Array:
        powers = np.array(
            [
                [dt**5 / 20.0, dt**4 / 8.0, dt**3 / 6.0],
                [dt**4 / 8.0, dt**3 / 3.0, dt**2 / 2.0],
                [dt**3 / 6.0, dt**2 / 2.0, dt],
            ]
        )
        return np.asarray(np.kron(jerk**2 * powers, identity), dtype=np.float64)

    def f(x: Array, u: Any, dt: float) -> Array:
        return x @ F(x, u, dt).T

    return Model(f, lambda x: x[..., :axes], Q, measurement_noise, F, lambda x: H)


@dataclass(frozen=True, eq=False)
class AxisBelief:
    """Particles of three axes, each on its own; as a belief of all (9,)."""

    axes: tuple[ParticleBelief, ParticleBelief, ParticleBelief]  # (N, 3) particles each: value, rate, acceleration
    innovation: Innovation | None = None

    @property
    def mean(self) -> Array:
        """(9,) values, rates, accelerations."""
        return np.stack([axis.mean for axis in self.axes], axis=1).ravel()

    @property
    def covariance(self) -> Array:
        """(9, 9), without terms between axes."""
        out = np.zeros((3, 3, 3, 3))
        for i, axis in enumerate(self.axes):
            out[:, i, :, i] = axis.covariance
        return out.reshape(9, 9)

    def shifted(self, values: Array) -> AxisBelief:
        """The belief with values (3,) taken off."""
        moved = [
            replace(axis, particles=axis.particles - [value, 0.0, 0.0])
            for axis, value in zip(self.axes, values, strict=True)
        ]
        return replace(self, axes=(moved[0], moved[1], moved[2]))


class AxisParticleFilter:
    """Three particle filters of constant acceleration, one an axis, behind the interface of one.

    Particles in nine dimensions would need to be very many: in three, some hundreds do. What measurements of one axis
    tell of another, by the terms between them in the noise, is left out.
    """

    def __init__(self, jerk: float, noise: Array, gate: float | None, rng: np.random.Generator, particles: int) -> None:
        models = [constant_acceleration_model(jerk, noise[i : i + 1, i : i + 1]) for i in range(3)]
        self._filters = [ParticleFilter(model, None, rng=rng, particles=particles) for model in models]
        self._gate_distance = gate_distance(gate, 3)

    def initial(self, mean: Array, covariance: Array) -> AxisBelief:
        return self._joined(
            filter.initial(mean[i::3], covariance[i::3, i::3]) for i, filter in enumerate(self._filters)
        )

    def predict(self, belief: AxisBelief, dt: float) -> AxisBelief:
        return self._joined(filter.predict(axis, dt) for filter, axis in zip(self._filters, belief.axes, strict=True))

    def update(self, belief: AxisBelief, z: Array) -> AxisBelief:
        after = self._joined(
            filter.update(axis, z[i : i + 1])
            for i, (filter, axis) in enumerate(zip(self._filters, belief.axes, strict=True))
        )
        seen = [axis.innovation for axis in after.axes if axis.innovation is not None]
        distance = sum(one.distance for one in seen)
        residual = np.concatenate([one.residual for one in seen])
        spread = np.diag(np.concatenate([one.covariance.ravel() for one in seen]))
        innovation = Innovation(residual, spread, distance, distance <= self._gate_distance)
        return replace(after if innovation.accepted else belief, innovation=innovation)

    def _joined(self, beliefs: Iterable[ParticleBelief]) -> AxisBelief:
        first, second, third = beliefs
        return AxisBelief((first, second, third))


def nearest_symmetric(T: Array, symmetries: Array, R_near: Array) -> tuple[Array, int]:
    """The pose T (4, 4) with the symmetry (K, 3, 3) after which its rotation is nearest to R_near, and which it is."""
    turned = T[:3, :3] @ symmetries
    best = int(np.argmax(np.einsum("kij,ij->k", turned, R_near)))  # the trace of R_nearᵀ R: 1 + 2 cos of the angle
    out = T.copy()
    out[:3, :3] = turned[best]
    return out, best


def turn_between(R_from: Array, R_to: Array) -> Array:
    """The rotation vector (3,) [rad] that takes R_from to R_to, in the outer frame: R_to = exp(v) R_from."""
    return so3_log(R_to @ R_from.T)
