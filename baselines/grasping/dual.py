"""Two arms on one object: pairs of grasps ranked together, and where the base goes for both.

Pairs keep their grippers apart and load them alike: the centre of mass lies near the line between the grasps, and near
its middle (thesis section 2.4, on grasps with two arms).
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from aerograsp_env.sim.arms.vehicles import VehicleConfig
from aerograsp_env.spatial import check_transform
from baselines.grasping.candidates import note
from baselines.grasping.contacts import Array
from baselines.grasping.on_model import ModelGrasps
from baselines.grasping.reaching import (
    HALF_TURN,
    Reached,
    ReachSettings,
    distinct,
    model_grasps,
    robust,
    tool_grid,
)
from baselines.grasping.scenes import Scene, frame_clear, frame_points, moved_scene, surroundings
from baselines.kinematics.arm import Arm
from baselines.kinematics.collision import CollisionModel
from baselines.kinematics.regions import Region, region


class DualReached(NamedTuple):
    """A grasp for each arm, and where the base puts the object."""

    right: Reached
    left: Reached
    T_level_object: Array  # (4, 4)
    score: float


class DualPlan(NamedTuple):
    """What can be done, best first, and why other pairs were turned down."""

    grasps: tuple[DualReached, ...]
    reasons: dict[str, int]


@dataclass(frozen=True)
class PairSettings:
    """What counts in a pair.

    Raises:
        ValueError: a number that is not positive.
    """

    singles: int = 48  # grasps that are paired
    pairs: int = 60  # pairs whose reach is looked at
    apart: float = 0.15  # least distance of the grasps [m]
    sides: float = 0.10  # least distance from the right one to the left one along the body's y [m]
    line: float = 12.0  # [1/m] of the centre of mass' distance from the line between the grasps
    balance: float = 3.0  # of the share of the weight that one arm carries more than half
    alike: float = 0.7  # of approaches that differ by 90°

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not 0.0 < value < np.inf:
                raise ValueError(f"{name}: expected a positive number, got {value}")


class DualPlanner:
    """Plans grasps of both arms of a vehicle.

    Args:
        vehicle: with arms of six joints on the right and on the left.
        settings: of reach, for each arm.
        pairs: of the pairs.

    Raises:
        ValueError: an arm is missing.
    """

    def __init__(
        self, vehicle: VehicleConfig, settings: ReachSettings | None = None, pairs: PairSettings | None = None
    ) -> None:
        self.vehicle = vehicle
        self.mounts = vehicle.mount("right"), vehicle.mount("left")
        right, left = (Arm.from_config(mount.arm, mount.T_body_base) for mount in self.mounts)
        self.arms: tuple[Arm, Arm] = right, left
        self.settings = ReachSettings(motion=1.0, tried=48) if settings is None else settings
        self.pairs = PairSettings() if pairs is None else pairs
        self.grid = tool_grid(self.mounts[0], self.settings.step)
        self.frame = frame_points(vehicle)

    def plan(self, scene: Scene, friction: float = 0.5, shortlist: ModelGrasps | None = None) -> DualPlan:
        """Pairs of grasps that the arms can do together, best first; see `GraspPlanner.plan`."""
        T = check_transform(scene.T_level_object, "T_level_object")
        found = model_grasps(scene, self.mounts[0], friction) if shortlist is None else shortlist
        reasons: Counter[str] = Counter(found.reasons)
        grasps = distinct(found, T, self.settings)
        rows, scores = self._ranked(grasps, T)
        note(reasons, {"no pair": int(not len(rows))})
        regions: dict[tuple[int, int], tuple[Region, Array]] = {}
        reached = []
        for (i, j), score in zip(rows, scores, strict=True):
            both = self._reach(scene, T, grasps, int(i), int(j), float(score), regions)
            if both is None:
                note(reasons, {"out of reach": 1})
            else:
                reached.append(both)
        reached.sort(key=lambda grasp: -grasp.score)
        model = surroundings(self.vehicle, scene)
        kept: list[DualReached] = []
        for both in reached:
            if (fault := self._collision(model, scene, both)) is None:
                kept.append(both)
                if len(kept) == self.settings.kept:
                    break
            else:
                note(reasons, {fault: 1})
        return DualPlan(tuple(kept), dict(reasons))

    def _ranked(self, grasps: ModelGrasps, T: Array) -> tuple[Array, Array]:
        """(P, 2) rows of the right and the left grasp, best pairs first, and their scores (P,)."""
        s = self.pairs
        centers = grasps.T[:, :3, 3]
        approach = grasps.T[:, :3, 2]
        i, j = np.nonzero(~np.eye(len(grasps), dtype=bool))
        line = centers[j] - centers[i]
        length = np.linalg.norm(line, axis=1)
        sideways = line @ T[1, :3]
        able = (length > s.apart) & (sideways > s.sides)
        i, j, line, length = i[able], j[able], line[able], length[able]
        arm = grasps.center - centers[i]
        share = np.einsum("pi,pi->p", arm, line) / np.maximum(length, 1e-9) ** 2
        # under the line the centre of mass hangs still: only what is level of its distance counts
        off = arm - share[:, None] * line
        level = np.linalg.norm(off - np.outer(off @ T[2, :3], T[2, :3]), axis=1)
        turn = 0.5 * (1.0 - np.einsum("pi,pi->p", approach[i], approach[j]))
        base = grasps.score + 16.0 * grasps.lever  # each grasp's own lever does not matter with two
        score = 0.5 * (base[i] + base[j]) - s.line * level - s.balance * np.abs(share - 0.5) - s.alike * turn
        order = np.argsort(-score, kind="stable")[: s.pairs]
        return np.stack([i[order], j[order]], axis=1), score[order]

    def _reach(
        self,
        scene: Scene,
        T: Array,
        grasps: ModelGrasps,
        i: int,
        j: int,
        score: float,
        regions: dict[tuple[int, int], tuple[Region, Array]],
    ) -> DualReached | None:
        """The pair at the best place for both, or None."""
        s = self.settings
        best: DualReached | None = None
        for turn in (0, 1):
            if (i, turn) not in regions:
                at = region(self.arms[0], T[:3, :3] @ _turned(grasps.T[i], turn)[:3, :3], self.grid.positions, s.back)
                regions[i, turn] = at, robust(at, self.grid.shape)
            right, smooth = regions[i, turn]
            objects = self.grid.positions - T[:3, :3] @ grasps.T[i, :3, 3]
            can = np.flatnonzero(right.score > 0.0)
            can = can[frame_clear(self.frame, scene, objects[can], s.frame_height, s.frame_range)]
            if not len(can):
                continue
            for other in (0, 1):
                T_left = _turned(grasps.T[j], other)
                left = region(
                    self.arms[1], T[:3, :3] @ T_left[:3, :3], objects[can] + T[:3, :3] @ T_left[:3, 3], s.back
                )
                value = s.posture * (np.minimum(smooth[can], left.score) - 1.0)
                value = value - s.motion * np.linalg.norm(objects[can] - T[:3, 3], axis=1)
                value[left.score <= 0.0] = -np.inf
                k = int(value.argmax())
                total = float(value[k]) + score
                if np.isfinite(total) and (best is None or total > best.score):
                    T_level = T.copy()
                    T_level[:3, 3] = objects[can[k]]
                    hands = [
                        Reached(T_grasp, float(grasps.widths[g]), float(grasps.openings[g]), q, before, T_level, total)
                        for T_grasp, g, q, before in (
                            (_turned(grasps.T[i], turn), i, right.q[can[k]], right.q_before[can[k]]),
                            (T_left, j, left.q[k], left.q_before[k]),
                        )
                    ]
                    best = DualReached(hands[0], hands[1], T_level, total)
        return best

    def _collision(self, model: CollisionModel, scene: Scene, both: DualReached) -> str | None:
        """What the arms would touch, or None."""
        poses = moved_scene(scene, both.T_level_object)
        widths = {"right": both.right.opening, "left": both.left.opening}
        before = {"right": both.right.q_before, "left": both.left.q_before}
        hit = model.collides(before, widths, poses, margin=self.settings.arm_room)
        if hit is not None:
            return f"pre-grasp: {hit.first} – {hit.second}"
        ignored = [(side, "object") for side in widths]
        at = {"right": both.right.q, "left": both.left.q}
        hit = model.collides(at, widths, poses, ignored, margin=self.settings.grasp_room)
        return None if hit is None else f"grasp: {hit.first} – {hit.second}"


def _turned(T: Array, turn: int) -> Array:
    """The grasp (4, 4), with the fingers swapped where `turn` is 1."""
    if not turn:
        return T
    swapped = T.copy()
    swapped[:3, :3] = T[:3, :3] @ HALF_TURN
    return swapped
