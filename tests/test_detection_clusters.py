"""Clusters without models: outliers, planes, Euclidean clusters, k-means, projection, and real tables."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import trimesh
from detection_clouds import CAMERA, cast, frame_of, looking
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from aerograsp_env.interfaces import Intrinsics
from aerograsp_env.spatial import inverse, so3_exp, transform, transform_points
from baselines.detection import (
    cluster_detections,
    convex_hull,
    crop_hull,
    euclidean_clusters,
    fit_plane,
    kmeans_pp,
    pca_frame,
    project,
    remove_outliers,
    segment_objects,
    x_means,
)
from baselines.objects.cloud_files import _decompress_lzf

DATA = Path(os.environ.get("AEROGRASP_DATA", Path(__file__).parents[2] / "shared" / "data"))
needs_data = pytest.mark.skipif(not (DATA / "clouds_mosd").is_dir(), reason="real data not present")

BAD = ((np.empty((0, 3)), "expected at least"), (np.full((30, 3), np.nan), "finite"), (np.ones((30, 2)), "shape"))


def test_outliers_go_and_the_rest_stays() -> None:
    rng = np.random.default_rng(0)
    cloud = rng.uniform(-0.1, 0.1, (2000, 3))
    strays = rng.uniform(0.5, 1.0, (10, 3))
    mask = remove_outliers(np.concatenate([cloud, strays]))
    assert not mask[2000:].any() and mask[:2000].mean() > 0.99
    for bad, said in (*BAD, (np.ones((3, 3)), "expected at least 17 points, got 3")):
        with pytest.raises(ValueError, match=said):
            remove_outliers(bad)


def test_plane_among_clutter_with_its_own_threshold() -> None:
    rng = np.random.default_rng(1)
    normal = np.array([0.2, -0.3, 0.933])
    normal /= np.linalg.norm(normal)
    R = so3_exp([0.3, 0.2, 0.0])
    flat = np.concatenate([rng.uniform(-1, 1, (3000, 2)), 0.002 * rng.normal(size=(3000, 1))], axis=1)
    clutter = rng.uniform([-1, -1, 0.05], [1, 1, 1], (2000, 3))
    cloud = np.concatenate([flat, clutter]) @ R.T + [0.0, 0.0, 50.0]  # far from the origin: digits are kept
    plane = fit_plane(cloud)
    assert plane.normal @ R[:, 2] == pytest.approx(-1.0, abs=1e-6)  # towards the origin
    assert np.median(np.abs(plane.distance(cloud[:3000]))) < 0.002 and 0.004 < plane.threshold < 0.009
    assert plane.inliers[:3000].mean() > 0.99 and plane.inliers[3000:].mean() < 0.02
    other = fit_plane(cloud, viewpoint=(0.0, 0.0, 100.0))
    np.testing.assert_allclose(other.normal, -plane.normal, atol=1e-12)
    assert other.offset == pytest.approx(-plane.offset)


def test_plane_refuses_what_spans_none() -> None:
    line = np.linspace(0, 1, 50)[:, None] * [1.0, 2.0, 3.0]
    with pytest.raises(ValueError, match="all on one line"):
        fit_plane(line)
    for bad, said in (*BAD, (np.eye(3), "expected at least 4 points, got 3")):
        with pytest.raises(ValueError, match=said):
            fit_plane(bad)


def test_clusters_are_exactly_the_connected_components() -> None:
    rng = np.random.default_rng(2)
    for _ in range(10):
        cloud = rng.uniform(0, 1, (rng.integers(1, 1500), 3)) * rng.uniform(0.1, 2, 3)
        tolerance = rng.uniform(0.02, 0.2)
        i, j = cKDTree(cloud).query_pairs(tolerance, output_type="ndarray").T
        graph = coo_matrix((np.ones(len(i)), (i, j)), shape=(len(cloud),) * 2)
        count, labels = connected_components(graph, directed=False)
        clusters = euclidean_clusters(cloud, tolerance, min_size=1)
        assert len(clusters) == count and sum(map(len, clusters)) == len(cloud)
        assert all(len(np.unique(labels[cluster])) == 1 for cluster in clusters)
        sizes = [len(cluster) for cluster in clusters]
        assert sizes == sorted(sizes, reverse=True)


def test_clusters_by_size_and_default_tolerance() -> None:
    rng = np.random.default_rng(3)
    grid = np.stack(np.meshgrid(np.arange(20), np.arange(20), [0]), axis=-1).reshape(-1, 3) * 0.01
    cloud = np.concatenate([grid, grid[:100] + [1.0, 0.0, 0.0], rng.uniform(5, 9, (5, 3))])
    assert [len(cluster) for cluster in euclidean_clusters(cloud)] == [400, 100]
    assert [len(cluster) for cluster in euclidean_clusters(cloud, max_size=200)] == [100]
    for bad, said in BAD:
        with pytest.raises(ValueError, match=said):
            euclidean_clusters(bad)
    with pytest.raises(ValueError, match="min_size"):
        euclidean_clusters(cloud, 0.1, 10, 5)
    with pytest.raises(ValueError, match="tolerance"):
        euclidean_clusters(cloud, -0.1)


def test_means_find_the_blobs_and_their_number() -> None:
    rng = np.random.default_rng(4)
    middles = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 1]], dtype=float)
    cloud = np.concatenate([middle + 0.05 * rng.normal(size=(80, 3)) for middle in middles])
    for found in (kmeans_pp(cloud, 4), x_means(cloud)):
        assert len(found.centers) == 4
        gaps = np.linalg.norm(found.centers[:, None] - middles, axis=-1)
        assert gaps.min(axis=0).max() < 0.03 and np.bincount(found.labels).tolist() == [80] * 4
    assert len(x_means(cloud[:80]).centers) == 1
    assert len(x_means(cloud, kmax=3).centers) <= 3
    with pytest.raises(ValueError, match="k: expected"):
        kmeans_pp(np.ones((10, 3)), 2)
    with pytest.raises(ValueError, match="kmin"):
        x_means(cloud, 3, 2)


def test_projection_hull_and_crop() -> None:
    camera = Intrinsics(200, 100, 100.0, 110.0, 99.0, 49.0)
    points = np.array([[0.1, -0.2, 2.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    pixels = project(points, camera)
    np.testing.assert_allclose(pixels[:2], [[104.0, 38.0], [99.0, 49.0]], atol=1e-9)
    assert np.isnan(pixels[2]).all()
    right = project(points[:1], camera, transform(np.eye(3), [-0.1, 0.0, 0.0]))  # a camera 0.1 m to the right
    np.testing.assert_allclose(pixels[0] - right[0], [100.0 * 0.1 / 2.0, 0.0], atol=1e-9)
    square = np.array([[10, 10], [20, 10], [20, 20], [10, 20], [15, 15], [np.nan, 0]], dtype=float)
    hull = convex_hull(square)
    assert {tuple(corner) for corner in hull} == {(10, 10), (20, 10), (20, 20), (10, 20)}
    image = np.full((100, 200, 3), 7, dtype=np.uint8)
    patch, corner = crop_hull(image, np.array([[10.0, 10.0], [20.0, 10.0], [10.0, 20.0]]))
    assert corner == (10, 10) and patch.shape == (11, 11, 3) and patch[0, 0, 0] == 7 and patch[10, 10, 0] == 0
    with pytest.raises(ValueError, match="hull: expected one that meets"):
        crop_hull(image, hull + 500.0)


def test_principal_frame() -> None:
    rng = np.random.default_rng(5)
    cloud = rng.uniform(-1, 1, (4000, 3)) * [0.1, 0.05, 0.01]
    T = transform(so3_exp([0.4, -0.3, 0.8]), [0.1, 0.2, 1.0])
    frame = pca_frame(transform_points(T, cloud))
    assert np.abs(np.abs((frame[:3, :3].T @ T[:3, :3]).diagonal()) - 1.0).max() < 1e-3
    assert np.linalg.det(frame[:3, :3]) == pytest.approx(1.0) and frame[:3, 2] @ frame[:3, 3] < 0.0
    with pytest.raises(ValueError, match="at least 3"):
        pca_frame(cloud[:2])


def test_boxes_on_a_table_are_detected() -> None:
    table = trimesh.creation.box((3.0, 3.0, 0.02), transform=transform(np.eye(3), [0, 0, -0.01]))
    things = [
        trimesh.creation.box((0.1, 0.08, 0.1), transform=transform(so3_exp([0, 0, 0.3]), [x, y, 0.05]))
        for x, y in ((-0.2, 0.0), (0.15, 0.1))
    ]
    T_c_w = inverse(looking(np.array([0.0, -0.9, 0.7]), np.zeros(3)))
    found = cluster_detections(frame_of(cast(trimesh.util.concatenate([table, *things]), T_c_w)))
    assert len(found) == 2
    for thing in things:
        depth = cast(thing, T_c_w)
        rows, columns = np.nonzero(depth)
        truth = np.array([columns.min(), rows.min(), columns.max(), rows.max()])
        assert min(np.abs(detection.box - truth).max() for detection in found) < 3.0
    assert all(detection.T_c_object is not None for detection in found)
    assert cluster_detections(frame_of(np.zeros((CAMERA.height, CAMERA.width)))) == []


def read_labels(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Labels (N,), points (N, 3) and colours (N, 3) of a compressed PCD file with fields label, x, y, z, rgba."""
    raw = path.read_bytes()
    start = raw.index(b"DATA binary_compressed\n") + len(b"DATA binary_compressed\n")
    packed, size = np.frombuffer(raw[start : start + 8], dtype=np.uint32).tolist()
    data = _decompress_lzf(raw[start + 8 : start + 8 + packed], size)
    n = size // 20
    labels, colors = (np.frombuffer(data[at * n : (at + 4) * n], dtype=np.uint32) for at in (0, 16))
    points = np.frombuffer(data[4 * n : 16 * n], dtype=np.float32).reshape(3, n).T.astype(np.float64)
    kept = np.isfinite(points).all(axis=1)
    rgb = np.stack([colors >> shift & 255 for shift in (16, 8, 0)], axis=1).astype(np.uint8)
    return labels[kept], points[kept], rgb[kept]


@needs_data
def test_objects_on_real_tables() -> None:
    """Every labelled object of the Kinect scenes is one cluster, also the two cylinders that touch."""
    overlaps = []
    for path in sorted((DATA / "clouds_mosd" / "learn").glob("*.pcd")):
        labels, points, colors = read_labels(path)
        parts = segment_objects(points, colors)
        for value in np.unique(labels[labels >= 20] // 10):  # a tens digit an object, units its visible parts
            mask = labels // 10 == value
            best = max(mask[part].sum() / (mask.sum() + len(part) - mask[part].sum()) for part in parts)
            overlaps.append(best)
    assert len(overlaps) == 4 and np.mean(np.array(overlaps) >= 0.5) >= 0.8
