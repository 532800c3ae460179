"""Whether parallel jaws can take an object where it stands: decided by geometry alone, before anything is tried.

A way to take it is an opposed pair of surface points that is narrower than the jaws, whose line lies within friction of
both normals, and around which the open gripper has room: it meets neither the object nor the plane (and the rim) that
the object stands on. It says nothing about the arm that has to bring the gripper there.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim.gripper import Box, GripperConfig
from aerograsp_env.sim.manipulation.supports import Support
from aerograsp_env.sim.objects import Convex, GraspObject
from aerograsp_env.sim.objects.surface_points import surface_points

Array = NDArray[np.float64]

WIDEST = 0.09  # [m] of what the jaws of 0.10 m take
ROOM = 0.008  # [m] by which each finger opens wider than the object
FRICTION_ANGLE = math.atan(0.35)  # less than any surface's, so that it holds
STEEPEST = math.radians(70.0)  # of the approach from straight down
GAP = 0.003  # [m] between the gripper and the support
STARTS, BODY = 200, 500  # surface points that pairs start from, and that must be clear of the gripper
TILT = 0.6 * FRICTION_ANGLE  # of further lines from each of them, to four sides
TURNS = 12  # approach directions about a closing line
FILLING = 0.012  # [m] between points all through the gripper, none of which may be within the object
LEAST_WIDTH = 0.004  # [m]


class OpposedPairs(NamedTuple):
    """Lines through an object, in its frame."""

    center: Array  # (K, 3) middle between the two points [m]
    closing: Array  # (K, 3) unit
    width: Array  # (K,) [m]


@functools.lru_cache(maxsize=256)
def opposed_pairs(item: GraspObject, widest: float = WIDEST) -> OpposedPairs:
    """From points of the surface inwards, straight and a little tilted, to where the ray leaves the material again."""
    cloud = surface_points(item, STARTS)
    points, inward = np.tile(cloud[:, :3], (5, 1)), _tilted(-cloud[:, 3:])
    enter, leave, out = (
        np.stack(rows) for rows in zip(*(_cross(p, points, inward) for p in _planes(item)), strict=True)
    )
    end, normal = np.zeros(len(points)), np.zeros_like(points)
    for _ in range(len(item.pieces)):  # material goes on where another piece begins before the last one ends
        reach = np.where((enter <= end + 1e-6) & (leave > end + 1e-9), leave, -np.inf)
        farthest = reach.argmax(axis=0)
        best = np.take_along_axis(reach, farthest[None], axis=0)[0]
        longer = best > end
        end = np.where(longer, best, end)
        normal = np.where(longer[:, None], out[farthest, np.arange(len(points))], normal)
        if not longer.any():
            break
    opposed = np.einsum("ij,ij->i", normal, inward) >= math.cos(FRICTION_ANGLE)
    good = opposed & (end >= LEAST_WIDTH) & (end <= widest)
    return OpposedPairs((points + 0.5 * end[:, None] * inward)[good], inward[good], end[good])


def _tilted(directions: Array) -> Array:
    """(5 N, 3): the unit directions (N, 3) themselves, then tilted to four sides."""
    side = np.cross(directions, np.eye(3)[np.abs(directions).argmin(axis=1)])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    other = np.cross(directions, side)
    tilts = [math.cos(TILT) * directions + math.sin(TILT) * way for way in (side, other, -side, -other)]
    return np.concatenate([directions, *tilts])


def can_be_taken(item: GraspObject, T_world_object: Array, support: Support, gripper: GripperConfig) -> bool:
    """Whether there is one way at least to take the item where it lies on the support; see above."""
    pairs = opposed_pairs(item, min(WIDEST, gripper.max_width - 0.01))
    to_seat = np.linalg.inv(support.T_world_seat) @ T_world_object
    down = T_world_object[:3, :3].T @ np.array([0.0, 0.0, -1.0])  # in the object's frame
    body = surface_points(item, BODY)[:, :3]
    body = np.concatenate([body, np.asarray(item.vertices, dtype=np.float64)])
    closeness = np.linalg.norm(pairs.center - item.center_of_mass, axis=1)
    for k in np.argsort(closeness, kind="stable"):
        boxes = gripper.boxes(min(float(pairs.width[k]) + 2.0 * ROOM, gripper.max_width))
        for approach in _approaches(pairs.closing[k]):
            if approach @ down < math.cos(STEEPEST):
                continue
            R = np.stack([pairs.closing[k], np.cross(approach, pairs.closing[k]), approach], axis=1)
            center = to_seat[:3, :3] @ pairs.center[k] + to_seat[:3, 3]
            free = _clear_of_support(boxes, to_seat[:3, :3] @ R, center, support)
            if not free or _meets(boxes, (body - pairs.center[k]) @ R):
                continue
            if not _within(_planes(item), _filled(boxes) @ R.T + pairs.center[k]):
                return True
    return False


def _approaches(closing: Array) -> Array:
    """(TURNS, 3) unit directions across the closing line."""
    side = np.cross(closing, np.eye(3)[np.argmin(np.abs(closing))])
    side /= np.linalg.norm(side)
    angles = 2.0 * np.pi * np.arange(TURNS) / TURNS
    return np.asarray(np.cos(angles)[:, None] * side + np.sin(angles)[:, None] * np.cross(closing, side))


def _corners(boxes: tuple[Box, ...]) -> Array:
    """(8 K, 3) of the boxes, in the gripper's frame."""
    signs = np.array(np.meshgrid((-1, 1), (-1, 1), (-1, 1))).reshape(3, 8).T
    return np.concatenate([np.add(box.center, signs * box.half_size) for box in boxes])


def _clear_of_support(boxes: tuple[Box, ...], R: Array, center: Array, support: Support) -> bool:
    corners = _corners(boxes) @ R.T + center
    low = corners[:, 2] < support.rim + GAP
    beside_rim = np.abs(corners[low, :2]) > np.asarray(support.half_size) - GAP
    return bool((corners[:, 2] > GAP).all() and not (support.rim > 0.0 and beside_rim.any()))


def _meets(boxes: tuple[Box, ...], points: Array) -> bool:
    """Whether a point (K, 3) of the object lies within a box, both in the gripper's frame."""
    return any((np.abs(points - box.center) < box.half_size).all(axis=1).any() for box in boxes)


def _filled(boxes: tuple[Box, ...]) -> Array:
    """(K, 3) points all through the boxes, their gripper's frame; those of the pads' faces are left to `_meets`."""
    parts = []
    for box in boxes:
        half = 0.9 * np.asarray(box.half_size)
        axes = [np.linspace(-h, h, max(2, math.ceil(2.0 * h / FILLING) + 1)) for h in half]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        parts.append(grid + box.center)
    return np.concatenate(parts)


def _within(pieces: Sequence[tuple[Array, Array]], points: Array) -> bool:
    """Whether one of the points lies within one of the pieces, given by their planes."""
    return any((points @ normals.T < distance).all(axis=1).any() for normals, distance in pieces)


@functools.lru_cache(maxsize=256)
def _planes(item: GraspObject) -> tuple[tuple[Array, Array], ...]:
    """Of each piece the outward unit normals (F, 3) of its facets, and their distances (F,) from the origin [m]."""
    return tuple(_facets(piece) for piece in item.pieces)


def _facets(piece: Convex) -> tuple[Array, Array]:
    a, b, c = (np.asarray(piece.vertices, dtype=np.float64)[piece.faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    keep = lengths > 1e-12
    normals = normals[keep] / lengths[keep, None]
    return normals, np.einsum("ij,ij->i", normals, a[keep])


def _cross(facets: tuple[Array, Array], points: Array, directions: Array) -> tuple[Array, Array, Array]:
    """Where rays enter and leave a convex piece [m], (N,) each, and its normal where they leave (N, 3)."""
    normals, distance = facets
    offset = distance - points @ normals.T  # (N, F) distance to each plane
    speed = directions @ normals.T
    with np.errstate(divide="ignore", invalid="ignore"):
        at = offset / speed
    parallel = np.abs(speed) < 1e-12
    outside = (parallel & (offset < -1e-9)).any(axis=1)
    enter = np.where((speed < 0.0) & ~parallel, at, -np.inf).max(axis=1)
    exits = np.where((speed > 0.0) & ~parallel, at, np.inf)
    face = exits.argmin(axis=1)
    leave = exits[np.arange(len(points)), face]
    missed = outside | (enter > leave)
    return np.where(missed, np.inf, enter), np.where(missed, -np.inf, leave), normals[face]
