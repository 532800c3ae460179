"""What the closed forms share: where an arm's axes meet, and which of the candidate angles hold."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.sim.kernel_math import compiled
from baselines.kinematics.arm import Arm, exactly
from baselines.kinematics.chain import forward_kernel, task_kernel

Array = NDArray[np.float64]

TOLERANCE = 1e-6  # of a branch's pose [m, rad]
_SLACK = 1e-9  # beyond a limit: rounding [rad]
_MEETING = 1e-9  # how closely axes must meet, as a share of the arm's length


class Structure(NamedTuple):
    """An arm at angle zero, in the frame of its poses."""

    axes: Array  # (n, 3) unit
    shoulder: Array  # (3,) where axes 0 and 1 cross
    elbow: Array  # (3,) on axis 2
    point: Array  # (3,) of link 2, which the first three joints place: the tool, or the wrist's centre
    T_tool: Array  # (4, 4)


def structure(arm: Arm, joints: int) -> Structure:
    """The arm's axes; `point` is where axes 3 and 4 cross, or, of four joints, the tool.

    Raises:
        ValueError: another number of joints, or first axes that do not cross.
    """
    if arm.n != joints:
        raise ValueError(f"arm: this closed form needs {joints} joints, got {arm.n}")
    poses = arm.link_poses(np.zeros(joints))
    axes = np.einsum("nij,nj->ni", poses[:-1, :3, :3], arm.axes)
    origins = poses[:-1, :3, 3]
    shoulder = crossing(arm, origins, axes, 0, 1)
    point = poses[-1, :3, 3] if joints == 4 else crossing(arm, origins, axes, 3, 4)
    return Structure(np.ascontiguousarray(axes), shoulder, origins[2].copy(), point.copy(), poses[-1].copy())


def crossing(arm: Arm, origins: Array, axes: Array, first: int, second: int) -> Array:
    """The point (3,) where two axes cross.

    Raises:
        ValueError: they are parallel or pass each other.
    """
    a, b, between = axes[first], axes[second], origins[second] - origins[first]
    normal = np.cross(a, b)
    area = float(normal @ normal)
    if area < 1e-12 or abs(between @ normal) > _MEETING * arm.length * math.sqrt(area):
        raise ValueError(
            f"arm: this closed form needs the axes of {arm.names[first]} and {arm.names[second]} to cross in a point"
        )
    meeting: Array = origins[first] + (np.cross(between, b) @ normal) / area * a
    return meeting


def distance_to_axis(point: Array, origin: Array, axis: Array) -> float:
    """How far a point (3,) lies from the line through `origin` along the unit `axis` [m]."""
    return float(np.linalg.norm(np.cross(point - origin, axis)))


def reference_angles(arm: Arm, reference: ArrayLike | None) -> Array:
    """The reference (n,), by default the middle of the ranges.

    Raises:
        ValueError: another shape, or not finite.
    """
    if reference is None:
        middle: Array = arm.limits.mean(axis=1)
        return middle
    return exactly(reference, (arm.n,), "reference")


@compiled
def holds(chain, limits, target, task, tolerance, q):
    """Whether a candidate (n,) fits the limits, once whole turns are taken off it in place, and meets the task."""
    n = q.shape[0]
    for i in range(n):
        middle = 0.5 * (limits[i, 0] + limits[i, 1])
        q[i] -= 2.0 * math.pi * math.floor((q[i] - middle) / (2.0 * math.pi) + 0.5)
        if not limits[i, 0] - _SLACK <= q[i] <= limits[i, 1] + _SLACK:
            return False
        q[i] = min(max(q[i], limits[i, 0]), limits[i, 1])
    tool, jacobian, error = np.empty((3, 4)), np.zeros((6, 1)), np.empty(6)
    forward_kernel(chain, q, tool)
    rows = task_kernel(task, tool, target, jacobian, error)
    worst = 0.0
    for r in range(rows):
        worst = max(worst, abs(error[r]))
    return worst <= tolerance


@compiled
def keep_new(found, count, q):
    """Append a candidate to found[:count] unless it is there already; returns how many there are then.

    Branches meet at singularities, where rounding is magnified to its square root.
    """
    for k in range(count):
        gap = 0.0
        for i in range(q.shape[0]):
            gap = max(gap, abs(found[k, i] - q[i]))
        if gap < 1e-6:
            return count
    found[count] = q
    return count + 1
