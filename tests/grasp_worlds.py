"""What the tests of grasp judging share: simple bodies with closed-form properties, and grasps on them."""

from __future__ import annotations

from typing import Any

import numpy as np
import trimesh

from aerograsp_env.interfaces import Grasp
from aerograsp_env.sim.objects import Convex, GraspObject

X, Y, Z = np.eye(3)
UPRIGHT = np.eye(4)


def solid(name: str, mesh: trimesh.Trimesh, inertia: np.ndarray, mass: float, **kwargs: Any) -> GraspObject:
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces, np.int32)
    kwargs = {"center_of_mass": np.zeros(3), **kwargs}
    return GraspObject(name, name, (Convex(vertices, faces),), vertices, faces, mass, inertia=inertia, **kwargs)


def box(size: tuple[float, float, float] = (0.05, 0.06, 0.12), mass: float = 0.75, **kwargs: Any) -> GraspObject:
    x, y, z = np.square(size)
    return solid("box", trimesh.creation.box(size), mass / 12 * np.diag([y + z, x + z, x + y]), mass, **kwargs)


def cylinder(radius: float = 0.03, height: float = 0.10, mass: float = 0.75, **kwargs: Any) -> GraspObject:
    inertia = mass * np.diag([0.25 * radius**2 + height**2 / 12] * 2 + [0.5 * radius**2])
    return solid("cylinder", trimesh.creation.cylinder(radius, height, sections=48), inertia, mass, **kwargs)


def grasp(center=(0.0, 0.0, 0.0), closing=X, approach=-Z, width: float = 0.08) -> Grasp:
    return Grasp(np.asarray(center, dtype=float), closing, approach, width)


def pose(rotation: np.ndarray, position=(0.0, 0.0, 0.0)) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation, position
    return T
