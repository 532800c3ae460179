"""Grasps of a whole object model: every antipodal pair of its surface points, each from many sides, in a few ms.

For a tracker's model, which is points with outward normals all round. Points of a sparse model seldom lie opposite each
other, so the closing axis is taken from the normals (it is exact for parallel faces, cylinders and spheres) and the
line between the points has to keep near to it.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.sim.gripper import GripperConfig
from aerograsp_env.sim.kernel_math import compiled
from baselines.grasping.candidates import THINNEST, approach_axes, note
from baselines.grasping.clearance import TOLERANCE, point_collisions, swept_boxes
from baselines.grasping.contacts import Array, finite, unit
from baselines.grasping.on_cloud import checked_cloud

ASIDE = 0.007  # [m] that the line between two points may lie off the closing axis: about a pad
ROOM = 0.004  # [m] wanted round what approaches
SUPPORT_ROOM = 0.003  # [m] wanted between the gripper and the support
NARROWER = (1.0, 0.03, 0.015)  # openings tried: the widest, then contact width + so much [m]
NEAR, ALIKE = 0.008, math.cos(math.radians(20.0))  # pairs closer and more parallel than this are one
PAIRS = 96  # most pairs that are tried from all sides

# What counts in the score, each about 1 for the difference between a good and a poor grasp
ANGLE = 2.0  # [1/rad] of the angle between closing axis and normals
LEVER = 16.0  # [1/m] of the closing line's distance from the centre of mass
SLACK = 25.0  # [1/m] of the room beside an object that is narrower than the jaws, up to ENOUGH
ENOUGH = 0.020  # [m] on either side


@dataclass(frozen=True, eq=False)
class ModelGrasps:
    """G grasps in the object's frame, best first."""

    T: Array  # (G, 4, 4) T_object_gripper
    widths: Array  # (G,) distance of the contacts along the closing axis [m]
    openings: Array  # (G,) of the jaws on the approach [m]
    score: Array  # (G,) more is better
    lever: Array  # (G,) distance of the closing line from the centre of mass [m]
    center: Array  # (3,) centre of mass by the model [m]
    reasons: Mapping[str, int]  # what was turned down

    def __len__(self) -> int:
        return len(self.T)

    def take(self, rows: NDArray[np.int64]) -> ModelGrasps:
        """Some of them."""
        arrays = {name: getattr(self, name)[rows] for name in ("T", "widths", "openings", "score", "lever")}
        return replace(self, **arrays)


def volume_center(points: Array, normals: Array) -> Array:
    """Centre of mass (3,) [m] of a solid of even density whose surface was sampled evenly, with outward normals.

    The divergence theorem: cones from a point inside to each patch of the surface, whose volumes go with p · n and
    whose centres lie at ¾ p. Where the samples enclose no volume, their mean.
    """
    origin = points.mean(axis=0)
    p = points - origin
    volume = np.einsum("ni,ni->n", p, normals)
    total = float(volume.sum())
    if total <= 1e-6 * float(np.abs(p).max()) * len(p):
        return np.asarray(origin)
    center = origin + 0.75 * (volume[:, None] * p).sum(axis=0) / total
    return np.asarray(np.clip(center, points.min(axis=0), points.max(axis=0)))


def grasps_on_model(
    points: ArrayLike,
    normals: ArrayLike,
    gripper: GripperConfig | None = None,
    friction: float = 0.5,
    support: tuple[ArrayLike, ArrayLike] | None = None,
    *,
    approaches: int = 16,
    margin: float = 0.012,
    room: float = ROOM,
) -> ModelGrasps:
    """Grasps of a parallel-jaw gripper on a model of the whole surface, in its frame.

    Two points are a pair if the closing axis, midway between their inward normals, lies within the friction cone of
    both, the line between them keeps within 7 mm of it, and the jaws go around with room to spare. Pairs that are
    nearly the same are tried once, from `approaches` sides about the closing axis, with jaws as wide as there is room.

    Args:
        points: (N, 3) [m].
        normals: (N, 3) unit, outward.
        gripper: None is `GripperConfig()`.
        friction: Coulomb coefficient that may be counted on.
        support: a point (3,) of the plane the object stands on and the plane's unit normal (3,) towards it; nothing of
            the gripper may come closer to it than 3 mm. None: the object hangs free.
        approaches: approach axes tried about each closing axis; one of them leans most against the support's normal.
        margin: what the jaws must open wider than the object [m].
        room: around fingers and palm on the approach [m].

    Raises:
        ValueError: fewer than 10 distinct points, points in a line, normals that are not unit, or another argument out
            of its range.
    """
    p = checked_cloud(points)
    n = unit("normals", normals, p.shape)
    gripper = GripperConfig() if gripper is None else gripper
    if not 0.0 < friction < math.inf:
        raise ValueError(f"friction: expected a positive coefficient, got {friction}")
    if not 0.0 <= margin < gripper.max_width:
        raise ValueError(f"margin: expected 0 … {gripper.max_width} m, got {margin}")
    if approaches < 1:
        raise ValueError(f"approaches: expected 1 or more, got {approaches}")
    plane = None
    if support is not None:
        plane = finite("support", support[0], (3,)), unit("support", support[1], (3,))
    reasons: Counter[str] = Counter()
    center = volume_center(p, n)
    middles, axes, widths, angles = _pairs(p, n, friction, gripper.max_width - margin, reasons)
    arms = middles - center
    lever = np.linalg.norm(arms - np.einsum("gi,gi->g", arms, axes)[:, None] * axes, axis=1)
    slack = np.minimum(0.5 * (gripper.max_width - widths), ENOUGH)
    score = -ANGLE * angles - LEVER * lever + SLACK * slack
    order = np.argsort(-score, kind="stable")
    kept = order[_distinct(middles[order], axes[order], NEAR, ALIKE, PAIRS)]
    middles, axes, widths, lever, score = (a[kept] for a in (middles, axes, widths, lever, score))
    rows, frames = _frames(axes, approaches, None if plane is None else plane[1])
    opening, reason = openings(gripper, p, middles[rows], frames, widths[rows], plane, room)
    note(reasons, {"no room": (reason == 1).sum(), "support": (reason == 2).sum()})
    free = opening > 0.0
    rows, frames, opening = rows[free], frames[free], opening[free]
    T = np.zeros((len(rows), 4, 4))
    T[:, :3, :3], T[:, :3, 3], T[:, 3, 3] = frames, middles[rows], 1.0
    total = score[rows] - SLACK * np.maximum(ENOUGH - 0.5 * (opening - widths[rows]), 0.0)
    found = ModelGrasps(T, widths[rows], opening, total, lever[rows], center, dict(reasons))
    return found.take(np.argsort(-total, kind="stable"))


def _pairs(
    p: Array, n: Array, friction: float, widest: float, reasons: Counter[str]
) -> tuple[Array, Array, Array, Array]:
    """Middles (P, 3), closing axes (P, 3), widths (P,) and angles between axis and normals (P,) of opposed points."""
    i, j = np.triu_indices(len(p), 1)
    facing = np.einsum("ni,ni->n", n[i], n[j])
    # both normals make the same angle with the axis midway: cos of twice the angle is −n_i · n_j
    opposed = facing < -math.cos(2.0 * math.atan(friction))
    i, j, facing = i[opposed], j[opposed], facing[opposed]
    axes = n[j] - n[i]
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    line = p[j] - p[i]
    widths = np.einsum("ni,ni->n", line, axes)
    aside = np.linalg.norm(line - widths[:, None] * axes, axis=1)
    along = (widths > THINNEST) & (aside <= ASIDE)
    wide = along & (widths > widest)
    note(reasons, {"too wide": wide.sum()})
    good = along & ~wide
    angles = 0.5 * np.arccos(np.clip(-facing, -1.0, 1.0))
    # contacts may be a little aside of each other: the line's own angle counts where it is the larger
    angles = np.maximum(angles, 0.5 * np.arctan2(aside, np.maximum(widths, THINNEST)))
    return 0.5 * (p[i] + p[j])[good], axes[good], widths[good], angles[good]


@compiled
def _distinct_kernel(middles, axes, near, alike, most, kept):
    count = 0
    for g in range(len(middles)):
        new = True
        for k in range(count):
            h = kept[k]
            distance = turn = 0.0
            for i in range(3):
                distance += (middles[g, i] - middles[h, i]) ** 2
                turn += axes[g, i] * axes[h, i]
            if distance < near * near and abs(turn) > alike:
                new = False
                break
        if new:
            kept[count] = g
            count += 1
            if count == most:
                break
    return count


def _distinct(middles: Array, axes: Array, near: float, alike: float, most: int) -> NDArray[np.int64]:
    """The first of each cluster, `most` at most."""
    kept = np.empty(most, dtype=np.int64)
    count = _distinct_kernel(middles, axes, near, alike, most, kept)
    return kept[:count]


def _frames(axes: Array, approaches: int, up: Array | None) -> tuple[NDArray[np.int64], Array]:
    """Pair (G,) and gripper axes (G, 3, 3) of every approach; the first of each pair comes down along −`up`."""
    rows = np.repeat(np.arange(len(axes)), approaches)
    closing, approach = approach_axes(axes, approaches)
    if up is not None and len(axes):
        down = -up - (axes @ -up)[:, None] * axes
        length = np.linalg.norm(down, axis=1)
        level = np.flatnonzero(length > 0.1)
        u = down[level] / length[level, None]
        w = np.cross(axes[level], u)
        angle = 2.0 * np.pi * np.arange(approaches) / approaches
        turned = np.cos(angle)[None, :, None] * u[:, None] + np.sin(angle)[None, :, None] * w[:, None]
        approach.reshape(len(axes), approaches, 3)[level] = turned
    return rows, np.stack([closing, np.cross(approach, closing), approach], axis=2)


def openings(
    gripper: GripperConfig,
    p: Array,
    middles: Array,
    frames: Array,
    widths: Array,
    plane: tuple[Array, Array] | None,
    room: float,
) -> tuple[Array, NDArray[np.int64]]:
    """The widest opening (G,) that has room, 0 where none has, and why: 1 the object, 2 the support."""
    widest, reason = np.zeros(len(widths)), np.zeros(len(widths), dtype=np.int64)
    left = np.arange(len(widths))
    for narrower in NARROWER:
        tried = np.full(len(left), gripper.max_width)
        if narrower < 1.0:
            tried = np.minimum(widths[left] + narrower, gripper.max_width)
        coming = swept_boxes(gripper, tried, widths[left], tolerance=-room)[:, :5]
        closing = swept_boxes(gripper, tried, widths[left], tolerance=TOLERANCE)[:, 5:]
        boxes = np.concatenate([coming, closing], axis=1)
        hit = point_collisions(p, frames[left], middles[left], boxes) >= 0
        blocked = np.zeros(len(left), dtype=bool)
        if plane is not None:
            blocked = _support_room(boxes, frames[left], middles[left], plane) < SUPPORT_ROOM - room
        free = ~hit & ~blocked
        widest[left[free]] = tried[free]
        reason[left[hit]], reason[left[blocked & ~hit]], reason[left[free]] = 1, 2, 0
        left = left[~free]
    return widest, reason


def _support_room(boxes: Array, frames: Array, middles: Array, plane: tuple[Array, Array]) -> Array:
    """Height (G,) of the lowest corner of the boxes over the plane [m]."""
    point, normal = plane
    local = np.einsum("gij,i->gj", frames, normal)[:, None]  # the normal in the gripper's axes
    lowest = np.minimum(boxes[..., :3] * local, boxes[..., 3:] * local).sum(axis=-1).min(axis=-1)
    return np.asarray(lowest + (middles - point) @ normal)
