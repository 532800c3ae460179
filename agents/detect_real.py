"""`aerograsp detector real MODEL DATA`: a detector trained on rendered pictures, on photographs that it never saw.

    aerograsp detector real detector.onnx ../shared/data --json real.json

Two sets, each in a folder of DATA:

- `tools_yolo17`: photographs with polygons of 17 classes of tools. A polygon's bounding box is the truth; `YOLO17` says
  which of our classes the set's names are. Other names (calipers, ratchets, saws, …) are not among the classes: they
  are no truth, and a detection on one of them is a fault. Scored by mAP over the four hand tools.
- `tools_aiml20`: photographs of one kind of tool each, in folders by name. Scored by top-1: whether the best detection
  of a hand tool has the right class; a picture without any detection is wrong. Drills are outside the classes.

Photographs have no depth: an RGB-D network is given none.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from agents.arguments import Parser, add_json
from agents.detect_evaluate import LEAST_SCORE
from agents.detect_evaluate_scores import DetectorScores, Found, Labelled, score
from agents.detect_onnx import OnnxDetector
from agents.files import dumps, writable_folder, write_atomic, write_json
from agents.provenance import provenance

TOOLS = ("screwdriver", "wrench", "pliers", "hammer")
YOLO17: tuple[str | None, ...] = (
    "wrench",  # Adjustable spanner
    None,  # Backsaw
    None,  # Calipers
    "pliers",  # Cutting pliers
    None,  # Drill
    "wrench",  # Gas wrench
    None,  # Gun
    "hammer",  # Hammer
    None,  # Hand
    None,  # Handsaw
    "pliers",  # Needle-nose pliers
    "pliers",  # Pliers
    None,  # Ratchet
    "screwdriver",  # Screwdriver
    None,  # Tape measure
    None,  # Utility knife
    "wrench",  # Wrench
)
"""Our class of each of the set's, in the order of its data.yaml."""
AIML20 = {"hammers": "hammer", "pliers": "pliers", "screwdrivers": "screwdriver"}
"""Our class of each folder; `drills` has none."""


class Photograph(NamedTuple):
    """A photograph and what it shows of our classes."""

    path: Path
    rgb: NDArray[np.uint8]  # (H, W, 3)
    boxes: NDArray[np.float64]  # (M, 4) xyxy [px]
    labels: tuple[str, ...]  # (M,)


class TopOne(NamedTuple):
    """How often the best detection names the right tool."""

    rate: float
    per_class: dict[str, float]
    photographs: int
    among_all: float  # the same, where the best detection of any class counts


def read_yolo17(folder: str | Path) -> list[Photograph]:
    """The photographs of `tools_yolo17`, in the order of their names.

    Raises:
        FileNotFoundError: the folder is not there.
        ValueError: a file that cannot be read, with its name.
    """
    images = Path(folder) / "train" / "images"
    if not images.is_dir():
        raise FileNotFoundError(f"{images}: expected the folder of the photographs, there is none")
    found = []
    for path in sorted(images.glob("*.jpg")):
        rgb = read_rgb(path)
        rows = (Path(folder) / "train" / "labels" / f"{path.stem}.txt").read_text().splitlines()
        boxes, labels = [], []
        for number, row in enumerate(filter(str.strip, rows), 1):
            label, box = _box(row, rgb.shape[1], rgb.shape[0], f"{path.stem}.txt, line {number}")
            if label is not None:
                boxes.append(box)
                labels.append(label)
        found.append(Photograph(path, rgb, np.reshape(boxes, (-1, 4)), tuple(labels)))
    return found


def _box(row: str, width: int, height: int, where: str) -> tuple[str | None, NDArray[np.float64]]:
    """Class and box [px] of a line: a class, then a polygon x y x y …, or centre and size, as shares of the image."""
    try:
        values = [float(value) for value in row.split()]
        label = YOLO17[int(values[0])]
        points = np.reshape(values[1:], (-1, 2)) * (width, height)
    except (ValueError, IndexError):
        raise ValueError(f"{where}: expected a class from 0 to {len(YOLO17) - 1} and pairs of numbers") from None
    if len(points) == 2:
        return label, np.concatenate([points[0] - points[1] / 2, points[0] + points[1] / 2])
    if len(points) < 3:
        raise ValueError(f"{where}: expected a box or a polygon of at least 3 points, got {len(points)}")
    return label, np.concatenate([points.min(axis=0), points.max(axis=0)])


def read_aiml20(folder: str | Path) -> list[tuple[Path, str]]:
    """Paths and classes of the photographs of `tools_aiml20` that show one of our classes.

    Raises:
        FileNotFoundError: the folder is not there.
    """
    folder = Path(folder)
    if missing := [name for name in AIML20 if not (folder / name).is_dir()]:
        raise FileNotFoundError(f"{folder}: expected a folder {missing[0]!r}, there is none")
    return [
        (path, label)
        for name, label in AIML20.items()
        for path in sorted((folder / name).iterdir())
        if path.suffix.lower() in (".jpg", ".jpeg", ".png")
    ]


def read_rgb(path: Path) -> NDArray[np.uint8]:
    """A picture (H, W, 3). Raises ValueError, with the file's name, for one that cannot be read."""
    data = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if data is None:
        raise ValueError(f"{path}: expected a picture, but it cannot be read")
    return np.ascontiguousarray(data[..., ::-1])


def score_yolo17(detector: OnnxDetector, photographs: Sequence[Photograph]) -> DetectorScores:
    """mAP and recall over the four hand tools."""
    classes = detector.card.classes
    detections: list[Found] = [detector.find(photo.rgb, None, LEAST_SCORE) for photo in photographs]
    truths = [
        Labelled(
            photo.boxes,
            np.array([classes.index(label) for label in photo.labels], dtype=np.int64),
            np.zeros(len(photo.labels), dtype=np.bool_),
        )
        for photo in photographs
    ]
    return score(detections, truths, classes, detector.threshold, [classes.index(label) for label in TOOLS])


def score_aiml20(detector: OnnxDetector, photographs: Sequence[tuple[Path, str]]) -> TopOne:
    """Top-1 over photographs of one kind of tool each."""
    classes = detector.card.classes
    right: dict[str, list[bool]] = {label: [] for label in AIML20.values()}
    any_right = []
    for path, label in photographs:
        _, _, found = detector.find(read_rgb(path), None, 1e-3)
        names = [classes[number] for number in found]
        best = next((name for name in names if name in TOOLS), None)
        right[label].append(best == label)
        any_right.append(bool(names) and names[0] == label)
    everything = [answer for answers in right.values() for answer in answers]
    rates = {label: float(np.mean(answers)) for label, answers in right.items() if answers}
    return TopOne(float(np.mean(everything)), rates, len(everything), float(np.mean(any_right)))


def write_photographs(photographs: Sequence[Photograph], classes: Sequence[str], out: str | Path) -> Path:
    """Photographs as a data set for training (`agents.detect_dataset`), 320 × 240 and without depth: for fine-tuning.

    Raises:
        ValueError: photographs that are not 4:3.
        OSError: the folder cannot be written.
    """
    folder = writable_folder(out)
    width, height = 320, 240
    focal = height / 2 / math.tan(math.radians(25.0))
    camera = [focal, focal, (width - 1) / 2, (height - 1) / 2]  # 50° high: nobody knows theirs
    for name in ("rgb", "depth"):
        (folder / name).mkdir(exist_ok=True)
    lines = []
    for number, photo in enumerate(photographs):
        rows, columns = photo.rgb.shape[:2]
        if columns * height != rows * width:
            raise ValueError(f"{photo.path.name}: expected a picture of 4:3, got {columns} × {rows}")
        small = cv2.resize(photo.rgb, (width, height), interpolation=cv2.INTER_AREA)
        for kind, suffix, pixels in (
            ("rgb", "jpg", small[..., ::-1]),
            ("depth", "png", np.zeros((height, width), dtype=np.uint16)),
        ):
            _, code = cv2.imencode(f".{suffix}", pixels)
            write_atomic(folder / kind / f"{number:06d}.{suffix}", code.tobytes())
        count = len(photo.labels)
        line = {"image": number, "boxes": (photo.boxes * width / columns).tolist()}
        line |= {"labels": [list(classes).index(label) for label in photo.labels], "visibility": [1.0] * count}
        line |= {"difficult": [False] * count, "T_c_object": [np.eye(4).ravel().tolist()] * count}
        line |= {"intrinsics": camera, "style": "photograph", "level": "real", "scene_seed": -1}
        lines.append(json.dumps(line))
    card: dict[str, Any] = {"version": 1, "classes": list(classes), "size": [width, height], "split": "photographs"}
    write_atomic(folder / "card.json", dumps(card | {"intrinsics": camera, "seed": 0, "images": len(photographs)}))
    write_atomic(folder / "labels.jsonl", "".join(line + "\n" for line in lines))
    return folder


def main(argv: list[str]) -> int:
    """`aerograsp detector real`."""
    parser = Parser(
        prog="aerograsp detector real",
        description="Score a detector on photographs that it never saw.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument("model", metavar="MODEL", help="exported detector (.onnx)")
    parser.add_argument("data", metavar="DATA", help="folder with tools_yolo17 and tools_aiml20")
    parser.add_argument(
        "--half", type=int, choices=(0, 1), help="only the photographs of tools_yolo17 with even or odd numbers"
    )
    parser.add_argument(
        "--write-other-half", metavar="FOLDER", help="write the other half as a data set, to fine-tune on"
    )
    add_json(parser)
    args = parser.parse_args(argv)
    detector = OnnxDetector(args.model)
    if missing := [label for label in TOOLS if label not in detector.card.classes]:
        raise ValueError(f"{args.model}: expected a detector of {', '.join(TOOLS)}; it does not know {missing[0]}")
    photographs = read_yolo17(Path(args.data) / "tools_yolo17")
    if args.write_other_half:
        write_photographs(photographs[1 - (args.half or 0) :: 2], detector.card.classes, args.write_other_half)
    boxes = score_yolo17(detector, photographs if args.half is None else photographs[args.half :: 2])
    top = score_aiml20(detector, read_aiml20(Path(args.data) / "tools_aiml20"))
    overall = boxes.overall
    if args.json != "-":
        print(
            f"tools_yolo17, {boxes.images} photographs, {overall.objects} tools: mAP@0.5 {overall.map50:.3f}, "
            f"mAP@0.75 {overall.map75:.3f}, recall {overall.recall:.3f}"
        )
        print("  " + ", ".join(f"{name} {row.map50:.3f}" for name, row in boxes.per_class.items()))
        print(
            f"tools_aiml20, {top.photographs} photographs: top-1 {top.rate:.3f} among the tools, {top.among_all:.3f} "
            "among all classes"
        )
        print("  " + ", ".join(f"{name} {rate:.3f}" for name, rate in top.per_class.items()))
    if args.json:
        per_class = {name: row._asdict() for name, row in boxes.per_class.items()}
        yolo17 = {"images": boxes.images, "overall": overall._asdict(), "per_class": per_class}
        facts = provenance(["aerograsp", "detector", "real", *argv])
        write_json(args.json, {"tools_yolo17": yolo17, "tools_aiml20": top._asdict(), "provenance": facts})
    return 0


if __name__ == "__main__":
    from agents.arguments import guarded

    sys.exit(guarded("aerograsp detector real", main, sys.argv[1:]))
