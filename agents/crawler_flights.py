"""Flights past a crawler in `aerograsp/Detect-v0`, its pose measured and filtered in several ways at once.

The vehicle and its camera are the environment's, and so is the way from box to pose, that of the policy cnn+icp: the
cloud in a box, the crawler's model aligned with it, a filter in the frame in which the flight began, to which the
vehicle's own attitude and velocity estimates lead.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from aerograsp_env.envs.detect import FRAMES, DetectEnv
from aerograsp_env.envs.detect_action import observed_frame
from aerograsp_env.envs.detect_motion import MOTIONS
from aerograsp_env.envs.detect_view import draw_detections
from aerograsp_env.interfaces import RGBD, Detection
from aerograsp_env.metrics import TrueObject, box_iou, rotation_error, translation_error
from aerograsp_env.sim.visual import CLASSES
from aerograsp_env.spatial import Array, inverse
from agents.detect_posed import followed, measured, predicted, tracker_of
from baselines.detection import BoxPose, PoseTrack
from baselines.policies.detect_tracks import FRAME, Odometry

LABEL = "crawler"
POSITION, ROTATION = 0.01, np.radians(5.0)  # of a good pose [m], [rad]
BOX_NOISE = 2.0  # of the edges of a true box [px]
LEAST_IOU = 0.5  # of a detector's box with the true one
FORGOTTEN = 6  # frames out of sight after which a crawler is another one
METHODS = ("alone", "alone, then ekf", "ekf", "ukf", "particle")
PICTURES = 3

Boxes = Callable[[RGBD, Sequence[TrueObject]], list[Array | None]]


class Frame(NamedTuple):
    """One crawler in one frame, and what one method said of it."""

    flight: int
    motion: str
    crawler: int
    time: float  # [s]
    distance: float  # from the camera [m]
    position: float  # error [m]; infinite without a pose
    rotation: float  # error [rad], up to the symmetries; infinite without a pose
    boxed: bool  # whether there was a box
    T_world_object: Array | None  # (4, 4) as estimated, seen from the true camera

    @property
    def good(self) -> bool:
        """Whether the pose is within 1 cm and 5°."""
        return self.position <= POSITION and self.rotation <= ROTATION


class Left(NamedTuple):
    """What does not count, in crawlers × frames."""

    difficult: int  # less than 40 % visible, or very small
    unseen: int  # out of the picture, or wholly hidden


class Flights(NamedTuple):
    """What some flights showed."""

    frames: dict[tuple[str, str], list[Frame]]  # by source of the boxes, and method
    left: Left
    pictures: list[NDArray[np.uint8]]


def true_boxes(rng: np.random.Generator) -> Boxes:
    """The true boxes with normal noise of 2 px."""

    def boxes(frame: RGBD, crawlers: Sequence[TrueObject]) -> list[Array | None]:
        return [inside(true.box + BOX_NOISE * rng.standard_normal(4), frame) for true in crawlers]

    return boxes


def detected_boxes(detector: Any) -> Boxes:
    """Each crawler's best box of those that a detector takes for crawlers."""

    def boxes(frame: RGBD, crawlers: Sequence[TrueObject]) -> list[Array | None]:
        found, _, labels = detector.find(frame.rgb, frame.depth, detector.threshold)
        found = found[labels == CLASSES.index(LABEL)]
        if not len(found):
            return [None] * len(crawlers)
        iou = box_iou(np.array([true.box for true in crawlers]), found)
        best = iou.argmax(axis=1)
        return [
            inside(found[j], frame) if iou[k, j] >= LEAST_IOU and iou[:, j].argmax() == k else None
            for k, j in enumerate(best)
        ]

    return boxes


def inside(box: Array, frame: RGBD) -> Array | None:
    """What of a box lies in the picture."""
    camera = frame.intrinsics
    cut = np.clip(box, 0.0, np.tile([camera.width - 1.0, camera.height - 1.0], 2))
    return cut if (cut[:2] < cut[2:]).all() else None


class Follower:
    """All methods on one crawler and one source of boxes."""

    def __init__(self) -> None:
        self.tracks: dict[str, PoseTrack | None] = dict.fromkeys(METHODS[1:])
        self.trackers = {name: tracker_of(LABEL, name.split()[-1]) for name in METHODS[1:]}
        self.missed = 0

    def see(self, frame: RGBD, box: Array | None, T_start_camera: Array, stamp: float) -> dict[str, Array | None]:
        """T_start_object (4, 4) by method."""
        self.missed = 0
        alone = BoxPose(None, 0.0, np.empty((0, 3))) if box is None else measured(frame, box, LABEL)
        out = {"alone": None if alone.T_c_object is None else T_start_camera @ alone.T_c_object}
        for name, track in self.tracks.items():
            tracker, found = self.trackers[name], alone
            if name in ("ekf", "ukf", "particle") and box is not None and track is not None:
                found = measured(frame, box, LABEL, predicted(tracker, track, T_start_camera, stamp))
            track = followed(tracker, track, found, LABEL, T_start_camera, stamp)
            self.tracks[name], out[name] = track, None if track is None else track.T
        return out

    def miss(self) -> None:
        """A frame that does not show the crawler well enough to count."""
        self.missed += 1
        if self.missed > FORGOTTEN:
            self.tracks = dict.fromkeys(self.tracks)


def fly(level: str, flights: int, seed: int, sources: Mapping[str, Boxes], frames: int = FRAMES) -> Flights:
    """Fly and follow every crawler that is seen; the motions take turns."""
    from tqdm import tqdm

    out: dict[tuple[str, str], list[Frame]] = {(source, name): [] for source in sources for name in METHODS}
    difficult, unseen, pictures = 0, 0, []
    for flight in tqdm(range(flights), desc=level, unit="flight", disable=None):
        motion = MOTIONS[1:][flight % 3]
        env: Any = gymnasium.make("aerograsp/Detect-v0", labels=(LABEL,), motion=motion, level=level)
        world: DetectEnv = env.unwrapped
        observation, _ = env.reset(seed=seed + flight)
        odometry = Odometry.begin()
        followers: dict[tuple[str, int], Follower] = {}
        for k in range(frames):
            odometry, T_start_camera = odometry.advance(observation, k == 0)
            frame, there = observed_frame(observation), [true for true in world.truths if true.label == LABEL]
            seen = {true.identity: true for true in there if not true.difficult}
            difficult += len(there) - len(seen)
            unseen += len({identity for _, identity in followers} - {true.identity for true in there})
            shown = []
            for source, boxes in sources.items():
                for true, box in zip(seen.values(), boxes(frame, list(seen.values())) if seen else [], strict=True):
                    follower = followers.setdefault((source, true.identity), Follower())
                    poses = follower.see(frame, box, T_start_camera, k * FRAME)
                    for name, T in poses.items():
                        T_c = None if T is None else inverse(T_start_camera) @ T
                        T_w = None if T_c is None else world.T_world_camera @ T_c
                        facts = (flight, motion, true.identity, k * FRAME)
                        out[source, name].append(Frame(*facts, *_errors(T_c, true), box is not None, T_w))
                        if name == "ekf" and source == next(iter(sources)):
                            shown.append(Detection(LABEL, 1.0, true.box, T_c))
                for key, follower in followers.items():
                    if key[0] == source and key[1] not in seen:
                        follower.miss()
            if k == frames // 2 and flight < PICTURES:
                pictures.append(draw_detections(frame.rgb, shown, frame.intrinsics, (640, 480)))
            observation, _, over, cut, _ = env.step(np.zeros(env.action_space.shape, np.float32))
            if over or cut:
                break
        env.close()
    return Flights(out, Left(difficult, unseen), pictures)


def _errors(T_c_object: Array | None, true: TrueObject) -> tuple[float, float, float]:
    """Distance of the crawler [m], errors of position [m] and rotation [rad]."""
    assert true.T_c_object is not None and true.model is not None
    distance = float(np.linalg.norm(true.T_c_object[:3, 3]))
    if T_c_object is None:
        return distance, np.inf, np.inf
    turned = rotation_error(T_c_object, true.T_c_object, true.model.symmetries)
    return distance, float(translation_error(T_c_object, true.T_c_object)), float(turned)
