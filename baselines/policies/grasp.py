"""Grasp-v0: the arm plans a grasp of the tracker's model, servoes to it and lifts; see `grasp_pilot`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim.arms.vehicles import BELEROFONTE_ARMS, VehicleConfig
from baselines.grasping.reaching import GraspPlanner
from baselines.grasping.scenes import Scene
from baselines.kinematics.servo import ServoSettings
from baselines.kinematics.tracking import TrackSettings
from baselines.policies.grasp_pilot import Flight
from baselines.policies.grasp_reading import read
from baselines.policies.grasp_state import Attempt, Manoeuvre, Pilot, PilotSettings

Array = NDArray[np.float64]
Observation = Mapping[str, NDArray[Any]]

FAILED_NEAR, FAILED_TURN = 0.02, 0.85  # [m] and cosine between approaches: grasps like one that failed …
FAILED_COST = 0.5  # … count so much less
FRICTION = 0.4  # that is counted on


class GraspPolicy:
    """Plans and flies grasps; remembers one `Pilot` for each row of the batch.

    Args:
        flight: the rules, for as many arms as the observations have.
    """

    def __init__(self, flight: Flight) -> None:
        self.flight = flight

    def predict(
        self,
        observation: Observation,
        state: tuple[Pilot | None, ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[Pilot | None, ...]]:
        """(action, state): action (A,) or (N, A) float32 in [−1, 1]."""
        del deterministic
        single = np.ndim(observation["velocity"]) == 1
        rows = {name: np.asarray(value)[None] if single else np.asarray(value) for name, value in observation.items()}
        count = len(rows["velocity"])
        pilots: list[Pilot | None] = list(state) if state is not None else [None] * count
        if episode_start is not None:
            fresh = np.broadcast_to(np.asarray(episode_start, dtype=bool).reshape(-1), (count,))
            pilots = [None if fresh[k] else pilots[k] for k in range(count)]
        actions = np.empty((count, self.flight.size), dtype=np.float32)
        for k in range(count):
            actions[k], pilots[k] = self.flight.step(read(rows, k, self.flight.joints), pilots[k])
        return (actions[0] if single else actions), tuple(pilots)


class SinglePlanner:
    """Finds the best grasp of one arm, away from those that failed."""

    def __init__(self, planner: GraspPlanner, friction: float = FRICTION) -> None:
        self.planner, self.friction = planner, friction

    def __call__(self, scene: Scene, attempts: tuple[Attempt, ...]) -> Manoeuvre | None:
        """The manoeuvre, or None if nothing can be done."""
        grasps = self.planner.plan(scene, self.friction).grasps
        if not grasps:
            return None
        scores = [grasp.score - FAILED_COST * failures(grasp.T_object_grasp, attempts) for grasp in grasps]
        index = int(np.argmax(scores))
        return Manoeuvre((grasps[index],), grasps[index].T_level_object, grasps, index)


def alike(T: Array, other: Array) -> bool:
    """Whether two grasps (4, 4) of an object are nearly the same, fingers swapped or not."""
    near = np.linalg.norm(T[:3, 3] - other[:3, 3]) < FAILED_NEAR
    return bool(near and T[:3, 2] @ other[:3, 2] > FAILED_TURN)


def failures(T: Array, attempts: tuple[Attempt, ...]) -> int:
    """How many attempts with nearly this grasp (4, 4) failed."""
    return sum(alike(T, attempt.grasp.T_object_grasp) for attempt in attempts)


def grasp_dls(
    vehicle: VehicleConfig = BELEROFONTE_ARMS,
    side: str = "right",
    settings: PilotSettings | None = None,
    track: TrackSettings | None = None,
    servo: ServoSettings | None = None,
) -> GraspPolicy:
    """The analytic policy `grasp-dls` of Grasp-v0.

    Args:
        vehicle: as the environment's; the arm needs six joints.
        side: of the arm that is active.
        settings: timing and thresholds.
        track, servo: of the filter and of the arm.
    """
    planner = GraspPlanner(vehicle.with_active([side]), side)
    return GraspPolicy(Flight((planner.arm,), SinglePlanner(planner), settings, track, servo))
