"""What a serial arm and its worm gripper are: frames, joints, masses and convex shapes, as plain frozen values.

One description feeds every model of an arm: MuJoCo's (`aerograsp_env.sim.arms.mjcf`), a URDF for other libraries
(`aerograsp_env.sim.arms.urdf`) and the kinematics of the baselines. Values hold arrays, which are read-only, and are
compared by identity.

Frames. Joint i turns link i about an axis through the joint's frame; that frame, turned by q_i, is the link's frame:
T_base_link0(q) = T_base_joint0 · Rot(axis_0, q_0), T_base_link1 = T_base_link0 · T_link0_joint1 · Rot(axis_1, q_1), …
The tool frame is the gripper frame of `aerograsp_env.sim.gripper`: origin midway between the pads, x along the closing
axis, z along the approach axis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.sim.arms.worm_gripper import WormGripper
from aerograsp_env.spatial import as_array, check_transform, skew, so3_exp, transform

Array = NDArray[np.float64]
Kind = Literal["capsule", "cylinder", "box"]

_SIZES = {"capsule": 2, "cylinder": 2, "box": 3}


def read_only(value: Array) -> Array:
    """An own copy that refuses to be written to."""
    value = np.array(value, dtype=np.float64)
    value.setflags(write=False)
    return value


def _exactly(value: ArrayLike, shape: tuple[int, ...], name: str) -> Array:
    array = as_array(value, shape, name)
    if array.shape != shape:
        raise ValueError(f"{name}: expected shape {shape}, got {array.shape}")
    return read_only(array)


def _pose(value: ArrayLike, name: str) -> Array:
    return read_only(check_transform(_exactly(value, (4, 4), name), name))


def _positive(owner: str, **values: float) -> None:
    for name, value in values.items():
        if not 0.0 < value < math.inf:
            raise ValueError(f"{owner}: expected a positive {name}, got {value}")


def _along(direction: Array) -> Array:
    """A rotation (3, 3) whose z axis is `direction` (3,), a unit vector."""
    other = np.eye(3)[np.argmin(np.abs(direction))]
    x = np.cross(other, direction)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(direction, x), direction], axis=1)


@dataclass(frozen=True, eq=False)
class Shape:
    """A convex collision shape. Capsules and cylinders lie along the z axis of their own frame.

    `size` is MuJoCo's: (radius, half of the length between the end centres) or the box's three half extents [m].

    Raises:
        ValueError: an unknown kind, a size of another length or not positive, or a pose that is not rigid.
    """

    name: str
    kind: Kind
    T_link_shape: Array
    size: tuple[float, ...]

    def __post_init__(self) -> None:
        if self.kind not in _SIZES:
            raise ValueError(f"{self.name}: kind must be one of {sorted(_SIZES)}, got {self.kind!r}")
        if len(self.size) != _SIZES[self.kind] or not all(0.0 < s < math.inf for s in self.size):
            raise ValueError(f"{self.name}: a {self.kind} needs {_SIZES[self.kind]} positive sizes, got {self.size!r}")
        object.__setattr__(self, "T_link_shape", _pose(self.T_link_shape, f"{self.name}: T_link_shape"))

    @classmethod
    def box(cls, name: str, center: ArrayLike, half_size: tuple[float, float, float]) -> Shape:
        """A box along the axes of its link."""
        return cls(name, "box", transform(np.eye(3), center), half_size)

    @classmethod
    def capsule(cls, name: str, start: ArrayLike, end: ArrayLike, radius: float) -> Shape:
        """Everything within `radius` of the segment from `start` to `end`."""
        return cls._round(name, "capsule", start, end, radius)

    @classmethod
    def cylinder(cls, name: str, start: ArrayLike, end: ArrayLike, radius: float) -> Shape:
        """A solid cylinder between the end faces' centres."""
        return cls._round(name, "cylinder", start, end, radius)

    @classmethod
    def _round(cls, name: str, kind: Kind, start: ArrayLike, end: ArrayLike, radius: float) -> Shape:
        a, b = _exactly(start, (3,), f"{name}: start"), _exactly(end, (3,), f"{name}: end")
        length = float(np.linalg.norm(b - a))
        if length == 0.0:
            raise ValueError(f"{name}: expected two different ends, got {a.tolist()} twice")
        return cls(name, kind, transform(_along((b - a) / length), 0.5 * (a + b)), (radius, 0.5 * length))

    def moved(self, T: ArrayLike, name: str | None = None) -> Shape:
        """The same shape seen from frame a, for T_a_link (4, 4)."""
        return Shape(name or self.name, self.kind, _pose(T, "T") @ self.T_link_shape, self.size)


@dataclass(frozen=True, eq=False)
class Joint:
    """A hinge and the position servo that drives it.

    Raises:
        ValueError: a pose that is not rigid, an axis that is not a unit vector, empty limits, or a rating that is not
            positive.
    """

    name: str
    T_parent_joint: Array  # (4, 4): the joint's frame in the parent link's, at q = 0
    axis: Array  # (3,) unit vector in the joint's frame
    limits: tuple[float, float]  # [rad]
    rate_limit: float  # no-load speed [rad/s]
    torque_limit: float  # stall torque at the joint [N m]
    stiffness: float  # proportional gain of the servo [N m/rad]
    damping: float  # derivative gain [N m s/rad]
    armature: float  # inertia of the motor seen through its gears [kg m²]

    def __post_init__(self) -> None:
        object.__setattr__(self, "T_parent_joint", _pose(self.T_parent_joint, f"{self.name}: T_parent_joint"))
        axis = _exactly(self.axis, (3,), f"{self.name}: axis")
        if abs(float(np.linalg.norm(axis)) - 1.0) > 1e-9:
            raise ValueError(f"{self.name}: axis must be a unit vector, got {axis.tolist()}")
        object.__setattr__(self, "axis", axis)
        low, high = self.limits
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise ValueError(f"{self.name}: limits must be finite with low < high, got {self.limits!r}")
        names = ("rate_limit", "torque_limit", "stiffness", "damping", "armature")
        _positive(self.name, **{n: getattr(self, n) for n in names})


@dataclass(frozen=True, eq=False)
class Link:
    """A rigid part and its shapes, in its own frame.

    Raises:
        ValueError: a mass that is not positive, or an inertia that no body has (not symmetric, not positive, or with a
            principal moment above the sum of the two others).
    """

    name: str
    mass: float  # [kg]
    center_of_mass: Array  # (3,) [m]
    inertia: Array  # (3, 3) about the centre of mass [kg m²]
    shapes: tuple[Shape, ...]

    def __post_init__(self) -> None:
        _positive(self.name, mass=self.mass)
        object.__setattr__(self, "center_of_mass", _exactly(self.center_of_mass, (3,), f"{self.name}: center_of_mass"))
        inertia = _exactly(self.inertia, (3, 3), f"{self.name}: inertia")
        if np.abs(inertia - inertia.T).max() > 1e-9 * np.abs(inertia).max():
            raise ValueError(f"{self.name}: inertia must be symmetric, got {inertia.tolist()}")
        low, middle, high = np.linalg.eigvalsh(inertia).tolist()
        if low <= 0.0 or high > (low + middle) * (1.0 + 1e-9):
            raise ValueError(f"{self.name}: no body has the principal moments {(low, middle, high)} kg m²")
        object.__setattr__(self, "inertia", inertia)


@dataclass(frozen=True, eq=False)
class ArmConfig:
    """A serial arm with a worm gripper at its end. Links weigh what they do without the fingers.

    Raises:
        ValueError: no joints, another number of links, names that repeat, or a configuration outside the limits.
    """

    name: str
    base: Link  # bolted to the vehicle; its frame is the arm's base frame, z out along the arm
    joints: tuple[Joint, ...]
    links: tuple[Link, ...]  # links[i] moves with joints[i]
    T_last_tool: Array  # (4, 4)
    gripper: WormGripper
    stowed: Array  # (n,) folded up, for transit [rad]
    home: Array  # (n,) ready above a grasp below the vehicle [rad]

    def __post_init__(self) -> None:
        if not self.joints or len(self.joints) != len(self.links):
            raise ValueError(f"{self.name}: one link per joint, got {len(self.joints)} joints, {len(self.links)} links")
        names = [j.name for j in self.joints] + [p.name for p in (self.base, *self.links)]
        if len(set(names)) != len(names):
            raise ValueError(f"{self.name}: names of joints and links must differ, got {names}")
        object.__setattr__(self, "T_last_tool", _pose(self.T_last_tool, f"{self.name}: T_last_tool"))
        for name in ("stowed", "home"):
            q = _exactly(getattr(self, name), (self.n,), f"{self.name}: {name}")
            if ((q < self.limits[:, 0]) | (q > self.limits[:, 1])).any():
                raise ValueError(f"{self.name}: {name} must lie within the joint limits, got {q.tolist()}")
            object.__setattr__(self, name, q)

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @property
    def limits(self) -> Array:
        """(n, 2) [rad]."""
        return np.array([j.limits for j in self.joints])

    @property
    def total_mass(self) -> float:
        """[kg] with base, gripper and fingers."""
        return sum(p.mass for p in (self.base, *self.links)) + 2.0 * self.gripper.finger_mass

    def link_poses(self, q: ArrayLike) -> Array:
        """(n + 1, 4, 4) poses of the links' frames and, last, of the tool, in the base frame.

        Raises:
            ValueError: not (n,) finite angles [rad].
        """
        q = _exactly(q, (self.n,), "q")
        poses, T = [], np.eye(4)
        for joint, angle in zip(self.joints, q, strict=True):
            T = T @ joint.T_parent_joint @ transform(so3_exp(angle * joint.axis), np.zeros(3))
            poses.append(T)
        return np.stack([*poses, T @ self.T_last_tool])

    def with_fingers(self, width: float | None = None) -> tuple[Link, ...]:
        """The links, the last one with the fingers on it, the pads `width` [m] apart (default: fully open).

        Raises:
            ValueError: a width outside [0, jaws.max_width].
        """
        gripper, last = self.gripper, self.links[-1]
        width = gripper.jaws.max_width if width is None else width
        if not 0.0 <= width <= gripper.jaws.max_width:
            raise ValueError(f"width: expected an opening in [0, {gripper.jaws.max_width}] m, got {width}")
        closed, R = 0.5 * (gripper.jaws.max_width - width), self.T_last_tool[:3, :3]
        parts = [(last.mass, last.center_of_mass, last.inertia)]
        inertia = R @ gripper.finger_inertia() @ R.T
        for finger in gripper.fingers():
            center = R @ (finger.center + [finger.closing * closed, 0.0, 0.0]) + self.T_last_tool[:3, 3]
            parts.append((gripper.finger_mass, center, inertia))
        return (*self.links[:-1], Link(last.name, *combined(parts), last.shapes))

    def mass_properties(self, q: ArrayLike) -> tuple[float, Array, Array]:
        """Mass [kg], centre of mass (3,) [m] and inertia about it (3, 3) [kg m²] of the whole arm, base frame."""
        poses = np.concatenate([np.eye(4)[None], self.link_poses(q)[:-1]])
        parts = []
        for T, part in zip(poses, (self.base, *self.with_fingers()), strict=True):
            R = T[:3, :3]
            parts.append((part.mass, R @ part.center_of_mass + T[:3, 3], R @ part.inertia @ R.T))
        return combined(parts)


def combined(parts: list[tuple[float, Array, Array]]) -> tuple[float, Array, Array]:
    """Mass, centre of mass and inertia about it of rigid parts in one frame, by the parallel-axis theorem."""
    mass = sum(m for m, _, _ in parts)
    center = np.sum([m * c for m, c, _ in parts], axis=0) / mass
    inertia = np.zeros((3, 3))
    for m, c, own in parts:
        r = skew(c - center)
        inertia += own - m * r @ r
    return mass, center, inertia
