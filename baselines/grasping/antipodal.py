"""Grasps of two contacts, many at once: closed-form force closure, and margins of the line between the contacts.

Arrays lead with any number of axes: (samples, 2, 3), or (samples, grasps, 2, 3). Nguyen 1988, "Constructing
force-closure grasps", International Journal of Robotics Research 7(3).
"""

import math

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from baselines.grasping.contacts import Array, unit


def _rows(name: str, value: ArrayLike, tail: tuple[int, ...]) -> Array:
    """`value` as a contiguous finite array whose last axes are `tail`, or a ValueError that names it."""
    wanted = f"(..., {', '.join(map(str, tail))})"
    try:
        array = np.ascontiguousarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name}: expected an array of numbers of shape {wanted}, got {value!r}") from error
    if array.ndim < len(tail) or array.shape[array.ndim - len(tail) :] != tail:
        raise ValueError(f"{name}: expected shape {wanted}, got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name}: expected finite numbers, got NaN or infinity")
    return array


def _pairs(positions: ArrayLike, normals: ArrayLike) -> tuple[Array, Array]:
    """Checked positions (..., 2, 3) and unit normals of the same shape."""
    p, n = _rows("positions", positions, (2, 3)), _rows("normals", normals, (2, 3))
    if n.shape != p.shape:
        raise ValueError(f"normals: expected the shape of positions, {p.shape}, got {n.shape}")
    return p, unit("normals", n, n.shape)


def _friction(friction: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Checked friction, broadcast to (..., 2)."""
    mu = _rows("friction", friction, ())
    if (mu < 0.0).any():
        raise ValueError(f"friction: expected non-negative, got {mu.min()}")
    try:
        return np.ascontiguousarray(np.broadcast_to(mu, shape))
    except ValueError:
        raise ValueError(f"friction: expected a shape that broadcasts to {shape}, got {mu.shape}") from None


@njit(cache=True, nogil=True, error_model="numpy")
def _parts(p, n, along, across):
    """Of each pair (k, 2, 3): the line to the other contact, along each normal and across it, (k, 2)."""
    for k in range(p.shape[0]):
        for i in range(2):
            x = p[k, 1 - i, 0] - p[k, i, 0]
            y = p[k, 1 - i, 1] - p[k, i, 1]
            z = p[k, 1 - i, 2] - p[k, i, 2]
            a, b, c = n[k, i, 0], n[k, i, 1], n[k, i, 2]
            along[k, i] = x * a + y * b + z * c
            # the cross product keeps its digits where the line is close to the normal
            u, v, w = y * c - z * b, z * a - x * c, x * b - y * a
            across[k, i] = math.sqrt(u * u + v * v + w * w)


def _line_parts(p: Array, n: Array) -> tuple[Array, Array]:
    """`_parts` for (..., 2, 3): (..., 2) each."""
    along, across = np.empty(p.shape[:-1]), np.empty(p.shape[:-1])
    _parts(p.reshape(-1, 2, 3), n.reshape(-1, 2, 3), along.reshape(-1, 2), across.reshape(-1, 2))
    return along, across


def soft_antipodal(positions: ArrayLike, normals: ArrayLike, friction: ArrayLike = 0.5) -> NDArray[np.bool_]:
    """Force closure of pairs of soft contacts, exact for round cones and any torsion > 0 (Nguyen 1988).

    The line between the contacts has to lie strictly inside both friction cones, with the fingers pushing towards
    each other, or apart (from inside a hollow).

    Args:
        positions: (..., 2, 3) [m].
        normals: (..., 2, 3) unit, into the object.
        friction: μ, broadcast to (..., 2): one for all, (2,) per finger, or sampled as the contacts are.

    Returns:
        (...,) verdicts; contacts in the same place never close.

    Raises:
        ValueError: wrong shapes, numbers that are not finite, normals that are not unit, negative friction.
    """
    p, n = _pairs(positions, normals)
    mu = _friction(friction, p.shape[:-1])
    along, across = _line_parts(p, n)
    closed = (across < mu * along).all(axis=-1) | (across < -mu * along).all(axis=-1)
    return np.asarray(closed)


def closing_angles(positions: ArrayLike, normals: ArrayLike) -> Array:
    """The larger angle between the closing line and the two inward normals [rad]: the friction that the grasp needs.

    0 is a line along both normals, fingers pushing towards each other; soft contacts with friction μ squeeze in force
    closure where the angle is below atan μ. Fingers that push apart have angles above π/2.

    Args:
        positions: (..., 2, 3) [m].
        normals: (..., 2, 3) unit, into the object.

    Returns:
        (...,) in [0, π]; NaN where the contacts coincide and there is no line.

    Raises:
        ValueError: wrong shapes, numbers that are not finite, normals that are not unit.
    """
    p, n = _pairs(positions, normals)
    along, across = _line_parts(p, n)
    angles = np.arctan2(across, along).max(axis=-1)
    return np.where((p[..., 0, :] == p[..., 1, :]).all(axis=-1), np.nan, angles)


def line_distance(positions: ArrayLike, center: ArrayLike) -> Array:
    """Distance of the closing line from a point, such as the centre of mass [m]: the lever arm of the weight.

    Args:
        positions: (..., 2, 3) [m].
        center: broadcast to (..., 3) [m].

    Returns:
        (...,); NaN where the contacts coincide and there is no line.

    Raises:
        ValueError: wrong shapes, or numbers that are not finite.
    """
    p, c = _rows("positions", positions, (2, 3)), _rows("center", center, (3,))
    try:
        arm = np.broadcast_to(c, p.shape[:-2] + (3,)) - p[..., 0, :]
    except ValueError:
        raise ValueError(f"center: expected a shape that broadcasts to {p.shape[:-2] + (3,)}, got {c.shape}") from None
    line = p[..., 1, :] - p[..., 0, :]
    length = np.linalg.norm(line, axis=-1)
    with np.errstate(invalid="ignore"):
        return np.linalg.norm(np.cross(line, arm), axis=-1) / np.where(length > 0.0, length, np.nan)
