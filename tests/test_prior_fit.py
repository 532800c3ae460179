"""Fitted priors: known shapes come back, all around and from one side; half an apple is restored; what is refused."""

import time

import numpy as np
import pytest
import trimesh

from aerograsp_env.spatial import se3_exp
from agents.shapes import apple
from baselines.objects import GPIS, SquaredExponential
from baselines.objects.least_squares import levenberg_marquardt
from baselines.objects.prior_fit import fit_cylinder, fit_ellipsoid, fit_plane, fit_sphere

POSE = se3_exp([0.3, -0.2, 0.5, 0.4, -0.7, 1.1])
EYE = np.array([1.2, -0.9, 1.4])


def scan(mesh, eye=None, count=300, noise=0.0005, turn=0.03, seed=0):
    """Points and normals of a mesh, of the side that faces the eye."""
    rng = np.random.default_rng(seed)
    points, faces = trimesh.sample.sample_surface(mesh, 20 * count, seed=seed)
    normals = mesh.face_normals[faces]
    if eye is not None:
        ray = eye - points
        seen = np.einsum("ij,ij->i", normals, ray) > 0.1 * np.linalg.norm(ray, axis=1)
        points, normals = points[seen], normals[seen]
    points = points[:count] + noise * rng.standard_normal((count, 3))
    normals = normals[:count] + turn * rng.standard_normal((count, 3))
    return points, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def posed(mesh, pose=POSE):
    return mesh.copy().apply_transform(pose)


def ellipsoid(axes):
    return posed(trimesh.creation.icosphere(4).apply_scale(axes))


def position(prior):
    return np.asarray(prior.T_world_object)[:3, 3]


def volume(prior):
    return 4 / 3 * np.pi * np.prod(prior.axes)


@pytest.mark.parametrize("eye", [None, EYE], ids=["all-around", "one-view"])
@pytest.mark.parametrize("with_normals", [True, False], ids=["normals", "points"])
def test_spheres_come_back(eye, with_normals):
    points, normals = scan(posed(trimesh.creation.icosphere(4, 0.05)), eye)
    found = fit_sphere(points, normals if with_normals else None, eye)
    assert found.converged and found.reason == "" and found.residual < 1e-3
    assert found.prior.radius == pytest.approx(0.05, rel=0.02)
    np.testing.assert_allclose(position(found.prior), POSE[:3, 3], atol=1e-3)


@pytest.mark.parametrize("axes", [(0.05, 0.05, 0.05), (0.04, 0.05, 0.07), (0.03, 0.03, 0.06)])
def test_ellipsoids_come_back(axes):
    points, normals = scan(ellipsoid(axes))
    for given in (normals, None):
        found = fit_ellipsoid(points, given)
        assert found.converged
        np.testing.assert_allclose(np.sort(found.prior.axes), axes, rtol=0.05)
        np.testing.assert_allclose(position(found.prior), POSE[:3, 3], atol=2e-3)
    for eye in (EYE, POSE[:3, 3] + [0.0, 1.0, 0.0]):
        points, normals = scan(ellipsoid(axes), eye)
        assert volume(fit_ellipsoid(points, normals, eye).prior) == pytest.approx(
            4 / 3 * np.pi * np.prod(axes), rel=0.2
        )


@pytest.mark.parametrize(
    "mesh",
    [
        trimesh.creation.box((0.06, 0.1, 0.08)),
        trimesh.creation.box((0.05, 0.05, 0.2)),
        trimesh.creation.cylinder(0.035, 0.12),
        trimesh.creation.box((0.15, 0.15, 0.03)),
    ],
    ids=["box", "bar", "can", "plate"],
)
def test_single_views_of_what_is_no_ellipsoid_stay_of_the_objects_size(mesh):
    for eye in EYE * np.array([[1, 1, 1], [0.1, 0.1, 2], [2, 0.1, 0.1], [-1, 1, 0.3]]):
        found = fit_ellipsoid(*scan(mesh, eye), eye)
        assert found.converged
        assert 0.2 * min(mesh.extents) < min(found.prior.axes) and max(found.prior.axes) < 1.3 * max(mesh.extents)
        assert max(found.prior.axes) / min(found.prior.axes) <= 4.0 + 1e-9
        near = np.linalg.norm(position(found.prior)) / np.linalg.norm(mesh.extents)
        assert near < 0.45


@pytest.mark.parametrize("direction", [(0.0, 1.0, 0.0), (1.0, 0.3, 0.5), (0.0, -1.0, 0.2)])
def test_half_an_apple_is_restored(direction):
    mesh = apple()
    points, faces = trimesh.sample.sample_surface(mesh, 800, seed=1)
    half = points @ direction > 0.0
    points, normals = points[half][:300], mesh.face_normals[faces][half][:300]
    prior = fit_ellipsoid(points, normals).prior
    model = GPIS(SquaredExponential(0.02, 1e-4), prior, noise=1e-3, normal_noise=0.1).fit(points, normals)
    assert model.surface(0.004).volume == pytest.approx(mesh.volume, rel=0.1)


@pytest.mark.parametrize("with_normals", [True, False], ids=["normals", "points"])
def test_cylinders_come_back_from_one_side(with_normals):
    full = posed(trimesh.creation.cylinder(0.04, 0.3))
    points, normals = scan(full, EYE)
    side = np.abs(normals @ POSE[:3, 2]) < 0.3  # a trunk shows no ends
    points, normals = points[side], normals[side]
    found = fit_cylinder(points, normals if with_normals else None, EYE)
    assert found.converged and found.residual < 2e-3
    assert found.prior.radius == pytest.approx(0.04, rel=0.03)
    T = np.asarray(found.prior.T_world_object)
    assert abs(T[:3, 2] @ POSE[:3, 2]) > np.cos(0.03)
    offset = T[:3, 3] - POSE[:3, 3]
    assert np.linalg.norm(offset - (offset @ POSE[:3, 2]) * POSE[:3, 2]) < 2e-3


def test_planes_face_the_viewer():
    rng = np.random.default_rng(0)
    points = (
        np.column_stack([rng.uniform(-1, 1, (50, 2)), 1e-3 * rng.standard_normal(50)]) @ POSE[:3, :3].T + POSE[:3, 3]
    )
    normal = POSE[:3, 2]
    for side in (1.0, -1.0):
        for arguments in ((None, POSE[:3, 3] + side * normal), (np.tile(side * normal, (50, 1)), None)):
            found = fit_plane(points, *arguments)
            np.testing.assert_allclose(found.prior.normal, side * normal, atol=2e-3)
            assert found.residual == pytest.approx(1e-3, rel=0.3) and found.converged


def test_flat_points_make_no_sphere():
    grid = np.column_stack([*np.mgrid[-1:1:9j, -1:1:9j].reshape(2, -1), np.zeros(81)])
    for fit in (fit_sphere, fit_cylinder):
        found = fit(grid, np.tile([0.0, 0.0, 1.0], (81, 1)), (0.0, 0.0, 3.0))
        assert not found.converged and found.reason


def test_fits_are_fast_enough_for_a_planner():
    points, normals = scan(trimesh.creation.box((0.06, 0.1, 0.08)), EYE)
    times = []
    for _ in range(5):
        start = time.perf_counter()
        fit_ellipsoid(points, normals, EYE)
        times.append(time.perf_counter() - start)
    assert min(times) < 0.02


def test_least_squares_finds_a_known_minimum_and_says_when_it_does_not():
    def rosenbrock(theta):
        return np.column_stack([10 * (theta[:, 1] - theta[:, 0] ** 2), 1 - theta[:, 0]])

    found = levenberg_marquardt(rosenbrock, np.array([-1.2, 1.0]), iterations=100)
    np.testing.assert_allclose(found.x, 1.0, atol=1e-4)
    assert found.converged and not levenberg_marquardt(rosenbrock, np.array([-1.2, 1.0]), iterations=3).converged


LINE = np.linspace(0.0, 1.0, 20)[:, None] * [1.0, 2.0, 3.0]


@pytest.mark.parametrize("fit", [fit_ellipsoid, fit_sphere, fit_cylinder, fit_plane])
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((LINE,), "points: expected points that span a surface"),
        ((np.ones((10, 3)),), "points: expected points that span a surface"),
        ((LINE[:2],), r"points: expected shape \(N, 3\) with N ≥"),
        ((LINE[:, :2],), r"points: expected shape \(N, 3\)"),
        ((np.where(LINE > 2, np.nan, LINE),), "points: expected finite"),
        ((LINE, LINE), "normals: expected unit length"),
        ((scan(apple())[0], None, (np.nan, 0.0, 0.0)), "viewpoint"),
        ((scan(apple())[0], None, (0.0, 0.0)), "viewpoint"),
    ],
)
def test_bad_input_is_named(fit, arguments, message):
    with pytest.raises(ValueError, match=message):
        fit(*arguments)


def test_the_ratio_of_axes_is_bounded():
    points, normals = scan(trimesh.creation.box((0.02, 0.02, 0.3)))
    found = fit_ellipsoid(points, normals, max_ratio=3.0)
    assert max(found.prior.axes) / min(found.prior.axes) == pytest.approx(3.0) and "bounded" in found.reason
    with pytest.raises(ValueError, match="max_ratio"):
        fit_ellipsoid(points, max_ratio=0.5)
