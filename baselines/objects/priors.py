"""Prior means m(x) of a Gaussian-process implicit surface: m < 0 inside the shape, 0 on it, > 0 outside.

Every prior gives ``value`` (N,) and ``gradient`` (N, 3) at points x (N, 3) of the world frame [m]; shapes are posed by
``T_world_object``. Shapes are scaled so that the gradient has length one on the surface, exactly or (ellipsoid) on
average: what unit normals are observations of. All are continuously differentiable.

Source: Martens, Poffet, Ramon Soria, Fitch & Sukkarieh 2017, "Geometric priors for Gaussian process implicit surfaces".
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import logsumexp, softmax

from aerograsp_env.spatial import as_array, check_transform

Array = NDArray[np.float64]


class Prior(ABC):
    """A mean function with its gradient."""

    dimension: ClassVar[int | None] = 3  # of the points; None takes any

    @abstractmethod
    def value(self, x: Array) -> Array:
        """m(x) (N,) for x (N, D)."""

    @abstractmethod
    def gradient(self, x: Array) -> Array:
        """∂m/∂x (N, D) for x (N, D)."""


@dataclass(frozen=True)
class Constant(Prior):
    """m = level everywhere, in any number of dimensions; positive says "outside unless seen".

    Raises:
        ValueError: level is not finite.
    """

    level: float = 0.0
    dimension: ClassVar[int | None] = None

    def __post_init__(self) -> None:
        if not np.isfinite(self.level):
            raise ValueError(f"level: expected a finite number, got {self.level}")

    def value(self, x: Array) -> Array:
        return np.full(len(x), float(self.level))

    def gradient(self, x: Array) -> Array:
        return np.zeros(x.shape)


def _lengths(value: ArrayLike, count: int, name: str) -> tuple[float, ...]:
    array = as_array(value, (count,), name)
    if array.shape != (count,) or (array <= 0.0).any():
        raise ValueError(f"{name}: expected {count} positive length(s) [m], got {array.tolist()}")
    return tuple(map(float, array))


def _pose(T_world_object: ArrayLike | None) -> Array:
    T = check_transform(np.eye(4) if T_world_object is None else T_world_object, "T_world_object")
    if T.shape != (4, 4):
        raise ValueError(f"T_world_object: expected one (4, 4) transform, got shape {T.shape}")
    T = T.copy()
    T.setflags(write=False)
    return T


@dataclass(frozen=True, eq=False)
class Posed(Prior):
    """Any prior moved as a whole: m(Rᵀ(x − t)).

    Args:
        prior: given in its own frame.
        T_world_object: (4, 4), its frame in the world.

    Raises:
        ValueError: T_world_object is no rigid transform.
    """

    prior: Prior
    T_world_object: ArrayLike

    def __post_init__(self) -> None:
        object.__setattr__(self, "T_world_object", _pose(self.T_world_object))

    def value(self, x: Array) -> Array:
        return self.prior.value(_local(self.T_world_object, x))

    def gradient(self, x: Array) -> Array:
        return self.prior.gradient(_local(self.T_world_object, x)) @ np.asarray(self.T_world_object)[:3, :3].T


def _local(T_world_object: ArrayLike, x: Array) -> Array:
    T = np.asarray(T_world_object)
    return (x - T[:3, 3]) @ T[:3, :3]


@dataclass(frozen=True, eq=False)
class _Quadric(Prior):
    """h/2 (xᵀAx − 1) with diagonal A and x in the object's frame; the shapes below say A and h."""

    T_world_object: ArrayLike | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        object.__setattr__(self, "T_world_object", _pose(self.T_world_object))

    @abstractmethod
    def _form(self) -> tuple[Array, float]:
        """The diagonal of A (3,) [1/m²], and h [m]."""

    def value(self, x: Array) -> Array:
        diagonal, h = self._form()
        return 0.5 * h * (_local(np.asarray(self.T_world_object), x) ** 2 @ diagonal - 1.0)

    def gradient(self, x: Array) -> Array:
        T = np.asarray(self.T_world_object)
        diagonal, h = self._form()
        return (h * diagonal * _local(T, x)) @ T[:3, :3].T


@dataclass(frozen=True, eq=False)
class Sphere(_Quadric):
    """(‖x‖² − r²)/2r. Raises ValueError for a radius [m] that is not positive or a pose that is not rigid."""

    radius: float

    def __post_init__(self) -> None:
        super().__post_init__()
        _lengths([self.radius], 1, "radius")

    def _form(self) -> tuple[Array, float]:
        return np.full(3, self.radius**-2), self.radius


@dataclass(frozen=True, eq=False)
class Ellipsoid(_Quadric):
    """h/2 (x²/a² + y²/b² + z²/c² − 1), h the mean of a, b and c.

    Args:
        axes: half lengths (a, b, c) [m].
        T_world_object: (4, 4) pose of centre and axes; None is the identity.

    Raises:
        ValueError: axes are not three positive lengths, or the pose is not rigid.
    """

    axes: Sequence[float]

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "axes", _lengths(self.axes, 3, "axes"))

    def _form(self) -> tuple[Array, float]:
        axes = np.asarray(self.axes)
        return axes**-2.0, float(axes.mean())


@dataclass(frozen=True, eq=False)
class Cylinder(_Quadric):
    """(x² + y² − r²)/2r, endless along z: an ellipsoid with c → ∞. Errors as for the sphere."""

    radius: float

    def __post_init__(self) -> None:
        super().__post_init__()
        _lengths([self.radius], 1, "radius")

    def _form(self) -> tuple[Array, float]:
        return np.array([1.0, 1.0, 0.0]) / self.radius**2, self.radius


@dataclass(frozen=True)
class Plane(Prior):
    """nᵀx − offset: the half-space against the normal is inside.

    Args:
        normal: unit vector (3,), pointing out.
        offset: distance of the plane from the origin along the normal [m].

    Raises:
        ValueError: the normal is not of length one (to 1e-6), or the offset is not finite.
    """

    normal: Sequence[float] = (0.0, 0.0, 1.0)
    offset: float = 0.0

    def __post_init__(self) -> None:
        normal = as_array(self.normal, (3,), "normal")
        if normal.shape != (3,) or abs(np.linalg.norm(normal) - 1.0) > 1e-6:
            raise ValueError(f"normal: expected a unit vector (3,), got {normal.tolist()}")
        if not np.isfinite(self.offset):
            raise ValueError(f"offset: expected a finite length [m], got {self.offset}")
        object.__setattr__(self, "normal", tuple(map(float, normal)))

    def value(self, x: Array) -> Array:
        return x @ np.asarray(self.normal) - self.offset

    def gradient(self, x: Array) -> Array:
        return np.tile(np.asarray(self.normal), (len(x), 1))


@dataclass(frozen=True, eq=False)
class FinitePlane(Prior):
    """A rectangular plate with rounded rim: (d² − t²)/2t, d the distance to a rectangle in the plane z = 0.

    The squared distance to a convex set is continuously differentiable, so no edge shows in the gradient.

    Args:
        size: lengths of the rectangle along x and y [m].
        thickness: 2t [m].
        T_world_object: (4, 4) pose of its centre; None is the identity.

    Raises:
        ValueError: a length is not positive, or the pose is not rigid.
    """

    size: Sequence[float]
    thickness: float
    T_world_object: ArrayLike | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        object.__setattr__(self, "T_world_object", _pose(self.T_world_object))
        object.__setattr__(self, "size", _lengths(self.size, 2, "size"))
        _lengths([self.thickness], 1, "thickness")

    def _offset(self, x: Array) -> Array:
        """From the nearest point of the rectangle to x, in the object's frame (N, 3)."""
        local, half = _local(np.asarray(self.T_world_object), x), 0.5 * np.array([*self.size, 0.0])
        return local - np.clip(local, -half, half)

    def value(self, x: Array) -> Array:
        t = 0.5 * self.thickness
        return ((self._offset(x) ** 2).sum(axis=1) - t**2) / (2.0 * t)

    def gradient(self, x: Array) -> Array:
        return self._offset(x) / (0.5 * self.thickness) @ np.asarray(self.T_world_object)[:3, :3].T


@dataclass(frozen=True, eq=False)
class SmoothUnion(Prior):
    """−s log Σ exp(−m_i/s): below the least of its parts by at most s log(number of parts), and smooth.

    Args:
        parts: the priors that it joins, at least one.
        smoothing: s [m], the rounding of the seam.

    Raises:
        ValueError: there are no parts, or the smoothing is not positive.
    """

    parts: Sequence[Prior]
    smoothing: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "parts", tuple(self.parts))
        if not self.parts:
            raise ValueError("parts: expected at least one prior, got none")
        _lengths([self.smoothing], 1, "smoothing")

    def _exponents(self, x: Array) -> Array:
        return -np.stack([part.value(x) for part in self.parts]) / self.smoothing

    def value(self, x: Array) -> Array:
        return -self.smoothing * logsumexp(self._exponents(x), axis=0)

    def gradient(self, x: Array) -> Array:
        weights = softmax(self._exponents(x), axis=0)
        return np.einsum("pn,pnd->nd", weights, np.stack([part.gradient(x) for part in self.parts]))
