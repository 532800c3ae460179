"""Photographs: how their labels are read; what the shipped detector makes of them, where they are at hand."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from agents.detect_dataset import DetectDataset
from agents.detect_real import TOOLS, YOLO17, read_aiml20, read_rgb, read_yolo17, write_photographs

DATA = Path(os.environ.get("AEROGRASP_DATA", Path(__file__).parents[2] / "shared" / "data"))
needs_data = pytest.mark.skipif(not (DATA / "tools_yolo17").is_dir(), reason="real data not present")


def photographs(folder: Path, rows: str) -> Path:
    for name in ("images", "labels"):
        (folder / "train" / name).mkdir(parents=True)
    cv2.imwrite(str(folder / "train" / "images" / "a.jpg"), np.full((48, 64, 3), 90, dtype=np.uint8))
    (folder / "train" / "labels" / "a.txt").write_text(rows)
    return folder


def test_polygons_and_boxes_become_boxes(tmp_path: Path) -> None:
    rows = "7 0.25 0.25 0.75 0.5 0.5 1.0\n\n13 0.5 0.5 0.25 0.5\n2 0 0 1 0 1 1\n"
    (photo,) = read_yolo17(photographs(tmp_path, rows))
    assert photo.labels == ("hammer", "screwdriver")  # callipers are none of ours
    np.testing.assert_allclose(photo.boxes, [[16, 12, 48, 48], [24, 12, 40, 36]])


@pytest.mark.parametrize("row", ["7 0.1", "99 0 0 1 0 1 1", "7 a b c d e f", "7 0.1 0.2 0.3"])
def test_labels_that_are_none_name_their_line(tmp_path: Path, row: str) -> None:
    with pytest.raises(ValueError, match=r"a\.txt, line 1: expected a (class|box)"):
        read_yolo17(photographs(tmp_path, row))


def test_folders_and_pictures_that_are_missing(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="expected the folder of the photographs"):
        read_yolo17(tmp_path)
    with pytest.raises(FileNotFoundError, match="expected a folder 'hammers'"):
        read_aiml20(tmp_path)
    (tmp_path / "x.jpg").write_bytes(b"\xff\xd8\xff")
    with pytest.raises(ValueError, match=r"x\.jpg: expected a picture"):
        read_rgb(tmp_path / "x.jpg")


def test_photographs_become_a_data_set(tmp_path: Path) -> None:
    found = read_yolo17(photographs(tmp_path / "set", "7 0.25 0.25 0.75 0.5 0.5 1.0\n"))
    dataset = DetectDataset(write_photographs(found, TOOLS, tmp_path / "out"))
    sample = dataset[0]
    assert len(dataset) == 1 and dataset.classes == TOOLS and not sample.depth.any()
    np.testing.assert_allclose(sample.boxes, [[80, 60, 240, 240]])
    assert sample.labels.tolist() == [TOOLS.index("hammer")]


def test_every_class_of_the_set_has_an_answer() -> None:
    assert len(YOLO17) == 17 and set(YOLO17) == {*TOOLS, None}


@needs_data
def test_real_sets_are_read_whole() -> None:
    photos = read_yolo17(DATA / "tools_yolo17")
    labels = [label for photo in photos for label in photo.labels]
    assert len(photos) == 60 and {label: labels.count(label) for label in TOOLS} == {
        "screwdriver": 55,
        "wrench": 89,
        "pliers": 24,
        "hammer": 26,
    }
    for photo in photos:
        assert (photo.boxes[:, :2] < photo.boxes[:, 2:]).all() and (photo.boxes >= -1e-6).all()
    assert len(read_aiml20(DATA / "tools_aiml20")) == 65
