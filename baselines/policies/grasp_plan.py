"""Grasp planning from one view: what each policy knows, and how it ranks.

| policy | candidates | ranking |
| --- | --- | --- |
| `gpis` | implicit surface, its prior a fitted ellipsoid | closure, distance to the centre of mass, clearance |
| `gpis-constant` | the same with a constant prior | the same |
| `cloud` | rays through the seen points | friction to spare, distance to the middle of the points |
| `com` | as `gpis`, but whatever the friction cone says | distance to the centre of mass only |
| `random-eligible` | as `gpis` | none: one at random of those that fit and are within the friction cone |
| `oracle-mesh` | rays through the true mesh | friction to spare, distance to the true centre of mass |

A policy that finds no grasp answers zeros, which is no grasp: where a cloud says too little (`usable`), where nothing
fits, or where all that fits is farther from the cloud's origin than an action can say.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping, MutableMapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.envs.grasp_cloud import MIN_WIDTH, REACH
from aerograsp_env.envs.grasp_plan import Cloud, encode_grasp, unpack_cloud
from aerograsp_env.interfaces import Grasp
from aerograsp_env.sim.gripper import GripperConfig
from baselines.grasping import grasps_on_cloud, grasps_on_mesh
from baselines.grasping.antipodal import closing_angles, line_distance
from baselines.grasping.candidates import GraspCandidates
from baselines.grasping.contacts import Array
from baselines.grasping.on_cloud import FEWEST
from baselines.grasping.planning import PlannerConfig, Proposals, propose, usable
from baselines.grasping.ranking import CONTEXT

__all__ = ["CONTEXT", "GraspPolicy", "MeshOracle", "planner"]

Observation = Mapping[str, NDArray[Any]]
Plan = Callable[[Cloud, np.random.Generator], Grasp | None]
Propose = Callable[[Cloud, np.random.Generator], Proposals]

ANY_FRICTION = 50.0  # a cone of 89°: no condition on the normals
NEAR = 0.015  # [m] from the middle of the points at which the preference of `cloud` has fallen to e^−1/2
ORACLE_RAYS = 3000
ORACLE_ANGLE = np.radians(10.0)  # of the closing line, and
ORACLE_REACH = 0.010  # [m] its distance, at which the oracle's preference has fallen to e^−1


class GraspPolicy:
    """A planner as a policy: one grasp an observation, without state.

    Args:
        plan: what finds a grasp in a cloud; its generator is seeded by the cloud's own content.
        gripper: of the environment.
    """

    def __init__(self, plan: Plan, gripper: GripperConfig | None = None) -> None:
        self.plan, self.gripper = plan, gripper or GripperConfig()

    def predict(self, observation: Observation, state=None, episode_start=None, deterministic: bool = True):
        """(action, state): action (10,) or (N, 10) float32 in [−1, 1]; the state is always None."""
        del state, episode_start, deterministic
        points = np.asarray(observation["points"])
        if points.ndim == 1:
            return self._action(observation), None
        rows = [{key: value[row] for key, value in observation.items()} for row in range(len(points))]
        return np.stack([self._action(row) for row in rows]), None

    def _action(self, observation: Observation) -> NDArray[np.float32]:
        cloud = unpack_cloud(observation)
        grasp = self.plan(cloud, content_rng(observation)) if usable(cloud.points) else None
        return np.zeros(10, dtype=np.float32) if grasp is None else encode_grasp(grasp, self.gripper)


def content_rng(observation: Observation) -> np.random.Generator:
    """A generator that equal observations seed equally."""
    return np.random.default_rng(zlib.crc32(np.ascontiguousarray(observation["points"]).tobytes()))


def planner(name: str, gripper: GripperConfig | None = None, config: PlannerConfig | None = None) -> Propose:
    """The planner behind "gpis", "gpis-constant" or "com", with everything that it found and an action can say.

    Raises:
        ValueError: another name.
    """
    config = config or PlannerConfig()
    if name not in ("gpis", "gpis-constant", "com"):
        raise ValueError(f"name: expected 'gpis', 'gpis-constant' or 'com', got {name!r}")
    if name == "gpis-constant":
        config = replace(config, prior="constant")
    friction = ANY_FRICTION if name == "com" else None

    def plan(cloud: Cloud, rng: np.random.Generator) -> Proposals:
        found = propose(cloud.points, cloud.normals, cloud.noise, cloud.viewpoint, rng, config, gripper, friction)
        return found.take(_expressible(found.candidates.centers, found.candidates.widths))

    return plan


def _expressible(centers: Array, widths: Array) -> NDArray[np.bool_]:
    """(G,) whether an action can say a grasp with this centre (G, 3) [m] and width (G,) [m]; see `encode_grasp`."""
    return (np.abs(centers) <= REACH).all(axis=1) & (widths >= MIN_WIDTH)


def _best(proposals: Proposals) -> Grasp | None:
    return proposals.grasp(0) if len(proposals) else None


def _first(find: Propose, cloud: Cloud, rng: np.random.Generator) -> Grasp | None:
    return _best(find(cloud, rng))


def _nearest(find: Propose, cloud: Cloud, rng: np.random.Generator) -> Grasp | None:
    proposals = find(cloud, rng)
    if not len(proposals):
        return None
    return proposals.grasp(int(np.argmin(line_distance(proposals.candidates.positions, proposals.estimate.center))))


def _any(find: Propose, cloud: Cloud, rng: np.random.Generator) -> Grasp | None:
    proposals = find(cloud, rng)
    return proposals.grasp(int(rng.integers(len(proposals)))) if len(proposals) else None


def _on_seen(gripper: GripperConfig, cloud: Cloud, rng: np.random.Generator) -> Grasp | None:
    points, rows = np.unique(cloud.points, axis=0, return_index=True)  # a point's repetition is no neighbour
    if len(points) < FEWEST:
        return None
    found = grasps_on_cloud(points, cloud.normals[rows], gripper, viewpoint=cloud.viewpoint, rng=rng)
    found = found.take(_expressible(found.centers, found.widths))
    if not len(found):
        return None
    distance = line_distance(found.positions, cloud.points.mean(axis=0))
    return found.grasps()[int(np.argmax(found.score - 0.5 * (distance / NEAR) ** 2))]


def gpis(gripper: GripperConfig | None = None) -> GraspPolicy:
    """The reference policy."""
    return GraspPolicy(partial(_first, planner("gpis", gripper)), gripper)


def gpis_constant(gripper: GripperConfig | None = None) -> GraspPolicy:
    """Without a shape for a prior."""
    return GraspPolicy(partial(_first, planner("gpis-constant", gripper)), gripper)


def com(gripper: GripperConfig | None = None) -> GraspPolicy:
    """The grasp nearest to the estimated centre of mass."""
    return GraspPolicy(partial(_nearest, planner("com", gripper)), gripper)


def random_eligible(gripper: GripperConfig | None = None) -> GraspPolicy:
    """Any grasp that fits."""
    return GraspPolicy(partial(_any, planner("gpis", gripper)), gripper)


def cloud(gripper: GripperConfig | None = None) -> GraspPolicy:
    """What the seen points alone allow."""
    return GraspPolicy(partial(_on_seen, gripper or GripperConfig()), gripper)


class MeshOracle:
    """Plans on the true mesh, mass distribution and pose: an upper bound, not a competitor.

    Args:
        gripper: of the environment.
    """

    def __init__(self, gripper: GripperConfig | None = None) -> None:
        self.gripper = gripper or GripperConfig()
        self._worlds: Sequence[Any] = ()
        self._found: MutableMapping[Any, GraspCandidates] = WeakKeyDictionary()  # by object, as long as it lives

    def watch(self, worlds: Sequence[Any]) -> None:
        """The unwrapped environments to act in, row by row."""
        self._worlds = worlds

    def predict(self, observation: Observation, state=None, episode_start=None, deterministic: bool = True):
        """(action, state): action (10,) or (N, 10) float32 in [−1, 1].

        Raises:
            RuntimeError: it was not told what worlds to watch.
        """
        del state, episode_start, deterministic
        points = np.asarray(observation["points"])
        rows = 1 if points.ndim == 1 else len(points)
        if len(self._worlds) < rows:
            raise RuntimeError(f"oracle-mesh: expected {rows} worlds to watch, got {len(self._worlds)}; call watch()")
        actions = np.stack([self._action(world) for world in self._worlds[:rows]])
        return (actions[0] if points.ndim == 1 else actions), None

    def _action(self, world: Any) -> NDArray[np.float32]:
        item, T = world.object, world.T_cloud_object
        found = self._found.get(item)
        if found is None:
            found = self._found[item] = self._plan(item)
        within = np.flatnonzero(_expressible(found.centers @ T[:3, :3].T + T[:3, 3], found.widths))
        if not len(within):
            return np.zeros(10, dtype=np.float32)
        return encode_grasp(moved(found.take(within[:1]).grasps()[0], T), self.gripper)

    def _plan(self, item: Any) -> GraspCandidates:
        """All that was found on an object, in its frame, best first."""
        found = grasps_on_mesh((item.vertices, item.faces), self.gripper, n_rays=ORACLE_RAYS)
        angle = closing_angles(found.positions, found.normals) / ORACLE_ANGLE
        distance = line_distance(found.positions, item.center_of_mass) / ORACLE_REACH
        return found.order(-(angle**2) - distance**2)


def oracle_mesh(gripper: GripperConfig | None = None) -> MeshOracle:
    """Reads the simulator's truth."""
    return MeshOracle(gripper)


def moved(grasp: Grasp, T: Array) -> Grasp:
    """A grasp in another frame: T (4, 4) maps its coordinates there."""
    closing = T[:3, :3] @ grasp.closing_axis
    closing = closing / np.linalg.norm(closing)
    approach = T[:3, :3] @ grasp.approach_axis
    approach = approach - closing * (closing @ approach)
    center = T[:3, :3] @ grasp.center + T[:3, 3]
    return Grasp(center, closing, approach / np.linalg.norm(approach), grasp.width)
