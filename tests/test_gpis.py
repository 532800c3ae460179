"""Implicit surfaces: against a dense textbook process, scikit-learn, finite differences, and in what they refuse."""

from itertools import product

import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel
from sklearn.gaussian_process.kernels import Matern as SklearnMatern

from aerograsp_env.spatial import se3_exp
from baselines.objects import (
    GPIS,
    Brownian,
    Constant,
    Cylinder,
    Ellipsoid,
    FinitePlane,
    Matern52,
    Periodic,
    Plane,
    Posed,
    SmoothUnion,
    Sphere,
    SquaredExponential,
    ThinPlate,
    gpis,
    posterior,
)

POSE = se3_exp([0.02, -0.01, 0.03, 0.4, -0.7, 1.1])
SPATIAL = [SquaredExponential(0.07, 0.8), Matern52(0.09, 1.3), ThinPlate(0.7, 2.0)]
PRIORS = {
    "constant": Constant(0.3),
    "sphere": Sphere(0.1),
    "sphere-posed": Sphere(0.09, T_world_object=POSE),
    "ellipsoid": Ellipsoid(axes=(0.12, 0.1, 0.08), T_world_object=POSE),
    "cylinder": Cylinder(0.1, T_world_object=POSE),
    "plane": Plane((0.6, 0.0, 0.8), 0.05),
    "plane-posed": Posed(Plane(), POSE),
    "plate": FinitePlane((0.1, 0.06), 0.04, T_world_object=POSE),
    "union": SmoothUnion([Sphere(0.08), Posed(Cylinder(0.03), POSE)], 0.01),
    "union-posed": Posed(SmoothUnion([Sphere(0.08), Plane(offset=0.02)], 0.02), POSE),
}


def named(kernel):
    return type(kernel).__name__


def seen(count=25, seed=0):
    """Points on half a sphere of 0.1 m with slightly turned normals, and queries in and around it."""
    rng = np.random.default_rng(seed)
    normals = rng.standard_normal((count, 3))
    normals[:, 2] = np.abs(normals[:, 2])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    turned = normals + 0.05 * rng.standard_normal(normals.shape)
    return 0.1 * normals, turned / np.linalg.norm(turned, axis=1, keepdims=True), rng.uniform(-0.15, 0.15, (30, 3))


# --- the textbook: one entry at a time, from φ, φ' and φ'' ------------------------------------------------------------


def radial(kernel, d):
    """φ, φ' and φ'' of an isotropic kernel at d."""
    if isinstance(kernel, SquaredExponential):
        s, t = kernel.variance * np.exp(-(d**2) / (2 * kernel.length_scale**2)), kernel.length_scale**2
        return s, -s * d / t, s * (d**2 / t**2 - 1 / t)
    if isinstance(kernel, Matern52):
        c = np.sqrt(5) / kernel.length_scale
        e = kernel.variance * np.exp(-c * d)
        return (
            e * (1 + c * d + (c * d) ** 2 / 3),
            -e * c**2 * d * (1 + c * d) / 3,
            e * c**2 * ((c * d) ** 2 - c * d - 1) / 3,
        )
    R, s = kernel.radius, kernel.variance
    return s * (2 * d**3 - 3 * R * d**2 + R**3), s * (6 * d**2 - 6 * R * d), s * (12 * d - 6 * R)


def textbook_block(kernel, x, y):
    """(1 + D, 1 + D) covariance of (f, ∂f)(x) with (f, ∂f)(y), x and y (D,)."""
    D = len(x)
    block = np.empty((1 + D, 1 + D))
    if isinstance(kernel, Periodic):
        u, w = float(x[0] - y[0]), kernel.length_scale**-2
        k = kernel.variance * np.exp(-2 * w * np.sin(u / 2) ** 2)
        return np.array([[k, k * w * np.sin(u)], [-k * w * np.sin(u), k * (w * np.cos(u) - w**2 * np.sin(u) ** 2)]])
    d = np.sqrt(((x - y) ** 2).sum())
    value, first, second = radial(kernel, d)
    u = (x - y) / d if d > 0 else np.zeros(D)
    transverse = first / d if d > 0 else second
    block[0, 0] = value
    block[0, 1:], block[1:, 0] = -first * u, first * u
    block[1:, 1:] = -(second * np.outer(u, u) + transverse * (np.eye(D) - np.outer(u, u)))
    return block


def textbook_gram(kernel, x, y):
    """All blocks, point by point: (N(1 + D), M(1 + D)), interleaved unlike the implementation."""
    return np.block([[textbook_block(kernel, a, b) for b in y] for a in x])


def textbook(kernel, prior, points, normals, sigma, sigma_normal, x):
    """Mean (M,), gradient (M, D) and joint covariance (values, then gradients) by inverting the whole matrix."""
    N, D = points.shape
    keep = np.ones((N, 1 + D), dtype=bool)
    targets = np.zeros((N, 1 + D))
    targets[:, 0] -= prior.value(points)
    if normals is None:
        keep[:, 1:] = False
    else:
        targets[:, 1:] = normals - prior.gradient(points)
    noise = np.column_stack([np.broadcast_to(sigma, N), np.full((N, D), sigma_normal)]) ** 2
    keep = keep.ravel()
    K = (textbook_gram(kernel, points, points) + np.diag(noise.ravel()))[np.ix_(keep, keep)]
    k = textbook_gram(kernel, x, points)[:, keep]
    moments = (k @ np.linalg.solve(K, targets.ravel()[keep])).reshape(len(x), 1 + D)
    covariance = textbook_gram(kernel, x, x) - k @ np.linalg.solve(K, k.T)
    rows = np.arange(len(covariance)).reshape(len(x), 1 + D)
    order = np.concatenate([rows[:, 0], rows[:, 1:].ravel()])
    return prior.value(x) + moments[:, 0], prior.gradient(x) + moments[:, 1:], covariance[np.ix_(order, order)]


@pytest.mark.parametrize("with_normals", [False, True], ids=["values", "normals"])
@pytest.mark.parametrize(
    ("kernel", "prior"),
    list(product(SPATIAL, PRIORS)),
    ids=lambda value: value if isinstance(value, str) else named(value),
)
def test_equals_the_dense_textbook(kernel, prior, with_normals, monkeypatch):
    for module in (gpis, posterior):
        monkeypatch.setattr(module, "CHUNK_ENTRIES", 1000)  # so that the queries come in several chunks
    points, normals, x = seen(12)
    normals = normals if with_normals else None
    sigma = np.linspace(0.01, 0.03, len(points))
    model = GPIS(kernel, PRIORS[prior], normal_noise=0.07).fit(points, normals, noise=sigma)
    got = model.predict(x, gradient=True, variance=True)
    mean, gradient, covariance = textbook(kernel, PRIORS[prior], points, normals, sigma, 0.07, x)
    assert model.jitter == 0.0
    np.testing.assert_allclose(got.mean, mean, rtol=0, atol=1e-8)
    np.testing.assert_allclose(got.gradient, gradient, rtol=0, atol=1e-8)
    np.testing.assert_allclose(got.variance, np.diag(covariance)[: len(x)], rtol=0, atol=1e-8)


@pytest.mark.parametrize("with_normals", [False, True], ids=["values", "normals"])
@pytest.mark.parametrize("kernel", SPATIAL, ids=named)
def test_joint_covariances_equal_the_dense_textbook(kernel, with_normals, monkeypatch):
    monkeypatch.setattr(posterior, "CHUNK_ENTRIES", 1000)
    points, normals, x = seen(12)
    normals, pairs = normals if with_normals else None, x.reshape(3, 5, 2, 3)
    model = GPIS(kernel, PRIORS["sphere"], 0.02, 0.07).fit(points, normals)
    got = model.covariance(pairs, gradients=True)
    assert got.shape == (3, 5, 8, 8)
    for index in np.ndindex(3, 5):
        _, _, covariance = textbook(kernel, PRIORS["sphere"], points, normals, 0.02, 0.07, pairs[index])
        np.testing.assert_allclose(got[index], covariance, rtol=0, atol=1e-8 * max(1.0, np.abs(covariance).max()))
    np.testing.assert_allclose(model.covariance(pairs), got[..., :2, :2], rtol=0, atol=1e-12)
    np.testing.assert_allclose(model.covariance(x)[4:6, 4:6], got[0, 2, :2, :2], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(model.observations.points, points)
    assert model.covariance(np.empty((0, 2, 3)), gradients=True).shape == (0, 8, 8)


@pytest.mark.parametrize("slopes", [None, np.array([[1.0], [-1.0], [1.0], [1.0]])], ids=["values", "normals"])
def test_periodic_process_equals_the_textbook(slopes):
    points, x = np.array([[0.1], [1.7], [3.0], [5.2]]), np.linspace(-4.0, 9.0, 17)[:, None]
    kernel, prior = Periodic(0.8, 1.4), Constant(0.2)
    got = GPIS(kernel, prior, 0.02, 0.05).fit(points, slopes).predict(x, gradient=True, variance=True)
    mean, gradient, covariance = textbook(kernel, prior, points, slopes, 0.02, 0.05, x)
    np.testing.assert_allclose(got.mean, mean, rtol=0, atol=1e-8)
    np.testing.assert_allclose(got.gradient, gradient, rtol=0, atol=1e-8)
    np.testing.assert_allclose(got.variance, np.diag(covariance)[: len(x)], rtol=0, atol=1e-8)
    model = GPIS(kernel, prior, 0.02, 0.05).fit(points, slopes)
    np.testing.assert_allclose(model.covariance(x, gradients=True), covariance, rtol=0, atol=1e-8)


def test_brownian_bridge_has_its_known_variance():
    # Tied to the level at 0 (by the kernel) and at 1 (by the data): var f(x) = x (1 − x).
    x = np.linspace(0.0, 1.0, 11)[:, None]
    got = GPIS(Brownian(), Constant(0.5), noise=0.0).fit([[1.0]]).predict(x, variance=True)
    np.testing.assert_allclose(got.variance, x[:, 0] * (1 - x[:, 0]), atol=1e-12)
    np.testing.assert_allclose(got.mean, 0.5 * (1 - x[:, 0]), atol=1e-12)


@pytest.mark.parametrize(
    ("kernel", "theirs"),
    [(SPATIAL[0], ConstantKernel(0.8) * RBF(0.07)), (SPATIAL[1], ConstantKernel(1.3) * SklearnMatern(0.09, nu=2.5))],
    ids=["squared-exponential", "matern"],
)
def test_values_only_equal_scikit_learn(kernel, theirs):
    points, _, x = seen(40)
    prior, sigma = Ellipsoid((0.12, 0.1, 0.08)), np.linspace(0.01, 0.05, 40)
    model = GPIS(kernel, prior).fit(points, noise=sigma)
    regressor = GaussianProcessRegressor(theirs, alpha=sigma**2, optimizer=None).fit(points, -prior.value(points))
    mean, deviation = regressor.predict(x, return_std=True)
    got = model.predict(x, variance=True)
    assert got.gradient is None
    np.testing.assert_allclose(got.mean, prior.value(x) + mean, rtol=0, atol=1e-8)
    np.testing.assert_allclose(got.variance, deviation**2, rtol=0, atol=1e-8)
    assert model.log_marginal_likelihood() == pytest.approx(regressor.log_marginal_likelihood_value_, rel=1e-9)


@pytest.mark.parametrize("with_normals", [False, True], ids=["values", "normals"])
def test_samples_have_the_posterior_mean_and_covariance(with_normals):
    points, normals, x = seen(12)
    x, normals, count = x[:6], normals if with_normals else None, 40_000
    kernel, prior = SPATIAL[0], PRIORS["ellipsoid"]
    model = GPIS(kernel, prior, 0.02, 0.1).fit(points, normals)
    draws = model.sample(x, count, np.random.default_rng(1))
    mean, _, joint = textbook(kernel, prior, points, normals, 0.02, 0.1, x)
    covariance = joint[:6, :6]
    assert draws.shape == (count, 6)
    spread = np.diag(covariance)
    assert (np.abs(draws.mean(axis=0) - mean) < 5 * np.sqrt(spread / count)).all()
    # The standard error of a sample covariance of normal variables.
    error = np.sqrt((np.outer(spread, spread) + covariance**2) / count)
    assert (np.abs(np.cov(draws.T) - covariance) < 5 * error).all()
    again = model.sample(x, 3, np.random.default_rng(1))
    np.testing.assert_array_equal(again, model.sample(x, 3, np.random.default_rng(1)))


def test_samples_at_the_data_reproduce_it():
    points, _, _ = seen(12)
    draws = GPIS(SPATIAL[0], Sphere(0.08), noise=0.0).fit(points).sample(points, 5, np.random.default_rng(0))
    np.testing.assert_allclose(draws, 0.0, atol=1e-5)
    model = GPIS(SPATIAL[0]).fit(points)
    assert model.sample(np.empty((0, 3)), 4, np.random.default_rng(0)).shape == (4, 0)
    assert model.predict(np.empty((0, 3)), True, True).gradient.shape == (0, 3)


# --- derivatives ------------------------------------------------------------------------------------------------------


def difference(function, x, h):
    """Central differences of function (N, D) -> (N, ...) in the coordinates of x: (N, ..., D)."""
    steps = h * np.eye(x.shape[1])
    return np.stack([(function(x + step) - function(x - step)) / (2 * h) for step in steps], axis=-1)


@pytest.mark.parametrize("kernel", [*SPATIAL, Periodic(0.8, 1.4)], ids=named)
def test_kernel_derivatives_equal_finite_differences(kernel):
    rng = np.random.default_rng(3)
    x, y = rng.uniform(-0.1, 0.1, (2, 7, kernel.dimension or 3))
    h = 1e-6
    by_y = np.moveaxis(difference(lambda p: kernel.value(x, p).T, y, h), 0, 1)
    np.testing.assert_allclose(kernel.gradient(x, y), by_y, rtol=1e-6, atol=1e-7)
    by_both = np.swapaxes(difference(lambda p: kernel.gradient(p, y), x, h), -1, -2)
    np.testing.assert_allclose(kernel.hessian(x, y), by_both, rtol=1e-6, atol=1e-5)


@pytest.mark.parametrize("kernel", [*SPATIAL, Periodic(0.8, 1.4)], ids=named)
def test_kernel_diagonals_and_symmetry(kernel):
    x, y = np.random.default_rng(4).uniform(-0.1, 0.1, (2, 6, kernel.dimension or 3))
    np.testing.assert_allclose(kernel.diagonal(x), np.diag(kernel.value(x, x)))
    np.testing.assert_allclose(kernel.gradient_diagonal(x), np.einsum("nnii->ni", kernel.hessian(x, x)))
    np.testing.assert_allclose(kernel.value(x, y), kernel.value(y, x).T)
    np.testing.assert_allclose(kernel.gradient(x, y), -kernel.gradient(y, x).transpose(1, 0, 2), atol=1e-12)
    np.testing.assert_allclose(kernel.hessian(x, y), kernel.hessian(y, x).transpose(1, 0, 3, 2))


@pytest.mark.parametrize("prior", PRIORS.values(), ids=PRIORS)
def test_prior_gradients_equal_finite_differences(prior):
    x = np.random.default_rng(5).uniform(-0.15, 0.15, (50, 3))
    np.testing.assert_allclose(prior.gradient(x), difference(prior.value, x, 1e-7), atol=1e-6)


def test_mean_gradient_is_the_slope_of_the_mean():
    points, normals, x = seen()
    model = GPIS(SPATIAL[1], PRIORS["union"]).fit(points, normals)
    slope = difference(lambda p: model.predict(p).mean, x, 1e-6)
    np.testing.assert_allclose(model.predict(x, gradient=True).gradient, slope, atol=1e-6)


@pytest.mark.parametrize(
    ("prior", "inside", "on", "outward"),
    [
        (Sphere(0.1), [0, 0, 0], [0, 0.1, 0], [0, 1, 0]),
        (Ellipsoid((0.1, 0.1, 0.1)), [0, 0, 0], [0, 0.1, 0], [0, 1, 0]),
        (Cylinder(0.1), [0, 0, 5], [0.1, 0, -3], [1, 0, 0]),
        (Plane((0, 0, 1), 0.2), [0, 0, 0], [1, 1, 0.2], [0, 0, 1]),
        (FinitePlane((0.4, 0.2), 0.1), [0.1, 0, 0], [0.1, 0.05, -0.05], [0, 0, -1]),
        (FinitePlane((0.4, 0.2), 0.1), [0.1, 0, 0], [0.25, 0.05, 0], [1, 0, 0]),
    ],
)
def test_shapes_are_negative_inside_with_unit_outward_gradients(prior, inside, on, outward):
    T = POSE if not isinstance(prior, Plane) else np.eye(4)
    posed = Posed(prior, T)
    moved_inside, moved_on = (T[:3, :3] @ np.asarray(p, dtype=float) + T[:3, 3] for p in (inside, on))
    assert posed.value(moved_inside[None])[0] < 0
    assert posed.value(moved_on[None])[0] == pytest.approx(0, abs=1e-12)
    np.testing.assert_allclose(posed.gradient(moved_on[None])[0], T[:3, :3] @ outward, atol=1e-12)


def test_smooth_union_lies_just_below_the_least_part():
    x = np.random.default_rng(6).uniform(-0.3, 0.3, (200, 3))
    parts = [Sphere(0.1), Sphere(0.1, T_world_object=POSE), Plane(offset=-0.1)]
    gap = np.min([part.value(x) for part in parts], axis=0) - SmoothUnion(parts, 0.01).value(x)
    assert (gap >= -1e-12).all() and (gap <= 0.01 * np.log(3) + 1e-12).all()


# --- conditioning on data ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kernel", SPATIAL, ids=named)
def test_interpolates_exact_data(kernel):
    points, normals, _ = seen(15)
    got = GPIS(kernel, Sphere(0.08), noise=0.0, normal_noise=0.0).fit(points, normals).predict(points, True, True)
    np.testing.assert_allclose(got.mean, 0.0, atol=1e-8)
    np.testing.assert_allclose(got.gradient, normals, atol=1e-6)
    np.testing.assert_allclose(got.variance, 0.0, atol=1e-8)


def test_the_prior_rules_far_from_the_data():
    points, normals, _ = seen()
    kernel, prior, far = SquaredExponential(0.02, 0.5), Ellipsoid((0.1, 0.2, 0.3)), np.array([[3.0, -2.0, 4.0]])
    got = GPIS(kernel, prior).fit(points, normals).predict(far, True, True)
    np.testing.assert_allclose(got.mean, prior.value(far))
    np.testing.assert_allclose(got.gradient, prior.gradient(far))
    np.testing.assert_allclose(got.variance, 0.5)


def test_jitter_comes_only_after_a_failure_and_is_reported():
    points, _, _ = seen(200)
    sound = GPIS(SquaredExponential(0.05), noise=1e-2).fit(points)
    assert sound.jitter == 0.0
    gram = sound.kernel.value(points, points) + 1e-4 * np.eye(200)
    assert 0.3 < sound.condition / np.linalg.cond(gram, 1) <= 1.0 + 1e-9  # LAPACK's estimate is from below
    singular = GPIS(SquaredExponential(5.0), noise=0.0).fit(points)
    assert 0.0 < singular.jitter <= 1e-6 and singular.condition > 1e8
    with pytest.raises(ValueError, match="singular even with jitter"):
        gpis.factorise(np.array([[1.0, 2.0], [2.0, 1.0]]))


# --- bad input --------------------------------------------------------------------------------------------------------

POINTS, NORMALS, _ = seen(4)
NAN = np.where(np.eye(4, 3) > 0, np.nan, POINTS)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"points": np.empty((0, 3))}, "points: expected at least one, got none"),
        ({"points": POINTS[0]}, r"points: expected shape \(N, D\), got \(3,\)"),
        ({"points": POINTS[:, :2]}, r"points: expected shape \(N, 3\), got \(4, 2\)"),
        ({"points": NAN}, "points: expected finite values, got .* in row 0"),
        ({"points": POINTS[[0, 1, 1]], "noise": 0.0}, r"points: expected distinct .* 1 duplicate"),
        ({"points": POINTS, "normals": NORMALS[:2]}, r"normals: expected shape \(4, 3\)"),
        ({"points": POINTS, "normals": 0.0 * NORMALS}, "normals: expected unit length .* got 0 in row 0"),
        ({"points": POINTS, "normals": 1.01 * NORMALS}, "normals: expected unit length .* got 1.01 in row 0"),
        ({"points": POINTS, "normals": NAN}, "normals: expected finite values"),
        ({"points": POINTS, "noise": -0.1}, "noise: expected standard deviations ≥ 0, got -0.1"),
        ({"points": POINTS, "noise": [0.1, 0.1, np.nan, 0.1]}, "noise: expected standard deviations ≥ 0, got nan"),
        ({"points": POINTS, "noise": [0.1, 0.1]}, r"noise: expected one number or shape \(4,\)"),
    ],
)
def test_bad_observations_are_named_and_leave_the_model_as_it_was(arguments, message):
    model = GPIS(SPATIAL[0], Sphere(0.1)).fit(POINTS, NORMALS)
    before = model.predict(POINTS).mean
    with pytest.raises(ValueError, match=message):
        model.fit(**arguments)
    np.testing.assert_array_equal(model.predict(POINTS).mean, before)


def test_duplicates_with_noise_are_taken():
    assert GPIS(SPATIAL[0], noise=0.01).fit(POINTS[[0, 1, 1]]).jitter == 0.0
    with pytest.raises(ValueError, match="duplicate"):
        GPIS(SPATIAL[0], normal_noise=0.0).fit(POINTS[[0, 1, 1]], NORMALS[[0, 1, 1]])


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: SquaredExponential(0.0), "length_scale"),
        (lambda: Matern52(0.1, -1.0), "variance"),
        (lambda: ThinPlate(np.nan), "radius"),
        (lambda: Sphere(-0.1), "radius"),
        (lambda: Ellipsoid((0.1, 0.0, 0.1)), "axes"),
        (lambda: Plane((0, 0, 2)), "normal"),
        (lambda: FinitePlane((0.1, 0.1), 0.0), "thickness"),
        (lambda: SmoothUnion([], 0.1), "parts"),
        (lambda: Sphere(0.1, T_world_object=np.diag([1, 1, -1, 1])), "T_world_object"),
        (lambda: GPIS(SPATIAL[0], noise=-1.0), "noise"),
        (lambda: GPIS(SPATIAL[0], normal_noise=-1.0), "normal_noise"),
        (lambda: GPIS(Periodic(1.0), Sphere(0.1)), "prior"),
        (lambda: GPIS(Brownian()).fit([[1.0]], [[1.0]]), "kernel: expected a differentiable"),
        (lambda: GPIS(Brownian()).fit([[1.0]]).predict([[1.0]], gradient=True), "kernel: expected a differentiable"),
        (lambda: GPIS(Brownian()).fit([[-1.0]]), "coordinates ≥ 0"),
        (lambda: GPIS(ThinPlate(0.05)).fit(POINTS), "radius: expected at least the largest distance"),
        (lambda: GPIS(ThinPlate(0.5)).fit(POINTS).predict([[1.0, 0, 0]]), "radius: expected at least the largest"),
        (lambda: GPIS(SPATIAL[0]).fit(POINTS).predict([[0.0, np.nan, 0]]), "x: expected finite"),
        (lambda: GPIS(SPATIAL[0]).fit(POINTS).predict([[0.0, 0.0]]), "x: expected shape"),
        (lambda: GPIS(SPATIAL[0]).fit(POINTS).covariance(POINTS[0]), r"x: expected shape \(N, D\)"),
        (lambda: GPIS(SPATIAL[0]).fit(POINTS).covariance(POINTS[..., :2]), r"x: expected shape \(N, 3\)"),
        (lambda: GPIS(Brownian()).fit([[1.0]]).covariance([[0.5]], gradients=True), "expected a differentiable"),
        (lambda: GPIS(SPATIAL[0]).fit(POINTS).sample(POINTS, -1, np.random.default_rng()), "n: expected"),
    ],
)
def test_bad_parameters_are_named(build, message):
    with pytest.raises(ValueError, match=message):
        build()


def test_an_unfitted_model_says_so():
    with pytest.raises(RuntimeError, match=r"call fit\(points\) first"):
        GPIS(SPATIAL[0]).predict(POINTS)


def test_values_are_printable_and_frozen():
    assert repr(SPATIAL[0]) == "SquaredExponential(length_scale=0.07, variance=0.8)"
    assert "4 points" in repr(GPIS(SPATIAL[0], Constant(0.1)).fit(POINTS))
    with pytest.raises(AttributeError):
        SPATIAL[0].variance = 2.0
