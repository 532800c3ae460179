"""A trained detector that runs anywhere: ONNX Runtime, OpenCV and NumPy, without torch.

    from agents.detect_onnx import OnnxDetector, shipped_detector
    detections = OnnxDetector(shipped_detector()).detect(frame)  # of an aerograsp_env.interfaces.RGBD

The file says itself what it was trained on: its metadata hold the card (classes, kind of input, size, threshold).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.interfaces import RGBD, Detection
from agents.detect_input import network_input, suppress

SCHEMA = "aerograsp-detector"
CHANNELS = {"rgb": 3, "rgbd": 4}
FACTS = ("family", "input", "size", "parameters", "pictures", "step")
OVERLAP = 0.6
"""Intersection over union above which the lesser of two detections is dropped."""


class DetectorFileError(ValueError):
    """A file that is no detector of this project; its one line names the file and what was expected."""


@dataclass(frozen=True)
class DetectorCard:
    """What a detector's file says of itself.

    Raises:
        ValueError: something is missing or not what it should be.
    """

    classes: tuple[str, ...]
    input: str  # rgb or rgbd
    size: tuple[int, int]  # (height, width) of the input [px]
    threshold: float  # score at which it was best on validation pictures

    def __post_init__(self) -> None:
        if not self.classes or self.input not in CHANNELS or min(self.size) < 1 or not 0.0 <= self.threshold <= 1.0:
            raise ValueError(f"its card is not a detector's ({self})")

    @classmethod
    def read(cls, text: str | None) -> DetectorCard:
        """From the JSON in the file's metadata."""
        try:
            card = json.loads(text or "null")
            if card["schema"] != SCHEMA:
                raise ValueError(f"its card is of the schema {card['schema']!r}")
            height, width = map(int, card["size"])
            return cls(tuple(map(str, card["classes"])), str(card["input"]), (height, width), float(card["threshold"]))
        except (KeyError, TypeError, json.JSONDecodeError):
            raise ValueError("it carries no card: it is another program's") from None


def shipped_detector() -> Path:
    """The detector that comes with the package.

    Raises:
        FileNotFoundError: it was not installed.
    """
    path = Path(__file__).parent / "checkpoints" / "detect-yolo.onnx"
    if not path.is_file():
        raise FileNotFoundError(f"detector: no such file: {path.name}; train one: aerograsp detector train --help")
    return path


class OnnxDetector:
    """An `aerograsp_env.interfaces.Detector`.

    Args:
        path: an .onnx file that `agents.detect_export` wrote.
        threshold: least score of what is returned; the card's by default.
        classes: what the caller works with; a detector trained on other classes is refused. None takes any.
        threads: of ONNX Runtime.
        classes_compete: whether an object gets one class only.

    Raises:
        FileNotFoundError: no such file.
        DetectorFileError: not a detector, or one of other classes.
        ValueError: a threshold outside [0, 1].
    """

    def __init__(
        self,
        path: str | Path,
        threshold: float | None = None,
        classes: Sequence[str] | None = None,
        threads: int = 1,
        classes_compete: bool = False,
    ) -> None:
        import onnxruntime

        path = Path(path)
        if not path.is_file():
            raise FileNotFoundError(f"detector: no such file: {path}")
        if threshold is not None and not 0.0 <= threshold <= 1.0:
            raise ValueError(f"threshold: expected a score in [0, 1], got {threshold}")
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = threads
        options.log_severity_level = 3
        try:
            self._session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
            self.card = DetectorCard.read(self._session.get_modelmeta().custom_metadata_map.get("card"))
        except ValueError as error:
            raise DetectorFileError(f"{path}: expected a detector of aerograsp, but {error}") from None
        except Exception as error:  # ONNX Runtime raises a type of its own for each way in which a file is bad
            reason = str(error).splitlines()[0]
            raise DetectorFileError(f"{path}: expected an ONNX file, but it cannot be read ({reason})") from None
        if classes is not None and tuple(classes) != self.card.classes:
            raise DetectorFileError(
                f"{path}: expected a detector of the classes {', '.join(classes)}, "
                f"but it was trained on {', '.join(self.card.classes)}"
            )
        self.threshold = self.card.threshold if threshold is None else float(threshold)
        self._compete = classes_compete

    def facts(self) -> dict[str, Any]:
        """Family, kind of input, size and number of parameters, as the card has them."""
        text = self._session.get_modelmeta().custom_metadata_map["card"]
        return {name: value for name, value in json.loads(text).items() if name in FACTS}

    def detect(self, frame: RGBD) -> list[Detection]:
        """The objects found in `frame`, best score first. A depth image of zeros is none at all."""
        boxes, scores, labels = self.find(frame.rgb, frame.depth)
        found = zip(boxes, scores, labels, strict=True)
        return [
            Detection(self.card.classes[label], min(float(score), 1.0), box)
            for box, score, label in found
            if box[2] - box[0] > 0.5 and box[3] - box[1] > 0.5
        ]

    def find(
        self, rgb: NDArray[np.uint8], depth: NDArray[np.floating] | None = None, threshold: float | None = None
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
        """Boxes (K, 4) xyxy [px], scores (K,) and classes (K,) in one picture, best first.

        Args:
            rgb: (H, W, 3) of any size.
            depth: (H, W) [m], 0 where there is none; None is none anywhere.
            threshold: least score, in the place of the detector's.
        """
        image, placed = network_input(rgb, depth, self.card.size, CHANNELS[self.card.input])
        outputs: list[Any] = self._session.run(None, {"images": image})
        boxes = placed.to_image(outputs[0][0], rgb.shape[1], rgb.shape[0])
        least = self.threshold if threshold is None else threshold
        return suppress(boxes, outputs[1][0], least, OVERLAP, classes_compete=self._compete)
