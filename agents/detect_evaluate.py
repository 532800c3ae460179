"""`aerograsp detector eval MODEL DATASET`: the figures of the thesis's Tables 3.3 and 3.4 for trained detectors.

    aerograsp detector eval detector.onnx data/test --json scores.json --page scores.html

mAP at IoU 0.5 and 0.75 and recall for each class, precision and recall at the detector's own threshold, and the time
of one picture from pixels to boxes on one thread. Objects that are difficult (hidden for the most part, or tiny) are
neither right nor wrong to find.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from agents.arguments import Parser, add_json, positive_int
from agents.detect_evaluate_page import evaluation_page
from agents.detect_evaluate_scores import ClassScores, DetectorScores, Found, collect, score, score_by_size
from agents.detect_onnx import OnnxDetector
from agents.files import write_atomic, write_json
from agents.provenance import provenance

LEAST_SCORE = 0.01
"""Of detections that are scored: mAP is an area under the whole curve."""
TIMED = 100
"""Pictures whose time is taken, after ten to warm up."""


class Evaluation(NamedTuple):
    """A detector's figures on a data set."""

    name: str
    scores: DetectorScores
    by_size: dict[str, ClassScores]
    milliseconds: float  # median of a picture, from pixels to boxes, on one thread
    card: dict[str, Any]  # family, input, size and parameters

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "detector": self.name,
            **self.card,
            "milliseconds": self.milliseconds,
            "images": self.scores.images,
            "threshold": self.scores.threshold,
            "overall": self.scores.overall._asdict(),
            "by_size": {name: row._asdict() for name, row in self.by_size.items()},
            "per_class": {name: row._asdict() for name, row in self.scores.per_class.items()},
        }


def evaluate(path: str | Path, dataset: Any, depth: bool = True, images: int | None = None) -> Evaluation:
    """Run a detector over a data set and score it.

    Args:
        path: an exported detector (.onnx).
        dataset: an `agents.detect_dataset.DetectDataset`, or samples like its own beside `classes`.
        depth: whether the detector is given depth.
        images: how many of the first pictures; all by default.

    Raises:
        DetectorFileError: no detector, or one trained on other classes.
    """
    detector = OnnxDetector(path, classes=dataset.classes)
    count = len(dataset) if images is None else min(images, len(dataset))
    times: list[float] = []

    def find(sample: Any) -> Found:
        began = time.perf_counter()
        found = detector.find(sample.rgb, sample.depth if depth else None, LEAST_SCORE)
        times.append(time.perf_counter() - began)
        return found

    detections, truths = collect(find, _with_bar(dataset, count))
    scores = score(detections, truths, dataset.classes, detector.threshold)
    by_size = score_by_size(detections, truths, dataset.classes, detector.threshold)
    timed = times[10 : 10 + TIMED] or times
    name = Path(path).stem + ("" if depth or detector.card.input == "rgb" else " without depth")
    return Evaluation(name, scores, by_size, 1e3 * float(np.median(timed)), detector.facts())


def _with_bar(dataset: Any, count: int) -> Iterable[Any]:
    from tqdm import tqdm

    return (dataset[i] for i in tqdm(range(count), desc="pictures", unit="image", disable=None))


def main(argv: list[str]) -> int:
    """`aerograsp detector eval`."""
    from agents.detect_dataset import DetectDataset

    parser = Parser(
        prog="aerograsp detector eval",
        description="mAP, recall and time of detectors on labelled pictures.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument("models", metavar="MODEL", nargs="+", help="exported detector (.onnx)")
    parser.add_argument("dataset", metavar="DATASET", help="folder of pictures")
    parser.add_argument("--images", metavar="N", type=positive_int, help="only the first N pictures")
    parser.add_argument("--no-depth", action="store_true", help="give RGB-D detectors no depth, as of a photograph")
    parser.add_argument("--page", metavar="FILE", help="write a page with the tables and example pictures (.html)")
    add_json(parser)
    args = parser.parse_args(argv)
    dataset = DetectDataset(args.dataset)
    results = [evaluate(model, dataset, not args.no_depth, args.images) for model in args.models]
    facts = provenance(["aerograsp", "detector", "eval", *argv])
    if args.json != "-":
        print(table(results))
    if args.json:
        write_json(args.json, {"results": [result.to_json() for result in results], "provenance": facts})
    if args.page:
        write_atomic(args.page, evaluation_page(results, args.models[0], dataset, not args.no_depth, facts))
    return 0


def table(results: Sequence[Evaluation]) -> str:
    """The overall figures as text, a detector a line."""
    lines = [f"{'detector':<32} mAP@.5 mAP@.75 recall | at its threshold: precision recall |   ms"]
    for result in results:
        row = result.scores.overall
        lines.append(
            f"{result.name:<32} {row.map50:6.3f} {row.map75:7.3f} {row.recall:6.3f} | "
            f"{row.precision:27.3f} {row.operating_recall:6.3f} | {result.milliseconds:4.1f}"
        )
        lines += [
            f"{'  ' + size:<32} {row.map50:6.3f} {row.map75:7.3f} {row.recall:6.3f} | {row.objects:>26} objects"
            for size, row in result.by_size.items()
        ]
    return "\n".join(lines)


if __name__ == "__main__":
    from agents.arguments import guarded

    sys.exit(guarded("aerograsp detector eval", main, sys.argv[1:]))
