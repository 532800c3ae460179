"""The comparison with Embree: what it measures is the same work."""

from __future__ import annotations

import numpy as np

from agents.ray_speed import RAYS, measure, rays_towards
from baselines.objects import MeshObject


def test_a_row_a_mesh_and_no_odd_ray() -> None:
    rows = measure(repeats=1, rays=500)
    assert all(row.odd == 0 and row.seconds > 0.0 and row.bound_seconds > 0.0 for row in rows)
    assert RAYS >= 10_000


def test_rays_start_outside_and_look_at_the_box() -> None:
    mesh = MeshObject.from_arrays(np.vstack([np.zeros(3), np.eye(3)]), [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    origins, directions = rays_towards(mesh, 200, np.random.default_rng(0))
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0)
    assert (np.linalg.norm(origins - 0.5, axis=1) > 2.0).all()
    assert 50 < len(np.unique(mesh.ray_hits(origins, directions).rays)) <= 200
