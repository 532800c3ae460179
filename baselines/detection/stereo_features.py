"""Features that both cameras of a calibrated pair see, and where they are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.interfaces import RGBD, Intrinsics
from aerograsp_env.spatial import as_array, check_transform, skew, transform, transform_points
from baselines.detection.extraction import FeatureKind, extract, feature_kind
from baselines.detection.pnp import pinhole, undistorted
from baselines.objects.matching import match_descriptors

Array = NDArray[np.float64]

RIGHT = 5
"""How many times more features the right image may have: nothing masks it, and the others are filtered out."""


@dataclass(frozen=True, eq=False)
class StereoRig:
    """Two calibrated cameras, fixed to each other.

    Raises:
        ValueError: a transform that is not rigid, or cameras at the same place.
    """

    left: Intrinsics
    right: Intrinsics
    T_right_left: Array  # (4, 4)

    def __post_init__(self) -> None:
        T = check_transform(self.T_right_left, "T_right_left")
        if T.shape != (4, 4) or not T[:3, 3].any():
            raise ValueError("T_right_left: expected one transform (4, 4) between cameras at different places")
        object.__setattr__(self, "T_right_left", T)

    @classmethod
    def rectified(cls, intrinsics: Intrinsics, baseline: float) -> StereoRig:
        """Two equal cameras side by side: the right one `baseline` [m] along the left one's x."""
        return cls(intrinsics, intrinsics, transform(np.eye(3), [-baseline, 0.0, 0.0]))


class FrameFeatures(NamedTuple):
    """Features of one frame with their places."""

    pixels: Array  # (N, 2) [px] in the left or only image, free of distortion
    points_c: Array  # (N, 3) [m] in that camera's frame
    descriptors: NDArray  # (N, D)
    pixels_right: Array | None = None  # (N, 2) [px] in the right image; None from a camera with depth


def epipolar_distances(pixels_left: ArrayLike, pixels_right: ArrayLike, rig: StereoRig) -> Array:
    """(N,) Sampson distances [px] of pairs from fulfilling x_rᵀ F x_l = 0 (Hartley & Zisserman 2004, eq. 11.9).

    Args:
        pixels_left, pixels_right: (N, 2) [px], free of distortion.
    """
    T = rig.T_right_left
    F = np.linalg.inv(rig.right.matrix).T @ skew(T[:3, 3]) @ T[:3, :3] @ np.linalg.inv(rig.left.matrix)
    left, right = (
        np.column_stack([as_array(p, (2,), "pixels"), np.ones(len(p))]) for p in _both(pixels_left, pixels_right)
    )
    line_right, line_left = left @ F.T, right @ F
    squares = (line_right[:, :2] ** 2).sum(axis=1) + (line_left[:, :2] ** 2).sum(axis=1)
    return np.abs(np.einsum("ij,ij->i", right, line_right)) / np.sqrt(np.maximum(squares, 1e-300))


def triangulate(pixels_left: ArrayLike, pixels_right: ArrayLike, rig: StereoRig) -> Array:
    """(N, 3) points in the left camera's frame [m]: least squares over both reprojection errors, by linear steps.

    The linear equations of Hartley & Zisserman 2004, section 12.2, weighted anew by the depths (Hartley & Sturm 1997).

    Args:
        pixels_left, pixels_right: (N, 2) [px], free of distortion.
    """
    T, rows, weights = rig.T_right_left, [], []
    for pixels, camera, M in zip(_both(pixels_left, pixels_right), (rig.left, rig.right), (np.eye(4), T), strict=True):
        ray = (pixels - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
        for axis, focal in ((0, camera.fx), (1, camera.fy)):
            rows.append(focal * (ray[:, axis, None] * M[2] - M[axis]))
            weights.append(M[2])
    A, depth_rows = np.stack(rows, axis=1), np.array(weights)  # (N, 4, 4) with the constant last
    weight, points = np.ones(A.shape[:2]), np.zeros((len(A), 3))
    for _ in range(3):
        W = A * weight[..., None]
        H = np.einsum("nki,nkj->nij", W[..., :3], W[..., :3])
        g = -np.einsum("nki,nk->ni", W[..., :3], W[..., 3])
        points = np.linalg.solve(H + 1e-12 * np.trace(H, axis1=1, axis2=2)[:, None, None] * np.eye(3), g[..., None])[
            ..., 0
        ]
        depth = points @ depth_rows[:, :3].T + depth_rows[:, 3]
        weight = 1.0 / np.maximum(np.abs(depth), 1e-6)
    return points


def _both(left: ArrayLike, right: ArrayLike) -> tuple[Array, Array]:
    a, b = as_array(left, (2,), "pixels_left").reshape(-1, 2), as_array(right, (2,), "pixels_right").reshape(-1, 2)
    if len(a) != len(b):
        raise ValueError(f"pixels_right: expected one for each of {len(a)} left pixels, got {len(b)}")
    return a, b


def check_size(image: ArrayLike, intrinsics: Intrinsics, name: str) -> None:
    """Raise ValueError unless the image has the camera's size."""
    if np.shape(image)[:2] != (intrinsics.height, intrinsics.width):
        height, width = (*np.shape(image), 0, 0)[:2]
        raise ValueError(
            f"{name}: expected {intrinsics.width}×{intrinsics.height} px as the intrinsics say, got {width}×{height}"
        )


def stereo_features(
    left: ArrayLike,
    right: ArrayLike,
    rig: StereoRig,
    feature: str | FeatureKind = "sift",
    n: int = 1500,
    mask: ArrayLike | None = None,
    ratio: float = 0.9,
    max_epipolar: float = 1.0,
    depth_range: tuple[float, float] = (0.1, 10.0),
    max_error: float = 1.0,
) -> FrameFeatures:
    """Features matched between both images that the pair's geometry allows (Ramon Soria 2018, figure 3.9).

    Three filters in turn: the distance from the epipolar line, the depth (so that the disparity has the right sign and
    size), and the reprojection error of the triangulated point in both images.

    Args:
        left, right: (H, W) or (H, W, 3) RGB, uint8.
        feature: see `extraction.feature_kind`.
        n: features at most in the left image, and `RIGHT` times as many in the right one.
        mask: (H, W) bool: where in the left image features may lie.
        ratio: of the nearest descriptor's distance to the second nearest's.
        max_epipolar, max_error: [px].
        depth_range: [m] in front of the left camera.

    Raises:
        ValueError: images of another shape, type or size than the rig's.
    """
    kind = feature if isinstance(feature, FeatureKind) else feature_kind(feature)
    check_size(left, rig.left, "left")
    check_size(right, rig.right, "right")
    a, b = extract(left, kind, n, mask), extract(right, kind, RIGHT * n)  # where the mask is there is not known
    pairs = match_descriptors(a.descriptors, b.descriptors, ratio=ratio)
    order = np.argsort(pairs.query)
    pixels_l = undistorted(a.pixels[pairs.query[order]], rig.left)
    pixels_r = undistorted(b.pixels[pairs.train[order]], rig.right)
    described = a.descriptors[pairs.query[order]]
    near = epipolar_distances(pixels_l, pixels_r, rig) <= max_epipolar
    pixels_l, pixels_r, described = pixels_l[near], pixels_r[near], described[near]
    points = triangulate(pixels_l, pixels_r, rig)
    good = (points[:, 2] >= depth_range[0]) & (points[:, 2] <= depth_range[1])
    for pixels, camera, T in ((pixels_l, rig.left, np.eye(4)), (pixels_r, rig.right, rig.T_right_left)):
        error = np.linalg.norm(pinhole(transform_points(T, points), camera) - pixels, axis=1)
        good &= np.nan_to_num(error, nan=np.inf) <= max_error
    return FrameFeatures(pixels_l[good], points[good], described[good], pixels_r[good])


def rgbd_features(
    frame: RGBD, feature: str | FeatureKind = "sift", n: int = 1500, mask: ArrayLike | None = None
) -> FrameFeatures:
    """Features of a colour image where there is depth; without a return at the nearest pixel they are left out."""
    found = extract(frame.rgb, feature, n, mask)
    columns, rows = np.rint(found.pixels).astype(np.int64).T
    height, width = frame.depth.shape
    z = frame.depth[np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)].astype(np.float64)
    pixels, K = undistorted(found.pixels, frame.intrinsics), frame.intrinsics
    points = np.column_stack([(pixels - [K.cx, K.cy]) / [K.fx, K.fy], np.ones(len(pixels))]) * z[:, None]
    seen = z > 0.0
    return FrameFeatures(pixels[seen], points[seen], found.descriptors[seen])
