"""The three filters: against a textbook Kalman filter, for consistency, and in what they refuse."""

import dataclasses

import filterpy.monte_carlo
import numpy as np
import pytest
from scipy.stats import chi2

from baselines.filtering import (
    Belief,
    ExtendedKalmanFilter,
    Model,
    ParticleBelief,
    ParticleFilter,
    UnscentedKalmanFilter,
    constant_velocity_model,
    numeric_jacobian,
)
from baselines.filtering.particle import systematic_resample

DT = 0.1
LINEAR = constant_velocity_model(acceleration_noise=[0.4, 0.7], measurement_noise=0.2, axes=2)
START = (np.array([1.0, -2.0, 0.5, 0.3]), np.diag([0.5, 0.6, 0.2, 0.3]) + 0.05)


def particle(model, seed=0, **kwargs):
    return ParticleFilter(model, rng=np.random.default_rng(seed), **kwargs)


FILTERS = pytest.mark.parametrize("make", [ExtendedKalmanFilter, UnscentedKalmanFilter, particle])
KALMAN = pytest.mark.parametrize("make", [ExtendedKalmanFilter, UnscentedKalmanFilter])


def textbook(x, P, zs, us, q, r, dt):
    """Kalman 1960 as textbooks have it, for a 2-D constant-velocity point, written without the library."""
    F, G, Q = np.eye(4), np.zeros((4, 2)), np.zeros((4, 4))
    for axis in range(2):
        p, v = axis, axis + 2
        F[p, v], G[p, axis], G[v, axis] = dt, dt**2 / 2, dt
        Q[p, p], Q[p, v], Q[v, p], Q[v, v] = np.array([dt**3 / 3, dt**2 / 2, dt**2 / 2, dt]) * q[axis] ** 2
    H, R = np.eye(2, 4), r**2 * np.eye(2)
    for z, u in zip(zs, us, strict=True):
        x, P = F @ x + G @ u, F @ P @ F.T + Q
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
        x, P = x + K @ (z - H @ x), (np.eye(4) - K @ H) @ P
        yield x, P


def linear_problem(steps=50):
    rng = np.random.default_rng(3)
    return rng.normal(size=(steps, 2)) * 0.3 + np.linspace(0, 5, steps)[:, None], rng.normal(size=(steps, 2))


@KALMAN
@pytest.mark.parametrize("jacobians", ["given", "numeric"])
def test_kalman_filters_equal_the_textbook_on_a_linear_problem(make, jacobians):
    model = LINEAR
    if jacobians == "numeric":
        model = dataclasses.replace(model, transition_jacobian=None, measurement_jacobian=None)
    zs, us = linear_problem()
    kf = make(model)
    belief = kf.initial(*START)
    for z, u, (x, P) in zip(zs, us, textbook(*START, zs, us, [0.4, 0.7], 0.2, DT), strict=True):
        belief = kf.update(kf.predict(belief, DT, u), z)
        np.testing.assert_allclose(belief.mean, x, rtol=0, atol=1e-9)
        np.testing.assert_allclose(belief.covariance, P, rtol=0, atol=1e-9)


def test_particle_filter_approaches_the_textbook():
    # Data that the model explains: where particles must reach for outliers their error is not of that order.
    zs, us = [z for _, z in simulate(LINEAR, START, 30, np.random.default_rng(1))], np.zeros((30, 2))
    errors = {}
    for count in (500, 20000):
        pf = particle(LINEAR, particles=count)
        belief = pf.initial(*START)
        scaled = []
        for z, u, (x, P) in zip(zs, us, textbook(*START, zs, us, [0.4, 0.7], 0.2, DT), strict=True):
            belief = pf.update(pf.predict(belief, DT, u), z)
            # In standard deviations of the exact posterior: Monte-Carlo error is about 1/sqrt(effective N).
            scaled.append(np.abs(belief.mean - x) / np.sqrt(np.diag(P)))
        errors[count] = np.mean(scaled)
        assert np.max(scaled) < 15.0 / np.sqrt(count)
        np.testing.assert_allclose(belief.covariance, P, atol=10.0 / np.sqrt(count) * np.abs(P).max())
    assert errors[20000] < errors[500] / 3.0


def range_bearing(noise=(0.05, 0.02)):
    """A planar constant-velocity point seen from the origin: range and (wrapping) bearing."""
    linear = constant_velocity_model(acceleration_noise=0.3, measurement_noise=1.0, axes=2)

    def h(x):
        return np.stack([np.hypot(x[..., 0], x[..., 1]), np.arctan2(x[..., 1], x[..., 0])], axis=-1)

    def H(x):
        d2 = x[0] ** 2 + x[1] ** 2
        d = np.sqrt(d2)
        return np.array([[x[0] / d, x[1] / d, 0, 0], [-x[1] / d2, x[0] / d2, 0, 0]])

    def residual(z, predicted):
        difference = np.asarray(z - predicted)
        return np.stack([difference[..., 0], (difference[..., 1] + np.pi) % (2 * np.pi) - np.pi], axis=-1)

    return dataclasses.replace(
        linear, measurement=h, measurement_jacobian=H, measurement_noise=np.diag(noise) ** 2, residual=residual
    )


def simulate(model, start, steps, rng):
    mean, covariance = start
    x = rng.multivariate_normal(mean, covariance)
    for _ in range(steps):
        x = model.f(x, None, DT) + rng.multivariate_normal(np.zeros(x.size), model.Q(DT, x.size))
        yield x, model.h(x) + rng.multivariate_normal(np.zeros(model.measurement_size), model.measurement_noise)


@FILTERS
def test_errors_match_the_covariance_on_a_nonlinear_problem(make):
    """Normalised estimation error squared (Bar-Shalom et al. 2001, section 5.4), and the innovations' likewise."""
    model = range_bearing()
    start = (np.array([-4.0, 0.5, 0.6, -0.4]), np.diag([0.2, 0.2, 0.1, 0.1]) ** 2)  # passes the bearing's cut at ±π
    runs, steps = (50, 25) if make is not particle else (20, 25)
    nees, nis = np.zeros((runs, steps)), np.zeros((runs, steps))
    for i in range(runs):
        f = make(model)
        belief = f.initial(*start)
        for k, (x, z) in enumerate(simulate(model, start, steps, np.random.default_rng(100 + i))):
            belief = f.update(f.predict(belief, DT), z)
            error = x - belief.mean
            nees[i, k] = error @ np.linalg.solve(belief.covariance, error)
            nis[i, k] = belief.innovation.distance
    # Runs are independent, so the sum over runs at one time is chi-square; steps of one run are not.
    low, high = chi2.ppf([0.0005, 0.9995], 4 * runs)
    assert low < nees[:, -1].sum() < high
    assert 0.8 < nees.mean() / 4 < 1.25
    assert 0.85 < nis.mean() / 2 < 1.15


@KALMAN
def test_jacobians_of_the_nonlinear_filters_track_better_than_the_measurements(make):
    model = range_bearing(noise=(0.3, 0.1))
    start = (np.array([3.0, 1.0, 0.3, 0.3]), np.diag([0.2, 0.2, 0.1, 0.1]) ** 2)
    kf, errors, raw = make(model), [], []
    belief = kf.initial(*start)
    for x, z in simulate(model, start, 100, np.random.default_rng(5)):
        belief = kf.update(kf.predict(belief, DT), z)
        errors.append(np.linalg.norm(belief.mean[:2] - x[:2]))
        raw.append(np.linalg.norm(z[0] * np.array([np.cos(z[1]), np.sin(z[1])]) - x[:2]))
    assert np.mean(errors) < 0.6 * np.mean(raw)


def test_numeric_jacobians_equal_the_given_ones():
    model = range_bearing()
    numeric = dataclasses.replace(model, transition_jacobian=None, measurement_jacobian=None)
    rng = np.random.default_rng(6)
    for x in [*rng.normal(size=(20, 4)), np.array([-3.0, 0.0, 1.0, 1.0])]:  # the last lies on the bearing's cut
        np.testing.assert_allclose(numeric.H(x), model.H(x), atol=1e-7 / min(1.0, np.hypot(x[0], x[1])) ** 3)
        np.testing.assert_allclose(numeric.F(x, None, DT), model.F(x, None, DT), atol=1e-9)
    np.testing.assert_allclose(numeric_jacobian(lambda x: x[:1] ** 2 * x[1], [3.0, 2.0]), [[12.0, 9.0]], rtol=1e-9)


def test_constant_velocity_noise_is_that_of_a_continuous_process():
    F, Q = LINEAR.F(np.zeros(4), None, DT), LINEAR.Q(DT, 4)
    np.testing.assert_allclose(LINEAR.Q(2 * DT, 4), F @ Q @ F.T + Q, atol=1e-15)
    x, u = np.array([1.0, 2.0, 3.0, 4.0]), np.array([0.5, -1.0])
    np.testing.assert_allclose(LINEAR.f(x, u, DT), [1.3025, 2.395, 3.05, 3.9])
    np.testing.assert_allclose(LINEAR.f(LINEAR.f(x, u, DT), u, DT), LINEAR.f(x, u, 2 * DT), atol=1e-14)
    both = constant_velocity_model(0.1, [0.1, 0.1, 0.2, 0.2], axes=2, measure_velocity=True)
    np.testing.assert_allclose(both.h(x), x)


def test_unscented_transform_of_a_square_is_exact():
    """x ~ N(0, 1) gives x² the mean 1 and variance 2; a first-order filter sees neither."""
    square = Model(lambda x, u, dt: x**2, lambda x: x, lambda dt: np.zeros((1, 1)), np.eye(1))
    ukf = UnscentedKalmanFilter(square)
    belief = ukf.predict(ukf.initial([0.0], [[1.0]]), 1.0)
    np.testing.assert_allclose(belief.mean, [1.0])
    np.testing.assert_allclose(belief.covariance, [[2.0]])


@FILTERS
def test_covariance_stays_symmetric_and_psd(make):
    # Nearly exact measurements of one axis for long, and a known start: where rounding hurts most.
    model = constant_velocity_model([1e-3, 10.0], [1e-6, 10.0], axes=2)
    f = make(model)
    belief = f.initial(np.zeros(4), np.zeros((4, 4)))
    zs = np.random.default_rng(7).normal(size=(300, 2)) * [1e-6, 10.0]
    for z in zs:
        for step in (lambda b: f.predict(b, 0.01), lambda b, z=z: f.update(b, z)):
            belief = step(belief)
            P = belief.covariance
            np.testing.assert_array_equal(P, P.T)
            assert np.linalg.eigvalsh(P)[0] >= -1e-12 * np.abs(P).max()


@FILTERS
def test_gate_rejects_an_outlier_and_says_so(make):
    f = make(LINEAR, gate=0.99)
    belief = f.predict(f.initial(*START), DT)
    good = f.update(belief, belief.mean[:2] + 0.1)
    assert good.innovation.accepted
    np.testing.assert_allclose(good.innovation.residual, 0.1, atol=1e-12)
    bad = f.update(belief, belief.mean[:2] + 50.0)
    assert not bad.innovation.accepted
    assert bad.innovation.distance > chi2.ppf(0.99, 2)
    np.testing.assert_array_equal(bad.mean, belief.mean)
    np.testing.assert_array_equal(bad.covariance, belief.covariance)
    assert make(LINEAR).update(belief, belief.mean[:2] + 50.0).innovation.accepted


@KALMAN
def test_gate_rejects_its_own_share_of_consistent_measurements(make):
    kf = make(LINEAR, gate=0.9)
    belief = kf.predict(kf.initial(*START), DT)
    S = kf.update(belief, belief.mean[:2]).innovation.covariance
    zs = np.random.default_rng(8).multivariate_normal(belief.mean[:2], S, size=1500)
    rejected = sum(not kf.update(belief, z).innovation.accepted for z in zs)
    assert abs(rejected - 150) < 4 * np.sqrt(1500 * 0.1 * 0.9)


@FILTERS
def test_beliefs_are_values(make):
    """Filtering from one belief twice gives one answer, and nothing given or returned can be changed."""
    f = make(LINEAR)
    mean = START[0].copy()
    belief = f.initial(mean, START[1])
    first = belief.mean.copy()
    mean[:] = 9.0
    np.testing.assert_array_equal(belief.mean, first)
    updated = f.update(belief, [1.0, 1.0])
    np.testing.assert_array_equal(f.update(belief, [1.0, 1.0]).mean, updated.mean)
    np.testing.assert_array_equal(belief.mean, first)
    assert updated.innovation is not None
    assert f.predict(updated, DT).innovation is None
    with pytest.raises(ValueError, match="read-only"):
        updated.mean[0] = 1.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        updated.innovation = None


@FILTERS
def test_zero_time_changes_nothing(make):
    f = make(LINEAR)
    belief = f.initial(*START)
    after = f.predict(belief, 0.0)
    np.testing.assert_allclose(after.mean, belief.mean, atol=1e-14)
    np.testing.assert_allclose(after.covariance, belief.covariance, atol=1e-14)


def test_particles_repeat_with_the_same_seed_and_leave_the_global_generator_alone():
    np.random.seed(0)  # noqa: NPY002 - it is this generator that must stay untouched
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    means = []
    for _ in range(2):
        pf = particle(LINEAR, seed=4, resample_below=1.0)
        belief = pf.initial(*START)
        for z in linear_problem(5)[0]:
            belief = pf.update(pf.predict(belief, DT), z)
        means.append(belief.mean)
    np.testing.assert_array_equal(*means)
    np.testing.assert_array_equal(np.random.get_state()[1], before)  # noqa: NPY002


def test_systematic_resampling_equals_filterpy_and_counts_by_weight(monkeypatch):
    rng = np.random.default_rng(9)
    for size in (2, 7, 500):
        weights = rng.dirichlet(np.full(size, 0.3))
        offset = rng.random()

        class Fixed:
            def random(self, value=offset):
                return value

        monkeypatch.setattr(filterpy.monte_carlo.resampling, "random", Fixed().random)
        indices = systematic_resample(weights, Fixed())
        np.testing.assert_array_equal(indices, filterpy.monte_carlo.systematic_resample(weights))
        counts = np.bincount(indices, minlength=size)
        assert (np.abs(counts - size * weights) < 1.0).all()


def test_resampling_never_chooses_a_weightless_particle():
    class Edge:
        def random(self):
            return np.nextafter(1.0, 0.0)

    weights = np.array([0.0, 0.1, 0.2, 0.7, 0.0])
    assert set(systematic_resample(weights, Edge())) <= {1, 2, 3}


def test_particle_weights_survive_a_measurement_far_from_all():
    pf = particle(LINEAR)
    belief = pf.update(pf.initial(*START), [1e6, 1e6])
    assert np.isfinite(belief.weights).all()
    assert belief.effective_size >= 1.0
    assert belief.particles[belief.weights.argmax()] @ [1, 1, 0, 0] > belief.particles.mean(0) @ [1, 1, 0, 0]


def test_particle_filter_keeps_two_hypotheses():
    """Only |x| is seen: the posterior has two modes, which no Gaussian belief can hold."""
    model = Model(lambda x, u, dt: x, np.abs, lambda dt: 1e-4 * np.eye(1), 0.01 * np.eye(1))
    pf = particle(model, particles=4000)
    belief = pf.initial([0.0], [[4.0]])
    for _ in range(5):
        belief = pf.update(pf.predict(belief, DT), [1.5])
    right = belief.particles[:, 0] > 0
    assert 0.3 < belief.weights[right].sum() < 0.7
    np.testing.assert_allclose(np.abs(belief.particles[belief.weights > 1e-4, 0]), 1.5, atol=0.4)


@FILTERS
def test_bad_input_is_refused_by_name(make):
    f = make(LINEAR)
    belief = f.initial(*START)
    nan = float("nan")
    for z in ([nan, 0.0], [np.inf, 0.0], [1.0], [1.0, 2.0, 3.0], [[1.0, 2.0]]):
        with pytest.raises(ValueError, match="z: expected"):
            f.update(belief, z)
    for dt in (-0.1, nan, np.inf):
        with pytest.raises(ValueError, match="dt"):
            f.predict(belief, dt)
    with pytest.raises(ValueError, match="u"):
        f.predict(belief, DT, [nan, 0.0])
    with pytest.raises(ValueError, match="mean"):
        f.initial([nan, 0, 0, 0], np.eye(4))
    with pytest.raises(ValueError, match="covariance"):
        f.initial(np.zeros(4), np.eye(3))
    with pytest.raises(ValueError, match="semi-definite"):
        f.initial(np.zeros(4), -np.eye(4))
    with pytest.raises(ValueError, match="symmetric"):
        f.initial(np.zeros(2), [[1.0, 0.5], [0.0, 1.0]])
    for gate in (0.0, 1.0, nan):
        with pytest.raises(ValueError, match="gate"):
            make(LINEAR, gate=gate)
    wrong = make(dataclasses.replace(LINEAR, measurement=lambda x: x))
    with pytest.raises(ValueError, match="measurement: expected"):
        wrong.update(belief, [0.0, 0.0])
    broken = make(dataclasses.replace(LINEAR, transition=lambda x, u, dt: x * nan))
    with pytest.raises(ValueError, match="transition: expected"):
        broken.predict(belief, DT)


def test_bad_models_and_options_are_refused_by_name():
    with pytest.raises(ValueError, match="measurement_noise"):
        dataclasses.replace(LINEAR, measurement_noise=np.zeros((2, 2)))
    with pytest.raises(ValueError, match="acceleration_noise"):
        constant_velocity_model([1.0, 2.0], 0.1, axes=3)
    with pytest.raises(ValueError, match="axes"):
        constant_velocity_model(1.0, 0.1, axes=0)
    with pytest.raises(ValueError, match="rng"):
        ParticleFilter(LINEAR, rng=42)
    with pytest.raises(ValueError, match="particles"):
        particle(LINEAR, particles=1)
    with pytest.raises(ValueError, match="resample_below"):
        particle(LINEAR, resample_below=2.0)
    with pytest.raises(ValueError, match="belief"):
        particle(LINEAR, particles=10).update(particle(LINEAR, particles=20).initial(*START), [0.0, 0.0])
    with pytest.raises(ValueError, match="weights"):
        ParticleBelief(np.zeros((3, 2)), np.ones(3))
    with pytest.raises(ValueError, match="kappa"):
        ukf = UnscentedKalmanFilter(LINEAR, kappa=-4.0)
        ukf.predict(ukf.initial(*START), DT)
    with pytest.raises(ValueError, match="alpha"):
        UnscentedKalmanFilter(LINEAR, alpha=0.0)
    with pytest.raises(ValueError, match="mean"):
        Belief(np.zeros((2, 2)), np.eye(2))
