"""What a depth camera sees of an object from one side: noisy points, normals estimated from them, and their noise.

Rays meet exactly the surface of the union of the object's convex pieces (`mujoco.mj_multiRay`; no OpenGL).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import NamedTuple

import mujoco
import numba
import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim.grasp_scene import OBJECT_GROUP, grasp_model
from aerograsp_env.sim.gripper import GripperConfig
from aerograsp_env.sim.objects import GraspObject

Array = NDArray[np.float64]

_PATCH = 0.006  # [m] half the side of the patch that a normal is fitted to
_WINDOW = 4  # pixels of it that are used on either side of the middle
_MARGIN = 1.02  # of the picture around the object
_NOISE_DISTANCE = 0.5  # [m] at which `sigma_quadratic` is reached
_FEWEST = 3  # pixels that make a view


class UnseenError(ValueError):
    """A view shows nothing of the object."""


@dataclass(frozen=True)
class DepthCameraConfig:
    """The depth camera, its noise, and what may stand in its way.

    The noise of the depth z is normal with σ_z = sigma + sigma_quadratic · (z / 0.5 m)², the axial law of structured
    light and stereo (Khoshelham and Elberink 2012). Surfaces seen at a grazing angle return nothing: always beyond
    `grazing_limit` from their normal, with a chance that grows linearly from `grazing_start` on.

    Raises:
        ValueError: a value out of its range.
    """

    width: int = 160  # [px] of the crop around the object
    height: int = 120
    distance: float = 0.5  # [m] from the object's middle
    sigma: float = 0.0005  # [m]
    sigma_quadratic: float = 0.0015  # [m]
    grazing_start: float = math.radians(70.0)
    grazing_limit: float = math.radians(86.0)
    occluded_probability: float = 0.25
    occluded_fraction: tuple[float, float] = (0.2, 0.4)  # of what is seen, when something hides one side

    def __post_init__(self) -> None:
        low, high = self.occluded_fraction
        for name, fits, expected in (
            ("width", 16 <= self.width <= 1024, "16 to 1024 px"),
            ("height", 16 <= self.height <= 1024, "16 to 1024 px"),
            ("distance", 0.3 <= self.distance <= 0.8, "0.3 to 0.8 m"),
            ("sigma", 0.0 <= self.sigma <= 0.02, "0 to 0.02 m"),
            ("sigma_quadratic", 0.0 <= self.sigma_quadratic <= 0.005, "0 to 0.005 m"),
            ("grazing_start", 0.0 < self.grazing_start < self.grazing_limit, "0 < grazing_start < grazing_limit"),
            ("grazing_limit", self.grazing_limit <= 0.5 * math.pi, "at most π/2 rad"),
            ("occluded_probability", 0.0 <= self.occluded_probability <= 1.0, "0 to 1"),
            ("occluded_fraction", 0.0 <= low <= high <= 0.8, "0 ≤ low ≤ high ≤ 0.8"),
        ):
            if not fits:
                raise ValueError(f"{name}: expected {expected}, got {getattr(self, name)!r}")

    def scaled(self, factor: float) -> DepthCameraConfig:
        """With `factor` times the noise."""
        kept = {f.name: getattr(self, f.name) for f in fields(self)}
        return DepthCameraConfig(
            **{**kept, "sigma": factor * self.sigma, "sigma_quadratic": factor * self.sigma_quadratic}
        )


class PartialView(NamedTuple):
    """What was seen. The frame has the world's axes (z up) and its origin at the mean of the points."""

    points: Array  # (N, 3) [m]
    normals: Array  # (N, 3) unit, towards the camera, estimated
    noise: Array  # (N,) [m] standard deviation of each point along its viewing ray
    viewpoint: Array  # (3,) [m] where the camera stands
    distinct: int  # how many of the points are
    T_cloud_object: Array  # (4, 4) the truth


class _Pixels(NamedTuple):
    """The seen pixels of a depth picture."""

    points: Array  # (H, W, 3) [m] with noise; what is not seen is NaN
    seen: NDArray[np.bool_]  # (H, W)
    sigma: Array  # (H, W) [m] along the ray
    pitch: float  # [m] between pixels at the object's middle


def middle_and_radius(item: GraspObject) -> tuple[Array, float]:
    """Middle of the object's bounding box (3,) and the distance of its farthest vertex [m], in its frame."""
    middle = 0.5 * (item.vertices.min(axis=0) + item.vertices.max(axis=0))
    return middle, float(np.linalg.norm(item.vertices - middle, axis=1).max())


def partial_view(
    item: GraspObject,
    R_world_object: Array,
    direction: Array,
    count: int,
    camera: DepthCameraConfig,
    rng: np.random.Generator,
    occluded: bool | None = None,
    gripper: GripperConfig | None = None,
) -> PartialView:
    """Look at an object and sample `count` points of what is seen.

    Args:
        R_world_object: (3, 3) how it lies.
        direction: (3,) unit, world, from the object's middle to the camera.
        occluded: whether something hides one side; None to leave it to chance.
        gripper: only which compiled model of the object is used.

    Raises:
        ValueError: an object so large that the camera would stand in it; (UnseenError) one of which fewer than
            three pixels are seen.
    """
    middle, radius = middle_and_radius(item)
    if radius > 0.8 * camera.distance:
        raise ValueError(
            f"object: expected one within {0.8 * camera.distance:.2f} m of its middle, {item.name!r} reaches "
            f"{radius:.3g} m (is its mesh in millimetres?)"
        )
    pixels, position = _look(item, R_world_object, middle, radius, direction, camera, rng, gripper or GripperConfig())
    if occluded is None:
        occluded = bool(rng.random() < camera.occluded_probability)
    seen = _hide_one_side(pixels.seen, camera, rng) if occluded else pixels.seen
    seen = _without_specks(seen)
    rows = np.flatnonzero(seen)
    if rows.size < _FEWEST:
        raise UnseenError(
            f"view: expected one that shows at least {_FEWEST} pixels of {item.name!r}, got {rows.size} from "
            f"{np.round(direction, 3).tolist()}"
        )
    distinct = min(count, rows.size)
    chosen = rng.choice(rows, distinct, replace=False)
    if distinct < count:
        chosen = np.concatenate([chosen, rng.choice(rows, count - distinct)])
    points = pixels.points.reshape(-1, 3)[chosen]
    normals = _fit_normals(pixels, seen, chosen, points, position)
    origin = points.mean(axis=0)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R_world_object, -R_world_object @ middle - origin
    return PartialView(points - origin, normals, pixels.sigma.ravel()[chosen], position - origin, distinct, T)


def _look(
    item: GraspObject,
    R_world_object: Array,
    middle: Array,
    radius: float,
    direction: Array,
    camera: DepthCameraConfig,
    rng: np.random.Generator,
    gripper: GripperConfig,
) -> tuple[_Pixels, Array]:
    """The depth picture as points about the object's middle with the world's axes, and the camera's position."""
    position = camera.distance * direction
    R = look_at(-direction)
    focal = 0.5 * camera.height / math.tan(math.asin(radius / camera.distance)) / _MARGIN
    x = (np.arange(camera.width) + 0.5 - 0.5 * camera.width) / focal
    y = (np.arange(camera.height) + 0.5 - 0.5 * camera.height) / focal
    square = 1.0 + x**2 + (y**2)[:, None]
    # Only what points at the bounding sphere is cast.
    cast = np.flatnonzero(square < 1.0 / (1.0 - (radius / camera.distance) ** 2))
    row, column = np.divmod(cast, camera.width)
    # Of length 1 along the optical axis: ray parameters are depths.
    rays = np.stack([x[column], y[row], np.ones(len(cast))], axis=1) @ R.T
    rays_object = rays @ R_world_object
    depth, normal = _cast(item, gripper, R_world_object.T @ position + middle, rays_object)
    hit = np.isfinite(depth)
    length = np.sqrt(square.ravel()[cast])
    cosine = np.abs(np.einsum("ij,ij->i", normal, rays_object)) / length
    angle = np.arccos(np.minimum(cosine, 1.0))
    lost = (angle - camera.grazing_start) / (camera.grazing_limit - camera.grazing_start)
    hit &= rng.random(len(cast)) >= lost
    safe = np.where(hit, depth, 1.0)
    sigma_z = camera.sigma + camera.sigma_quadratic * (safe / _NOISE_DISTANCE) ** 2
    noisy = safe + sigma_z * rng.standard_normal(len(cast))
    shape = (camera.height, camera.width)
    points, seen, sigma = np.full((*shape, 3), np.nan), np.zeros(shape, bool), np.zeros(shape)
    points.reshape(-1, 3)[cast] = np.where(hit, noisy, np.nan)[:, None] * rays + position
    seen.ravel()[cast] = hit
    sigma.ravel()[cast] = sigma_z * length
    return _Pixels(points, seen, sigma, camera.distance / focal), position


def look_at(forward: Array) -> Array:
    """(3, 3) R_world_camera (OpenCV: x right, y down, z forward) of an upright camera that looks along `forward`."""
    side = np.array([forward[1], -forward[0], 0.0])
    length = float(np.linalg.norm(side))
    side = side / length if length > 1e-9 else np.array([1.0, 0.0, 0.0])  # straight up or down: any heading
    return np.stack([side, np.cross(forward, side), forward], axis=1)


def _cast(item: GraspObject, gripper: GripperConfig, origin: Array, rays: Array) -> tuple[Array, Array]:
    """Depth (M,), infinite for a miss, and true normal (M, 3), all in the object's frame."""
    model = grasp_model(item, gripper)
    data = mujoco.MjData(model)
    data.joint("object").qpos[:] = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    mujoco.mj_kinematics(model, data)
    groups = np.zeros(mujoco.mjNGROUP, dtype=np.uint8)
    groups[OBJECT_GROUP] = 1
    count = len(rays)
    geom, depth, normal = np.empty(count, np.int32), np.empty(count), np.empty((count, 3))
    mujoco.mj_multiRay(
        *(model, data, origin, np.ascontiguousarray(rays).ravel(), groups, True, -1),
        *(geom, depth, normal.ravel(), count, mujoco.mjMAXVAL),
    )
    return np.where(geom >= 0, depth, np.inf), np.where(geom[:, None] >= 0, normal, 0.0)


def _hide_one_side(seen: NDArray[np.bool_], camera: DepthCameraConfig, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Without the pixels beyond a line across the picture."""
    angle = rng.uniform(0.0, 2.0 * math.pi)
    fraction = rng.uniform(*camera.occluded_fraction)
    grid = np.indices(seen.shape)  # rows, then columns
    along = math.cos(angle) * grid[1] + math.sin(angle) * grid[0]
    if not seen.any():
        return seen
    return np.logical_and(seen, along <= np.quantile(along[seen], 1.0 - fraction))


def _without_specks(seen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Without pixels that fewer than three of their eight neighbours stand by: no plane fits to those."""
    padded: NDArray[np.int8] = np.pad(seen, 1).astype(np.int8)
    rows: NDArray[np.int8] = padded[:-2] + padded[1:-1] + padded[2:]
    return np.logical_and(seen, rows[:, :-2] + rows[:, 1:-1] + rows[:, 2:] > 3)


def _fit_normals(
    pixels: _Pixels, seen: NDArray[np.bool_], chosen: NDArray[np.intp], points: Array, position: Array
) -> Array:
    """Normals (N, 3) of the planes fitted to the patches around the chosen pixels, towards the camera.

    Neighbours much farther or nearer than the pixel belong to another surface and are left out.
    """
    stride = max(1, round(_PATCH / (_WINDOW * pixels.pitch)))
    limit = 4.0 * pixels.sigma.ravel()[chosen] + 2.0 * _WINDOW * stride * pixels.pitch
    _, axes = np.linalg.eigh(_patch_moments(pixels.points, seen, chosen, stride, limit))
    normals = axes[:, :, 0]
    facing = np.einsum("ij,ij->i", normals, position - points)
    return np.where(facing[:, None] < 0.0, -normals, normals)


@numba.njit(cache=True)
def _patch_moments(points, seen, chosen, stride, limit):
    """Second moments (N, 3, 3) [m²] about their mean of the seen points within `limit` around each chosen pixel."""
    height, width = seen.shape
    moments = np.zeros((len(chosen), 3, 3))
    for k in range(len(chosen)):
        row, column = chosen[k] // width, chosen[k] % width
        total, second, count = np.zeros(3), np.zeros((3, 3)), 0
        for i in range(row - _WINDOW * stride, row + _WINDOW * stride + 1, stride):
            for j in range(column - _WINDOW * stride, column + _WINDOW * stride + 1, stride):
                if not (0 <= i < height and 0 <= j < width and seen[i, j]):
                    continue
                x = points[i, j, 0] - points[row, column, 0]
                y = points[i, j, 1] - points[row, column, 1]
                z = points[i, j, 2] - points[row, column, 2]
                if x * x + y * y + z * z >= limit[k] ** 2:
                    continue
                offset = (x, y, z)
                count += 1
                for a in range(3):
                    total[a] += offset[a]
                    for b in range(3):
                        second[a, b] += offset[a] * offset[b]
        for a in range(3):
            for b in range(3):
                moments[k, a, b] = second[a, b] - total[a] * total[b] / count
    return moments
