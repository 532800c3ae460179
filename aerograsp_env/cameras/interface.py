"""What every source of RGB-D frames has in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Self

from aerograsp_env.interfaces import RGBD, Intrinsics


class CameraError(RuntimeError):
    """A camera does not open, or stopped working; the message says what to do."""


class MissingPackage(CameraError):
    """A camera needs a Python package that is not installed; the message names it."""


@dataclass
class CameraReport:
    """What went wrong so far; a sequence with some bad frames goes on without them."""

    good: int = 0  # frames that were given
    bad: list[tuple[str, str]] = field(default_factory=list)  # (name of the frame, what was wrong)
    gaps: list[tuple[float, float]] = field(default_factory=list)  # stamps before and after [s]
    unmatched: int = 0  # pictures without a partner close enough in time

    def __str__(self) -> str:
        parts = [f"{self.good} frames"]
        if self.bad:
            name, why = self.bad[0]
            parts.append(f"{len(self.bad)} bad ones left out (first {name}: {why})")
        if self.gaps:
            longest = max(after - before for before, after in self.gaps)
            parts.append(f"{len(self.gaps)} gaps in the time stamps, up to {longest:.3g} s")
        if self.unmatched:
            parts.append(f"{self.unmatched} pictures without a partner in time")
        return "; ".join(parts)


class Camera(ABC):
    """A source of RGB-D frames: `read` until None, or iterate. Also a context manager that closes it."""

    report: CameraReport

    @property
    @abstractmethod
    def intrinsics(self) -> Intrinsics:
        """Of the colour camera; `T_color_depth` is None if depth is registered to colour."""

    @abstractmethod
    def read(self) -> RGBD | None:
        """The next frame, waiting for it if need be; None at the end of a recording.

        Raises:
            CameraError: the camera stopped working.
        """

    @abstractmethod
    def close(self) -> None:
        """Free the device or files; a second call does nothing."""

    def __iter__(self) -> Iterator[RGBD]:
        while (frame := self.read()) is not None:
            yield frame

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def read_intrinsics(value: Any, name: str = "intrinsics") -> Intrinsics:
    """Intrinsics from what a configuration holds: a mapping of width, height, fx, fy, cx, cy and maybe distortion.

    Raises:
        ValueError: something is missing, unknown or out of range.
    """
    if isinstance(value, Intrinsics):
        return value
    needed = ("width", "height", "fx", "fy", "cx", "cy")
    if not isinstance(value, Mapping):
        raise ValueError(f"{name}: expected a table of {', '.join(needed)}, got {value!r}")
    missing = [key for key in needed if key not in value]
    if missing:
        raise ValueError(f"{name}: {', '.join(missing)} missing; expected {', '.join(needed)}")
    unknown = sorted(set(value) - {*needed, "distortion", "T_color_depth"})
    if unknown:
        raise ValueError(
            f"{name}: unknown entry {unknown[0]!r}; expected {', '.join(needed)}, distortion, T_color_depth"
        )
    for key in needed:
        if isinstance(value[key], bool) or not isinstance(value[key], int | float):
            raise ValueError(f"{name}: {key}: expected a number, got {value[key]!r}")
    return Intrinsics(**value)


def missing_package(camera: str, package: str, install: str) -> MissingPackage:
    """The one error of an absent package."""
    return MissingPackage(f"{camera} needs the Python package {package!r}, which is not installed here: {install}")
