"""Fine registration of one cloud to another: point-to-plane ICP, generalised ICP, and ICP with colours."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

import numpy as np
import small_gicp
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.spatial import check_transform, inverse
from baselines.detection.checks import check_points, check_positive
from baselines.detection.color_registration import ColoredCloud, iterate_with_colors
from baselines.detection.spacing import bounds, cloud_size, point_spacing
from baselines.objects.point_cloud import PointCloudObject

Array = NDArray[np.float64]
Method = Literal["icp", "gicp", "color"]

LEAST = 10
"""Fewest points (and fewest pairs) that a registration is made from."""
NEIGHBORS = 10
"""Points that make a normal or a covariance."""
FIRM = 5e-3
"""Below this the target lets the source slide or turn: a plane, a sphere or a cylinder on its like has no one pose."""
KINDS = {"icp": "PLANE_ICP", "gicp": "GICP"}


class RegistrationResult(NamedTuple):
    """What a registration found, and how far to trust it."""

    T_target_source: Array  # (4, 4) maps source to target coordinates; NaN where not `converged`
    converged: bool  # the iteration came to rest, on enough of the target, which holds it
    rmse: float  # [m] of the inliers' distances to the nearest target point; NaN without inliers
    inlier_fraction: float  # of the source's points that have a target point within the gate
    iterations: int


class Scales(NamedTuple):
    """Lengths [m] that a registration works with."""

    resolution: float  # edge of the voxels that the clouds are thinned by
    reach: float  # largest distance of a pair while the start is rough
    gate: float  # the same at the end


def default_scales(source: Array, target: Array) -> Scales:
    """Scales of the clouds themselves: their density, and the size of the smaller one.

    Raises:
        ValueError: a cloud whose points all coincide.
    """
    sizes = {"source": cloud_size(source), "target": cloud_size(target)}
    for name, size in sizes.items():
        if size <= 0.0:
            raise ValueError(f"{name}: expected points that differ, got all at one place")
    size = min(sizes.values())
    spacing = max(point_spacing(source), point_spacing(target))
    resolution = 0.01 * size
    gate = 3.0 * max(spacing, resolution)
    return Scales(resolution, max(0.15 * size, gate), gate)


def failed(rmse: float = np.nan, inlier_fraction: float = 0.0, iterations: int = 0) -> RegistrationResult:
    """A result without a pose."""
    return RegistrationResult(np.full((4, 4), np.nan), False, rmse, inlier_fraction, iterations)


def register(
    source: Any,
    target: Any,
    T_init: ArrayLike | None = None,
    method: Method = "icp",
    *,
    resolution: float | None = None,
    reach: float | None = None,
    gate: float | None = None,
    min_inlier_fraction: float = 0.3,
    max_iterations: int = 50,
) -> RegistrationResult:
    """The rigid motion that lays one cloud on another (thesis, section 3.3), from a rough start.

    "icp" minimises distances to the target's tangent planes (Chen & Medioni 1992), "gicp" those between the two
    surfaces (Segal, Haehnel & Thrun 2009), both by small_gicp: first a coarse cloud with far-reaching pairs, then all
    of it with near ones. "color" pairs points by place and colour and passes the pairs through four rejectors.

    Args:
        source, target: (N, 3) [m], or a `PointCloudObject` ("color" needs its colours). The source must lie on the
            target, at least in part.
        T_init: (4, 4) rough T_target_source; None: the identity.
        method: see above.
        resolution, reach, gate: [m] edge of the voxels that thin the clouds, and the largest distance of a pair at
            first and at last. None: from the clouds' own size and density.
        min_inlier_fraction: the smallest share of the source on the target that counts as success.
        max_iterations: of each of the two stages.

    Returns:
        The pose and its quality. Where it failed, `converged` is false and the pose is NaN; so it is where shapes alone
        leave the pose open, as those of a plane, a sphere or a cylinder do.

    Raises:
        ValueError: clouds of fewer than ten points or with values that are not finite, a start that is not rigid, or
            arguments out of range.
    """
    if method not in ("icp", "gicp", "color"):
        raise ValueError(f'method: expected "icp", "gicp" or "color", got {method!r}')
    if not 0.0 <= min_inlier_fraction <= 1.0:
        raise ValueError(f"min_inlier_fraction: expected a fraction in [0, 1], got {min_inlier_fraction}")
    if max_iterations < 1:
        raise ValueError(f"max_iterations: expected at least 1, got {max_iterations}")
    moving, fixed = points_of(source, "source"), points_of(target, "target")
    start = np.eye(4) if T_init is None else check_transform(T_init, "T_init")
    if start.ndim != 2:
        raise ValueError(f"T_init: expected shape (4, 4), got {start.shape}")
    given = {"resolution": resolution, "reach": reach, "gate": gate}
    given = {name: check_positive(value, name) for name, value in given.items() if value is not None}
    scales = Scales(**given) if len(given) == 3 else default_scales(moving, fixed)._replace(**given)  # type: ignore[arg-type]
    if method == "color":
        return _register_colors(source, target, moving, fixed, start, scales, min_inlier_fraction, max_iterations)
    return _register_shapes(moving, fixed, start, method, scales, min_inlier_fraction, max_iterations)


def points_of(cloud: Any, name: str) -> Array:
    """The points (N, 3) of an array or a `PointCloudObject`."""
    return check_points(cloud.points if isinstance(cloud, PointCloudObject) else cloud, name, LEAST)


def _register_shapes(
    moving: Array,
    fixed: Array,
    start: Array,
    method: str,
    scales: Scales,
    least_fraction: float,
    max_iterations: int,
) -> RegistrationResult:
    near = _crop(fixed, moving @ start[:3, :3].T + start[:3, 3], 2.0 * scales.reach)
    if len(near) < LEAST:
        return failed()
    target, tree = _prepared(near, scales.resolution)
    source, _ = _prepared(moving, scales.resolution)
    coarse = _coarser(source, max(3.0 * scales.resolution, scales.reach / 5.0))
    size = cloud_size(moving)
    T, iterations = start, 0
    # The generalised steps need not come to rest as nearly: their pairs switch within the surfaces' covariances. Nor
    # need they begin as near, whereas plane steps over all of the cloud cost more than those over the coarse one.
    rough, fine = (1e-1, 1e-2) if method == "gicp" else (5e-2, 2e-3)
    stages = [(source, KINDS[method], scales.gate, fine * scales.resolution)]
    if scales.reach > scales.gate:
        stages.insert(0, (coarse, KINDS["icp"], scales.reach, rough * scales.resolution))
    for cloud, kind, distance, step in stages:
        found = _align(target, cloud, tree, T, kind, distance, max_iterations, step, size)
        iterations += int(found.iterations)
        # small_gicp reports success where it found no pair at all, with the pose that it was given.
        if found.num_inliers < LEAST or not np.isfinite(found.T_target_source).all():
            return failed(iterations=iterations)
        T = np.array(found.T_target_source)
    rested = bool(found.converged)
    if not rested:  # pairs may switch to and fro for ever: what hardly moves any more is at rest all the same
        found = _align(target, source, tree, T, KINDS[method], scales.gate, 5, step, size)
        moved = inverse(T) @ np.array(found.T_target_source)
        rested = _displacement(moved, np.asarray(source.points())[:, :3]) < 0.1 * scales.resolution
    rmse, fraction, firmness = _fit(T, source, tree, scales.gate, np.asarray(target.normals())[:, :3])
    if not rested or fraction < least_fraction or firmness < FIRM:
        return failed(rmse, fraction, iterations)
    return RegistrationResult(T, True, rmse, fraction, iterations)


def _align(
    target: small_gicp.PointCloud,
    source: small_gicp.PointCloud,
    tree: small_gicp.KdTree,
    T: Array,
    kind: str,
    distance: float,
    max_iterations: int,
    step: float,
    size: float,
) -> small_gicp.RegistrationResult:
    return small_gicp.align(
        target,
        source,
        tree,
        T,
        registration_type=kind,
        max_correspondence_distance=distance,
        max_iterations=max_iterations,
        rotation_epsilon=step / size,
        translation_epsilon=step,
    )


def _displacement(T: Array, points: Array) -> float:
    """Root mean square [m] of how far a motion takes the points."""
    return float(np.sqrt((((points @ (T[:3, :3] - np.eye(3)).T) + T[:3, 3]) ** 2).sum(axis=1).mean()))


def _register_colors(
    source: Any,
    target: Any,
    moving: Array,
    fixed: Array,
    start: Array,
    scales: Scales,
    least_fraction: float,
    max_iterations: int,
) -> RegistrationResult:
    colors = []
    for name, cloud in (("source", source), ("target", target)):
        if not isinstance(cloud, PointCloudObject) or cloud.colors is None:
            raise ValueError(f"{name}: expected a PointCloudObject with colors for the method 'color'")
        colors.append(cloud.colors)
    near = _inside(fixed, moving @ start[:3, :3].T + start[:3, 3], 2.0 * scales.reach)
    if near.sum() < LEAST:
        return failed()
    one = ColoredCloud(moving, colors[0], scales.resolution)
    other = ColoredCloud(fixed[near], colors[1][near], scales.resolution)
    if min(len(one.points), len(other.points)) < LEAST:
        return failed()
    T, rested, iterations = iterate_with_colors(one, other, start, scales.reach, scales.gate, max_iterations, LEAST)
    rmse, fraction, _ = _fit(T, small_gicp.PointCloud(one.points), small_gicp.KdTree(other.points), scales.gate)
    if not rested or fraction < least_fraction:
        return failed(rmse, fraction, iterations)
    return RegistrationResult(T, True, rmse, fraction, iterations)


def _inside(points: Array, around: Array, margin: float) -> NDArray[np.bool_]:
    """Which points lie inside a cloud's bounding box, widened by a margin [m]."""
    low, high = bounds(around)
    return ((points >= low - margin) & (points <= high + margin)).all(axis=1)


def _crop(points: Array, around: Array, margin: float) -> Array:
    """The points inside a cloud's bounding box, widened by a margin [m]; not copied where that is all of them."""
    (low, high), (lowest, highest) = bounds(around), bounds(points)
    if (lowest >= low - margin).all() and (highest <= high + margin).all():
        return points
    return points[_inside(points, around, margin)]


def _prepared(points: Array, resolution: float) -> tuple[small_gicp.PointCloud, small_gicp.KdTree]:
    """A cloud thinned by voxels (unless too little would be left), with normals and covariances, and its tree."""
    # small_gicp numbers voxels by 21 bits an axis, and drops what lies beyond them.
    if max(-points.min(), points.max()) < 2**20 * resolution:
        cloud, tree = small_gicp.preprocess_points(points, resolution, NEIGHBORS)
        if cloud.size() >= LEAST:
            return cloud, tree
    cloud = small_gicp.PointCloud(points)
    tree = small_gicp.KdTree(cloud)
    small_gicp.estimate_normals_covariances(cloud, tree, NEIGHBORS)
    return cloud, tree


def _coarser(cloud: small_gicp.PointCloud, resolution: float) -> small_gicp.PointCloud:
    """A thinned cloud thinned more, if enough is left."""
    coarse = small_gicp.voxelgrid_sampling(cloud, resolution)
    return coarse if coarse.size() >= LEAST else cloud


def _fit(
    T: Array,
    source: small_gicp.PointCloud,
    tree: small_gicp.KdTree,
    gate: float,
    normals: Array | None = None,
    looks: int = 1000,
) -> tuple[float, float, float]:
    """How well a pose fits, from at most `looks` points of the source.

    Returns:
        The root mean square [m] of the distances within the gate, the share of the source that has one, and, with the
        target's normals, how firmly the tangent planes hold the source: the smallest eigenvalue of their information
        over the largest, about the middle and with turns in units of the size; 1 without normals.
    """
    points = np.asarray(source.points())[:, :3]
    points = points[:: max(1, len(points) // looks)] @ T[:3, :3].T + T[:3, 3]
    rows, squared = (np.asarray(found).reshape(-1) for found in tree.batch_knn_search(points, 1))
    near = squared <= gate * gate
    if not near.any():
        return np.nan, 0.0, 0.0
    rmse, firmness = float(np.sqrt(squared[near].mean())), 1.0
    if normals is not None:
        local = points[near] - points[near].mean(axis=0)
        local /= max(float(np.sqrt((local**2).sum(axis=1).mean())), 1e-12)
        facing = normals[rows[near].astype(np.int64)]
        planes = np.concatenate([facing, np.cross(local, facing)], axis=1)
        values = np.linalg.eigvalsh(planes.T @ planes)
        firmness = float(values[0] / max(values[-1], 1e-300))
    return rmse, float(near.mean()), firmness
