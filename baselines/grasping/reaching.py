"""Grasps that a flying arm can do: reach and collisions of the candidates, and where the base goes for each.

The base may be put anywhere over the object (its heading is kept), so each grasp is met where the arm does its
orientation well: far from singular and from the joint limits, at the grasp and where the tool comes from, with the
airframe clear of what is below (thesis section 2.4: grasps on the object, then inverse kinematics and collision checks
of the arm). Frames: "level" is the body's origin and heading, z up.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from aerograsp_env.sim.arms.vehicles import ArmMount, VehicleConfig
from aerograsp_env.spatial import check_transform, inverse, transform_points
from baselines.grasping.candidates import note
from baselines.grasping.contacts import Array
from baselines.grasping.on_model import ModelGrasps, grasps_on_model
from baselines.grasping.scenes import Scene, frame_clear, frame_points, moved_scene, surroundings
from baselines.kinematics.arm import Arm
from baselines.kinematics.collision import CollisionModel
from baselines.kinematics.regions import Region, region

HALF_TURN = np.diag([-1.0, -1.0, 1.0])  # the same grasp with the fingers swapped
ALIKE_TURN, ALIKE_PLACE = 0.9, 0.015  # cosine between approaches and distance [m] of grasps that are nearly one

EASED = ((1.0, 0.004), (1.4, 0.002), (1.8, 0.0005))  # factors of the friction counted on, and room wanted [m]
FEW = 12


class Reached(NamedTuple):
    """A grasp, the arm in it, and where the object is then."""

    T_object_grasp: Array  # (4, 4)
    width: float  # between the contacts [m]
    opening: float  # of the jaws on the approach [m]
    q: Array  # (n,) at the grasp [rad]
    q_before: Array  # (n,) at the pre-grasp
    T_level_object: Array  # (4, 4) where the base puts the object
    score: float  # more is better


class Plan(NamedTuple):
    """What can be done, best first, and why other grasps were turned down."""

    grasps: tuple[Reached, ...]
    reasons: dict[str, int]


@dataclass(frozen=True)
class ReachSettings:
    """What counts where grasps are chosen. Lengths in metres.

    Raises:
        ValueError: a number that is not positive.
    """

    back: float = 0.09  # from the pre-grasp to the grasp, along the approach axis
    tried: int = 24  # grasps whose reach is looked at
    kept: int = 6
    step: float = 0.07  # of the grid of tool positions
    posture: float = 1.2  # what a posture at its best counts against one that is just possible
    straight_down: float = 0.25  # what an approach straight down counts against a horizontal one
    motion: float = 0.3  # per metre that the base has to move
    frame_height: float = 0.12  # of the airframe over the support
    frame_range: float = 0.90  # from the seat's middle within which the support counts
    arm_room: float = 0.008  # of the arms from everything at the pre-grasp
    grasp_room: float = 0.002  # at the grasp, where the fingers come near the support

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not 0.0 < value < np.inf:
                raise ValueError(f"{name}: expected a positive number, got {value}")


class Grid(NamedTuple):
    """Tool positions of an arm that are tried, level frame."""

    positions: Array  # (P, 3) [m]
    shape: tuple[int, int, int]


def tool_grid(mount: ArmMount, step: float) -> Grid:
    """In front of, beside and below the arm's base, as far as it reaches."""
    x, y, z = mount.T_body_base[:3, 3]
    axes = (
        x + np.arange(-0.26, 0.38, step),
        y + np.arange(-0.27, 0.28, step),
        z - np.arange(0.24, 0.60, step),
    )
    mesh = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    return Grid(mesh.reshape(-1, 3), (mesh.shape[0], mesh.shape[1], mesh.shape[2]))


class GraspPlanner:
    """Plans grasps of one arm of a vehicle.

    Args:
        vehicle: its other arms are taken to be stowed.
        side: of the arm, which needs a closed form for six joints.
        settings: what counts.

    Raises:
        ValueError: the vehicle has no such arm, or the arm no closed form.
    """

    def __init__(self, vehicle: VehicleConfig, side: str = "right", settings: ReachSettings | None = None) -> None:
        self.vehicle, self.side = vehicle, side
        self.mount = vehicle.mount(side)
        self.arm = Arm.from_config(self.mount.arm, self.mount.T_body_base)
        self.settings = ReachSettings() if settings is None else settings
        self.grid = tool_grid(self.mount, self.settings.step)
        self.frame = frame_points(vehicle.with_active([side]) if len(vehicle.mounts) > 1 else vehicle)

    def plan(self, scene: Scene, friction: float = 0.5, shortlist: ModelGrasps | None = None) -> Plan:
        """The grasps that the arm can do, best first.

        Args:
            scene: the object and its support.
            friction: Coulomb coefficient that may be counted on.
            shortlist: grasps of the object's model, where they are known already.

        Raises:
            ValueError: a pose that is not rigid, or a model that `grasps_on_model` refuses.
        """
        T = check_transform(scene.T_level_object, "T_level_object")
        grasps = model_grasps(scene, self.mount, friction) if shortlist is None else shortlist
        reasons: Counter[str] = Counter(grasps.reasons)
        reached = self._reach(scene, T, distinct(grasps, T, self.settings), reasons)
        model = surroundings(self.vehicle, scene)
        kept = []
        for grasp in reached:
            if (fault := self._collision(model, scene, grasp)) is None:
                kept.append(grasp)
                if len(kept) == self.settings.kept:
                    break
            else:
                note(reasons, {fault: 1})
        return Plan(tuple(kept), dict(reasons))

    def _reach(self, scene: Scene, T: Array, grasps: ModelGrasps, reasons: Counter[str]) -> list[Reached]:
        """Every grasp at the best place for it, best first."""
        s = self.settings
        found = []
        for g in range(len(grasps)):
            best: Reached | None = None
            for turn in (np.eye(3), HALF_TURN):
                T_grasp = grasps.T[g].copy()
                T_grasp[:3, :3] = T_grasp[:3, :3] @ turn
                R = T[:3, :3] @ T_grasp[:3, :3]
                at = region(self.arm, R, self.grid.positions, s.back)
                objects = self.grid.positions - T[:3, :3] @ T_grasp[:3, 3]
                value = s.posture * (robust(at, self.grid.shape) - 1.0)
                value = value - s.motion * np.linalg.norm(objects - T[:3, 3], axis=1)
                can = np.flatnonzero(at.score > 0.0)
                can = can[frame_clear(self.frame, scene, objects[can], s.frame_height, s.frame_range)]
                if not len(can):
                    continue
                p = int(can[value[can].argmax()])
                total = float(value[p] + grasps.score[g])
                if best is None or total > best.score:
                    T_level = T.copy()
                    T_level[:3, 3] = objects[p]
                    opening, width = float(grasps.openings[g]), float(grasps.widths[g])
                    best = Reached(T_grasp, width, opening, at.q[p], at.q_before[p], T_level, total)
            if best is None:
                note(reasons, {"out of reach": 1})
            else:
                found.append(best)
        return sorted(found, key=lambda grasp: -grasp.score)

    def _collision(self, model: CollisionModel, scene: Scene, grasp: Reached) -> str | None:
        """What the arm would touch, or None."""
        poses = moved_scene(scene, grasp.T_level_object)
        widths = {self.side: grasp.opening}
        before = model.collides({self.side: grasp.q_before}, widths, poses, margin=self.settings.arm_room)
        if before is not None:
            return f"pre-grasp: {before.first} – {before.second}"
        ignored = [(self.side, "object")]  # the model's points have been looked at
        hit = model.collides({self.side: grasp.q}, widths, poses, ignored, margin=self.settings.grasp_room)
        return None if hit is None else f"grasp: {hit.first} – {hit.second}"


def model_grasps(scene: Scene, mount: ArmMount, friction: float) -> ModelGrasps:
    """Grasps of the object as it stands, in its frame; with more friction and less room where there are few."""
    T_object_level = inverse(scene.T_level_object)
    support = transform_points(T_object_level, scene.support), T_object_level[:3, :3] @ scene.up
    for factor, room in EASED:
        jaws = mount.arm.gripper.jaws
        found = grasps_on_model(scene.points, scene.normals, jaws, factor * friction, support, room=room)
        if len(found) >= FEW:
            break
    return found


def distinct(grasps: ModelGrasps, T: Array, settings: ReachSettings) -> ModelGrasps:
    """The best grasps that differ, with what their approach counts added to the score."""
    approach = np.einsum("ij,gj->gi", T[:3, :3], grasps.T[:, :3, 2])
    score = grasps.score - settings.straight_down * (1.0 + approach[:, 2])
    center = grasps.T[:, :3, 3]
    chosen: list[int] = []
    for g in np.argsort(-score, kind="stable"):
        near = np.linalg.norm(center[chosen] - center[g], axis=1) < ALIKE_PLACE if chosen else np.zeros(0, bool)
        if not (near & (approach[chosen] @ approach[g] > ALIKE_TURN)).any():
            chosen.append(int(g))
            if len(chosen) == settings.tried:
                break
    rows = np.array(chosen, dtype=np.int64)
    taken = grasps.take(rows)
    taken.score[:] = score[rows]
    return taken


def robust(at: Region, shape: tuple[int, int, int]) -> Array:
    """(P,) scores that count the six neighbours as much as the place itself: a hover does not stand still."""
    score = at.score.reshape(shape)
    wide = np.pad(score, 1)
    beside = [wide[2:, 1:-1, 1:-1], wide[:-2, 1:-1, 1:-1], wide[1:-1, 2:, 1:-1], wide[1:-1, :-2, 1:-1]]
    beside += [wide[1:-1, 1:-1, 2:], wide[1:-1, 1:-1, :-2]]
    return np.asarray(0.5 * score + np.mean(beside, axis=0) * 0.5).reshape(-1)
