"""Points and normals as a Gaussian-process implicit surface takes them, after making sure that they can be used."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

UNIT_TOLERANCE = 1e-6
"""Largest deviation of a normal's length from one."""


class Observations(NamedTuple):
    """What was seen of a surface."""

    points: Array  # (N, D) [m]
    normals: Array | None  # (N, D) unit, outward
    deviations: Array  # (N,) or (N(1 + D),): standard deviation of each observation, values first


def check_points(points: ArrayLike, name: str) -> Array:
    """`points` as a finite float64 array (N, D) of its own.

    Raises:
        ValueError: naming the argument, and the shape or the first row that is wrong.
    """
    array = np.array(points, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] == 0:
        raise ValueError(f"{name}: expected shape (N, D), got {array.shape}")
    bad = ~np.isfinite(array).all(axis=1)
    if bad.any():
        raise ValueError(f"{name}: expected finite values, got {array[bad][0]} in row {int(bad.argmax())}")
    return array


def _deviations(value: ArrayLike, count: int, name: str) -> Array:
    sigma = np.asarray(value, dtype=np.float64)
    if sigma.shape not in ((), (count,)):
        raise ValueError(f"{name}: expected one number or shape ({count},), got {sigma.shape}")
    if not (np.isfinite(sigma) & (sigma >= 0.0)).all():
        wrong = sigma[~(sigma >= 0.0) | np.isinf(sigma)][0]
        raise ValueError(f"{name}: expected standard deviations ≥ 0, got {wrong}")
    return np.broadcast_to(sigma, count).copy()


def check_observations(
    points: ArrayLike, normals: ArrayLike | None, noise: ArrayLike, normal_noise: ArrayLike
) -> Observations:
    """Points (N, D) [m], unit normals (N, D) or None, and the deviations of both, each one or (N,).

    Raises:
        ValueError: no points; a value that is not finite; shapes that do not match; a normal that is zero or not of
            length one (to 1e-6); negative noise; points that coincide while their observations have no noise.
    """
    x = check_points(points, "points")
    if len(x) == 0:
        raise ValueError("points: expected at least one, got none")
    sigma = _deviations(noise, len(x), "noise")
    exact = sigma == 0.0
    n = None
    if normals is not None:
        n = check_normals(normals, x)
        turned = _deviations(normal_noise, len(x), "normal_noise")
        sigma = np.concatenate([sigma, np.repeat(turned, x.shape[1])])
        exact = exact | (turned == 0.0)
    distinct = np.unique(x[exact], axis=0)
    if len(distinct) < exact.sum():
        raise ValueError(
            f"points: expected distinct points where there is no noise, got {int(exact.sum()) - len(distinct)} "
            "duplicate(s); give noise or remove them"
        )
    return Observations(x, n, sigma)


def check_normals(normals: ArrayLike, points: Array) -> Array:
    """`normals` as a finite float64 array of the shape of `points` (N, D), each of length one.

    Raises:
        ValueError: naming the shape, or the first row that is wrong.
    """
    n = check_points(normals, "normals")
    if n.shape != points.shape:
        raise ValueError(f"normals: expected shape {points.shape} like the points, got {n.shape}")
    lengths = np.linalg.norm(n, axis=1)
    wrong = np.abs(lengths - 1.0) > UNIT_TOLERANCE
    if wrong.any():
        row = int(wrong.argmax())
        raise ValueError(f"normals: expected unit length (to {UNIT_TOLERANCE:g}), got {lengths[row]:g} in row {row}")
    return n
