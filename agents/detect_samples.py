"""Reading a detection data set; `agents.detect_dataset` says how it is laid out."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from aerograsp_env.interfaces import Intrinsics

VERSION = 1


class Sample(NamedTuple):
    """One picture of a data set."""

    rgb: NDArray[np.uint8]  # (H, W, 3)
    depth: NDArray[np.float32]  # (H, W) [m], 0 where there is none
    boxes: NDArray[np.float32]  # (N, 4) x1, y1, x2, y2 [px]
    labels: NDArray[np.int64]  # (N,) index into the classes
    difficult: NDArray[np.bool_]  # (N,)
    T_c_object: NDArray[np.float64]  # (N, 4, 4)
    intrinsics: Intrinsics


class DetectDataset:
    """A data set on disk; pictures are read when asked for.

    Attributes:
        classes: names, in the order of the labels.
        intrinsics: of the nominal camera; each picture's own are in its `Sample`.
        rows: the labels' rows.

    Raises:
        FileNotFoundError: no such data set.
        ValueError: a card or labels that cannot be understood, with the name of the file.
    """

    def __init__(self, path: str | Path):
        self.path = Path(path)
        card_path = self.path / "card.json"
        if not card_path.is_file():
            raise FileNotFoundError(f"{self.path}: expected the folder of a data set, with a card.json")
        self.card = read_json(card_path)
        try:
            self.classes = tuple(str(name) for name in self.card["classes"])
            width, height = (int(side) for side in self.card["size"])
            self.intrinsics = Intrinsics(width, height, *self.card["intrinsics"])
            version = self.card["version"]
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"{card_path}: expected classes, size, intrinsics and version, got {error}") from error
        if version != VERSION:
            raise ValueError(f"{card_path}: expected version {VERSION}, got {version}")
        self.rows = _read_rows(self.path / "labels.jsonl", len(self.classes))

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, index: int) -> Sample:
        """Picture `index`.

        Raises:
            IndexError: no such picture.
            ValueError: a picture that is missing, damaged or of another size, with the name of the file.
        """
        row = self.rows[index]
        size = (self.intrinsics.height, self.intrinsics.width)
        rgb = _read_image(self.path / "rgb" / f"{row['image']:06d}.jpg", (*size, 3), np.uint8)
        depth = _read_image(self.path / "depth" / f"{row['image']:06d}.png", size, np.uint16)
        camera = self.intrinsics[:2] + tuple(row["intrinsics"])
        return Sample(
            rgb,
            depth.astype(np.float32) * np.float32(1e-3),
            np.array(row["boxes"], dtype=np.float32).reshape(-1, 4),
            np.array(row["labels"], dtype=np.int64),
            np.array(row["difficult"], dtype=bool),
            np.array(row["T_c_object"], dtype=np.float64).reshape(-1, 4, 4),
            Intrinsics(*camera),
        )


def read_json(path: Path) -> dict[str, Any]:
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ValueError(f"{path}: expected JSON, got {error}") from error
    if not isinstance(value, dict):
        raise ValueError(f"{path}: expected a JSON object, got {type(value).__name__}")
    return value


_ROW = {"boxes": 4, "labels": None, "visibility": None, "difficult": None, "T_c_object": 16}


def _read_rows(path: Path, classes: int) -> list[dict[str, Any]]:
    if not path.is_file():
        raise ValueError(f"{path}: expected the labels of the pictures, there is no such file")
    text = path.read_text(encoding="utf-8")
    lines = text.split("\n")[:-1]  # what follows the last line break is still being written
    rows = []
    for number, line in enumerate(lines, 1):
        try:
            row = json.loads(line)
            counts = {len(row[name]) for name in _ROW}
            sound = len(counts) == 1 and len(row["intrinsics"]) == 4 and int(row["image"]) >= 0
            sound &= all(len(item) == size for name, size in _ROW.items() if size for item in row[name])
        except (ValueError, KeyError, TypeError) as error:
            raise ValueError(f"{path}, line {number}: expected the labels of a picture, got {error!r}") from error
        if not sound:
            raise ValueError(f"{path}, line {number}: expected as many boxes, labels, … as each other")
        if not all(isinstance(label, int) and 0 <= label < classes for label in row["labels"]):
            raise ValueError(f"{path}, line {number}: expected labels from 0 to {classes - 1}, got {row['labels']}")
        rows.append(row)
    return rows


def _read_image(path: Path, shape: tuple[int, ...], dtype: type) -> NDArray[Any]:
    try:
        with Image.open(path) as image:
            pixels = np.asarray(image)
    except (OSError, SyntaxError, ValueError) as error:  # Pillow's, for a damaged file
        raise ValueError(f"{path}: expected a picture of {shape[1]} × {shape[0]} px, got {error}") from error
    if pixels.shape != shape or pixels.dtype != dtype:
        raise ValueError(f"{path}: expected {shape} {np.dtype(dtype).name}, got {pixels.shape} {pixels.dtype.name}")
    return pixels
