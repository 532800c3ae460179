"""An anchor-free detector of one stage.

Every cell of a feature pyramid gives class logits and its distances to the four sides of a box, by two branches (Ge et
al. 2021, YOLOX). A distance is the mean of a distribution over bins (Li et al. 2020, generalised focal loss), which
trains faster than one number and places sides more exactly.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor, nn

from agents.networks.detector_parts import STRIDES, Backbone, Pyramid, Widths, cell_centers, convolution, rows

BINS = 16
"""Of a side's distance: 0 … BINS − 1 strides."""


class DenseOutput(NamedTuple):
    """What the cells of all levels say, and where they are."""

    logits: Tensor  # (B, N, C) of the classes
    bins: Tensor  # (B, N, 4, BINS) logits of the distances left, top, right, bottom
    boxes: Tensor  # (B, N, 4) xyxy [px], decoded
    centers: Tensor  # (N, 2) [px]
    strides: Tensor  # (N, 1) [px]


class DenseHead(nn.Module):
    """Both branches, on each level.

    Args:
        width: channels of each level.
        classes: number of classes.
        prior: the probability that an untrained cell gives any class.
    """

    def __init__(self, width: int, classes: int, prior: float = 0.01) -> None:
        super().__init__()
        self.class_branch = nn.ModuleList(_branch(width, classes) for _ in STRIDES)
        self.box_branch = nn.ModuleList(_branch(width, 4 * BINS) for _ in STRIDES)
        for branch in self.class_branch:
            nn.init.constant_(branch[-1].bias, math.log(prior / (1.0 - prior)))  # type: ignore[index]
        self.register_buffer("steps", torch.arange(BINS).float(), persistent=False)

    def forward(self, levels: tuple[Tensor, Tensor, Tensor]) -> DenseOutput:
        """From three maps at strides 8, 16 and 32."""
        logits = torch.cat([rows(branch(x)) for branch, x in zip(self.class_branch, levels, strict=True)], dim=1)
        bins = torch.cat([rows(branch(x)) for branch, x in zip(self.box_branch, levels, strict=True)], dim=1)
        bins = bins.unflatten(-1, (4, BINS)).float()
        centers, strides = cell_centers(levels, STRIDES)
        distances = (bins.softmax(dim=-1) * self.steps).sum(dim=-1) * strides
        boxes = torch.cat([centers - distances[..., :2], centers + distances[..., 2:]], dim=-1)
        return DenseOutput(logits.float(), bins, boxes, centers, strides)


def _branch(width: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(convolution(width, width), nn.Conv2d(width, outputs, 1))


class Yolo(nn.Module):
    """The whole network.

    Args:
        channels: 3 for RGB, 4 with depth.
        classes: number of classes.
        widths: of its layers.
    """

    def __init__(self, channels: int, classes: int, widths: Widths) -> None:
        super().__init__()
        self.backbone = Backbone(channels, widths)
        self.pyramid = Pyramid(widths)
        self.head = DenseHead(widths.pyramid, classes)

    def raw(self, images: Tensor) -> DenseOutput:
        """What the loss is computed from."""
        return self.head(self.pyramid(self.backbone(images)))

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Boxes (B, N, 4) [px] and class scores (B, N, C) in [0, 1], before suppression of doubles."""
        output = self.raw(images)
        return output.boxes, output.logits.sigmoid()
