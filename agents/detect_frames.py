"""The pictures of a data set, decoded once and held in memory as the augmentation wants them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from agents.detect_assign import IGNORED
from agents.detect_augment import UNITS, Frame
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
