"""Colour and depth images from files: whole, of a known kind and in metres, or refused with the file's name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["ImageFileError", "read_color", "read_depth"]

FARTHEST = 50.0
"""Depth [m] that half of an image's returns must not exceed: beyond it, its unit is not what was said."""
NEAREST = 0.02
"""Depth [m] that half of an image's returns must exceed, for the same reason."""
INVALID = 65535
"""What some cameras write where there is no return, besides 0 (16-bit images)."""
PNG_END = b"IEND\xaeB`\x82"
JPEG_START, JPEG_END = b"\xff\xd8", b"\xff\xd9"


class ImageFileError(ValueError):
    """An image that cannot be used; the one line names the file, what was expected and what came."""


def read_color(path: str | Path) -> NDArray[np.uint8]:
    """A colour or grey image (H, W, 3) uint8, RGB; transparency is dropped, 16 bits become 8.

    Raises:
        FileNotFoundError: no such file.
        ImageFileError: not an image, or one that ends early.
    """
    image = _decode(path, cv2.IMREAD_COLOR)
    if image.dtype != np.uint8:
        image = (image >> 8).astype(np.uint8) if image.dtype == np.uint16 else image
    if image.dtype != np.uint8:
        raise ImageFileError(f"{path}: expected 8 or 16 bits a channel, got {image.dtype}")
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), dtype=np.uint8)


def read_depth(path: str | Path, scale: float = 1000.0) -> NDArray[np.float32]:
    """A depth image (H, W) float32 [m], 0 where there is no return, from a 16-bit or float image of one channel.

    Args:
        scale: units of a 16-bit image a metre: 1000 for millimetres, 5000 in TUM's data sets. Float images are metres.

    Raises:
        FileNotFoundError: no such file.
        ImageFileError: not an image, one that ends early, of 8 bits or several channels, or in another unit: half of
            its returns are nearer than 2 cm or farther than 50 m.
        ValueError: a scale that is not positive.
    """
    if not 0.0 < scale < np.inf:
        raise ValueError(f"scale: expected a positive number of units a metre, got {scale}")
    image = _decode(path, cv2.IMREAD_UNCHANGED)
    if image.ndim != 2:
        raise ImageFileError(f"{path}: expected a depth image of one channel, got shape {image.shape}")
    if image.dtype == np.uint16:
        depth = np.where(image == INVALID, 0, image).astype(np.float32) / np.float32(scale)
    elif image.dtype == np.float32:
        depth = np.where(np.isfinite(image) & (image > 0.0), image, 0.0).astype(np.float32)
    else:
        raise ImageFileError(f"{path}: expected a depth image of 16 bits or floats, got {image.dtype}")
    seen = depth[depth > 0.0]
    if seen.size and not NEAREST <= (median := float(np.median(seen))) <= FARTHEST:
        raise ImageFileError(
            f"{path}: expected depths of {NEAREST:g} to {FARTHEST:g} m, got a median of {median:.4g} m: "
            f"its unit is not 1/{scale:g} m"
        )
    return depth


def _decode(path: str | Path, flags: int) -> NDArray[Any]:
    code = Path(path).read_bytes()
    # Decoders fill in what is missing from a file that was cut off, and say nothing.
    cut = (code.startswith(b"\x89PNG") and PNG_END not in code[-64:]) or (
        code.startswith(JPEG_START) and JPEG_END not in code[-4096:]
    )
    image = None
    if code and not cut:
        try:
            image = cv2.imdecode(np.frombuffer(code, dtype=np.uint8), flags)
        except cv2.error:  # OpenCV's own checks of a header
            image = None
    if image is None:
        what = "an image that ends early" if cut else "none"
        raise ImageFileError(f"{path}: expected a whole PNG, JPEG, TIFF or PGM image, got {what}")
    return image
