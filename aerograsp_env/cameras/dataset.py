"""A data set on disk as a camera."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from aerograsp_env.cameras.image_files import DepthUnitError, read_color, read_depth
from aerograsp_env.cameras.interface import Camera, CameraReport, read_intrinsics
from aerograsp_env.cameras.layouts import Entry, Layout, read_pose, recognise, sized
from aerograsp_env.interfaces import RGBD, Intrinsics

_FIRST_TRIED = 10  # frames that may be bad before the first good one
_GAP = 3.0  # median periods


class DatasetCamera(Camera):
    """Frames of a data set, one after another.

    Layouts are recognised by their files: TUM RGB-D (rgb.txt, depth.txt, groundtruth.txt; Sturm et al. 2012), 7-Scenes
    (frame-000000.color.png, .depth.png, .pose.txt; Shotton et al. 2013), folders `color` (or `rgb`) and `depth` with
    equal names, and NAME.png beside NAME_depth.png. A file `camera-intrinsics.txt` (3×3) is read where there is one.

    A frame whose files are missing, truncated, of another size or type, or whose pose is not rigid, is left out and
    counted in `report`, as are gaps of more than three median periods in the stamps.

    Args:
        path: the folder.
        intrinsics: of the colour camera, where the data set does not say (or to override what it says).
        depth_unit: steps of the depth image a metre; None for the layout's own (TUM 5000, the others 1000).
        max_gap: [s] between stamps of a picture, its depth and its pose (TUM).
        start, stop, step: which frames, as in a slice.

    Raises:
        FileNotFoundError: there is no such folder.
        ValueError: no layout is recognised, intrinsics are missing or of another size, no frame can be read, or the
            first depths are not in the unit that they should be in.
    """

    def __init__(
        self,
        path: str | Path,
        intrinsics: Any = None,
        depth_unit: float | None = None,
        max_gap: float = 0.02,
        start: int = 0,
        stop: int | None = None,
        step: int = 1,
    ) -> None:
        self.path = Path(path)
        for name, value in (("depth_unit", depth_unit), ("max_gap", max_gap)):
            if value is not None and not 0.0 < value < np.inf:
                raise ValueError(f"{name}: expected a positive number, got {value!r}")
        if step < 1 or start < 0:
            raise ValueError(f"start, step: expected start ≥ 0 and step ≥ 1, got {start!r} and {step!r}")
        layout = recognise(self.path, float(max_gap))
        self.layout = layout.name
        self._entries = layout.entries[start:stop:step]
        if not self._entries:
            raise ValueError(f"{self.path}: start {start}, stop {stop}: the data set has {len(layout.entries)} frames")
        self._unit = float(depth_unit or layout.unit)
        self._next = 0
        self.report = CameraReport(unmatched=layout.unmatched, gaps=_gaps([e.stamp for e in self._entries]))
        self._intrinsics = self._first_look(layout, intrinsics)

    @property
    def intrinsics(self) -> Intrinsics:
        """Of the colour camera."""
        return self._intrinsics

    def __len__(self) -> int:
        """Frames on disk, bad ones included."""
        return len(self._entries)

    def read(self) -> RGBD | None:
        """The next good frame, None at the end.

        Raises:
            ValueError: the end, and not one frame was good.
        """
        while self._next < len(self._entries):
            entry = self._entries[self._next]
            self._next += 1
            try:
                frame = self._load(entry)
            except (OSError, ValueError) as error:
                self.report.bad.append((entry.color.name, " ".join(str(error).split())))
                continue
            self.report.good += 1
            return frame
        if not self.report.good and self.report.bad:
            raise ValueError(f"{self.path}: no frame can be read: {self.report}")
        return None

    def close(self) -> None:
        """End the sequence."""
        self._next = len(self._entries)

    def _first_look(self, layout: Layout, given: Any) -> Intrinsics:
        """Intrinsics for the size of the first picture that can be read, with its depth's unit checked."""
        fault: Exception | None = None
        for entry in self._entries[:_FIRST_TRIED]:
            try:
                size = read_color(entry.color).shape[:2]
                read_depth(entry.depth, self._unit)
            except DepthUnitError as error:
                raise ValueError(f"{error} by depth_unit") from error
            except (OSError, ValueError) as error:
                fault = fault or error
                continue
            if given is not None:
                camera = read_intrinsics(given)
                if (camera.height, camera.width) != size:
                    raise ValueError(
                        f"intrinsics: expected those of the pictures of {self.path}, which are {size[1]}×{size[0]}, "
                        f"got {camera.width}×{camera.height}"
                    )
                return camera
            if layout.intrinsics is None:
                raise ValueError(
                    f"{self.path}: intrinsics missing: expected camera-intrinsics.txt (3×3) in it, or "
                    "intrinsics = {width, height, fx, fy, cx, cy} in the configuration"
                )
            return sized(layout.intrinsics, (size[0], size[1]))
        raise ValueError(f"{self.path}: none of the first {_FIRST_TRIED} frames can be read: {fault}")

    def _load(self, entry: Entry) -> RGBD:
        size = (self._intrinsics.height, self._intrinsics.width)
        rgb, depth = read_color(entry.color), read_depth(entry.depth, self._unit)
        for path, shape in ((entry.color, rgb.shape[:2]), (entry.depth, depth.shape)):
            if shape != size:
                raise ValueError(f"{path.name}: expected {size[1]}×{size[0]} pixels, got {shape[1]}×{shape[0]}")
        pose = read_pose(entry.pose) if isinstance(entry.pose, Path) else entry.pose
        return RGBD(rgb, depth, self._intrinsics, entry.stamp, pose)


def _gaps(stamps: list[float]) -> list[tuple[float, float]]:
    periods = np.diff(stamps)
    if not len(periods):
        return []
    usual = float(np.median(periods))
    return [(stamps[i], stamps[i + 1]) for i in np.flatnonzero(periods > _GAP * max(usual, 1e-9))]
