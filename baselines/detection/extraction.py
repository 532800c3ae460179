"""Image features of any detector with any descriptor: "fast+sift", "orb+orb", "shi-tomasi+brief", …"""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.detection.brief import brief
from baselines.objects.feature_cloud import ImageFeatures

DETECTORS = ("sift", "orb", "fast", "shi-tomasi")
DESCRIPTORS = ("sift", "orb", "brief", "rbrief")

FAST_THRESHOLD = 10  # grey levels
SIFT_CONTRAST = 0.02  # half of Lowe's: an object's faint features count, since the strongest n are taken anyhow
CORNER_QUALITY, CORNER_SPACING = 0.01, 4.0  # share of the strongest corner's eigenvalue; [px]
PATCH = 7.0  # [px] size of a keypoint of a detector without scale, as FAST's is
NO_ANGLE = -1.0  # OpenCV's mark of a keypoint without direction


class FeatureKind(NamedTuple):
    """A detector and a descriptor, which can be exchanged freely."""

    detector: str  # "sift" (Lowe 2004), "orb" (Rublee 2011), "fast" (Rosten & Drummond 2006), "shi-tomasi" (1994)
    descriptor: str  # "sift", "orb", "brief" (Calonder 2010, upright), "rbrief" (turned by the keypoint's direction)

    @property
    def width(self) -> int:
        """Entries of a descriptor: 128 numbers for SIFT, 32 bytes for ORB, 64 bytes for BRIEF."""
        return {"sift": 128, "orb": 32}.get(self.descriptor, 64)

    @property
    def dtype(self) -> type:
        return np.float32 if self.descriptor == "sift" else np.uint8

    def __str__(self) -> str:
        return f"{self.detector}+{self.descriptor}"


def feature_kind(name: str) -> FeatureKind:
    """The pair that "detector+descriptor" names; "sift" and "orb" alone stand for both.

    Raises:
        ValueError: an unknown name.
    """
    detector, plus, descriptor = str(name).partition("+")
    kind = FeatureKind(detector, descriptor if plus else detector)
    if kind.detector not in DETECTORS or kind.descriptor not in DESCRIPTORS:
        raise ValueError(
            f'feature: expected "detector+descriptor", one of {", ".join(DETECTORS)} '
            f"with one of {', '.join(DESCRIPTORS)}, got {name!r}"
        )
    return kind


def check_image(image: ArrayLike, name: str = "image") -> NDArray[np.uint8]:
    """The image in grey, (H, W) uint8, from (H, W) or (H, W, 3) RGB.

    Raises:
        ValueError: another shape or type.
    """
    array = np.asarray(image)
    shaped = array.ndim == 2 or (array.ndim == 3 and array.shape[2] == 3)
    if array.dtype != np.uint8 or not shaped or not array.size:
        raise ValueError(f"{name}: expected uint8 of shape (H, W) or (H, W, 3), got {array.dtype} {array.shape}")
    return array if array.ndim == 2 else np.asarray(cv2.cvtColor(array, cv2.COLOR_RGB2GRAY), dtype=np.uint8)


def extract(
    image: ArrayLike, feature: str | FeatureKind = "sift", n: int = 1000, mask: ArrayLike | None = None
) -> ImageFeatures:
    """At most n features of an image, strongest first.

    Corners of FAST and Shi-Tomasi have one scale and no direction: descriptors at them are upright. For "rbrief" they
    have the direction of −1° that OpenCV's keypoints without one carry, as models made with OpenCV do.

    Args:
        image: (H, W) or (H, W, 3) RGB, uint8.
        feature: see `feature_kind`.
        mask: (H, W) bool: where features may lie; None is everywhere.

    Raises:
        ValueError: another shape or type, an unknown feature, or n < 1.
    """
    gray = check_image(image)
    kind = feature if isinstance(feature, FeatureKind) else feature_kind(feature)
    if n < 1:
        raise ValueError(f"n: expected a number of features ≥ 1, got {n}")
    allowed = None
    if mask is not None:
        allowed = np.ascontiguousarray(mask, dtype=bool).astype(np.uint8)
        if allowed.shape != gray.shape:
            raise ValueError(f"mask: expected the image's shape {gray.shape}, got {allowed.shape}")
    keypoints = sorted(_detect(gray, kind.detector, n, allowed), key=lambda k: -k.response)[:n]
    keypoints, descriptors = _describe(gray, kind.descriptor, keypoints)
    if not len(keypoints):
        return ImageFeatures(np.empty((0, 2)), np.empty((0, kind.width), dtype=kind.dtype), np.empty(0))
    responses = np.array([k.response for k in keypoints], dtype=np.float64)
    order = np.argsort(-responses, kind="stable")[:n]
    pixels = np.array([k.pt for k in keypoints], dtype=np.float64)
    return ImageFeatures(pixels[order], descriptors[order], responses[order])


def _detect(gray: NDArray[np.uint8], detector: str, n: int, mask: NDArray[np.uint8] | None) -> list[cv2.KeyPoint]:
    if detector == "sift":
        return list(cv2.SIFT.create(nfeatures=n, contrastThreshold=SIFT_CONTRAST).detect(gray, mask))
    if detector == "orb":
        return list(cv2.ORB.create(nfeatures=n).detect(gray, mask))
    if detector == "fast":
        return list(cv2.FastFeatureDetector.create(FAST_THRESHOLD).detect(gray, mask))
    corners = cv2.goodFeaturesToTrack(gray, n, CORNER_QUALITY, CORNER_SPACING, mask=mask)
    corners = np.empty((0, 2)) if corners is None else corners.reshape(-1, 2)
    # The order of the corners is that of their strength, which OpenCV does not tell.
    strength = np.linspace(1.0, 0.0, len(corners), endpoint=False)
    return [
        cv2.KeyPoint(float(x), float(y), PATCH, NO_ANGLE, float(s)) for (x, y), s in zip(corners, strength, strict=True)
    ]


def _describe(
    gray: NDArray[np.uint8], descriptor: str, keypoints: list[cv2.KeyPoint]
) -> tuple[list[cv2.KeyPoint], NDArray[Any]]:
    """Descriptors, and the keypoints that could have one."""
    if not keypoints:
        return [], np.empty((0, 0))
    if descriptor in ("brief", "rbrief"):
        pixels = np.array([k.pt for k in keypoints])
        angles = np.array([k.angle for k in keypoints]) if descriptor == "rbrief" else None
        described, inside = brief(gray, pixels, angles)
        return [k for k, good in zip(keypoints, inside, strict=True) if good], described
    describer: Any = cv2.SIFT.create() if descriptor == "sift" else cv2.ORB.create()
    if descriptor == "orb":
        # ORB reads the octave as a level of its own pyramid; SIFT packs other things into it.
        for k in keypoints:
            k.octave = k.octave if 0 <= k.octave < 8 else 0
    kept, found = describer.compute(gray, keypoints)
    return (list(kept), np.asarray(found)) if found is not None else ([], np.empty((0, 0)))
