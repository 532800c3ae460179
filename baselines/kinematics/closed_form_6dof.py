"""The closed form of arms of six joints whose last three axes meet in a point: up to eight configurations a pose.

Position and orientation part there (Pieper 1968): the first three joints place the wrist's centre in up to four ways,
the last three turn the tool in two for each, all by Paden–Kahan subproblems (Murray, Li & Sastry 1994, section 3.3,
example 3.5). The thesis has IKFast for this (section 2.4).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.sim.kernel_math import compiled
from aerograsp_env.spatial import check_transform
from baselines.kinematics.arm import Arm, exactly
from baselines.kinematics.closed_form import (
    TOLERANCE,
    Structure,
    distance_to_axis,
    holds,
    keep_new,
    reference_angles,
    structure,
)
from baselines.kinematics.subproblems import angle_between, cross, out_of_reach, rotated, shoulder_angles, two_angles

Array = NDArray[np.float64]


def branches_6dof(arm: Arm, T_target: ArrayLike, reference: ArrayLike | None = None) -> Array:
    """Every configuration (k, 6) within the limits, k ≤ 8, at which the tool's pose is the target's [rad].

    At a singularity (wrist straight, or its centre over the base) a family of configurations meets the pose: the one
    that keeps the reference's angle stands for it.

    Args:
        arm: the arm.
        T_target: the tool's pose (4, 4).
        reference: (6,) angles of joints that may stand anywhere; the middle of the ranges by default.

    Raises:
        ValueError: an arm of another structure, a target that is not a rigid transform, or a reference that is not
            (n,) finite angles.
    """
    shape = six_joints(arm)
    target = np.ascontiguousarray(exactly(check_transform(T_target, "T_target"), (4, 4), "T_target"))
    found = np.empty((8, 6))
    count = branches_kernel(
        arm.chain, arm.limits, shape.axes, shape.shoulder, shape.elbow, shape.point, shape.T_tool, target,
        reference_angles(arm, reference), TOLERANCE, found,
    )  # fmt: skip
    return found[:count]


@lru_cache(maxsize=16)
def six_joints(arm: Arm) -> Structure:
    """The arm's structure, checked.

    Raises:
        ValueError: not six joints, first axes that do not cross, or last three that do not meet in a point.
    """
    shape = structure(arm, 6)
    origin = arm.link_poses(np.zeros(6))[5, :3, 3]
    if distance_to_axis(shape.point, origin, shape.axes[5]) > 1e-9 * arm.length:
        raise ValueError(f"arm: this closed form needs the axes of {', '.join(arm.names[3:])} to meet in one point")
    if np.linalg.norm(np.cross(shape.axes[4], shape.axes[5])) < 1e-6:
        raise ValueError(f"arm: this closed form needs the axes of {arm.names[4]} and {arm.names[5]} to cross")
    return shape


@compiled
def branches_kernel(chain, limits, axes, shoulder, elbow, point, T_tool, target, reference, tolerance, found):
    """Writes the configurations into `found` (8, 6); returns how many."""
    q = np.empty(6)
    # where the wrist's centre must be: it is fixed in the tool
    offset = np.empty(3)
    for r in range(3):
        offset[r] = 0.0
        for k in range(3):
            offset[r] += T_tool[k, r] * (point[k] - T_tool[k, 3])
    center = np.empty(3)
    for r in range(3):
        center[r] = target[r, 3] + target[r, 0] * offset[0] + target[r, 1] * offset[1] + target[r, 2] * offset[2]
    if out_of_reach(shoulder, elbow, point, center, tolerance):
        return 0
    # how the last axis, and one across it, must point: R_target R_tool(0)ᵀ of what they do at zero
    last = axes[5]
    across = cross(axes[4], last)
    last_goal, across_goal = _turned(target, T_tool, last), _turned(target, T_tool, across)
    count = 0
    for bend in (1.0, -1.0):
        for lean in (1.0, -1.0):
            q[0], q[1], q[2] = shoulder_angles(axes, shoulder, elbow, point, center, reference, bend, lean)
            wanted, side = _undone(axes, q, 3, last_goal), _undone(axes, q, 3, across_goal)
            for flip in (1.0, -1.0):
                q[3], q[4] = two_angles(axes[3], axes[4], last, wanted, reference[3], reference[4], flip)
                seen = rotated(axes[4], -q[4], rotated(axes[3], -q[3], side))
                q[5] = angle_between(last, across, seen, reference[5])
                trial = q.copy()
                if holds(chain, limits, target, 0, tolerance, trial):
                    count = keep_new(found, count, trial)
    return count


@compiled
def _turned(target, T_tool, v):
    """R_target R_toolᵀ v."""
    x, y, z = 0.0, 0.0, 0.0
    for k in range(3):
        part = T_tool[0, k] * v[0] + T_tool[1, k] * v[1] + T_tool[2, k] * v[2]
        x += target[0, k] * part
        y += target[1, k] * part
        z += target[2, k] * part
    return x, y, z


@compiled
def _undone(axes, q, count, v):
    """v as seen before the first `count` joints turned."""
    for i in range(count):
        v = rotated(axes[i], -q[i], v)
    return v
