"""Where an arm does a given tool orientation well: over a grid of positions, the better of its closed form's branches.

A flying base can be put anywhere, so that what remains of reach is a choice: at which place of the arm's workspace to
meet a pose whose orientation is given. Good is far from singular (Yoshikawa's measure) and far from the joint limits,
at the pose itself and where the tool comes from, on one branch.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.sim.kernel_math import compiled
from aerograsp_env.spatial import as_array, check_rotation
from baselines.kinematics.arm import Arm
from baselines.kinematics.chain import jacobian_kernel
from baselines.kinematics.closed_form import TOLERANCE
from baselines.kinematics.closed_form_6dof import branches_kernel, six_joints
from baselines.kinematics.manipulability import manipulability

Array = NDArray[np.float64]

LIMIT_ROOM = 0.35  # [rad] from a limit at which it no longer counts
_GOOD = 0.8  # quantile of manipulability over the joint ranges that counts as good
_FARTHEST = 1.2  # [rad] of a joint between a pose and the one before it


class Region(NamedTuple):
    """How well an arm does an orientation at P positions."""

    score: Array  # (P,) in [0, 1]; 0 where it cannot
    q: Array  # (P, n) [rad] there; NaN where it cannot
    q_before: Array  # (P, n) at the pose that it comes from


@lru_cache(maxsize=16)
def _good_manipulability(arm: Arm) -> float:
    rng = np.random.default_rng(0)
    q = rng.uniform(arm.limits[:, 0], arm.limits[:, 1], (512, arm.n))
    return float(np.quantile(manipulability(arm, q), _GOOD))


def region(arm: Arm, rotation: ArrayLike, positions: ArrayLike, back: float = 0.0) -> Region:
    """Scores of an orientation at every position, for arms of six joints with a closed form.

    Args:
        arm: the arm.
        rotation: (3, 3) of the tool, in the frame of `arm.forward`.
        positions: (P, 3) of the tool [m].
        back: the tool comes from so far back along its approach axis z [m].

    Raises:
        ValueError: an arm without the closed form, a matrix that is no rotation, positions of another shape or not
            finite, or a negative distance.
    """
    R = np.ascontiguousarray(check_rotation(rotation, "rotation"))
    p = np.ascontiguousarray(np.atleast_2d(as_array(positions, (3,), "positions")))
    if not 0.0 <= back < np.inf:
        raise ValueError(f"back: expected a distance ≥ 0, got {back}")
    shape = six_joints(arm)
    score, q, q_before = np.zeros(len(p)), np.full((len(p), 6), np.nan), np.full((len(p), 6), np.nan)
    _region_kernel(
        arm.chain, arm.limits, shape.axes, shape.shoulder, shape.elbow, shape.point, shape.T_tool,
        R, p, float(back), _good_manipulability(arm), arm.limits.mean(axis=1), score, q, q_before,
    )  # fmt: skip
    return Region(score, q, q_before)


def posture(arm: Arm, q: ArrayLike) -> float:
    """How good a configuration (n,) is, in [0, 1]: 0 at a singularity or limit, 1 far from both."""
    return float(_posture(arm.chain, arm.limits, _good_manipulability(arm), as_array(q, (arm.n,), "q")))


@compiled
def _determinant(a):
    """|det| of a square matrix, which is overwritten."""
    n = a.shape[0]
    product = 1.0
    for k in range(n):
        pivot = k
        for r in range(k + 1, n):
            if abs(a[r, k]) > abs(a[pivot, k]):
                pivot = r
        if a[pivot, k] == 0.0:
            return 0.0
        for c in range(k, n):
            a[k, c], a[pivot, c] = a[pivot, c], a[k, c]
        product *= a[k, k]
        for r in range(k + 1, n):
            factor = a[r, k] / a[k, k]
            for c in range(k, n):
                a[r, c] -= factor * a[k, c]
    return abs(product)


@compiled
def _posture(chain, limits, good, q):
    n = q.shape[0]
    room = LIMIT_ROOM
    for i in range(n):
        room = min(room, min(q[i] - limits[i, 0], limits[i, 1] - q[i]))
    if room <= 0.0:
        return 0.0
    tool, jacobian = np.empty((3, 4)), np.empty((6, n))
    jacobian_kernel(chain, q, tool, jacobian)
    return room / LIMIT_ROOM * min(1.0, _determinant(jacobian) / good)


@compiled
def _region_kernel(
    chain, limits, axes, shoulder, elbow, point, T_tool, rotation, positions, back, good, reference, score, q, q_before
):
    target, before = np.eye(4), np.eye(4)
    target[:3, :3] = rotation
    before[:3, :3] = rotation
    found, found_before = np.empty((8, 6)), np.empty((8, 6))
    reach = np.linalg.norm(point - shoulder) + 1e-9  # the wrist's centre at angle zero: the arm is stretched there
    wrist = np.empty(3)
    for i in range(3):
        wrist[i] = 0.0
        for k in range(3):
            wrist[i] += T_tool[k, i] * (point[k] - T_tool[k, 3])
    for g in range(positions.shape[0]):
        distance = 0.0
        for i in range(3):
            at = positions[g, i]
            for k in range(3):
                at += rotation[i, k] * wrist[k]
            distance += (at - shoulder[i]) ** 2
        if distance > reach * reach:
            continue
        target[:3, 3] = positions[g]
        count = branches_kernel(
            chain, limits, axes, shoulder, elbow, point, T_tool, target, reference, TOLERANCE, found
        )
        if count == 0:
            continue
        count_before = count
        if back > 0.0:
            before[:3, 3] = positions[g] - back * rotation[:, 2]
            count_before = branches_kernel(
                chain, limits, axes, shoulder, elbow, point, T_tool, before, reference, TOLERANCE, found_before
            )
        else:
            found_before[:count] = found[:count]
        for a in range(count):
            here = _posture(chain, limits, good, found[a])
            if here <= score[g]:
                continue
            for b in range(count_before):
                farthest = 0.0
                for i in range(6):
                    farthest = max(farthest, abs(found[a, i] - found_before[b, i]))
                if farthest > _FARTHEST:
                    continue
                both = min(here, _posture(chain, limits, good, found_before[b]))
                if both > score[g]:
                    score[g] = both
                    q[g] = found[a]
                    q_before[g] = found_before[b]
