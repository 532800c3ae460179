"""Bundle adjustment: its Jacobian, exact data, noise, scale, and errors."""

from __future__ import annotations

import numpy as np
import pytest

from aerograsp_env import spatial as sp
from aerograsp_env.interfaces import Intrinsics
from aerograsp_env.metrics import umeyama
from baselines.detection.bundle import _Problem, bundle_adjust
from baselines.detection.pnp import pinhole

CAMERA = Intrinsics(640, 480, 600.0, 600.0, 319.5, 239.5)
T_RIGHT_LEFT = sp.transform(np.eye(3), [-0.1, 0.0, 0.0])


def world(rng: np.random.Generator, frames: int, count: int, noise: float) -> tuple[np.ndarray, ...]:
    """True poses and points, pixels of both cameras, and which point and frame they are of."""
    points = rng.uniform(-0.1, 0.1, (count, 3))
    angles = np.linspace(0.0, 1.2, frames)
    T = np.array(
        [sp.transform(sp.so3_exp([0.1 * np.sin(5 * a), a, 0.0]), [0.02 * np.sin(9 * a), 0.0, 0.5]) for a in angles]
    )
    frame, point = np.nonzero(rng.random((frames, count)) < 0.7)
    points_c = np.einsum("mij,mj->mi", T[frame, :3, :3], points[point]) + T[frame, :3, 3]
    left = pinhole(points_c, CAMERA) + noise * rng.standard_normal((len(frame), 2))
    right = pinhole(sp.transform_points(T_RIGHT_LEFT, points_c), CAMERA) + noise * rng.standard_normal((len(frame), 2))
    return T, points, left, right, frame, point


def disturbed(
    rng: np.random.Generator, T: np.ndarray, points: np.ndarray, size: float
) -> tuple[np.ndarray, np.ndarray]:
    twists = size * rng.standard_normal((len(T), 6))
    twists[0] = 0.0
    return sp.se3_exp(twists) @ T, points + size * rng.standard_normal(points.shape)


def test_jacobian_is_the_derivative() -> None:
    rng = np.random.default_rng(0)
    T, points, left, right, frame, point = world(rng, 3, 8, 0.0)
    side = np.tile(np.eye(4), (2 * len(frame), 1, 1))
    side[len(frame) :] = sp.transform(sp.so3_exp([0.1, 0.05, -0.2]), [-0.1, 0.01, 0.02])
    problem = _Problem(
        T, points, np.concatenate([left, right]), np.tile(frame, 2), np.tile(point, 2), CAMERA, side
    )  # fmt: skip
    x = 0.1 * rng.standard_normal(6 * 2 + 3 * 8)
    numeric = [(problem.residual(x + e) - problem.residual(x - e)) / 2e-6 for e in 1e-6 * np.eye(len(x))]
    np.testing.assert_allclose(problem.jacobian(x).toarray(), np.array(numeric).T, atol=1e-4)


def test_exact_data_come_back_up_to_scale() -> None:
    rng = np.random.default_rng(1)
    T, points, left, _, frame, point = world(rng, 8, 60, 0.0)
    found = bundle_adjust(*disturbed(rng, T, points, 0.01), left, frame, point, CAMERA)
    assert found.converged and found.rmse < 1e-2
    np.testing.assert_array_equal(found.T_c_o[0], T[0])
    fit = umeyama(found.points, points, with_scale=True)
    aligned = sp.transform_points(fit.T_target_source, fit.scale * found.points)
    assert np.linalg.norm(aligned - points, axis=1).max() < 2e-5
    assert fit.scale == pytest.approx(1.0, abs=0.03)


def test_the_second_camera_gives_the_scale() -> None:
    rng = np.random.default_rng(2)
    T, points, left, right, frame, point = world(rng, 8, 60, 0.2)
    T_start, start = disturbed(rng, T, points, 0.005)
    right[::3] = np.nan
    T_start[:, :3, 3] *= 1.1
    T_start[0] = T[0]
    found = bundle_adjust(
        T_start, 1.1 * start, left, frame, point, CAMERA, pixels_right=right, T_right_left=T_RIGHT_LEFT
    )
    fit = umeyama(found.points, points, with_scale=True)
    assert fit.scale == pytest.approx(1.0, abs=2e-3)
    # Residuals have the noise's deviation, less what the unknowns take up.
    rows = 2 * (len(frame) + np.isfinite(right).all(axis=1).sum())
    expected = 0.2 * np.sqrt(2.0 * (rows - found.points.size - 6 * 7) / rows)
    assert found.rmse == pytest.approx(expected, rel=0.1)


def test_wrong_observations_show_in_their_errors() -> None:
    rng = np.random.default_rng(3)
    T, points, left, _, frame, point = world(rng, 8, 60, 0.2)
    left[7] += 40.0
    found = bundle_adjust(*disturbed(rng, T, points, 0.002), left, frame, point, CAMERA)
    assert int(found.errors.argmax()) == 7 and found.errors[7] > 20.0


def test_errors_name_the_argument() -> None:
    T, points, left, right, frame, point = world(np.random.default_rng(4), 3, 10, 0.0)
    with pytest.raises(ValueError, match="frame, point: expected"):
        bundle_adjust(T, points, left, frame[:-1], point, CAMERA)
    with pytest.raises(ValueError, match="point: expected rows below 5"):
        bundle_adjust(T, points[:5], left, frame, point, CAMERA)
    with pytest.raises(ValueError, match="at least 42 coordinates"):
        bundle_adjust(T, points, left[:5], frame[:5], point[:5], CAMERA)
    with pytest.raises(ValueError, match="pixels_right: expected shape"):
        bundle_adjust(T, points, left, frame, point, CAMERA, pixels_right=right[:3], T_right_left=T_RIGHT_LEFT)
