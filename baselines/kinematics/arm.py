"""Serial arms of revolute joints: poses, Jacobians and limits, from plain arrays, the project's arms or a URDF."""

from __future__ import annotations

from dataclasses import dataclass, field
from os import PathLike
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.sim.kernel_math import compiled
from aerograsp_env.spatial import as_array, check_transform, transform
from baselines.kinematics.chain import columns_kernel, frames_kernel

if TYPE_CHECKING:
    from aerograsp_env.sim.arms.description import ArmConfig

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Arm:
    """A serial arm. Poses are in the frame that `T_base` leads to: the arm's base by default, else e.g. the body.

    Args:
        placements: T_parent_joint (n, 4, 4): each joint's frame in the one before it (the first in the base frame), at
            angle zero.
        axes: (n, 3) each joint's unit axis in its own frame.
        limits: (n, 2) lowest and highest angle [rad].
        T_tool: T_last_tool (4, 4), the tool in the last joint's frame.
        T_base: (4, 4) the base frame in the frame that poses are given in.
        names: of the joints; "joint0" … by default.

    Raises:
        ValueError: an array of another shape or not finite, a placement that is not a rigid transform, an axis that is
            not unit to 1e-6, limits that are not in order, or names that are not n different ones.
    """

    placements: Array
    axes: Array
    limits: Array
    T_tool: Array = field(default_factory=lambda: np.eye(4))
    T_base: Array = field(default_factory=lambda: np.eye(4))
    names: tuple[str, ...] = ()
    chain: Array = field(
        init=False, repr=False
    )  # (n + 1, 3, 4), for the compiled kernels: see baselines.kinematics.chain
    length: float = field(init=False, repr=False)  # from the first joint along the chain to the tool [m]
    _turns: Array = field(init=False, repr=False)  # (n, 3, 3) that bring z to the joint's axis

    def __post_init__(self) -> None:
        placements = check_transform(self.placements, "placements")
        count = len(placements)
        if placements.ndim != 3 or count == 0:
            raise ValueError(f"placements: expected shape (n, 4, 4), n > 0, got {placements.shape}")
        axes = exactly(self.axes, (count, 3), "axes")
        lengths = np.linalg.norm(axes, axis=1)
        if np.any(np.abs(lengths - 1.0) > 1e-6):
            raise ValueError(f"axes: expected unit vectors, got lengths {lengths.tolist()}")
        limits = exactly(self.limits, (count, 2), "limits")
        if np.any(limits[:, 0] >= limits[:, 1]):
            raise ValueError(f"limits: expected lower < upper for every joint, got {limits.tolist()}")
        T_tool, T_base = (
            exactly(check_transform(T, name), (4, 4), name)
            for T, name in ((self.T_tool, "T_tool"), (self.T_base, "T_base"))
        )
        names = tuple(self.names) or tuple(f"joint{i}" for i in range(count))
        if len(set(names)) != count or len(names) != count:
            raise ValueError(f"names: expected {count} different ones, got {names}")
        turns = _turns_to(axes / lengths[:, None])
        after = np.concatenate([placements @ transform(turns, np.zeros(3)), T_tool[None]])
        before = np.concatenate([np.eye(3)[None], np.swapaxes(turns, 1, 2)])
        chain = transform(before, np.zeros(3)) @ after
        chain[0] = T_base @ chain[0]
        values = dict(placements=placements, axes=axes, limits=limits, T_tool=T_tool, T_base=T_base)
        for name, value in (values | dict(chain=chain[:, :3].copy(), _turns=turns)).items():
            value = np.array(value)
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        object.__setattr__(self, "names", names)
        object.__setattr__(self, "length", float(np.linalg.norm(chain[1:, :3, 3], axis=1).sum()))

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.placements)

    def forward(self, q: ArrayLike) -> Array:
        """T_base_tool (..., 4, 4) at joint angles q (..., n) [rad]; limits are not enforced.

        Raises:
            ValueError: q has another shape or is not finite.
        """
        return self._run(q)[1]

    def jacobian(self, q: ArrayLike) -> Array:
        """d(tool velocity; angular velocity) / d(joint rates), (..., 6, n): linear first, axes of the base frame.

        Raises:
            ValueError: q has another shape or is not finite.
        """
        return self._run(q)[2]

    def link_poses(self, q: ArrayLike) -> Array:
        """Poses (..., n + 1, 4, 4) of the frame of each joint's link, and last of the tool.

        Raises:
            ValueError: q has another shape or is not finite.
        """
        frames, tool, _ = self._run(q)
        links = frames @ transform(np.swapaxes(self._turns, 1, 2), np.zeros(3))
        return np.concatenate([links, tool[..., None, :, :]], axis=-3)

    def within_limits(self, q: ArrayLike, slack: float = 0.0) -> NDArray[np.bool_]:
        """Whether every joint of q (..., n) lies within its limits, or at most `slack` [rad] beyond.

        Raises:
            ValueError: q has another shape or is not finite.
        """
        q = as_array(q, (self.n,), "q")
        inside: NDArray[np.bool_] = np.all((q >= self.limits[:, 0] - slack) & (q <= self.limits[:, 1] + slack), axis=-1)
        return inside

    def at_base(self, T_base: ArrayLike) -> Arm:
        """The same arm with its base elsewhere, e.g. at its mount in the body frame."""
        return Arm(self.placements, self.axes, self.limits, self.T_tool, np.asarray(T_base, np.float64), self.names)

    def _run(self, q: ArrayLike) -> tuple[Array, Array, Array]:
        q = as_array(q, (self.n,), "q")
        flat = np.ascontiguousarray(q.reshape(-1, self.n))
        shape, n = q.shape[:-1], self.n
        frames, tools = np.zeros((len(flat), n, 4, 4)), np.zeros((len(flat), 4, 4))
        jacobians = np.empty((len(flat), 6, n))
        frames[..., 3, 3] = tools[..., 3, 3] = 1.0
        _run_kernel(self.chain, flat, frames, tools, jacobians)
        return frames.reshape(*shape, n, 4, 4), tools.reshape(*shape, 4, 4), jacobians.reshape(*shape, 6, n)

    @classmethod
    def from_config(cls, config: ArmConfig, T_base: ArrayLike | None = None) -> Arm:
        """The kinematics of an arm's description; poses in its base frame, or in the one `T_base` (4, 4) leads to."""
        joints = config.joints
        return cls(
            placements=np.array([joint.T_parent_joint for joint in joints]),
            axes=np.array([joint.axis for joint in joints]),
            limits=np.array([joint.limits for joint in joints]),
            T_tool=np.asarray(config.T_last_tool),
            T_base=np.eye(4) if T_base is None else np.asarray(T_base, np.float64),
            names=tuple(joint.name for joint in joints),
        )

    @classmethod
    def hecatonquiros_4dof(cls, T_base: ArrayLike | None = None) -> Arm:
        """The 4-DoF arm of Aquiles (thesis section 5.2)."""
        from aerograsp_env.sim.arms.hecatonquiros import HECATONQUIROS_4DOF

        return cls.from_config(HECATONQUIROS_4DOF, T_base)

    @classmethod
    def hecatonquiros_6dof(cls, T_base: ArrayLike | None = None) -> Arm:
        """The 6-DoF arm of Belerofonte (thesis section 5.3)."""
        from aerograsp_env.sim.arms.hecatonquiros import HECATONQUIROS_6DOF

        return cls.from_config(HECATONQUIROS_6DOF, T_base)

    @classmethod
    def from_urdf(cls, path: str | PathLike[str], base: str | None = None, tip: str | None = None) -> Arm:
        """The chain between two links of a URDF: `urdf_chain.read_chain`.

        Args:
            path: of the file.
            base: link in whose frame poses are given; the root by default.
            tip: link that is the tool; by default the only one without children.

        Raises:
            FileNotFoundError: no such file, or a mesh that it names is missing.
            ValueError: not a URDF; unknown links or joints; a joint that is neither revolute, continuous nor fixed; a
                branching chain without `tip`; a moving link without mass or inertia; a chain that moves nothing.
        """
        from baselines.kinematics.urdf_chain import read_chain

        read = read_chain(path, base, tip)
        return cls(read.placements, read.axes, read.limits, read.T_tool, names=read.names)


def exactly(value: ArrayLike, shape: tuple[int, ...], name: str) -> Array:
    """`value` as a finite float64 array of this shape and no other.

    Raises:
        ValueError: naming the argument, the expected and the actual shape, or the first value that is not finite.
    """
    array = as_array(value, shape, name)
    if array.shape != shape:
        raise ValueError(f"{name}: expected shape {shape}, got {array.shape}")
    return array


def _turns_to(axes: Array) -> Array:
    """(n, 3, 3) rotations that take z to each unit axis."""
    away = np.eye(3)[np.argmin(np.abs(axes), axis=1)]
    x = np.cross(away, axes)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack([x, np.cross(axes, x), axes], axis=2)


@compiled
def _run_kernel(chain, q, frames, tools, jacobians):
    for k in range(q.shape[0]):
        frames_kernel(chain, q[k], frames[k], tools[k])
        columns_kernel(frames[k], tools[k], jacobians[k])
