"""Feature models: learned from drawn stereo pictures, located, half hidden too; files, failures and errors."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from feature_pictures import CAMERA, HEIGHT, WIDTH, board_points, draw_board, hide_half, poster

from aerograsp_env import spatial as sp
from aerograsp_env.interfaces import RGBD, Detector
from aerograsp_env.metrics import rotation_error, translation_error
from baselines.detection.feature_detector import FeatureDetector
from baselines.detection.feature_learning import (
    LearnedModel,
    LearningError,
    learn_feature_model,
    learn_from_rgbd,
    learn_from_stereo,
)
from baselines.detection.feature_model import FeatureModel
from baselines.detection.stereo_features import FrameFeatures, StereoRig

RIG = StereoRig.rectified(CAMERA, 0.08)
POSTER = poster(7)


def way(count: int) -> np.ndarray:
    """(count, 4, 4) T_c_board along a path that turns and nears."""
    s = np.linspace(-1.0, 1.0, count)
    turns = np.column_stack([0.15 * np.cos(3.0 * s), 0.45 * s, 0.1 * s])
    places = np.column_stack([0.03 * s, 0.02 * np.cos(2.0 * s), 0.46 + 0.04 * s])
    return sp.transform(sp.so3_exp(turns), places)


def pictures(poses: np.ndarray, rng: np.random.Generator | None = None) -> list[tuple[np.ndarray, np.ndarray]]:
    pairs = []
    for k, T in enumerate(poses):
        pair = [draw_board(POSTER, T_side @ T, k) for T_side in (np.eye(4), RIG.T_right_left)]
        if rng is not None:
            pair = [np.clip(p + rng.normal(0.0, 3.0, p.shape), 0, 255).astype(np.uint8) for p in pair]
        pairs.append((pair[0], pair[1]))
    return pairs


def near(rng: np.random.Generator, shift: float = 0.02, turn: float = 0.15) -> np.ndarray:
    """T_c_board (4, 4) about the middle of the way."""
    twist = np.concatenate([rng.normal(0.0, shift, 3), rng.normal(0.0, turn, 3)])
    return way(3)[1] @ sp.se3_exp(twist)


def learn(feature: str, count: int = 7) -> LearnedModel:
    poses = way(count)
    masks = [board_points(T) > 0 for T in poses]
    pairs = pictures(poses, np.random.default_rng(0))
    return learn_from_stereo(pairs, RIG, feature, masks, 400, T_c_object=poses, name="board")


@pytest.fixture(scope="module")
def learned() -> LearnedModel:
    return learn("sift")


def synthetic(rng: np.random.Generator, poses: np.ndarray, noise: float, scale: float = 1.0) -> list[FrameFeatures]:
    """Frames that see random points, with descriptors that tell them apart; depth is wrong by a factor."""
    points, descriptors = rng.uniform(-0.1, 0.1, (80, 3)), rng.uniform(0.0, 255.0, (80, 128)).astype(np.float32)
    frames = []
    for T in poses:
        rows = rng.permutation(80)[:60]
        points_c = sp.transform_points(T, points[rows])
        pixels = points_c[:, :2] / points_c[:, 2:] * CAMERA.fx + [CAMERA.cx, CAMERA.cy]
        frames.append(
            FrameFeatures(
                pixels + noise * rng.standard_normal(pixels.shape),
                scale * points_c * (1.0 + 0.005 * rng.standard_normal((60, 1))),
                descriptors[rows],
            )
        )
    return frames


@pytest.mark.parametrize("feature", ["fast+sift", "orb", "fast+brief"])
def test_a_model_is_learned_with_every_kind_of_feature(feature: str) -> None:
    found = learn(feature)
    assert len(found.model) > 25 and found.frames == tuple(range(7)) and not found.skipped
    assert (found.views >= 3).all() and found.rmse < 1.5
    assert found.scale == pytest.approx(1.0, abs=0.1) and found.scale_spread < 0.02
    x, y, z = found.model.points.T
    assert np.median(np.abs(z)) < 2e-3  # the board is flat, at z = 0, and of its size
    assert np.abs(x).max() < 0.5 * WIDTH + 5e-3 and np.abs(y).max() < 0.5 * HEIGHT + 5e-3
    assert translation_error(found.T_c_object, way(7)).max() < 6e-3


def test_the_scale_is_that_of_the_depths() -> None:
    poses = way(6)
    one = learn_feature_model(synthetic(np.random.default_rng(1), poses, 0.2), CAMERA, "sift")
    two = learn_feature_model(synthetic(np.random.default_rng(1), poses, 0.2, scale=2.0), CAMERA, "sift")
    ratio = np.linalg.norm(two.model.points, axis=1).mean() / np.linalg.norm(one.model.points, axis=1).mean()
    assert ratio == pytest.approx(2.0, rel=1e-2)
    assert one.model.points.std(axis=0).mean() == pytest.approx(0.2 / np.sqrt(12.0), rel=0.1)


def test_the_board_is_found_from_new_sides(learned: LearnedModel) -> None:
    rng = np.random.default_rng(3)
    for k in range(5):
        T = near(rng)
        pose = learned.model.locate(draw_board(POSTER, T, 50 + k), CAMERA)
        assert pose.T_c_object is not None and pose.covariance is not None and pose.reason == ""
        assert translation_error(pose.T_c_object, T) < 6e-3 and rotation_error(pose.T_c_object, T) < 0.04
        assert pose.inliers == len(pose.points) == len(pose.pixels) and pose.rmse < 2.0


def test_half_hidden_it_stays_within_two_centimetres(learned: LearnedModel) -> None:
    rng = np.random.default_rng(4)
    errors = []
    for k in range(12):
        T = near(rng)
        picture = hide_half(draw_board(POSTER, T, 80 + k), T, rng.uniform(-np.pi, np.pi), k)
        pose = learned.model.locate(picture, CAMERA)
        errors.append(np.inf if pose.T_c_object is None else float(translation_error(pose.T_c_object, T)))
    assert (np.array(errors) < 0.02).mean() >= 0.9, errors


def test_where_it_is_not_it_is_not_found(learned: LearnedModel) -> None:
    for k in range(3):
        wall = cv2.resize(poster(300 + k), (CAMERA.width, CAMERA.height), interpolation=cv2.INTER_AREA)
        for guess in (None, way(3)[1]):
            pose = learned.model.locate(wall, CAMERA, T_guess=guess)
            assert pose.T_c_object is None and pose.covariance is None and pose.reason and np.isnan(pose.rmse)
    blank = learned.model.locate(np.zeros((240, 320), dtype=np.uint8), CAMERA)
    assert blank.T_c_object is None and blank.matches == 0


def test_the_covariance_is_honest(learned: LearnedModel) -> None:
    rng = np.random.default_rng(5)
    ratios = []
    for k in range(8):
        T = near(rng)
        pose = learned.model.locate(draw_board(POSTER, T, 150 + k), CAMERA)
        assert pose.T_c_object is not None and pose.covariance is not None
        gap = pose.T_c_object[:3, 3] - T[:3, 3]
        ratios.append(np.sqrt(gap @ np.linalg.solve(pose.covariance[:3, :3], gap) / 3.0))
    assert 0.3 < np.median(ratios) < 3.0  # of pixel noise alone; the model's own errors come on top


def test_bad_frames_are_left_out_and_named() -> None:
    frames = synthetic(np.random.default_rng(6), way(7), 0.2)
    frames[3] = frames[3]._replace(descriptors=np.random.default_rng(9).uniform(0, 255, (60, 128)).astype(np.float32))
    empty = FrameFeatures(np.empty((0, 2)), np.empty((0, 3)), np.empty((0, 128), dtype=np.float32))
    found = learn_feature_model([empty, *frames], CAMERA, "sift")
    assert [i for i, _ in found.skipped] == [0, 4] and found.frames == (1, 2, 3, 5, 6, 7)
    with pytest.raises(LearningError, match="3 or more that fit together, got 2 of 2"):
        learn_feature_model(frames[:2], CAMERA, "sift")
    with pytest.raises(LearningError, match="got 0"):
        learn_from_rgbd([])


def test_depth_frames_give_a_model_too() -> None:
    poses = way(6)
    frames = []
    for k, T in enumerate(poses):
        normal, x = T[:3, 2], T[:3, 3]
        v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
        rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(u.shape)], axis=-1)
        depth = np.where(board_points(T) > 127, (normal @ x) / (rays @ normal), 0.0).astype(np.float32)
        frames.append(RGBD(draw_board(POSTER, T, k), depth, CAMERA))
    found = learn_from_rgbd(frames, "sift", T_c_object=poses[0], name="board")
    assert found.scale == pytest.approx(1.0, abs=0.02) and np.median(np.abs(found.model.points[:, 2])) < 3e-3


def test_a_detector_of_models(learned: LearnedModel) -> None:
    detector = FeatureDetector([learned.model])
    assert isinstance(detector, Detector)
    T = way(3)[1]
    frame = RGBD(draw_board(POSTER, T, 60), np.zeros((240, 320), dtype=np.float32), CAMERA)
    (found,) = detector.detect(frame)
    assert found.label == "board" and 0.5 < found.score < 1.0 and found.T_c_object is not None
    rows, columns = np.nonzero(board_points(T) > 127)
    np.testing.assert_allclose(found.box, [columns.min(), rows.min(), columns.max(), rows.max()], atol=15.0)
    with pytest.raises(ValueError, match="models: expected at least one"):
        FeatureDetector([])


def test_matches_by_hand() -> None:
    descriptors = np.zeros((4, 32), dtype=np.uint8)
    descriptors[1], descriptors[2], descriptors[3] = 255, 254, 15
    model = FeatureModel(np.eye(3), descriptors, "orb", owners=np.array([0, 1, 1, 2]))
    given = np.array([[0] * 32, [255] * 32, [254] * 32, [3] * 32], dtype=np.uint8)
    rows, points = model.match(given)
    # Both 255 and 254 are point 1's own; the first to be nearest has it. 3 is as far from 0 as from 15.
    assert rows.tolist() == [0, 1] and points.tolist() == [0, 1]


def test_a_model_comes_back_from_its_file(learned: LearnedModel, tmp_path: Path) -> None:
    learned.model.save(tmp_path / "board.npz")
    again = FeatureModel.load(tmp_path / "board.npz")
    for name in ("points", "descriptors", "owners"):
        np.testing.assert_array_equal(getattr(again, name), getattr(learned.model, name))
    assert (again.feature, again.name) == ("sift+sift", "board")


def test_opencv_storage_is_read(learned: LearnedModel, tmp_path: Path) -> None:
    path = tmp_path / "model.yml"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    points, descriptors = np.arange(12.0).reshape(4, 3), np.arange(128, dtype=np.uint8).reshape(4, 32)
    storage.write("points", points)
    storage.write("descriptors", descriptors)
    storage.release()
    model = FeatureModel.read_opencv(path, "orb")
    np.testing.assert_array_equal(model.points, points)
    np.testing.assert_array_equal(model.descriptors, descriptors)
    with pytest.raises(ValueError, match=r"model\.yml: descriptors: expected \(M, 128\) float32 for sift\+sift"):
        FeatureModel.read_opencv(path, "sift")
    path.write_text("points: [1, 2")
    with pytest.raises(ValueError, match=r"model\.yml: expected"):
        FeatureModel.read_opencv(path, "orb")
    with pytest.raises(FileNotFoundError, match=r"none\.xml"):
        FeatureModel.read_opencv(tmp_path / "none.xml", "orb")


def test_errors_are_one_line(learned: LearnedModel, tmp_path: Path) -> None:
    model = learned.model
    (tmp_path / "not.npz").write_bytes(b"PK\x03\x04 not a model")
    np.savez(tmp_path / "other.npz", points=np.zeros((3, 3)))
    for name in ("not.npz", "other.npz"):
        with pytest.raises(ValueError, match=f"{name}: expected a feature model") as caught:
            FeatureModel.load(tmp_path / name)
        assert "\n" not in str(caught.value)
    with pytest.raises(ValueError, match="image: expected 320×240 px as the intrinsics say, got 100×100"):
        model.locate(np.zeros((100, 100, 3), dtype=np.uint8), CAMERA)
    with pytest.raises(ValueError, match="image: expected uint8"):
        model.locate(np.zeros((240, 320, 3)), CAMERA)
    with pytest.raises(ValueError, match="ratio"):
        model.locate(np.zeros((240, 320, 3), dtype=np.uint8), CAMERA, ratio=0.0)
    with pytest.raises(ValueError, match=r"descriptors: expected \(F, 128\) float32"):
        model.match(np.zeros((5, 32), dtype=np.uint8))
    with pytest.raises(ValueError, match=r"descriptors: expected \(M, 32\) uint8 for orb\+orb"):
        FeatureModel(model.points, model.descriptors, "orb")
    with pytest.raises(ValueError, match=r"points: expected shape \(N, 3\)"):
        FeatureModel(np.empty((0, 3)), np.empty((0, 32), dtype=np.uint8), "orb")
    with pytest.raises(ValueError, match="owners: expected one point for each"):
        FeatureModel(np.eye(3), np.zeros((4, 32), dtype=np.uint8), "orb")
    with pytest.raises(ValueError, match=r"frames\[0\]: expected descriptors of orb"):
        learn_feature_model(synthetic(np.random.default_rng(0), way(3), 0.0), CAMERA, "orb")
    with pytest.raises(ValueError, match="masks: expected one for each of 2"):
        learn_from_stereo(pictures(way(2)), RIG, masks=[None])
