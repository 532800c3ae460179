"""Clusters seen by a camera: their pixels, hulls and boxes, and a frame from their spread."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.interfaces import RGBD, Detection, Intrinsics
from aerograsp_env.spatial import check_transform, transform, transform_points
from baselines.detection.checks import check_points
from baselines.detection.segmentation import segment_objects
from baselines.objects.depth_points import unproject

Array = NDArray[np.float64]


def project(points_c: ArrayLike, intrinsics: Intrinsics, T_camera_points: ArrayLike | None = None) -> Array:
    """Pixels (N, 2) of points: u = K [R|t] X, with the lens's distortion (thesis, section 3.2, equation 3.1).

    Args:
        points_c: (N, 3) [m].
        intrinsics: of the camera.
        T_camera_points: (4, 4) maps the points to the camera's frame, for the second camera of a pair; None: they
            are in it.

    Returns:
        (N, 2) u, v [px], also outside the image; NaN for points that are not in front of the camera.

    Raises:
        ValueError: no points, values that are not finite, or a transform that is not rigid.
    """
    points = check_points(points_c, "points_c")
    if T_camera_points is not None:
        points = transform_points(check_transform(T_camera_points, "T_camera_points"), points)
    ahead = points[:, 2] > 0.0
    pixels = np.full((len(points), 2), np.nan)
    if ahead.any():
        none = np.zeros(3)
        found, _ = cv2.projectPoints(points[ahead, None], none, none, intrinsics.matrix, intrinsics.distortion)
        pixels[ahead] = found[:, 0]
    return pixels


def convex_hull(pixels: ArrayLike) -> Array:
    """(K, 2) corners [px] of the convex hull of pixels (N, 2), in order; rows of NaN do not count.

    Raises:
        ValueError: no finite pixel.
    """
    places = np.asarray(pixels, dtype=np.float64)
    if places.ndim != 2 or places.shape[1] != 2:
        raise ValueError(f"pixels: expected shape (N, 2), got {places.shape}")
    places = places[np.isfinite(places).all(axis=1)]
    if not len(places):
        raise ValueError("pixels: expected at least one that is finite, got none")
    return np.asarray(cv2.convexHull(places.astype(np.float32))[:, 0], dtype=np.float64)


def crop_hull(image: NDArray, hull: ArrayLike) -> tuple[NDArray, tuple[int, int]]:
    """The part of an image (H, W, …) inside a hull (K, 2), zero outside it, and the pixel (left, top) it starts at.

    Raises:
        ValueError: a hull that does not meet the image.
    """
    corners = np.asarray(hull, dtype=np.float64)
    height, width = image.shape[:2]
    left, top = np.maximum(np.floor(corners.min(axis=0)).astype(int), 0)
    right, bottom = np.minimum(np.ceil(corners.max(axis=0)).astype(int) + 1, [width, height])
    if left >= right or top >= bottom:
        raise ValueError(f"hull: expected one that meets the image of {width} × {height} px")
    mask = np.zeros((bottom - top, right - left), dtype=np.uint8)
    cv2.fillConvexPoly(mask, np.rint(corners - [left, top]).astype(np.int32), 1)
    patch = image[top:bottom, left:right].copy()
    patch[mask == 0] = 0
    return patch, (int(left), int(top))


def pca_frame(points: Any, viewpoint: ArrayLike = (0.0, 0.0, 0.0)) -> Array:
    """(4, 4) frame of a cloud: x along its largest spread, z along its smallest and towards the viewpoint, at its mean.

    x points to the side on which the points reach farther (thesis, figure 3.2).

    Raises:
        ValueError: fewer than three points, or points at one place.
    """
    cloud = check_points(points, least=3)
    center = cloud.mean(axis=0)
    spread = cloud - center
    values, vectors = np.linalg.eigh(spread.T @ spread)
    if values[-1] <= 0.0:
        raise ValueError("points: expected some that differ, got all at one place")
    x, z = vectors[:, 2], vectors[:, 0]
    along = spread @ x
    x = x if along.max() >= -along.min() else -x
    z = z if z @ (np.asarray(viewpoint, dtype=np.float64) - center) >= 0.0 else -z
    return transform(np.stack([x, np.cross(z, x), z], axis=1), center)


def cluster_detections(
    frame: RGBD,
    label: str = "object",
    *,
    use_color: bool = True,
    tolerance: float | None = None,
    min_size: int | None = None,
    max_distance: float = 3.0,
) -> list[Detection]:
    """Objects of any kind that stand on a plane: boxes and principal frames of clusters. Thesis, section 3.2.

    Args:
        frame: with depth registered to the colours.
        label: the class that every detection gets.
        use_color: part touching objects of different colours.
        tolerance, min_size: as `segment_objects`.
        max_distance: [m] what is farther along the optical axis is left out.

    Returns:
        The largest first; T_c_object is the cluster's principal frame, the score the share of the box that is filled.
        An empty list where there are too few points for a plane.
    """
    near = np.where(frame.depth <= max_distance, frame.depth, 0.0)
    if np.count_nonzero(near) < 4:
        return []
    points, valid = unproject(near, frame.intrinsics)
    try:
        parts = segment_objects(points, frame.rgb[valid] if use_color else None, None, tolerance, min_size)
    except ValueError:  # all on one line: no plane, and nothing that stands on it
        return []
    rows, columns = np.nonzero(valid)
    found = []
    for part in parts:
        low = np.array([columns[part].min(), rows[part].min()]) - 0.5
        high = np.array([columns[part].max(), rows[part].max()]) + 0.5
        filled = min(1.0, len(part) / float(np.prod(high - low)))
        found.append(Detection(label, filled, np.concatenate([low, high]), pca_frame(points[part])))
    return found
