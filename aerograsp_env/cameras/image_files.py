"""Colour and depth pictures from files: whole, of a known kind and in metres, or refused with the file's name."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

__all__ = ["DepthUnitError", "ImageFileError", "read_color", "read_depth"]

PLAUSIBLE = (0.05, 60.0)
"""Where the median [m] of a depth picture lies if its unit is right."""
NO_RETURN = 65535
"""What some cameras write where there is no return, besides 0 (16-bit pictures)."""


class ImageFileError(ValueError):
    """A picture that cannot be used; the one line names the file, what was expected and what came."""


class DepthUnitError(ImageFileError):
    """A depth picture in another unit than it should be in."""


def read_color(path: str | Path) -> NDArray[np.uint8]:
    """A colour or grey picture as (H, W, 3) uint8, RGB; transparency is dropped.

    Raises:
        FileNotFoundError: no such file.
        ImageFileError: not a picture, or one that ends early.
    """
    return np.asarray(_open(Path(path)).convert("RGB"))


def read_depth(path: str | Path, unit: float = 1000.0) -> NDArray[np.float32]:
    """A depth picture (H, W) float32 [m], 0 where there is no return.

    Args:
        path: a picture of one channel, 16 bits a pixel, or floats, which are metres.
        unit: steps of a 16-bit picture a metre: 1000 for millimetres, 5000 in TUM's data sets.

    Raises:
        FileNotFoundError: no such file.
        ImageFileError: not a picture, one that ends early, or of another kind.
        DepthUnitError: half of its returns are nearer than 5 cm, or farther than 60 m.
        ValueError: a unit that is not positive.
    """
    path = Path(path)
    if not 0.0 < unit < np.inf:
        raise ValueError(f"unit: expected a positive number of steps a metre, got {unit}")
    image = _open(path)
    values = np.asarray(image)
    if image.mode == "F":
        depth = np.where(np.isfinite(values) & (values > 0.0), values, 0.0).astype(np.float32)
    elif image.mode in ("I;16", "I;16B", "I"):
        depth = np.where(values >= NO_RETURN, 0, values).astype(np.float32) / np.float32(unit)
    else:
        raise ImageFileError(f"{path}: expected a depth picture of 16 bits a pixel, got mode {image.mode}")
    seen = depth[depth > 0.0]
    if seen.size and not PLAUSIBLE[0] <= (median := float(np.median(seen))) <= PLAUSIBLE[1]:
        raise DepthUnitError(
            f"{path}: expected depths in steps of 1/{unit:g} m, but their median would be {median:.3g} m: set the unit"
        )
    return depth


def _open(path: Path) -> Image.Image:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Pillow's doubts about sizes
            image = Image.open(path)
            image.load()  # a truncated file is found out here
    except FileNotFoundError as error:
        raise FileNotFoundError(f"{path}: no such file") from error
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise ImageFileError(f"{path}: expected a whole picture: {error}") from error
    return image
