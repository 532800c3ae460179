"""How an object can rest on a plane: the facets of its convex hull that it can stand on, and how often it comes there.

An object dropped in a random orientation and losing its energy at once comes down on the facet of its hull that lies
below the centre of mass. It stays if the centre of mass is above that facet, and else rolls over the edge it lies
beyond, on to the next facet (Goldberg, Mirtich, Zhuang, Craig, Carlisle and Canny 1999, "Part pose statistics:
estimators and experiments", IEEE Transactions on Robotics and Automation 15(5)). The probability of a resting pose is
the solid angle, seen from the centre of mass, of all facets that lead to its own.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from aerograsp_env.sim.objects.grasp_object import GraspObject

Array = NDArray[np.float64]

FLAT = 2e-5  # [m] vertices this close to a facet's plane belong to the facet
STEADY = 1e-3  # [m] at which a centre of mass inside a facet's edge still counts as above the edge
RARE = 0.004  # probability below which a pose is left out


class RestingPose(NamedTuple):
    """An object on the plane z = 0, its centre of mass on the z axis. The heading is arbitrary, but always the same."""

    T_support_object: Array  # (4, 4)
    probability: float  # of coming to rest so, among the poses that are returned
    height: float  # [m] of the object's highest point
    center_height: float  # [m] of its centre of mass
    polygon: Array  # (K, 2) [m] corners of the facet it stands on, counter-clockwise from above

    def margin(self, slope: float = 0.0, downhill: float = 0.0) -> float:
        """Distance [m] from the edge of the facet at which gravity's line through the centre of mass meets it.

        Negative where the object tips over.

        Args:
            slope: of the plane [rad].
            downhill: angle from x to the steepest descent, about z [rad].
        """
        reach = self.center_height * np.tan(slope)
        return float(-_beyond(self.polygon, reach * np.array([np.cos(downhill), np.sin(downhill)])).max())


class _Facet(NamedTuple):
    normal: Array  # (3,) outward
    height: float  # [m] of the centre of mass above it
    polygon: Array  # (K, 2) [m] around the centre of mass, counter-clockwise against the normal
    corners: NDArray[np.intp]  # (K,) of the hull's vertices
    members: frozenset[int]  # every hull vertex in the plane
    share: float  # of the full solid angle


@functools.lru_cache(maxsize=512)
def resting_poses(item: GraspObject) -> tuple[RestingPose, ...]:
    """The item's resting poses on a horizontal plane, the most probable first; kept for every object.

    Poses that fewer than one drop in 250 ends in are left out. Every object has one pose at least.
    """
    hull = ConvexHull(np.asarray(item.vertices, dtype=np.float64))
    facets = _facets(hull, np.asarray(item.center_of_mass, dtype=np.float64))
    shares = np.zeros(len(facets))
    for index, facet in enumerate(facets):
        shares[_settle(facets, index)] += facet.share
    shares = np.where(shares >= min(RARE, shares.max()), shares, 0.0)
    order = np.lexsort((np.arange(len(facets)), -shares))
    return tuple(_pose(item, facets[i], shares[i] / shares.sum()) for i in order if shares[i] > 0.0)


def _facets(hull: ConvexHull, center: Array) -> list[_Facet]:
    """The hull's triangles, joined where they lie in one plane."""
    points, triangles = hull.points - center, hull.simplices
    used = np.unique(triangles)
    a, b, c = (points[triangles[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    share = np.abs(_solid_angle(a, b, c)) / (4.0 * np.pi)
    taken = np.zeros(len(triangles), dtype=bool)
    facets = []
    for first in np.argsort(-np.linalg.norm(cross, axis=1), kind="stable"):
        if taken[first]:
            continue
        normal = hull.equations[first, :3]
        height = float(normal @ points[triangles[first, 0]])
        inside = np.zeros(len(points), dtype=bool)
        inside[used[np.abs(points[used] @ normal - height) < FLAT]] = True
        here = inside[triangles].all(axis=1) & ~taken
        taken |= here
        members = np.flatnonzero(inside)
        rotation = _down(normal)
        flat = points[members] @ rotation[:2].T
        around = ConvexHull(flat).vertices  # counter-clockwise
        corners = members[around]
        total = float(share[here].sum())
        facets.append(_Facet(normal, height, flat[around], corners, frozenset(members.tolist()), total))
    return facets


def _settle(facets: list[_Facet], index: int) -> int:
    """The facet at rest that rolling from this one ends on; every step lowers the centre of mass."""
    while True:
        facet = facets[index]
        beyond = _beyond(facet.polygon, np.zeros(2))
        edge = int(np.argmax(beyond))
        if beyond[edge] < -STEADY:
            return index
        ends = {int(facet.corners[edge]), int(facet.corners[(edge + 1) % len(facet.corners)])}
        lower = [i for i, other in enumerate(facets) if ends <= other.members and other.height < facet.height - 1e-9]
        if not lower:
            return index
        index = min(lower, key=lambda i: facets[i].height)


def _pose(item: GraspObject, facet: _Facet, probability: float) -> RestingPose:
    rotation = _down(facet.normal)
    T = np.eye(4)
    T[:3, :3] = rotation
    T[:3, 3] = (0.0, 0.0, facet.height) - rotation @ item.center_of_mass
    heights = item.vertices @ rotation[2] + T[2, 3]
    T[2, 3] -= heights.min()
    T.setflags(write=False)
    polygon = facet.polygon.copy()
    polygon.setflags(write=False)
    return RestingPose(T, float(probability), float(np.ptp(heights)), facet.height, polygon)


def _down(normal: Array) -> Array:
    """(3, 3) the rotation that turns a unit normal to −z, its x axis near one of the object's own axes."""
    x = np.eye(3)[np.argmin(np.abs(normal))]
    x = x - (x @ normal) * normal
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(-normal, x), -normal])


def _beyond(polygon: Array, point: Array) -> Array:
    """(K,) how far a point (2,) lies beyond the line of every edge of a counter-clockwise convex polygon (K, 2)."""
    along = np.roll(polygon, -1, axis=0) - polygon
    normal = np.stack([along[:, 1], -along[:, 0]], axis=1) / np.linalg.norm(along, axis=1, keepdims=True)
    return np.asarray(np.einsum("ij,ij->i", normal, point - polygon))


def _solid_angle(a: Array, b: Array, c: Array) -> Array:
    """(T,) of triangles seen from the origin (Van Oosterom and Strackee 1983)."""
    la, lb, lc = (np.linalg.norm(p, axis=1) for p in (a, b, c))
    dot_ab, dot_bc, dot_ca = (np.einsum("ij,ij->i", p, q) for p, q in ((a, b), (b, c), (c, a)))
    triple = np.einsum("ij,ij->i", a, np.cross(b, c))
    return np.asarray(2.0 * np.arctan2(triple, la * lb * lc + dot_ab * lc + dot_bc * la + dot_ca * lb))
