"""Object models: what an object's surface is, and how sure one can be of it.

`GPIS` is a Gaussian process over an implicit function, made of a kernel and a prior shape::

    model = GPIS(SquaredExponential(length_scale=0.05), Ellipsoid((0.04, 0.03, 0.06)), noise=1e-3)
    model.fit(points, normals)
    mean, gradient, variance = model.predict(x, gradient=True, variance=True)
"""

from baselines.objects.aligned_model import MergedData, aligned_noise, fit_with_model, merge_model
from baselines.objects.convex import convex_pieces, watertight_union
from baselines.objects.downsampling import voxel_downsample
from baselines.objects.feature_cloud import FeatureCloud, detect_features
from baselines.objects.fpfh import fpfh, iss_keypoints
from baselines.objects.gpis import GPIS, Optimization, Prediction
from baselines.objects.kernels import Kernel, Matern52, SquaredExponential, ThinPlate
from baselines.objects.line_kernels import Brownian, Periodic
from baselines.objects.matching import Matches, match_descriptors
from baselines.objects.mesh import MeshObject
from baselines.objects.mesh_checks import MeshReport
from baselines.objects.point_cloud import PointCloudObject
from baselines.objects.prior_fit import PriorFit, fit_cylinder, fit_ellipsoid, fit_plane, fit_sphere
from baselines.objects.priors import (
    Constant,
    Cylinder,
    Ellipsoid,
    FinitePlane,
    Plane,
    Posed,
    Prior,
    SmoothUnion,
    Sphere,
)
from baselines.objects.surface import SurfaceError

__all__ = [
    "GPIS",
    "Brownian",
    "Constant",
    "Cylinder",
    "Ellipsoid",
    "FeatureCloud",
    "FinitePlane",
    "Kernel",
    "Matches",
    "Matern52",
    "MergedData",
    "MeshObject",
    "MeshReport",
    "Optimization",
    "Periodic",
    "Plane",
    "PointCloudObject",
    "Posed",
    "Prediction",
    "Prior",
    "PriorFit",
    "SmoothUnion",
    "Sphere",
    "SquaredExponential",
    "SurfaceError",
    "ThinPlate",
    "aligned_noise",
    "convex_pieces",
    "detect_features",
    "fit_cylinder",
    "fit_ellipsoid",
    "fit_plane",
    "fit_sphere",
    "fit_with_model",
    "fpfh",
    "iss_keypoints",
    "match_descriptors",
    "merge_model",
    "voxel_downsample",
    "watertight_union",
]
