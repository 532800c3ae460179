"""What tasks are scored by: detection, object pose, trajectory, shape and control errors.

Pure functions on arrays, in SI units. Empty or non-finite input raises ValueError: no score is ever made up.
"""

from aerograsp_env.metrics.control import TruenessPrecision, mean_absolute_error, trueness_precision
from aerograsp_env.metrics.detection import (
    IGNORED,
    MISSED,
    MeanAveragePrecision,
    assign_detections,
    average_precision,
    box_iou,
    match_detections,
    mean_average_precision,
)
from aerograsp_env.metrics.pose import (
    add_error,
    add_s_error,
    chamfer_distance,
    count_jumps,
    rotation_error,
    translation_error,
)
from aerograsp_env.metrics.scoring import (
    DetectionSummary,
    FrameScore,
    Match,
    PoseModel,
    TrueObject,
    score_frame,
    summarize,
)
from aerograsp_env.metrics.trajectory import (
    Alignment,
    RelativePoseError,
    TrajectoryError,
    absolute_trajectory_error,
    associate,
    relative_pose_error,
    umeyama,
)

__all__ = [
    "IGNORED",
    "MISSED",
    "Alignment",
    "DetectionSummary",
    "FrameScore",
    "Match",
    "MeanAveragePrecision",
    "PoseModel",
    "RelativePoseError",
    "TrajectoryError",
    "TrueObject",
    "TruenessPrecision",
    "absolute_trajectory_error",
    "add_error",
    "add_s_error",
    "assign_detections",
    "associate",
    "average_precision",
    "box_iou",
    "chamfer_distance",
    "count_jumps",
    "match_detections",
    "mean_absolute_error",
    "mean_average_precision",
    "relative_pose_error",
    "rotation_error",
    "score_frame",
    "summarize",
    "translation_error",
    "trueness_precision",
    "umeyama",
]
