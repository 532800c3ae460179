"""Descriptors by hand and by invariance, and matches that are known."""

from __future__ import annotations

import numpy as np
import pytest

from aerograsp_env import spatial as sp
from aerograsp_env.interfaces import Intrinsics
from baselines.objects.feature_cloud import FeatureCloud, detect_features
from baselines.objects.fpfh import fpfh, iss_keypoints, pair_features
from baselines.objects.matching import match_descriptors
from baselines.objects.point_cloud import PointCloudObject

CAMERA = Intrinsics(160, 120, 150.0, 150.0, 79.5, 59.5)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(9)


def bumpy(rng: np.random.Generator, n: int = 1500) -> PointCloudObject:
    """A closed surface without symmetry, with its exact normals."""
    import trimesh

    mesh = trimesh.creation.icosphere(4, 0.1)
    v = mesh.vertices
    mesh.vertices = v * (
        1 + 0.25 * np.sin(31 * v[:, :1] + 1) * np.cos(43 * v[:, 1:2]) + 0.2 * np.sin(37 * v[:, 2:] + 2)
    )
    points, faces = trimesh.sample.sample_surface(mesh, 6 * n, seed=4)
    return PointCloudObject(points, mesh.face_normals[faces]).farthest_point_sample(n, rng)


def picture(rng: np.random.Generator) -> np.ndarray:
    import cv2

    return cv2.resize(rng.integers(0, 255, (30, 40)).astype(np.uint8), (160, 120), interpolation=cv2.INTER_CUBIC)


def test_pair_features_by_hand() -> None:
    zero, x, z = np.zeros(3), np.array([1.0, 0, 0]), np.array([0.0, 0, 1])
    assert pair_features(zero, z, x, z) == pytest.approx((0.0, 0.0, 0.0))  # two points of a plane
    # the second normal leans by 30° towards the line: it becomes the source, u·d = −cos 60°, and θ is the lean
    lean = np.array([0.5, 0, np.sqrt(0.75)])
    alpha, phi, theta = pair_features(zero, z, x, lean)
    assert (alpha, phi, abs(theta)) == pytest.approx((0.0, -0.5, np.pi / 6))
    # it turns out of the plane of d and u: all of it is in α
    alpha, phi, theta = pair_features(zero, z, x, np.array([0.0, 0.6, 0.8]))
    assert (abs(alpha), phi, theta) == pytest.approx((0.6, 0.0, 0.0))
    assert pair_features(zero, z, zero, z) == (0.0, 0.0, 0.0)


def test_a_plane_fills_the_middle_bins() -> None:
    grid = np.stack([*np.meshgrid(np.arange(10.0), np.arange(10.0)), np.zeros((10, 10))], -1).reshape(-1, 3)
    histogram = fpfh(grid, np.tile([0.0, 0, 1], (100, 1)), 2.1)
    expected = np.zeros(33)
    expected[[5, 16, 27]] = 100.0
    np.testing.assert_allclose(histogram, np.tile(expected, (100, 1)), atol=1e-9)
    alone = fpfh(np.array([[0.0, 0, 0], [9, 9, 9]]), np.array([[0.0, 0, 1], [0, 0, 1]]), 1.0)
    np.testing.assert_array_equal(alone, 0.0)


def test_histograms_do_not_change_with_pose_or_unit(rng: np.random.Generator) -> None:
    cloud = bumpy(rng, 600)
    T = sp.transform(sp.so3_exp(rng.normal(size=3)), rng.normal(size=3))
    moved = cloud.transform(T)
    assert cloud.normals is not None and moved.normals is not None
    a = fpfh(cloud.points, cloud.normals, 0.03)
    # a pair on the border of a bin may fall to either side of it after rounding
    assert np.quantile(np.abs(a - fpfh(moved.points, moved.normals, 0.03)), 0.99) < 1e-6
    np.testing.assert_allclose(fpfh(1000.0 * cloud.points, cloud.normals, 30.0), a, atol=1e-6)
    np.testing.assert_allclose(a.reshape(-1, 3, 11).sum(axis=2), 100.0, atol=1e-9)


@pytest.mark.parametrize("keypoints", ["iss", "uniform", "all"])
def test_a_moved_cloud_is_recognised(keypoints: str, rng: np.random.Generator) -> None:
    cloud = bumpy(rng)
    T = sp.transform(sp.so3_exp([0.5, -0.7, 1.1]), [0.3, 0.1, -0.2])
    other = PointCloudObject(cloud.points, cloud.normals).transform(T).select(rng.permutation(len(cloud)))
    a = FeatureCloud.from_cloud(cloud, 0.03, keypoints=keypoints)  # type: ignore[arg-type]
    b = FeatureCloud.from_cloud(other, 0.03, keypoints="all")
    matches = a.match(b, ratio=None)
    gaps = np.linalg.norm(sp.transform_points(T, a.points[matches.query]) - b.points[matches.train], axis=1)
    assert len(a) >= 10 and len(matches.query) >= 0.9 * len(a)
    assert (gaps < 1e-9).mean() > 0.95


def test_keypoints_are_apart_and_not_on_planes(rng: np.random.Generator) -> None:
    cloud = bumpy(rng)
    rows = iss_keypoints(cloud.points, 0.02, suppression=0.015)
    gaps = np.linalg.norm(cloud.points[rows][:, None] - cloud.points[rows], axis=2) + np.eye(len(rows))
    assert len(rows) > 10 and gaps.min() >= 0.015
    flat = np.concatenate([rng.uniform(size=(500, 2)), np.zeros((500, 1))], axis=1)
    assert len(iss_keypoints(flat, 0.2)) == 0


@pytest.mark.parametrize("feature", ["sift", "orb", "fast", "shi-tomasi"])
def test_features_lie_where_the_depth_says(feature: str, rng: np.random.Generator) -> None:
    image = picture(rng)
    x = np.tile(np.arange(160.0), (120, 1))
    depth = 0.5 + 0.001 * x
    depth[:, 120:] = 0.0
    cloud = FeatureCloud.from_rgbd(image, depth, CAMERA, feature, 200)  # type: ignore[arg-type]
    assert 10 < len(cloud) <= 200 and cloud.pixels is not None and cloud.pixels[:, 0].max() < 120
    projected = cloud.points @ CAMERA.matrix.T
    np.testing.assert_allclose(projected[:, :2] / projected[:, 2:], cloud.pixels, atol=1e-9)
    np.testing.assert_allclose(cloud.points[:, 2], 0.5 + 0.001 * np.rint(cloud.pixels[:, 0]), atol=1e-12)


@pytest.mark.parametrize("feature", ["sift", "orb", "fast", "shi-tomasi"])
@pytest.mark.parametrize("method", ["bf", "flann"])
def test_a_shifted_image_matches(feature: str, method: str, rng: np.random.Generator) -> None:
    image = picture(rng)
    shifted = np.roll(image, (5, 8), axis=(0, 1))
    a, b = detect_features(image, feature), detect_features(shifted, feature)  # type: ignore[arg-type]
    matches = match_descriptors(a.descriptors, b.descriptors, method)  # type: ignore[arg-type]
    shift = b.pixels[matches.train] - a.pixels[matches.query]
    assert len(matches.query) > 10
    # FLANN may miss the second nearest, and then its ratio test lets a wrong match pass
    assert (np.linalg.norm(shift - [8, 5], axis=1) < 1.0).mean() > (0.9 if method == "bf" else 0.8)
    assert (np.diff(matches.distances) >= 0).all()


def test_matches_equal_their_definition(rng: np.random.Generator) -> None:
    a, b = rng.normal(size=(30, 8)).astype(np.float32), rng.normal(size=(40, 8)).astype(np.float32)
    gaps = np.linalg.norm(a[:, None] - b, axis=2)
    near = np.sort(gaps, axis=1)
    expected = {
        (i, int(gaps[i].argmin()))
        for i in range(30)
        if near[i, 0] < 0.9 * near[i, 1] and gaps[:, gaps[i].argmin()].argmin() == i
    }
    matches = match_descriptors(a, b, ratio=0.9)
    assert set(zip(matches.query.tolist(), matches.train.tolist(), strict=True)) == expected and expected
    assert len(match_descriptors(a, b, ratio=None, cross_check=False).query) == 30
    assert len(match_descriptors(a, b[:0]).query) == 0
    assert len(match_descriptors(a, a, max_distance=-1.0).query) == 0


def test_bad_input_is_named(rng: np.random.Generator) -> None:
    cloud = PointCloudObject(rng.normal(size=(50, 3)))
    blank = np.zeros((120, 160), dtype=np.uint8)
    assert len(detect_features(blank).pixels) == 0 and len(FeatureCloud.from_rgbd(blank, blank + 1.0, CAMERA)) == 0
    for call, message in (
        (lambda: FeatureCloud.from_cloud(cloud, 0.1), "cloud: expected one with normals"),
        (lambda: detect_features(blank.astype(float)), "image: expected uint8"),  # type: ignore[arg-type]
        (lambda: detect_features(blank, "surf"), "feature: expected one of"),  # type: ignore[arg-type]
        (lambda: detect_features(blank, n=0), "n: expected"),
        (lambda: FeatureCloud(np.zeros((2, 3)), np.zeros((3, 4))), "descriptors: expected one for each point"),
        (lambda: FeatureCloud(np.zeros((1, 3)), np.full((1, 4), np.nan)), "descriptors: expected finite"),
        (lambda: match_descriptors(np.zeros((2, 3)), np.zeros((2, 4))), "train: expected shape"),
        (lambda: match_descriptors(np.zeros((2, 3)), np.zeros((2, 3)), ratio=1.5), "ratio"),
        (lambda: fpfh(cloud.points, cloud.points, 0.0), "radius"),
        (lambda: iss_keypoints(cloud.points, 0.5, gamma=2.0), "gamma"),
    ):
        with pytest.raises(ValueError, match=message):
            call()
