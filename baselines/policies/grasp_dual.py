"""GraspDual-v0: both arms take the pipe crawler by two of its handles; see `grasp_pilot`."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim.arms.vehicles import BELEROFONTE_ARMS, VehicleConfig
from aerograsp_env.sim.objects.crawler import crawler_handles, pipe_crawler
from aerograsp_env.spatial import inverse, transform_points
from baselines.grasping.dual import DualPlanner
from baselines.grasping.on_bars import grasps_on_bars
from baselines.grasping.scenes import Scene
from baselines.kinematics.servo import ServoSettings
from baselines.kinematics.tracking import TrackSettings
from baselines.policies.grasp import FAILED_COST, FRICTION, GraspPolicy, failures
from baselines.policies.grasp_pilot import Flight
from baselines.policies.grasp_state import Attempt, Manoeuvre, PilotSettings

Array = NDArray[np.float64]

POINTS = 3000  # of the crawler's surface, for the fingers' room beside its handles


@functools.cache
def crawler_surface(count: int = POINTS) -> Array:
    """(count, 6) points of the crawler's surface [m] and their outward normals, uniform by area; always the same."""
    item, rng = pipe_crawler(), np.random.default_rng(0)
    a, b, c = (np.asarray(item.vertices, dtype=np.float64)[item.faces[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    area = np.linalg.norm(cross, axis=1)
    face = rng.choice(len(area), size=count, p=area / area.sum())
    u, v = np.sqrt(rng.random((count, 1))), rng.random((count, 1))
    points = (1.0 - u) * a[face] + u * ((1.0 - v) * b[face] + v * c[face])
    return np.concatenate([points, cross[face] / area[face, None]], axis=1)


class CrawlerPlanner:
    """Finds the best pair of grasps of the crawler's handles, which the policy knows."""

    def __init__(self, planner: DualPlanner, friction: float = FRICTION) -> None:
        self.planner, self.friction = planner, friction
        self.surface = crawler_surface()
        self.jaws = planner.mounts[0].arm.gripper.jaws

    def __call__(self, scene: Scene, attempts: tuple[Attempt, ...]) -> Manoeuvre | None:
        """The manoeuvre, or None if nothing can be done."""
        T = inverse(scene.T_level_object)
        support = transform_points(T, scene.support), T[:3, :3] @ scene.up
        handles = grasps_on_bars(crawler_handles(), self.surface[:, :3], self.surface[:, 3:], self.jaws, support)
        pairs = self.planner.plan(scene, self.friction, handles).grasps
        if not pairs:
            return None
        scores = [pair.score - FAILED_COST * failures(pair.right.T_object_grasp, attempts) for pair in pairs]
        best = pairs[int(np.argmax(scores))]
        return Manoeuvre((best.right, best.left), best.T_level_object)


def dual_dls(
    vehicle: VehicleConfig = BELEROFONTE_ARMS,
    settings: PilotSettings | None = None,
    track: TrackSettings | None = None,
    servo: ServoSettings | None = None,
) -> GraspPolicy:
    """The analytic policy `dual-dls` of GraspDual-v0; arguments as `grasp_dls` has them."""
    planner = DualPlanner(vehicle)
    return GraspPolicy(Flight(planner.arms, CrawlerPlanner(planner), settings, track, servo))
