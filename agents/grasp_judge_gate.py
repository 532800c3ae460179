"""Is the judge worth asking? Grasps that must hold and grasps that must not, on every test object."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from aerograsp_env.interfaces import Grasp
from aerograsp_env.sim.grasp_judge import Judgement, judge_grasp
from aerograsp_env.sim.gripper import GripperConfig
from aerograsp_env.sim.objects import GraspObject, test_objects
from agents.reproduction import Reproduction, Request, text_table
from agents.statistics import wilson_interval
from baselines.grasping.antipodal import closing_angles, line_distance
from baselines.grasping.candidates import Pairs
from baselines.grasping.contacts import Array
from baselines.grasping.on_mesh import RayPattern, box_rays, opposed_pairs
from baselines.objects import MeshObject
from baselines.policies.grasp_plan import moved

TRIALS = 25  # of each kind on each object
RAYS = 6000
CLEARANCE = 0.012  # [m] of each open pad
LEAST_WIDTH = 0.004  # [m]
SIDES = 8
GOOD_SHARE = 0.3  # of the cone's angle
GOOD_DISTANCE = 0.010  # [m]
BEYOND = np.radians(12.0)

NOTES = """\
Up to {trials} grasps of each kind on each object: lines through it, random sides without a collision, random
orientations. Must hold: both normals within {share:.0%} of the friction cone's angle, and the closing line within
{distance:.0f} mm of the centre of mass; half of these lines are parallel to the edges of the object's box. Must not: a
normal more than {beyond:.0f}° outside of the cone."""


def pairs_through(item: GraspObject, pattern: RayPattern, rng: np.random.Generator) -> Pairs:
    """Opposed contacts on lines through the object that the jaws open wide enough for."""
    mesh = MeshObject.from_arrays(item.vertices, item.faces)
    lower, upper = item.vertices.min(axis=0), item.vertices.max(axis=0)
    pairs, _ = opposed_pairs(mesh, *box_rays(lower, upper, RAYS, pattern, rng))
    width = np.linalg.norm(pairs.positions[:, 1] - pairs.positions[:, 0], axis=1)
    return pairs.take((width > LEAST_WIDTH) & (width < GripperConfig().max_width - CLEARANCE))


def trials(item: GraspObject, good: bool, count: int, rng: np.random.Generator) -> tuple[int, int, int]:
    """Grasps tried, held, and held strictly; those that collide from every side that is tried are left out."""
    gripper = GripperConfig()
    pairs = pairs_through(item, "both" if good else "oblique", rng)
    angle = closing_angles(pairs.positions, pairs.normals)
    cone = np.arctan(gripper.friction)
    if good:
        fits = (angle < GOOD_SHARE * cone) & (line_distance(pairs.positions, item.center_of_mass) < GOOD_DISTANCE)
    else:
        fits = angle > cone + BEYOND
    tried = held = strict = 0
    for row in rng.permutation(np.flatnonzero(fits)):
        judgement = attempt(item, pairs.positions[row], gripper, rng)
        if judgement is not None:
            tried, held, strict = tried + 1, held + judgement.held, strict + judgement.strict
        if tried == count:
            break
    return tried, held, strict


def attempt(item: GraspObject, contacts: Array, gripper: GripperConfig, rng: np.random.Generator) -> Judgement | None:
    """What becomes of a grasp at two contacts (2, 3) from the first of eight random sides without a collision."""
    line = contacts[1] - contacts[0]
    width = float(np.linalg.norm(line))
    opening = min(width + 2.0 * CLEARANCE, gripper.max_width)
    for _ in range(SIDES):
        approach = np.cross(line, rng.standard_normal(3))
        grasp = Grasp(contacts.mean(axis=0), line / width, approach / np.linalg.norm(approach), opening)
        T = np.eye(4)
        T[:3, :3] = Rotation.random(random_state=rng).as_matrix()
        judgement = judge_grasp(item, moved(grasp, T), T, gripper)
        if judgement.outcome != "collision":
            return judgement
    return None


def run(request: Request, count: int = TRIALS) -> Reproduction:
    """Rates per object and over all."""
    rows = [["object", "tags", "must hold", "held", "strict", "must not", "held"]]
    total = np.zeros((2, 3), dtype=int)
    data: dict[str, Any] = {}
    for index, item in enumerate(test_objects()):
        rng = np.random.default_rng([request.seed, index])
        both = np.array([trials(item, good, count, rng) for good in (True, False)])
        total += both
        data[item.name] = {"good": both[0].tolist(), "wrong": both[1].tolist()}
        rows.append([item.name, ", ".join(sorted(item.tags)), *map(str, both[0]), *map(str, both[1, :2])])
    (n, held, strict), (wrong, escaped, _) = total.tolist()
    rows.append(["all", "", *map(str, (n, held, strict, wrong, escaped))])
    lines = []
    for name, hits, of in (("must hold: held", held, n), ("strict", strict, n), ("must not: held", escaped, wrong)):
        low, high = wilson_interval(hits, of)
        lines.append(f"{name} {hits / of:.3f} [{low:.3f}, {high:.3f}]")
    notes = NOTES.format(trials=count, share=GOOD_SHARE, distance=1e3 * GOOD_DISTANCE, beyond=np.degrees(BEYOND))
    data["all"] = {"good": total[0].tolist(), "wrong": total[1].tolist()}
    return Reproduction("\n".join([text_table(rows), *lines, "", notes]), data)
