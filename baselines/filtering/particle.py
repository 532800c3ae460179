"""A bootstrap particle filter on the same models as the Kalman filters."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.filtering.kalman import gate_distance, time_step
from baselines.filtering.model import Array, Belief, Innovation, Model, read_only, square_root, vector


@dataclass(frozen=True, eq=False)
class ParticleBelief:
    """Weighted particles; read-only arrays.

    Raises:
        ValueError: shapes disagree, a value is not finite, or the weights are no distribution.
    """

    particles: Array  # (N, n)
    weights: Array  # (N,), non-negative, sum 1
    innovation: Innovation | None = None  # of the update this belief came from

    def __post_init__(self) -> None:
        particles = np.array(self.particles, dtype=np.float64)
        if particles.ndim != 2 or not particles.size:
            raise ValueError(f"particles: expected shape (N, n), got {particles.shape}")
        if not np.isfinite(particles).all():
            raise ValueError("particles: expected finite numbers")
        weights = vector(self.weights, "weights", len(particles))
        if (weights < 0.0).any() or not np.isclose(weights.sum(), 1.0, rtol=0.0, atol=1e-9):
            raise ValueError(f"weights: expected non-negative numbers that sum to 1, got the sum {weights.sum()}")
        object.__setattr__(self, "particles", read_only(particles))
        object.__setattr__(self, "weights", read_only(weights))

    @cached_property
    def mean(self) -> Array:
        """The weighted mean, (n,)."""
        return read_only(self.weights @ self.particles)

    @cached_property
    def covariance(self) -> Array:
        """The weighted covariance, (n, n)."""
        deviation = self.particles - self.mean
        return read_only(_gram(deviation, self.weights))

    @property
    def effective_size(self) -> float:
        """1 / Σw², between 1 and N (Kong, Liu & Wong 1994)."""
        return float(1.0 / np.sum(self.weights**2))


class ParticleFilter:
    """Bootstrap filter (Gordon, Salmond & Smith 1993): moves particles by the model's noise, weighs them by z.

    Particles are resampled systematically at the start of a prediction, once their effective number has fallen below
    `resample_below` of all: estimates after an update are then those of the weighted set, without resampling noise.

    Args:
        model: the model to filter with; its functions must broadcast over leading axes.
        gate: probability in (0, 1) or None, as for the Kalman filters.
        rng: the only source of randomness.
        particles: how many.
        resample_below: fraction in [0, 1]; 0 never resamples, 1 always.

    Raises:
        ValueError: an argument outside its range.
    """

    def __init__(
        self,
        model: Model,
        gate: float | None = None,
        *,
        rng: np.random.Generator,
        particles: int = 1000,
        resample_below: float = 0.5,
    ) -> None:
        if not isinstance(rng, np.random.Generator):
            raise ValueError(f"rng: expected a numpy.random.Generator, got {type(rng).__name__}")
        if particles < 2:
            raise ValueError(f"particles: expected at least 2, got {particles}")
        if not 0.0 <= resample_below <= 1.0:
            raise ValueError(f"resample_below: expected a fraction in [0, 1], got {resample_below}")
        self.model = model
        self.gate = gate
        self.particles = int(particles)
        self.resample_below = resample_below
        self._rng = rng
        self._gate_distance = gate_distance(gate, model.measurement_size)
        # R = CᵀC whitens residuals: |C⁻ᵀ r|² = rᵀ R⁻¹ r.
        self._whitening = np.linalg.inv(np.linalg.cholesky(model.measurement_noise))

    def initial(self, mean: ArrayLike, covariance: ArrayLike) -> ParticleBelief:
        """Particles drawn from the Gaussian of mean (n,) and covariance (n, n), equally weighted."""
        gaussian = Belief(np.asarray(mean), np.asarray(covariance))
        return ParticleBelief(gaussian.mean + self._noise(gaussian.covariance), self._equal_weights())

    def predict(self, belief: ParticleBelief, dt: float, u: Any = None) -> ParticleBelief:
        """The belief dt seconds [s] later, under the model's input u.

        Raises:
            ValueError: dt is negative or not finite, or the model returns something of a wrong shape or not finite.
        """
        dt = time_step(dt)
        particles, weights = self._sized(belief).particles, belief.weights
        if belief.effective_size < self.resample_below * self.particles:
            particles = particles[systematic_resample(weights, self._rng)]
            weights = self._equal_weights()
        moved = self.model.f(particles, u, dt)
        return ParticleBelief(moved + self._noise(self.model.Q(dt, particles.shape[1])), weights)

    def update(self, belief: ParticleBelief, z: ArrayLike) -> ParticleBelief:
        """The belief given the measurement z (m,); its `innovation` tells what came of it.

        Raises:
            ValueError: z has another shape or is not finite.
        """
        z = vector(np.atleast_1d(z), "z", self.model.measurement_size)
        weights = self._sized(belief).weights
        residuals = self.model.residual(z, self.model.h(belief.particles))
        residual = weights @ residuals
        S = _gram(residuals - residual, weights) + self.model.measurement_noise
        distance = float(residual @ np.linalg.solve(S, residual))
        innovation = Innovation(residual, S, distance, distance <= self._gate_distance)
        if not innovation.accepted:
            return replace(belief, innovation=innovation)
        # In logarithms, so that a measurement far from every particle still ranks them instead of dividing 0 by 0.
        with np.errstate(divide="ignore"):
            log_weights = np.log(weights) - 0.5 * np.sum((residuals @ self._whitening.T) ** 2, axis=1)
        weights = np.exp(log_weights - log_weights.max())
        return ParticleBelief(belief.particles, weights / weights.sum(), innovation)

    def _noise(self, covariance: Array) -> Array:
        return self._rng.standard_normal((self.particles, len(covariance))) @ square_root(covariance)

    def _equal_weights(self) -> Array:
        return np.full(self.particles, 1.0 / self.particles)

    def _sized(self, belief: ParticleBelief) -> ParticleBelief:
        if len(belief.particles) != self.particles:
            raise ValueError(f"belief: expected {self.particles} particles, got {len(belief.particles)}")
        return belief


def systematic_resample(weights: Array, rng: np.random.Generator) -> NDArray[np.intp]:
    """N indices drawn with one random offset, each i about N·wᵢ times (Kitagawa 1996).

    It equals `filterpy.monte_carlo.systematic_resample` at the same offset; that one draws from numpy's global
    generator, so it cannot be used where results must repeat.
    """
    total = np.cumsum(weights)
    positions = (rng.random() + np.arange(len(total))) / len(total)
    # Rounding must neither pass the end nor reach a weight of zero there.
    positions = np.minimum(positions, np.nextafter(1.0, 0.0))
    return np.searchsorted(total / total[-1], positions, side="right")


def _gram(deviation: Array, weights: Array) -> Array:
    matrix = (deviation * weights[:, None]).T @ deviation
    return 0.5 * (matrix + matrix.T)
