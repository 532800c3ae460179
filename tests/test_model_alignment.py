"""A known object's pose from what a depth camera sees of it."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from detection_clouds import CAMERA, box_of, cast, frame_of, looking, noisy, pose_error, surface_of

from aerograsp_env.sim.objects.crawler import pipe_crawler
from aerograsp_env.spatial import inverse, so3_exp, transform
from baselines.detection import DepthView, ShapeModel, align_model, pose_from_box
from baselines.detection.alignment import best_pose, uniform_rotations
from baselines.objects.depth_points import unproject

SYMMETRIES = np.stack([so3_exp([0.0, 0.0, 2.0 * np.pi / 3.0 * k]) for k in range(3)])


def crawler() -> tuple[trimesh.Trimesh, ShapeModel]:
    shape = pipe_crawler()
    mesh = trimesh.Trimesh(shape.vertices, shape.faces, process=False)
    return mesh, ShapeModel(*surface_of(mesh, 1500), SYMMETRIES)


def test_rotations_cover_all() -> None:
    some = uniform_rotations(256)
    np.testing.assert_allclose(some @ np.swapaxes(some, 1, 2), np.broadcast_to(np.eye(3), some.shape), atol=1e-12)
    probes = uniform_rotations(999)
    traces = np.einsum("aij,bij->ab", some, probes).max(axis=0)
    assert np.degrees(np.arccos(0.5 * (traces.min() - 1.0))) < 45.0


def test_poses_in_any_orientation_are_found_without_a_start() -> None:
    mesh, model = crawler()
    rng = np.random.default_rng(0)
    for _ in range(8):
        T = transform(so3_exp(3.0 * rng.normal(size=3)), [*rng.uniform(-0.1, 0.1, 2), rng.uniform(0.8, 1.3)])
        depth = noisy(cast(mesh, T), rng)
        points, _ = unproject(depth, CAMERA)
        view = DepthView(np.where(depth > 0, depth, 5.0).astype(np.float32), CAMERA)
        result = align_model(points, model, view=view)
        angle, distance = pose_error(result.T_target_source, T, SYMMETRIES)
        assert result.converged and angle < 3.0 and distance < 0.01 and result.inlier_fraction > 0.95


def test_another_object_is_refused() -> None:
    _, model = crawler()
    box = trimesh.creation.box((0.5, 0.35, 0.4))
    depth = cast(box, transform(so3_exp([0.5, 0.4, 0.3]), [0.0, 0.0, 1.2]))
    points, _ = unproject(depth, CAMERA)
    result = align_model(points, model, view=DepthView(np.where(depth > 0, depth, 5.0).astype(np.float32), CAMERA))
    assert not result.converged and np.isnan(result.T_target_source).all()


def test_a_stretched_instance_keeps_its_middle() -> None:
    box = trimesh.creation.box((0.2, 0.1, 0.06))
    points, normals = surface_of(box, 1500)
    longer = trimesh.creation.box((0.26, 0.09, 0.07))
    T = transform(so3_exp([-2.2, 0.5, 0.3]), [0.02, 0.0, 0.8])
    cloud, _ = unproject(noisy(cast(longer, T), np.random.default_rng(0)), CAMERA)
    found = best_pose(cloud, ShapeModel(points, normals, stretch=1.5), T)
    assert np.linalg.norm(found.T[:3, 3] - T[:3, 3]) < 0.008
    np.testing.assert_allclose(found.stretch, [1.3, 0.9, 7.0 / 6.0], atol=0.12)


def test_pose_from_a_box_in_a_frame_with_a_floor() -> None:
    mesh, model = crawler()
    floor = trimesh.creation.box((4.0, 4.0, 0.02), transform=transform(np.eye(3), [0, 0, -0.01]))
    scene = trimesh.util.concatenate([mesh, floor])
    rng = np.random.default_rng(1)
    for angle in (0.3, 2.0, 4.5):
        eye = np.array([0.9 * np.cos(angle), 0.9 * np.sin(angle), 0.8])
        T = inverse(looking(eye, np.zeros(3)))
        depth = noisy(cast(scene, T), rng)
        found = pose_from_box(frame_of(depth), box_of(cast(mesh, T)) + rng.normal(size=4), model)
        assert found.T_c_object is not None and found.score > 0.7
        turn, distance = pose_error(found.T_c_object, T, SYMMETRIES)
        assert turn < 3.0 and distance < 0.01
        again = pose_from_box(frame_of(depth), box_of(cast(mesh, T)), model, T)
        assert again.T_c_object is not None and pose_error(again.T_c_object, T)[0] < 3.0  # no symmetric twin
        empty = pose_from_box(frame_of(depth), [0.0, 0.0, 6.0, 6.0], model)
        assert empty.T_c_object is None and empty.score == 0.0


def test_a_wrong_start_is_disproved_and_a_right_one_is_kept() -> None:
    mesh, model = crawler()
    floor = trimesh.creation.box((4.0, 4.0, 0.02), transform=transform(np.eye(3), [0, 0, -0.01]))
    T = inverse(looking(np.array([0.8, 0.3, 0.8]), np.zeros(3)))
    depth = noisy(cast(trimesh.util.concatenate([mesh, floor]), T), np.random.default_rng(2))
    box = box_of(cast(mesh, T))
    twin = T @ transform(so3_exp([0.0, 0.0, np.pi / 3.0]), np.zeros(3))  # looks nearly alike
    for start, disproved in ((twin, True), (T, False), (None, False)):
        found = pose_from_box(frame_of(depth), box, model, start)
        assert found.T_c_object is not None and found.disproved == disproved
        turn, distance = pose_error(found.T_c_object, T, SYMMETRIES)
        assert turn < 3.0 and distance < 0.01


def test_bad_input_is_named() -> None:
    points = np.random.default_rng(0).normal(size=(50, 3))
    normals = points / np.linalg.norm(points, axis=1, keepdims=True)
    model = ShapeModel(normals, normals)
    for bad, said in (
        (points[:3], "cloud: expected at least 10"),
        (np.full((20, 3), np.nan), "cloud: expected finite"),
    ):
        with pytest.raises(ValueError, match=said):
            align_model(bad, model)
    with pytest.raises(ValueError, match="normals: expected shape"):
        ShapeModel(points, normals[:4])
    with pytest.raises(ValueError, match="normals: expected unit length"):
        ShapeModel(points, 2.0 * normals)
    with pytest.raises(ValueError, match="stretch: expected"):
        ShapeModel(points, normals, stretch=0.5)
    with pytest.raises(ValueError, match="symmetries"):
        ShapeModel(points, normals, 2.0 * np.eye(3)[None])
    frame = frame_of(np.ones((CAMERA.height, CAMERA.width)))
    with pytest.raises(ValueError, match="box: expected x1 < x2"):
        pose_from_box(frame, [10.0, 10.0, 5.0, 20.0], model)
    with pytest.raises(ValueError, match="box: expected one inside"):
        pose_from_box(frame, [900.0, 10.0, 905.0, 20.0], model)
