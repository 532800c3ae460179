"""Poses from pairs: exact ones, wrong pairs, honest failures, and covariances against sampling."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from aerograsp_env import spatial as sp
from aerograsp_env.interfaces import Intrinsics
from aerograsp_env.metrics import rotation_error, translation_error
from baselines.detection.pnp import (
    chance,
    pinhole,
    pose_covariance,
    pose_jacobian,
    refine_pose,
    solve_pnp,
    undistorted,
)

CAMERA = Intrinsics(640, 480, 600.0, 590.0, 321.0, 238.0)
POSE = sp.transform(sp.so3_exp([0.3, -0.5, 0.2]), [0.05, -0.02, 0.6])


def cloud(rng: np.random.Generator, n: int, flat: bool = False) -> np.ndarray:
    points = rng.uniform(-0.1, 0.1, (n, 3))
    return points * [1.0, 1.0, 0.0] if flat else points


def seen(points: np.ndarray, T: np.ndarray = POSE) -> np.ndarray:
    return pinhole(sp.transform_points(T, points), CAMERA)


@pytest.mark.parametrize("flat", [False, True])
def test_exact_pairs_give_the_exact_pose(flat: bool) -> None:
    points = cloud(np.random.default_rng(0), 30, flat)
    found = solve_pnp(points, seen(points), CAMERA)
    assert found.T_c_object is not None and found.inliers.all() and found.rmse < 1e-6
    assert translation_error(found.T_c_object, POSE) < 1e-8 and rotation_error(found.T_c_object, POSE) < 1e-7


def test_a_distorted_camera_is_undone() -> None:
    lens = CAMERA._replace(distortion=np.array([-0.25, 0.1, 0.001, -0.002, 0.0]))
    points = cloud(np.random.default_rng(1), 40)
    rotation = cv2.Rodrigues(POSE[:3, :3])[0]
    pixels = cv2.projectPoints(points, rotation, POSE[:3, 3], lens.matrix, lens.distortion)[0].reshape(-1, 2)
    np.testing.assert_allclose(undistorted(pixels, lens), seen(points), atol=1e-2)
    found = solve_pnp(points, pixels, lens)
    assert found.T_c_object is not None and translation_error(found.T_c_object, POSE) < 1e-4


@pytest.mark.parametrize("flat", [False, True])
def test_two_thirds_of_wrong_pairs_are_left_out(flat: bool) -> None:
    rng = np.random.default_rng(2)
    points = cloud(rng, 90, flat)
    pixels = seen(points) + rng.normal(0.0, 0.5, (90, 2))
    pixels[30:] = rng.uniform([0, 0], [640, 480], (60, 2))
    found = solve_pnp(points, pixels, CAMERA)
    assert found.T_c_object is not None
    assert found.inliers[:30].sum() >= 29 and found.inliers[30:].sum() <= 1
    assert translation_error(found.T_c_object, POSE) < 5e-3
    assert solve_pnp(points, pixels, CAMERA).T_c_object == pytest.approx(found.T_c_object, abs=0.0)


def test_random_pairs_give_no_pose() -> None:
    rng = np.random.default_rng(3)
    for n in (8, 30, 120):
        for _ in range(5):
            found = solve_pnp(cloud(rng, n), rng.uniform([0, 0], [640, 480], (n, 2)), CAMERA)
            assert found.T_c_object is None and found.covariance is None and not found.inliers.any()
            assert found.reason and np.isnan(found.rmse)


def test_pairs_that_leave_the_pose_open_give_none() -> None:
    line = np.linspace(-0.1, 0.1, 20)[:, None] * [1.0, 0.5, 0.2]
    assert solve_pnp(line, seen(line), CAMERA).T_c_object is None
    same = np.tile([[0.01, 0.02, 0.03]], (20, 1))
    assert solve_pnp(same, seen(same), CAMERA).T_c_object is None
    few = cloud(np.random.default_rng(4), 5)
    assert solve_pnp(few, seen(few), CAMERA).reason == "5 pairs, 6 needed"
    assert solve_pnp(np.empty((0, 3)), np.empty((0, 2)), CAMERA).T_c_object is None


def test_a_guess_helps_where_sampling_finds_nothing() -> None:
    rng = np.random.default_rng(5)
    points = cloud(rng, 300)
    pixels = rng.uniform([0, 0], [640, 480], (300, 2))
    pixels[:25] = seen(points[:25])
    guess = sp.se3_exp([0.0, 0.001, 0.0, 0.002, 0.0, 0.0]) @ POSE
    found = solve_pnp(points, pixels, CAMERA, iterations=1, T_guess=guess)
    assert found.T_c_object is not None and translation_error(found.T_c_object, POSE) < 1e-3


def test_jacobian_is_the_derivative() -> None:
    points_c = sp.transform_points(POSE, cloud(np.random.default_rng(6), 10))
    J = pose_jacobian(points_c, CAMERA)
    for k, step in enumerate(1e-6 * np.eye(6)):
        moved = [pinhole(sp.transform_points(sp.se3_exp(s * step), points_c), CAMERA) for s in (1.0, -1.0)]
        np.testing.assert_allclose(J[..., k], (moved[0] - moved[1]) / 2e-6, rtol=1e-5, atol=1e-4)


def test_covariance_is_that_of_sampled_noise() -> None:
    rng = np.random.default_rng(7)
    points, sigma = cloud(rng, 60), 0.8
    errors = []
    for _ in range(400):
        T = refine_pose(points, seen(points) + rng.normal(0.0, sigma, (60, 2)), CAMERA, POSE)
        errors.append(np.concatenate([T[:3, 3] - POSE[:3, 3], sp.so3_log(T[:3, :3] @ POSE[:3, :3].T)]))
    bound = pose_covariance(points, POSE, CAMERA, sigma)
    assert bound is not None
    ratio = np.sqrt(np.diag(np.cov(np.array(errors).T)) / np.diag(bound))
    np.testing.assert_allclose(ratio, 1.0, atol=0.15)
    whitened = np.linalg.solve(np.linalg.cholesky(bound), np.array(errors).T)
    np.testing.assert_allclose(np.cov(whitened), np.eye(6), atol=0.3)


def test_chance_by_hand() -> None:
    # Of 10 pairs, 6 places to start from, 10 over 8 choices of inliers, 8 over 4 of the sample, 4 more that agree.
    assert chance(10, 8, 0.01) == pytest.approx(6 * 45 * 70 * 1e-8)
    assert chance(10, 4, 0.5) > 1.0


def test_errors_name_the_argument() -> None:
    points = cloud(np.random.default_rng(8), 10)
    with pytest.raises(ValueError, match="pixels: expected one for each of 10 points, got 9"):
        solve_pnp(points, seen(points)[:9], CAMERA)
    with pytest.raises(ValueError, match="points: expected finite"):
        solve_pnp(np.full((10, 3), np.nan), seen(points), CAMERA)
    with pytest.raises(ValueError, match="threshold"):
        solve_pnp(points, seen(points), CAMERA, threshold=0.0)
