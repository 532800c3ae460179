"""What tracking needs: the constant-acceleration model, and symmetric poses brought next to a predicted one."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.spatial import so3_log
from baselines.filtering import Model

Array = NDArray[np.float64]


def constant_acceleration_model(jerk: float, measurement_noise: Array) -> Model:
    """Three axes whose acceleration changes by white noise, with their values measured (Bar-Shalom et al. 2001, 6.2.3).

    State (9,): value, rate, acceleration, three axes each. Thesis, section 3.3: X + Ẋ Δt + ½ Ẍ Δt².

    Args:
        jerk: square root of the jerk's spectral density [unit/s³ / √Hz].
        measurement_noise: (3, 3) covariance of a measured value.
    """
    identity, H = np.eye(3), np.eye(3, 9)

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

    return Model(f, lambda x: x[..., :3], Q, measurement_noise, F, lambda x: H)


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
