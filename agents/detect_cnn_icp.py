"""The policy `cnn+icp` of Detect-v0: a learned detector's boxes, aligned models, one filter a track.

Thesis, section 3.6.3 and algorithm 2: detect, crop the cloud, align the class's model, filter the pose. Tracks live in
the frame that the flight began in, where objects rest: what the vehicle's attitude and velocity estimates say of the
camera's way moves them in the image. A track's filter has constant acceleration and brings every measurement to the
symmetric pose nearest to its prediction, so that symmetric objects do not flip.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.envs.detect_action import SLOTS, detections_to_action
from aerograsp_env.interfaces import RGBD, Detection
from aerograsp_env.metrics import box_iou
from aerograsp_env.sim.visual import CLASSES
from aerograsp_env.spatial import Array, inverse
from agents.detect_onnx import OnnxDetector, shipped_detector
from agents.detect_posed import followed, measured, predicted, tracker_of
from baselines.detection import BoxPose, PoseTrack
from baselines.policies.detect import seen_frame
from baselines.policies.detect_descriptors import describe
from baselines.policies.detect_pose import fit_pose
from baselines.policies.detect_proposals import Proposal, find_proposals
from baselines.policies.detect_rows import Observation, act_by_rows
from baselines.policies.detect_tracks import FRAME, Odometry

ALIGNED = 2
"""Objects whose poses are measured in each frame: new ones first, then those that waited longest."""
FOUND = 0.35
"""Least score of a detection that is followed, over the detector's own threshold. A track's score must reach all
of that to be reported: what lasts from frame to frame needs less evidence in each."""
KEEP = 0.8
"""Weight of a track's score so far in each new frame."""
LEAST_IOU = 0.2
"""Of a detection with a track's predicted box."""
ON_SUPPORT = ("can", "juice_box", "box", "fruit")
"""Classes whose size varies so much that what one sees of them does not tell where their middle is."""
SAME_THING = 0.6
"""IoU of a detection's box with what stands out from its support, from which both are one thing."""
MISSED = 6
"""Frames after which a track that was not seen is dropped."""


class Track(NamedTuple):
    """One thing seen in several frames."""

    box: Array  # (4,) xyxy in the last frame that showed it [px]
    scores: Array  # (C,) mean of the detector's scores, the last frames counting most
    missed: int  # frames since it was seen
    waited: int  # frames since its pose was measured
    label: str = ""  # class of `pose`
    pose: PoseTrack | None = None  # T_start_object


class RowState(NamedTuple):
    """What is remembered of one world."""

    odometry: Odometry
    tracks: tuple[Track, ...]
    stamp: float  # [s] since the start


class CnnPolicy:
    """Boxes by a network, poses by alignment, followed from frame to frame.

    Args:
        detector: None takes the shipped one.
    """

    def __init__(self, detector: OnnxDetector | None = None) -> None:
        self.detector = OnnxDetector(shipped_detector(), classes=CLASSES) if detector is None else detector

    def predict(
        self,
        observation: Observation,
        state: tuple[RowState | None, ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[RowState | None, ...]]:
        """(action, state): action (184,) or (N, 184) float32 in [−1, 1]."""
        del deterministic
        return act_by_rows(self._act, observation, state, episode_start)

    def _act(self, observation: Observation, before: RowState | None) -> tuple[NDArray[np.float32], RowState]:
        odometry = Odometry.begin() if before is None else before.odometry
        odometry, T_start_camera = odometry.advance(observation, before is None)
        stamp = 0.0 if before is None else before.stamp + FRAME
        frame = seen_frame(observation)
        tracks = self._follow(frame, () if before is None else before.tracks)
        tracks = self._measure(frame, tracks, T_start_camera, stamp)
        least = self.detector.threshold
        found = [detection for track in tracks if (detection := _report(track, T_start_camera, least)) is not None]
        return detections_to_action(found, frame.intrinsics), RowState(odometry, tracks, stamp)

    def _follow(self, frame: RGBD, tracks: Sequence[Track]) -> tuple[Track, ...]:
        """The tracks with this frame's boxes, new ones among them."""
        boxes, scores, labels = self.detector.find(frame.rgb, frame.depth, FOUND * self.detector.threshold)
        inside = (boxes[:, :2] < (frame.intrinsics.width - 2, frame.intrinsics.height - 2)).all(axis=1)
        boxes, scores, labels = boxes[inside], scores[inside], labels[inside]
        boxes, evidence = _merged(boxes, scores, labels)
        iou = box_iou(np.reshape([track.box for track in tracks], (-1, 4)), boxes)
        # A box of the track's own class is preferred to one that merely overlaps as much.
        for k, track in enumerate(tracks):
            iou[k] += 0.2 * (evidence.argmax(axis=1) == track.scores.argmax()) * (iou[k] > 0.0)
        kept, taken = [], set()
        for k in np.argsort(-iou.max(axis=1, initial=0.0)):
            track = tracks[k]
            free = [j for j in np.argsort(-iou[k]) if j not in taken and iou[k, j] >= LEAST_IOU]
            if free:
                taken.add(free[0])
                mixed = KEEP * track.scores + (1.0 - KEEP) * evidence[free[0]]
                kept.append(track._replace(box=boxes[free[0]], scores=mixed, missed=0, waited=track.waited + 1))
            elif track.missed < MISSED:
                kept.append(track._replace(missed=track.missed + 1, waited=track.waited + 1))
        new = [Track(boxes[j], evidence[j], 0, 10**6) for j in range(len(boxes)) if j not in taken]
        return (*kept, *new)

    def _measure(self, frame: RGBD, tracks: Sequence[Track], T_start_camera: Array, stamp: float) -> tuple[Track, ...]:
        """The tracks, some of them with newly measured poses; the others stay where they were: objects rest."""
        seen = [k for k, track in enumerate(tracks) if track.missed == 0]
        turn = sorted(seen, key=lambda k: (-tracks[k].waited, -tracks[k].scores.max()))[:ALIGNED]
        results = list(tracks)
        some = any(CLASSES[int(tracks[k].scores.argmax())] in ON_SUPPORT for k in turn)
        proposals = find_proposals(frame, T_start_camera[2, :3], np.random.default_rng(0)) if some else []
        for k in turn:
            track = tracks[k]
            label = CLASSES[int(track.scores.argmax())]
            pose = track.pose if track.label == label else None
            tracker = tracker_of(label)
            T_init = predicted(tracker, pose, T_start_camera, stamp)
            found = _pose(frame, track.box, label, proposals, T_init)
            if found.T_c_object is not None:
                pose = followed(tracker, pose, found, label, T_start_camera, stamp)
            results[k] = track._replace(label=label, pose=pose, waited=0)
        return tuple(results)


def _pose(frame: RGBD, box: Array, label: str, proposals: Sequence[Proposal], T_init: Array | None) -> BoxPose:
    """The pose of what is in a box, if the depth there shows the class.

    Containers and fruit that stand out from their support are measured on it, which tells how far down their hidden
    side goes; of all others, and where objects touch, the model is aligned with what the box shows.
    """
    iou = box_iou(box[None], np.reshape([proposal.box for proposal in proposals], (-1, 4)))[0]
    if label in ON_SUPPORT and len(iou) and iou.max() >= SAME_THING:
        proposal = proposals[int(iou.argmax())]
        camera = frame.intrinsics
        fit = fit_pose(label, proposal, describe(proposal, 1.0 / (camera.fx * camera.fy)))
        return BoxPose(fit.T_c_object, float(iou.max()), proposal.points)
    return measured(frame, box, label, T_init)


def _merged(boxes: Array, scores: Array, labels: NDArray[np.int64]) -> tuple[Array, Array]:
    """Boxes (K, 4) of different things, and each one's scores (K, C): boxes of several classes on one thing are one."""
    kept: list[int] = []
    evidence: list[Array] = []
    iou = box_iou(boxes, boxes) if len(boxes) else np.zeros((0, 0))
    for k in range(len(boxes)):  # best first
        same = [n for n, j in enumerate(kept) if iou[k, j] > 0.6]
        if same:
            row = evidence[same[0]]
            row[labels[k]] = max(row[labels[k]], scores[k])
        elif len(kept) < SLOTS:
            kept.append(k)
            evidence.append(np.where(np.arange(len(CLASSES)) == labels[k], scores[k], 0.0))
    return np.asarray(boxes)[kept].reshape(-1, 4), np.reshape(evidence, (-1, len(CLASSES)))


def _report(track: Track, T_start_camera: Array, least: float) -> Detection | None:
    score = float(track.scores.max())
    if track.missed or score < least:
        return None
    label = CLASSES[int(track.scores.argmax())]
    T = None
    if track.pose is not None and track.label == label:
        T = inverse(T_start_camera) @ track.pose.T
    return Detection(label, min(score, 1.0), track.box, T)


def cnn_icp() -> CnnPolicy:
    """The policy `cnn+icp`."""
    return CnnPolicy()
