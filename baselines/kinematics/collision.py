"""Collisions and distances of a vehicle's arms: with each other, with the airframe, with themselves, with obstacles.

Every part is one of the convex shapes of the vehicle's description, or the hull of an obstacle's piece; distances come
from coal (Pan et al. 2012, FCL; Montaut et al. 2022 for its accelerated GJK). They are negative by the depth of
penetration.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import coal
import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.sim.arms.description import Shape
from aerograsp_env.sim.arms.vehicles import ArmMount, VehicleConfig
from aerograsp_env.spatial import as_array, check_transform
from baselines.kinematics.arm import Arm

Array = NDArray[np.float64]

KINDS = ("arm-frame", "arm-arm", "self", "arm-obstacle")
# Links of one arm that lie closer along the chain touch at their common joints.
NEAREST_OF_ONE_ARM = 3


class Pair(NamedTuple):
    """Two parts and the distance between them [m], negative where they overlap."""

    first: str
    second: str
    distance: float


class Clearance(NamedTuple):
    """The nearest pair of each kind; a kind without pairs is infinitely clear."""

    arm_frame: Pair
    arm_arm: Pair
    itself: Pair  # links of one arm
    arm_obstacle: Pair

    @property
    def nearest(self) -> Pair:
        """Of them all."""
        return min(self, key=lambda pair: pair.distance)


_CLEAR = Pair("", "", math.inf)


class _Part(NamedTuple):
    name: str
    owner: str  # "frame", a side, or an obstacle's name
    link: int  # whose frame the part is in; −1 where that is the owner's own
    geometry: coal.CollisionGeometry
    T: Array  # (4, 4) in the link's, the body's or the obstacle's frame
    radius: float  # of a ball round T's origin that holds the part [m]


def convex_hull(points: ArrayLike) -> coal.ConvexBase:
    """The hull of points (N, 3) [m], N ≥ 4, not in one plane.

    Raises:
        ValueError: fewer or flat points, or points that are not finite.
    """
    array = as_array(points, (3,), "points")
    spread = np.linalg.svd(array - array.mean(axis=0), compute_uv=False) if len(array) >= 4 else np.zeros(3)
    if spread[-1] <= 1e-9:
        raise ValueError(f"points: expected at least 4 that span a volume, got {len(array)} that do not")
    vertices = coal.StdVec_Vec3s()
    for point in array:
        vertices.append(point)
    return coal.Convex.convexHull(vertices, True, None)


def _geometry(shape: Shape) -> tuple[coal.CollisionGeometry, float]:
    """The shape, centred at its own frame, and the radius of a ball round it."""
    if shape.kind == "box":
        half = np.asarray(shape.size)
        return coal.Box(*(2.0 * half)), float(np.linalg.norm(half))
    radius, half_length = shape.size
    if shape.kind == "capsule":
        return coal.Capsule(radius, 2.0 * half_length), radius + half_length
    return coal.Cylinder(radius, 2.0 * half_length), math.hypot(radius, half_length)


def _of_shape(shape: Shape, name: str, owner: str, link: int = -1) -> _Part:
    geometry, radius = _geometry(shape)
    return _Part(name, owner, link, geometry, np.asarray(shape.T_link_shape), radius)


class CollisionModel:
    """What may collide on a vehicle and around it.

    Args:
        vehicle: its mounts are the arms that move.
        obstacles: by name, the convex pieces of things around the vehicle: shapes, or the vertices (N, 3) [m] of a
            hull. Each obstacle is one rigid body, whose pose is given with every question.

    Raises:
        ValueError: an obstacle without pieces or of the name of a side, or pieces that are not convex bodies.
    """

    def __init__(self, vehicle: VehicleConfig, obstacles: Mapping[str, Sequence[Shape | Array]] | None = None) -> None:
        self.vehicle = vehicle
        self.arms: dict[str, Arm] = {
            mount.side: Arm.from_config(mount.arm, mount.T_body_base) for mount in vehicle.mounts
        }
        self._mounts: dict[str, ArmMount] = {mount.side: mount for mount in vehicle.mounts}
        parts = [_of_shape(shape, f"frame/{shape.name}", "frame") for shape in vehicle.shapes]
        for mount in vehicle.mounts:
            parts += _arm_parts(mount)
        for name, pieces in (obstacles or {}).items():
            if name in (*self._mounts, "frame") or not len(pieces):
                raise ValueError(f"obstacles: expected pieces under a name of their own, got {len(pieces)} in {name!r}")
            for i, piece in enumerate(pieces):
                if isinstance(piece, Shape):
                    parts.append(_of_shape(piece, f"{name}/{piece.name}", name))
                else:
                    hull, reach = convex_hull(piece), float(np.linalg.norm(piece, axis=1).max())
                    parts.append(_Part(f"{name}/{i}", name, -1, hull, np.eye(4), reach))
        self._parts = parts
        self._obstacles = tuple(obstacles or {})
        self._radii = np.array([part.radius for part in parts])
        pairs = list(self._pairs())
        self._pair_indices = np.array([(i, j) for i, j, _ in pairs], dtype=np.int64).reshape(-1, 2)
        self._kinds = np.array([kind for _, _, kind in pairs], dtype=np.int64)
        self._measures: dict[int, coal.ComputeDistance] = {}
        self._request = coal.DistanceRequest(False)
        self._request.enable_signed_distance = True

    def _pairs(self) -> Iterator[tuple[int, int, int]]:
        for j, second in enumerate(self._parts):
            for i, first in enumerate(self._parts[:j]):
                kind = self._kind(first, second)
                if kind >= 0:
                    yield i, j, kind

    def _kind(self, first: _Part, second: _Part) -> int:
        """Index in KINDS of what the pair's distance means, −1 where it is not asked for."""
        arms = [part for part in (first, second) if part.owner in self._mounts]
        if not arms:
            return -1
        if first.owner == second.owner:
            last = self._mounts[first.owner].arm.n - 1  # jaws and palm belong to the last link
            apart = abs(min(first.link, last) - min(second.link, last))
            return KINDS.index("self") if apart >= NEAREST_OF_ONE_ARM else -1
        if len(arms) == 2:
            return KINDS.index("arm-arm")
        if "frame" in (first.owner, second.owner):
            # the base is bolted to the airframe, and the yaw bracket turns on it
            return KINDS.index("arm-frame") if arms[0].link >= 1 else -1
        return KINDS.index("arm-obstacle")

    def _poses(
        self, angles: Mapping[str, ArrayLike], widths: Mapping[str, float], poses: Mapping[str, ArrayLike]
    ) -> Array:
        """(P, 4, 4) T_body_part."""
        for name in (*angles, *widths):
            if name not in self._mounts:
                raise ValueError(f"angles, widths: {self.vehicle.name} has arms {list(self._mounts)}, not {name!r}")
        for name in poses:
            if name not in self._obstacles:
                raise ValueError(f"poses: expected obstacles among {list(self._obstacles)}, got {name!r}")
        frames: dict[tuple[str, int], Array] = {("frame", -1): np.eye(4)}
        for name in self._obstacles:
            frames[name, -1] = check_transform(poses[name], f"poses[{name!r}]") if name in poses else np.eye(4)
        for side, mount in self._mounts.items():
            arm = mount.arm
            links = self.arms[side].link_poses(angles.get(side, arm.stowed))
            frames[side, -1] = np.asarray(mount.T_body_base)
            for link in range(arm.n):
                frames[side, link] = links[link]
            jaws = arm.gripper.jaws
            width = widths.get(side, jaws.max_width)
            if not 0.0 <= width <= jaws.max_width:
                raise ValueError(f"widths[{side!r}]: expected an opening in [0, {jaws.max_width}] m, got {width}")
            closed = 0.5 * (jaws.max_width - width)
            for finger in range(3):  # left, right, palm: "links" n, n + 1, n + 2
                T = links[-1].copy()
                T[:3, 3] += (closed, -closed, 0.0)[finger] * T[:3, 0]
                frames[side, arm.n + finger] = T
        return np.stack([frames[part.owner, part.link] @ part.T for part in self._parts])

    def _distances(self, placed: Array, ignore: Sequence[tuple[str, str]], bounds: Array) -> Iterator[tuple[int, Pair]]:
        """(kind, pair), nearest balls first, of the pairs whose balls are nearer than the kind's bound [m].

        `bounds` (len(KINDS),) may be lowered between two pairs.
        """
        i, j = self._pair_indices.T
        centers = placed[:, :3, 3]
        gaps = np.linalg.norm(centers[i] - centers[j], axis=1) - self._radii[i] - self._radii[j]
        near = np.flatnonzero(gaps < bounds[self._kinds])
        transforms: dict[int, coal.Transform3s] = {}
        result = coal.DistanceResult()
        for k in near[np.argsort(gaps[near], kind="stable")].tolist():
            if gaps[k] >= bounds[self._kinds[k]]:
                continue
            first, second = self._parts[i[k]], self._parts[j[k]]
            if any({first.owner, second.owner} == set(pair) for pair in ignore):
                continue
            for index in (i[k], j[k]):
                if index not in transforms:
                    T = placed[index]
                    transforms[index] = coal.Transform3s(T[:3, :3], T[:3, 3])
            if k not in self._measures:
                self._measures[k] = coal.ComputeDistance(first.geometry, second.geometry)
            result.clear()
            distance = self._measures[k](transforms[i[k]], transforms[j[k]], self._request, result)
            yield int(self._kinds[k]), Pair(first.name, second.name, float(distance))

    def clearance(
        self,
        angles: Mapping[str, ArrayLike],
        widths: Mapping[str, float] | None = None,
        poses: Mapping[str, ArrayLike] | None = None,
        ignore: Sequence[tuple[str, str]] = (),
        within: float = 0.5,
    ) -> Clearance:
        """The nearest pair of every kind.

        Args:
            angles: side → joint angles (n,) [rad]; an arm that is not named is stowed.
            widths: side → opening of the jaws [m], fully open by default.
            poses: obstacle → T_body_obstacle (4, 4), identity by default.
            ignore: pairs of owners (a side, "frame", an obstacle) between which contact is wanted.
            within: pairs farther apart than this are not measured [m], and are infinitely clear.

        Raises:
            ValueError: an arm or obstacle that is not there, angles of another number, a pose that is not rigid.
        """
        nearest = [_CLEAR] * len(KINDS)
        placed = self._poses(angles, widths or {}, poses or {})
        bounds = np.full(len(KINDS), float(within))
        for kind, pair in self._distances(placed, ignore, bounds):
            if pair.distance < nearest[kind].distance:
                nearest[kind] = pair
                bounds[kind] = min(pair.distance, within)
        return Clearance(*nearest)

    def collides(
        self,
        angles: Mapping[str, ArrayLike],
        widths: Mapping[str, float] | None = None,
        poses: Mapping[str, ArrayLike] | None = None,
        ignore: Sequence[tuple[str, str]] = (),
        margin: float = 0.0,
    ) -> Pair | None:
        """A pair that comes closer than `margin` [m], or None; arguments and errors as for `clearance`."""
        placed = self._poses(angles, widths or {}, poses or {})
        for _, pair in self._distances(placed, ignore, np.full(len(KINDS), float(margin))):
            if pair.distance < margin:
                return pair
        return None


def _arm_parts(mount: ArmMount) -> list[_Part]:
    """Base (link −1), links 0 … n − 1, and the gripper: left and right jaw, palm (n, n + 1, n + 2)."""
    arm, side = mount.arm, mount.side
    parts = [_of_shape(shape, f"{side}/{shape.name}", side) for shape in arm.base.shapes]
    for i, link in enumerate(arm.links):
        parts += [_of_shape(shape, f"{side}/{link.name}/{shape.name}", side, i) for shape in link.shapes]
    jaws = arm.gripper.jaws
    for box in jaws.boxes(jaws.max_width):
        finger = ("left", "right", "palm").index(box.name.partition("_")[0])
        shape = Shape.box(box.name, box.center, box.half_size)
        parts.append(_of_shape(shape, f"{side}/{box.name}", side, arm.n + finger))
    return parts
