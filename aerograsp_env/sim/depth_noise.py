"""What a depth camera of the structured-light or stereo kind makes of a true depth image.

In the order in which it happens: the projector's shadow (what only one of the two eyes sees has no depth), lateral
jitter, normal noise of the disparity and its quantisation, lost pixels at grazing angles and at random, the range.

Depth z has the disparity k / z (k is focal length times baseline). Normal noise of the disparity with a constant σ
gives depth a σ quadratic in z, and steps of disparity give steps of depth quadratic in z (Khoshelham & Elberink 2012,
"Accuracy and resolution of Kinect depth data for indoor mapping applications"). Their Kinect: σ_z = 1.425 mm · z²,
steps of 2.85 mm · z². The lateral jitter follows Nguyen, Izadi & Lovell 2012, "Modeling Kinect sensor noise for
improved 3D reconstruction and tracking", and the order of jitter, noise and quantisation Barron & Malik 2013,
"Intrinsic scene properties from a single RGB-D image".
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from aerograsp_env.interfaces import Intrinsics

_SEPARATE = 0.05  # of the depth: neighbours farther apart lie on different surfaces


@dataclass(frozen=True)
class DepthNoiseConfig:
    """A depth camera's faults; the defaults are the Kinect's. `none` has none.

    Raises:
        ValueError: a value out of its range.
    """

    sigma: float = 1.425e-3  # [1/m] of 1/z: σ_z = sigma · z²
    quantum: float = 2.85e-3  # [1/m] step of 1/z
    jitter: float = 0.5  # [px] σ of where a pixel looks, sideways
    baseline: float = 0.075  # [m] from the camera to its projector or second eye, along the image's x; 0: no shadow
    grazing_start: float = math.radians(70.0)  # [rad] from the surface's normal, where pixels begin to get lost
    grazing_limit: float = math.radians(86.0)  # [rad] from where on all are
    lost: float = 0.002  # share of pixels lost anywhere

    def __post_init__(self) -> None:
        for name, fits, expected in (
            ("sigma", 0.0 <= self.sigma <= 0.1, "0 to 0.1 1/m"),
            ("quantum", 0.0 <= self.quantum <= 0.1, "0 to 0.1 1/m"),
            ("jitter", 0.0 <= self.jitter <= 3.0, "0 to 3 px"),
            ("baseline", abs(self.baseline) <= 1.0, "within ±1 m"),
            ("grazing_start", 0.0 < self.grazing_start < self.grazing_limit, "0 < grazing_start < grazing_limit"),
            ("grazing_limit", self.grazing_limit <= math.pi, "at most π rad"),
            ("lost", 0.0 <= self.lost <= 1.0, "0 to 1"),
        ):
            if not fits:
                raise ValueError(f"{name}: expected {expected}, got {getattr(self, name)!r}")

    @classmethod
    def none(cls) -> DepthNoiseConfig:
        """A camera without faults."""
        return cls(0.0, 0.0, 0.0, 0.0, 0.5 * math.pi, math.pi, 0.0)


def noisy_depth(
    depth: NDArray[np.float32],
    intrinsics: Intrinsics,
    config: DepthNoiseConfig,
    rng: np.random.Generator,
) -> NDArray[np.float32]:
    """What the camera measures of the true `depth` (H, W) [m]; both have 0 where there is no return.

    Raises:
        ValueError: a depth image of another size than the intrinsics'.
    """
    expected = (intrinsics.height, intrinsics.width)
    if depth.shape != expected:
        raise ValueError(f"depth: expected shape {expected} as the intrinsics say, got {depth.shape}")
    chance = rng.random((2, *depth.shape), dtype=np.float32)
    normal = rng.standard_normal((3, *depth.shape), dtype=np.float32)
    focal = (intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy)
    settings = (config.sigma, config.quantum, config.jitter, config.baseline, config.lost)
    return _measure(
        np.ascontiguousarray(depth, np.float32),
        *(chance, normal, focal, settings, config.grazing_start, config.grazing_limit),
    )


@numba.njit(cache=True, error_model="numpy")
def _measure(depth, chance, normal, focal, settings, grazing_start, grazing_limit):
    sigma, quantum, jitter, baseline, lost = settings
    height, width = depth.shape
    seen = np.zeros((height, width), np.bool_)
    for v in range(height):
        # The column in which the second eye sees each pixel falls from one end of a row to the other, unless something
        # nearer stands before it.
        right, first = baseline >= 0.0, True
        edge = 0.0
        for step in range(width):
            u = width - 1 - step if right else step
            z = depth[v, u]
            if z <= 0.0:
                continue
            column = u - focal[0] * baseline / z
            hidden = not first and baseline != 0.0 and (column > edge if right else column < edge)
            if not hidden:
                edge, first = column, False
            seen[v, u] = not hidden and chance[0, v, u] >= lost

    out = np.zeros((height, width), np.float32)
    for v in range(height):
        for u in range(width):
            if not seen[v, u]:
                continue
            z = depth[v, u]
            if grazing_limit < math.pi:
                angle = _incidence(depth, v, u, z, focal)
                if chance[1, v, u] < (angle - grazing_start) / (grazing_limit - grazing_start):
                    continue
            if jitter > 0.0:
                row = min(max(math.floor(v + jitter * normal[0, v, u] + 0.5), 0), height - 1)
                column = min(max(math.floor(u + jitter * normal[1, v, u] + 0.5), 0), width - 1)
                other = depth[row, column]
                if other <= 0.0:
                    continue
                # On the same surface the jitter would only add the slope's noise, which the disparity's σ has already.
                if abs(other - z) > _SEPARATE * z:
                    z = other
            inverse = 1.0 / z + sigma * normal[2, v, u]
            if quantum > 0.0:
                inverse = quantum * math.floor(inverse / quantum + 0.5)
            if inverse > 0.0:
                out[v, u] = 1.0 / inverse
    return out


@numba.njit(cache=True, error_model="numpy")
def _incidence(depth, v, u, z, focal):
    """Angle [rad] between the line of sight and the surface's normal, from the neighbours on the same surface."""
    slope_u = _slope(z, depth[v, u - 1] if u > 0 else 0.0, depth[v, u + 1] if u < depth.shape[1] - 1 else 0.0)
    slope_v = _slope(z, depth[v - 1, u] if v > 0 else 0.0, depth[v + 1, u] if v < depth.shape[0] - 1 else 0.0)
    # With p = z · r, r = (x, y, 1), the tangents are ∂p/∂u = z_u r + z e_x / f and ∂p/∂v alike; the normal is their
    # cross product, and its product with r is z² / f² whatever the slopes are.
    x, y = (u - focal[2]) / focal[0], (v - focal[3]) / focal[1]
    a, b = slope_u * focal[0], slope_v * focal[1]
    c = -(z + a * x + b * y)
    cosine = z / (math.sqrt(a * a + b * b + c * c) * math.sqrt(x * x + y * y + 1.0))
    return math.acos(min(cosine, 1.0))


@numba.njit(cache=True, error_model="numpy")
def _slope(z, before, after):
    """Change of depth from pixel to pixel: towards the neighbour that is closer in depth; 0 if there is none."""
    first = z - before if before > 0.0 else np.inf
    second = after - z if after > 0.0 else np.inf
    best = first if abs(first) < abs(second) else second
    return best if abs(best) < np.inf else 0.0
