"""Joint posterior covariances of a Gaussian process and its gradient. Rasmussen & Williams 2006, eq. 2.24 and 9.4."""

from collections.abc import Iterator

import numpy as np
from scipy.linalg import solve_triangular

from baselines.objects.kernels import Kernel
from baselines.objects.linear_algebra import Array, Factor
from baselines.objects.observations import Observations

CHUNK_ENTRIES = 2**20
"""Entries of the largest block of cross-covariance held at a time (8 MB in float64)."""

_TOGETHER = 16  # points whose prior covariances are taken from one Gram matrix


def chunks(count: int, size: int) -> Iterator[slice]:
    """Slices of 0 … count, `size` or at least one at a time."""
    size = max(size, 1)
    return (slice(start, min(start + size, count)) for start in range(0, count, size))


def joint_covariance(kernel: Kernel, data: Observations, factor: Factor, groups: Array, gradients: bool) -> Array:
    """Posterior covariance (G, n, n) within each group of points (G, K, D), in `Kernel.gram`'s order: K values, then,
    where said, the gradients point by point."""
    count, size, dimension = groups.shape
    n = size * (1 + dimension) if gradients else size
    if not count * n:
        return np.empty((count, n, n))
    out = _prior(kernel, groups, gradients)
    for part in chunks(len(groups), CHUNK_ENTRIES // (n * len(factor.lower))):
        cross = _cross(kernel, data, groups[part], gradients)
        columns = cross.reshape(-1, cross.shape[-1]).T
        half = solve_triangular(factor.lower, columns, lower=True, check_finite=False).T.reshape(cross.shape)
        out[part] -= half @ half.transpose(0, 2, 1)
    return out


def _cross(kernel: Kernel, data: Observations, groups: Array, gradients: bool) -> Array:
    """Covariance (G, n, N) of each group's values and gradients with all N observations."""
    count, size, dimension = groups.shape
    x, y, normals = groups.reshape(-1, dimension), data.points, data.normals is not None
    values = kernel.cross(x, y, normals)
    n = values.shape[1]
    if not gradients:
        return values.reshape(count, size, n)
    slopes = np.empty((len(x), dimension, n))
    slopes[..., : len(y)] = kernel.gradient(y, x).transpose(1, 2, 0)
    if normals:
        slopes[..., len(y) :] = kernel.hessian(x, y).transpose(0, 2, 1, 3).reshape(len(x), dimension, -1)
    return np.concatenate([values.reshape(count, size, n), slopes.reshape(count, size * dimension, n)], axis=1)


def _prior(kernel: Kernel, groups: Array, gradients: bool) -> Array:
    """The same (G, n, n) before any observation."""
    count, size, dimension = groups.shape
    n = size * (1 + dimension) if gradients else size
    out = np.empty((count, n, n))
    for part in chunks(count, _TOGETHER // size):
        points = groups[part].reshape(-1, dimension)
        gram = kernel.gram(points, gradients)
        first = np.arange(0, len(points), size)[:, None]
        at = first + np.arange(size)
        if gradients:
            at = np.concatenate([at, len(points) + dimension * first + np.arange(dimension * size)], axis=1)
        out[part] = gram[at[:, :, None], at[:, None, :]]
    return out
