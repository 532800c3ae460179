"""Finding objects in images and clouds, without learning: clusters, alignment, tracking, features and colours."""

from baselines.detection.alignment import DepthView, align_model
from baselines.detection.box_pose import BoxPose, pose_from_box
from baselines.detection.clusters import euclidean_clusters
from baselines.detection.kmeans import Centers, kmeans_pp, x_means
from baselines.detection.outliers import remove_outliers
from baselines.detection.plane import Plane, fit_plane
from baselines.detection.pose_tracker import PoseTrack, PoseTracker
from baselines.detection.projection import cluster_detections, convex_hull, crop_hull, pca_frame, project
from baselines.detection.registration import RegistrationResult, register
from baselines.detection.segmentation import segment_objects
from baselines.detection.shape_model import ShapeModel

__all__ = [
    "BoxPose",
    "Centers",
    "DepthView",
    "Plane",
    "PoseTrack",
    "PoseTracker",
    "RegistrationResult",
    "ShapeModel",
    "align_model",
    "cluster_detections",
    "convex_hull",
    "crop_hull",
    "euclidean_clusters",
    "fit_plane",
    "kmeans_pp",
    "pca_frame",
    "pose_from_box",
    "project",
    "register",
    "remove_outliers",
    "segment_objects",
    "x_means",
]
