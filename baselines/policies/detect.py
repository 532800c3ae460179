"""Finding objects in flight without a network.

`clusters+icp`: Euclidean clusters over planes and pipes (thesis, section 3.2), recognised by size, outline, relief and
colours; the class's nominal shape, stretched to the cluster and aligned to it by ICP (section 3.3); class and pose are
followed from frame to frame, with what the vehicle's attitude and velocity estimates say of the camera's way.

`features+pnp`: the same, but once a thing was seen for some frames its own image features give its rotation, by PnP.

`oracle-truth` reports what the simulator knows.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.envs.detect_action import detections_to_action, observed_frame, observed_intrinsics
from aerograsp_env.interfaces import RGBD, Detection
from aerograsp_env.spatial import Array, inverse
from baselines.policies.detect_descriptors import Description, describe
from baselines.policies.detect_features import in_start, learn, locate
from baselines.policies.detect_pose import fit_pose
from baselines.policies.detect_proposals import Proposal, find_proposals
from baselines.policies.detect_recognition import NAMES, NOTHING, Forest, shipped
from baselines.policies.detect_rows import Observation, act_by_rows, rows_of
from baselines.policies.detect_tracks import POSITION_NOISE, Odometry, Track, associate, tracker_of

GATE = 0.08  # [m] that a thing's middle may move between frames
FORGET = 0.85  # weight of the evidence so far in each new frame
MISSED = 6  # frames after which a track is dropped
LEAST_SCORE = 0.35  # of what is reported
SETTLED, RELEARN, FEW = 8, 5, 10  # frames before features are learned, and between two learnings; inliers that are few


class RowState(NamedTuple):
    """What is remembered of one world."""

    odometry: Odometry
    tracks: tuple[Track, ...]


class Sight(NamedTuple):
    """One thing as one frame shows it."""

    frame: RGBD
    proposal: Proposal
    description: Description
    T_start_camera: Array  # (4, 4)
    stamp: float  # [s]


class ClusterPolicy:
    """Clusters, recognised and aligned, followed from frame to frame."""

    def __init__(self, recognizer: Forest | None = None) -> None:
        self._recognizer = recognizer

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
        tracks = () if before is None else before.tracks
        frame = seen_frame(observation)
        detections, tracks = self._look(frame, T_start_camera, tracks, odometry.stamp)
        return detections_to_action(detections, frame.intrinsics), RowState(odometry, tracks)

    def _look(
        self, frame: RGBD, T_start_camera: Array, tracks: tuple[Track, ...], stamp: float
    ) -> tuple[list[Detection], tuple[Track, ...]]:
        camera = frame.intrinsics
        proposals = find_proposals(frame, T_start_camera[2, :3], np.random.default_rng(0))
        described = [describe(proposal, 1.0 / (camera.fx * camera.fy)) for proposal in proposals]
        places = np.array([(T_start_camera @ item.T_c_box)[:3, 3] for item in described]).reshape(-1, 3)
        owners = associate(tracks, places, GATE)
        found: list[Detection] = []
        kept = [
            track._replace(missed=track.missed + 1)
            for k, track in enumerate(tracks)
            if k not in owners and track.missed < MISSED
        ]
        for proposal, item, place, owner in zip(proposals, described, places, owners, strict=True):
            track = self._follow(None if owner < 0 else tracks[owner], item, place)
            label, score = _best(track)
            if score >= LEAST_SCORE:
                if track.label != label:
                    track = track._replace(label=label, pose=None, features=None)
                track = self._pose(track, Sight(frame, proposal, item, T_start_camera, stamp))
                assert track.pose is not None
                found.append(Detection(label, score, proposal.box, inverse(T_start_camera) @ track.pose.T))
            kept.append(track)
        return found, tuple(kept)

    def _follow(self, track: Track | None, item: Description, place: Array) -> Track:
        evidence = (self._recognizer or shipped()).log_probabilities(item.features)
        if track is None:
            return Track(place, evidence, 1, 0)
        evidence = FORGET * track.evidence + evidence
        return track._replace(place=place, evidence=evidence, frames=track.frames + 1, missed=0)

    def _pose(self, track: Track, sight: Sight) -> Track:
        """The track with its pose brought up to this frame."""
        seen = fit_pose(track.label, sight.proposal, sight.description).T_c_object
        pose = tracker_of(track.label).update(track.pose, sight.T_start_camera @ seen, sight.stamp)
        return track._replace(pose=pose)


def _best(track: Track) -> tuple[str, float]:
    """The likeliest class of a track, of those that are objects, and its probability."""
    p = np.exp(track.evidence - track.evidence.max())
    p /= p.sum()
    best = int(p[: NAMES.index(NOTHING)].argmax())
    return NAMES[best], float(p[best])


def seen_frame(observation: Observation) -> RGBD:
    """The frame of one observation; of a stereo pair with the depth that block matching finds."""
    if "depth" in observation:
        return observed_frame(observation)
    import cv2

    camera = observed_intrinsics(observation)
    left, right = (cv2.cvtColor(np.asarray(observation[name]), cv2.COLOR_RGB2GRAY) for name in ("rgb", "right"))
    matcher = cv2.StereoSGBM.create(
        minDisparity=0, numDisparities=96, blockSize=5, P1=200, P2=800, disp12MaxDiff=1, uniquenessRatio=5,
        speckleWindowSize=60, speckleRange=2, mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )  # fmt: skip
    disparity = matcher.compute(left, right).astype(np.float32) / 16.0
    reach = camera.fx * float(observation["baseline"][0])
    depth = np.where(disparity > reach / 6.0, reach / np.maximum(disparity, 1e-3), 0.0).astype(np.float32)
    return RGBD(np.asarray(observation["rgb"]), depth, camera)


class FeaturePolicy(ClusterPolicy):
    """Clusters, recognised and first posed as by `ClusterPolicy`; then each thing's own features say how it moves.

    After some frames that show a thing its features are lifted to points by their depth. Later frames are matched
    with them, and the rotation is found by PnP (thesis, section 3.4): it does not depend on a shape that may look the
    same from several sides. The place stays that of the cluster.
    """

    def _pose(self, track: Track, sight: Sight) -> Track:
        found = None
        if track.features is not None and track.pose is not None:
            guess = inverse(sight.T_start_camera) @ tracker_of(track.label).predict(track.pose, sight.stamp).T
            found = locate(track.features, sight.frame, sight.proposal.box, guess)
        if found is None:
            track = super()._pose(track, sight)
        else:  # of small things PnP tells the rotation well, the distance badly
            seen = found.T_c_object.copy()
            seen[:3, 3] = fit_pose(track.label, sight.proposal, sight.description).T_c_object[:3, 3]
            covariance = in_start(found.covariance, sight.T_start_camera)
            covariance[:3], covariance[:, :3] = 0.0, 0.0
            covariance[:3, :3] = POSITION_NOISE**2 * np.eye(3)
            pose = tracker_of(track.label).update(track.pose, sight.T_start_camera @ seen, sight.stamp, covariance)
            track = track._replace(pose=pose)
        few = found is None or found.inliers < FEW
        if few and (track.features is None or track.frames - track.learned >= RELEARN) and track.frames >= SETTLED:
            assert track.pose is not None
            T_c_object = inverse(sight.T_start_camera) @ track.pose.T
            points = sight.proposal.points
            features = learn(sight.frame, sight.proposal.box, points, T_c_object)
            track = track._replace(features=features, learned=track.frames)
        return track


def clusters_icp() -> ClusterPolicy:
    """The policy `clusters+icp`."""
    return ClusterPolicy()


def features_pnp() -> FeaturePolicy:
    """The policy `features+pnp`."""
    return FeaturePolicy()


class TruthOracle:
    """Reports the simulator's truth: an upper bound, and a check that the task can be done."""

    def __init__(self) -> None:
        self._worlds: Sequence[Any] = ()

    def watch(self, worlds: Sequence[Any]) -> None:
        """Be told which unwrapped environments it acts in, row by row."""
        self._worlds = list(worlds)

    def predict(
        self,
        observation: Observation,
        state: Any = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], None]:
        """(action, None); of difficult objects nothing is said.

        Raises:
            ValueError: not told of as many worlds as there are rows.
        """
        rows, batched = rows_of(observation)
        if len(self._worlds) != len(rows):
            raise ValueError(f"watch: expected to be told of {len(rows)} worlds, was told of {len(self._worlds)}")
        actions = []
        for row, world in zip(rows, self._worlds, strict=True):
            true = [true for true in world.truths if not true.difficult]
            found = [Detection(item.label, 1.0, item.box, item.T_c_object) for item in true]
            actions.append(detections_to_action(found, observed_intrinsics(row)))
        return (np.stack(actions) if batched else actions[0]), None


def truth() -> TruthOracle:
    """The oracle `oracle-truth`."""
    return TruthOracle()
