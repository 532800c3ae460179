"""Poses of recognised clusters: the class's nominal shape, stretched to the cluster's box, turned, aligned by ICP."""

from __future__ import annotations

import functools
import itertools
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from aerograsp_env.sim.visual.objects import nominal_object
from aerograsp_env.spatial import Array, transform
from baselines.detection import register
from baselines.policies.detect_descriptors import Description
from baselines.policies.detect_proposals import Proposal

MODEL_POINTS = 400
CLUSTER_POINTS = 150
ORDERS = 2  # ways to lie that are tried, of the six orders of a box's sides
RIGID = ("crawler",)  # classes of one shape
YAWS = 6  # starts about the vertical of a rigid shape
FARTHEST_STEP, FARTHEST_TURN = 0.03, np.radians(25.0)  # of ICP from its start; beyond, the start is kept


class Model(NamedTuple):
    """A class's nominal shape."""

    points: Array  # (N, 3) in its bounding box, each side from −½ to ½
    normals: Array  # (N, 3) outward, of the shape as it is
    extents: Array  # (3,) of that box [m]
    middle: Array  # (3,) of that box, object frame [m]
    tree: cKDTree
    symmetries: Array  # (K, 3, 3)


class Fit(NamedTuple):
    """A pose of an object and how well it fits."""

    T_c_object: Array  # (4, 4)
    error: float  # mean distance between cluster and shape, both ways [m]


@functools.cache
def model_of(label: str) -> Model:
    """The nominal model of a class; the same at every call."""
    item = nominal_object(label)
    points, normals, _ = item.surface(MODEL_POINTS, np.random.default_rng(0))
    low, high = item.vertices.min(axis=0), item.vertices.max(axis=0)
    unit = (points - 0.5 * (low + high)) / (high - low)
    return Model(unit, normals, high - low, 0.5 * (low + high), cKDTree(unit), item.symmetries)


def _turns() -> Array:
    """(24, 3, 3) the rotations that map axes to axes."""
    found = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((-1.0, 1.0), repeat=3):
            R = np.zeros((3, 3))
            R[order, range(3)] = signs
            if np.linalg.det(R) > 0.0:
                found.append(R)
    return np.array(found)


TURNS = _turns()
ORDER_OF = np.array([np.abs(R).argmax(axis=1) for R in TURNS])  # (24, 3) which object axis lies along each box axis


def fit_pose(label: str, proposal: Proposal, description: Description, refine: bool = True) -> Fit:
    """The pose in which the class's shape explains a cluster best."""
    model = model_of(label)
    points = proposal.points
    if len(points) > CLUSTER_POINTS:
        points = points[np.linspace(0, len(points) - 1, CLUSTER_POINTS).astype(int)]
    T_c_box, extents = description.T_c_box, description.extents
    starts = _rigid_starts(model) if label in RIGID else _stretched_starts(model, extents)
    best: tuple[float, Array, Array] | None = None
    for R_box_object, size in starts:
        fit = _error(model, points, T_c_box, R_box_object, size)
        if best is None or fit < best[0]:
            best = fit, R_box_object, size
    assert best is not None
    error, R_box_object, size = best
    R = T_c_box[:3, :3] @ R_box_object
    T = transform(R, T_c_box[:3, 3] - R @ (model.middle * size / model.extents))
    if label in RIGID:  # its box is as high as the shape, whatever of it is seen
        T[:3, 3] += (0.5 * size[2] - 0.5 * extents[2]) * T_c_box[:3, 2]
    return Fit(_refined(model, size, points, T) if refine else T, error)


def _rigid_starts(model: Model) -> list[tuple[Array, Array]]:
    angles = 2.0 * np.pi * np.arange(2 * YAWS) / (2 * YAWS)
    turns = [np.array([[np.cos(a), -np.sin(a), 0.0], [np.sin(a), np.cos(a), 0.0], [0.0, 0.0, 1.0]]) for a in angles]
    return [(R, model.extents) for R in turns]


def _stretched_starts(model: Model, extents: Array) -> list[tuple[Array, Array]]:
    """Rotations R_box_object with the object's extents, of the orders of sides that suit the box best."""
    orders = np.array(list(itertools.permutations(range(3))))  # object axis along each box axis
    cost = (np.log(extents / model.extents[orders]) ** 2).sum(axis=1)
    found = []
    for order in orders[np.argsort(cost)[:ORDERS]]:
        size = np.empty(3)
        size[order] = extents
        found += [(R, size) for R, mine in zip(TURNS, ORDER_OF, strict=True) if (mine == order).all()]
    return found


def _error(model: Model, points: Array, T_c_box: Array, R_box_object: Array, size: Array) -> float:
    """Mean distance [m] from the cluster to the shape, and from what of the shape faces the camera to the cluster."""
    R = T_c_box[:3, :3] @ R_box_object
    local = (points - T_c_box[:3, 3]) @ R
    _, nearest = model.tree.query(local / size)
    there = np.linalg.norm(local - model.points[nearest] * size, axis=1)
    eye = -T_c_box[:3, 3] @ R
    normals = model.normals / size  # of the stretched shape, up to their length
    facing = ((eye - model.points * size) * normals).sum(axis=1) > 0.0
    back, _ = cKDTree(local).query(model.points[facing] * size)
    return float(np.minimum(there, 0.03).mean() + np.minimum(back, 0.03).mean())


def _refined(model: Model, size: Array, points: Array, T: Array) -> Array:
    """T_c_object after ICP, or as it was where ICP fails or leaves its start."""
    shape = model.points * size + model.middle * size / model.extents
    T_object_c = transform(T[:3, :3].T, -T[:3, :3].T @ T[:3, 3])
    result = register(points, shape, T_object_c, "icp", resolution=0.004, reach=0.02, gate=0.012, max_iterations=15)
    if not result.converged:
        return T
    R = result.T_target_source[:3, :3]
    found = transform(R.T, -R.T @ result.T_target_source[:3, 3])
    turn = np.arccos(np.clip(0.5 * (np.trace(found[:3, :3].T @ T[:3, :3]) - 1.0), -1.0, 1.0))
    moved = float(np.linalg.norm(found[:3, 3] - T[:3, 3]))
    return found if moved < FARTHEST_STEP and turn < FARTHEST_TURN else T
