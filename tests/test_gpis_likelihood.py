"""The marginal likelihood's gradient against finite differences, and what optimising it finds and refuses."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from baselines.objects import (
    GPIS,
    Brownian,
    Constant,
    Matern52,
    Periodic,
    Sphere,
    SquaredExponential,
    ThinPlate,
)
from baselines.objects.likelihood import evidence, scaled
from baselines.objects.observations import check_observations

SPATIAL = [SquaredExponential(0.07, 0.8), Matern52(0.09, 1.3), ThinPlate(0.7, 2.0)]


def sphere(count, seed=0, radius=0.1, noise=0.0):
    rng = np.random.default_rng(seed)
    normals = rng.standard_normal((count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return (radius + noise * rng.standard_normal((count, 1))) * normals, normals


def line(count, dimension_one_normals, seed=0):
    rng = np.random.default_rng(seed)
    points = np.sort(rng.uniform(0.1, 5.0, (count, 1)), axis=0)
    return points, rng.choice([-1.0, 1.0], (count, 1)) if dimension_one_normals else None


def problems():
    for kernel in SPATIAL:
        for with_normals in (False, True):
            points, normals = sphere(14)
            yield pytest.param(kernel, points, normals if with_normals else None, id=f"{kernel}-{with_normals}")
    for with_normals in (False, True):
        yield pytest.param(Periodic(0.8, 1.4), *line(6, with_normals), id=f"periodic-{with_normals}")
    yield pytest.param(Brownian(0.7), *line(9, False), id="brownian")


@pytest.mark.parametrize(("kernel", "points", "normals"), list(problems()))
def test_gradient_equals_finite_differences_and_the_value_a_normal_density(kernel, points, normals):
    rng = np.random.default_rng(1)
    noise = rng.uniform(0.05, 0.15, len(points))
    data = check_observations(points, normals, noise, 0.2)
    residual = rng.standard_normal(len(data.deviations))
    found = evidence(kernel, data, residual)
    covariance = kernel.gram(points, normals is not None) + np.diag(data.deviations**2)
    density = multivariate_normal(np.zeros(len(residual)), covariance).logpdf(residual)
    assert found.value == pytest.approx(density, rel=1e-9)
    assert set(found.gradient) == {*kernel.parameters, "noise", *(["normal_noise"] if normals is not None else [])}
    h = 1e-5

    def at(name, step):
        if name in kernel.parameters:
            moved = replace(kernel, **{name: kernel.parameters[name] * np.exp(step)})
            return evidence(moved, data, residual).value
        factors = {"noise": 1.0, "normal_noise": 1.0, name: np.exp(step)}
        return evidence(kernel, scaled(data, **factors), residual).value

    for name, slope in found.gradient.items():
        assert slope == pytest.approx((at(name, h) - at(name, -h)) / (2 * h), rel=2e-6, abs=1e-5), name


def test_recovers_the_parameters_that_made_the_data():
    # Many independent draws on a line are the cheapest way to much information on the parameters.
    rng = np.random.default_rng(2)
    points = np.linspace(0.0, 60.0, 300)[:, None]
    truth, sigma = SquaredExponential(0.7, 1.5), 0.1
    covariance = truth.value(points, points) + sigma**2 * np.eye(300)
    draw = np.linalg.cholesky(covariance) @ rng.standard_normal(300)

    class Drawn(Constant):
        def value(self, x):
            return np.interp(x[:, 0], points[:, 0], -draw)

    found = GPIS(SquaredExponential(2.0, 0.3), Drawn(), noise=0.5).fit(points).optimize()
    assert found.converged and found.active == () and found.after > found.before
    assert found.model.kernel.length_scale == pytest.approx(0.7, rel=0.1)
    assert found.model.kernel.variance == pytest.approx(1.5, rel=0.5)
    assert found.model.noise == pytest.approx(0.1, rel=0.2)


def test_optimising_leaves_the_model_and_keeps_proportions_of_noise():
    points, normals = sphere(40, noise=0.002)
    model = GPIS(SquaredExponential(0.05), Sphere(0.09), noise=0.01, normal_noise=0.05)
    model.fit(points, normals, noise=np.linspace(0.005, 0.02, 40))
    before = model.predict(points[:5]).mean
    found = model.optimize()
    np.testing.assert_array_equal(model.predict(points[:5]).mean, before)
    assert (model.kernel, model.noise) == (SquaredExponential(0.05), 0.01)
    assert found.before == model.log_marginal_likelihood() < found.after == found.model.log_marginal_likelihood()
    factor = found.model.noise / 0.01
    again = GPIS(found.model.kernel, Sphere(0.09), normal_noise=found.model.normal_noise)
    again.fit(points, normals, noise=factor * np.linspace(0.005, 0.02, 40))
    assert again.log_marginal_likelihood() == pytest.approx(found.after)


def test_bounds_hold_and_are_reported_and_fixed_parameters_stay():
    points, normals = sphere(30)
    model = GPIS(Matern52(0.05, 0.1), Sphere(0.08), noise=0.01).fit(points, normals)
    found = model.optimize(bounds={"length_scale": (0.04, 0.06)}, fixed=("variance", "noise", "normal_noise"))
    assert found.active == ("length_scale",) and found.model.kernel.length_scale == pytest.approx(0.06)
    assert found.model.noise == 0.01 and found.model.normal_noise == 0.05


def test_exact_data_stays_exact_and_restarts_never_do_worse():
    points, _ = sphere(20)
    model = GPIS(SquaredExponential(0.03, 0.01), Sphere(0.08), noise=0.0).fit(points)
    single = model.optimize(bounds={"length_scale": (0.01, 0.1)})
    many = model.optimize(bounds={"length_scale": (0.01, 0.1)}, restarts=3, rng=np.random.default_rng(0))
    assert single.model.noise == 0.0 and many.after >= single.after and many.evaluations > single.evaluations


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"bounds": {"radius": (0.1, 1.0)}}, r"bounds: expected names among .*'length_scale'.* got \['radius'\]"),
        ({"fixed": ("sigma",)}, "fixed: expected names"),
        ({"fixed": ("length_scale", "variance", "noise")}, "at least one"),
        ({"bounds": {"variance": (2.0, 3.0)}}, "bounds: expected 0 < low ≤ 1"),
        ({"restarts": 2}, "restarts: expected .* generator"),
    ],
)
def test_bad_arguments_are_named(arguments, message):
    model = GPIS(SquaredExponential(0.05)).fit(sphere(5)[0])
    with pytest.raises(ValueError, match=message):
        model.optimize(**arguments)


def test_noise_of_each_normal():
    points, normals = sphere(6)
    model = GPIS(SPATIAL[0], Constant(0.1))
    one = model.fit(points, normals, normal_noise=0.1).predict(points * 0.5, variance=True)
    each = model.fit(points, normals, normal_noise=np.full(6, 0.1)).predict(points * 0.5, variance=True)
    np.testing.assert_array_equal(one.variance, each.variance)
    flipped = np.vstack([normals[:5], -normals[5:]])  # one wrong normal, known to be no good
    loose = model.fit(points, flipped, normal_noise=[0.1] * 5 + [1e6]).predict(points, gradient=True).gradient
    np.testing.assert_allclose(loose, normals, atol=0.1)
    with pytest.raises(ValueError, match=r"normal_noise: expected one number or shape \(6,\)"):
        model.fit(points, normals, normal_noise=[0.1, 0.2])
