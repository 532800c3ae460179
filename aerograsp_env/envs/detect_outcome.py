"""What Detect-v0's frames are worth: rewards of the newest, metrics and success of all so far."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from aerograsp_env.interfaces import Detection
from aerograsp_env.metrics import FrameScore, TrueObject, count_jumps, score_frame, summarize
from aerograsp_env.rewards import tolerance
from aerograsp_env.spatial import Array

LEAST_F1 = 0.7
LARGEST_ERROR = 0.02  # [m]
POSITION_MARGIN, ROTATION_MARGIN = 0.05, np.radians(30.0)  # [m], [rad]
TERMS = {"dense": ("found", "position", "rotation"), "sparse": ("within",)}


def reward_terms(frame: FrameScore | None, reward_mode: str) -> dict[str, float]:
    """The newest frame's terms; zeros before there is one."""
    if frame is None:
        return dict.fromkeys(TERMS[reward_mode], 0.0)
    f1, needed = frame_f1(frame), len(frame.needed)
    errors = np.array([[match.position_error, match.rotation_error] for match in frame.matches]).reshape(-1, 2)
    errors = np.where(np.isnan(errors), np.inf, errors)
    if reward_mode == "sparse":
        within = f1 >= LEAST_F1 and (not needed or float(np.median(errors[:, 0])) <= LARGEST_ERROR)
        return {"within": float(within)}
    near = [
        sum(float(tolerance(error, margin=margin, sigmoid="linear")) for error in column if np.isfinite(error))
        for column, margin in zip(errors.T, (POSITION_MARGIN, ROTATION_MARGIN), strict=True)
    ]
    return {
        "found": 0.5 * f1,
        "position": 0.25 * near[0] / max(needed, 1),
        "rotation": 0.25 * near[1] / max(needed, 1),
    }


def frame_f1(frame: FrameScore) -> float:
    """F1 of one frame at IoU 0.5; 1 where nothing is to be found and nothing was reported."""
    true, reported = int((frame.found[0] >= 0).sum()), int((frame.found[0] >= -1).sum())
    total = reported + len(frame.needed)
    return 2.0 * true / total if total else 1.0


class Outcome:
    """The scores of an episode's frames so far."""

    def __init__(self, reward_mode: str) -> None:
        self._reward_mode = reward_mode
        self._frames: list[FrameScore] = []
        self._last: dict[int, tuple[int, Array]] = {}  # object → frame and T_world_object by its last match
        self._jumps = 0

    def add(self, detections: Sequence[Detection], truths: Sequence[TrueObject], T_world_camera: Array) -> None:
        """One more frame, taken at T_world_camera; `truths` in the order of the scene's objects' identities."""
        frame = score_frame(detections, truths)
        now = len(self._frames)
        for match in frame.matches:
            T_c_object = detections[match.detection].T_c_object
            if T_c_object is None:
                continue
            T, key = T_world_camera @ T_c_object, truths[match.truth].identity
            before = self._last.get(key)
            if before is not None and before[0] == now - 1:
                self._jumps += count_jumps(np.stack([before[1], T]))
            self._last[key] = now, T
        self._frames.append(frame)

    def metrics(self) -> tuple[dict[str, float], bool]:
        """The metrics that are defined, and whether the episode so far is a success."""
        if not any(frame.needed for frame in self._frames):
            return {}, False
        summary = summarize(self._frames)
        named = {name: float(value) for name, value in summary._asdict().items() if name != "per_class"}
        named["jumps"] = float(self._jumps)
        success = summary.f1 >= LEAST_F1 and summary.position_error <= LARGEST_ERROR
        return {name: value for name, value in named.items() if np.isfinite(value)}, bool(success)

    def info(self, termination: str) -> dict[str, Any]:
        """What `step` and `reset` say of it."""
        metrics, success = self.metrics()
        return {
            "success": success and not termination,
            "reward_terms": reward_terms(self._frames[-1] if self._frames else None, self._reward_mode),
            "metrics": metrics,
            "termination": termination,
        }
