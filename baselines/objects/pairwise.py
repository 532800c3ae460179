"""Compiled loops over pairs of points, for the blocks of an isotropic covariance k = φ(‖x − y‖) and its derivatives.

With r = x − y, a = φ'/d and b = a'/d: cov(f, ∂f') = −a r, cov(∂f, f') = a r and cov(∂f, ∂f') = −b r rᵀ − a I. The
profiles φ, a and b come in as matrices over all pairs, so that one loop serves every kernel.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


@njit(cache=True)
def fill_gram(x: Array, value: Array, first: Array, second: Array, out: Array) -> None:
    """Covariance (n, n), n = N(1 + D), of values and gradients at x (N, D) into `out`: values first.

    `value`, `first` and `second` are φ, a and b (N, N).
    """
    count, dimension = x.shape
    r = np.empty(dimension)
    for i in range(count):
        out[i, :count] = value[i]
        for j in range(count):
            a = first[i, j]
            for e in range(dimension):
                out[i, count + j * dimension + e] = -a * (x[i, e] - x[j, e])
    for i in range(count):
        for d in range(dimension):
            row = out[count + i * dimension + d]
            for j in range(count):
                a, b = first[i, j], second[i, j]
                for e in range(dimension):
                    r[e] = x[i, e] - x[j, e]
                row[j] = a * r[d]
                for e in range(dimension):
                    row[count + j * dimension + e] = -b * r[d] * r[e]
                row[count + j * dimension + d] -= a


@njit(cache=True)
def fill_cross(x: Array, y: Array, value: Array, first: Array, out: Array) -> None:
    """Covariance (M, N(1 + D)) of f at x (M, D) with values and gradients at y (N, D) into `out`: values first."""
    count, dimension = y.shape
    for i in range(len(x)):
        row = out[i]
        for j in range(count):
            row[j] = value[i, j]
            a = first[i, j]
            for e in range(dimension):
                row[count + j * dimension + e] = -a * (x[i, e] - y[j, e])


@njit(cache=True)
def reduce_weights(x: Array, lower: Array) -> tuple[Array, Array, Array]:
    """P, Q, S (N, N) with Σ W∘K = Σ P∘φ + Q∘a + S∘b for the covariance K of `fill_gram` and a symmetric W (n, n).

    Only the lower triangle of W is read. This makes the trace of W ∂K/∂θ cheap for any number of parameters θ.
    """
    count, dimension = x.shape
    values, firsts, seconds = np.zeros((count, count)), np.zeros((count, count)), np.zeros((count, count))
    for i in range(count):
        for j in range(i):
            values[i, j] = 2.0 * lower[i, j]
        values[i, i] = lower[i, i]
        for d in range(dimension):
            row = lower[count + i * dimension + d]
            for j in range(count):
                firsts[i, j] += 2.0 * row[j] * (x[i, d] - x[j, d])
            for j in range(i):
                inner = 0.0
                for e in range(dimension):
                    inner += row[count + j * dimension + e] * (x[i, e] - x[j, e])
                seconds[i, j] -= 2.0 * inner * (x[i, d] - x[j, d])
                firsts[i, j] -= 2.0 * row[count + j * dimension + d]
            firsts[i, i] -= row[count + i * dimension + d]
    return values, firsts, seconds


@njit(cache=True, fastmath={"reassoc", "contract", "nsz"})
def weighted_slopes(
    x: Array, y: Array, first: Array, second: Array, values: Array, slopes: Array, mean: Array, slope: Array
) -> None:
    """Adds Σ_j cov(f(x), ∂f(y_j))·slopes_j to `mean` (M,) and ∂ of the whole mean to `slope` (M, 3).

    x (M, 3), but y and the weights of the gradients `slopes` (3, N), so that the inner loop is vectorised; `first` and
    `second` are a and b (M, N), `values` (N,) the weights of the values.
    """
    count = y.shape[1]
    for i in range(len(x)):
        x0, x1, x2 = x[i, 0], x[i, 1], x[i, 2]
        total = g0 = g1 = g2 = 0.0
        for j in range(count):
            r0, r1, r2, a = x0 - y[0, j], x1 - y[1, j], x2 - y[2, j], first[i, j]
            inner = r0 * slopes[0, j] + r1 * slopes[1, j] + r2 * slopes[2, j]
            total += a * inner
            along = a * values[j] - second[i, j] * inner
            g0 += along * r0 - a * slopes[0, j]
            g1 += along * r1 - a * slopes[1, j]
            g2 += along * r2 - a * slopes[2, j]
        mean[i] -= total
        slope[i, 0] += g0
        slope[i, 1] += g1
        slope[i, 2] += g2
