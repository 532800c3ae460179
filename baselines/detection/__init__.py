"""Finding objects in images and clouds, without learning: clusters, alignment, tracking, features and colours."""

from baselines.detection.alignment import DepthView, align_model
from baselines.detection.box_pose import BoxPose, pose_from_box
from baselines.detection.clusters import euclidean_clusters
from baselines.detection.outliers import remove_outliers
from baselines.detection.plane import Plane, fit_plane
from baselines.detection.pose_tracker import PoseTrack, PoseTracker
from baselines.detection.registration import RegistrationResult, register
from baselines.detection.shape_model import ShapeModel

__all__ = [
    "BoxPose",
    "DepthView",
    "Plane",
    "PoseTrack",
    "PoseTracker",
    "RegistrationResult",
    "ShapeModel",
    "align_model",
    "euclidean_clusters",
    "fit_plane",
    "pose_from_box",
    "register",
    "remove_outliers",
]
