"""Trained detectors in torch: read from disk, and run on samples of a data set."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from agents.checkpoint import DETECTOR_KIND, CheckpointError, load_checkpoint
from agents.detect_evaluate_scores import Found
from agents.detect_input import network_input, suppress
from agents.networks.detector import INPUTS, DetectorLayout, Network

DETECT = "aerograsp/Detect-v0"
LEAST_SCORE, OVERLAP = 0.01, 0.6
"""Of detections that are scored, and above which IoU the lesser of two is dropped."""


def load_detector(path: str | Path) -> tuple[DetectorLayout, dict[str, Tensor], dict[str, Any]]:
    """Layout, weights and card of a trained network (not of a run's whole state).

    Raises:
        CheckpointError: no whole checkpoint of a detector.
    """
    checkpoint = load_checkpoint(path, DETECT)
    if checkpoint.card.get("kind") != DETECTOR_KIND:
        raise CheckpointError(f"{path}: expected a {DETECTOR_KIND}, got {checkpoint.card.get('kind')!r}")
    try:
        layout = DetectorLayout.from_card(checkpoint.card)
    except ValueError as error:
        raise CheckpointError(f"{path}: {error}") from None
    return layout, {n: torch.from_numpy(np.array(v)) for n, v in checkpoint.tensors.items()}, checkpoint.card


def torch_detector(network: Network, layout: DetectorLayout) -> Any:
    """A function from a sample (rgb, depth) to what the network finds in it, down to low scores."""

    def detect(sample: Any) -> Found:
        height, width = sample.rgb.shape[:2]
        size = (-(-height // 32) * 32, -(-width // 32) * 32)
        image, placed = network_input(sample.rgb, sample.depth, size, INPUTS[layout.input])
        with torch.no_grad():
            boxes, scores = network.eval()(torch.from_numpy(image).to(memory_format=torch.channels_last))
        inside = placed.to_image(boxes[0].numpy(), width, height)
        return suppress(inside, scores[0].numpy(), LEAST_SCORE, OVERLAP)

    return detect
