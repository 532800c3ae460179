"""The stereo filter and triangulation, against exact projections and drawn pairs of pictures."""

from __future__ import annotations

import numpy as np
import pytest
from feature_pictures import CAMERA, board_points, draw_board, poster

from aerograsp_env import spatial as sp
from aerograsp_env.interfaces import RGBD, Intrinsics
from baselines.detection.pnp import pinhole
from baselines.detection.stereo_features import (
    StereoRig,
    epipolar_distances,
    rgbd_features,
    stereo_features,
    triangulate,
)

RIG = StereoRig.rectified(CAMERA, 0.1)
TURNED = StereoRig(
    CAMERA, CAMERA._replace(fx=300.0, cx=150.0), sp.transform(sp.so3_exp([0.02, -0.1, 0.05]), [-0.1, 0.02, 0.01])
)


def both(points: np.ndarray, rig: StereoRig) -> tuple[np.ndarray, np.ndarray]:
    return pinhole(points, rig.left), pinhole(sp.transform_points(rig.T_right_left, points), rig.right)


@pytest.mark.parametrize("rig", [RIG, TURNED], ids=["rectified", "turned"])
def test_exact_pairs_triangulate_exactly(rig: StereoRig) -> None:
    points = np.random.default_rng(0).uniform([-0.2, -0.2, 0.4], [0.2, 0.2, 2.0], (200, 3))
    left, right = both(points, rig)
    np.testing.assert_allclose(triangulate(left, right, rig), points, atol=1e-9)
    assert epipolar_distances(left, right, rig).max() < 1e-9


def test_depth_is_focal_length_times_baseline_over_disparity() -> None:
    point = triangulate([[180.0, 120.0]], [[150.0, 120.0]], RIG)[0]
    assert point[2] == pytest.approx(CAMERA.fx * 0.1 / 30.0)
    # Half of an offset across the lines goes to each image: the Sampson distance of rectified rows is their gap / √2.
    assert epipolar_distances([[180.0, 120.0]], [[150.0, 122.0]], RIG)[0] == pytest.approx(2.0 / np.sqrt(2.0))


def test_triangulation_is_as_good_as_the_noise_allows() -> None:
    rng = np.random.default_rng(1)
    point = np.array([[0.05, -0.1, 0.8]])
    left, right = (np.repeat(p, 4000, axis=0) + 0.3 * rng.standard_normal((4000, 2)) for p in both(point, RIG))
    error = triangulate(left, right, RIG) - point
    sigma = 0.8**2 / (CAMERA.fx * 0.1) * 0.3 * np.sqrt(2.0)  # of the depth, by the derivative of f b / d
    assert error[:, 2].std() == pytest.approx(sigma, rel=0.05)
    assert abs(error[:, 2].mean()) < 0.1 * sigma


@pytest.mark.parametrize("feature", ["fast+sift", "orb", "fast+brief"])
def test_a_drawn_board_is_where_it_is(feature: str) -> None:
    T = sp.transform(sp.so3_exp([0.2, 0.3, 0.1]), [-0.02, 0.01, 0.6])
    image = poster(2)
    left, right = draw_board(image, T, 3), draw_board(image, RIG.T_right_left @ T, 3)
    found = stereo_features(left, right, RIG, feature, 400, mask=board_points(T) > 0)
    assert len(found.pixels) > 25 and found.pixels_right is not None
    on_board = sp.transform_points(sp.inverse(T), found.points_c)
    assert np.median(np.abs(on_board[:, 2])) < 5e-3
    np.testing.assert_allclose(pinhole(found.points_c, CAMERA), found.pixels, atol=1.0)


def test_right_and_left_exchanged_leave_nothing() -> None:
    T = sp.transform(np.eye(3), [0.0, 0.0, 0.6])
    left, right = draw_board(poster(2), T, 3), draw_board(poster(2), RIG.T_right_left @ T, 3)
    assert len(stereo_features(right, left, RIG, "fast+sift", 300).pixels) < 5


def test_depth_gives_the_points_of_an_rgbd_frame() -> None:
    T = sp.transform(np.eye(3), [0.0, 0.0, 0.7])
    depth = np.full((240, 320), 0.7, dtype=np.float32)
    depth[:, :160] = 0.0
    found = rgbd_features(RGBD(draw_board(poster(2), T, 3), depth, CAMERA), "fast+sift", 300)
    assert len(found.pixels) > 10 and found.pixels[:, 0].min() > 159.0
    np.testing.assert_allclose(found.points_c[:, 2], 0.7, rtol=1e-6)
    np.testing.assert_allclose(pinhole(found.points_c, CAMERA), found.pixels, atol=1e-4)


def test_errors_name_the_image() -> None:
    image = np.zeros((240, 320), dtype=np.uint8)
    with pytest.raises(ValueError, match="right: expected 320×240 px as the intrinsics say, got 160×120"):
        stereo_features(image, image[::2, ::2], RIG)
    with pytest.raises(ValueError, match="image: expected uint8"):
        stereo_features(image.astype(float), image, RIG)
    with pytest.raises(ValueError, match="T_right_left"):
        StereoRig(CAMERA, CAMERA, np.eye(4))
    with pytest.raises(ValueError, match="pixels_right: expected one for each of 2"):
        triangulate(np.zeros((2, 2)), np.zeros((1, 2)), RIG)
    assert isinstance(RIG.left, Intrinsics)
