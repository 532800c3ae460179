"""Inverse kinematics: one door to the damped search and to the closed forms of the arms that have one."""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.spatial import check_transform
from baselines.kinematics.arm import Arm, exactly
from baselines.kinematics.chain import POSE, POSITION, POSITION_ROLL, forward_kernel, task_kernel
from baselines.kinematics.closed_form_4dof import branches_4dof
from baselines.kinematics.closed_form_6dof import branches_6dof
from baselines.kinematics.search import error_sizes, search

Array = NDArray[np.float64]
Method = Literal["dls", "analytic", "global"]
Task = Literal["pose", "position", "position+roll"]

TASKS = {"pose": POSE, "position": POSITION, "position+roll": POSITION_ROLL}
METHODS = ("dls", "analytic", "global")


class IKResult(NamedTuple):
    """What `solve_ik` found: where it did not converge, the nearest configuration that it found, and its errors."""

    q: Array  # (n,) [rad], within the limits
    converged: bool  # the task is met within both tolerances
    iterations: int  # of the damped search, 0 for a closed form
    position_error: float  # [m]
    orientation_error: float  # of what the task asks: the whole rotation, the roll, or 0 for a position [rad]
    reason: str  # empty if converged, else why not
    jump: float = math.nan  # the largest joint angle between q and q0 [rad]; NaN without q0
    branches: int = 0  # how many configurations within the limits a closed form found


def solve_ik(
    arm: Arm,
    T_target: ArrayLike,
    q0: ArrayLike | None = None,
    method: Method = "dls",
    task: Task = "pose",
    position_tolerance: float = 1e-4,
    orientation_tolerance: float = 1e-3,
) -> IKResult:
    """Joint angles within the limits that bring the tool to a pose, or the nearest ones and why they do not.

    Tasks: "pose" is the whole pose; "position" the tool's origin alone; "position+roll" the position and the rotation
    about the approach axis (the tool's z): what remains of the target's rotation after the smallest rotation that
    aligns the approach axes, which is what an arm of four joints can choose (thesis section 5.2).

    Methods: "dls" descends from q0, then from deterministic samples of the joint ranges, for any arm and task.
    "analytic" is the closed form of arms of four joints, for any task; "global" that of arms of six joints with a
    spherical wrist, for poses: both weigh every branch within the limits and take the one nearest to q0 (`jump` says
    how near). Where no branch fits, the damped search finds the nearest configuration.

    Args:
        arm: the arm.
        T_target: the tool's pose (4, 4), in the frame of `arm.forward`.
        q0: (n,) [rad] where the arm is; the middle of the ranges by default. Beyond the limits it is brought to them.
        method: see above.
        task: see above.
        position_tolerance: [m].
        orientation_tolerance: [rad].

    Raises:
        ValueError: a target that is not a rigid transform (a reflection, NaN, …), q0 of another shape or not finite, an
            unknown method or task, a tolerance that is not positive, or a closed form for an arm or task without one.
    """
    target = np.ascontiguousarray(exactly(check_transform(T_target, "T_target"), (4, 4), "T_target"))
    if task not in TASKS:
        raise ValueError(f"task: expected one of {', '.join(TASKS)}, got {task!r}")
    if method not in METHODS:
        raise ValueError(f"method: expected one of {', '.join(METHODS)}, got {method!r}")
    for name, value in (("position_tolerance", position_tolerance), ("orientation_tolerance", orientation_tolerance)):
        if not 0.0 < value < math.inf:
            raise ValueError(f"{name}: expected a positive number, got {value}")
    start = arm.limits.mean(axis=1)
    given: Array | None = None
    if q0 is not None:
        given = exactly(q0, (arm.n,), "q0")
        start = np.clip(given, arm.limits[:, 0], arm.limits[:, 1])
    code, tolerances = TASKS[task], (position_tolerance, orientation_tolerance)
    count = 0
    if method != "dls":
        branches = _branches(arm, target, start, method, task)
        count = len(branches)
        for q in branches[np.argsort(np.abs(branches - start).max(axis=1))]:  # the nearest first
            position, orientation = _errors(arm, q, target, code)
            if position <= position_tolerance and orientation <= orientation_tolerance:
                return IKResult(q, True, 0, position, orientation, "", _jump(q, given), count)
        if count:
            start = branches[0]
    found = search(arm, target, start, code, *tolerances)
    position, orientation = _errors(arm, found.q, target, code)
    reason = ""
    if not found.converged:
        sought = f"from {found.searches} starts" if method == "dls" else "by the closed form"
        reason = (
            f"no configuration within the limits meets the target ({sought}): the nearest is off by {position:.3g} m "
            f"and {orientation:.3g} rad, tolerances {position_tolerance:g} m and {orientation_tolerance:g} rad"
        )
    jump = _jump(found.q, given)
    return IKResult(found.q, found.converged, found.iterations, position, orientation, reason, jump, count)


def _branches(arm: Arm, target: Array, start: Array, method: str, task: str) -> Array:
    """A closed form's configurations (k, n) within the limits."""
    if method == "analytic":
        return branches_4dof(arm, target, start, roll=task != "position")
    if task != "pose":
        raise ValueError(f'task: method "global" solves poses, got {task!r}')
    return branches_6dof(arm, target, start)


def _jump(q: Array, q0: Array | None) -> float:
    return math.nan if q0 is None else float(np.max(np.abs(q - q0)))


def _errors(arm: Arm, q: Array, target: Array, task: int) -> tuple[float, float]:
    """Position [m] and orientation error [rad] of a task at q."""
    tool, jacobian, error = np.empty((3, 4)), np.zeros((6, 1)), np.empty(6)
    forward_kernel(arm.chain, q, tool)
    rows = task_kernel(task, tool, target, jacobian, error)
    position, orientation = error_sizes(error, rows)
    return float(position), float(orientation)
