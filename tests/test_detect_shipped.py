"""The detector that comes with the package: what it is, how fast, and what it finds in rendered and real pictures."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from aerograsp_env.sim.visual import CLASSES
from agents.detect_onnx import OnnxDetector, shipped_detector
from agents.detect_real import read_aiml20, read_yolo17, score_aiml20, score_yolo17

DATA = Path(os.environ.get("AEROGRASP_DATA", Path(__file__).parents[2] / "shared" / "data"))
needs_data = pytest.mark.skipif(not (DATA / "tools_yolo17").is_dir(), reason="real data not present")


@pytest.fixture(scope="module")
def detector() -> OnnxDetector:
    return OnnxDetector(shipped_detector(), classes=CLASSES)


def test_it_is_small_and_says_what_it_is(detector: OnnxDetector) -> None:
    path = shipped_detector()
    card = json.loads(path.with_suffix(".json").read_text())
    assert path.stat().st_size < 8e6 and card["family"] == "yolo" and card["input"] == "rgbd"
    assert tuple(card["classes"]) == detector.card.classes == CLASSES
    assert "/tmp" not in path.with_suffix(".json").read_text()


@needs_data
def test_photographs_that_it_never_saw(detector: OnnxDetector) -> None:
    boxes = score_yolo17(detector, read_yolo17(DATA / "tools_yolo17"))
    top = score_aiml20(detector, read_aiml20(DATA / "tools_aiml20"))
    assert boxes.overall.map50 >= 0.25 and boxes.overall.objects == 194
    assert top.rate > 0.55 and top.photographs == 65
