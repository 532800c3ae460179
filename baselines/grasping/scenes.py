"""What stands around a grasp and must stay clear, in the level frame: the body's origin and heading, z up."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim.arms.description import Shape
from aerograsp_env.sim.arms.vehicles import VehicleConfig
from aerograsp_env.sim.kernel_math import compiled
from aerograsp_env.spatial import transform_points
from baselines.grasping.contacts import Array
from baselines.kinematics.collision import CollisionModel


class Scene(NamedTuple):
    """What stands around a grasp, in the level frame."""

    T_level_object: Array  # (4, 4)
    points: Array  # (N, 3) of the object's surface, object frame [m]
    normals: Array  # (N, 3) unit, outward
    support: Array  # (3,) the middle of the seat [m]
    up: Array  # (3,) the seat's unit normal


def frame_points(vehicle: VehicleConfig) -> Array:
    """(K, 3) points on the undersides of the airframe and of what is fixed to it, body frame [m]."""
    points = []
    corners = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    ring = np.linspace(0.0, 2.0 * np.pi, 9)[:-1]
    rim = np.stack([np.cos(ring), np.sin(ring), np.zeros(8)], axis=1)
    for shape in vehicle.shapes:
        if shape.kind == "box":
            local = corners * shape.size
        else:
            radius, half = shape.size
            local = np.concatenate([radius * rim + (0.0, 0.0, end) for end in (-half, half)])
        points.append(transform_points(shape.T_link_shape, local))
    return np.concatenate(points)


def frame_clear(frame: Array, scene: Scene, objects: Array, height: float, radius: float) -> NDArray[np.bool_]:
    """Whether (P,) the airframe is clear of the support and of the object, with the object's origin at (P, 3).

    Args:
        frame: (K, 3) points of the airframe, see `frame_points`.
        scene: the object and its support, whose poses to each other stay.
        objects: (P, 3) origins of the object [m].
        height: of the airframe over the plane of the support [m]; half of it is wanted from the object.
        radius: about the seat's middle within which the plane counts [m].
    """
    offset = scene.support - scene.T_level_object[:3, 3]
    middle = scene.points.mean(axis=0)
    size = float(np.linalg.norm(scene.points - middle, axis=1).max()) + 0.5 * height
    clear = np.empty(len(objects), dtype=np.bool_)
    _frame_clear_kernel(
        frame, np.ascontiguousarray(objects), offset, scene.up, height, radius,
        scene.T_level_object[:3, :3] @ middle, size, clear,
    )  # fmt: skip
    return clear


@compiled
def _frame_clear_kernel(frame, objects, offset, up, least, farthest, middle, radius, clear):
    for g in range(objects.shape[0]):
        clear[g] = True
        for k in range(frame.shape[0]):
            height = squared = distance = 0.0
            for i in range(3):
                apart = frame[k, i] - objects[g, i] - offset[i]
                height += apart * up[i]
                squared += apart * apart
                distance += (frame[k, i] - objects[g, i] - middle[i]) ** 2
            over = height > least or squared - height * height > farthest * farthest
            if not over or distance <= radius * radius:
                clear[g] = False
                break


def surroundings(vehicle: VehicleConfig, scene: Scene, half: float = 0.25) -> CollisionModel:
    """The vehicle with the object's hull and a slab for the support as obstacles."""
    slab = Shape.box("slab", (0.0, 0.0, -0.02), (half, half, 0.02))
    return CollisionModel(vehicle, {"object": [scene.points], "support": [slab]})


def moved_scene(scene: Scene, T_level_object: Array) -> dict[str, Array]:
    """Poses of the obstacles of `surroundings` once the base has put the object there."""
    T_seat = np.eye(4)
    other = np.eye(3)[np.argmin(np.abs(scene.up))]
    x = np.cross(other, scene.up)
    x /= np.linalg.norm(x)
    T_seat[:3, :3] = np.stack([x, np.cross(scene.up, x), scene.up], axis=1)
    T_seat[:3, 3] = scene.support + T_level_object[:3, 3] - scene.T_level_object[:3, 3]
    return {"object": T_level_object, "support": T_seat}
