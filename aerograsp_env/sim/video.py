"""Write frames as PNG, GIF or MP4.

Every file is written under a temporary name in the same folder and renamed when it is whole, so an interrupted run
leaves the old file, or none, but never half a one.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

Frame = NDArray[np.uint8]  # (H, W, 3) sRGB

_PALETTE_FRAMES = 8  # frames that the common palette of a GIF is made from
_MAX_GIF_FPS = 50.0  # viewers slow down frames shorter than 20 ms


def write_video(path: str | Path, frames: Iterable[Frame], fps: float) -> Path:
    """Write `frames` in the format that the suffix of `path` names (``.gif`` or ``.mp4``).

    Args:
        path: of the file; its folder must exist.
        frames: (H, W, 3) uint8 each, all of one size; any iterable.
        fps: frames per second.

    Returns:
        `path`.

    Raises:
        ValueError: unknown suffix, no frames, frames of a wrong type or shape, or a wrong `fps`.
        OSError: the folder is missing or cannot be written to.
        RuntimeError: the codec does not open (MP4).
    """
    suffix = Path(path).suffix.lower()
    if suffix not in _WRITERS:
        raise ValueError(f"path must end in one of {', '.join(sorted(_WRITERS))}, got {str(path)!r}")
    return _WRITERS[suffix](path, frames, fps)


def write_gif(path: str | Path, frames: Iterable[Frame], fps: float) -> Path:
    """Write an endlessly looping GIF with one palette of 256 colours for all frames.

    GIF counts time in 10 ms: frame times are rounded so that the errors do not add up. Equal frames in a row are
    stored once, with the sum of their times. Arguments, result and errors are `write_video`'s; `fps` is at most 50,
    above which viewers slow the animation down.
    """
    _check_fps(fps, _MAX_GIF_FPS)
    images = [Image.fromarray(frame) for frame in _checked(frames)]
    palette = _palette(images)
    # No dithering: it would change still parts from frame to frame and double the size.
    quantised = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    ends = np.rint(100.0 * np.arange(1, len(images) + 1) / fps)  # [10 ms]
    durations = (10 * np.diff(ends, prepend=0.0)).astype(int).tolist()  # [ms]
    with _whole_file(path) as temporary:
        quantised[0].save(
            temporary, save_all=True, append_images=quantised[1:], duration=durations, loop=0, optimize=True, disposal=1
        )
    return Path(path)


def write_mp4(path: str | Path, frames: Iterable[Frame], fps: float) -> Path:
    """Write an MP4 (MPEG-4 part 2, ``mp4v``) with OpenCV, frame by frame, so `frames` may be a long generator.

    Arguments, result and errors are `write_video`'s. The codec wants even sides: an odd last row or column is repeated.
    """
    _check_fps(fps, 1000.0)
    with _whole_file(path) as temporary:
        writer = None
        try:
            for frame in _checked(frames):
                even = np.pad(frame, ((0, frame.shape[0] % 2), (0, frame.shape[1] % 2), (0, 0)), mode="edge")
                if writer is None:
                    size = (even.shape[1], even.shape[0])
                    writer = cv2.VideoWriter(str(temporary), cv2.VideoWriter.fourcc(*"mp4v"), float(fps), size)
                    if not writer.isOpened():
                        raise RuntimeError("OpenCV cannot open its mp4v codec on this machine: write a .gif instead")
                writer.write(cv2.cvtColor(even, cv2.COLOR_RGB2BGR))
        finally:
            if writer is not None:
                writer.release()
    return Path(path)


def write_png(path: str | Path, frame: Frame) -> Path:
    """Write one picture (H, W, 3) uint8 as PNG. Errors are `write_video`'s."""
    if Path(path).suffix.lower() != ".png":
        raise ValueError(f"path must end in .png, got {str(path)!r}")
    image = Image.fromarray(next(_checked([frame])))
    with _whole_file(path) as temporary:
        image.save(temporary, optimize=True)
    return Path(path)


_WRITERS: dict[str, Callable[[str | Path, Iterable[Frame], float], Path]] = {".gif": write_gif, ".mp4": write_mp4}


def _check_fps(fps: float, high: float) -> None:
    if not 0 < fps <= high:
        raise ValueError(f"fps must be positive and at most {high:g}, got {fps!r}")


def _checked(frames: Iterable[Frame]) -> Iterator[Frame]:
    shape = None
    for i, frame in enumerate(frames):
        array = np.asarray(frame)
        if array.dtype != np.uint8 or array.ndim != 3 or array.shape[2] != 3 or 0 in array.shape:
            raise ValueError(f"frames[{i}] must be (H, W, 3) uint8, got {array.shape} {array.dtype}")
        if shape is not None and array.shape != shape:
            raise ValueError(f"frames[{i}] must have the shape of the first, {shape}, got {array.shape}")
        shape = array.shape
        yield np.ascontiguousarray(array)
    if shape is None:
        raise ValueError("frames must hold at least one frame, got none")


def _palette(images: list[Image.Image]) -> Image.Image:
    """A palette image for all `images`, made from some of them.

    Colours count by the square root of how often they occur: else a large floor takes nearly all of the 256 and small
    bright things are left with bands.
    """
    some = images[:: max(1, len(images) // _PALETTE_FRAMES)]
    pixels = np.concatenate([np.asarray(image).reshape(-1, 3) for image in some])
    cell = (pixels >> 2).astype(np.int64) @ np.array([1 << 12, 1 << 6, 1])  # 64 levels a channel
    _, index, count = np.unique(cell, return_inverse=True, return_counts=True)
    mean = np.stack([np.bincount(index, pixels[:, k]) for k in range(3)], axis=1) / count[:, None]
    colors = np.repeat(np.rint(mean).astype(np.uint8), np.rint(np.sqrt(count)).astype(int), axis=0)
    return Image.fromarray(colors[None]).quantize(256, method=Image.Quantize.MEDIANCUT, kmeans=3)


@contextmanager
def _whole_file(path: str | Path) -> Iterator[Path]:
    """A temporary path beside `path`, with its suffix; it becomes `path` if all goes well and vanishes if not."""
    path = Path(path)
    if not path.parent.is_dir():
        raise NotADirectoryError(f"folder {str(path.parent)!r} of {path.name!r} does not exist")
    if path.is_dir():
        raise IsADirectoryError(f"{str(path)!r} is a folder, not a file")
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        temporary.touch()
    except OSError as error:
        raise PermissionError(f"folder {str(path.parent)!r} cannot be written to: {error.strerror}") from error
    try:
        yield temporary
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
