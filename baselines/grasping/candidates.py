"""Candidate grasps of a parallel-jaw gripper: what every generator returns, and how pairs of contacts become grasps."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.interfaces import Grasp
from aerograsp_env.sim.gripper import GripperConfig
from baselines.grasping.antipodal import closing_angles, line_distance
from baselines.grasping.clearance import PALM, swept_boxes
from baselines.grasping.contacts import Array, finite

Ints = NDArray[np.int64]
Collide = Callable[[Array, Array, Array], Ints]

THINNEST = 0.001
"""[m] Contacts closer together are taken for one."""
LEAST_CLEARANCE = 0.002
"""[m] The least room between each open pad and its contact."""
SHAPES = {
    "centers": (3,),
    "closing_axes": (3,),
    "approach_axes": (3,),
    "widths": (),
    "positions": (2, 3),
    "normals": (2, 3),
    "score": (),
    "score_error": (),
}
"""The arrays of `GraspCandidates` and what each holds of one grasp."""


class Pairs(NamedTuple):
    """Opposed contacts: the first finger's and the second's."""

    positions: Array  # (P, 2, 3) [m]
    normals: Array  # (P, 2, 3) unit, into the object

    def take(self, rows: NDArray[Any]) -> Pairs:
        """Some of them."""
        return Pairs(self.positions[rows], self.normals[rows])


@dataclass(frozen=True, eq=False)
class GraspCandidates:
    """G grasps, best first, and why others were turned down. Arrays are read-only.

    Raises:
        ValueError: arrays of other shapes, or numbers that are not finite.
    """

    centers: Array  # (G, 3) [m] midway between the contacts
    closing_axes: Array  # (G, 3) unit, from the first contact to the second
    approach_axes: Array  # (G, 3) unit, from the palm to the object, orthogonal to the closing axes
    widths: Array  # (G,) [m] opening before closing
    positions: Array  # (G, 2, 3) [m] of the contacts
    normals: Array  # (G, 2, 3) unit, into the object
    score: Array  # (G,) more is better; each generator says what it is
    score_error: Array  # (G,) standard error of the score, 0 where it is exact
    reasons: Mapping[str, int] = field(default_factory=dict)  # what was turned down, by why
    counts: Mapping[str, int] = field(default_factory=dict)  # what was tried, by what

    def __post_init__(self) -> None:
        for name, tail in SHAPES.items():
            array = finite(name, getattr(self, name), (-1, *tail))
            if len(array) != len(self.centers):
                raise ValueError(f"{name}: expected {len(self.centers)} rows like centers, got {len(array)}")
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        for name in ("reasons", "counts"):
            object.__setattr__(self, name, MappingProxyType({k: int(v) for k, v in getattr(self, name).items()}))

    def __len__(self) -> int:
        return len(self.centers)

    def __repr__(self) -> str:
        said = ", ".join(f"{count} {reason}" for reason, count in self.reasons.items()) or "none"
        return f"GraspCandidates({len(self)} grasps; turned down: {said})"

    @property
    def contact_widths(self) -> Array:
        """(G,) distance between the contacts [m]."""
        return np.linalg.norm(self.positions[:, 1] - self.positions[:, 0], axis=1)

    def take(self, rows: ArrayLike) -> GraspCandidates:
        """Some of the grasps, by index or mask."""
        rows = np.asarray(rows)
        return replace(self, **{name: getattr(self, name)[rows] for name in SHAPES})

    def order(self, score: ArrayLike) -> GraspCandidates:
        """The grasps by another score (G,), such as a column of `evaluate_candidates`, best (largest) first.

        Raises:
            ValueError: a score of another shape or not finite.
        """
        values = finite("score", score, (len(self),))
        ordered = replace(self, score=values, score_error=np.zeros(len(self)))
        return ordered.take(np.argsort(-values, kind="stable"))

    def top(self, n: int) -> GraspCandidates:
        """The n best, or all where there are fewer."""
        if n < 0:
            raise ValueError(f"n: expected a number of grasps ≥ 0, got {n}")
        return self.take(np.arange(min(n, len(self))))

    def grasps(self) -> list[Grasp]:
        """One `Grasp` each, in order."""
        rows = zip(self.centers, self.closing_axes, self.approach_axes, self.widths, strict=True)
        return [Grasp(center, closing, approach, float(width)) for center, closing, approach, width in rows]


@dataclass(frozen=True)
class GraspSearch:
    """What all generators have in common.

    Raises:
        ValueError: a value outside its range.
    """

    gripper: GripperConfig
    friction: float  # Coulomb coefficient
    approaches: int = 8  # approach axes tried for each pair of contacts, evenly about the closing axis
    clearance: float = (
        0.008  # [m] wanted between each open pad and its contact; halved and quartered where it is narrow
    )

    def __post_init__(self) -> None:
        if not isinstance(self.gripper, GripperConfig):
            raise ValueError(f"gripper: expected a GripperConfig, got {type(self.gripper).__name__}")
        if not 0.0 < self.friction < np.inf:
            raise ValueError(f"friction: expected a positive coefficient, got {self.friction}")
        if not isinstance(self.approaches, (int, np.integer)) or self.approaches < 1:
            raise ValueError(f"approaches: expected a whole number ≥ 1, got {self.approaches!r}")
        if not LEAST_CLEARANCE <= self.clearance < np.inf:
            raise ValueError(f"clearance: expected at least {LEAST_CLEARANCE} m, got {self.clearance}")
        if self.widest <= THINNEST:
            raise ValueError(f"gripper: expected one that opens more than {2 * LEAST_CLEARANCE} m, got {self.gripper}")

    @classmethod
    def of(
        cls, gripper: GripperConfig | None, friction: float | None, approaches: int, clearance: float
    ) -> GraspSearch:
        """With the defaults for None: a `GripperConfig()`, and the gripper's friction."""
        gripper = GripperConfig() if gripper is None else gripper
        mu = getattr(gripper, "friction", 1.0) if friction is None else float(friction)
        return cls(gripper, mu, approaches, float(clearance))

    @property
    def widest(self) -> float:
        """[m] The largest distance of contacts that the jaws go around."""
        return self.gripper.max_width - 2.0 * LEAST_CLEARANCE

    def eligible(self, pairs: Pairs, reasons: Counter[str]) -> tuple[Pairs, Array]:
        """The pairs that the jaws can go around and squeeze, and their margins: friction angle less the angle that each
        needs [rad]. `reasons` is added to."""
        width = np.linalg.norm(pairs.positions[:, 1] - pairs.positions[:, 0], axis=1)
        wide, thin = width > self.widest, width < THINNEST
        pairs = pairs.take(~(wide | thin))
        margin = np.arctan(self.friction) - closing_angles(pairs.positions, pairs.normals)
        note(reasons, {"too wide": wide.sum(), "too thin": thin.sum(), "outside cone": (margin <= 0.0).sum()})
        return pairs.take(margin > 0.0), margin[margin > 0.0]

    def place(self, pairs: Pairs, collide: Collide, reasons: Counter[str]) -> tuple[Ints, Array, Array, Array]:
        """Where the gripper fits: pair (G,), closing and approach axis (G, 3), and opening (G,) [m].

        Each opening is the widest of three that has room. `collide` takes rotations (G, 3, 3), centres (G, 3) and boxes
        (G, K, 6), and gives the box that is not free, or −1. `reasons` is added to.
        """
        line = pairs.positions[:, 1] - pairs.positions[:, 0]
        width = np.linalg.norm(line, axis=1)
        closing, approach = approach_axes(line / width[:, None], self.approaches)
        rows = np.repeat(np.arange(len(line)), self.approaches)
        rotations = np.stack([closing, np.cross(approach, closing), approach], axis=2)
        centers = pairs.positions.mean(axis=1)[rows]
        opening, blocked = np.zeros(len(rows)), np.zeros(len(rows), dtype=np.int64)
        for clearance in sorted({max(self.clearance * part, LEAST_CLEARANCE) for part in (1.0, 0.5, 0.25)})[::-1]:
            left = np.flatnonzero(blocked >= 0)
            opening[left] = np.minimum(width[rows[left]] + 2.0 * clearance, self.gripper.max_width)
            boxes = swept_boxes(self.gripper, opening[left], width[rows[left]])
            blocked[left] = collide(rotations[left], centers[left], boxes)
        palm = blocked == PALM
        note(reasons, {"no clearance": ((blocked >= 0) & ~palm).sum(), "palm collision": palm.sum()})
        free = blocked < 0
        return rows[free], closing[free], approach[free], opening[free]


def note(reasons: Counter[str], found: Mapping[str, int]) -> None:
    """Add to the reasons, leaving out what did not happen."""
    reasons.update({reason: int(count) for reason, count in found.items() if count})


def approach_axes(closing: Array, count: int) -> tuple[Array, Array]:
    """The closing axes (P, 3) repeated, and `count` unit axes evenly about each of them: (P·count, 3) both."""
    smallest = np.eye(3)[np.argmin(np.abs(closing), axis=1)]
    u = np.cross(closing, smallest)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    w = np.cross(closing, u)
    angle = 2.0 * np.pi * np.arange(count) / count
    axes = np.cos(angle)[None, :, None] * u[:, None] + np.sin(angle)[None, :, None] * w[:, None]
    return np.repeat(closing, count, axis=0), axes.reshape(-1, 3)


def assemble(
    pairs: Pairs,
    placed: tuple[Ints, Array, Array, Array],
    score: Array,
    reasons: Mapping[str, int],
    counts: Mapping[str, int],
    center: Array,
    score_error: Array | None = None,
) -> GraspCandidates:
    """What `GraspSearch.place` found, best first; scores and their errors are per pair (P,).

    Scores that are equal (to 1e-9) are ordered by the distance of the closing line from `center` (3,), nearest first.
    """
    rows, closing, approach, opening = placed
    error = np.zeros(len(score)) if score_error is None else score_error
    found = GraspCandidates(
        pairs.positions.mean(axis=1)[rows],
        closing,
        approach,
        opening,
        pairs.positions[rows],
        pairs.normals[rows],
        score[rows],
        error[rows],
        reasons,
        counts,
    )
    arm = np.round(line_distance(found.positions, center), 9)
    return found.take(np.lexsort((arm, -np.round(found.score, 9))))
