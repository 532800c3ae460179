"""What a grasp plan depends on, and what a search hands to the ranking."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim.gripper import GripperConfig
from agents.plan_page import Scene
from baselines.grasping.candidates import GraspCandidates

Array = NDArray[np.float64]
Method = Literal["auto", "mesh", "gpis", "cloud"]
PriorName = Literal["ellipsoid", "cylinder", "plane", "constant"]
Say = Callable[[str], None]

METRICS = (
    *("pfc", "lmrw_sum", "lmrw_independent", "closing_angle", "line_distance", "force_closure"),
    *("q_min", "q_volume", "q_isotropy", "wrench_volume", "antipodal_margin"),
)
RANK, TIE = "pfc", "lmrw_sum"


@dataclass(frozen=True)
class Settings:
    """What a plan depends on, beside the file."""

    method: Method = "auto"
    prior: PriorName = "ellipsoid"
    rank: str = RANK
    top: int = 10
    seed: int = 0
    gripper: GripperConfig = field(default_factory=GripperConfig)
    noise: float = 0.001  # [m] standard deviation of a mesh's surface, for the probability, and of a cloud's points
    scale: float | None = None  # metres per unit of the file
    viewpoint: tuple[float, float, float] | None = None  # [m] where a cloud was seen from
    all_round: bool = False  # whether a cloud was seen from all round, its normals to be turned away from its middle
    crop: tuple[float, ...] | None = None  # [m] lower and upper corner
    points: int = 300  # that a cloud is thinned to for its implicit surface
    rays: int = 2000  # through a mesh or cloud
    cache: bool = True

    def __post_init__(self) -> None:
        for name, names in (("method", get_args(Method)), ("prior", get_args(PriorName)), ("rank", METRICS)):
            if getattr(self, name) not in names:
                raise ValueError(f"{name}: expected one of {', '.join(names)}, got {getattr(self, name)!r}")
        if self.all_round and self.viewpoint is not None:
            raise ValueError("viewpoint: expected none for a cloud that was seen from all round")
        if not 0.0 <= self.noise < np.inf:
            raise ValueError(f"noise: expected a standard deviation ≥ 0 [m], got {self.noise}")
        for name in ("top", "points", "rays"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name}: expected at least 1, got {getattr(self, name)}")


class Found(NamedTuple):
    """What a search found."""

    method: str
    grasps: GraspCandidates
    center: Array
    scene: Scene
    notes: list[str]
