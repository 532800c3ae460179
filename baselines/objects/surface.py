"""Meshes of a level set {g = 0} by a walk along it: only cells that the surface crosses, and their rim, are evaluated.

The walk starts in the cells around given points and goes, layer by layer, through every cell face whose corners differ
in sign, until no cell is left: a breadth-first search, each layer evaluated at once. Cells are then cut into
tetrahedra (Kuhn's six around a diagonal, which fit together across faces), and each is meshed by its corners' signs:
the mesh of a closed level set is watertight.

Sources: Wyvill, McPheeters & Wyvill 1986, "Data structure for soft objects" (following the surface); Payne & Toga 1990,
"Surface mapping brain function on 3D models" (tetrahedra); Dragiev, Toussaint & Gienger 2011 (surfaces of a GPIS).
"""

from collections.abc import Callable
from itertools import permutations
from typing import NamedTuple

import numpy as np
import trimesh
from numpy.typing import NDArray

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

MAX_CELLS = 200_000

_BITS = 20  # of a cell's index per axis, so that three make one key
_HALF = 1 << (_BITS - 1)
_CORNERS = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])  # corner 4i + 2j + k
_STEPS = np.concatenate([-np.eye(3, dtype=np.int64), np.eye(3, dtype=np.int64)])  # across the faces
_FACES = np.array([np.flatnonzero(_CORNERS @ step == max(step.sum(), 0)) for step in _STEPS])  # (6, 4) their corners
_TETRAHEDRA = np.array([np.cumsum([0] + [4 >> axis for axis in order]) for order in permutations(range(3))])  # (6, 4)
_AROUND = np.array([[i, j, k] for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1)])
_APPROACHES = 20  # steps of seeds towards the surface
_ON_NODE = 1e-3  # vertices keep this fraction of an edge away from its ends, lest triangles degenerate


class SurfaceError(ValueError):
    """There is no surface near the data, or it is too large for the resolution."""


class Walk(NamedTuple):
    """Cells that the surface crosses, and g where it was evaluated; the grid's node i lies at origin + i·resolution."""

    origin: Array  # (3,)
    resolution: float
    cells: Integers  # (C, 3), of their lowest corners
    keys: Integers  # (K,) of the nodes, ascending
    values: Array  # (K,)


def check_resolution(resolution: float) -> None:
    """Raises ValueError for an edge of a cell that is not a positive length."""
    if not 0.0 < resolution < np.inf:
        raise ValueError(f"resolution: expected a positive length [m], got {resolution}")


def approach(
    function: Callable[[Array], Array], gradient: Callable[[Array], Array], points: Array, step: float
) -> Array:
    """Points (N, 3) moved towards {function = 0} along a gradient (M, 3), by no more than `step` [m] at a time."""
    x = points
    for _ in range(_APPROACHES):
        slope = gradient(x)
        steepness = np.maximum(np.linalg.norm(slope, axis=1), 1e-12)  # flat where the data does not reach
        distance = function(x) / steepness
        x = x - (np.clip(distance, -step, step) / steepness)[:, None] * slope
        if (np.abs(distance) < 0.5 * step).all():
            break
    return x


def walk(
    function: Callable[[Array], Array], seeds: Array, resolution: float, max_cells: int = MAX_CELLS, reach: int = 3
) -> Walk:
    """Follow {function = 0} from the cells around seeds.

    Args:
        function: g (M,) at points (M, 3); negative inside.
        seeds: (S, 3) points on or near the surface [m], S ≥ 1.
        resolution: edge of a cell [m].
        max_cells: largest number of cells evaluated.
        reach: cells around a seed's that are looked at for the surface.

    Raises:
        SurfaceError: no surface within `reach` cells of a seed, or more than `max_cells` cells.
        ValueError: a resolution that is not positive.
    """
    check_resolution(resolution)
    origin = seeds.mean(axis=0)
    frontier = np.unique(_pack(np.floor((seeds - origin) / resolution).astype(np.int64)))
    nodes = np.empty(0, dtype=np.int64)
    values = np.empty(0)
    seen, crossed, looked = frontier, [], 0
    while len(frontier):
        if len(seen) > max_cells:
            raise SurfaceError(
                f"surface: expected at most {max_cells} cells at a resolution of {resolution:g} m, got more; it may be "
                "open (a prior gives it an end), or take a larger resolution or max_cells"
            )
        cells = _unpack(frontier)
        corners = _pack(cells[:, None] + _CORNERS)  # (F, 8)
        new = np.setdiff1d(corners, nodes)
        found = function(origin + _unpack(new) * resolution)
        if not np.isfinite(found).all():
            raise SurfaceError("surface: expected finite values of the function, got others")
        order = np.argsort(np.concatenate([nodes, new]), kind="stable")
        nodes, values = np.concatenate([nodes, new])[order], np.concatenate([values, found])[order]
        inside = values[np.searchsorted(nodes, corners)] < 0.0
        on = inside.any(axis=1) & ~inside.all(axis=1)
        crossed.append(cells[on])
        faces = inside[:, _FACES]  # (F, 6, 4)
        through = faces.any(axis=2) & ~faces.all(axis=2)
        ahead = _pack((cells[:, None] + _STEPS)[through])
        if looked < reach and not any(map(len, crossed)):
            ahead, looked = _pack((cells[:, None] + _AROUND).reshape(-1, 3)), looked + 1
        frontier = np.setdiff1d(ahead, seen)
        seen = np.union1d(seen, frontier)
    found_cells = np.concatenate(crossed)
    if not len(found_cells):
        raise SurfaceError(
            f"surface: expected one within {reach} cells ({reach * resolution:g} m) of the data, got none; "
            "a prior's level, noise or sigma may be too large"
        )
    return Walk(origin, resolution, found_cells, nodes, values)


def mesh(walked: Walk) -> trimesh.Trimesh:
    """The surface through the cells of a walk, outward where g grows; vertices by linear interpolation on edges."""
    corners = _pack(walked.cells[:, None] + _CORNERS)
    tetrahedra = corners[:, _TETRAHEDRA].reshape(-1, 4)
    values = walked.values[np.searchsorted(walked.keys, tetrahedra)]
    order = np.argsort(values, axis=1, kind="stable")
    # Corners ascending in g: those inside first. Reordering may mirror the tetrahedron: orientation is set at the end.
    tetrahedra, values = np.take_along_axis(tetrahedra, order, 1), np.take_along_axis(values, order, 1)
    count = (values < 0.0).sum(axis=1)
    edges = []  # (T, 3, 2) node keys of the edges that carry each triangle's vertices
    for inside, triangles in (
        (1, [[(0, 1), (0, 2), (0, 3)]]),
        (3, [[(0, 3), (1, 3), (2, 3)]]),
        (2, [[(0, 2), (0, 3), (1, 3)], [(0, 2), (1, 3), (1, 2)]]),
    ):
        edges += [tetrahedra[count == inside][:, triangle] for triangle in triangles]
    pairs = np.concatenate(edges)
    faces_of = np.concatenate([np.flatnonzero(count == i) for i in (1, 3, 2, 2)])
    ends, faces = np.unique(np.sort(pairs.reshape(-1, 2), axis=1), axis=0, return_inverse=True)
    faces = faces.reshape(-1, 3)
    g = walked.values[np.searchsorted(walked.keys, ends)]
    t = np.clip(g[:, 0] / (g[:, 0] - g[:, 1]), _ON_NODE, 1.0 - _ON_NODE)[:, None]
    low, high = _unpack(ends[:, 0]), _unpack(ends[:, 1])
    vertices = walked.origin + walked.resolution * ((1.0 - t) * low + t * high)
    # Outward is from the inner to the outer corners of the tetrahedron that holds the triangle.
    nodes, weights = _unpack(tetrahedra[faces_of]), (values[faces_of] >= 0.0).astype(float)
    outer = (nodes * weights[..., None]).sum(axis=1) / weights.sum(axis=1, keepdims=True)
    inner = (nodes * (1.0 - weights)[..., None]).sum(axis=1) / (1.0 - weights).sum(axis=1, keepdims=True)
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    wrong = np.einsum("ij,ij->i", np.cross(b - a, c - a), outer - inner) < 0.0
    faces[wrong] = faces[wrong][:, ::-1]
    return trimesh.Trimesh(vertices, faces, process=False)


def _pack(cells: Integers) -> Integers:
    """One key for three indices (..., 3)."""
    if cells.size and np.abs(cells).max() >= _HALF - 2:
        raise SurfaceError(f"resolution: expected at most {_HALF} cells along an axis, got more")
    i, j, k = np.moveaxis(cells + _HALF, -1, 0)
    return (i << 2 * _BITS) | (j << _BITS) | k


def _unpack(keys: Integers) -> Integers:
    """`_pack` undone: (...,) -> (..., 3)."""
    mask = (1 << _BITS) - 1
    return np.stack([keys >> 2 * _BITS, (keys >> _BITS) & mask, keys & mask], axis=-1) - _HALF
