"""Posed priors fitted to what was seen of an object: ellipsoid, sphere, cylinder, plane.

One view shows less than half of an object, and what it does not show its points cannot say: how deep the object is.
The ellipsoid is therefore a maximum a posteriori fit. Distances and normals count as some twenty independent
observations with errors of the size by which objects differ from ellipsoids; against them stands the expectation that
the axes are alike, that the outline across the line of sight and its nearest point are those of the object, and that
the depth is the smaller of the two extents across (an object that is round about its long axis). Seen from all around,
the data decides; seen from one side, the depth follows from the curvature as far as that goes, and from symmetry where
it does not.

Sources: Martens et al. 2017, "Geometric priors for Gaussian process implicit surfaces"; Taubin 1991 (first-order
distance to a quadric); Arsigny et al. 2006 (ellipsoids by the logarithm of their matrix).
"""

from dataclasses import dataclass
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from aerograsp_env.spatial import as_array
from baselines.objects.least_squares import Solution, levenberg_marquardt
from baselines.objects.linear_algebra import Array
from baselines.objects.observations import check_normals, check_points
from baselines.objects.priors import Cylinder, Ellipsoid, Plane, Prior, Sphere

P = TypeVar("P", bound=Prior)

EFFECTIVE = 50.0  # independent observations that the points are worth: neighbours err together
DISTANCE_ERROR = 0.04  # of the object's size, between an object and its ellipsoid
NORMAL_ERROR = 0.25  # per component
OUTLYING = 3.0  # squared error, in units of those two, from which a point counts less
LIKENESS = 0.6  # standard deviation of the logarithms of the axes about their mean
OUTLINE_ERROR = 0.1  # of half an extent: how far an ellipsoid may lie from what bounds the points on either side
DEPTH_LIKENESS = 0.3  # and of the depth's about the smaller extent across the line of sight
THINNEST = 0.5  # least depth along the line of sight, in extents across
ALIKE = 0.4  # logarithm of the ratio of extents from which an object counts as elongated
ONE_SIDED = 0.2  # length of the mean normal from which a cloud counts as seen from one side (half a sphere: 0.5)
FLAT = 20.0  # radius, in sizes of the cloud, from which it shows no curvature


@dataclass(frozen=True)
class PriorFit(Generic[P]):
    """A prior, and how well it describes the points."""

    prior: P
    residual: float  # root mean square distance of the points from its surface, to first order [m]
    converged: bool
    iterations: int
    reason: str  # why it did not converge, or what was bounded; empty when there is nothing to say


class _Cloud(NamedTuple):
    """Points about their centroid, in units of their size."""

    points: Array  # (N, 3)
    normals: Array | None  # (N, 3) outward
    centre: Array  # (3,) [m]
    size: float  # root mean square distance from the centroid [m]
    sight: Array | None  # unit (3,), from the viewer into the object; None when it was seen from all around

    def residuals(self, distances: Array, directions: Array) -> Array:
        """Weighted residuals (B, R) from distances (B, N), in sizes, and unit normals of the shape (B, N, 3).

        Far from the surface they grow like the root of the distance: dents and handles shall not steer the fit.
        """
        parts = (distances / DISTANCE_ERROR)[..., None]
        if self.normals is not None:
            parts = np.concatenate([parts, (directions - self.normals) / NORMAL_ERROR], axis=2)
        squares = np.einsum("bnk,bnk->bn", parts, parts)
        weight = np.sqrt(EFFECTIVE / len(self.points)) * (1.0 + squares / OUTLYING) ** -0.25
        return (parts * weight[..., None]).reshape(len(parts), -1)


def fit_ellipsoid(
    points: ArrayLike, normals: ArrayLike | None = None, viewpoint: ArrayLike | None = None, max_ratio: float = 4.0
) -> PriorFit[Ellipsoid]:
    """The most probable ellipsoid; see the module.

    Args:
        points: (N, 3) [m], N ≥ 4, not on a line.
        normals: (N, 3) unit, outward; they tell much more than the points where little is seen.
        viewpoint: (3,) [m], where they were seen from; without it the mean normal tells the line of sight.
        max_ratio: largest ratio of two axes.

    Raises:
        ValueError: bad points, normals or viewpoint; points on a line; a ratio below 1.
    """
    if not max_ratio >= 1.0:
        raise ValueError(f"max_ratio: expected a ratio ≥ 1, got {max_ratio}")
    cloud = _cloud(points, normals, viewpoint, 4)
    sight = cloud.sight
    across = None if sight is None else _complement(sight)  # (2, 3)
    outward, reach, half_extent = _outline(cloud, across)

    def residuals(theta: Array) -> Array:
        centres, logarithm = theta[:, :3], _symmetric(theta[:, 3:])
        eigenvalues, vectors = np.linalg.eigh(logarithm)  # of log A/2: −log of the axes
        axes, turned = np.exp(-eigenvalues), np.swapaxes(vectors, 1, 2)
        local = (cloud.points - centres[:, None]) @ vectors / axes[:, None]  # on the unit sphere
        radius = np.linalg.norm(local, axis=2)
        slope = local / axes[:, None] @ turned
        steepness = np.linalg.norm(slope, axis=2) + 1e-12
        parts = [cloud.residuals((radius - 1.0) * radius / steepness, slope / steepness[..., None])]
        mean = eigenvalues.mean(axis=1, keepdims=True)
        parts.append((eigenvalues - mean) / LIKENESS)
        parts.append(10.0 * np.maximum(np.abs(eigenvalues - mean) - 0.5 * np.log(max_ratio), 0.0))
        squares = vectors * axes[:, None] ** 2 @ turned  # A⁻¹: an ellipsoid reaches cᵀu + √(uᵀA⁻¹u) along u
        reached = centres @ outward.T + np.sqrt(np.einsum("ki,bij,kj->bk", outward, squares, outward))
        parts.append((reached - reach) / (OUTLINE_ERROR * half_extent))
        if sight is not None and across is not None:
            depth = 0.5 * np.log(np.einsum("i,bij,j->b", sight, squares, sight))
            small, large = 0.5 * np.log(np.linalg.eigvalsh(across @ squares @ across.T)).T
            gap = large - small  # of nearly equal extents the mean, lest noise make the object flat
            lateral = small + 0.5 * gap * np.exp(-((gap / ALIKE) ** 2))
            parts.append((depth - lateral)[:, None] / DEPTH_LIKENESS)
            # A face seen head-on looks like a disc without depth to the data.
            parts.append(40.0 * np.maximum(np.log(THINNEST) - (depth - lateral), 0.0)[:, None])
        return np.concatenate(parts, axis=1)

    centre, radius = _ball(cloud)
    start = np.concatenate([centre, -np.log(radius) * np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])])
    solution = levenberg_marquardt(residuals, start)
    eigenvalues, vectors = np.linalg.eigh(_symmetric(solution.x[None, 3:])[0])
    half = 0.5 * np.log(max_ratio)
    bounded = np.clip(eigenvalues, eigenvalues.mean() - half, eigenvalues.mean() + half)
    axes = cloud.size * np.exp(-bounded)
    prior = Ellipsoid(tuple(axes), T_world_object=_pose(vectors, cloud.centre + cloud.size * solution.x[:3]))
    reason = f"the axes' ratio is bounded to {max_ratio:g}" if np.abs(bounded - eigenvalues).max() > 1e-6 else ""
    return _result(prior, cloud, solution, reason)


def fit_sphere(
    points: ArrayLike, normals: ArrayLike | None = None, viewpoint: ArrayLike | None = None
) -> PriorFit[Sphere]:
    """The sphere of least squares, of distances and normals. Arguments and errors as for the ellipsoid."""
    cloud = _cloud(points, normals, viewpoint, 4)

    def residuals(theta: Array) -> Array:
        offset = cloud.points - theta[:, None, :3]
        distance = np.linalg.norm(offset, axis=2) + 1e-12
        return cloud.residuals(distance - np.exp(theta[:, 3:]), offset / distance[..., None])

    centre, radius = _ball(cloud)
    solution = levenberg_marquardt(residuals, np.append(centre, np.log(radius)), iterations=100)
    prior = Sphere(
        float(cloud.size * np.exp(min(solution.x[3], np.log(FLAT)))),
        T_world_object=_pose(np.eye(3), cloud.centre + cloud.size * solution.x[:3]),
    )
    return _result(prior, cloud, solution, "", float(np.exp(solution.x[3])))


def fit_cylinder(
    points: ArrayLike, normals: ArrayLike | None = None, viewpoint: ArrayLike | None = None
) -> PriorFit[Cylinder]:
    """The endless cylinder of least squares, of distances and normals. Arguments and errors as for the ellipsoid.

    Normals show the axis, which they are square to; without them the cloud's three principal axes are tried.
    """
    cloud = _cloud(points, normals, viewpoint, 6)
    if cloud.normals is not None:
        starts = [np.linalg.eigh(cloud.normals.T @ cloud.normals)[1][:, 0]]
    else:
        starts = list(np.linalg.svd(cloud.points, full_matrices=False)[2])
    fits = [_cylinder_from(cloud, axis) for axis in starts]
    return min(fits, key=lambda fit: (not fit.converged, fit.residual))


def fit_plane(
    points: ArrayLike, normals: ArrayLike | None = None, viewpoint: ArrayLike | None = None
) -> PriorFit[Plane]:
    """The plane of least squares (total: by the smallest principal axis), facing as the normals or the viewer say.

    Without either it faces up. Arguments and errors as for the ellipsoid; N ≥ 3.
    """
    cloud = _cloud(points, normals, viewpoint, 3)
    normal = np.linalg.svd(cloud.points, full_matrices=False)[2][-1]
    if cloud.normals is not None:
        outward = cloud.normals.mean(axis=0)
    else:
        outward = -cloud.sight if cloud.sight is not None else np.array([0.0, 0.0, 1.0])
    normal = normal if normal @ outward >= 0.0 else -normal
    prior = Plane(tuple(normal), float(normal @ cloud.centre))
    return PriorFit(prior, _rms(prior, cloud), True, 0, "")


def _cylinder_from(cloud: _Cloud, axis: Array) -> PriorFit[Cylinder]:
    across = _complement(axis)  # (2, 3)

    def residuals(theta: Array) -> Array:
        tilted = axis + theta[:, :2] @ across
        tilted /= np.linalg.norm(tilted, axis=1, keepdims=True)
        offset = cloud.points - (theta[:, 2:4] @ across)[:, None]
        offset = offset - (offset @ tilted[..., None]) * tilted[:, None]
        distance = np.linalg.norm(offset, axis=2) + 1e-12
        return cloud.residuals(distance - np.exp(theta[:, 4:]), offset / distance[..., None])

    flat = cloud._replace(
        points=cloud.points @ across.T,
        normals=None if cloud.normals is None else cloud.normals @ across.T,
        sight=None if cloud.sight is None else across @ cloud.sight,
    )
    centre, radius = _ball(flat)
    solution = levenberg_marquardt(residuals, np.concatenate([np.zeros(2), centre, [np.log(radius)]]), iterations=100)
    tilted = axis + solution.x[:2] @ across
    tilted /= np.linalg.norm(tilted)
    foot = solution.x[2:4] @ across
    foot = foot - (foot @ tilted) * tilted  # the axis' point nearest to the centroid
    frame = np.column_stack([*_complement(tilted), tilted])
    prior = Cylinder(
        float(cloud.size * np.exp(min(solution.x[4], np.log(FLAT)))),
        T_world_object=_pose(frame, cloud.centre + cloud.size * foot),
    )
    return _result(prior, cloud, solution, "", float(np.exp(solution.x[4])))


def _cloud(points: ArrayLike, normals: ArrayLike | None, viewpoint: ArrayLike | None, least: int) -> _Cloud:
    x = check_points(points, "points")
    if x.shape[1] != 3 or len(x) < least:
        raise ValueError(f"points: expected shape (N, 3) with N ≥ {least}, got {x.shape}")
    n = None if normals is None else check_normals(normals, x)
    centre = x.mean(axis=0)
    spread = np.linalg.svd(x - centre, compute_uv=False)
    if spread[1] <= 1e-6 * spread[0] or spread[0] == 0.0:
        raise ValueError("points: expected points that span a surface, got all on a line")
    size = float(np.sqrt(np.mean(((x - centre) ** 2).sum(axis=1))))
    sight = None
    mean_normal = None if n is None else n.mean(axis=0)
    one_sided = mean_normal is None or np.linalg.norm(mean_normal) > ONE_SIDED
    if viewpoint is not None:
        eye = as_array(viewpoint, (3,), "viewpoint")
        if eye.shape != (3,) or not np.isfinite(eye).all() or np.linalg.norm(eye - centre) < 1e-9:
            raise ValueError(f"viewpoint: expected a finite point (3,) away from the cloud, got {eye.tolist()}")
        sight = centre - eye
    elif mean_normal is not None:
        sight = -mean_normal
    if sight is not None:
        sight = sight / np.linalg.norm(sight) if one_sided else None
    return _Cloud((x - centre) / size, n, centre, size, sight)


def _outline(cloud: _Cloud, across: Array | None) -> tuple[Array, Array, Array]:
    """Directions (K, 3) in which the cloud shows the object's end, how far it reaches there, and half its extent."""
    if across is None:
        lines = np.linalg.svd(cloud.points, full_matrices=False)[2]
    else:
        angles = np.linspace(0.0, np.pi, 4, endpoint=False)
        lines = np.column_stack([np.cos(angles), np.sin(angles)]) @ across
    low, high = np.quantile(cloud.points @ lines.T, [0.0, 1.0], axis=0)
    outward, reach, half = np.vstack([lines, -lines]), np.concatenate([high, -low]), np.tile(0.5 * (high - low), 2)
    if cloud.sight is not None:  # of the line of sight only the near end
        outward, reach = np.vstack([outward, -cloud.sight]), np.append(reach, (-cloud.points @ cloud.sight).max())
        half = np.append(half, half.min())
    return outward, reach, np.maximum(half, 1e-3)


def _ball(cloud: _Cloud) -> tuple[Array, float]:
    """A sphere or circle to start from: closed forms. With normals x = c + r n is linear in c and r."""
    x, n = cloud.points, cloud.normals
    if n is not None:
        deviation = n - n.mean(axis=0)
        radius = float((x * deviation).sum() / max((deviation**2).sum(), 1e-9))
        radius = float(np.clip(radius, 0.3, 3.0))
        return -radius * n.mean(axis=0), radius  # the points are about their centroid
    if cloud.sight is not None and (length := float(np.linalg.norm(cloud.sight))) > 1e-6:
        return 0.6 * cloud.sight / length, 1.0
    system = np.column_stack([2.0 * x, np.ones(len(x))])
    solution = np.linalg.lstsq(system, (x**2).sum(axis=1), rcond=None)[0]
    centre = np.clip(solution[:-1], -3.0, 3.0)
    return centre, float(np.clip(np.sqrt(max(solution[-1] + solution[:-1] @ solution[:-1], 0.0)), 0.3, 3.0))


def _symmetric(six: Array) -> Array:
    """Symmetric matrices (B, 3, 3) from their diagonals and their entries (1, 2), (0, 2), (0, 1)."""
    return six[:, [[0, 5, 4], [5, 1, 3], [4, 3, 2]]]


def _complement(axis: Array) -> Array:
    """Two unit vectors (2, 3) that make a right-handed frame with a third, `axis`."""
    first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(axis, first)])


def _pose(rotation: Array, position: Array) -> Array:
    T = np.eye(4)
    T[:3, :3] = rotation if np.linalg.det(rotation) > 0.0 else -rotation
    T[:3, 3] = position
    return T


def _rms(prior: Prior, cloud: _Cloud) -> float:
    x = cloud.centre + cloud.size * cloud.points
    slope = np.linalg.norm(prior.gradient(x), axis=1)
    return float(np.sqrt(np.mean((prior.value(x) / np.maximum(slope, 1e-9)) ** 2)))


def _result(prior: P, cloud: _Cloud, solution: Solution, reason: str, radius: float = 0.0) -> PriorFit[P]:
    converged, residual = solution.converged, _rms(prior, cloud)
    if radius >= FLAT:
        converged, reason = False, f"the points show no curvature: its radius exceeds {FLAT:g} times their size"
    elif not converged:
        reason = f"no convergence within {solution.iterations} iterations"
    return PriorFit(prior, residual, converged, solution.iterations, reason)
