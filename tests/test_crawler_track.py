"""The crawler's pose in flight: a tiny run, and what its tables are made of."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from aerograsp_env.interfaces import RGBD, Intrinsics
from aerograsp_env.metrics import TrueObject
from aerograsp_env.sim.visual import CLASSES
from aerograsp_env.spatial import so3_exp, transform
from agents.crawler_flights import LABEL, METHODS, Frame, detected_boxes, fly, inside, true_boxes
from agents.crawler_track import main, picture, summary, table

CAMERA = Intrinsics(320, 240, 280.0, 280.0, 159.5, 119.5)


def frame() -> RGBD:
    return RGBD(np.zeros((240, 320, 3), np.uint8), np.ones((240, 320), np.float32), CAMERA)


def row(flight: int, position: float, rotation: float, turn: float | None) -> Frame:
    T = None if turn is None else transform(so3_exp([0.0, 0.0, turn]), np.zeros(3))
    return Frame(flight, "pass", 0, 0.0, 1.0, position, rotation, True, T)


def test_a_flight_is_followed_by_every_method() -> None:
    flights = fly("easy", 1, 2_000_001, {"true": true_boxes(np.random.default_rng(0))}, frames=3)
    assert set(flights.frames) == {("true", name) for name in METHODS}
    assert flights.left == (0, 0) and len(flights.pictures) == 1
    for rows in flights.frames.values():
        assert [one.time for one in rows] == pytest.approx([0.0, 0.1, 0.2])
        assert all(one.good and one.motion == "hover" for one in rows)
    assert "alone, then ekf" in table(flights) and picture(flights).startswith(b"\x89PNG")


def test_shares_and_jumps_are_counted_by_hand() -> None:
    third = 2.0 * np.pi / 3.0
    rows = [
        row(0, 0.001, 0.01, 0.0),
        row(0, 0.001, 0.01, third),  # a symmetric twin: right, but a jump
        row(0, 0.02, 0.01, third),  # too far
        row(0, np.inf, np.inf, None),  # no pose: the next is compared with the one before
        row(1, 0.001, np.radians(6.0), -third),  # turned too far; another flight: no jump
        row(1, 0.0099, np.radians(4.9), -third),
    ]
    s = summary(rows)
    assert s["good"] == pytest.approx(3 / 6) and s["posed"] == pytest.approx(5 / 6)
    assert (s["tracks"], s["jumps"], s["jumping_tracks"]) == (2, 1, 1)
    assert s["interval"] == (0.5, 0.5)  # both flights have as many
    with pytest.raises(ValueError, match="frames: expected at least one"):
        summary([])


def test_boxes_are_the_crawlers() -> None:
    crawlers = [
        TrueObject(LABEL, np.array([10.0, 10.0, 60.0, 60.0])),
        TrueObject(LABEL, np.array([200.0, 90, 260, 150])),
    ]

    class Detector:
        threshold = 0.3

        def find(self, rgb: Any, depth: Any, threshold: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            boxes = np.array([[12.0, 12, 60, 62], [11.0, 11, 59, 61], [200.0, 90, 260, 150]])
            return boxes, np.full(3, 0.9), np.array([CLASSES.index(LABEL)] * 2 + [CLASSES.index("can")])

    first, second = detected_boxes(Detector())(frame(), crawlers)
    assert first is not None and first[0] == 11.0  # the one that overlaps most
    assert second is None  # another class
    boxes = true_boxes(np.random.default_rng(0))(frame(), crawlers)
    for box, true in zip(boxes, crawlers, strict=True):
        assert box is not None and 0.0 < np.abs(box - true.box).max() < 10.0
    np.testing.assert_array_equal(inside(np.array([-5.0, 100.0, 400.0, 300.0]), frame()), [0.0, 100.0, 319.0, 239.0])
    assert inside(np.array([-9.0, 10.0, -2.0, 20.0]), frame()) is None


def test_the_command_writes_what_it_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    def few(level: str, flights: int, seed: int, sources: Any) -> Any:
        return fly(level, flights, seed, sources, frames=2)

    monkeypatch.setattr("agents.crawler_track.fly", few)
    out = tmp_path / "run"
    assert main(["--out", str(out), "--flights", "1", "--seed", "2000001", "--boxes", "true"]) == 0
    data = json.loads((out / "crawler-track.json").read_text())
    assert data["seed"] == 2_000_001 and set(data["methods"]) == {f"true: {name}" for name in METHODS}
    assert (out / "crawler-track.txt").read_text().strip() in capsys.readouterr().out
    assert (out / "crawler-track.png").stat().st_size > 10_000
    with pytest.raises(SystemExit):
        main(["--flights", "0"])
