"""From where a scene is seen: as a photographer sees tools on a bench, or as a vehicle that hovers beside them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim.visual.scenes import Scene
from aerograsp_env.spatial import transform

Array = NDArray[np.float64]


class Viewpoint(NamedTuple):
    """A camera's pose and vertical field of view."""

    T_world_camera: Array  # (4, 4), OpenCV's axes
    fovy: float  # [rad]


def look_at(position: Array, target: Array, roll: float = 0.0) -> Array:
    """T_world_camera (4, 4) of a camera at `position` that looks at `target`, its picture turned by `roll` [rad].

    Without roll the picture is upright; looking straight down, its top is towards +y.
    """
    z = np.asarray(target, dtype=np.float64) - position
    z /= np.linalg.norm(z)
    up = np.array([0.0, 0.0, 1.0]) if abs(z[2]) < 0.999 else np.array([0.0, 1.0, 0.0])
    x = np.cross(z, up)
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    c, s = np.cos(roll), np.sin(roll)
    return transform(np.column_stack([c * x + s * y, c * y - s * x, z]), position)


def draw_viewpoint(scene: Scene, rng: np.random.Generator) -> Viewpoint:
    """A viewpoint that suits the scene's style: 0.15–2 m away, above the support and outside of pipes.

    Most have the middle of an object in the picture and nothing of the room before it; a few show none.
    """
    draw = _studio if scene.config.style == "studio" else _aerial
    for _ in range(20):
        viewpoint = draw(scene, rng)
        if not _behind_pipe(scene, viewpoint.T_world_camera[:3, 3], viewpoint.T_world_camera[:3, 3]):
            seen = any(_shows(viewpoint, scene, placed.T_world_object[:3, 3]) for placed in scene.objects)
            if seen or rng.random() < 0.1:
                break
    return viewpoint


def _shows(viewpoint: Viewpoint, scene: Scene, point: Array) -> bool:
    return _in_sight(viewpoint, point) and not _behind_pipe(scene, viewpoint.T_world_camera[:3, 3], point)


def _behind_pipe(scene: Scene, eye: Array, point: Array) -> bool:
    """Whether the way from the eye to a point, but for its end, enters a pipe (all lie along y);
    with no way to go, whether the eye is within 5 cm of one."""
    for ground in scene.grounds:
        if ground.shape == "cylinder":
            axis = ground.T_world_ground[[0, 2], 3]
            start, along = eye[[0, 2]] - axis, 0.9 * (point - eye)[[0, 2]]
            length = float(along @ along)
            nearest = start + along * (np.clip(-(start @ along) / length, 0.0, 1.0) if length > 0.0 else 0.0)
            if np.linalg.norm(nearest) < ground.size[0] + 0.05 * (length == 0.0):
                return True
    return False


def _in_sight(viewpoint: Viewpoint, point: Array) -> bool:
    """Whether a point is in the picture, if it is 4 to 3."""
    x, y, z = viewpoint.T_world_camera[:3, :3].T @ (point - viewpoint.T_world_camera[:3, 3])
    tall = np.tan(0.5 * viewpoint.fovy)
    return bool(z > 0.05 and abs(y) < tall * z and abs(x) < 4.0 / 3.0 * tall * z)


def _aerial(scene: Scene, rng: np.random.Generator) -> Viewpoint:
    elevation = np.radians(rng.uniform(22.0, 68.0))
    distance, fovy = 0.6 + 1.4 * rng.random() ** 2, np.radians(rng.uniform(40.0, 62.0))
    target = _target(scene, rng, 0.9) + rng.normal(0.0, 0.08, 3) * (1.0, 1.0, 0.2)
    roll = rng.normal(0.0, np.radians(6.0))
    return Viewpoint(look_at(_around(target, distance, elevation, rng), target, roll), float(fovy))


def _studio(scene: Scene, rng: np.random.Generator) -> Viewpoint:
    elevation = np.radians(rng.uniform(62.0, 89.5) if rng.random() < 0.7 else rng.uniform(22.0, 62.0))
    fovy = np.radians(rng.uniform(30.0, 75.0))
    if scene.objects and (len(scene.objects) == 1 or rng.random() < 0.3):  # one of them fills the picture
        item = scene.objects[int(rng.integers(len(scene.objects)))]
        target, size = item.T_world_object[:3, 3].copy(), 0.5 * item.object.diameter
        target += rng.normal(0.0, 0.18 * size, 3) * (1.0, 1.0, 0.0)
        fill = rng.uniform(0.55, 1.4)
    else:
        target, size = scene.center, _spread(scene)
        target = target + rng.normal(0.0, 0.12 * size, 3) * (1.0, 1.0, 0.0)
        fill = rng.uniform(0.65, 1.35)
    distance = float(np.clip(size / np.tan(0.5 * fovy) / fill, 0.15, 2.0))
    roll = rng.uniform(-np.pi, np.pi) if rng.random() < 0.6 else rng.normal(0.0, 0.1)
    return Viewpoint(look_at(_around(target, distance, elevation, rng), target, roll), float(fovy))


def _around(target: Array, distance: float, elevation: float, rng: np.random.Generator) -> Array:
    azimuth = rng.uniform(-np.pi, np.pi)
    flat = distance * np.cos(elevation)
    return target + np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), distance * np.sin(elevation)])


def _target(scene: Scene, rng: np.random.Generator, share: float) -> Array:
    if scene.objects and rng.random() < share:
        return scene.objects[int(rng.integers(len(scene.objects)))].T_world_object[:3, 3].copy()
    return scene.center


def _spread(scene: Scene) -> float:
    """Radius [m] of a circle around the middle that holds all objects."""
    reach = [
        np.linalg.norm(p.T_world_object[:2, 3] - scene.center[:2]) + 0.5 * p.object.diameter for p in scene.objects
    ]
    return float(max(reach, default=0.3))
