"""An object as a triangle mesh: checked when it is made, then measured, sampled, and cut by rays."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple, Self

import igl
import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.spatial import transform_points
from baselines.objects.bvh import BVH
from baselines.objects.mesh_checks import MeshReport, check_unit, clean_mesh
from baselines.objects.observations import check_points
from baselines.objects.rays import RayCaster

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

_OBLIQUE = np.array([0.2672612419124244, 0.5345224838248488, 0.8017837257372732])
"""Direction in which `contains` looks for the way out: along no axis of a usual model."""


class RayHits(NamedTuple):
    """Every hit of a set of rays, ordered by ray and then by distance."""

    rays: Ints  # (H,) which ray
    distances: Array  # (H,) [m] from the ray's origin, ≥ 0
    faces: Ints  # (H,) which face


class SurfaceSample(NamedTuple):
    """Points drawn uniformly from a surface."""

    points: Array  # (N, 3) [m]
    normals: Array  # (N, 3) outward unit normals of their faces
    faces: Ints  # (N,)


@dataclass(frozen=True, eq=False)
class MeshObject:
    """A triangle mesh in metres, with merged vertices and outward faces; made by one of the constructors.

    `report` says whether it is watertight, what else is wrong with it, and what was repaired. What has no meaning on an
    open mesh (volume, centre of mass, inertia, inside and outside) raises ValueError there.
    """

    vertices: Array  # (V, 3) [m], read-only
    faces: Ints  # (F, 3) corners, counter-clockwise seen from outside, read-only
    report: MeshReport

    @classmethod
    def from_arrays(
        cls, vertices: ArrayLike, faces: ArrayLike, scale: float | None = None, repair: bool = True, name: str = "mesh"
    ) -> Self:
        """A mesh from vertices (V, 3) and faces (F, 3).

        Args:
            scale: metres per unit of the vertices (0.001 for millimetres). None: metres, and an object of more than
                3 m is refused, for it is probably in another unit.
            repair: whether degenerate and doubled faces may be dropped, and inverted ones turned; if not, they raise.
            name: what messages call the mesh.

        Raises:
            ValueError: no faces, values that are not finite, indices without a vertex, an implausible size, or a fault
                that may not be repaired.
        """
        v = check_points(vertices, f"{name} vertices") if np.size(vertices) else np.empty((0, 3))
        f = np.asarray(faces)
        if v.shape[1] != 3:
            raise ValueError(f"{name} vertices: expected shape (V, 3), got {v.shape}")
        if f.size == 0 or len(v) == 0:
            raise ValueError(f"{name}: expected at least one face, got {len(v)} vertices and no faces")
        if f.ndim != 2 or f.shape[1] != 3 or not np.issubdtype(f.dtype, np.integer):
            raise ValueError(f"{name} faces: expected whole numbers of shape (F, 3), got {f.dtype} {f.shape}")
        if f.min() < 0 or f.max() >= len(v):
            raise ValueError(f"{name} faces: expected indices in [0, {len(v) - 1}], got {f.min()} … {f.max()}")
        if scale is None:
            check_unit(float(np.ptp(v[f.ravel()], axis=0).max()), name)
        elif not 0.0 < scale < np.inf:
            raise ValueError(f"scale: expected a positive number of metres per unit, got {scale}")
        v, f, report = clean_mesh(v if scale is None else scale * v, f.astype(np.int64), repair, name)
        v.setflags(write=False)
        f.setflags(write=False)
        return cls(v, f, report)

    @classmethod
    def from_trimesh(cls, mesh: trimesh.Trimesh, scale: float | None = None, repair: bool = True) -> Self:
        """See `from_arrays`."""
        return cls.from_arrays(mesh.vertices, mesh.faces, scale, repair)

    @classmethod
    def from_file(cls, path: str | Path, scale: float | None = None, repair: bool = True) -> Self:
        """Any triangle mesh that trimesh reads (OBJ, PLY, STL, OFF, GLB; DAE where pycollada is installed).

        A scene's parts are joined in its frame. See `from_arrays`.

        Raises:
            ValueError: also for a file that cannot be read as a mesh, or holds only points.
            FileNotFoundError: no such file.
            ImportError: a .dae file without pycollada.
        """
        path = Path(path)
        if not path.is_file():
            raise FileNotFoundError(f"path: no file {path}")
        if path.suffix.lower() in (".dae", ".zae") and find_spec("collada") is None:
            raise ImportError(f"{path.name}: reading COLLADA needs the package pycollada (pip install pycollada)")
        try:
            loaded: Any = trimesh.load_scene(path, process=False, maintain_order=True).to_mesh()
        except Exception as error:  # trimesh's readers raise whatever the bytes make of them
            raise ValueError(f"path: expected a readable mesh, got {path.name}: {error}") from error
        return cls.from_arrays(loaded.vertices, loaded.faces, scale, repair, path.name)

    @property
    def watertight(self) -> bool:
        """Whether the surface has no boundary, so that inside and outside have a meaning."""
        return self.report.watertight

    @cached_property
    def trimesh(self) -> trimesh.Trimesh:
        """The same mesh for trimesh, which may not be changed."""
        return trimesh.Trimesh(self.vertices, self.faces, process=False)

    @cached_property
    def extents(self) -> Array:
        """(3,) [m] size of the axis-aligned bounding box."""
        return np.ptp(self.vertices, axis=0)

    @cached_property
    def _crosses(self) -> Array:
        a, b, c = np.moveaxis(self.vertices[self.faces], 1, 0)
        return np.cross(b - a, c - a)

    @cached_property
    def face_areas(self) -> Array:
        """(F,) [m²]."""
        return 0.5 * np.linalg.norm(self._crosses, axis=1)

    @cached_property
    def face_normals(self) -> Array:
        """(F, 3) outward unit normals; a face without area has the direction of its corners' other faces."""
        sums = np.zeros_like(self.vertices)
        for k in range(3):
            np.add.at(sums, self.faces[:, k], self._crosses)
        smooth = sums[self.faces].sum(axis=1)
        thin = self.face_areas <= 1e-12 * self.extents.max() ** 2
        normals = np.where(thin[:, None], smooth, self._crosses)
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        return np.where(lengths > 0.0, normals, [0.0, 0.0, 1.0]) / np.where(lengths > 0.0, lengths, 1.0)

    @cached_property
    def bvh(self) -> BVH:
        """A hierarchy of boxes around the faces, for compiled code to descend."""
        return BVH.build(self.vertices, self.faces)

    @cached_property
    def _caster(self) -> RayCaster:
        return RayCaster(self.vertices, self.faces, self.face_normals, self.watertight)

    @cached_property
    def _tree(self) -> igl.AABB:
        tree = igl.AABB()
        tree.init(self.vertices, self.faces)
        return tree

    def _closed(self, what: str) -> None:
        if not self.watertight:
            faults = "; ".join(self.report.faults) or "neighbouring faces disagree"
            raise ValueError(f"{what}: expected a watertight mesh, got one that is not ({faults})")

    @cached_property
    def _moments(self) -> tuple[float, Array, Array]:
        """Volume, centre of mass, and inertia about it at density 1. Eberly 2002, "Polyhedral mass properties"."""
        self._closed("mass properties")
        origin = self.vertices.mean(axis=0)
        a, b, c = np.moveaxis((self.vertices - origin)[self.faces], 1, 0)
        volumes = np.einsum("ni,ni->n", a, np.cross(b, c)) / 6.0
        volume = float(volumes.sum())
        if not volume > 0.0:
            raise ValueError(f"mass properties: expected a mesh that encloses a volume, got {volume:.3g} m³")
        total = a + b + c
        center = (volumes[:, None] * total).sum(axis=0) / (4.0 * volume)
        second = np.einsum("n,ni,nj->ij", volumes, total, total)
        second += sum(np.einsum("n,ni,nj->ij", volumes, x, x) for x in (a, b, c))
        second = second / 20.0 - volume * np.outer(center, center)
        return volume, origin + center, np.trace(second) * np.eye(3) - second

    @property
    def volume(self) -> float:
        """[m³]."""
        return self._moments[0]

    @property
    def center_of_mass(self) -> Array:
        """(3,) [m], of a uniform density."""
        return self._moments[1].copy()

    def inertia(self, density: float) -> Array:
        """(3, 3) [kg m²] about the centre of mass, for a density [kg/m³]."""
        if not 0.0 < density < np.inf:
            raise ValueError(f"density: expected a positive number [kg/m³], got {density}")
        return density * self._moments[2]

    def sample(self, n: int, rng: np.random.Generator) -> SurfaceSample:
        """n points uniform by area (Osada et al. 2002, eq. 1), with their faces' normals."""
        if n < 0:
            raise ValueError(f"n: expected a number of points ≥ 0, got {n}")
        ends = np.cumsum(self.face_areas)
        faces = np.minimum(np.searchsorted(ends, rng.random(n) * ends[-1], side="right"), len(ends) - 1)
        u, v = np.sqrt(rng.random((n, 1))), rng.random((n, 1))
        a, b, c = np.moveaxis(self.vertices[self.faces[faces]], 1, 0)
        return SurfaceSample((1.0 - u) * a + u * (1.0 - v) * b + u * v * c, self.face_normals[faces], faces)

    def ray_hits(self, origins: ArrayLike, directions: ArrayLike) -> RayHits:
        """Every crossing of the surface by rays from origins (N, 3) [m] along directions (N, 3) of any length.

        Embree finds them in float32, and distances are those to the faces' planes in float64. On a watertight mesh a
        ray through an edge or corner hits one of the faces around it, or those that a ray a billionth of the mesh's
        size aside would: the whole line enters the mesh as often as it leaves it (see `rays`). On an open mesh hits
        at edges may be missing, and walls thinner than 4e-6 of the mesh's size may count once.

        Raises:
            ValueError: shapes that do not match, values that are not finite, or a direction of zero length.
            ArithmeticError: a ray that is let into a watertight mesh more or less often than out, however it is moved.
        """
        o, d = check_points(origins, "origins"), check_points(directions, "directions")
        if o.shape != d.shape or o.shape[1] != 3:
            raise ValueError(f"directions: expected shape {o.shape} like the origins, (N, 3), got {d.shape}")
        lengths = np.linalg.norm(d, axis=1, keepdims=True)
        if not (lengths > 0.0).all():
            raise ValueError(f"directions: expected lengths > 0, got zero in row {int((lengths[:, 0] == 0).argmax())}")
        return RayHits(*self._caster.hits(o, d / lengths))

    def contains(self, points: ArrayLike) -> NDArray[np.bool_]:
        """(N,) whether each point is inside: whether more faces are left than entered on the way out.

        Overlapping parts are one solid.

        Raises:
            ValueError: an open mesh, or points that are not finite (N, 3).
        """
        self._closed("contains")
        p = check_points(points, "points")
        hits = self.ray_hits(p, np.broadcast_to(_OBLIQUE, p.shape))
        leaving = np.sign(self.face_normals[hits.faces] @ _OBLIQUE)
        return np.bincount(hits.rays, weights=leaving, minlength=len(p)) > 0.5

    def closest(self, points: ArrayLike) -> tuple[Array, Ints]:
        """Closest point of the surface (N, 3) [m] to each of points (N, 3), and its face (N,)."""
        p = check_points(points, "points")
        if p.shape[1] != 3:
            raise ValueError(f"points: expected shape (N, 3), got {p.shape}")
        _, faces, found = self._tree.squared_distance(self.vertices, self.faces, np.ascontiguousarray(p))
        return found, faces

    def signed_distance(self, points: ArrayLike) -> Array:
        """(N,) [m] distance of points (N, 3) to the surface, negative inside. Raises as `contains` does."""
        p = check_points(points, "points")
        distance = np.linalg.norm(self.closest(p)[0] - p, axis=1)
        return np.where(self.contains(p), -distance, distance)

    def convex_pieces(self, threshold: float = 0.05, seed: int = 0) -> tuple[MeshObject, ...]:
        """See `convex.convex_pieces`."""
        from baselines.objects.convex import convex_pieces  # which makes its pieces with this class

        return convex_pieces(self, threshold, seed)

    def transform(self, T: ArrayLike) -> MeshObject:
        """The mesh in another frame: T (4, 4) rigid, maps this frame's coordinates to the new one's."""
        vertices = transform_points(T, self.vertices)
        vertices.setflags(write=False)
        return MeshObject(vertices, self.faces, self.report)
