"""Grasps on a point cloud: the mesh's rays against the voxels that the points occupy.

Ramon Soria 2018, section 2.3.2 (figure 2.22), with a regular grid for the octree.
"""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from aerograsp_env.sim.gripper import GripperConfig
from baselines.grasping.candidates import GraspCandidates, GraspSearch, Pairs, assemble, note
from baselines.grasping.clearance import point_collisions
from baselines.grasping.contacts import Array, finite, unit
from baselines.grasping.occupancy import Occupancy
from baselines.grasping.on_mesh import RayPattern, box_rays
from baselines.objects.normals import estimate_normals
from baselines.objects.observations import check_points

FEWEST = 10
"""Distinct points that a cloud has to have."""
VOXEL_SPACINGS = 4.0
"""Edge of a voxel, in median distances of points from their nearest neighbours, unless one is given."""


def checked_cloud(points: ArrayLike) -> Array:
    """(N, 3) finite points that are enough and do not lie on a line, or a ValueError that names them."""
    p = check_points(points, "points") if np.size(points) else np.empty((0, 3))
    if p.shape[1] != 3:
        raise ValueError(f"points: expected shape (N, 3), got {p.shape}")
    distinct = len(np.unique(p, axis=0))
    if distinct < FEWEST:
        repeated = "" if distinct == len(p) else f" among {len(p)}, the others repeat them"
        raise ValueError(f"points: expected at least {FEWEST} distinct ones, got {distinct}{repeated}")
    spread = np.linalg.svd(p - p.mean(axis=0), compute_uv=False)
    if spread[1] <= 1e-6 * spread[0]:
        raise ValueError("points: expected points that spread over a surface, got ones in a line or a single place")
    return p


def cloud_pairs(cloud: Occupancy, origins: Array, directions: Array, oriented: bool) -> tuple[Pairs, int, int]:
    """Every way in and later way out along each ray, how many crossings there were, and how many rays had no pair.

    Without oriented normals ways in and out take turns, and rays with an odd number of crossings are passed over.
    """
    hits = cloud.cast(origins, directions, oriented)
    rays, normals = hits.rays, hits.normals
    count = np.bincount(rays, minlength=len(origins))
    if oriented:
        entering = np.einsum("hi,hi->h", normals, directions[rays]) < 0.0
    else:
        place = np.arange(len(rays)) - (np.cumsum(count) - count)[rays]
        entering = place % 2 == 0
        normals = np.where(entering[:, None], normals, -normals)  # the cast turned all of them against the ray
    usable = np.ones(len(rays), dtype=bool) if oriented else (count % 2 == 0)[rays]
    most = int(count.max(initial=0))
    rows = [
        np.stack([first, first + ahead], axis=1)
        for ahead in range(1, most)
        for first in (np.arange(max(len(rays) - ahead, 0)),)
    ]
    pairs = np.concatenate(rows) if rows else np.empty((0, 2), dtype=np.int64)
    i, j = pairs.T
    pairs = pairs[(rays[i] == rays[j]) & entering[i] & ~entering[j] & usable[i]]
    points = origins[rays] + hits.distances[:, None] * directions[rays]
    alone = int((count > 0).sum()) - len(np.unique(rays[pairs[:, 0]]))
    return Pairs(points[pairs], -normals[pairs]), len(rays), alone


def grasps_on_cloud(
    points: ArrayLike,
    normals: ArrayLike | None = None,
    gripper: GripperConfig | None = None,
    viewpoint: ArrayLike | None = None,
    voxel: float | None = None,
    friction: float | None = None,
    n_rays: int = 1000,
    rng: np.random.Generator | int = 0,
    *,
    pattern: RayPattern = "both",
    approaches: int = 8,
    clearance: float = 0.008,
) -> GraspCandidates:
    """Grasps of a parallel-jaw gripper on the points that were seen, in their frame; scored by the friction to spare.

    The score is as `grasps_on_mesh` has it. Both sides of what is held have to have been seen: a cloud from a single
    view gives few grasps or none. The gripper has room where no point is inside of its boxes, so where nothing was
    seen it is taken to be free.

    Args:
        points: (N, 3) [m].
        normals: (N, 3) unit, outward; None estimates them from 20 neighbours.
        gripper: None is `GripperConfig()`.
        viewpoint: (3,) [m] where all points were seen from, which estimated normals are turned to. Without it, and
            without normals, rays are taken to go in and out by turns, which holds for complete clouds.
        voxel: edge of a voxel [m]; None is 4 times the median distance to the nearest other place.
        friction: Coulomb coefficient; None is the gripper's.
        n_rays, rng, pattern, approaches, clearance: as `grasps_on_mesh` has them.

    Returns:
        Possibly none at all: `reasons` as `grasps_on_mesh` has them, with "ray saw no opposite side"; `counts` has
        "rays", "crossings" and "pairs".

    Raises:
        ValueError: fewer than 10 distinct points, points in a line, values that are not finite, normals that are not
            of unit length, or another argument out of its range.
    """
    p = checked_cloud(points)
    search = GraspSearch.of(gripper, friction, approaches, clearance)
    body = p
    if normals is None:
        view = None if viewpoint is None else finite("viewpoint", viewpoint, (3,))
        estimated = estimate_normals(p, np.zeros(3) if view is None else view)
        p, n, oriented = p[estimated.valid], estimated.normals[estimated.valid], view is not None
        if (places := len(np.unique(p, axis=0))) < FEWEST:
            raise ValueError(f"points: expected a surface to estimate normals on, got one at {places} points only")
    else:
        n, oriented = unit("normals", normals, p.shape), True
    if voxel is None:
        distinct = np.unique(p, axis=0)
        voxel = VOXEL_SPACINGS * float(np.median(cKDTree(distinct).query(distinct, k=2)[0][:, 1]))
    cloud = Occupancy.build(p, n, voxel)
    rays = box_rays(p.min(axis=0), p.max(axis=0), n_rays, pattern, np.random.default_rng(rng))
    reasons: Counter[str] = Counter()
    all_pairs, crossings, alone = cloud_pairs(cloud, *rays, oriented)
    note(reasons, {"ray saw no opposite side": alone, "ray missed": 0 if crossings else n_rays})
    pairs, margin = search.eligible(all_pairs, reasons)
    placed = search.place(pairs, lambda *bodies: point_collisions(body, *bodies), reasons)
    counts = {"rays": n_rays, "crossings": crossings, "pairs": len(all_pairs.positions)}
    return assemble(pairs, placed, margin, reasons, counts, p.mean(axis=0))
