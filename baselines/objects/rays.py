"""Every hit of rays with a triangle mesh: Embree in float32, checked, and made good in float64 where it fails.

Embree returns the first hit of a ray, so rays are cast again from just behind each hit. That may lose a hit at an edge,
or of walls thinner than the step. A line enters a closed surface as often as it leaves it, so whole lines are cast,
from before the mesh to behind it, and those for which this does not hold are cast again by libigl in float64, moved
aside by a billionth of the mesh's radius, which takes them off edges and corners.
"""

from __future__ import annotations

from functools import cached_property

import igl
import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

STEP = 4e-6
"""How far behind a hit the ray goes on, as a fraction of the mesh's radius: some float32 roundings at that radius."""
GRAZING = 1e-4
"""Fraction of the radius by which the distance to a hit face's plane may differ from the distance that was found; it
differs more where the ray runs nearly along the plane, and there the latter is kept."""
ASIDE = 1e-9
"""Fraction of the radius by which rays are moved when they are cast again; four times as far at every attempt."""
ATTEMPTS = 8
_UNITS = 1e3
"""Radius that libigl sees: it takes a determinant below an absolute threshold for a ray along the face."""


class RayCaster:
    """The hits of rays with one mesh of vertices (V, 3) and faces (F, 3), with unit normals (F, 3).

    `closed`: whether the surface has no boundary, so that every line has to leave it as often as it enters it.
    """

    def __init__(self, vertices: Array, faces: Ints, normals: Array, closed: bool) -> None:
        lower, upper = vertices.min(axis=0), vertices.max(axis=0)
        self._center = 0.5 * (lower + upper)
        self._radius = max(float(np.linalg.norm(vertices - self._center, axis=1).max()), np.finfo(np.float64).tiny)
        self._unit_vertices = (vertices - self._center) / self._radius
        self._faces = np.ascontiguousarray(faces, dtype=np.int64)
        self._normals = normals
        self._offsets = np.vecdot(normals, self._unit_vertices[faces[:, 0]])
        self._closed = closed
        self._scene = EmbreeScene()
        TriangleMesh(self._scene, self._unit_vertices.astype(np.float32), faces.astype(np.int32))

    @cached_property
    def _tree(self) -> tuple[igl.AABB, Array]:
        vertices = _UNITS * self._unit_vertices
        tree = igl.AABB()
        tree.init(vertices, self._faces)
        return tree, vertices

    def hits(self, origins: Array, directions: Array) -> tuple[Ints, Array, Ints]:
        """Ray (H,), distance (H,) ≥ 0 and face (H,) of every hit of rays (N, 3) of unit direction; by ray and distance.

        Raises:
            ArithmeticError: a line that a closed surface lets in more or less often than out, however it is moved.
        """
        o = (origins - self._center) / self._radius
        middles = -np.vecdot(o, directions)  # where each line is nearest to the mesh's centre
        lines = np.flatnonzero((np.vecdot(o, o) - middles**2 <= 1.01) & (middles >= -1.01))  # which reach its ball
        starts = o[lines] + (middles[lines] - 1.01)[:, None] * directions[lines]
        rows, t, faces = self._embree(starts, directions[lines])
        rays = lines[rows]
        leaning = self._leaning(faces, directions, rays)
        if self._closed:
            lost = np.bincount(rays, weights=np.sign(leaning), minlength=len(o)) != 0.0
            if lost.any():
                kept = ~lost[rays]
                old, new = (rays[kept], t[kept], faces[kept]), self._recast(starts, directions, lines, lost)
                rays, t, faces = (np.concatenate(pair) for pair in zip(old, new, strict=True))
                leaning = self._leaning(faces, directions, rays)
        t = t + (middles[rays] - 1.01)
        gaps = self._offsets[faces] - np.vecdot(self._normals.take(faces, axis=0), o.take(rays, axis=0))
        plane = np.divide(gaps, leaning, out=np.full(len(t), np.inf), where=leaning != 0.0)
        t = np.where(np.abs(plane - t) <= GRAZING, plane, t)
        ahead = np.flatnonzero(t >= 0.0)
        order = ahead[np.argsort(rays[ahead], kind="stable")]
        if ((np.diff(t[order]) < 0.0) & (np.diff(rays[order]) == 0)).any():  # rare, and sorting by both is slow
            order = ahead[np.lexsort((t[ahead], rays[ahead]))]
        return rays[order], self._radius * t[order], faces[order]

    def _leaning(self, faces: Ints, directions: Array, rays: Ints) -> Array:
        """(H,) cosine between each hit's normal and ray; positive where the ray leaves."""
        return np.vecdot(self._normals.take(faces, axis=0), directions.take(rays, axis=0))

    def _embree(self, starts: Array, directions: Array) -> tuple[Ints, Array, Ints]:
        """Row, distance from the start, and face of every hit, in units of the radius."""
        d32 = directions.astype(np.float32)
        live, p, d, t = np.arange(len(starts)), starts, directions, np.zeros(len(starts))
        last = np.full(len(starts), -1)
        step = np.full(len(starts), STEP)
        found: list[tuple[Ints, Array, Ints]] = []
        while len(live):
            result = self._scene.run(p.astype(np.float32), d32, output=True)
            hit = np.flatnonzero(result["primID"] >= 0)
            if len(hit) < len(live):
                live, d, d32, starts = live[hit], d.take(hit, axis=0), d32.take(hit, axis=0), starts.take(hit, axis=0)
                t, last, step = t[hit], last[hit], step[hit]
            faces = result["primID"][hit]
            t = t + result["tfar"][hit]
            new = faces != last
            found.append((live[new], t[new], faces[new]))
            step = np.where(new, STEP, 2.0 * step)  # a ray held by a face takes longer steps
            t = t + step
            last = faces
            p = starts + t[:, None] * d
        rows, distances, faces = (np.concatenate(part) for part in zip(*found, strict=True)) if found else _nothing()
        return rows, distances, faces.astype(np.int64)

    def _recast(
        self, starts: Array, directions: Array, lines: Ints, lost: NDArray[np.bool_]
    ) -> tuple[Ints, Array, Ints]:
        """As `_embree`, for the lines that are lost, by ray, in float64."""
        tree, vertices = self._tree
        left = np.flatnonzero(lost[lines])
        found = [_nothing()]
        for attempt in range(ATTEMPTS):
            d = directions[lines[left]]
            u = np.cross(d, np.eye(3)[np.abs(d).argmin(axis=1)])
            u /= np.linalg.norm(u, axis=1, keepdims=True)
            angle = 1.0 + 2.399963 * attempt  # the golden angle: no direction comes again
            aside = ASIDE * 4.0**attempt * (np.cos(angle) * u + np.sin(angle) * np.cross(d, u))
            lists = tree.intersect_ray(vertices, self._faces, _UNITS * (starts[left] + aside), d)
            rows = np.repeat(np.arange(len(left)), [len(hits) for hits in lists])
            every = np.array([hit[:2] for hits in lists for hit in hits]).reshape(-1, 2)
            faces, t = every[:, 0].astype(np.int64), every[:, 1] / _UNITS
            wrong = np.bincount(rows, weights=np.sign(self._leaning(faces, d, rows)), minlength=len(left)) != 0.0
            good = ~wrong[rows]
            found.append((lines[left][rows[good]], t[good], faces[good]))
            left = left[wrong]
            if len(left) == 0:
                rays, distances, faces = (np.concatenate(part) for part in zip(*found, strict=True))
                return rays, distances, faces
        raise ArithmeticError(f"ray {lines[left[0]]} enters the closed mesh more or less often than it leaves it")


def _nothing() -> tuple[Ints, Array, Ints]:
    return np.empty(0, dtype=np.int64), np.empty(0), np.empty(0, dtype=np.int64)
