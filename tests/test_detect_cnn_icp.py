"""The policy cnn+icp: poses of what a detector finds, tracks that last, observations of any batch."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from aerograsp_env.envs.detect import DetectEnv
from aerograsp_env.envs.detect_action import ACTION_SIZE, action_to_detections, observed_intrinsics
from aerograsp_env.sim.visual import CLASSES
from agents.detect_cnn_icp import MISSED, CnnPolicy, _merged
from agents.policies import load_policy


class Boxes:
    """A detector that knows the true boxes of a world."""

    threshold = 0.3

    def __init__(self) -> None:
        self.world: Any = None
        self.blind = False

    def find(self, rgb: Any, depth: Any, threshold: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        true = [] if self.blind else [item for item in self.world.truths if not item.difficult]
        labels = np.array([CLASSES.index(item.label) for item in true], dtype=np.int64)
        return np.reshape([item.box for item in true], (-1, 4)), np.full(len(true), 0.9), labels


@pytest.fixture(scope="module")
def flown() -> tuple[DetectEnv, CnnPolicy, Boxes, list[dict], list[np.ndarray], list[Any], list[list[Any]]]:
    env = DetectEnv(level="easy", labels=("can", "box"), wind="calm")
    boxes = Boxes()
    boxes.world = env
    policy = CnnPolicy(boxes)  # type: ignore[arg-type]  # it finds boxes like an OnnxDetector
    observation, _ = env.reset(seed=7)
    observations, actions, states, truths = [observation], [], [None], []
    for _ in range(8):
        action, state = policy.predict(observation, states[-1])
        truths.append(list(env.truths))
        observation, *_ = env.step(action)
        observations.append(observation)
        actions.append(action)
        states.append(state)
    return env, policy, boxes, observations, actions, states, truths


def test_poses_are_near_the_truth(flown: Any) -> None:
    _, _, _, observations, actions, _, truths = flown
    errors = []
    for observation, action, true in zip(observations, actions, truths, strict=False):
        found = action_to_detections(action, observed_intrinsics(observation))
        needed = [item for item in true if not item.difficult]
        assert len(found) == len(needed) > 0
        for item in needed:
            nearest = min(found, key=lambda detection: np.abs(detection.box - item.box).max())
            assert nearest.label == item.label and np.abs(nearest.box - item.box).max() < 1e-3
            if nearest.T_c_object is not None:
                errors.append(np.linalg.norm(nearest.T_c_object[:3, 3] - item.T_c_object[:3, 3]))
    assert len(errors) >= 6 and np.median(errors) < 0.03


def test_a_track_outlives_a_few_blind_frames_and_no_more(flown: Any) -> None:
    _, policy, boxes, observations, _, states, _ = flown
    state = states[-1]
    boxes.blind = True
    for frame in range(MISSED + 1):
        action, state = policy.predict(observations[-1], state)
        assert not action_to_detections(action, observed_intrinsics(observations[-1]))  # not seen: not reported
        assert bool(state[0].tracks) == (frame < MISSED)
    boxes.blind = False


def test_state_is_never_changed_and_rows_do_not_mix(flown: Any) -> None:
    _, policy, boxes, observations, _, states, _ = flown
    boxes.blind = True
    stacked = {name: np.stack([observations[2][name]] * 2) for name in observations[2]}
    before = (states[2][0], None)
    batch, after = policy.predict(stacked, before, np.array([False, True]))
    single, _ = policy.predict(observations[2], (states[2][0],))
    fresh, _ = policy.predict(observations[2], None)
    boxes.blind = False
    assert batch.shape == (2, ACTION_SIZE) and batch.dtype == np.float32 and len(after) == 2
    np.testing.assert_array_equal(batch[0], single)
    np.testing.assert_array_equal(batch[1], fresh)
    assert states[2][0].stamp == pytest.approx(0.1) and after[0].stamp == pytest.approx(0.2)


def test_it_is_known_by_name() -> None:
    assert isinstance(load_policy("aerograsp/Detect-v0", "cnn+icp"), CnnPolicy)


def test_boxes_of_several_classes_on_one_thing_are_one() -> None:
    boxes = np.array([[0, 0, 10, 10], [0, 0, 10, 9.5], [40, 40, 50, 50]], dtype=float)
    kept, evidence = _merged(boxes, np.array([0.9, 0.6, 0.5]), np.array([1, 2, 0]))
    np.testing.assert_array_equal(kept, boxes[[0, 2]])
    assert evidence[0, 1] == 0.9 and evidence[0, 2] == 0.6 and evidence[1, 0] == 0.5 and evidence.sum() == 2.0
    kept, evidence = _merged(np.zeros((0, 4)), np.zeros(0), np.zeros(0, dtype=np.int64))
    assert kept.shape == (0, 4) and evidence.shape == (0, len(CLASSES))
