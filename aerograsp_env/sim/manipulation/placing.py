"""Objects at rest on supports: set down in a resting pose, then left to settle in MuJoCo by themselves."""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from aerograsp_env.sim.manipulation.supports import PLATE, RIM_WIDTH, Support
from aerograsp_env.sim.objects import GraspObject
from aerograsp_env.sim.objects.mjcf import object_mjcf
from aerograsp_env.sim.objects.resting import RestingPose, resting_poses

Array = NDArray[np.float64]

GRAVITY = 9.80665  # [m/s²]
TIMESTEP = 0.002  # [s]
CONTACT = 'solref="0.01 1" solimp="0.9 0.95 0.001"'  # as stiff as the contacts of the grasping worlds
GAP = 2e-4  # [m] at which an object is set down above the seat
CLEAR = 1e-3  # [m] from the rim
STEADY = 2e-3  # [m] that gravity's line must pass within the facet that an object stands on
HOLDING = 1.15  # times the slope's tangent: friction that surely holds an object on it
WINDOW = 0.3  # [s] for which an object that has come to rest …
STILL, STILL_TURN = 2e-4, math.radians(0.2)  # … moves [m] and turns [rad] less than this
LONGEST = 4.0  # [s] after which an object that still moves is set down anew
ATTEMPTS = 12
HEADINGS: Array = np.linspace(0.0, 2.0 * np.pi, 72, endpoint=False)
TURNED = math.radians(5.0)  # a given resting pose may lean by this in the end


class PlacementError(ValueError):
    """The object does not come to rest on the support."""


class Motion(NamedTuple):
    """What an object did when it was let go."""

    T_world_object: Array  # (4, 4) in the end
    moved: float  # [m] of its centre of mass, from where it was let go
    turned: float  # [rad]
    still: bool  # it was at rest in the end
    duration: float  # [s]


class _Spot(NamedTuple):
    """A resting pose turned by a heading, and where on the seat its centre may stand."""

    pose: RestingPose
    heading: float  # [rad] from the seat's x axis to the resting pose's
    low: Array  # (2,) [m]
    high: Array  # (2,) [m]


def possible_poses(item: GraspObject, support: Support) -> tuple[RestingPose, ...]:
    """The item's resting poses in which it fits on the seat, and does not tip on its slope at one heading or more."""
    return tuple(pose for pose in resting_poses(item) if _first_spot(item, support, pose, HEADINGS) is not None)


def place(
    item: GraspObject,
    support: Support,
    rng: np.random.Generator,
    *,
    pose: RestingPose | None = None,
    heading: float | None = None,
    spread: float = 0.03,
) -> Array:
    """T_world_object of the item at rest on the support.

    A resting pose is drawn by its probability among those that are possible there, then a heading at which it does not
    tip, and the place of its centre from a square around the seat's. Where friction does not hold the item on the slope
    or no pose keeps it from rolling, it is let go next to the lower rim, and what comes back is how it lies in the end.
    Either way it touches the seat within 0.2 mm, and stays.

    Args:
        pose: one of `resting_poses(item)`, to be the only one.
        heading: of the resting pose's x axis from the seat's [rad], to be the only one.
        spread: half the side of that square [m].

    Raises:
        PlacementError: the item does not fit on the seat, or none of a dozen attempts came to rest on it.
    """
    if not 0.0 <= spread < math.inf:
        raise ValueError(f"spread: expected a length of zero or more [m], got {spread}")
    if heading is not None and not math.isfinite(heading):
        raise ValueError(f"heading: expected an angle [rad], got {heading}")
    poses = resting_poses(item) if pose is None else (pose,)
    slides = support.contact_friction(item) < HOLDING * math.tan(support.slope)
    for rolls in (False, True):
        weights = np.array([p.probability for p in poses])
        attempts = 0
        while weights.any() and attempts < ATTEMPTS:
            index = int(rng.choice(len(poses), p=weights / weights.sum()))
            turns = (
                rng.permutation(HEADINGS) + rng.uniform(0.0, HEADINGS[1]) if heading is None else np.array([heading])
            )
            spot = _first_spot(item, support, poses[index], turns, rolls)
            if spot is None:
                weights[index] = 0.0
                continue
            attempts += 1
            found = _set_down(item, support, spot, rng.uniform(-spread, spread, 2), slides or rolls, pose is not None)
            if found is not None:
                return found
        if attempts:
            raise PlacementError(f"item: {item.name} did not come to rest on {support.name} in {attempts} attempts")
    raise PlacementError(f"item: {item.name} does not fit on the seat of {support.name}")


def _set_down(
    item: GraspObject, support: Support, spot: _Spot, center: Array, free: bool, keep_pose: bool
) -> Array | None:
    """T_world_object of the item set down there; if it is `free` to move, where it ends, or None if that is no rest."""
    x, y = np.clip(center, spot.low, spot.high)
    onto = _turn(spot.heading) @ spot.pose.T_support_object
    if not free:
        return np.asarray(support.T_world_seat @ _translation(x, y, 0.0) @ onto)
    start = support.T_world_seat @ _translation(spot.high[0], y, GAP) @ onto
    motion = settle(item, support, start)
    end = motion.T_world_object
    middle = end[:3, :3] @ item.center_of_mass + end[:3, 3]
    fallen = keep_pose and _lean(start, end, support) > TURNED
    return end if motion.still and not fallen and support.contains(middle) else None


def settle(item: GraspObject, support: Support, T_world_object: Array, longest: float = LONGEST) -> Motion:
    """Let the item go on the support's seat, until it lies still or `longest` [s] have passed."""
    model = _model(item, support.half_size, support.rim, support.contact_friction(item))
    data = mujoco.MjData(model)
    to_seat = np.linalg.inv(support.T_world_seat)
    data.qpos[:] = _qpos(to_seat @ T_world_object)
    data.xfrc_applied[1, :3] = -item.mass * GRAVITY * support.T_world_seat[2, :3]  # gravity, in the seat's frame
    steps = round(WINDOW / TIMESTEP)
    first = before = data.qpos.copy()
    still, time = False, 0.0
    while time < longest and not still:
        mujoco.mj_step(model, data, nstep=steps)
        time += WINDOW
        now = data.qpos.copy()
        if not np.isfinite(now).all() or abs(now[2]) > 1.0:
            break
        moved, turned = _between(item, before, now)
        still = moved < STILL and turned < STILL_TURN
        before = now
    moved, turned = _between(item, first, data.qpos)
    return Motion(support.T_world_seat @ _matrix(data.qpos), moved, turned, still, time)


@functools.lru_cache(maxsize=48)
def _model(item: GraspObject, half_size: tuple[float, float], rim: float, friction: float) -> mujoco.MjModel:
    """The item over the seat, in the seat's frame and without gravity, so that one model serves every slope."""
    support = f'condim="4" friction="{friction:.9g} 0.002 0.0001" priority="1" {CONTACT}'
    x, y = half_size
    outer_x, outer_y, w = x + RIM_WIDTH, y + RIM_WIDTH, 0.5 * RIM_WIDTH
    boxes = [((outer_x, outer_y, PLATE), (0.0, 0.0, -PLATE))]
    if rim > 0.0:
        h = 0.5 * (rim + PLATE)
        boxes += [((w, outer_y, h), (s * (x + w), 0.0, h - PLATE)) for s in (1.0, -1.0)]
        boxes += [((x, w, h), (0.0, s * (y + w), h - PLATE)) for s in (1.0, -1.0)]
    seat = "\n".join(
        f'<geom type="box" size="{a[0]:.9g} {a[1]:.9g} {a[2]:.9g}" pos="{b[0]:.9g} {b[1]:.9g} {b[2]:.9g}" {support}/>'
        for a, b in boxes
    )
    text = object_mjcf(item)
    return mujoco.MjModel.from_xml_string(f"""
<mujoco model="rest">
  <option timestep="{TIMESTEP}" gravity="0 0 0" integrator="implicitfast" cone="elliptic" impratio="100"/>
  <size memory="4M"/>
  <default><default class="object"><geom contype="0" conaffinity="1"/></default></default>
  <asset>{text.assets}</asset>
  <worldbody>{seat}{text.body}</worldbody>
</mujoco>""")


def _first_spot(
    item: GraspObject, support: Support, pose: RestingPose, headings: Array, tips: bool = False
) -> _Spot | None:
    """Where the item may stand so, at the first heading at which it fits and does not tip (or may); else None."""
    outline = _outline(item, pose, support.rim + CLEAR)
    room = np.asarray(support.half_size) - CLEAR
    for heading in headings:
        if not tips and pose.margin(support.slope, -heading) < STEADY * (support.slope > 0.0):
            continue
        turned = outline @ _turn(heading)[:2, :2].T
        low, high = -room - turned.min(axis=0), room - turned.max(axis=0)
        if (low <= high).all():
            return _Spot(pose, heading, low, high)
    return None


def _outline(item: GraspObject, pose: RestingPose, height: float) -> Array:
    """(K, 2) points around whatever of the item lies below a height over the seat [m]."""
    points = item.vertices @ pose.T_support_object[:3, :3].T + pose.T_support_object[:3, 3]
    starts = points[item.faces].reshape(-1, 3)
    ends = points[np.roll(item.faces, -1, axis=1)].reshape(-1, 3)
    cut = (starts[:, 2] < height) & (ends[:, 2] > height)  # every edge runs both ways: each is cut once
    share = (height - starts[cut, 2]) / (ends[cut, 2] - starts[cut, 2])
    crossing = starts[cut] + share[:, None] * (ends[cut] - starts[cut])
    return np.asarray(np.concatenate([points[points[:, 2] <= height, :2], crossing[:, :2]]))


def _lean(start: Array, end: Array, support: Support) -> float:
    """How far the direction that pointed out of the seat has turned away from it [rad]."""
    up = support.T_world_seat[:3, 2]
    return math.acos(float(np.clip(up @ (end[:3, :3] @ start[:3, :3].T @ up), -1.0, 1.0)))


def _between(item: GraspObject, one: Array, other: Array) -> tuple[float, float]:
    a, b = _matrix(one), _matrix(other)
    moved = (b[:3, :3] - a[:3, :3]) @ item.center_of_mass + b[:3, 3] - a[:3, 3]
    return float(np.linalg.norm(moved)), float(Rotation.from_matrix(a[:3, :3].T @ b[:3, :3]).magnitude())


def _matrix(qpos: Array) -> Array:
    w, x, y, z = qpos[3:7]
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat((x, y, z, w)).as_matrix()
    T[:3, 3] = qpos[:3]
    return T


def _qpos(T: Array) -> Array:
    x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat()
    return np.array([*T[:3, 3], w, x, y, z])


def _turn(heading: float) -> Array:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("z", heading).as_matrix()
    return T


def _translation(x: float, y: float, z: float) -> Array:
    T = np.eye(4)
    T[:3, 3] = (x, y, z)
    return T
