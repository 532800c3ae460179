"""The Cholesky factor of a Gram matrix, with what was done to get it and how far it can be trusted."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular
from scipy.linalg.lapack import dpocon

Array = NDArray[np.float64]

JITTERS = (1e-12, 1e-10, 1e-8, 1e-6)
"""Tried in turn once a Cholesky has failed, as fractions of the largest diagonal entry."""


class Factor(NamedTuple):
    """LLᵀ = K + jitter·I."""

    lower: Array  # (n, n)
    jitter: float  # added to the diagonal, in K's unit; 0.0 when nothing was
    condition: float  # estimate of ‖K‖₁ ‖K⁻¹‖₁, jitter included

    def solve(self, b: Array) -> Array:
        """(K + jitter·I)⁻¹ b for b (n,)."""
        half = solve_triangular(self.lower, b, lower=True, check_finite=False)
        return solve_triangular(self.lower, half, lower=True, trans="T", check_finite=False)

    @property
    def half_log_determinant(self) -> float:
        """½ log det(K + jitter·I)."""
        return float(np.log(np.diag(self.lower)).sum())

    @property
    def rounding(self) -> float:
        """Relative error that float64 may leave in a product with K⁻¹."""
        return 10.0 * np.finfo(np.float64).eps * max(self.condition, 1.0)


def factorise(gram: Array) -> Factor:
    """Cholesky factor of a symmetric positive definite matrix (n, n), with jitter only after a failure.

    Raises:
        LinAlgError (a ValueError): the matrix is not positive definite even with the largest jitter.
    """
    scale = float(np.diag(gram).max())
    for fraction in (0.0, *JITTERS):
        shifted = gram if fraction == 0.0 else gram + fraction * scale * np.eye(len(gram))
        try:
            lower = cholesky(shifted, lower=True, check_finite=False)
        except np.linalg.LinAlgError:
            continue
        reciprocal, _ = dpocon(lower, np.abs(shifted).sum(axis=0).max(), uplo="L")
        return Factor(lower, fraction * scale, 1.0 / reciprocal if reciprocal > 0.0 else np.inf)
    raise np.linalg.LinAlgError(
        f"Gram matrix: expected positive definite, got singular even with jitter {JITTERS[-1] * scale:.3g} on the "
        "diagonal; give noise, remove near-duplicate points, or (thin plate) raise the radius"
    )


def checked_variance(prior: Array, cross: Array, factor: Factor) -> Array:
    """prior − diag(C K⁻¹ Cᵀ) (M,) for cross-covariances C (M, n), no less than 0. Rasmussen & Williams, eq. 2.26.

    Raises:
        LinAlgError (a ValueError): a variance is negative beyond rounding.
    """
    half = solve_triangular(factor.lower, cross.T, lower=True, check_finite=False)
    variance = prior - np.einsum("nm,nm->m", half, half)
    tolerance = factor.rounding * prior.max()
    if variance.min() < -tolerance:
        raise np.linalg.LinAlgError(
            f"variance: expected ≥ 0 up to rounding ({tolerance:.1e}), got {variance.min():.3g}; "
            "(thin plate) raise the radius"
        )
    return np.maximum(variance, 0.0)
