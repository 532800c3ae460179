"""Dryden gusts against MIL-F-8785C, written here on its own."""

from __future__ import annotations

import numpy as np
import pytest
from dock_worlds import FREE, make, world
from scipy.signal import welch

from aerograsp_env.sim.config import CONTROL_STEP, DockConfig
from aerograsp_env.sim.kernel_sensors import advance_slow
from aerograsp_env.sim.layout import SLOW_NOISE
from aerograsp_env.sim.wind import WIND_LEVELS, WindConfig, dryden_coefficients, dryden_spectrum

GUSTY = WindConfig(mean_speed=3.0, gust_std=1.0, direction=0.4)


def military_spectrum(frequency, sigma, speed, altitude):
    """One-sided density [(m/s)²/Hz] of u, v, w from |H(jω)|²: MIL-F-8785C, low altitude, in feet."""
    foot = 0.3048
    h = altitude / foot
    length_w, length_u = h * foot, h / (0.177 + 0.000823 * h) ** 1.2 * foot
    s = 2j * np.pi * frequency
    filters = [sigma * np.sqrt(2 * length_u / (np.pi * speed)) / (1 + length_u / speed * s)]
    for length in (length_u, length_w):
        t = length / speed
        filters.append(sigma * np.sqrt(length / (np.pi * speed)) * (1 + np.sqrt(3) * t * s) / (1 + t * s) ** 2)
    return 2 * np.pi * np.abs(np.array(filters)) ** 2  # the standard's density is per rad/s


@pytest.fixture(scope="module")
def series() -> np.ndarray:
    """(N, 3) gusts along, across and up from the compiled step that the environments run."""
    _, _, p, s = world(DockConfig(wind=GUSTY))
    rng, n = np.random.default_rng(2), 2**16
    p.wind_axes[:] = np.eye(3)
    s.gust[:] = dryden_coefficients(GUSTY, CONTROL_STEP).initial @ rng.standard_normal(5)
    noise, row, out = rng.standard_normal((n, 5)), np.zeros(SLOW_NOISE), np.empty((n, 3))
    for k in range(n):
        row[:5] = noise[k]
        advance_slow(p, s, row)
        out[k] = s.wind
    return out


def test_spectrum_of_a_long_series(series):
    frequency, power = welch(series.T, fs=1 / CONTROL_STEP, nperseg=2**13, window="hann", detrend=False)
    expected = military_spectrum(frequency[1:], GUSTY.gust_std, GUSTY.mean_speed, GUSTY.altitude)
    ratio = power[:, 1:] / expected
    for low, high, tolerance in ((0.02, 0.08, 0.35), (0.08, 0.5, 0.15), (0.5, 5.0, 0.08)):
        band = (frequency[1:] >= low) & (frequency[1:] < high)
        np.testing.assert_allclose(ratio[:, band].mean(axis=1), 1.0, atol=tolerance)


def test_the_packages_own_formula_is_the_standards():
    frequency = np.geomspace(1e-3, 10.0, 50)
    for config in (GUSTY, WIND_LEVELS["light"], WindConfig(8.0, 2.0, altitude=100.0)):
        expected = military_spectrum(frequency, config.gust_std, config.mean_speed, config.altitude)
        np.testing.assert_allclose(2 * dryden_spectrum(config, frequency), expected, rtol=1e-12)  # it is two-sided


@pytest.mark.parametrize(
    "config", [GUSTY, WIND_LEVELS["light"], WindConfig(0.0, 1.5), WindConfig(12.0, 3.0, altitude=80.0)]
)
def test_variance_is_exact_and_kept_by_every_step(config):
    c = dryden_coefficients(config, CONTROL_STEP)
    stationary = c.initial @ c.initial.T
    np.testing.assert_allclose(c.output @ stationary @ c.output.T, config.gust_std**2 * np.eye(3), atol=1e-9)
    np.testing.assert_allclose(
        c.transition @ stationary @ c.transition.T + c.input @ c.input.T, stationary, rtol=1e-9, atol=1e-12
    )


def test_the_process_does_not_depend_on_the_time_step():
    fine, coarse = dryden_coefficients(GUSTY, 0.01), dryden_coefficients(GUSTY, 0.03)
    a, q = fine.transition, fine.input @ fine.input.T
    np.testing.assert_allclose(a @ a @ a, coarse.transition, atol=1e-12)
    np.testing.assert_allclose(q + a @ q @ a.T + a @ a @ q @ a.T @ a.T, coarse.input @ coarse.input.T, atol=1e-12)
    np.testing.assert_allclose(fine.initial, coarse.initial)
    np.testing.assert_allclose(fine.output, coarse.output)


def test_gusts_are_stationary_from_the_first_sample():
    env = make(**(FREE | {"wind": GUSTY}))
    first = []
    for seed in range(200):
        env.reset(seed=seed)
        first.append(env.state["wind"].copy())
    gusts = np.array(first) - GUSTY.mean_speed * np.array([np.cos(0.4), np.sin(0.4), 0.0])
    along = gusts @ np.array([[np.cos(0.4), -np.sin(0.4), 0.0], [np.sin(0.4), np.cos(0.4), 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(along.mean(axis=0), 0.0, atol=4 / np.sqrt(200))
    np.testing.assert_allclose(along.std(axis=0), GUSTY.gust_std, atol=4 / np.sqrt(2 * 200))


def test_steady_wind_blows_towards_its_azimuth():
    env = make(**(FREE | {"wind": WindConfig(mean_speed=4.0, gust_std=0.0)}))
    env.reset(seed=0, options={"wind_direction": 2.0})
    for _ in range(5):
        np.testing.assert_allclose(env.state["wind"], [4 * np.cos(2.0), 4 * np.sin(2.0), 0.0], atol=1e-12)
        env.step(np.zeros(3, np.float32))
    azimuths = []
    for seed in range(100):
        env.reset(seed=seed)
        azimuths.append(np.arctan2(env.state["wind"][1], env.state["wind"][0]))
    assert np.abs(np.exp(1j * np.array(azimuths)).mean()) < 0.3  # drawn from all round


def test_levels_are_those_documented():
    assert {name: (w.mean_speed, w.gust_std) for name, w in WIND_LEVELS.items()} == {
        "calm": (0.0, 0.0),
        "light": (2.0, 0.5),
        "gusty": (3.0, 1.0),
    }
    env = make(**FREE)
    env.reset(seed=0)
    env.step(np.zeros(3, np.float32))
    assert not env.state["wind"].any()


@pytest.mark.parametrize(
    "changes",
    [{"mean_speed": -1.0}, {"gust_std": np.nan}, {"altitude": 1.0}, {"direction": np.inf}, {"mean_speed": 99.0}],
)
def test_wind_out_of_range_is_refused_by_name(changes):
    with pytest.raises(ValueError, match=next(iter(changes))):
        WindConfig(**changes)
