"""Features on real pictures: a box in a scene, and the crawler by the model that its authors made."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from aerograsp_env.interfaces import Intrinsics
from aerograsp_env.metrics import translation_error
from aerograsp_env.spatial import transform_points
from baselines.detection.extraction import extract
from baselines.detection.feature_model import FeatureModel
from baselines.detection.projection import project
from baselines.objects.matching import match_descriptors

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
needs_data = pytest.mark.skipif(not (DATA / "pairs_opencv").is_dir(), reason="real data not present")

CRAWLER_CAMERA = Intrinsics(640, 480, 608.721, 608.530, 322.238, 241.967)
"""Of the pictures' camera, from the calibration that the model's authors published beside it."""


def picture(path: Path) -> np.ndarray:
    return cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB)


@needs_data
def test_the_box_is_found_in_the_scene() -> None:
    box, scene = (picture(DATA / "pairs_opencv" / f"{name}.png") for name in ("box", "box_in_scene"))
    a, b = extract(box, "sift", 3000), extract(scene, "sift", 3000)
    pairs = match_descriptors(a.descriptors, b.descriptors, ratio=0.8)
    cv2.setRNGSeed(0)
    H, inside = cv2.findHomography(a.pixels[pairs.query], b.pixels[pairs.train], cv2.RANSAC, 3.0)
    assert inside.sum() >= 70
    height, width = box.shape[:2]
    corners = np.array([[[0, 0]], [[width, 0]], [[width, height]], [[0, height]]], dtype=np.float64)
    found = cv2.perspectiveTransform(corners, H)[:, 0].astype(np.float32)
    assert cv2.isContourConvex(found) and 10_000 < cv2.contourArea(found) < 40_000
    assert (found > 0).all() and (found < [scene.shape[1], scene.shape[0]]).all()


@needs_data
def test_the_true_homography_of_the_wall_is_found() -> None:
    first, third = (picture(DATA / "pairs_opencv" / f"graf{k}.png") for k in (1, 3))
    storage = cv2.FileStorage(str(DATA / "pairs_opencv" / "H1to3p.xml"), cv2.FILE_STORAGE_READ)
    truth = storage.getNode("H13").mat()
    a, b = extract(first, "sift", 4000), extract(third, "sift", 4000)
    pairs = match_descriptors(a.descriptors, b.descriptors, ratio=0.8)
    moved = cv2.perspectiveTransform(a.pixels[pairs.query][:, None], truth)[:, 0]
    right = np.linalg.norm(moved - b.pixels[pairs.train], axis=1) < 3.0
    assert right.sum() >= 100 and right.mean() > 0.5


@needs_data
def test_the_crawler_is_found_in_all_six_pictures() -> None:
    folder = DATA / "mico_crawler_track"
    model = FeatureModel.read_opencv(folder / "model_crawler_simple_5_fix.xml", "fast+rbrief", "crawler")
    assert len(model) == 92
    poses = []
    for k in range(1, 7):
        image = picture(folder / "test_images" / f"left_{k}.png")
        found = model.locate(image, CRAWLER_CAMERA)
        assert found.T_c_object is not None and found.inliers >= 70 and found.rmse < 1.0
        # The crawler lies in the middle, half a metre away, and its points on it.
        pixels = project(transform_points(found.T_c_object, model.points), CRAWLER_CAMERA)
        assert (pixels > [180, 90]).all() and (pixels < [540, 420]).all()
        assert 0.45 < found.T_c_object[2, 3] < 0.6
        poses.append(found.T_c_object)
    # Neither the camera nor the crawler moved.
    assert translation_error(np.array(poses), poses[0]).max() < 2e-3
