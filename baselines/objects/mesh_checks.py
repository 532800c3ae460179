"""What is wrong with a triangle mesh, measured, and the repairs that change no geometry."""

from __future__ import annotations

from typing import NamedTuple

import igl
import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from baselines.objects.triangles import crossing_pairs

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

LARGEST = 3.0
"""[m] An object to grasp larger than this is taken to be in another unit, unless a scale is given."""
PAIRS_COUNTED = 1000
"""Self-intersections are counted up to here."""


class MeshReport(NamedTuple):
    """What was found in a mesh, after `repairs`."""

    watertight: bool  # no boundary: faces run through every edge as often in one direction as in the other
    open_edges: int  # edges with one face
    non_manifold_edges: int  # edges with more than two faces
    bodies: int  # parts that share no vertex
    degenerate_faces: int  # faces without area that stay, because without them the mesh would be open
    self_intersections: int  # pairs of faces that pass through each other, counted up to `PAIRS_COUNTED`
    repairs: tuple[str, ...]  # what was done

    @property
    def faults(self) -> tuple[str, ...]:
        """What is left to say against the mesh, in words."""
        some = f"{self.self_intersections}{'+' if self.self_intersections >= PAIRS_COUNTED else ''}"
        found = {
            f"open: {self.open_edges} edge(s) with one face": self.open_edges,
            f"not manifold: {self.non_manifold_edges} edge(s) with more than two faces": self.non_manifold_edges,
            f"{self.degenerate_faces} face(s) without area": self.degenerate_faces,
            f"self-intersecting: {some} pair(s) of faces": self.self_intersections,
        }
        return tuple(text for text, count in found.items() if count)


def check_unit(extent: float, name: str) -> None:
    """Refuse an object that cannot be in metres.

    Raises:
        ValueError: with the sizes that the usual other units would make of it.
    """
    if extent > LARGEST:
        raise ValueError(
            f"{name}: expected an object of at most {LARGEST:g} m, got an extent of {extent:.4g}: looks like "
            f"millimetres ({extent * 0.001:.3g} m; pass scale=0.001) or inches "
            f"({extent * 0.0254:.3g} m; pass scale=0.0254); pass scale=1.0 if it is in metres"
        )


def signed_volume(vertices: Array, faces: Ints) -> float:
    """Volume inside a closed mesh; negative when its faces look inwards."""
    a, b, c = np.moveaxis((vertices - vertices.mean(axis=0))[faces], 1, 0)
    return float(np.einsum("ni,ni->", a, np.cross(b, c))) / 6.0


def bodies(vertices: Array, faces: Ints) -> tuple[int, Ints]:
    """Number of parts that share no vertex, and the part (F,) of each face."""
    links = np.concatenate([faces[:, :2], faces[:, 1:]])
    graph = coo_array((np.ones(len(links), dtype=np.int8), (links[:, 0], links[:, 1])), shape=(len(vertices),) * 2)
    _, label = connected_components(graph, directed=False)
    names, parts = np.unique(label[faces[:, 0]], return_inverse=True)
    return len(names), parts


class Edges(NamedTuple):
    """How faces meet."""

    single: int  # edges with one face
    multiple: int  # edges with more than two faces
    consistent: bool  # where two faces meet, both look to the same side
    closed: bool  # every edge is run through as often in one direction as in the other: the surface has no boundary


def edges_of(faces: Ints) -> Edges:
    """What the edges of faces (F, 3) say."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    forward = edges[:, 0] < edges[:, 1]
    keys = edges.min(axis=1) * (int(faces.max()) + 1) + edges.max(axis=1)
    _, which, counts = np.unique(keys, return_inverse=True, return_counts=True)
    balance = np.bincount(which, weights=np.where(forward, 1.0, -1.0))
    return Edges(int((counts == 1).sum()), int((counts > 2).sum()), not balance[counts == 2].any(), not balance.any())


def _merge(vertices: Array, faces: Ints) -> tuple[Array, Ints]:
    """Equal vertices made one (files repeat them for textures and normals), unused ones left out."""
    step = 1e-8 * max(float(np.ptp(vertices[faces.ravel()], axis=0).max()), np.finfo(np.float64).tiny)
    used = np.unique(faces)
    _, first, which = np.unique(
        np.round(vertices[used] / step).astype(np.int64), axis=0, return_index=True, return_inverse=True
    )
    new = np.zeros(len(vertices), dtype=np.int64)
    new[used] = which.ravel()
    return vertices[used][first], new[faces]


def _outward(vertices: Array, faces: Ints) -> tuple[Ints, int]:
    """Faces of each closed part turned outwards, and how many parts were turned.

    A part with negative volume is a cavity, and stays, where another part holds it.
    """
    count, parts = bodies(vertices, faces)
    faces, turned = faces.copy(), 0
    for part in range(count):
        mine = parts == part
        if not edges_of(faces[mine]).closed or signed_volume(vertices, faces[mine]) >= 0.0:
            continue
        if count > 1:
            start = vertices[faces[mine][0]].mean(axis=0)
            if round(float(igl.winding_number(vertices, faces[~mine], start[None])[0])) % 2:
                continue
        faces[mine] = faces[mine][:, ::-1]
        turned += 1
    return faces, turned


def clean_mesh(vertices: Array, faces: Ints, repair: bool, name: str) -> tuple[Array, Ints, MeshReport]:
    """The mesh with equal vertices merged, and, given `repair`, without doubled faces and with faces turned outwards.

    Raises:
        ValueError: nothing left of the mesh; or, without `repair`, a fault that could be repaired.
    """
    if len(faces) == 0:
        raise ValueError(f"{name}: expected at least one face, got none")
    vertices, faces = _merge(vertices, faces)
    done = []
    collapsed = (faces == np.roll(faces, 1, axis=1)).any(axis=1)
    if collapsed.any():
        faces = faces[~collapsed]
        done.append(f"{int(collapsed.sum())} degenerate face(s) dropped")
    if len(faces) == 0:
        raise ValueError(f"{name}: expected a face with area, got only degenerate faces")
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    if len(first) < len(faces):
        done.append(f"{len(faces) - len(first)} doubled face(s) dropped")
        faces = faces[np.sort(first)]
    edges = edges_of(faces)
    if not edges.consistent:
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        trimesh.repair.fix_winding(mesh)
        faces = np.array(mesh.faces, dtype=np.int64)
        edges = edges_of(faces)
        done.append("faces turned to agree with their neighbours")
    faces, turned = _outward(vertices, faces)
    if turned:
        done.append(f"{turned} inverted part(s) turned outwards")
    if done and not repair:
        raise ValueError(f"{name}: expected a mesh without faults, got one that needs repair ({'; '.join(done)})")
    corners = vertices[faces]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    report = MeshReport(
        watertight=edges_of(faces).closed if turned else edges.closed,
        open_edges=edges.single,
        non_manifold_edges=edges.multiple,
        bodies=bodies(vertices, faces)[0],
        degenerate_faces=int((areas <= 1e-12 * float(np.ptp(vertices, axis=0).max()) ** 2).sum()),
        self_intersections=min(len(crossing_pairs(vertices, faces)), PAIRS_COUNTED),
        repairs=tuple(done),
    )
    return vertices, faces, report
