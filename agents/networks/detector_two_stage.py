"""A detector of two stages (Ren et al. 2015, Faster R-CNN).

The first stage proposes boxes of anything: the dense head of `detector_yolo` with the single class "object", whose
local maxima are the proposals (a maximum over 3×3 cells in the place of suppression by overlap, so that the whole
network exports as one graph). The second looks at each proposal through aligned samples of the finest level (He et al.
2017, RoIAlign, here by bilinear `grid_sample`) and gives its class and a better box.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from agents.networks.detector_parts import STRIDES, Backbone, Pyramid, Widths
from agents.networks.detector_ssd import decode
from agents.networks.detector_yolo import DenseHead, DenseOutput

PROPOSALS = 64
"""Boxes that the second stage looks at in each image."""
BINS, SAMPLES = 6, 2
"""Aligned bins along a side of a proposal, and bilinear samples along a side of a bin."""


class StagesOutput(NamedTuple):
    """What the first stage says, and the features that the second one samples."""

    dense: DenseOutput  # of one class
    features: Tensor  # (B, C, H / 8, W / 8)
    proposals: Tensor  # (B, PROPOSALS, 4) xyxy [px], without gradient
    objectness: Tensor  # (B, PROPOSALS) in [0, 1]


class RegionOutput(NamedTuple):
    """What the second stage says of regions."""

    logits: Tensor  # (B, R, 1 + C): background first
    offsets: Tensor  # (B, R, 4) from the regions, as `detector_ssd.encode` has them


def roi_align(features: Tensor, boxes: Tensor, stride: int) -> Tensor:
    """Bilinear samples of boxes.

    Args:
        features: (B, C, H, W).
        boxes: (B, R, 4) xyxy [px of the image].
        stride: pixels a cell of the features.

    Returns:
        (B, R, C, BINS, BINS): means of SAMPLES × SAMPLES samples in each bin; zero beyond the image.
    """
    batch, count = boxes.shape[:2]
    height, width = features.shape[-2:]
    side = BINS * SAMPLES
    steps = (torch.arange(side, device=boxes.device).float() + 0.5) / side
    x = boxes[..., 0:1] + steps * (boxes[..., 2:3] - boxes[..., 0:1])  # (B, R, side) [px]
    y = boxes[..., 1:2] + steps * (boxes[..., 3:4] - boxes[..., 1:2])
    x, y = 2.0 * x / (width * stride) - 1.0, 2.0 * y / (height * stride) - 1.0  # borders of the image are ∓1
    grid = torch.stack(
        [x[:, :, None, :].expand(-1, -1, side, -1), y[:, :, :, None].expand(-1, -1, -1, side)], dim=-1
    ).reshape(batch, count * side, side, 2)
    samples = nn.functional.grid_sample(features.float(), grid, align_corners=False)  # (B, C, R·side, side)
    bins = nn.functional.avg_pool2d(samples, SAMPLES)
    return bins.unflatten(2, (count, BINS)).transpose(1, 2)


class TwoStage(nn.Module):
    """The whole network.

    Args:
        channels: 3 for RGB, 4 with depth.
        classes: number of classes, without the background.
        widths: of its layers.
    """

    def __init__(self, channels: int, classes: int, widths: Widths) -> None:
        super().__init__()
        width = widths.pyramid
        self.backbone = Backbone(channels, widths)
        self.pyramid = Pyramid(widths)
        self.proposer = DenseHead(width, 1)
        hidden = 2 * width
        self.region = nn.Sequential(
            nn.Flatten(2), nn.Linear(width * BINS * BINS, hidden), nn.ReLU(), nn.Linear(hidden, hidden), nn.ReLU()
        )
        self.classes = nn.Linear(hidden, 1 + classes)
        self.offsets = nn.Linear(hidden, 4)

    def raw(self, images: Tensor) -> StagesOutput:
        """What the loss of the first stage is computed from."""
        levels = self.pyramid(self.backbone(images))
        dense = self.proposer(levels)
        proposals, objectness = propose(dense, [tuple(level.shape[-2:]) for level in levels])
        return StagesOutput(dense, levels[0], proposals, objectness)

    def regions(self, features: Tensor, boxes: Tensor) -> RegionOutput:
        """The second stage, on boxes (B, R, 4) [px]."""
        hidden = self.region(roi_align(features, boxes, STRIDES[0]))
        return RegionOutput(self.classes(hidden).float(), self.offsets(hidden).float())

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Boxes (B, N, 4) [px] and class scores (B, N, C) in [0, 1], before suppression of doubles."""
        output = self.raw(images)
        found = self.regions(output.features, output.proposals)
        boxes = decode(found.offsets, centered(output.proposals))
        scores = found.logits.softmax(dim=-1)[..., 1:] * output.objectness[..., None]
        return boxes, scores.sqrt()  # the geometric mean of both stages (Zhou et al. 2021, CenterNet2)


def propose(dense: DenseOutput, shapes: list[tuple[int, int]]) -> tuple[Tensor, Tensor]:
    """The PROPOSALS best local maxima of objectness: boxes (B, PROPOSALS, 4) and objectness (B, PROPOSALS).

    Args:
        dense: of one class.
        shapes: (rows, columns) of each level.
    """
    score = dense.logits.detach()[..., 0].sigmoid()
    peaks = []
    start = 0
    for height, width in shapes:
        level = score[:, start : start + height * width].reshape(-1, 1, height, width)
        highest = nn.functional.max_pool2d(level, 3, 1, 1)
        peaks.append(torch.where(level >= highest, level, 0.01 * level).flatten(1))
        start += height * width
    objectness, index = torch.cat(peaks, dim=1).topk(PROPOSALS, dim=1)
    boxes = torch.gather(dense.boxes.detach(), 1, index[..., None].expand(-1, -1, 4))
    center, half = (boxes[..., :2] + boxes[..., 2:]) / 2, (boxes[..., 2:] - boxes[..., :2]).clamp(min=4.0) / 2
    return torch.cat([center - half, center + half], dim=-1), objectness


def centered(boxes: Tensor) -> Tensor:
    """Boxes xyxy (..., 4) as center x, center y, width, height."""
    return torch.cat([(boxes[..., :2] + boxes[..., 2:]) / 2, boxes[..., 2:] - boxes[..., :2]], dim=-1)
