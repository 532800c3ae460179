"""Detections with poses scored over frames, against values worked by hand."""

from __future__ import annotations

import numpy as np
import pytest

from aerograsp_env import metrics as m
from aerograsp_env import spatial as sp
from aerograsp_env.interfaces import Detection

CORNERS = 0.1 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
CUBE = m.PoseModel(CORNERS, 0.2 * np.sqrt(3.0), np.eye(3)[None])
QUARTERS = sp.so3_exp(np.outer([0.0, np.pi / 2, np.pi, -np.pi / 2], [0.0, 0.0, 1.0]))
BOX, OTHER, THIRD = [0.0, 0.0, 10.0, 10.0], [20.0, 20.0, 30.0, 30.0], [40.0, 0.0, 50.0, 10.0]


def pose(x: float = 0.0, turn: float = 0.0) -> np.ndarray:
    return sp.transform(sp.so3_exp([0.0, 0.0, turn]), [x, 0.0, 1.0])


def true(label: str, box: list[float], model: m.PoseModel | None = CUBE, difficult: bool = False) -> m.TrueObject:
    return m.TrueObject(label, np.array(box), None if model is None else pose(), model, difficult)


def found(label: str, score: float, box: list[float], T: np.ndarray | None = None) -> Detection:
    return Detection(label, score, np.array(box), T)


def test_difficult_objects_are_neither_reward_nor_fault() -> None:
    boxes, scores = [BOX, BOX, OTHER, THIRD], [0.9, 0.8, 0.7, 0.6]
    taken = m.assign_detections(boxes, scores, [BOX, OTHER], difficult=[False, True])
    np.testing.assert_array_equal(taken, [0, m.MISSED, m.IGNORED, m.MISSED])
    # Of a difficult object any number of detections counts neither way.
    np.testing.assert_array_equal(m.assign_detections([BOX, BOX], [0.9, 0.8], [BOX], 0.5, [True]), [m.IGNORED] * 2)
    np.testing.assert_array_equal(m.match_detections(boxes, scores, [BOX, OTHER]), [True, False, True, False])
    # Hits 0.9 and 0.5 of 2 and a miss at 0.6: ½·1 + ½·2/3; the difficult one's detection at 0.7 is gone.
    detections = [([BOX, OTHER, BOX, THIRD], [0.9, 0.7, 0.6, 0.5], ["can"] * 4)]
    truths = [([BOX, OTHER, THIRD], ["can"] * 3)]
    result = m.mean_average_precision(detections, truths, difficult=[[False, True, False]])
    assert result.mean == pytest.approx(0.5 + 0.5 * 2 / 3)
    with pytest.raises(ValueError, match="difficult: expected one flag for each of 3"):
        m.mean_average_precision(detections, truths, difficult=[[False]])
    with pytest.raises(ValueError, match="at least one true object"):
        m.mean_average_precision(detections, truths, difficult=[[True] * 3])


def test_a_frame_by_hand() -> None:
    truths = [true("can", BOX), true("can", OTHER), true("box", THIRD), true("fruit", THIRD, difficult=True)]
    detections = [
        found("can", 0.9, BOX, pose(0.01)),  # right
        found("can", 0.8, [0.0, 0.0, 10.0, 6.0], pose()),  # a second one of the same object
        found("can", 0.7, [20.0, 20.0, 30.0, 26.0], pose(0.5, 1.0)),  # right by its box at 0.5, IoU 0.6, not by pose
        found("fruit", 0.6, THIRD, pose()),  # difficult
        found("hammer", 0.5, THIRD, pose()),  # wrong class
    ]
    frame = m.score_frame(detections, truths)
    np.testing.assert_array_equal(frame.found, [[0, m.MISSED, 1, m.IGNORED, m.MISSED], [0, -1, -1, m.IGNORED, -1]])
    assert frame.needed == ("can", "can", "box")
    assert [(match.detection, match.truth) for match in frame.matches] == [(0, 0), (2, 1)]
    near, far = frame.matches
    assert (near.position_error, far.position_error) == pytest.approx((0.01, 0.5))
    assert (near.rotation_error, far.rotation_error) == pytest.approx((0.0, 1.0), abs=1e-12)
    assert near.add_s == pytest.approx(0.01) and near.add_s_passed  # a shift by less than half the corners' distance
    assert not far.add_s_passed
    summary = m.summarize([frame])
    # Of three objects two were found, of four detections that count two were right.
    assert (summary.recall, summary.precision, summary.f1) == pytest.approx((2 / 3, 0.5, 4 / 7))
    assert summary.add_s == pytest.approx(1 / 3)
    assert summary.position_error == pytest.approx(0.255)
    # can at 0.5: hit, miss, hit of 2; at 0.75: hit, miss, miss of 2; box: none.
    assert summary.per_class["can"] == pytest.approx({"map50": 0.5 + 0.5 * 2 / 3, "map75": 0.5, "recall": 1.0})
    assert summary.per_class["box"] == pytest.approx({"map50": 0.0, "map75": 0.0, "recall": 0.0})
    assert summary.map50 == pytest.approx((0.5 + 1 / 3) / 2) and summary.map75 == pytest.approx(0.25)


def test_frames_are_pooled_as_mean_average_precision_pools_images(rng: np.random.Generator) -> None:
    frames, images, truths, flags = [], [], [], []
    for _ in range(12):
        objects, detections = [], []
        for k in range(rng.integers(1, 5)):
            corner = np.array([60.0 * k, 0.0]) + rng.uniform(0, 5, 2)
            label = str(rng.choice(["can", "box", "fruit"]))
            objects.append(true(label, [*corner, *(corner + 40)], None, bool(rng.random() < 0.2)))
            moved = corner + rng.uniform(0, 15, 2)
            detections.append(found(str(rng.choice([label, "can"])), rng.random(), [*moved, *(moved + 40)]))
        frames.append(m.score_frame(detections, objects))
        images.append(([d.box for d in detections], [d.score for d in detections], [d.label for d in detections]))
        truths.append(([t.box for t in objects], [t.label for t in objects]))
        flags.append([t.difficult for t in objects])
    summary = m.summarize(frames)
    for name, threshold in (("map50", 0.5), ("map75", 0.75)):
        expected = m.mean_average_precision(images, truths, threshold, flags)
        assert getattr(summary, name) == pytest.approx(expected.mean, abs=1e-12)
        assert {k: v[name] for k, v in summary.per_class.items()} == pytest.approx(expected.per_class, abs=1e-12)
    assert 0.0 < summary.map75 < summary.map50 < 1.0


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(3)


def test_symmetric_objects_are_not_blamed_for_what_cannot_be_seen() -> None:
    square = m.PoseModel(CORNERS, CUBE.diameter, QUARTERS)
    turned = found("box", 1.0, BOX, pose(0.0, np.pi / 2 + 0.1))
    plain, symmetric = (m.score_frame([turned], [true("box", BOX, model)]).matches[0] for model in (CUBE, square))
    assert plain.rotation_error == pytest.approx(np.pi / 2 + 0.1)
    assert symmetric.rotation_error == pytest.approx(0.1)
    # The corners move by 2 r sin(0.05) to the nearest one, r = 0.1 √2.
    assert symmetric.add_s == pytest.approx(2 * 0.1 * np.sqrt(2) * np.sin(0.05))


def test_boxes_without_poses_are_scored_as_boxes() -> None:
    frame = m.score_frame([found("can", 0.9, BOX)], [true("can", BOX)])
    summary = m.summarize([frame])
    assert summary.f1 == 1.0 and summary.add_s == 0.0 and summary.position_error == np.inf
    both = m.summarize([frame, m.score_frame([found("can", 0.9, BOX, pose())], [true("can", BOX)])] * 2 + [frame])
    assert both.position_error == np.inf  # three of five have no pose: their median has none either
    boxes_only = m.summarize([m.score_frame([found("can", 0.9, BOX, pose())], [true("can", BOX, None)])])
    assert boxes_only.map50 == 1.0 and boxes_only.add_s == 0.0


def test_nothing_found_and_nothing_there() -> None:
    nothing = m.summarize([m.score_frame([], [true("can", BOX)])])
    assert (nothing.map50, nothing.recall, nothing.f1, nothing.add_s) == (0.0, 0.0, 0.0, 0.0)
    assert np.isnan(nothing.precision) and np.isnan(nothing.position_error)
    empty = m.score_frame([found("can", 0.9, BOX)], [])
    with pytest.raises(ValueError, match="frames: expected at least one true object"):
        m.summarize([empty])
    # A false alarm in an empty frame counts all the same.
    summary = m.summarize([empty, m.score_frame([found("can", 0.8, BOX)], [true("can", BOX)])])
    assert summary.precision == 0.5 and summary.map50 == 0.5


def test_bad_models_are_refused() -> None:
    with pytest.raises(ValueError, match="diameter"):
        m.PoseModel(CORNERS, 0.0, np.eye(3)[None])
    with pytest.raises(ValueError, match="symmetries: expected shape"):
        m.PoseModel(CORNERS, 1.0, np.eye(3))
    with pytest.raises(ValueError, match="points"):
        m.PoseModel(np.zeros((0, 3)), 1.0, np.eye(3)[None])
    with pytest.raises(ValueError, match="model with the pose of object 0 \\('can'\\)"):
        m.score_frame([], [m.TrueObject("can", np.array(BOX), pose())])


def test_jumps_of_a_track() -> None:
    steps = np.radians([0.0, 10.0, 20.0, 80.0, 90.0, 50.0])
    track = np.stack([pose(0.0, float(a)) for a in steps])
    assert m.count_jumps(track) == 2
    assert m.count_jumps(track, np.radians(5.0)) == 5
    assert m.count_jumps(track[:1]) == 0
    with pytest.raises(ValueError, match="angle"):
        m.count_jumps(track, 30.0)
    with pytest.raises(ValueError, match="track: expected shape"):
        m.count_jumps(track[0])
