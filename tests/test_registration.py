"""Registration: known motions come back, honest failure, the four rejectors, and real pairs against their truths."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from detection_clouds import pose_error

from aerograsp_env.spatial import inverse, project_to_so3, se3_exp, so3_exp, transform, transform_points
from baselines.detection import register
from baselines.detection.rejectors import (
    Pairs,
    hsv_cone,
    reject_colors,
    reject_distance,
    reject_normals,
    reject_shared,
)
from baselines.objects import MeshObject, PointCloudObject

DATA = Path(os.environ.get("AEROGRASP_DATA", Path(__file__).parents[2] / "shared" / "data"))
needs_data = pytest.mark.skipif(not (DATA / "clouds_pcl").is_dir(), reason="real data not present")


def bumpy(count: int, rng: np.random.Generator) -> np.ndarray:
    """Points of one uneven surface about 1 m wide; different ones at each call."""
    x, y = rng.uniform(-0.5, 0.5, (2, count))
    return np.stack([x, y, 0.1 * np.sin(8 * x) + 0.1 * np.cos(7 * y) + 0.05 * np.sin(13 * x * y)], axis=1)


TRUE = se3_exp(np.array([0.02, -0.03, 0.01, 0.08, -0.05, 0.1]))


@pytest.mark.parametrize("method", ["icp", "gicp"])
@pytest.mark.parametrize("unit", [1.0, 0.01, 100.0])
def test_a_known_motion_comes_back_at_any_scale(method: str, unit: float) -> None:
    rng = np.random.default_rng(0)
    T = TRUE.copy()
    T[:3, 3] *= unit
    source, target = unit * bumpy(3000, rng), transform_points(T, unit * bumpy(3000, rng))
    result = register(source, target, method=method)
    angle, distance = pose_error(result.T_target_source, T)
    assert result.converged and angle < 0.3 and distance < 2e-3 * unit
    assert result.inlier_fraction > 0.95 and 0 < result.rmse < 0.03 * unit and result.iterations > 1


def test_a_start_is_used_and_the_inverse_swaps_the_clouds() -> None:
    rng = np.random.default_rng(1)
    far = transform(so3_exp([0.0, 0.0, 2.5]), [3.0, 1.0, -2.0])
    source, target = bumpy(2500, rng), transform_points(far, bumpy(2500, rng))
    rough = far @ se3_exp(np.array([0.02, 0.02, -0.02, 0.1, 0.0, -0.1]))
    there = register(source, target, rough)
    back = register(target, source, inverse(rough))
    assert pose_error(there.T_target_source, far)[0] < 0.3
    angle, distance = pose_error(back.T_target_source @ there.T_target_source, np.eye(4))
    assert angle < 0.3 and distance < 5e-3


def test_what_fails_says_so() -> None:
    rng = np.random.default_rng(2)
    cloud = bumpy(1000, rng)
    flat = np.concatenate([rng.uniform(-0.5, 0.5, (1000, 2)), np.zeros((1000, 1))], axis=1)
    ball = rng.normal(size=(1000, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    for source, target in ((cloud, cloud + 50.0), (flat, flat + [0.05, 0.0, 0.0]), (ball, ball @ so3_exp([0.1, 0, 0]))):
        for method in ("icp", "gicp"):
            result = register(source, target, method=method)
            assert not result.converged and np.isnan(result.T_target_source).all()


def colored_plane(rng: np.random.Generator, T: np.ndarray) -> PointCloudObject:
    x, y = rng.uniform(-0.5, 0.5, (2, 5000))
    colors = 128 + 100 * np.stack([np.sin(9 * x) * np.cos(7 * y), np.sin(11 * y), np.cos(6 * x + 2)], axis=1)
    points = np.stack([x, y, 0.002 * rng.normal(size=x.size)], axis=1)
    return PointCloudObject(transform_points(T, points), colors=colors.astype(np.uint8))


def test_colors_hold_a_plane_that_shapes_let_slide() -> None:
    rng = np.random.default_rng(3)
    source, target = colored_plane(rng, np.eye(4)), colored_plane(rng, TRUE)
    result = register(source, target, method="color")
    angle, distance = pose_error(result.T_target_source, TRUE)
    assert result.converged and angle < 0.5 and distance < 0.005
    with pytest.raises(ValueError, match="source: expected a PointCloudObject with colors"):
        register(source.points, target, method="color")


def test_bad_input_is_named() -> None:
    cloud = bumpy(100, np.random.default_rng(4))
    broken = cloud.copy()
    broken[3, 1] = np.nan
    for bad, said in (
        (np.empty((0, 3)), "source: expected at least 10 points, got 0"),
        (cloud[:3], "source: expected at least 10 points, got 3"),
        (broken, "source: expected finite values, got nan"),
        (cloud[:, :2], r"source: expected shape \(\.\.\., 3\), got \(100, 2\)"),
        (np.ones((20, 3)), "source: expected points that differ"),
    ):
        with pytest.raises(ValueError, match=said):
            register(bad, cloud)
    with pytest.raises(ValueError, match="target: expected at least 10"):
        register(cloud, cloud[:3])
    with pytest.raises(ValueError, match="method: expected"):
        register(cloud, cloud, method="ndt")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="T_init: expected"):
        register(cloud, cloud, 2.0 * np.eye(4))
    with pytest.raises(ValueError, match="gate: expected a positive number"):
        register(cloud, cloud, gate=-1.0)


def test_rejectors() -> None:
    pairs = Pairs(np.array([0, 1, 2, 3]), np.array([5, 5, 6, 7]), np.array([0.2, 0.1, 0.3, 0.1]))
    assert reject_distance(pairs, 0.2).source.tolist() == [0, 1, 3]
    assert reject_shared(pairs).source.tolist() == [1, 2, 3]
    normals = np.tile([0.0, 0.0, 1.0], (8, 1))
    tilted = normals.copy()
    tilted[6], tilted[7] = [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]  # a right angle, and the same plane's other side
    assert reject_normals(pairs, normals, tilted, 0.7).source.tolist() == [0, 1, 3]
    colors = np.zeros((8, 3))
    colors[7, 2] = 0.5
    assert reject_colors(pairs, np.zeros((8, 3)), colors, 0.25).source.tolist() == [0, 1, 2]


def test_the_cone_of_colors_has_no_seam() -> None:
    red, almost, green, gray, black = np.array(
        [[255, 0, 0], [255, 0, 5], [0, 255, 0], [100, 100, 100], [0, 0, 0]], dtype=np.uint8
    )
    cone = hsv_cone(np.stack([red, almost, green, gray, black]))
    np.testing.assert_allclose(cone[0], [1.0, 0.0, 1.0], atol=1e-12)
    assert np.linalg.norm(cone[0] - cone[1]) < 0.03  # hues 0° and 359°
    np.testing.assert_allclose(cone[2], [-0.5, np.sqrt(0.75), 1.0], atol=1e-12)
    np.testing.assert_allclose(cone[3], [0.0, 0.0, 100 / 255], atol=1e-12)
    np.testing.assert_allclose(cone[4], 0.0)


# --- real data --------------------------------------------------------------------------------------------------------


@needs_data
@pytest.mark.parametrize("method", ["icp", "gicp"])
def test_lidar_pair(method: str) -> None:
    """A KITTI pair with the pose that its authors give; its clouds are thinned to 0.25 m by their own example."""
    folder = DATA / "reg_small_gicp"
    truth = np.loadtxt(folder / "T_target_source.txt")
    truth[:3, :3] = project_to_so3(truth[:3, :3])
    source, target = (PointCloudObject.from_file(folder / f"{name}.ply", scale=1.0) for name in ("source", "target"))
    result = register(source, target, method=method)
    angle, distance = pose_error(result.T_target_source, truth)
    assert result.converged and angle < 0.5 and distance < 0.03


def matched_pose(a: np.ndarray, b: np.ndarray, limit: float) -> np.ndarray:
    """The pose that most of the matched points (N, 3) agree on, by sampling three at a time."""

    def solve(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        R = project_to_so3((b - b.mean(axis=0)).T @ (a - a.mean(axis=0)))
        return transform(R, b.mean(axis=0) - R @ a.mean(axis=0))

    rng = np.random.default_rng(0)
    most, near = 0, np.zeros(len(a), dtype=bool)
    for _ in range(3000):
        three = rng.choice(len(a), 3, replace=False)
        inside = np.linalg.norm(transform_points(solve(a[three], b[three]), a) - b, axis=1) < limit
        if inside.sum() > most:
            most, near = inside.sum(), inside
    return solve(a[near], b[near])


def displacement(points: np.ndarray, T: np.ndarray, truth: np.ndarray) -> float:
    """Root mean square [m] of how far apart two poses put the points."""
    gaps = transform_points(T, points) - transform_points(truth, points)
    return float(np.sqrt((gaps**2).sum(axis=1).mean()))


@needs_data
def test_object_in_a_scene() -> None:
    """The truth is what the set's own matches agree on: 79 of 189 pairs, good to some millimetres; the points are 4 to
    5 mm apart. Starts are 15° and a few centimetres off."""
    folder = DATA / "reg_teaser_object_scene"
    clouds = [PointCloudObject.from_file(folder / f"matcher-test-{name}-1.ply").points for name in ("object", "scene")]
    matches = np.loadtxt(folder / "matcher-test-matches-1.csv", delimiter=",", dtype=int) - 1
    truth = matched_pose(clouds[0][matches[:, 0]], clouds[1][matches[:, 1]], 0.015)
    rng = np.random.default_rng(0)
    middle = clouds[0].mean(axis=0)
    for _ in range(4):
        turn = rng.normal(size=3)
        R = so3_exp(np.radians(15) * turn / np.linalg.norm(turn))
        about = transform(R, middle - R @ middle + 0.01 * rng.normal(size=3))
        result = register(clouds[0], clouds[1], truth @ about)
        assert result.converged and displacement(clouds[0], result.T_target_source, truth) < 0.0065


# The whole model in the frame of the scan `bun000`: the middle of its bounding box (lowest, highest corner of
# bun_zipper.ply); and the pose of `bun045` in that frame. Both are the Stanford 3D scanning repository's; the latter is
# bun.conf's "-0.0520211 -0.000383981 -0.0109223 0.00548449 -0.294635 -0.0038555 0.955586" (translation, quaternion
# xyzw), whose quaternion is of the inverse rotation.
BUNNY_MIDDLE = 0.5 * (np.array([-0.0946899, 0.0329874, -0.0618736]) + [0.0610091, 0.187321, 0.0587997])
BUN045 = transform(
    so3_exp(2 * np.arccos(0.955586) * np.array([-0.00548449, 0.294635, 0.0038555]) / np.sqrt(1 - 0.955586**2)),
    np.array([-0.0520211, -0.000383981, -0.0109223]),
)


@needs_data
@pytest.mark.parametrize("view", ["bun0", "bun01", "bun02", "bun03", "bun4"])
def test_bunny_views_on_the_mesh(view: str) -> None:
    """The mesh is 0.6 times the scanner's model, turned about x and centred; truths are published, not fitted here."""
    path = DATA / "meshes_grasping_tools" / "gpis_grasping" / "samples" / "bun_zipper.ply"
    model = MeshObject.from_file(path)
    vertices = model.vertices / 0.6
    triangles = vertices[model.faces]
    rng = np.random.default_rng(0)
    areas = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1)
    chosen = triangles[rng.choice(len(areas), 20000, p=areas / areas.sum())]
    weights = rng.dirichlet(np.ones(3), len(chosen))
    surface = np.einsum("nk,nki->ni", weights, chosen)
    turn = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    truth = transform(turn, 0.5 * (vertices.min(axis=0) + vertices.max(axis=0)) - turn @ BUNNY_MIDDLE)
    if view == "bun4":
        truth = truth @ BUN045
    points = PointCloudObject.from_file(DATA / "clouds_pcl" / f"{view}.pcd").points
    middle = points.mean(axis=0)
    for _ in range(4):
        axis = rng.normal(size=3)
        R = so3_exp(np.radians(15) * axis / np.linalg.norm(axis))
        rough = truth @ transform(R, middle - R @ middle + 0.005 * rng.normal(size=3))
        result = register(points, surface, rough)
        assert result.converged
        off = inverse(truth) @ result.T_target_source
        assert pose_error(off, np.eye(4))[0] < 1.0
        assert np.linalg.norm(transform_points(off, middle) - middle) < 0.002
