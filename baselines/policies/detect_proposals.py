"""What stands out from floors, tables, walls and pipes in a depth image: proposals of objects (thesis, section 3.2)."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from aerograsp_env.interfaces import RGBD
from baselines.detection import euclidean_clusters, fit_plane

Array = NDArray[np.float64]

SAMPLES = 5000  # points that surfaces are fitted to
LEAST_SHARE = 0.08  # of them, that a surface must hold
SURFACES = 4  # planes looked for
UPRIGHT = 0.97  # cosine between a plane's normal and the vertical, from which it is a support
RISE, RISE_RATE = 0.003, 0.0016  # height over a surface that stands out: RISE + RISE_RATE · z² [m]
PIPE_RADII = (0.08, 0.5)  # [m]
GAP = 0.015  # between two objects [m]
LEAST_PIXELS = 30  # of a proposal
LARGEST = 0.65  # extent of one [m]
HIGHEST = 0.6  # over its support [m]
FEWEST = 500  # points that a frame must have


class Surface(NamedTuple):
    """A plane, or a cylinder about a horizontal axis, that things lie on or stand before."""

    normal: Array  # (3,) of a plane, towards the camera; of a pipe, up
    offset: float  # of a plane: normal @ p = offset on it; of a pipe: normal @ its highest line
    support: bool  # things may lie on it
    axis: Array | None = None  # (3,) unit, of a pipe
    center: Array | None = None  # (3,) on the axis
    radius: float = 0.0

    def height(self, points: Array) -> Array:
        """Distance (N,) [m] from the surface, positive on the camera's side, of points (N, 3)."""
        if self.axis is None or self.center is None:
            return points @ self.normal - self.offset
        arm = points - self.center
        along = arm @ self.axis
        return np.sqrt(np.maximum(np.einsum("ij,ij->i", arm, arm) - along**2, 0.0)) - self.radius


class Proposal(NamedTuple):
    """One thing that stands out."""

    points: Array  # (N, 3) camera frame [m]
    colors: NDArray[np.uint8]  # (N, 3)
    box: Array  # (4,) edges of its pixels [px]
    up: Array  # (3,) camera frame: of what it lies on
    floor: float  # up @ p on the support below it


def find_proposals(frame: RGBD, up: Array, rng: np.random.Generator) -> list[Proposal]:
    """Things that stand out in a frame, the largest first; `up` (3,) is the vertical in the camera's frame.

    Planes (RANSAC), and if much is left a pipe, are taken away; what rises over them makes Euclidean clusters.
    """
    depth = cv2.medianBlur(np.ascontiguousarray(frame.depth), 5)  # keeps edges, averages the disparity's steps
    rows, columns = np.nonzero((depth > 0.0) & (frame.depth > 0.0))
    if len(rows) < FEWEST:
        return []
    camera = frame.intrinsics
    z = depth[rows, columns].astype(np.float64)
    points = np.stack([(columns - camera.cx) / camera.fx * z, (rows - camera.cy) / camera.fy * z, z], axis=1)
    surfaces = find_surfaces(points, up, rng)
    rise = RISE + RISE_RATE * z**2
    out = np.ones(len(points), dtype=np.bool_)
    heights = [surface.height(points) for surface in surfaces]
    for surface, height in zip(surfaces, heights, strict=True):
        if surface.support and surface.axis is None:
            out &= (height > rise) | (height < -0.05)  # what is far below lies on another one
        else:
            out &= np.abs(height) > 2.0 * rise
    supports = [(s, h) for s, h in zip(surfaces, heights, strict=True) if s.support]
    chosen = np.flatnonzero(out)
    if len(chosen) < LEAST_PIXELS:
        return []
    found = []
    for cluster in euclidean_clusters(points[chosen], GAP, LEAST_PIXELS):
        members = chosen[cluster]
        mine = points[members]
        if np.linalg.norm(np.ptp(mine, axis=0)) > LARGEST:
            continue
        below = _support(mine, members, supports, up)
        if below is None:
            continue
        x, y = columns[members], rows[members]
        box = np.array([x.min(), y.min(), x.max() + 1, y.max() + 1], dtype=np.float64)
        found.append(Proposal(mine, frame.rgb[y, x], box, *below))
    return found


def _support(
    points: Array, members: NDArray[np.intp], supports: list[tuple[Surface, Array]], up: Array
) -> tuple[Array, float] | None:
    """The vertical and the height, along it, of what a cluster lies on: the highest surface that is below it."""
    best: tuple[float, Array, float] | None = None
    for surface, heights in supports:
        height = heights[members]
        middle = float(np.median(height))
        if not 0.0 < middle < HIGHEST or float(np.percentile(height, 5)) < -0.02:
            continue
        normal = surface.normal
        floor = float(normal @ points[np.argmin(height)] - height.min()) if surface.axis is None else surface.offset
        if best is None or middle < best[0]:
            best = middle, normal, floor
    return None if best is None else best[1:]


def find_surfaces(points: Array, up: Array, rng: np.random.Generator) -> list[Surface]:
    """Planes that hold many of the points (N, 3), and a pipe if one does; the camera is at the origin."""
    left = points[rng.choice(len(points), min(SAMPLES, len(points)), replace=False)]
    least = LEAST_SHARE * len(left)
    found: list[Surface] = []
    for _ in range(SURFACES):
        if len(left) < max(least, 4):
            break
        plane = fit_plane(left, threshold=0.01, rng=rng, iterations=200)
        if plane.inliers.sum() < least:
            break
        upright = abs(float(plane.normal @ up))
        if 0.3 < upright < UPRIGHT and (pipe := _pipe(left, up, rng, least)) is not None:
            found.append(pipe)
            left = left[np.abs(pipe.height(left)) > 0.02]
            continue
        found.append(Surface(plane.normal, plane.offset, upright >= UPRIGHT))
        rise = RISE + RISE_RATE * left[:, 2] ** 2
        left = left[np.abs(plane.distance(left)) > 1.5 * rise]
    if len(left) > least and (pipe := _pipe(left, up, rng, least)) is not None:
        found.append(pipe)
    return found


def _pipe(points: Array, up: Array, rng: np.random.Generator, least: float, headings: int = 36) -> Surface | None:
    """A cylinder about a horizontal axis, of which the camera sees the near side: circles through three points."""
    x, y = level_axes(up)
    some = points[rng.choice(len(points), min(600, len(points)), replace=False)]
    best: tuple[float, Array, Array, float] | None = None
    for heading in np.pi * np.arange(headings) / headings:
        axis = np.cos(heading) * x + np.sin(heading) * y
        side = np.cross(up, axis)
        flat = np.stack([some @ side, some @ up], axis=1)
        centers, radii = _circles(flat[rng.integers(0, len(flat), (40, 3))])
        good = (radii > PIPE_RADII[0]) & (radii < PIPE_RADII[1])
        if not good.any():
            continue
        centers, radii = centers[good], radii[good]
        gaps = np.abs(np.linalg.norm(flat[:, None] - centers, axis=2) - radii)
        cost = np.minimum(gaps, 0.01).sum(axis=0)
        k = int(cost.argmin())
        if best is None or cost[k] < best[0]:
            best = float(cost[k]), axis, centers[k, 0] * side + centers[k, 1] * up, float(radii[k])
    if best is None:
        return None
    _, axis, center, radius = best
    pipe = Surface(up, float(up @ center + radius), True, axis, center, radius)
    near = np.abs(pipe.height(points)) < 0.012
    return pipe if near.sum() >= least else None


def level_axes(up: Array) -> tuple[Array, Array]:
    """Two unit vectors (3,) at right angles to `up` and to each other: x × y = up."""
    x = np.cross(np.eye(3)[np.abs(up).argmin()], up)
    x /= np.linalg.norm(x)
    return x, np.cross(up, x)


def _circles(triples: Array) -> tuple[Array, Array]:
    """Centres (M, 2) and radii (M,) of the circles through three points each (M, 3, 2); infinite for collinear ones."""
    a, b, c = triples[:, 0], triples[:, 1], triples[:, 2]
    u, v = b - a, c - a
    area = 2.0 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
    safe = np.where(np.abs(area) < 1e-12, np.nan, area)
    uu, vv = np.einsum("ij,ij->i", u, u), np.einsum("ij,ij->i", v, v)
    offset = np.stack([v[:, 1] * uu - u[:, 1] * vv, u[:, 0] * vv - v[:, 0] * uu], axis=1) / safe[:, None]
    radius = np.linalg.norm(offset, axis=1)
    return a + offset, np.where(np.isfinite(radius), radius, np.inf)
