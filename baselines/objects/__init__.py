"""Object models: what an object's surface is, and how sure one can be of it.

`GPIS` is a Gaussian process over an implicit function, made of a kernel and a prior shape::

    model = GPIS(SquaredExponential(length_scale=0.05), Ellipsoid((0.04, 0.03, 0.06)), noise=1e-3)
    model.fit(points, normals)
    mean, gradient, variance = model.predict(x, gradient=True, variance=True)
"""

from baselines.objects.gpis import GPIS, Optimization, Prediction
from baselines.objects.kernels import Kernel, Matern52, SquaredExponential, ThinPlate
from baselines.objects.line_kernels import Brownian, Periodic
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
    "FinitePlane",
    "Kernel",
    "Matern52",
    "Optimization",
    "Periodic",
    "Plane",
    "Posed",
    "Prediction",
    "Prior",
    "SmoothUnion",
    "Sphere",
    "SquaredExponential",
    "SurfaceError",
    "ThinPlate",
]
