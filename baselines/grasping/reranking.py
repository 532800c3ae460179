"""Grasps of one plan ranked anew as the object moves, and when to switch between them (thesis figure 2.28)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from aerograsp_env.spatial import check_transform
from baselines.grasping.contacts import Array
from baselines.grasping.reaching import Reached
from baselines.kinematics.arm import Arm
from baselines.kinematics.regions import region


class Choice(NamedTuple):
    """Which stored grasp to go on with."""

    chosen: int  # −1: none can be done
    scores: Array  # (G,) as things are now, 0 where it cannot be done


def rerank(
    arm: Arm,
    grasps: Sequence[Reached],
    T_body_object: ArrayLike,
    current: int,
    back: float,
    hysteresis: float = 0.3,
    collides: Callable[[int, Array], bool] | None = None,
) -> Choice:
    """The stored grasp that suits best with the object where it is now and the base where it is.

    Cheap: the closed form at the grasp and the pre-grasp. The current one is kept until it is out of reach or collides,
    or another one's posture is better by `hysteresis`.

    Args:
        arm: poses in the body frame.
        grasps: of one plan.
        T_body_object: (4, 4) the object's pose now.
        current: index of the one that is being done, or −1.
        back: from the pre-grasp to the grasp [m].
        hysteresis: by how much a posture, in [0, 1], must be better.
        collides: whether a grasp, by its index, collides in a configuration (n,); asked of the best only.

    Raises:
        ValueError: a pose that is not rigid.
    """
    T = check_transform(T_body_object, "T_body_object")
    scores = np.zeros(len(grasps))
    angles = np.zeros((len(grasps), arm.n))
    for g, grasp in enumerate(grasps):
        T_tool = T @ grasp.T_object_grasp
        at = region(arm, T_tool[:3, :3], T_tool[:3, 3], back)
        scores[g], angles[g] = at.score[0], at.q[0]
    ranks = scores + np.where(np.arange(len(grasps)) == current, hysteresis, 0.0)
    for g in np.argsort(-ranks, kind="stable"):
        if scores[g] > 0.0 and (collides is None or not collides(int(g), angles[g])):
            return Choice(int(g), scores)
    return Choice(-1, scores)
