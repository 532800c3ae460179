"""Layouts of RGB-D data sets on disk, recognised by their files."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.interfaces import Intrinsics
from aerograsp_env.spatial import matrix_from_quat_wxyz, project_to_so3, quat_wxyz_from_xyzw, transform

Array = NDArray[np.float64]

_PICTURES = (".png", ".jpg", ".jpeg")
_PERIOD = 1.0 / 30.0  # [s] between frames that have numbers and no stamps
_FREIBURG = {  # Sturm et al. 2012, the calibrated colour cameras of the three parts of the data set
    "1": (517.3, 516.5, 318.6, 255.3),
    "2": (520.9, 521.0, 325.1, 249.7),
    "3": (535.4, 539.2, 320.1, 247.6),
}
_SEVEN_SCENES = (585.0, 585.0, 320.0, 240.0)  # Shotton et al. 2013; the depth camera's


class Entry(NamedTuple):
    """One frame on disk."""

    stamp: float  # [s]
    color: Path
    depth: Path
    pose: Path | Array | None  # a file with a matrix, T_world_camera (4, 4), or None


class Layout(NamedTuple):
    """A data set on disk."""

    name: str
    entries: list[Entry]  # in order of time
    unit: float  # steps of the depth image a metre
    intrinsics: tuple[float, float, float, float] | None  # fx, fy, cx, cy [px], where the data set says
    unmatched: int  # pictures without a partner


def recognise(folder: Path, max_gap: float) -> Layout:
    """Which layout a folder has.

    Raises:
        FileNotFoundError: there is no such folder.
        ValueError: it has no layout that is known, or files of one that do not hold what they should.
    """
    if not folder.is_dir():
        raise FileNotFoundError(f"{folder}: no such folder")
    if (folder / "rgb.txt").is_file() and (folder / "depth.txt").is_file():
        return _tum(folder, max_gap)
    if any(folder.glob("frame-*.color.*")):
        return _seven_scenes(folder)
    for color in ("color", "rgb"):
        if (folder / color).is_dir() and (folder / "depth").is_dir():
            return _matched("folders", _numbered(folder / color), _numbered(folder / "depth"), folder)
    depths = {p.stem.removesuffix("_depth"): p for p in folder.glob("*_depth.png")}
    if depths:
        colors = {stem: p for stem, p in _numbered(folder).items() if not stem.endswith("_depth")}
        return _matched("pairs", colors, depths, folder)._replace(unit=5000.0)
    raise ValueError(
        f"{folder}: expected an RGB-D data set: rgb.txt and depth.txt (TUM), frame-000000.color.* and .depth.png "
        "(7-Scenes), folders color (or rgb) and depth with equal names, or NAME.png with NAME_depth.png"
    )


def read_matrix(path: Path, shape: tuple[int, int]) -> Array:
    """A matrix in a text file.

    Raises:
        ValueError: the file does not hold `shape` finite numbers.
        OSError: it cannot be read.
    """
    try:
        values = [float(word) for word in path.read_text(errors="replace").split()]
    except ValueError as error:
        raise ValueError(f"{path.name}: expected numbers: {error}") from error
    if len(values) != shape[0] * shape[1] or not all(map(math.isfinite, values)):
        raise ValueError(f"{path.name}: expected {shape[0]}×{shape[1]} finite numbers, got {len(values)}")
    return np.array(values).reshape(shape)


def read_pose(path: Path) -> Array:
    """T_world_camera (4, 4) of a text file; its rotation is projected, for files hold few digits.

    Raises:
        ValueError: it is not within 1 % of a rigid transform.
    """
    T = read_matrix(path, (4, 4))
    if np.abs(T[3] - [0, 0, 0, 1]).max() > 1e-6 or np.abs(T[:3, :3] @ T[:3, :3].T - np.eye(3)).max() > 0.01:
        raise ValueError(f"{path.name}: expected a rigid transform (4×4)")
    return transform(project_to_so3(T[:3, :3]), T[:3, 3])


def intrinsics_file(folder: Path) -> tuple[float, float, float, float] | None:
    """fx, fy, cx, cy of a `camera-intrinsics.txt` (3×3), or None if there is none."""
    path = folder / "camera-intrinsics.txt"
    if not path.is_file():
        return None
    K = read_matrix(path, (3, 3))
    return float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])


def sized(camera: tuple[float, float, float, float], size: tuple[int, int]) -> Intrinsics:
    """Intrinsics of an image of `size` (height, width)."""
    return Intrinsics(size[1], size[0], *camera)


def _stamped(path: Path, columns: int) -> list[tuple[float, list[str]]]:
    """Rows of a TUM text file, in order of time: the stamp and the other words."""
    rows = []
    for number, line in enumerate(path.read_text(errors="replace").splitlines(), 1):
        words = line.replace(",", " ").split()
        if not words or words[0].startswith("#"):
            continue
        try:
            stamp = float(words[0])
        except ValueError:
            stamp = math.nan
        if len(words) < columns or not math.isfinite(stamp):
            raise ValueError(f"{path}, line {number}: expected a stamp and {columns - 1} more words, got {line!r}")
        rows.append((stamp, words[1:]))
    if not rows:
        raise ValueError(f"{path}: expected lines of a stamp and a file name, got none")
    return sorted(rows, key=lambda row: row[0])


def _nearest(stamps: Array, stamp: float, max_gap: float) -> int | None:
    """The index of the stamp that is closest, if within `max_gap`."""
    i = int(np.searchsorted(stamps, stamp))
    best = min((j for j in (i - 1, i) if 0 <= j < len(stamps)), key=lambda j: abs(stamps[j] - stamp))
    return best if abs(stamps[best] - stamp) <= max_gap else None


def _tum(folder: Path, max_gap: float) -> Layout:
    colors, depths = _stamped(folder / "rgb.txt", 2), _stamped(folder / "depth.txt", 2)
    truth = _stamped(folder / "groundtruth.txt", 8) if (folder / "groundtruth.txt").is_file() else []
    depth_stamps, truth_stamps = np.array([s for s, _ in depths]), np.array([s for s, _ in truth])
    entries, used = [], set()
    for stamp, words in colors:
        match = _nearest(depth_stamps, stamp, max_gap)
        if match is None or match in used:
            continue
        used.add(match)
        at = _nearest(truth_stamps, stamp, max_gap) if truth else None
        pose = None if at is None else _truth(folder / "groundtruth.txt", truth[at][1])
        entries.append(Entry(stamp, folder / words[0], folder / depths[match][1][0], pose))
    if not entries:
        raise ValueError(f"{folder}: no picture of rgb.txt has one of depth.txt within {max_gap:g} s")
    part = re.search(r"(?:freiburg|fr)([123])", folder.resolve().name)
    camera = _FREIBURG[part.group(1)] if part else intrinsics_file(folder)
    return Layout("TUM", entries, 5000.0, camera, len(colors) + len(depths) - 2 * len(entries))


def _truth(path: Path, words: list[str]) -> Array:
    try:
        values = np.array([float(word) for word in words[:7]])
        return transform(matrix_from_quat_wxyz(quat_wxyz_from_xyzw(values[3:])), values[:3])
    except ValueError as error:
        raise ValueError(f"{path}: expected tx ty tz qx qy qz qw, got {' '.join(words)!r}") from error


def _seven_scenes(folder: Path) -> Layout:
    colors = {p.name.split(".")[0]: p for p in sorted(folder.glob("frame-*.color.*")) if p.suffix in _PICTURES}
    depths = {p.name.split(".")[0]: p for p in folder.glob("frame-*.depth.png")}
    layout = _matched("7-Scenes", colors, depths, folder)
    poses = [folder / f"{entry.color.name.split('.')[0]}.pose.txt" for entry in layout.entries]
    entries = [e._replace(pose=p if p.is_file() else None) for e, p in zip(layout.entries, poses, strict=True)]
    return layout._replace(entries=entries, intrinsics=layout.intrinsics or _SEVEN_SCENES)


def _numbered(folder: Path) -> dict[str, Path]:
    return {p.stem: p for p in folder.iterdir() if p.suffix.lower() in _PICTURES}


def _order(stem: str) -> tuple[int, str]:
    """Frames sort by the last number in their names, so that 10 comes after 9."""
    numbers = re.findall(r"\d+", stem)
    return (int(numbers[-1]) if numbers else -1, stem)


def _matched(name: str, colors: dict[str, Path], depths: dict[str, Path], folder: Path) -> Layout:
    """Frames whose names are equal; their numbers are their stamps, at 30 frames a second."""
    stems = sorted(colors.keys() & depths.keys(), key=_order)
    if not stems:
        raise ValueError(f"{folder}: expected colour and depth pictures with equal names, found no pair")
    first = _order(stems[0])[0]
    stamps = [(_order(stem)[0] - first) * _PERIOD if first >= 0 else i * _PERIOD for i, stem in enumerate(stems)]
    entries = [Entry(t, colors[stem], depths[stem], None) for t, stem in zip(stamps, stems, strict=True)]
    return Layout(name, entries, 1000.0, intrinsics_file(folder), len(colors) + len(depths) - 2 * len(stems))
