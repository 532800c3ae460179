"""Objects to be looked at: coloured closed surfaces with a class label, a frame and the symmetries of that frame.

Frames, the same for every member of a class: the origin is the middle of the bounding box, except that objects with
an axis of symmetry have it on that axis.

| class | x | y | z |
|---|---|---|---|
| screwdriver | axis, from the grip to the tip | in the plane of a flat blade | out of it |
| wrench, pliers | from the grip to the (first) jaw | across, in the tool's plane | out of the plane |
| hammer | along the handle to the head | from the claw or peen to the face | out of that plane |
| can, juice_box | along the front's width | front to back | up, to the lid |
| box | longest side | second side | shortest side |
| fruit | any | any, or to the inside of the bend | along the core to the stem |
| crawler | through a lobe | left of it | up |
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from aerograsp_env.sim.visual.looks import Look, another
from aerograsp_env.sim.visual.solids import Shaded, Solid, shaded

Array = NDArray[np.float64]
T = TypeVar("T")

STEP = 36  # samples of a continuous symmetry


class Part(NamedTuple):
    """A closed surface of one look, in the object's frame. Parts of an object may overlap."""

    vertices: Array  # (V, 3) [m]
    faces: NDArray[np.int32]  # (F, 3), outward by the right-hand rule
    look: Look


@dataclass(frozen=True, eq=False)
class VisualObject:
    """Something to be looked at; see the module for its frame.

    Raises:
        ValueError: no parts, a part without faces or with vertices that are not finite, or symmetries that are not
            rotations (K, 3, 3) with the identity first.
    """

    label: str
    parts: tuple[Part, ...]
    symmetries: Array  # (K, 3, 3) rotations that leave it looking the same; the identity is the first
    kind: str = ""  # which sort of its class, e.g. "claw"

    def __post_init__(self) -> None:
        if not self.parts or any(len(part.faces) == 0 for part in self.parts):
            raise ValueError(f"parts: expected closed surfaces with faces, got {len(self.parts)} parts, some empty")
        if not all(np.isfinite(part.vertices).all() for part in self.parts):
            raise ValueError("parts: expected finite vertices")
        R = np.asarray(self.symmetries, dtype=np.float64)
        if R.ndim != 3 or R.shape[1:] != (3, 3) or not len(R) or not np.allclose(R[0], np.eye(3), atol=1e-9):
            raise ValueError(f"symmetries: expected (K, 3, 3) with the identity first, got shape {R.shape}")
        if not np.allclose(R @ R.transpose(0, 2, 1), np.eye(3), atol=1e-6) or (np.linalg.det(R) < 0.0).any():
            raise ValueError("symmetries: expected proper rotations")

    @functools.cached_property
    def vertices(self) -> Array:
        """(V, 3) [m] of all parts."""
        return np.concatenate([part.vertices for part in self.parts])

    @functools.cached_property
    def faces(self) -> NDArray[np.int32]:
        """(F, 3) into `vertices`."""
        starts = np.cumsum([0, *(len(part.vertices) for part in self.parts[:-1])])
        return np.concatenate([part.faces + start for part, start in zip(self.parts, starts, strict=True)]).astype(
            np.int32
        )

    @functools.cached_property
    def shaded(self) -> tuple[Shaded, ...]:
        """The parts with normals to draw them by: smooth but for sharp edges."""
        return tuple(shaded(part.vertices, part.faces) for part in self.parts)

    @functools.cached_property
    def extent(self) -> Array:
        """(3,) side lengths [m] of the bounding box."""
        return np.asarray(np.ptp(self.vertices, axis=0))

    @functools.cached_property
    def diameter(self) -> float:
        """Largest distance [m] between two vertices: what ADD-S thresholds are shares of."""
        from scipy.spatial import ConvexHull
        from scipy.spatial.distance import pdist

        return float(pdist(self.vertices[ConvexHull(self.vertices, qhull_options="QJ").vertices]).max())

    @functools.cached_property
    def steady(self) -> tuple[Array, Array]:
        """Outward normals (K, 3) of the facets of its hull that it can stand on, and weights (K,) that sum to 1.

        It can stand on a facet that holds the foot of the perpendicular from the centre of mass, here that of the
        surface. Weights are the facets' areas: a quick stand-in for how often a dropped object comes to rest on each
        (`aerograsp_env.sim.objects.resting` has those probabilities, at a hundred times the cost).
        """
        from scipy.spatial import ConvexHull

        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        center = (area @ (a + b + c)) / (3.0 * area.sum())
        hull = ConvexHull(self.vertices - center)
        a, b, c = (hull.points[hull.simplices[:, k]] for k in range(3))
        normal = hull.equations[:, :3]
        foot = -normal * hull.equations[:, 3:]
        cross = np.cross(b - a, c - a)
        area = np.linalg.norm(cross, axis=1)
        turn = np.sign(np.einsum("ij,ij->i", cross, normal))
        inside = area > 0.0
        for start, end in ((a, b), (b, c), (c, a)):
            side = np.einsum("ij,ij->i", np.cross(end - start, foot - start), normal) * turn
            inside &= side >= -1e-3 * np.linalg.norm(end - start, axis=1)  # a millimetre outside still counts
        chosen = np.flatnonzero(inside) if inside.any() else np.array([int(np.argmax(area))])
        weight = ((normal[chosen] @ normal.T > 0.9995) * area).sum(axis=1)
        return normal[chosen], weight / weight.sum()

    def surface(self, count: int, rng: np.random.Generator) -> tuple[Array, Array, NDArray[np.uint8]]:
        """Points (N, 3) [m], outward unit normals (N, 3) and sRGB colours (N, 3), uniform over the outside.

        What lies inside another part is left out; textures are not in the colours.

        Raises:
            ValueError: a count below 1.
        """
        if count < 1:
            raise ValueError(f"count: expected at least 1, got {count}")
        vertices, faces = self.vertices, self.faces
        a, b, c = (vertices[faces[:, k]] for k in range(3))
        cross = np.cross(b - a, c - a)
        area = np.linalg.norm(cross, axis=1)
        owner = np.repeat(np.arange(len(self.parts)), [len(part.faces) for part in self.parts])
        found: list[tuple[Array, Array, NDArray[np.intp]]] = []
        missing = count
        while missing > 0:
            face = rng.choice(len(area), size=2 * missing + 16, p=area / area.sum())
            u, v = rng.random((2, len(face), 1))
            fold = u + v > 1.0
            u, v = np.where(fold, 1.0 - u, u), np.where(fold, 1.0 - v, v)
            points = a[face] + u * (b[face] - a[face]) + v * (c[face] - a[face])
            out = ~self._buried(points, owner[face])
            found.append((points[out], (cross / np.maximum(area, 1e-300)[:, None])[face[out]], owner[face[out]]))
            missing -= int(out.sum())
        points, normals, part = (np.concatenate(arrays)[:count] for arrays in zip(*found, strict=True))
        palette = np.array([np.round(255.0 * np.asarray(item.look.rgb)) for item in self.parts]).astype(np.uint8)
        return points, normals, palette[part]

    def _buried(self, points: Array, owner: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Which points of the parts' surfaces lie inside another part."""
        import igl

        inside = np.zeros(len(points), dtype=bool)
        for index, part in enumerate(self.parts):
            other = np.flatnonzero(owner != index)
            low, high = part.vertices.min(axis=0), part.vertices.max(axis=0)
            near = other[((points[other] > low) & (points[other] < high)).all(axis=1)]
            if near.size:
                winding = igl.fast_winding_number(part.vertices, part.faces.astype(np.int64), points[near])
                inside[near] |= winding > 0.5
        return inside


_FIELDS = {field.name for field in dataclasses.fields(VisualObject)}


class Draw:
    """Where a builder's dimensions come from: their nominal values, or a generator."""

    def __init__(self, rng: np.random.Generator | None = None, colors: bool = True):
        self._rng = rng
        self._colors = rng if colors else None

    def size(self, nominal: float, low: float, high: float) -> float:
        """A length or number between low and high."""
        return nominal if self._rng is None else float(self._rng.uniform(low, high))

    def pick(self, *options: T) -> T:
        """One of the options, the first is the nominal one."""
        return options[0] if self._rng is None else options[int(self._rng.integers(len(options)))]

    def chance(self, probability: float) -> bool:
        """True with the probability; never in the nominal object."""
        return self._rng is not None and bool(self._rng.random() < probability)

    def look(self, nominal: Look, maker: Callable[[np.random.Generator], Look]) -> Look:
        """A random look by `maker`, or the nominal one."""
        return nominal if self._colors is None else maker(self._colors)


class Shape(NamedTuple):
    """What a builder returns: solids and their looks, in any position but with the axes of the class."""

    parts: tuple[tuple[Solid, Look], ...]
    symmetries: Array
    kind: str
    center: tuple[float | None, float | None, float | None] = (None, None, None)  # origin; None the middle of the box


def finish(label: str, shape: Shape) -> VisualObject:
    """The object, its origin where its class has it."""
    points = np.concatenate([solid.vertices for solid, _ in shape.parts])
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    origin = np.array([m if given is None else given for given, m in zip(shape.center, middle, strict=True)])
    parts = tuple(Part(solid.vertices - origin, solid.faces, look) for solid, look in shape.parts)
    return VisualObject(label, parts, shape.symmetries, shape.kind)


# --- groups of symmetries, each with the identity first


def only() -> Array:
    """No symmetry."""
    return np.eye(3)[None]


def turns(axis: int, count: int) -> Array:
    """(count, 3, 3) turns about an axis."""
    return np.asarray(
        Rotation.from_rotvec(np.eye(3)[axis] * (np.arange(count)[:, None] * 2.0 * np.pi / count)).as_matrix()
    )


def times(first: ArrayLike, second: ArrayLike) -> Array:
    """Every product of two groups' members."""
    a, b = np.asarray(first), np.asarray(second)
    return np.asarray((a[:, None] @ b[None]).reshape(-1, 3, 3))


def registry() -> dict[str, Callable[[Draw], Shape]]:
    """The builder of every class."""
    from aerograsp_env.sim.visual import everyday, hammers, pliers, screwdrivers, wrenches

    return {
        "screwdriver": screwdrivers.screwdriver,
        "wrench": wrenches.wrench,
        "pliers": pliers.pliers,
        "hammer": hammers.hammer,
        "crawler": everyday.crawler,
        "can": everyday.can,
        "juice_box": everyday.juice_box,
        "box": everyday.box,
        "fruit": everyday.fruit,
    }


def _builder(label: str) -> Callable[[Draw], Shape]:
    builders = registry()
    if label not in builders:
        raise ValueError(f"label: expected one of {', '.join(builders)}, got {label!r}")
    return builders[label]


@functools.cache
def nominal_object(label: str) -> VisualObject:
    """The class's reference model, which policies may know.

    Raises:
        ValueError: an unknown label.
    """
    return finish(label, _builder(label)(Draw()))


def recolored(item: VisualObject, rng: np.random.Generator) -> VisualObject:
    """The same shape, each material in another look; parts that looked alike still do."""
    new: dict[Look, Look] = {}
    for part in item.parts:
        if part.look not in new:
            new[part.look] = another(part.look, rng)
    copy = dataclasses.replace(item, parts=tuple(part._replace(look=new[part.look]) for part in item.parts))
    shape = {name: value for name, value in vars(item).items() if name not in _FIELDS}  # what has been computed of it
    vars(copy).update(shape)
    return copy


def random_object(label: str, rng: np.random.Generator, colors: bool = True) -> VisualObject:
    """A member of the class with its own sort, proportions and (with `colors`) looks.

    Raises:
        ValueError: an unknown label.
    """
    return finish(label, _builder(label)(Draw(rng, colors)))
