"""A page with a detector's figures beside the thesis's, and pictures in which a person can check the boxes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from agents.detect_onnx import OnnxDetector
from agents.page import facts, image, notes, page, table, table_row, text
from agents.published import TABLE_3_3, TABLE_3_4_SECONDS

if TYPE_CHECKING:
    from agents.detect_evaluate import Evaluation

EXAMPLES = 12
COLORS = (
    (230, 85, 60), (60, 130, 230), (60, 180, 90), (230, 160, 40), (150, 90, 210),
    (40, 185, 185), (225, 90, 165), (140, 120, 60), (120, 190, 40),
)  # fmt: skip
"""RGB of each class's boxes."""


def evaluation_page(
    results: Sequence[Evaluation], example: str, dataset: Any, depth: bool, source: dict[str, Any]
) -> str:
    """The page.

    Args:
        results: of each detector.
        example: the detector that draws its boxes into example pictures (.onnx).
        dataset: of the examples.
        depth: whether it is given depth.
        source: where the figures come from.
    """
    best = results[0]
    row = best.scores.overall
    lead = (
        f'<p class="lead"><strong>{text(best.name)}</strong>: mAP@0.5 <strong>{row.map50:.3f}</strong>, mAP@0.75 '
        f"<strong>{row.map75:.3f}</strong>, recall <strong>{row.recall:.3f}</strong> on {best.scores.images} pictures, "
        f"<strong>{best.milliseconds:.1f} ms</strong> a picture on one thread.</p>"
    )
    parts = [lead, "<h2>Detectors</h2>", _comparison(results)]
    for result in results:
        parts += [f"<h2>{text(result.name)}, by class and by size</h2>", _classes(result)]
    parts += ["<h2>Examples</h2>", _examples(example, dataset, depth)]
    parts += ["<h2>Where this comes from</h2>", facts({k: v for k, v in source.items() if k != "versions"})]
    return page("Detectors", parts)


def _comparison(results: Sequence[Evaluation]) -> str:
    head = ("detector", "mAP@0.5", "mAP@0.75", "recall", "precision*", "recall*", "ms", "parameters")
    rows = []
    for result in results:
        row = result.scores.overall
        values = (row.map50, row.map75, row.recall, row.precision, row.operating_recall)
        cells = [text(result.name), *(f"{value:.3f}" for value in values), f"{result.milliseconds:.1f}"]
        rows.append(table_row([*cells, f"{result.card['parameters'] / 1e6:.2f} M"]))
    for name, figures in TABLE_3_3.items():
        cells = ["–" if value is None else f"{value:.3f}" for value in figures]
        milliseconds = f"{1e3 * TABLE_3_4_SECONDS:.0f}" if name == "YOLO v3" else "–"
        rows.append(table_row([f"{text(name)} (thesis)", *cells, "–", "–", milliseconds, "–"], "published"))
    small = notes(
        [
            "* at the score with the best F1 on validation pictures; the other recall counts every detection.",
            "The thesis's Table 3.3 is of its own photographs of four hand tools, Table 3.4 of its embedded computer: "
            "their columns stand beside ours, not against them.",
        ]
    )
    return table(head, rows) + small


def _classes(result: Evaluation) -> str:
    head = ("class, or side of the box", "mAP@0.5", "mAP@0.75", "recall", "precision*", "recall*", "objects")
    rows = [
        table_row([text(name), *(f"{value:.3f}" for value in row[:5]), str(row.objects)])
        for name, row in (result.scores.per_class | result.by_size).items()
    ]
    return table(head, rows)


def _examples(path: str, dataset: Any, depth: bool) -> str:
    detector = OnnxDetector(path)
    chosen = np.linspace(0, len(dataset) - 1, min(EXAMPLES, len(dataset))).round().astype(int)
    figures = []
    for index in chosen:
        sample = dataset[int(index)]
        boxes, scores, labels = detector.find(sample.rgb, sample.depth if depth else None)
        names = [f"{detector.card.classes[label]} {value:.2f}" for label, value in zip(labels, scores, strict=True)]
        drawn = draw_boxes(sample.rgb, boxes, names, labels)
        _, code = cv2.imencode(".jpg", drawn[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 85])
        figures.append(f"<figure>{image(code.tobytes(), 'jpeg', f'picture {index}')}</figure>")
    return '<div class="films">' + "".join(figures) + "</div>"


def draw_boxes(
    rgb: NDArray[np.uint8], boxes: NDArray, names: Sequence[str], labels: Sequence[int] | NDArray
) -> NDArray[np.uint8]:
    """The picture at twice its size, with boxes [px of the picture] and names in the colours of their classes."""
    drawn: NDArray[Any] = cv2.resize(rgb, None, fx=2.0, fy=2.0, interpolation=cv2.INTER_CUBIC)
    for box, name, label in zip(boxes, names, labels, strict=True):
        color = COLORS[int(label) % len(COLORS)]
        x1, y1, x2, y2 = np.rint(2.0 * np.asarray(box)).astype(int).tolist()
        cv2.rectangle(drawn, (x1, y1), (x2, y2), color, 2, cv2.LINE_AA)
        (width, height), _ = cv2.getTextSize(name, cv2.FONT_HERSHEY_SIMPLEX, 0.45, 1)
        top = max(y1 - height - 6, 0)
        cv2.rectangle(drawn, (x1, top), (x1 + width + 6, top + height + 6), color, -1)
        place = (x1 + 3, top + height + 2)
        cv2.putText(drawn, name, place, cv2.FONT_HERSHEY_SIMPLEX, 0.45, (255, 255, 255), 1, cv2.LINE_AA)
    return drawn
