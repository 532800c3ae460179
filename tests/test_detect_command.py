"""`aerograsp detect` on pictures, folders and data sets, with a detector that finds what is red."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

import agents.detect_onnx
from aerograsp_env.interfaces import RGBD, Detection
from agents.detect import frame_of, main

RED_AT = (8, 6, 20, 16)  # x1, y1, x2, y2 [px]


class FindsRed:
    """Stands in for the network."""

    def __init__(self, path: Path, threshold: float | None = None) -> None:
        self.threshold = 0.5 if threshold is None else threshold

    def detect(self, frame: RGBD) -> list[Detection]:
        rows, columns = np.nonzero((frame.rgb[..., 0] > 150) & (frame.rgb[..., 1] < 80))
        if not len(rows) or self.threshold > 0.9:
            return []
        box = [columns.min() - 0.5, rows.min() - 0.5, columns.max() + 0.5, rows.max() + 0.5]
        return [Detection("can", 0.9, np.array(box))]


@pytest.fixture(autouse=True)
def detector(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(agents.detect_onnx, "OnnxDetector", FindsRed)
    monkeypatch.setattr(agents.detect_onnx, "shipped_detector", lambda: Path("none.onnx"))


def picture() -> np.ndarray:
    rgb = np.full((24, 32, 3), 90, dtype=np.uint8)
    x1, y1, x2, y2 = RED_AT
    rgb[y1:y2, x1:x2] = (220, 20, 20)
    return rgb


def written(path: Path, rgb: np.ndarray) -> Path:
    path.parent.mkdir(exist_ok=True)
    assert cv2.imwrite(str(path), rgb[..., ::-1] if rgb.ndim == 3 else rgb)
    return path


def test_one_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image, out, report = written(tmp_path / "red.png", picture()), tmp_path / "out.png", tmp_path / "out.json"
    assert main([str(image), "--out", str(out), "--json", str(report)]) == 0
    assert "can" in capsys.readouterr().out
    frames = json.loads(report.read_text())["frames"]
    assert [frame["image"] for frame in frames] == ["red"]
    np.testing.assert_allclose(frames[0]["detections"][0]["box"], np.array(RED_AT) - 0.5)
    assert frames[0]["detections"][0]["T_c_object"] is None
    drawn = cv2.imread(str(out))
    assert drawn is not None and (drawn[..., ::-1] != picture()).any()


def test_nothing_found_is_no_failure(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(written(tmp_path / "grey.png", np.full((24, 32, 3), 90, np.uint8)))]) == 0
    assert "0 objects in 1 frames" in capsys.readouterr().out


def test_a_folder_goes_on_without_its_bad_pictures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("a", "b", "c"):
        written(tmp_path / "in" / f"{name}.png", picture())
    code = (tmp_path / "in" / "b.png").read_bytes()
    (tmp_path / "in" / "b.png").write_bytes(code[: len(code) // 2])
    assert main([str(tmp_path / "in"), "--out", str(tmp_path / "out")]) == 0
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["a.png", "c.png"]
    text = capsys.readouterr().out
    assert "2 objects in 2 frames" in text and "b.png: expected a whole picture" in text


def test_a_data_set_brings_its_depth(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    depth = np.full((24, 32), 1000, dtype=np.uint16)
    for number in range(3):
        written(tmp_path / "color" / f"{number}.png", picture())
        written(tmp_path / "depth" / f"{number}.png", depth)
    (tmp_path / "camera-intrinsics.txt").write_text("30 0 15.5\n0 30 11.5\n0 0 1\n")
    report = tmp_path / "out.json"
    assert main([str(tmp_path), "--frames", "2", "--json", str(report)]) == 0
    assert len(json.loads(report.read_text())["frames"]) == 2


def test_depth_without_a_camera_and_of_another_size() -> None:
    rgb, depth = picture(), np.ones((24, 32), dtype=np.float32)
    with pytest.raises(ValueError, match="--intrinsics: expected FX FY CX CY with --depth"):
        frame_of(rgb, depth, None)
    with pytest.raises(ValueError, match="--depth: expected an image of the colour image's 32 × 24 px, got 16 × 24"):
        frame_of(rgb, depth[:, :16], (30, 30, 15.5, 11.5))
    assert frame_of(rgb, depth, (30, 31, 15.5, 11.5)).intrinsics.fy == 31


@pytest.mark.parametrize(
    "arguments, words",
    [
        (["none.png"], "SOURCE: no such file or folder"),
        (["{folder}"], "expected an RGB-D data set"),
        (["{image}", "--out", "x.jpg"], "--out: expected a name that ends in .png"),
        (["{image}", "--depth", "{image}"], "depth picture of 16 bits"),
        (["{text}"], "expected a whole picture"),
    ],
)
def test_mistakes_are_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments, words: str) -> None:
    image = written(tmp_path / "pictures" / "red.png", picture())
    (tmp_path / "empty").mkdir()
    text = tmp_path / "text.png"
    text.write_text("words")
    names = {"folder": tmp_path / "empty", "image": image, "text": text}
    assert main([argument.format(**names) for argument in arguments]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and words in error
