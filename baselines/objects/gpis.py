"""Gaussian-process implicit surfaces: a surface {f = 0} with its uncertainty, from points and normals on it.

Observations are f(x_i) = 0 and, with normals, ∂f(x_i) = n_i (f < 0 inside, normals outward). With N points in D
dimensions the Gram matrix is N × N, or N(1 + D) square with normals: first all values, then the gradients point by
point.

Sources: Williams & Fitzgibbon 2007, "Gaussian process implicit surfaces"; Rasmussen & Williams 2006, Alg. 2.1 and
section 9.4 (derivative observations); Dragiev, Toussaint & Gienger 2011 (normals).
"""

import math
from collections.abc import Collection
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
import trimesh
from numpy.typing import ArrayLike

from baselines.objects.kernels import Kernel
from baselines.objects.likelihood import Bounds, log_likelihood, maximise, scaled
from baselines.objects.linear_algebra import Array, Factor, checked_variance, factorise
from baselines.objects.observations import Observations, check_observations, check_points
from baselines.objects.posterior import CHUNK_ENTRIES, chunks, joint_covariance
from baselines.objects.priors import Constant, Prior
from baselines.objects.surface import MAX_CELLS, approach, check_resolution, mesh, walk

CHUNK_PAIRS = 2**13
"""Pairs of query and observation at a time for the mean, few enough to stay in cache and off fresh pages."""


class Prediction(NamedTuple):
    """What the process says at M points."""

    mean: Array  # (M,)
    gradient: Array | None  # (M, D), of the mean; None unless asked for
    variance: Array | None  # (M,), of f without noise; None unless asked for


@dataclass(frozen=True)
class Optimization:
    """What `GPIS.optimize` found."""

    model: "GPIS"  # a new model, fitted to the same observations
    before: float  # log marginal likelihood
    after: float
    converged: bool
    active: tuple[str, ...]  # parameters that ended on a bound: the data asks for more than was allowed
    evaluations: int
    message: str


class _Fit(NamedTuple):
    observations: Observations
    factor: Factor
    residual: Array  # (n,) targets less the prior mean
    weights: Array  # (n,) K_y⁻¹ residual


class GPIS:
    """A Gaussian process over an implicit function, with a geometric prior mean.

    Args:
        kernel: covariance of f less its prior mean; with normals or gradients a differentiable one.
        prior: mean function; None is zero everywhere.
        noise: standard deviation of the observed values, ≥ 0.
        normal_noise: standard deviation of each component of the observed normals, ≥ 0.

    Attributes:
        jitter: what was added to the diagonal of the Gram matrix for its Cholesky factor to exist; 0.0 when nothing.
        condition: estimate of the Gram matrix's condition number in the 1-norm.

    Raises:
        ValueError: a noise is negative or not finite, or kernel and prior are for different dimensions.
    """

    def __init__(
        self, kernel: Kernel, prior: Prior | None = None, noise: float = 1e-2, normal_noise: float = 5e-2
    ) -> None:
        self.kernel = kernel
        self.prior: Prior = Constant(0.0) if prior is None else prior
        dimensions = {d for d in (kernel.dimension, self.prior.dimension) if d is not None}
        if len(dimensions) > 1:
            raise ValueError(f"prior: expected one for {kernel.dimension}-D points like the kernel, got {self.prior}")
        self.dimension: int | None = dimensions.pop() if dimensions else None
        for name, value in (("noise", noise), ("normal_noise", normal_noise)):
            if not 0.0 <= value < np.inf:
                raise ValueError(f"{name}: expected a standard deviation ≥ 0, got {value}")
        self.noise, self.normal_noise = float(noise), float(normal_noise)
        self._fit: _Fit | None = None

    def __repr__(self) -> str:
        state = "not fitted" if self._fit is None else f"{len(self._fit.observations.points)} points"
        return f"GPIS({self.kernel}, {self.prior}, noise={self.noise}, normal_noise={self.normal_noise}; {state})"

    @property
    def observations(self) -> Observations:
        """What it was fitted to."""
        return self._fitted().observations

    @property
    def jitter(self) -> float:
        return self._fitted().factor.jitter

    @property
    def condition(self) -> float:
        return self._fitted().factor.condition

    def fit(
        self,
        points: ArrayLike,
        normals: ArrayLike | None = None,
        noise: ArrayLike | None = None,
        normal_noise: ArrayLike | None = None,
    ) -> Self:
        """Condition on points of the surface; replaces what was fitted before, unless it fails.

        Args:
            points: (N, D) [m], N ≥ 1.
            normals: (N, D) unit vectors pointing out, or None for values only.
            noise: standard deviation of the values, one or (N,); None takes the model's.
            normal_noise: standard deviation of a normal's components, one or (N,); None takes the model's.

        Returns:
            The model itself.

        Raises:
            ValueError: bad points, normals or noise; points that coincide without noise; normals with a kernel that
                is not differentiable; (LinAlgError) a Gram matrix that stays singular under the largest jitter.
        """
        data = check_observations(
            points,
            normals,
            self.noise if noise is None else noise,
            self.normal_noise if normal_noise is None else normal_noise,
        )
        self._check_dimension(data.points, "points")
        return self._condition(data)

    def _condition(self, data: Observations) -> Self:
        gram = self.kernel.gram(data.points, data.normals is not None)
        gram[np.diag_indices_from(gram)] += data.deviations**2
        factor = factorise(gram)
        residual = -self.prior.value(data.points)
        if data.normals is not None:
            residual = np.concatenate([residual, (data.normals - self.prior.gradient(data.points)).ravel()])
        self._fit = _Fit(data, factor, residual, factor.solve(residual))
        return self

    def predict(self, x: ArrayLike, gradient: bool = False, variance: bool = False) -> Prediction:
        """Posterior mean at x (M, D) [m], with its gradient and the variance of f where asked for.

        Works through x in chunks: beyond the results, memory does not grow with M.

        Raises:
            ValueError: bad x; a gradient from a kernel without one; (LinAlgError) a variance that is negative beyond
                rounding, which a kernel out of its range gives.
            RuntimeError: the model is not fitted.
        """
        fit = self._fitted()
        x = check_points(x, "x")
        self._check_dimension(x, "x")
        mean = self.prior.value(x)
        slope = self.prior.gradient(x) if gradient else None
        spread = self.kernel.diagonal(x) if variance else None
        points = fit.observations.points
        values, slopes = fit.weights[: len(points)], None
        if fit.observations.normals is not None:
            slopes = fit.weights[len(points) :].reshape(points.shape)
        for part in chunks(len(x), CHUNK_PAIRS // len(points)):
            mean_part, slope_part = self.kernel.weighted(x[part], points, values, slopes, gradient)
            mean[part] += mean_part
            if slope is not None and slope_part is not None:
                slope[part] += slope_part
        if spread is not None:
            for part in chunks(len(x), CHUNK_ENTRIES // len(fit.weights)):
                spread[part] = checked_variance(spread[part], self._cross(x[part]), fit.factor)
        return Prediction(mean, slope, spread)

    def covariance(self, x: ArrayLike, gradients: bool = False) -> Array:
        """Joint posterior covariance (..., n, n) of f, without noise, at each group of points x (..., M, D) [m].

        n = M; with `gradients` the M values are followed by the gradients, point by point: n = M(1 + D). A group's
        points are taken together, groups are independent of each other: (P, 2, D) are P pairs.

        Raises:
            ValueError: bad x, or gradients of a kernel without them.
            RuntimeError: the model is not fitted.
        """
        fit = self._fitted()
        array = np.asarray(x, dtype=np.float64)
        flat = array.reshape(math.prod(array.shape[:-1]), array.shape[-1]) if array.ndim > 2 else array
        points = check_points(flat, "x")
        self._check_dimension(points, "x")
        groups = points.reshape(math.prod(array.shape[:-2]), *array.shape[-2:])
        found = joint_covariance(self.kernel, fit.observations, fit.factor, groups, gradients)
        return found.reshape(*array.shape[:-2], *found.shape[1:])

    def sample(self, x: ArrayLike, n: int, rng: np.random.Generator) -> Array:
        """n joint draws (n, M) of f, without noise, at x (M, D) [m] from the posterior.

        Raises:
            ValueError: bad x or a negative n; (LinAlgError) a covariance that is not positive semi-definite beyond
                rounding.
            RuntimeError: the model is not fitted.
        """
        fit = self._fitted()
        if n < 0:
            raise ValueError(f"n: expected a number of draws ≥ 0, got {n}")
        mean = self.predict(x).mean
        x = np.asarray(x, dtype=np.float64)
        covariance = self.covariance(x)
        # The posterior covariance is singular near the data, where Cholesky fails: take the symmetric root.
        eigenvalues, vectors = np.linalg.eigh(covariance)
        tolerance = fit.factor.rounding * self.kernel.diagonal(x).max(initial=0.0) * max(len(x), 1)
        if eigenvalues.size and eigenvalues[0] < -tolerance:
            raise np.linalg.LinAlgError(
                f"covariance: expected eigenvalues ≥ 0 up to rounding ({tolerance:.1e}), got {eigenvalues[0]:.3g}"
            )
        root = vectors * np.sqrt(np.maximum(eigenvalues, 0.0))
        return mean + rng.standard_normal((n, len(x))) @ root.T

    def log_marginal_likelihood(self) -> float:
        """log p(observations | points, kernel, prior, noise), normals included. Rasmussen & Williams 2006, eq. 2.30.

        Raises:
            RuntimeError: the model is not fitted.
        """
        fit = self._fitted()
        return log_likelihood(fit.factor, fit.residual, fit.weights)

    def optimize(
        self,
        bounds: Bounds | None = None,
        fixed: Collection[str] = (),
        restarts: int = 0,
        rng: np.random.Generator | None = None,
        max_iterations: int = 100,
    ) -> Optimization:
        """Maximise the marginal likelihood over the kernel's parameters and the noise; this model stays as it is.

        The parameters are the kernel's fields (`length_scale`, `variance`, `radius`) and `noise` and, with normals,
        `normal_noise`: factors on the standard deviations that were fitted, starting at 1. What is 0 stays 0.

        Args:
            bounds: (low, high) by name, around the present value; a hundredth to a hundred times it unless given (a
                thin plate's radius only upwards).
            fixed: names of parameters that keep their value.
            restarts: further starts, drawn within the bounds, log-uniformly.
            rng: the generator that draws them.
            max_iterations: of each start.

        Raises:
            ValueError: see `maximise`.
            RuntimeError: the model is not fitted.
        """
        fit = self._fitted()
        data = fit.observations
        found = maximise(self.kernel, data, fit.residual, bounds or {}, fixed, restarts, rng, max_iterations)
        model = GPIS(
            found.kernel, self.prior, self.noise * found.noise_factor, self.normal_noise * found.normal_noise_factor
        )
        model._condition(scaled(data, found.noise_factor, found.normal_noise_factor))
        before, after = self.log_marginal_likelihood(), model.log_marginal_likelihood()
        return Optimization(model, before, after, found.converged, found.active, found.evaluations, found.message)

    def surface(self, resolution: float, sigma: float = 0.0, max_cells: int = MAX_CELLS) -> trimesh.Trimesh:
        """Mesh of {mean = sigma · standard deviation}, followed from the data: (N, 3) points only.

        sigma = 0 is the estimated surface. A shell of sigma > 0 encloses the object with confidence, one of sigma < 0
        is enclosed by it. Pieces that no data is near are left out. The mesh is watertight with outward normals where
        the level set is closed; `metadata["evaluated"]` counts the points at which the process was evaluated.

        Args:
            resolution: edge of a cell [m].
            sigma: number of standard deviations.
            max_cells: bound on the cells that are visited.

        Raises:
            ValueError: a resolution that is not positive; points that are not in space; (SurfaceError) no surface near
                the data, or one with more than `max_cells` cells, as where it has no end.
            RuntimeError: the model is not fitted.
        """
        points = self._fitted().observations.points
        check_resolution(resolution)
        if points.shape[1] != 3:
            raise ValueError(f"points: expected a model of points in space for a surface, got {points.shape[1]}-D ones")

        def level(x: Array) -> Array:
            mean, _, variance = self.predict(x, variance=sigma != 0.0)
            return mean if variance is None else mean - sigma * np.sqrt(variance)

        def slope(x: Array) -> Array:
            gradient = self.predict(x, gradient=True).gradient
            assert gradient is not None
            return gradient

        walked = walk(level, approach(level, slope, points, resolution), resolution, max_cells)
        found = mesh(walked)
        found.metadata["evaluated"] = len(walked.keys)
        return found

    def _fitted(self) -> _Fit:
        if self._fit is None:
            raise RuntimeError("GPIS: expected a fitted model; call fit(points) first")
        return self._fit

    def _check_dimension(self, x: Array, name: str) -> None:
        expected = self.dimension if self._fit is None or name == "points" else self._fit.observations.points.shape[1]
        if expected is not None and x.shape[1] != expected:
            raise ValueError(f"{name}: expected shape (N, {expected}), got {x.shape}")

    def _cross(self, x: Array) -> Array:
        """Covariance (M, n) of f at x with all observations."""
        data = self._fitted().observations
        return self.kernel.cross(x, data.points, data.normals is not None)
