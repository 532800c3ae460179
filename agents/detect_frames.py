"""The pictures of a data set, decoded once and held in memory as the augmentation wants them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.detect_assign import IGNORED
from agents.detect_augment import UNITS, Frame, Frames
from agents.detect_input import inverse_depth


class FrameCache:
    """Data sets whose pictures are decoded when they are first asked for: 0.4 MB each at 320 × 240.

    Args:
        datasets: each an `agents.detect_dataset.DetectDataset`, or anything with `len` and samples of rgb, depth,
            boxes, labels and difficult.
        count: how many of the first pictures; all by default.

    Raises:
        ValueError: no pictures.
    """

    def __init__(self, datasets: Sequence[Any], count: int | None = None) -> None:
        self._where = [(dataset, index) for dataset in datasets for index in range(len(dataset))][:count]
        self._frames: list[Frame | None] = [None] * len(self._where)
        if not self._frames:
            raise ValueError("dataset: expected at least one picture, got none")

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, index: int) -> Frame:
        if (frame := self._frames[index]) is None:
            dataset, number = self._where[index]
            sample = dataset[number]
            labels = np.where(sample.difficult, IGNORED, sample.labels).astype(np.int64)
            inverse = np.rint(inverse_depth(sample.depth) * UNITS).astype(np.int16)
            boxes = np.asarray(sample.boxes, dtype=np.float32).reshape(-1, 4)
            frame = self._frames[index] = Frame(np.ascontiguousarray(sample.rgb), inverse, boxes, labels)
        return frame

    def presence(self, classes: int) -> NDArray[np.bool_]:
        """(len, classes) which classes each picture shows; the labels are read, not the pictures."""
        there = np.zeros((len(self), classes), dtype=np.bool_)
        for row, (dataset, index) in zip(there, self._where, strict=True):
            row[dataset.rows[index]["labels"]] = True
        return there


class Repeated:
    """Pictures of rare classes several times over (Gupta et al. 2019, LVIS, section B.3).

    Args:
        frames: the pictures.
        times: (N,) how often each is there, on average over its neighbours; at least 1.
    """

    def __init__(self, frames: Frames, times: NDArray[np.float64]) -> None:
        ends = np.floor(np.cumsum(times) + 0.5).astype(np.int64)
        self._frames, self._rows = frames, np.repeat(np.arange(len(times)), np.diff(ends, prepend=0))

    def __len__(self) -> int:
        return len(self._rows)

    def __getitem__(self, index: int) -> Frame:
        return self._frames[int(self._rows[index])]


def repeats(presence: NDArray[np.bool_], power: float) -> NDArray[np.float64]:
    """(N,) how often to show each picture: (the commonest class's share of the pictures / its rarest class's) ** power.

    Args:
        presence: (N, C) which classes each picture shows.
        power: 0 shows every picture once; 0.5 is the paper's.
    """
    share = presence.mean(axis=0)
    factors = (share.max(initial=0.0) / np.where(share > 0.0, share, 1.0)) ** power
    return np.maximum((presence * factors).max(axis=1, initial=1.0), 1.0)
