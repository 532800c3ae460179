"""Steady wind and Dryden gusts (MIL-F-8785C), discretised exactly.

Along the mean wind the gust is a first-order process, across and vertically a second-order one:
    H_u(s) = σ √(2L/(πV)) / (1 + (L/V) s),     H_v,w(s) = σ √(L/(πV)) (1 + √3 (L/V) s) / (1 + (L/V) s)².
Each is driven by white noise in state-space form and stepped by its matrix exponential, so that variance and spectrum
do not depend on the time step. The stationary distribution seeds it: an episode does not begin in still air.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm, solve_continuous_lyapunov

_FOOT = 0.3048


@dataclass(frozen=True)
class WindConfig:
    """Mean wind [m/s], gust standard deviation per axis [m/s], where it blows to, and Dryden's length scales."""

    mean_speed: float = 2.0
    gust_std: float = 0.5
    direction: float | None = None  # azimuth the mean wind blows towards, world frame [rad]; None: drawn per episode
    altitude: float = 3.1  # sets the length scales [m]; the model holds from 10 ft (3.05 m)

    def __post_init__(self) -> None:
        for name, low, high in (("mean_speed", 0.0, 15.0), ("gust_std", 0.0, 5.0), ("altitude", 3.0, 300.0)):
            value = getattr(self, name)
            if not np.isfinite(value) or not low <= value <= high:
                raise ValueError(f"WindConfig.{name} must be in [{low}, {high}], got {value}")
        if self.direction is not None and not np.isfinite(self.direction):
            raise ValueError(f"WindConfig.direction must be finite or None, got {self.direction}")

    def length_scales(self) -> tuple[float, float]:
        """(L_u = L_v, L_w) [m] at low altitude, MIL-F-8785C: L_w = h, L_u = h / (0.177 + 0.000823 h)^1.2, h in feet."""
        h = self.altitude / _FOOT
        return h / (0.177 + 0.000823 * h) ** 1.2 * _FOOT, h * _FOOT


WIND_LEVELS = {"calm": WindConfig(0.0, 0.0), "light": WindConfig(2.0, 0.5), "gusty": WindConfig(3.0, 1.0)}


@dataclass(frozen=True)
class DrydenCoefficients:
    """x⁺ = transition x + input w, gust = output x, with w standard normal.

    The state is (u; v₁, v₂; w₁, w₂): (5,). `input` is lower triangular, `initial` the Cholesky factor of the stationary
    covariance.
    """

    transition: NDArray[np.float64]  # (5, 5)
    input: NDArray[np.float64]  # (5, 5)
    output: NDArray[np.float64]  # (3, 5) along, across, up
    initial: NDArray[np.float64]  # (5, 5)


@lru_cache(maxsize=64)  # every reset asks, and matrix functions cost more than the rest of it
def dryden_coefficients(config: WindConfig, dt: float) -> DrydenCoefficients:
    """Exact discretisation for time step `dt` [s]; all zero where there are no gusts. The arrays are read-only."""
    a, g = np.zeros((5, 5)), np.zeros((5, 3))
    output = np.zeros((3, 5))
    if config.gust_std == 0.0:
        return _frozen(a, a, output, a)
    speed = max(config.mean_speed, 1.0)  # Dryden's frozen field needs a speed; in a calm mean the gusts still change
    along, vertical = config.length_scales()
    tau = along / speed
    a[0, 0], g[0, 0], output[0, 0] = -1.0 / tau, 1.0, np.sqrt(2.0 / tau)
    for axis, start, scale in ((1, 1, along), (2, 3, vertical)):
        tau = scale / speed
        a[start, start + 1] = 1.0
        a[start + 1, start], a[start + 1, start + 1] = -1.0 / tau**2, -2.0 / tau
        g[start + 1, axis] = 1.0
        output[axis, start], output[axis, start + 1] = tau**-1.5, np.sqrt(3.0) * tau**-0.5
    output *= config.gust_std
    stationary = solve_continuous_lyapunov(a, -g @ g.T)
    transition = expm(a * dt)
    step = stationary - transition @ stationary @ transition.T
    return _frozen(transition, np.linalg.cholesky(step), output, np.linalg.cholesky(stationary))


def _frozen(*arrays: NDArray[np.float64]) -> DrydenCoefficients:
    for array in arrays:
        array.flags.writeable = False
    return DrydenCoefficients(*arrays)


def dryden_spectrum(config: WindConfig, frequency: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3, M) two-sided power spectral density [(m/s)²/Hz] along, across and up at `frequency` (M,) [Hz]."""
    omega = 2.0 * np.pi * np.asarray(frequency, dtype=float)
    along, vertical = config.length_scales()
    speed = max(config.mean_speed, 1.0)
    rows = []
    for order, scale in ((1, along), (2, along), (2, vertical)):
        x = (omega * scale / speed) ** 2
        shape = 2.0 / (1.0 + x) if order == 1 else (1.0 + 3.0 * x) / (1.0 + x) ** 2
        rows.append(config.gust_std**2 * scale / speed * shape)
    return np.stack(rows)
