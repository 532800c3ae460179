"""What an object to grasp is: convex pieces for the physics, and their watertight union for everything else."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Faces = NDArray[np.int32]

TAGS = frozenset({"concave", "elongated", "off-balance"})


class Convex(NamedTuple):
    """One convex piece, in the object's frame."""

    vertices: Array  # (V, 3) [m]
    faces: Faces  # (F, 3) indices, outward by the right-hand rule


@dataclass(frozen=True, eq=False)
class GraspObject:
    """A rigid object. Its frame is arbitrary; the centre of mass need not be at the origin.

    The surface is the boundary of the pieces' union: what a camera sees, what an oracle reads and what the gripper
    touches are the same shape.

    Raises:
        ValueError: a mass or friction that is not positive, an inertia that is not that of a rigid body, an empty
            piece, or an unknown tag.
    """

    name: str  # unique within its set
    family: str  # what kind of shape it is; train and test families are disjoint
    pieces: tuple[Convex, ...]
    vertices: Array  # (V, 3) [m] of the watertight union
    faces: Faces  # (F, 3), outward
    mass: float  # [kg]
    center_of_mass: Array  # (3,) [m]
    inertia: Array  # (3, 3) [kg m²] about the centre of mass, in the object's axes
    friction: float = 0.7  # Coulomb coefficient of its surface
    tags: frozenset[str] = field(default_factory=frozenset)  # of `TAGS`

    def __post_init__(self) -> None:
        for name in ("mass", "friction"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name}: expected a positive value, got {getattr(self, name)}")
        if not self.pieces or any(len(piece.vertices) < 4 or len(piece.faces) < 4 for piece in self.pieces):
            raise ValueError("pieces: expected one convex piece or more, each of four vertices and faces or more")
        principal = np.linalg.eigvalsh(np.asarray(self.inertia, dtype=np.float64))
        if principal[0] <= 0.0 or principal[2] > (principal[0] + principal[1]) * (1.0 + 1e-6):
            raise ValueError(f"inertia: expected principal moments of a rigid body, got {principal.tolist()}")
        if unknown := self.tags - TAGS:
            raise ValueError(f"tags: expected some of {sorted(TAGS)}, got {sorted(unknown)}")
