"""Finding objects in images and clouds, without learning: clusters, alignment, tracking, features and colours."""

from baselines.detection.alignment import DepthView, align_model
from baselines.detection.box_pose import BoxPose, pose_from_box
from baselines.detection.bundle import BundleResult, bundle_adjust
from baselines.detection.clusters import euclidean_clusters
from baselines.detection.color import ColorRegion, ColorSegmenter
from baselines.detection.extraction import extract, feature_kind
from baselines.detection.feature_detector import FeatureDetector
from baselines.detection.feature_learning import (
    LearnedModel,
    LearningError,
    learn_feature_model,
    learn_from_rgbd,
    learn_from_stereo,
)
from baselines.detection.feature_model import FeatureModel, FeaturePose
from baselines.detection.kmeans import Centers, kmeans_pp, x_means
from baselines.detection.outliers import remove_outliers
from baselines.detection.plane import Plane, fit_plane
from baselines.detection.pnp import PnPResult, solve_pnp
from baselines.detection.pose_tracker import PoseTrack, PoseTracker
from baselines.detection.projection import cluster_detections, convex_hull, crop_hull, pca_frame, project
from baselines.detection.propagation import observations, propagate
from baselines.detection.registration import RegistrationResult, register
from baselines.detection.segmentation import segment_objects
from baselines.detection.shape_model import ShapeModel
from baselines.detection.stereo_features import FrameFeatures, StereoRig, rgbd_features, stereo_features

__all__ = [
    "BoxPose",
    "BundleResult",
    "Centers",
    "ColorRegion",
    "ColorSegmenter",
    "DepthView",
    "FeatureDetector",
    "FeatureModel",
    "FeaturePose",
    "FrameFeatures",
    "LearnedModel",
    "LearningError",
    "Plane",
    "PnPResult",
    "PoseTrack",
    "PoseTracker",
    "RegistrationResult",
    "ShapeModel",
    "StereoRig",
    "align_model",
    "bundle_adjust",
    "cluster_detections",
    "convex_hull",
    "crop_hull",
    "euclidean_clusters",
    "extract",
    "feature_kind",
    "fit_plane",
    "kmeans_pp",
    "learn_feature_model",
    "learn_from_rgbd",
    "learn_from_stereo",
    "observations",
    "pca_frame",
    "pose_from_box",
    "project",
    "propagate",
    "register",
    "remove_outliers",
    "rgbd_features",
    "segment_objects",
    "solve_pnp",
    "stereo_features",
    "x_means",
]
