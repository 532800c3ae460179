"""Where in its workspace the docking tool reads well, and the set-point that keeps it there.

The thesis maps the quality of each tip position (figure 5.15) and leaves holding the vehicle where it is high to future
work (section 5.4.1). Here the set-point is chosen by its worst quality over the motion to expect around it, not by its
own: a good point beside a limit is a bad place to hold.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import distance_transform_edt, minimum_filter

from aerograsp_env.spatial import as_array, transform

if TYPE_CHECKING:
    from baselines.kinematics.docking_tool import DockingTool

Array = NDArray[np.float64]

_MAX_CELLS = 5_000_000


class Workspace(NamedTuple):
    """Tip positions in the base frame and the quality there, with the vehicle level at one heading."""

    x: Array  # (nx,) [m], evenly spaced, as y and z
    y: Array  # (ny,) [m]
    z: Array  # (nz,) [m]
    quality: Array  # (nx, ny, nz) in [0, 1], 0 where unreachable


class SetPoint(NamedTuple):
    """Where to hold the tip."""

    position: Array  # (3,) in the base frame [m]
    quality: float  # there
    worst_quality: float  # the least over the expected motion about it


def level_pose(position: ArrayLike, heading: ArrayLike = 0.0, up: bool = True) -> Array:
    """T_base_tip (..., 4, 4) of a tip at `position` (..., 3) [m] that holds a level vehicle.

    Rz(heading) Rx(± 90°): the tip's y axis points up, or down where `up` is False. `heading` (...) is θ0 + θ4 with the
    axis up and θ0 − θ4 with it down [rad].
    """
    position = as_array(position, (3,), "position")
    heading = np.asarray(heading, dtype=np.float64)
    if not np.isfinite(heading).all():
        raise ValueError(f"heading: expected finite angles, got {heading.tolist()}")
    c, s, zero = np.cos(heading), np.sin(heading), np.zeros_like(heading)
    sense = 1.0 if up else -1.0
    rows = [[c, zero, sense * s], [s, zero, -sense * c], [zero, zero + sense, zero]]
    return transform(np.stack([np.stack(row, axis=-1) for row in rows], axis=-2), position)


def workspace(
    tool: DockingTool,
    resolution: float = 0.02,
    heading: float | None = None,
    up: bool = True,
    bounds: ArrayLike | None = None,
) -> Workspace:
    """The tool's quality over a grid of tip positions with the vehicle level (thesis figure 5.15).

    Args:
        tool: whose workspace.
        resolution: distance of the grid's points [m].
        heading: of the tip about the base's z axis [rad]; the joint centres' when None.
        up: whether the tip's y axis points up (θ1 + θ2 + θ3 = 90°) or down (−90°).
        bounds: (3, 2) lowest and highest x, y, z in the base frame [m]; all that can be reached when None.

    Raises:
        ValueError: a resolution or bounds that give no grid, or one of more than five million points.
    """
    _check_resolution(resolution)
    heading = _heading(tool, up) if heading is None else heading
    l0, l1, l2, l3, l4 = tool.lengths
    if bounds is None:
        middle = np.array([0.0, 0.0, l0 + (l4 if up else -l4)])
        reach = np.array([l1 + l2 + l3, l1 + l2 + l3, l1 + l2])
        counts = np.ceil(reach / resolution)
        low, steps = middle - counts * resolution, 2.0 * counts
    else:
        limits = as_array(bounds, (3, 2), "bounds")
        if limits.shape != (3, 2) or (limits[:, 0] > limits[:, 1]).any():
            raise ValueError(f"bounds: expected (3, 2) rows of low ≤ high, got {limits.tolist()}")
        low, steps = limits[:, 0], np.floor((limits[:, 1] - limits[:, 0]) / resolution + 1e-9)
    if np.prod(steps + 1.0) > _MAX_CELLS:
        raise ValueError(f"resolution: expected at most {_MAX_CELLS} grid points, got {np.prod(steps + 1.0):.3g}")
    x, y, z = (start + resolution * np.arange(int(n) + 1) for start, n in zip(low, steps, strict=True))
    quality = np.empty((x.size, y.size, z.size))
    for i, xi in enumerate(x):  # one plane at a time: the poses of a whole fine grid would fill the memory
        positions = np.stack(np.meshgrid([xi], y, z, indexing="ij"), axis=-1)[0]
        quality[i] = tool.solve(level_pose(positions, heading, up)).quality
    return Workspace(x, y, z, quality)


def best_set_point(
    tool: DockingTool,
    center: ArrayLike | None = None,
    radius: ArrayLike = 0.05,
    search: ArrayLike | None = None,
    heading: float | None = None,
    up: bool = True,
    resolution: float = 0.01,
) -> SetPoint:
    """The tip position, vehicle level, whose worst quality over the expected motion about it is highest.

    Exact on a grid: the quality is sampled at `resolution` and its minimum taken over the grid's points in the motion.
    Among equals the one nearest to `center` is chosen. The vehicle's tilt is not part of the motion.

    Args:
        tool: whose set-point.
        center: (3,) of the region searched, in the base frame [m]; the whole workspace when None.
        radius: the motion: of a ball [m], or the half extents (3,) of a box.
        search: half extents of the region about `center`, scalar or (3,) [m]; 0.1 when None.
        heading, up: of the tip, as for `workspace`.
        resolution: of the grid [m].

    Raises:
        ValueError: nowhere does the whole motion stay within the joint limits; or an argument of a wrong shape,
            negative or not finite.
    """
    motion = _extents(radius, "radius")
    if center is None:
        if search is not None:
            raise ValueError("search: expected None where no center is given")
        grid = workspace(tool, resolution, heading, up)
        inside = np.ones(grid.quality.shape, dtype=bool)
        near = tool.forward(tool.joint_centers)[:3, 3]
    else:
        near = as_array(center, (3,), "center")
        if near.shape != (3,):
            raise ValueError(f"center: expected shape (3,), got {near.shape}")
        _check_resolution(resolution)
        # A whole number of steps each way, so that the centre is on the grid; the margin is for the motion only.
        region = np.floor(_extents(0.1 if search is None else search, "search") / resolution + 1e-9)
        half = (region + np.ceil(motion / resolution)) * resolution
        grid = workspace(tool, resolution, heading, up, np.stack([near - half, near + half], axis=1))
        inside = np.zeros(grid.quality.shape, dtype=bool)
        half_shape = np.array(grid.quality.shape) // 2
        low, high = (half_shape - region).astype(int), (half_shape + region).astype(int) + 1
        inside[low[0] : high[0], low[1] : high[1], low[2] : high[2]] = True

    # Room for the largest ball inside the motion is needed anyway; without this check a huge footprint would be built.
    room = float(distance_transform_edt(np.pad(grid.quality > 0.0, 1)).max()) * resolution
    worst = np.zeros(grid.quality.shape)
    if room > motion.min():
        reach = np.floor(motion / resolution + 1e-9).astype(int)
        offsets = np.meshgrid(*(np.arange(-n, n + 1) * resolution for n in reach), indexing="ij")
        footprint = np.ones(offsets[0].shape, dtype=bool)
        if np.ndim(radius) == 0:
            footprint = sum(offset**2 for offset in offsets) <= (motion[0] * (1.0 + 1e-9)) ** 2
        worst = np.where(inside, minimum_filter(grid.quality, footprint=footprint, mode="constant", cval=0.0), 0.0)
    highest = float(worst.max())
    if highest <= 0.0:
        raise ValueError(
            f"radius: expected a motion that some set-point keeps within the joint limits, got {np.asarray(radius)} m"
        )
    equals = np.argwhere(worst >= highest * (1.0 - 1e-9))
    positions = np.stack([axis[i] for axis, i in zip(grid[:3], equals.T, strict=True)], axis=-1)
    chosen = int(np.argmin(np.linalg.norm(positions - near, axis=1)))
    return SetPoint(positions[chosen], float(grid.quality[tuple(equals[chosen])]), highest)


def _heading(tool: DockingTool, up: bool) -> float:
    return tool.joint_centers[0] + (tool.joint_centers[4] if up else -tool.joint_centers[4])


def _check_resolution(resolution: float) -> None:
    if not 0.0 < resolution < np.inf:
        raise ValueError(f"resolution: expected a positive distance [m], got {resolution}")


def _extents(value: ArrayLike, name: str) -> Array:
    array = np.asarray(value, dtype=np.float64)
    if array.shape not in ((), (3,)) or not np.isfinite(array).all() or (array < 0.0).any():
        raise ValueError(f"{name}: expected a non-negative length or three of them [m], got {array.tolist()}")
    return np.broadcast_to(array, (3,))
