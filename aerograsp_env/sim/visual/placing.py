"""Where things lie: resting poses on a support, on top of each other, and on a pipe."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull

from aerograsp_env.sim.visual.objects import VisualObject
from aerograsp_env.spatial import transform

Array = NDArray[np.float64]


class Placed(NamedTuple):
    """An object somewhere."""

    object: VisualObject
    T_world_object: Array  # (4, 4)

    @property
    def points(self) -> Array:
        """(V, 3) [m] its vertices in the world."""
        return self.object.vertices @ self.T_world_object[:3, :3].T + self.T_world_object[:3, 3]


def _down(normal: Array) -> Array:
    """(3, 3) the rotation that turns a unit normal to −z."""
    x = np.eye(3)[np.argmin(np.abs(normal))]
    x = x - (x @ normal) * normal
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(-normal, x), -normal])


def upright(item: VisualObject, rng: np.random.Generator) -> Array:
    """A rotation (3, 3) in which it rests, with a random heading; things with a foot mostly stand on it."""
    heading = _turn(rng.uniform(-np.pi, np.pi))
    if item.label == "crawler" or (item.label in ("can", "juice_box", "box", "fruit") and rng.random() < 0.55):
        return heading
    normals, weights = item.steady
    return heading @ _down(normals[rng.choice(len(normals), p=weights)])


def lying(item: VisualObject, rng: np.random.Generator, at: ArrayLike = (0.0, 0.0), height: float = 0.0) -> Placed:
    """The object at rest on the plane z = `height`, its origin above `at` (2,) [m]."""
    return _set_down(item, upright(item, rng), np.asarray(at, dtype=np.float64), height)


def _set_down(item: VisualObject, R: Array, at: Array, height: float) -> Placed:
    low = float((item.vertices @ R[2]).min())
    return Placed(item, transform(R, np.array([at[0], at[1], height - low])))


def lined_up(items: list[VisualObject], rng: np.random.Generator, height: float = 0.0) -> list[Placed]:
    """The objects flat and side by side along x, all pointing nearly the same way, as tools are laid out."""
    heading, jitter = rng.choice([0.5, -0.5]) * np.pi, rng.uniform(0.0, 0.12)
    gap, x = rng.uniform(0.01, 0.04), 0.0
    placed: list[Placed] = []
    for item in items:
        over = np.diag([1.0, -1.0, -1.0]) if rng.random() < 0.5 else np.eye(3)
        R = _turn(heading + rng.normal(0.0, jitter) + (np.pi if rng.random() < 0.1 else 0.0)) @ over
        points = item.vertices @ R.T
        x -= float(points[:, 0].min())
        placed.append(_set_down(item, R, np.array([x, rng.normal(0.0, 0.01)]), height))
        x += float(points[:, 0].max()) + gap
    middle = np.array([0.5 * x, 0.0, 0.0])
    return [Placed(item, transform(T[:3, :3], T[:3, 3] - middle)) for item, T in placed]


def leaning(item: VisualObject, rng: np.random.Generator, at: ArrayLike, height: float) -> Placed:
    """A long object whose far end is raised, as if it leaned on something: pitched by up to 50° about its lower end."""
    R = _turn(rng.uniform(-np.pi, np.pi)) @ _pitch(rng.uniform(0.1, 0.85)) @ _roll(rng.choice([0.0, np.pi]))
    return _set_down(item, R, np.asarray(at, dtype=np.float64), height)


def footprint(placed: Placed) -> NDArray[np.float32]:
    """(K, 2) [m] outline of its shadow on the ground."""
    flat = placed.points[:, :2]
    return flat[ConvexHull(flat).vertices].astype(np.float32)


def overlap(one: NDArray[np.float32], other: NDArray[np.float32]) -> float:
    """Area [m²] that two convex outlines share."""
    if (one.max(axis=0) < other.min(axis=0)).any() or (other.max(axis=0) < one.min(axis=0)).any():
        return 0.0
    scale = np.float32(1e3)  # OpenCV drops areas below its own tolerance
    area, _ = cv2.intersectConvexConvex(one * scale, other * scale)
    return float(area) / 1e6


def scatter(
    items: list[VisualObject],
    rng: np.random.Generator,
    area: tuple[float, float],
    height: float,
    stack: float = 0.0,
    taken: list[Placed] | None = None,
) -> list[Placed]:
    """The objects strewn over a rectangle of half-sides `area` [m] around the origin.

    Where there is no free place an object is left out, or with the probability `stack` laid on top of the others.
    """
    placed: list[Placed] = []
    shapes = [(footprint(other), float(other.points[:, 2].max())) for other in taken or []]
    for item in items:
        for attempt in range(12):
            at = rng.uniform(-1.0, 1.0, 2) * area
            lean = stack > 0.0 and item.extent[0] > 0.12 and rng.random() < 0.15 * stack
            candidate = (leaning if lean else lying)(item, rng, at, height)
            outline = footprint(candidate)
            hits = [top for other, top in shapes if overlap(outline, other) > 0.0]
            if hits and not (attempt >= 3 and rng.random() < stack):
                continue
            if hits:  # on top of the highest, never more than two deep
                lift = max(hits) - height
                if lift > 0.06:
                    continue
                candidate = Placed(item, _raised(candidate.T_world_object, lift))
            placed.append(candidate)
            shapes.append((outline, float(candidate.points[:, 2].max())))
            break
    return placed


def _raised(T: Array, lift: float) -> Array:
    return transform(T[:3, :3], T[:3, 3] + np.array([0.0, 0.0, lift]))


def on_pipe(item: VisualObject, rng: np.random.Generator, radius: float, along: float, axis_height: float) -> Placed:
    """The object astride a horizontal pipe along y: lowered until it touches."""
    R = _turn(rng.uniform(-np.pi, np.pi))
    points = item.vertices @ R.T
    side = np.abs(points[:, 0])
    above = np.sqrt(np.maximum(radius**2 - side**2, 0.0))
    lift = float((np.where(side < radius, above, -np.inf) - points[:, 2]).max())
    return Placed(item, transform(R, np.array([0.0, along, axis_height + lift])))


def _turn(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _pitch(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])


def _roll(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
