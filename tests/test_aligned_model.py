"""Aligned models: the noise's formula and bounds, thinning, and what the model adds to half an object."""

import numpy as np
import pytest

from baselines.objects import GPIS, Constant, SquaredExponential
from baselines.objects.aligned_model import aligned_noise, fit_with_model, merge_model
from baselines.objects.downsampling import voxel_downsample


def sphere(count=400, seed=0, radius=0.05):
    normals = np.random.default_rng(seed).standard_normal((count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return radius * normals, normals


def test_noise_grows_with_the_distance_and_is_bounded():
    seen, x = np.array([[0.0, 0, 0], [1.0, 0, 0]]), np.array([[0.0, 0, 0], [0.3, 0, 0], [0.9, 0, 0], [9.0, 0, 0]])
    got = aligned_noise(x, seen, 0.01, 0.1, largest=0.5)
    np.testing.assert_allclose(got, [0.01, 0.01 * np.exp(3), 0.01 * np.exp(1), 0.5])
    np.testing.assert_allclose(aligned_noise(x, seen, 0.01, np.inf), 0.01)
    assert aligned_noise([[1e9, 0, 0]], seen, 0.01, 1e-3) == pytest.approx(0.2)
    assert aligned_noise(np.empty((0, 3)), seen, 0.01, 0.1).shape == (0,)


def test_one_point_for_each_voxel():
    points, normals = sphere(3000)
    fewer, turned = voxel_downsample(points, 0.01, normals)
    cells = np.unique(np.floor(points / 0.01), axis=0)
    assert len(fewer) == len(turned) == len(cells)
    assert set(map(tuple, np.floor(fewer / 0.01))) == set(map(tuple, cells))
    np.testing.assert_allclose(np.linalg.norm(turned, axis=1), 1.0)
    assert np.einsum("ij,ij->i", turned, fewer / np.linalg.norm(fewer, axis=1, keepdims=True)).min() > 0.99
    np.testing.assert_allclose(voxel_downsample(points, 1e-7)[0], points[np.lexsort(np.floor(points / 1e-7).T[::-1])])
    wall = np.array([[0.001, 0.0, 0.0], [0.002, 0.0, 0.0]])
    kept, kept_normals = voxel_downsample(wall, 0.01, np.array([[-1.0, 0, 0], [1.0, 0, 0]]))
    np.testing.assert_array_equal(kept, wall[:1])
    np.testing.assert_array_equal(kept_normals, [[-1.0, 0, 0]])


def test_the_model_completes_half_an_object_and_stays_uncertain_there():
    points, normals = sphere()
    half = points[:, 2] > 0.0
    model_points, model_normals = sphere(seed=1)
    data = merge_model(
        points[half], normals[half], model_points + [0.0, 0.0, 0.002], model_normals,
        voxel=0.012, alignment_noise=0.003, decay_length=0.03,
    )  # fmt: skip
    assert data.observed < len(data.points) and (data.points[: data.observed, 2] > 0.0).all()
    assert (data.noise[: data.observed] == 1e-3).all() and data.noise[data.observed :].min() >= 0.003
    np.testing.assert_allclose(data.normal_noise[data.observed :] / 0.05, data.noise[data.observed :] / 0.003)
    gp = GPIS(SquaredExponential(0.04, 1e-3), Constant(0.03))
    assert fit_with_model(gp, data) is gp
    assert gp.surface(0.005).volume == pytest.approx(4 / 3 * np.pi * 0.05**3, rel=0.08)
    ends = gp.predict([[0.0, 0, 0.05], [0.0, 0, -0.05]], variance=True).variance
    assert ends[1] > 2.0 * ends[0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"alignment_noise": 0.0}, "alignment_noise: expected a positive"),
        ({"decay_length": 0.0}, "decay_length: expected a positive"),
        ({"decay_length": np.nan}, "decay_length: expected a positive"),
        ({"largest": 1e-4}, "largest: expected a length ≥ alignment_noise"),
        ({"voxel": 0.0}, "voxel: expected a positive"),
        ({"points": np.empty((0, 3)), "normals": np.empty((0, 3))}, "observed_points: expected shape"),
        ({"model_normals": np.ones((400, 3))}, "normals: expected unit length"),
        ({"points": np.full((400, 3), np.nan)}, "points: expected finite"),
    ],
)
def test_bad_arguments_are_named(arguments, message):
    points, normals = sphere()
    good = {
        "points": points, "normals": normals, "model_points": points, "model_normals": normals,
        "voxel": 0.01, "alignment_noise": 0.003, "decay_length": 0.03,
    }  # fmt: skip
    with pytest.raises(ValueError, match=message):
        merge_model(**(good | arguments))
