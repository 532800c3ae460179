"""The closed form of arms of four joints whose last turns the tool about its approach axis (thesis section 5.2).

Yaw and shoulder axes cross, the elbow's lies anywhere, and the tool lies on the last axis: so the first three joints
take it to a position in up to four ways, and the fourth chooses its roll about the approach axis. All offsets are the
arm's own. The thesis prints the law of cosines of a plane arm; here it is part of the Paden–Kahan subproblems.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.sim.kernel_math import compiled
from aerograsp_env.spatial import check_transform
from baselines.kinematics.arm import Arm, exactly
from baselines.kinematics.chain import POSITION, POSITION_ROLL, forward_kernel, roll_kernel
from baselines.kinematics.closed_form import (
    TOLERANCE,
    Structure,
    distance_to_axis,
    holds,
    keep_new,
    reference_angles,
    structure,
)
from baselines.kinematics.subproblems import out_of_reach, shoulder_angles

Array = NDArray[np.float64]


def branches_4dof(arm: Arm, T_target: ArrayLike, reference: ArrayLike | None = None, roll: bool = True) -> Array:
    """Every configuration (k, 4) within the limits, k ≤ 4, at which the tool has the target's position and roll [rad].

    Args:
        arm: the arm.
        T_target: the tool's pose (4, 4). Of its rotation only the roll counts: what remains after the smallest rotation
            that aligns the approach axes.
        reference: (4,) angles of joints that may stand anywhere; the middle of the ranges by default.
        roll: whether the roll counts; the last joint keeps its reference otherwise.

    Raises:
        ValueError: an arm of another structure, a target that is not a rigid transform, or a reference that is not
            (n,) finite angles.
    """
    shape = four_joints(arm)
    target = np.ascontiguousarray(exactly(check_transform(T_target, "T_target"), (4, 4), "T_target"))
    found = np.empty((4, 4))
    count = branches_kernel(
        arm.chain, arm.limits, shape.axes, shape.shoulder, shape.elbow, shape.point, shape.T_tool, target,
        reference_angles(arm, reference), POSITION_ROLL if roll else POSITION, TOLERANCE, found,
    )  # fmt: skip
    return found[:count]


@lru_cache(maxsize=16)
def four_joints(arm: Arm) -> Structure:
    """The arm's structure, checked.

    Raises:
        ValueError: not four joints, first axes that do not cross, or a tool that the last joint moves or tilts.
    """
    shape = structure(arm, 4)
    origin = arm.link_poses(np.zeros(4))[3, :3, 3]
    approach = shape.T_tool[:3, 2]
    if distance_to_axis(shape.point, origin, shape.axes[3]) > 1e-9 * arm.length:
        raise ValueError(f"arm: this closed form needs the tool on the axis of {arm.names[3]}")
    if np.linalg.norm(np.cross(approach, shape.axes[3])) > 1e-9:
        raise ValueError(f"arm: this closed form needs the tool's z along the axis of {arm.names[3]}, got {approach}")
    return shape


@compiled
def branches_kernel(chain, limits, axes, shoulder, elbow, point, T_tool, target, reference, task, tolerance, found):
    """Writes the configurations into `found` (4, 4); returns how many."""
    q, tool, row = np.empty(4), np.empty((3, 4)), np.empty(3)
    position = (target[0, 3], target[1, 3], target[2, 3])
    if out_of_reach(shoulder, elbow, point, position, tolerance):
        return 0
    along = 0.0  # 1 if the approach axis points along the last joint's, else −1
    for r in range(3):
        along += axes[3, r] * T_tool[r, 2]
    count = 0
    for bend in (1.0, -1.0):
        for lean in (1.0, -1.0):
            q[0], q[1], q[2] = shoulder_angles(axes, shoulder, elbow, point, position, reference, bend, lean)
            q[3] = reference[3]
            if task == POSITION_ROLL:
                forward_kernel(chain, q, tool)
                q[3] += along * roll_kernel(tool, target, row)
            if holds(chain, limits, target, task, tolerance, q):
                count = keep_new(found, count, q)
    return count
