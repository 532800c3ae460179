"""Fast colour segmentation: classes by a bitwise AND of three look-up tables (Bruce, Balch & Veloso 2000)."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

MAX_CLASSES = 32  # bits of a table's entries
SPACES = {"hsv": cv2.COLOR_RGB2HSV_FULL, "yuv": cv2.COLOR_RGB2YUV, "lab": cv2.COLOR_RGB2LAB, "rgb": None}
SMOOTHING = 2.0  # [levels] deviation by which learned histograms are widened


class ColorRegion(NamedTuple):
    """A connected region of one class."""

    label: str
    box: NDArray[np.float64]  # (4,) xyxy [px] of its pixels' edges
    area: int  # [px]
    centroid: NDArray[np.float64]  # (2,) x, y [px]


@dataclass(frozen=True, eq=False)
class ColorSegmenter:
    """Colour classes, each a product of sets of the three channels' values.

    A pixel belongs to a class if each of its channels has a value of the class. Tables hold one bit for each class, so
    that an AND of three entries answers for all classes at once. Sets need not be intervals: hue may wrap.

    Raises:
        ValueError: more than 32 classes, none, tables of another shape, or an unknown colour space.
    """

    labels: tuple[str, ...]
    tables: NDArray[np.uint32]  # (3, 256): bit k of entry (c, v) says whether class k has value v in channel c
    space: str = "hsv"  # "hsv" (hue over the full byte), "yuv", "lab" or "rgb"

    def __post_init__(self) -> None:
        labels = tuple(str(label) for label in self.labels)
        if not 1 <= len(labels) <= MAX_CLASSES or len(set(labels)) != len(labels):
            raise ValueError(f"labels: expected 1 to {MAX_CLASSES} different names, got {list(labels)}")
        if self.space not in SPACES:
            raise ValueError(f"space: expected one of {', '.join(SPACES)}, got {self.space!r}")
        tables = np.array(self.tables)
        if tables.shape != (3, 256) or tables.dtype != np.uint32:
            raise ValueError(f"tables: expected (3, 256) uint32, got {tables.shape} {tables.dtype}")
        tables.setflags(write=False)
        object.__setattr__(self, "labels", labels)
        object.__setattr__(self, "tables", tables)

    @classmethod
    def from_ranges(cls, ranges: Mapping[str, ArrayLike], space: str = "hsv") -> ColorSegmenter:
        """Classes from intervals: (3, 2) of first and last value, both included; a first above the last wraps around.

        Raises:
            ValueError: another shape, or values that are not whole numbers from 0 to 255.
        """
        tables = np.zeros((3, 256), dtype=np.uint32)
        for k, (label, given) in enumerate(ranges.items()):
            bounds = np.asarray(given, dtype=np.float64)
            whole = bounds.shape == (3, 2) and bool(((bounds >= 0) & (bounds <= 255) & (bounds % 1 == 0)).all())
            if not whole:
                raise ValueError(f"ranges[{label!r}]: expected (3, 2) whole numbers from 0 to 255, got {given!r}")
            values = np.arange(256)
            for channel, (low, high) in enumerate(bounds):
                inside = (values >= low) & (values <= high) if low <= high else (values >= low) | (values <= high)
                tables[channel, inside] |= np.uint32(1 << min(k, MAX_CLASSES - 1))
        return cls(tuple(ranges), tables, space)

    @classmethod
    def learn(
        cls, pixels: Mapping[str, ArrayLike], space: str = "hsv", coverage: float = 0.98, min_share: float = 0.0
    ) -> ColorSegmenter:
        """Classes from labelled pixels: in each channel the most frequent values that hold `coverage` of them.

        Args:
            pixels: (N, 3) RGB uint8 of each class.
            coverage: share of a class's pixels within each channel's set, in (0, 1].
            min_share: values rarer than this share of the most frequent one are left out even so.

        Raises:
            ValueError: another shape or type, a class without pixels, or settings out of range.
        """
        if not 0.0 < coverage <= 1.0 or not 0.0 <= min_share < 1.0:
            raise ValueError(f"coverage, min_share: expected in (0, 1] and [0, 1), got {coverage}, {min_share}")
        if space not in SPACES:
            raise ValueError(f"space: expected one of {', '.join(SPACES)}, got {space!r}")
        tables = np.zeros((3, 256), dtype=np.uint32)
        for k, (label, given) in enumerate(pixels.items()):
            colors = np.asarray(given)
            if colors.dtype != np.uint8 or colors.ndim != 2 or colors.shape[1] != 3 or not len(colors):
                raise ValueError(f"pixels[{label!r}]: expected (N, 3) uint8, N ≥ 1, got {colors.shape} {colors.dtype}")
            converted = _convert(colors[None], space)[0]
            for channel in range(3):
                counts = np.bincount(converted[:, channel], minlength=256).astype(np.float64)
                smooth = _smooth(counts, wraps=space == "hsv" and channel == 0)
                order = np.argsort(-smooth, kind="stable")
                held = np.cumsum(counts[order])
                chosen = order[: int(np.searchsorted(held, coverage * counts.sum() - 1e-9)) + 1]
                chosen = chosen[smooth[chosen] >= min_share * smooth.max()]
                tables[channel, chosen] |= np.uint32(1 << min(k, MAX_CLASSES - 1))
        return cls(tuple(pixels), tables, space)

    def segment(self, image: ArrayLike) -> NDArray[np.uint32]:
        """(H, W) bits: bit k of a pixel says whether it belongs to class k.

        Args:
            image: (H, W, 3) RGB, uint8.

        Raises:
            ValueError: another shape or type.
        """
        rgb = np.asarray(image)
        if rgb.dtype != np.uint8 or rgb.ndim != 3 or rgb.shape[2] != 3 or not rgb.size:
            raise ValueError(f"image: expected (H, W, 3) uint8, got {rgb.shape} {rgb.dtype}")
        first, second, third = cv2.split(_convert(rgb, self.space))
        return self.tables[0][first] & self.tables[1][second] & self.tables[2][third]

    def mask(self, image: ArrayLike, label: str) -> NDArray[np.bool_]:
        """(H, W) the pixels of one class."""
        if label not in self.labels:
            raise ValueError(f"label: expected one of {', '.join(self.labels)}, got {label!r}")
        return (self.segment(image) >> np.uint32(self.labels.index(label)) & np.uint32(1)).astype(bool)

    def regions(self, image: ArrayLike, min_area: int = 50, connectivity: int = 8) -> list[ColorRegion]:
        """The connected regions of every class, largest first.

        Args:
            min_area: [px] of the smallest to be kept.
            connectivity: 4 or 8 neighbours.

        Raises:
            ValueError: as `segment`, or settings out of range.
        """
        if min_area < 1 or connectivity not in (4, 8):
            raise ValueError(f"min_area, connectivity: expected ≥ 1, and 4 or 8, got {min_area}, {connectivity}")
        bits = self.segment(image)
        found = []
        for k, label in enumerate(self.labels):
            mask = (bits >> np.uint32(k) & np.uint32(1)).astype(np.uint8)
            count, _, stats, centroids = cv2.connectedComponentsWithStats(mask, connectivity=connectivity)
            for row in range(1, count):
                x, y, width, height, area = (int(v) for v in stats[row])
                if area >= min_area:
                    box = np.array([x, y, x + width, y + height], dtype=np.float64) - 0.5
                    found.append(ColorRegion(label, box, area, np.array(centroids[row], dtype=np.float64)))
        return sorted(found, key=lambda region: -region.area)

    def save(self, path: str | Path) -> None:
        """Write the classes as JSON: for each channel and class the values as ranges."""
        classes = {}
        for k, label in enumerate(self.labels):
            member = (self.tables >> np.uint32(k) & np.uint32(1)).astype(np.int8)
            edges = np.diff(np.pad(member, ((0, 0), (1, 1))), axis=1)
            classes[label] = [
                np.column_stack([np.nonzero(row == 1)[0], np.nonzero(row == -1)[0] - 1]).tolist() for row in edges
            ]
        Path(path).write_text(json.dumps({"space": self.space, "classes": classes}, indent=1) + "\n", encoding="utf-8")

    @classmethod
    def load(cls, path: str | Path) -> ColorSegmenter:
        """Read what `save` wrote.

        Raises:
            FileNotFoundError: no such file.
            ValueError: another content, naming the file.
        """
        text = Path(path).read_bytes()
        try:
            data = json.loads(text)
            tables = np.zeros((3, 256), dtype=np.uint32)
            for k, channels in enumerate(data["classes"].values()):
                if len(channels) != 3:
                    raise ValueError(f"expected 3 channels, got {len(channels)}")
                for channel, ranges in enumerate(channels):
                    for low, high in ranges:
                        if not 0 <= low <= high <= 255:
                            raise ValueError(f"expected ranges within 0 to 255, got {[low, high]}")
                        tables[channel, low : high + 1] |= np.uint32(1 << min(k, MAX_CLASSES - 1))
            return cls(tuple(data["classes"]), tables, data["space"])
        except (KeyError, TypeError, AttributeError, ValueError) as fault:
            raise ValueError(f"{path}: expected colour classes written by ColorSegmenter.save: {fault}") from None


def _convert(rgb: NDArray[np.uint8], space: str) -> NDArray[np.uint8]:
    code = SPACES[space]
    return rgb if code is None else np.asarray(cv2.cvtColor(np.ascontiguousarray(rgb), code), dtype=np.uint8)


def _smooth(counts: NDArray[np.float64], wraps: bool) -> NDArray[np.float64]:
    """Convolved with a Gaussian: values between those of the sample are as likely as their neighbours."""
    reach = int(4 * SMOOTHING)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / SMOOTHING) ** 2)
    padded = np.pad(counts, reach, mode="wrap" if wraps else "constant")
    return np.convolve(padded, kernel / kernel.sum(), mode="valid")
