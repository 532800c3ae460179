"""Where things lie: resting poses on a support, on top of each other, and on a pipe."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
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


def lying(item: VisualObject, rng: np.random.Generator, at: tuple[float, float] = (0.0, 0.0), height: float = 0.0) -> Placed:
    """The object at rest on the plane z = `height`, its origin above `at` [m]."""
    R = upright(item, rng)
    low = float((item.vertices @ R[2]).min())
    return Placed(item, transform(R, np.array([*at, height - low])))


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
            candidate = lying(item, rng, (float(at[0]), float(at[1])), height)
            outline = footprint(candidate)
            hits = [top for other, top in shapes if overlap(outline, other) > 0.0]
            if hits and not (attempt >= 3 and rng.random() < stack):
                continue
            if hits:  # on top of the highest, never more than two deep
                lift = max(hits) - height
                if lift > 0.06:
                    continue
                candidate = Placed(item, transform(candidate.T_world_object[:3, :3], candidate.T_world_object[:3, 3] + (0.0, 0.0, lift)))
            placed.append(candidate)
            shapes.append((outline, float(candidate.points[:, 2].max())))
            break
    return placed


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

