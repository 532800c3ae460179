"""The reproductions on implicit surfaces: their objects, views and scores, on single cases."""

import numpy as np
import pytest

from agents.figure_2_8 import half, reconstruct, volume_ratio
from agents.figure_2_12 import SHAPES, align, score, view
from agents.gpis_speed import medians
from agents.seeds import VALIDATION_SEED
from agents.shapes import apple, surface_points
from baselines.objects import Constant, fit_ellipsoid


@pytest.mark.parametrize("shape", [apple, *SHAPES.values()])
def test_shapes_are_closed_and_face_outward(shape):
    mesh = shape()
    assert mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0.0
    assert 0.05 < mesh.extents.max() < 0.25


def test_half_an_apple():
    seen = half(VALIDATION_SEED)
    prior = fit_ellipsoid(seen.points, seen.normals).prior
    assert volume_ratio(seen, prior, 0.03) == pytest.approx(1.0, abs=0.15)
    assert volume_ratio(seen, Constant(0.01), 0.01) < 0.75  # falls back to the level beyond what is seen
    assert reconstruct(seen, Constant(10.0), 1e-4) is None and volume_ratio(seen, Constant(10.0), 1e-4) == 0.0


def test_views_show_one_side_and_alignment_undoes_an_error():
    seen = view(VALIDATION_SEED + 2)
    assert 200 < len(seen.points) < 6000
    points, normals = surface_points(seen.truth, 4000, np.random.default_rng(0))
    moved = np.eye(4)
    moved[:3, 3] = [0.004, -0.003, 0.002]
    T = align(points, normals, points[::3], moved)
    np.testing.assert_allclose(points @ T[:3, :3].T + T[:3, 3], points, atol=1e-3)


def test_a_model_completes_a_view():
    seen = view(VALIDATION_SEED)
    assert score(seen, 4e-3, 0.02).far < score(seen, None, np.inf).far


def test_medians_time_every_function():
    calls = []
    found = medians({"a": lambda: calls.append("a"), "b": lambda: calls.append("b")}, 3)
    assert set(found) == {"a", "b"} and calls == ["a", "b"] * 4
