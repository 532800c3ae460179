"""What objects stand on in the grasping worlds: flat and inclined tables, and a pipe with a saddle.

A support is a flat seat in the world and the boxes and cylinders that make it. A round object rolls off a bare pipe,
and off a slope, so the inclined table and the saddle have a rim around their seat.

Seat frame: origin in the middle of the seat, z its outward normal, x down the slope (the heading of a level one).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from aerograsp_env.sim.objects import GraspObject

Array = NDArray[np.float64]

SLAB = 0.030  # [m] thickness of a table's top
COLUMN = 0.050  # [m] radius of the column under a slope
PLATE = 0.010  # [m] thickness of a saddle's plate
RIM_WIDTH = 0.010  # [m]
STEEPEST = math.radians(40.0)  # what objects still rest on
ABOVE, BELOW = 0.60, 0.01  # [m] from the seat: between them a point is on the support
TORSION, ROLLING = 0.002, 1e-4  # [m] friction against spinning and rolling, as levers of a contact's normal force
_WOOD, _METAL, _PAINT = "0.62 0.47 0.33 1", "0.55 0.57 0.60 1", "0.78 0.62 0.22 1"


class Solid(NamedTuple):
    """One geom of a support."""

    kind: Literal["box", "cylinder"]
    size: tuple[float, ...]  # [m] half sizes of a box; radius and half length (along z) of a cylinder
    T_world_solid: Array  # (4, 4)
    rgba: str

    def geom(self, name: str, attributes: str) -> str:
        """Its MJCF text."""
        x, y, z, w = Rotation.from_matrix(self.T_world_solid[:3, :3]).as_quat()
        pos, quat = _text(self.T_world_solid[:3, 3]), _text((w, x, y, z))
        return (
            f'<geom name="{name}" type="{self.kind}" size="{_text(self.size)}" pos="{pos}" quat="{quat}" '
            f'rgba="{self.rgba}" {attributes}/>'
        )


@dataclass(frozen=True, eq=False)
class Support:
    """A seat that objects rest on. Made by `table`, `inclined_table` and `pipe_saddle`."""

    name: str
    T_world_seat: Array  # (4, 4)
    half_size: tuple[float, float]  # [m] of the seat along its x and y, within the rim
    rim: float  # [m] height of the rim; 0 for none
    friction: float  # Coulomb coefficient of its surface
    solids: tuple[Solid, ...]

    @property
    def slope(self) -> float:
        """Angle between the seat and the horizontal [rad]."""
        return math.acos(min(1.0, float(self.T_world_seat[2, 2])))

    def geoms(self, cls: str, item: GraspObject | None = None, prefix: str = "support") -> str:
        """MJCF text of its geoms, named `prefix`0, `prefix`1, …, of the default class `cls`.

        Args:
            item: what stands on it; the geoms then state the friction between the two (`contact_friction`), with
                priority over the object's own.
        """
        contact = ""
        if item is not None:
            numbers = _text((self.contact_friction(item), TORSION, ROLLING))
            contact = f' condim="4" priority="1" friction="{numbers}"'
        attributes = f'class="{cls}"{contact}'
        return "\n".join(solid.geom(f"{prefix}{i}", attributes) for i, solid in enumerate(self.solids))

    def contact_friction(self, item: GraspObject) -> float:
        """Coulomb coefficient between the item and the support: the geometric mean of the two surfaces' own."""
        return math.sqrt(item.friction * self.friction)

    def contains(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Whether world points (..., 3) [m] are over the seat: within its rim, and not far above it."""
        local = (np.asarray(points, dtype=np.float64) - self.T_world_seat[:3, 3]) @ self.T_world_seat[:3, :3]
        across = (np.abs(local[..., :2]) <= self.half_size).all(axis=-1)
        return np.asarray(across & (local[..., 2] >= -BELOW) & (local[..., 2] <= ABOVE))


def table(
    height: float = 0.75,
    size: tuple[float, float] = (0.60, 0.60),
    *,
    center: tuple[float, float] = (0.0, 0.0),
    heading: float = 0.0,
    friction: float = 0.7,
) -> Support:
    """A level table on four legs.

    Args:
        height: of its top above the floor [m].
        size: along its x and y [m].
        center: of its top in the world [m].
        heading: from the world's x axis to its own [rad].

    Raises:
        ValueError: a number out of range.
    """
    T = _seat(height, center, heading, 0.0)
    half = _half(size)
    _check(height=(height, SLAB, 5.0), friction=(friction, 0.0, 5.0))
    leg = 0.5 * (height - SLAB)
    solids = [_on(T, (*half, 0.5 * SLAB), (0.0, 0.0, -0.5 * SLAB), _WOOD)]
    for x in (-1.0, 1.0):
        for y in (-1.0, 1.0):
            place = (x * (half[0] - 0.03), y * (half[1] - 0.03), -SLAB - leg)
            solids.append(_on(T, (0.02, 0.02, leg), place, _WOOD))
    return Support("table", T, half, 0.0, friction, tuple(solids))


def inclined_table(
    angle: float = math.radians(15.0),
    height: float = 0.75,
    size: tuple[float, float] = (0.40, 0.40),
    *,
    rim: float = 0.015,
    center: tuple[float, float] = (0.0, 0.0),
    heading: float = 0.0,
    friction: float = 0.7,
) -> Support:
    """A table with a rim, inclined about a horizontal axis, on a column.

    Args:
        angle: of the slope [rad], at most 40°.
        height: of the seat's middle above the floor [m].
        size: of the seat within the rim, down the slope and across [m].
        rim: its height [m].
        center: of the seat in the world [m].
        heading: of the way down, from the world's x axis [rad].

    Raises:
        ValueError: a number out of range.
    """
    T = _seat(height, center, heading, angle)
    half = _half(size)
    reach = (half[0] + RIM_WIDTH) * math.sin(angle) + SLAB * math.cos(angle)  # of the lowest edge below the middle
    _check(height=(height, 0.0, 5.0), friction=(friction, 0.0, 5.0), rim=(rim, 0.0, 0.1))
    if reach > height:
        raise ValueError(f"height: expected {reach:.3g} m or more for a slope of this size, got {height}")
    outer = (half[0] + RIM_WIDTH, half[1] + RIM_WIDTH, 0.5 * SLAB)
    half_column = 0.5 * (height - COLUMN * math.tan(angle) - 0.3 * SLAB)  # ends within the slab, below the seat
    column = _upright((*center, half_column), COLUMN, half_column, _METAL)
    solids = [_on(T, outer, (0.0, 0.0, -0.5 * SLAB), _WOOD), *_rim(T, half, rim, SLAB), column]
    return Support("inclined_table", T, half, rim, friction, tuple(solids))


def pipe_saddle(
    angle: float = 0.0,
    height: float = 1.0,
    seat: tuple[float, float] = (0.30, 0.24),
    *,
    radius: float = 0.05,
    length: float = 2.0,
    rim: float = 0.015,
    center: tuple[float, float] = (0.0, 0.0),
    heading: float = 0.0,
    friction: float = 0.7,
) -> Support:
    """A pipe, level or oblique, between two columns, with a saddle clamped on it: a plate with a rim, along the pipe.

    Args:
        angle: of the pipe against the horizontal [rad], at most 40°.
        height: of the seat's middle above the floor [m].
        seat: along and across the pipe, within the rim [m]; the crawler needs (0.36, 0.36).
        radius: of the pipe [m].
        length: of the pipe [m].
        rim: its height [m].
        center: of the seat in the world [m].
        heading: of the pipe's way down, from the world's x axis [rad].

    Raises:
        ValueError: a number out of range.
    """
    T = _seat(height, center, heading, angle)
    half = _half(seat)
    _check(height=(height, 0.0, 10.0), friction=(friction, 0.0, 5.0), rim=(rim, 0.0, 0.1), radius=(radius, 0.0, 0.5))
    _check(length=(length, seat[0], 20.0))
    depth = PLATE + 0.02 + radius  # of the pipe's axis below the seat
    low = height - depth * math.cos(angle) - 0.5 * length * math.sin(angle)
    if low < radius:
        raise ValueError(f"height: expected {height + radius - low:.3g} m or more for this pipe, got {height}")
    along = np.eye(4)
    along[:3, :3] = Rotation.from_euler("y", 0.5 * math.pi).as_matrix()
    along[2, 3] = -depth
    T_pipe = T @ along
    block = (0.25 * seat[0], 0.9 * radius, 0.5 * (depth - 0.5 * radius - PLATE))
    plate = (half[0] + RIM_WIDTH, half[1] + RIM_WIDTH, 0.5 * PLATE)
    solids = [
        _on(T, plate, (0.0, 0.0, -0.5 * PLATE), _METAL),
        *_rim(T, half, rim, PLATE),
        _on(T, block, (0.0, 0.0, -PLATE - block[2]), _METAL),
        Solid("cylinder", (radius, 0.5 * length), T_pipe, _PAINT),
    ]
    for end in (-0.5, 0.5):
        top = T_pipe[:3, 3] + end * length * T_pipe[:3, 2]
        solids.append(_upright((top[0], top[1], 0.5 * top[2]), 0.04, 0.5 * top[2], _METAL))
    return Support("pipe_saddle", T, half, rim, friction, tuple(solids))


def _check(**values: tuple[float, float, float]) -> None:
    for name, (value, low, high) in values.items():
        if not low <= value <= high or (value == 0.0 and name != "rim"):
            raise ValueError(f"{name}: expected a number above {low:.3g} and at most {high:.3g}, got {value}")


def _half(size: tuple[float, float]) -> tuple[float, float]:
    if len(size) != 2 or not all(0.05 <= value <= 5.0 for value in size):
        raise ValueError(f"size: expected two lengths between 0.05 and 5 m, got {size}")
    return 0.5 * size[0], 0.5 * size[1]


def _seat(height: float, center: tuple[float, float], heading: float, angle: float) -> Array:
    if not 0.0 <= angle <= STEEPEST:
        raise ValueError(f"angle: expected a slope between 0 and {STEEPEST:.3g} rad, got {angle}")
    if not np.isfinite([height, *center, heading]).all():
        raise ValueError(f"center: expected finite numbers, got height {height}, center {center}, heading {heading}")
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("ZY", (heading, angle)).as_matrix()
    T[:3, 3] = (*center, height)
    T.setflags(write=False)
    return T


def _rim(T: Array, half: tuple[float, float], height: float, thickness: float) -> list[Solid]:
    """Four walls from the bottom of the plate to the top of the rim."""
    if height == 0.0:
        return []
    x, y = half
    w, h, z = 0.5 * RIM_WIDTH, 0.5 * (height + thickness), 0.5 * (height - thickness)
    ends = [_on(T, (w, y + RIM_WIDTH, h), (s * (x + w), 0.0, z), _METAL) for s in (1.0, -1.0)]
    return ends + [_on(T, (x, w, h), (0.0, s * (y + w), z), _METAL) for s in (1.0, -1.0)]


def _on(T: Array, half: tuple[float, float, float], center: tuple[float, float, float], rgba: str) -> Solid:
    """A box along the axes of the frame T."""
    local = np.eye(4)
    local[:3, 3] = center
    return Solid("box", half, T @ local, rgba)


def _upright(center: tuple[float, float, float], radius: float, half: float, rgba: str) -> Solid:
    T = np.eye(4)
    T[:3, 3] = center
    return Solid("cylinder", (radius, half), T, rgba)


def _text(values: ArrayLike) -> str:
    return " ".join(f"{value:.9g}" for value in np.asarray(values, dtype=np.float64))
