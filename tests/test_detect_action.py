"""The layouts of Detect-v0: detections as actions, images as observations."""

from __future__ import annotations

import numpy as np
import pytest

from aerograsp_env import spatial as sp
from aerograsp_env.envs import detect_action as code
from aerograsp_env.interfaces import Detection, Intrinsics
from aerograsp_env.sim.visual import CLASSES

CAMERA = Intrinsics(320, 240, 257.0, 257.0, 159.5, 119.5)


def drawn(rng: np.random.Generator, pose: bool = True) -> Detection:
    corner, size = rng.uniform(0, 200, 2) * [1.0, 0.7], rng.uniform(5, 90, 2)
    T = sp.transform(sp.so3_exp(rng.normal(size=3)), rng.uniform([-1, -1, 0.3], [1, 1, 3])) if pose else None
    return Detection(str(rng.choice(CLASSES)), float(rng.uniform(0.05, 1)), np.array([*corner, *(corner + size)]), T)


@pytest.mark.parametrize("pose", [True, False])
def test_what_is_reported_comes_back(pose: bool) -> None:
    rng = np.random.default_rng(0)
    for count in range(9):
        given = sorted((drawn(rng, pose) for _ in range(count)), key=lambda d: -d.score)
        action = code.detections_to_action(given, CAMERA)
        assert action.shape == (code.ACTION_SIZE,) == (184,) and action.dtype == np.float32
        assert np.abs(action).max(initial=0.0) <= 1.0
        back = code.action_to_detections(action, CAMERA)
        assert [d.label for d in back] == [d.label for d in given]
        for a, b in zip(back, given, strict=True):
            assert a.score == pytest.approx(b.score, abs=1e-6)
            np.testing.assert_allclose(a.box, b.box, atol=1e-4)  # single precision over the image's width
            if b.T_c_object is None or a.T_c_object is None:
                assert a.T_c_object is b.T_c_object
            else:
                np.testing.assert_allclose(a.T_c_object, b.T_c_object, atol=2e-6)


def test_the_whole_image_is_a_full_box_and_the_best_eight_are_kept() -> None:
    rng = np.random.default_rng(1)
    whole = Detection("can", 1.0, np.array([0.0, 0.0, 320.0, 240.0]))
    row = code.detections_to_action([whole], CAMERA)[: code.SLOT_SIZE]
    np.testing.assert_array_equal(row[10:14], [-1, -1, 1, 1])
    np.testing.assert_array_equal(row[14:], 0.0)
    beyond = Detection("can", 0.0, np.array([-50.0, -50.0, 500.0, 500.0]))
    assert code.action_to_detections(code.detections_to_action([beyond], CAMERA), CAMERA)[0].score == pytest.approx(
        1e-3
    )
    np.testing.assert_array_equal(code.detections_to_action([beyond], CAMERA)[10:14], [-1, -1, 1, 1])
    many = [drawn(rng) for _ in range(20)]
    kept = code.action_to_detections(code.detections_to_action(many, CAMERA), CAMERA)
    best = sorted((d.score for d in many), reverse=True)[:8]
    np.testing.assert_allclose([d.score for d in kept], best, atol=1e-6)


def test_the_layout_names_what_the_codec_writes() -> None:
    layout = code.action_layout()
    assert len(layout) == code.ACTION_SIZE and layout[: code.SLOT_SIZE] * code.SLOTS == layout
    names = [dimension.name for dimension in layout[: code.SLOT_SIZE]]
    T = sp.transform(np.eye(3), [0.3, -0.6, 1.5])
    row = code.detections_to_action([Detection("hammer", 0.5, np.array([10.0, 20.0, 30.0, 40.0]), T)], CAMERA)
    said = dict(zip(names, row[: code.SLOT_SIZE].tolist(), strict=True))
    assert said["presence"] == 0.5
    assert [name for name in names if name.startswith("is_") and said[name] > 0] == ["is_hammer"]
    scale = {dimension.name: dimension.scale for dimension in layout}
    position = [said[f"position_{axis}"] * scale[f"position_{axis}"] for axis in "xyz"]
    np.testing.assert_allclose(position, T[:3, 3], atol=1e-6)
    assert [said[f"{c}_axis_{a}"] for c in "xy" for a in "xyz"] == [1, 0, 0, 0, 1, 0]


def test_what_says_nothing_is_no_detection_or_no_pose() -> None:
    action = np.zeros(184)
    assert code.action_to_detections(action, CAMERA) == []
    action[0], action[3], action[10:14] = 0.7, 0.1, (0.5, 0.5, -0.5, -0.5)  # corners in the other order
    (found,) = code.action_to_detections(action, CAMERA)
    assert found.label == CLASSES[2] and found.T_c_object is None
    np.testing.assert_allclose(found.box, [80, 60, 240, 180])
    action[17:23] = [0.2, 0, 0, 0.5, 0, 0]  # parallel axes
    assert code.action_to_detections(action, CAMERA)[0].T_c_object is None
    action[17:23] = [0.2, 0, 0, 0.5, 0.1, 0]  # made orthonormal
    T = code.action_to_detections(action, CAMERA)[0].T_c_object
    assert T is not None
    np.testing.assert_allclose(T[:3, :3], np.eye(3), atol=1e-12)
    action[12] = action[10]  # no width
    assert code.action_to_detections(action, CAMERA) == []
    assert code.action_to_detections(np.full(184, 9.0), CAMERA) == []  # ±1 at most: boxes without area


def test_bad_actions_and_detections_are_refused() -> None:
    with pytest.raises(ValueError, match="action: expected shape"):
        code.action_to_detections(np.zeros(100), CAMERA)
    with pytest.raises(ValueError, match="action: expected finite"):
        code.action_to_detections(np.full(184, np.nan), CAMERA)
    with pytest.raises(ValueError, match=r"labels among .*got 'cat'"):
        code.detections_to_action([Detection("cat", 1.0, np.array([0.0, 0, 1, 1]))], CAMERA)
    far = sp.transform(np.eye(3), [0, 0, 7.0])
    with pytest.raises(ValueError, match=r"within ±6\.0 m"):
        code.detections_to_action([Detection("can", 1.0, np.array([0.0, 0, 1, 1]), far)], CAMERA)


def test_an_observation_gives_its_frame_back() -> None:
    rng = np.random.default_rng(2)
    rgb, depth = rng.integers(0, 255, (24, 32, 3), dtype=np.uint8), rng.random((24, 32)).astype(np.float32)
    observation = {"rgb": rgb, "depth": depth.ravel(), "intrinsics": np.array([30, 31, 15.5, 11.5], np.float32)}
    frame = code.observed_frame(observation, 1.5)
    np.testing.assert_array_equal(frame.depth, depth)
    assert frame.intrinsics == Intrinsics(32, 24, 30.0, 31.0, 15.5, 11.5) and frame.stamp == 1.5
    with pytest.raises(ValueError, match="stereo"):
        code.observed_frame({"rgb": rgb, "right": rgb, "intrinsics": observation["intrinsics"]})
