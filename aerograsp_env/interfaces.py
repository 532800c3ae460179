"""What analytic and learned parts have in common: the `Policy` and `Detector` protocols, and the values they exchange.

Values are frozen: their small arrays are read-only float64 copies. Images are held as given, without a copy.
They compare by identity, since arrays have no single truth value.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.spatial import as_array, check_transform

Array = NDArray[np.float64]
Observation = NDArray[Any] | Mapping[str, NDArray[Any]]

UNIT_TOLERANCE = 1e-6
"""How far a unit vector's length, or the cosine of two orthogonal axes, may be off."""


def _frozen(array: Array) -> Array:
    copy = np.array(array, dtype=np.float64)
    copy.setflags(write=False)
    return copy


def _exact(value: Any, shape: tuple[int, ...], name: str) -> Array:
    """A finite read-only float64 copy of exactly `shape`."""
    array = as_array(value, shape, name)
    if array.ndim != len(shape):
        raise ValueError(f"{name}: expected shape {shape}, got {array.shape}")
    return _frozen(array)


def _pose(value: Any, name: str) -> Array:
    return _frozen(check_transform(_exact(value, (4, 4), name), name))


class _IntrinsicsFields(NamedTuple):
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: Array | None = None
    T_color_depth: Array | None = None


class Intrinsics(_IntrinsicsFields):
    """Pinhole camera, in OpenCV's frame and order; the centre of the top left pixel is (0, 0).

    Fields:
        width, height: image size [px].
        fx, fy, cx, cy: focal lengths and principal point [px].
        distortion: (4,), (5,), (8,), (12,) or (14,) in OpenCV's order (k1, k2, p1, p2, k3, …), or None for none.
        T_color_depth: (4, 4), maps the depth camera's coordinates to the colour camera's; None if depth is registered.

    Raises:
        ValueError: for a size that is not positive, focal lengths that are not positive, or arrays of a wrong shape.
    """

    __slots__ = ()

    def __new__(
        cls,
        width: int,
        height: int,
        fx: float,
        fy: float,
        cx: float,
        cy: float,
        distortion: Any = None,
        T_color_depth: Any = None,
    ) -> Self:
        for name, size in (("width", width), ("height", height)):
            if not isinstance(size, (int, np.integer)) or size < 1:
                raise ValueError(f"{name}: expected a positive whole number of pixels, got {size}")
        for name, focal in (("fx", fx), ("fy", fy)):
            if not 0.0 < focal < math.inf:
                raise ValueError(f"{name}: expected a positive focal length [px], got {focal}")
        for name, center in (("cx", cx), ("cy", cy)):
            if not math.isfinite(center):
                raise ValueError(f"{name}: expected a finite coordinate [px], got {center}")
        if distortion is not None:
            count = np.size(distortion)
            if count not in (4, 5, 8, 12, 14):
                raise ValueError(f"distortion: expected 4, 5, 8, 12 or 14 coefficients, got {count}")
            distortion = _exact(distortion, (count,), "distortion")
        if T_color_depth is not None:
            T_color_depth = _pose(T_color_depth, "T_color_depth")
        camera = (int(width), int(height), float(fx), float(fy), float(cx), float(cy))
        return super().__new__(cls, *camera, distortion, T_color_depth)

    @classmethod
    def _make(cls, iterable: Iterable[Any]) -> Self:  # type: ignore[override]  # mypy's own signature cannot be written
        return cls(*iterable)  # so that _replace is checked too

    @property
    def matrix(self) -> Array:
        """(3, 3) camera matrix [px]."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])


@dataclass(frozen=True, eq=False)
class RGBD:
    """One frame of a colour and depth camera.

    Raises:
        ValueError: for shapes or types other than those below, depth that is negative or not finite, or a stamp that
            is not finite.
    """

    rgb: NDArray[np.uint8]  # (H, W, 3)
    depth: NDArray[np.float32]  # (H, W) [m] along the optical axis, 0 where there is no return
    intrinsics: Intrinsics  # of the colour camera
    stamp: float = 0.0  # [s]
    T_world_camera: Array | None = None  # (4, 4), None where it is not known

    def __post_init__(self) -> None:
        if not isinstance(self.intrinsics, Intrinsics):
            raise ValueError(f"intrinsics: expected Intrinsics, got {type(self.intrinsics).__name__}")
        size = (self.intrinsics.height, self.intrinsics.width)
        for name, shape, dtype in (("rgb", (*size, 3), np.uint8), ("depth", size, np.float32)):
            image = getattr(self, name)
            if not isinstance(image, np.ndarray) or image.shape != shape or image.dtype != dtype:
                got = f"{image.shape} {image.dtype}" if isinstance(image, np.ndarray) else type(image).__name__
                raise ValueError(f"{name}: expected an array of {shape} {np.dtype(dtype).name}, got {got}")
        if not (np.isfinite(self.depth).all() and (self.depth >= 0).all()):
            raise ValueError("depth: expected finite values ≥ 0 [m], with 0 where there is no return")
        if not math.isfinite(self.stamp):
            raise ValueError(f"stamp: expected a finite time [s], got {self.stamp}")
        if self.T_world_camera is not None:
            object.__setattr__(self, "T_world_camera", _pose(self.T_world_camera, "T_world_camera"))


@dataclass(frozen=True, eq=False)
class Detection:
    """One object found in an image.

    Raises:
        ValueError: for an empty label, a score outside [0, 1], a box without extent, a pose that is not rigid, or a
            covariance that is not symmetric and positive semi-definite.
    """

    label: str  # the object's class
    score: float  # confidence in [0, 1]
    box: Array  # (4,) xyxy [px]
    T_c_object: Array | None = None  # (4, 4) object to camera, None from a detector of boxes only
    covariance: Array | None = None  # (6, 6) of the pose: camera-frame position [m²], then rotation vector [rad²]

    def __post_init__(self) -> None:
        if not self.label:
            raise ValueError("label: expected the name of a class, got an empty string")
        if not 0.0 <= self.score <= 1.0:
            raise ValueError(f"score: expected a value in [0, 1], got {self.score}")
        box = _exact(self.box, (4,), "box")
        if not (box[0] < box[2] and box[1] < box[3]):
            raise ValueError(f"box: expected x1 < x2 and y1 < y2, got {box.tolist()}")
        object.__setattr__(self, "box", box)
        if self.T_c_object is not None:
            object.__setattr__(self, "T_c_object", _pose(self.T_c_object, "T_c_object"))
        if self.covariance is not None:
            covariance = _exact(self.covariance, (6, 6), "covariance")
            size = np.abs(covariance).max()
            if np.abs(covariance - covariance.T).max() > 1e-9 * size:
                raise ValueError("covariance: expected a symmetric matrix")
            if (smallest := np.linalg.eigvalsh(covariance)[0]) < -1e-9 * size:
                raise ValueError(f"covariance: expected no negative eigenvalue, got {smallest:.3g}")
            object.__setattr__(self, "covariance", covariance)


@dataclass(frozen=True, eq=False)
class Grasp:
    """A parallel-jaw grasp, in the frame of the cloud that it was planned on.

    Raises:
        ValueError: for axes that are not unit vectors (to 1e-6) or not orthogonal, or a width that is not positive.
    """

    center: Array  # (3,) [m] midway between the fingertips
    closing_axis: Array  # (3,) unit, the line along which the fingers close; its sign has no meaning
    approach_axis: Array  # (3,) unit, from the palm towards the object
    width: float  # [m] opening between the fingertips before closing

    def __post_init__(self) -> None:
        for name in ("center", "closing_axis", "approach_axis"):
            object.__setattr__(self, name, _exact(getattr(self, name), (3,), name))
        for name in ("closing_axis", "approach_axis"):
            if abs((length := np.linalg.norm(getattr(self, name))) - 1.0) > UNIT_TOLERANCE:
                raise ValueError(f"{name}: expected a unit vector, got length {length:.9g}")
        if abs(cosine := float(self.closing_axis @ self.approach_axis)) > UNIT_TOLERANCE:
            raise ValueError(f"approach_axis: expected an axis orthogonal to closing_axis, got cosine {cosine:.3g}")
        if not 0.0 < self.width < math.inf:
            raise ValueError(f"width: expected a positive opening [m], got {self.width}")


@runtime_checkable
class Policy(Protocol):
    """Anything that acts: a controller, a planner or a trained network.

    The signature is Stable-Baselines3's, so its models are policies as they are, and policies run in its
    `evaluate_policy`. A policy sees only the observation; constants are given to it at construction.
    """

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[Any], Any]:
        """The action for an observation, and the state to pass in with the next one.

        Args:
            observation: an array or a dict of arrays, of one world (dim,) or of N worlds (N, dim).
            state: what the last call returned, never modified in place; None starts every world afresh.
            episode_start: (N,) bool: worlds that start afresh whatever `state` says; None is none of them.
            deterministic: whether equal inputs give equal actions.

        Returns:
            The action, (n,) or (N, n) in [−1, 1], and the next state.
        """
        ...


@runtime_checkable
class Oracle(Policy, Protocol):
    """A policy that reads the simulator's truth: an upper bound to compare with, listed as one."""

    def watch(self, worlds: Sequence[Any]) -> None:
        """Be told which unwrapped environments it acts in, row by row, before the first `predict`."""
        ...


@runtime_checkable
class Detector(Protocol):
    """Anything that finds objects in an image: the twin of `Policy` for single frames."""

    def detect(self, frame: RGBD) -> list[Detection]:
        """The objects found in `frame`, best score first; an empty list if there are none."""
        ...
