"""Detectors and descriptors compared: models learned and located with each pair on the same rendered pictures.

`python -m agents.feature_benchmark [--features PAIR …] [--frames N] [--views N] [--json FILE]`
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from aerograsp_env.interfaces import RGBD
from aerograsp_env.metrics import rotation_error, translation_error
from aerograsp_env.sim.rgbd_camera import RGBDCameraConfig
from agents.feature_scenes import CAMERA, FeatureScene, StereoSequence, frame, orbit, stereo_sequence, view
from agents.files import write_json
from agents.provenance import provenance
from agents.reproduction import text_table
from agents.seeds import TEST_SEED, TRAIN_SEED
from baselines.detection.extraction import extract, feature_kind
from baselines.detection.feature_learning import LearningError, learn_from_stereo
from baselines.detection.feature_model import FEATURES
from baselines.detection.stereo_features import StereoRig

PAIRS = (
    "sift+sift",
    "fast+sift",
    "orb+orb",
    "fast+orb",
    "fast+brief",
    "fast+rbrief",
    "shi-tomasi+sift",
    "shi-tomasi+brief",
)
FRAMES, VIEWS = 40, 40
CARTON = 1
WITHIN = 0.02  # [m]


class Row(NamedTuple):
    """One pair's model and what it finds; NaN where there is nothing to measure."""

    feature: str
    points: int  # of the model
    reprojection: float  # [px] of its bundle
    found: float  # share of the frames with a pose
    within: float  # share of the frames with a pose within 2 cm
    inliers: float  # median over the frames, 0 where not found
    inlier_share: float  # of the matches, median over the frames found
    position: float  # [m] median over the frames found
    rotation: float  # [rad]
    features_ms: float  # median wall time of detection and description
    locate_ms: float  # and of everything
    fault: str = ""  # why there is no model


def compare(feature: str, sequence: StereoSequence, rig: StereoRig, tests: Sequence[tuple[RGBD, np.ndarray]]) -> Row:
    """Learn a model with one pair of detector and descriptor, and locate it in every test frame."""
    try:
        learned = learn_from_stereo(
            sequence.pairs, rig, feature, sequence.masks, 1500, T_c_object=sequence.T_c_object, name="carton"
        )
    except LearningError as fault:
        nothing = (np.nan,) * 3
        return Row(feature, 0, np.nan, 0.0, 0.0, 0.0, *nothing, np.nan, np.nan, str(fault))
    model = learned.model
    model.locate(tests[0][0].rgb, tests[0][0].intrinsics)  # warm
    position, rotation, inliers, share, seconds, extracting = [], [], [], [], [], []
    for taken, truth in tests:
        start = time.perf_counter()
        extract(taken.rgb, model.kind, FEATURES)
        middle = time.perf_counter()
        found = model.locate(taken.rgb, taken.intrinsics)
        extracting.append(middle - start)
        seconds.append(time.perf_counter() - middle)
        inliers.append(found.inliers)
        if found.T_c_object is not None:
            position.append(float(translation_error(found.T_c_object, truth)))
            rotation.append(float(rotation_error(found.T_c_object, truth)))
            share.append(found.inliers / found.matches)

    def median(values: list[float]) -> float:
        return float(np.median(values)) if values else np.nan

    near = sum(error < WITHIN for error in position)
    return Row(
        feature, len(model), learned.rmse, len(position) / len(tests), near / len(tests),
        float(np.median(inliers)), median(share), median(position), median(rotation), 1e3 * median(extracting),
        1e3 * median(seconds),
    )  # fmt: skip


def measure(
    features: Sequence[str] = PAIRS,
    frames: int = FRAMES,
    views: int = VIEWS,
    seed: int = TEST_SEED,
    config: RGBDCameraConfig = CAMERA,
) -> list[Row]:
    """All pairs on the same pictures: the model's from `views` stereo pairs, then `frames` from any side elsewhere."""
    scene = FeatureScene(CARTON, TRAIN_SEED, config)
    sequence = stereo_sequence(scene, orbit(views), np.random.default_rng(TRAIN_SEED))
    other, rng = FeatureScene(CARTON, seed, config), np.random.default_rng(seed)
    tests = [frame(other, view(rng), rng) for _ in range(frames)]
    return [compare(feature, sequence, scene.rig, tests) for feature in features]


def table(rows: Sequence[Row]) -> str:
    """The comparison as text."""
    head = ["", "points", "model [px]", "found", "< 2 cm", "inliers", "of matches", "position [mm]", "rotation [°]",
            "features [ms]", "locate [ms]"]  # fmt: skip
    lines = [head]
    for row in rows:
        if row.fault:
            lines.append([row.feature, "no model", *["–"] * 9])
            continue
        lines.append(
            [row.feature, str(row.points), f"{row.reprojection:.2f}", f"{row.found:.0%}", f"{row.within:.0%}",
             f"{row.inliers:.0f}", f"{row.inlier_share:.0%}", f"{1e3 * row.position:.1f}",
             f"{np.degrees(row.rotation):.2f}", f"{row.features_ms:.0f}", f"{row.locate_ms:.0f}"]
        )  # fmt: skip
    faults = "".join(f"\n{row.feature}: {row.fault}" for row in rows if row.fault)
    return text_table(lines, 1) + faults


def main(arguments: Sequence[str]) -> int:
    """Print the table; write the data where asked."""
    parser = argparse.ArgumentParser(prog="python -m agents.feature_benchmark", description=__doc__.splitlines()[0])
    parser.add_argument("--features", nargs="+", default=list(PAIRS), metavar="PAIR", help="detector+descriptor")
    parser.add_argument("--frames", type=int, default=FRAMES, help="test frames")
    parser.add_argument("--views", type=int, default=VIEWS, help="stereo pairs to learn from")
    parser.add_argument("--seed", type=int, default=TEST_SEED)
    parser.add_argument("--json", type=Path, help="data to write")
    given = parser.parse_args(arguments)
    try:
        kinds = [str(feature_kind(feature)) for feature in given.features]
    except ValueError as fault:
        parser.error(str(fault))
    if given.frames < 1 or given.views < 3:
        parser.error(f"--frames, --views: expected 1 or more and 3 or more, got {given.frames} and {given.views}")
    rows = measure(kinds, given.frames, given.views, given.seed)
    print(table(rows))
    if given.json is not None:
        source = provenance(["python -m agents.feature_benchmark", *arguments])
        write_json(given.json, {"rows": [row._asdict() for row in rows], "provenance": source})
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
