"""The Cholesky factor of a Gram matrix, with what was done to get it and how far it can be trusted."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dlange, dpocon, dpotrf, dpotri

Array = NDArray[np.float64]

JITTERS = (1e-12, 1e-10, 1e-8, 1e-6)
"""Tried in turn once a Cholesky has failed, as fractions of the largest diagonal entry."""


class Factor(NamedTuple):
    """LLᵀ = K + jitter·I."""

    lower: Array  # (n, n), of which only the lower triangle counts: above it stands what was there before
    jitter: float  # added to the diagonal, in K's unit; 0.0 when nothing was
    condition: float  # estimate of ‖K‖₁ ‖K⁻¹‖₁, jitter included

    def solve(self, b: Array) -> Array:
        """(K + jitter·I)⁻¹ b for b (n,)."""
        half = solve_triangular(self.lower, b, lower=True, check_finite=False)
        return solve_triangular(self.lower, half, lower=True, trans="T", check_finite=False)

    def inverse(self) -> Array:
        """Lower triangle of (K + jitter·I)⁻¹ (n, n); above it stands anything."""
        inverse, _ = dpotri(self.lower, lower=1)
        return inverse

    @property
    def half_log_determinant(self) -> float:
        """½ log det(K + jitter·I)."""
        return float(np.log(np.diag(self.lower)).sum())

    @property
    def rounding(self) -> float:
        """Relative error that float64 may leave in a product with K⁻¹."""
        return 10.0 * np.finfo(np.float64).eps * max(self.condition, 1.0)


def factorise(gram: Array, jitters: tuple[float, ...] = JITTERS) -> Factor:
    """Cholesky factor of a symmetric positive definite matrix (n, n), with jitter only after a failure.

    The matrix is overwritten: with thousands of points a copy would cost as much memory again.

    Raises:
        LinAlgError (a ValueError): the matrix is not positive definite even with the largest jitter.
    """
    # LAPACK wants columns; a symmetric matrix in rows is its own transpose. The strict upper triangle survives the
    # factorisation and, with the diagonal kept aside, restores the matrix after a failure.
    columns = gram.T if gram.flags.c_contiguous else np.asfortranarray(gram)
    diagonal, norm = np.diag(columns).copy(), dlange("1", columns)
    scale, axes = float(diagonal.max()), np.arange(len(columns))
    for fraction in (0.0, *jitters):
        if fraction > 0.0:
            columns = np.asfortranarray(np.triu(columns, 1) + np.triu(columns, 1).T)
            columns[axes, axes] = diagonal + fraction * scale
        lower, failed = dpotrf(columns, lower=1, clean=0, overwrite_a=1)
        if not failed:
            reciprocal, _ = dpocon(lower, norm + fraction * scale, uplo="L")
            return Factor(lower, fraction * scale, 1.0 / reciprocal if reciprocal > 0.0 else np.inf)
    largest = max(jitters, default=0.0) * scale
    raise np.linalg.LinAlgError(
        f"Gram matrix: expected positive definite, got singular even with jitter {largest:.3g} on the diagonal; give "
        "noise, remove near-duplicate points, or (thin plate) raise the radius"
    )


def checked_variance(prior: Array, cross: Array, factor: Factor) -> Array:
    """prior − diag(C K⁻¹ Cᵀ) (M,) for cross-covariances C (M, n), no less than 0. Rasmussen & Williams, eq. 2.26.

    C is overwritten.

    Raises:
        LinAlgError (a ValueError): a variance is negative beyond rounding.
    """
    half = solve_triangular(factor.lower, cross.T, lower=True, overwrite_b=True, check_finite=False)
    variance = prior - np.einsum("nm,nm->m", half, half)
    tolerance = factor.rounding * prior.max()
    if variance.min() < -tolerance:
        raise np.linalg.LinAlgError(
            f"variance: expected ≥ 0 up to rounding ({tolerance:.1e}), got {variance.min():.3g}; "
            "(thin plate) raise the radius"
        )
    return np.maximum(variance, 0.0)
