"""An object as a few points that can be recognised: image features lifted by depth, or keypoints of its shape."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.interfaces import Intrinsics
from aerograsp_env.spatial import as_array, transform_points
from baselines.objects.fpfh import fpfh, iss_keypoints
from baselines.objects.matching import Matches, match_descriptors
from baselines.objects.point_cloud import PointCloudObject

Array = NDArray[np.float64]

Feature = Literal["sift", "orb", "fast", "shi-tomasi"]
FEATURES = ("sift", "orb", "fast", "shi-tomasi")


class ImageFeatures(NamedTuple):
    """Features of one image."""

    pixels: Array  # (N, 2) x, y [px]
    descriptors: NDArray  # (N, 128) float32 for SIFT, (N, 32) uint8 for the others
    responses: Array  # (N,) the detector's own strength


def detect_features(image: NDArray[np.uint8], feature: Feature = "orb", n: int = 500) -> ImageFeatures:
    """At most n features of an image, strongest first.

    "sift": Lowe 2004. "orb": Rublee et al. 2011. "fast" (Rosten & Drummond 2006) and "shi-tomasi" (Shi & Tomasi 1994)
    only detect; their descriptors are ORB's, which are BRIEF's (Calonder et al. 2010) turned to the corner's direction.

    Args:
        image: (H, W) or (H, W, 3) RGB, uint8.

    Raises:
        ValueError: another shape or type, an unknown feature, or n < 1.
    """
    image = np.asarray(image)
    if (
        image.dtype != np.uint8
        or image.ndim not in (2, 3)
        or (image.ndim == 3 and image.shape[2] != 3)
        or not image.size
    ):
        raise ValueError(f"image: expected uint8 of shape (H, W) or (H, W, 3), got {image.dtype} {image.shape}")
    if feature not in FEATURES:
        raise ValueError(f"feature: expected one of {', '.join(FEATURES)}, got {feature!r}")
    if n < 1:
        raise ValueError(f"n: expected a number of features ≥ 1, got {n}")
    gray = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    describer: Any = cv2.SIFT.create(nfeatures=n) if feature == "sift" else cv2.ORB.create(nfeatures=n)
    if feature == "fast":
        found = sorted(cv2.FastFeatureDetector.create().detect(gray), key=lambda k: -k.response)[:n]
    elif feature == "shi-tomasi":
        corners = cv2.goodFeaturesToTrack(gray, n, 0.01, 5.0)
        corners = np.empty((0, 2)) if corners is None else corners.reshape(-1, 2)
        # The order of the corners is that of their strength, which OpenCV does not tell.
        strength = np.linspace(1.0, 0.0, len(corners), endpoint=False)
        found = [cv2.KeyPoint(float(x), float(y), 31.0, -1.0, float(r)) for (x, y), r in zip(corners, strength)]  # noqa: B905
    else:
        found = describer.detect(gray)
    keypoints, descriptors = describer.compute(gray, found)
    width, kind = (128, np.float32) if feature == "sift" else (32, np.uint8)
    if descriptors is None or len(keypoints) == 0:
        return ImageFeatures(np.empty((0, 2)), np.empty((0, width), dtype=kind), np.empty(0))
    responses = np.array([k.response for k in keypoints], dtype=np.float64)
    order = np.argsort(-responses, kind="stable")[:n]
    pixels = np.array([k.pt for k in keypoints], dtype=np.float64)
    return ImageFeatures(pixels[order], np.asarray(descriptors)[order], responses[order])


@dataclass(frozen=True, eq=False)
class FeatureCloud:
    """Points with descriptors.

    Raises:
        ValueError: shapes that do not match, or values that are not finite. A cloud may be empty.
    """

    points: Array  # (N, 3) [m]
    descriptors: NDArray  # (N, D) uint8 strings of bits, or float32
    pixels: Array | None = None  # (N, 2) [px] where they come from an image

    def __post_init__(self) -> None:
        points = as_array(self.points, (3,), "points")
        descriptors = np.asarray(self.descriptors)
        if points.ndim != 2 or descriptors.ndim != 2 or len(descriptors) != len(points):
            raise ValueError(
                f"descriptors: expected one for each point (N, 3), got {descriptors.shape} for {points.shape}"
            )
        if descriptors.dtype != np.uint8:
            descriptors = descriptors.astype(np.float32)
            if not np.isfinite(descriptors).all():
                raise ValueError("descriptors: expected finite values")
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "descriptors", descriptors)
        if self.pixels is not None:
            pixels = as_array(self.pixels, (2,), "pixels")
            if pixels.shape != (len(points), 2):
                raise ValueError(f"pixels: expected shape ({len(points)}, 2), got {pixels.shape}")
            object.__setattr__(self, "pixels", pixels)

    def __len__(self) -> int:
        return len(self.points)

    @classmethod
    def from_rgbd(
        cls, rgb: NDArray[np.uint8], depth: ArrayLike, intrinsics: Intrinsics, feature: Feature = "orb", n: int = 500
    ) -> FeatureCloud:
        """Features of an image where there is depth, in the camera's frame.

        A feature's depth is that of the nearest pixel; without a return there it is left out.

        Args:
            rgb: (H, W) or (H, W, 3) uint8, registered to the depth.
            depth: (H, W) [m]; 0 or NaN where there is no return.
            intrinsics: of both. Lens distortion is undone.
            feature, n: see `detect_features`.

        Raises:
            ValueError: as `detect_features` does; sizes that do not match; negative or infinite depth.
        """
        z = np.asarray(depth, dtype=np.float64)
        size = (intrinsics.height, intrinsics.width)
        if z.shape != size or np.shape(rgb)[:2] != size:
            raise ValueError(f"depth: expected rgb and depth of {size}, got {np.shape(rgb)} and {z.shape}")
        z = np.where(np.isnan(z), 0.0, z)
        if (z < 0.0).any() or np.isinf(z).any():
            raise ValueError("depth: expected values ≥ 0 [m], with 0 or NaN where there is no return")
        found = detect_features(rgb, feature, n)
        columns, rows = np.rint(found.pixels).astype(np.int64).T
        seen = z[np.clip(rows, 0, size[0] - 1), np.clip(columns, 0, size[1] - 1)]
        kept = seen > 0.0
        pixels, seen = found.pixels[kept], seen[kept]
        if intrinsics.distortion is not None and len(pixels):
            rays = cv2.undistortPoints(pixels[:, None], intrinsics.matrix, intrinsics.distortion)[:, 0]
        else:
            rays = (pixels - [intrinsics.cx, intrinsics.cy]) / [intrinsics.fx, intrinsics.fy]
        points = np.concatenate([rays, np.ones((len(rays), 1))], axis=1) * seen[:, None]
        return cls(points, found.descriptors[kept], pixels)

    @classmethod
    def from_cloud(
        cls,
        cloud: PointCloudObject,
        radius: float,
        keypoints: Literal["iss", "uniform", "all"] = "iss",
        spacing: float | None = None,
    ) -> FeatureCloud:
        """FPFH descriptors of a cloud's keypoints.

        Args:
            cloud: with normals; thin it to an even spacing first.
            radius: [m] of the descriptors' neighbourhoods.
            keypoints: "iss" (Zhong 2009), "uniform" (the point nearest to the mean of each voxel), or "all" points.
            spacing: [m] radius of the ISS neighbourhoods, or edge of the voxels; None: 0.6 `radius`.

        Raises:
            ValueError: a cloud without normals, lengths that are not positive, or unknown keypoints.
        """
        if cloud.normals is None:
            raise ValueError("cloud: expected one with normals; call estimate_normals() first")
        step = 0.6 * radius if spacing is None else spacing
        if keypoints == "iss":
            rows = iss_keypoints(cloud.points, step)
        elif keypoints == "uniform":
            rows = cloud.voxel_representatives(step)
        elif keypoints == "all":
            rows = np.arange(len(cloud))
        else:
            raise ValueError(f'keypoints: expected "iss", "uniform" or "all", got {keypoints!r}')
        return cls(cloud.points[rows], fpfh(cloud.points, cloud.normals, radius, rows))

    def match(
        self,
        other: FeatureCloud,
        method: Literal["bf", "flann"] = "bf",
        ratio: float | None = 0.8,
        cross_check: bool = True,
        max_distance: float = np.inf,
    ) -> Matches:
        """Pairs of this cloud's features with the other's: see `match_descriptors`."""
        return match_descriptors(self.descriptors, other.descriptors, method, ratio, cross_check, max_distance)

    def transform(self, T: ArrayLike) -> FeatureCloud:
        """The cloud in another frame: T (4, 4) rigid, maps this frame's coordinates to the new one's."""
        return FeatureCloud(transform_points(T, self.points), self.descriptors, self.pixels)
