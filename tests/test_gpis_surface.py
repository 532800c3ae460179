"""Surface walks and meshes: closed forms, watertightness, the shells' order, the bound, and what has no surface."""

import numpy as np
import pytest
import trimesh

from baselines.objects import GPIS, Constant, Cylinder, Ellipsoid, Plane, Sphere, SquaredExponential, SurfaceError
from baselines.objects.surface import mesh, walk


def sphere(count, seed=0, radius=0.1):
    rng = np.random.default_rng(seed)
    normals = rng.standard_normal((count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return radius * normals, normals


def fitted(prior=None, count=120, noise=1e-3):
    points, normals = sphere(count)
    return GPIS(SquaredExponential(0.08, 0.01), prior, noise=noise, normal_noise=0.05).fit(points, normals)


def is_closed(found):
    return found.is_watertight and found.is_winding_consistent and found.volume > 0.0


@pytest.mark.parametrize("prior", [Constant(0.05), Sphere(0.08)], ids=["constant", "sphere"])
def test_a_sphere_comes_back(prior):
    model = fitted(prior)
    found = model.surface(resolution=0.006)
    assert is_closed(found) and found.euler_number == 2
    assert found.volume == pytest.approx(4 / 3 * np.pi * 1e-3, rel=0.01)
    got = model.predict(np.asarray(found.vertices), gradient=True)
    assert np.abs(got.mean).max() < 0.05 * 0.006  # second order in the resolution
    # Outward: along the gradient of the mean.
    at = model.predict(found.triangles_center, gradient=True).gradient
    assert (np.einsum("ij,ij->i", at, found.face_normals) > 0.0).mean() > 0.999
    assert found.metadata["evaluated"] < 0.3 * (0.2 / 0.006) ** 3


def test_the_error_is_second_order_and_the_work_that_of_a_surface():
    exact = 4 / 3 * np.pi * 1e-3
    meshes = [mesh(walk(Sphere(0.1).value, sphere(5)[0], h, 10**6)) for h in (0.016, 0.008, 0.004)]
    errors = [abs(found.volume - exact) for found in meshes]
    assert errors[0] > 3 * errors[1] > 9 * errors[2]
    counts = [len(walk(Sphere(0.1).value, sphere(5)[0], h, 10**6).keys) for h in (0.008, 0.004)]
    assert counts[1] / counts[0] == pytest.approx(4.0, rel=0.15)


def test_shells_nest():
    model = fitted(Ellipsoid((0.11, 0.1, 0.1)), count=60, noise=2e-3)
    inner, middle, outer = (model.surface(0.01, sigma=s) for s in (-1.0, 0.0, 1.0))
    assert all(map(is_closed, (inner, middle, outer)))
    assert inner.volume < middle.volume < outer.volume
    assert middle.contains(inner.vertices).all() and outer.contains(middle.vertices).all()


def test_nodes_on_the_surface_and_several_pieces():
    # The level passes exactly through nodes of the grid: no hole, no degenerate triangle.
    seeds = np.array([[0.5, 0.5, 0.5], [-0.5, -0.5, -0.5]])
    box = mesh(walk(lambda x: np.abs(x).max(axis=1) - 0.5, seeds, 0.125))
    assert is_closed(box) and box.area_faces.min() > 0.0
    assert box.volume == pytest.approx(1.0, rel=0.05)  # the cells cut its edges

    def two(x):
        return np.minimum(np.linalg.norm(x, axis=1), np.linalg.norm(x - [1.0, 0, 0], axis=1)) - 0.2

    both = mesh(walk(two, np.array([[0.2, 0, 0], [0.8, 0, 0]]), 0.05))
    one = mesh(walk(two, np.array([[0.2, 0, 0]]), 0.05))
    assert (both.body_count, one.body_count) == (2, 1) and is_closed(both)
    torus = mesh(
        walk(lambda x: np.hypot(np.hypot(x[:, 0], x[:, 1]) - 0.3, x[:, 2]) - 0.1, np.array([[0.4, 0, 0]]), 0.03)
    )
    assert is_closed(torus) and torus.euler_number == 0
    assert torus.volume == pytest.approx(2 * np.pi**2 * 0.3 * 0.01, rel=0.03)


def test_surfaces_without_an_end_or_that_do_not_exist_say_so():
    points, _ = sphere(20)
    endless = GPIS(SquaredExponential(0.03, 1e-4), Cylinder(0.1)).fit(0.1 * np.eye(3)[:2], np.eye(3)[:2])
    with pytest.raises(SurfaceError, match=r"at most 3000 cells.*may be open"):
        endless.surface(0.01, max_cells=3000)
    plane = GPIS(SquaredExponential(0.05, 1e-4), Plane()).fit([[0.0, 0, 0]], [[0.0, 0, 1]])
    with pytest.raises(SurfaceError, match="may be open"):
        plane.surface(0.01, max_cells=3000)
    nowhere = GPIS(SquaredExponential(0.01, 1e-6), Constant(1.0), noise=0.5).fit(points)
    with pytest.raises(SurfaceError, match=r"within 3 cells .* got none"):
        nowhere.surface(0.01)


@pytest.mark.parametrize("resolution", [0.0, -0.1, np.nan, np.inf])
def test_bad_resolutions_are_named(resolution):
    with pytest.raises(ValueError, match="resolution: expected a positive length"):
        fitted().surface(resolution)


def test_surfaces_need_space_and_data():
    with pytest.raises(ValueError, match="points in space"):
        GPIS(SquaredExponential(0.1)).fit([[0.0, 1.0]]).surface(0.1)
    with pytest.raises(RuntimeError, match="call fit"):
        GPIS(SquaredExponential(0.1)).surface(0.1)


def test_the_mesh_is_a_trimesh():
    assert isinstance(fitted().surface(0.02), trimesh.Trimesh)
