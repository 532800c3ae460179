"""Finding objects in images and clouds, without learning: clusters, alignment, tracking, features and colours."""

from baselines.detection.clusters import euclidean_clusters
from baselines.detection.outliers import remove_outliers
from baselines.detection.plane import Plane, fit_plane
from baselines.detection.registration import RegistrationResult, register

__all__ = [
    "Plane",
    "RegistrationResult",
    "euclidean_clusters",
    "fit_plane",
    "register",
    "remove_outliers",
]
