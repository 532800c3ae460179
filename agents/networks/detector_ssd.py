"""A single-shot detector with default boxes (Liu et al. 2016, SSD).

Every cell of a level has default boxes of one scale and several aspect ratios; the network gives each of them
a distribution over the classes and the background, and offsets to the box of the object that it stands for.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor, nn

from agents.networks.detector_parts import STRIDES, Backbone, Pyramid, Widths, cell_centers, convolution, rows

STRIDES_4 = (*STRIDES, 64)
SCALES = (24.0, 56.0, 112.0, 200.0)
"""Side [px] of each level's square default box."""
SHAPES = ((1.0, 1.0), (1.0, 2.0), (1.0, 0.5), (1.0, 4.0), (1.0, 0.25), (1.45, 1.0))
"""(scale, aspect ratio) of a cell's default boxes; the last is the geometric mean of this level's and the next."""
VARIANCES = (0.1, 0.2)
"""Offsets of centres and of logarithmic sizes are divided by these."""


class BoxOutput(NamedTuple):
    """What the default boxes say."""

    logits: Tensor  # (B, N, 1 + C): background first
    offsets: Tensor  # (B, N, 4)
    boxes: Tensor  # (B, N, 4) xyxy [px], decoded
    defaults: Tensor  # (N, 4) center x, center y, width, height [px]


def encode(boxes: Tensor, defaults: Tensor) -> Tensor:
    """Offsets of xyxy boxes (..., 4) from default boxes (..., 4) (Girshick et al. 2014)."""
    center = (boxes[..., :2] + boxes[..., 2:]) / 2
    size = (boxes[..., 2:] - boxes[..., :2]).clamp(min=1e-3)
    offset = (center - defaults[..., :2]) / (VARIANCES[0] * defaults[..., 2:])
    return torch.cat([offset, torch.log(size / defaults[..., 2:]) / VARIANCES[1]], dim=-1)


def decode(offsets: Tensor, defaults: Tensor) -> Tensor:
    """The inverse of `encode`; sizes are held below 60 times the default."""
    center = defaults[..., :2] + VARIANCES[0] * offsets[..., :2] * defaults[..., 2:]
    half = torch.exp((VARIANCES[1] * offsets[..., 2:]).clamp(max=4.1)) * defaults[..., 2:] / 2
    return torch.cat([center - half, center + half], dim=-1)


def default_boxes(levels: list[Tensor]) -> Tensor:
    """(N, 4) center x, center y, width, height [px]: cell after cell, all shapes of each."""
    found = []
    shapes = torch.tensor([(scale * math.sqrt(ratio), scale / math.sqrt(ratio)) for scale, ratio in SHAPES])
    for level, stride, scale in zip(levels, STRIDES_4, SCALES, strict=True):
        centers, _ = cell_centers([level], (stride,))
        sizes = (shapes * scale).to(centers)
        pairs = [
            centers[:, None].expand(-1, len(SHAPES), -1),
            sizes[None].expand(len(centers), -1, -1),
        ]
        found.append(torch.cat(pairs, dim=-1).reshape(-1, 4))
    return torch.cat(found)


class Ssd(nn.Module):
    """The whole network.

    Args:
        channels: 3 for RGB, 4 with depth.
        classes: number of classes, without the background.
        widths: of its layers.
    """

    def __init__(self, channels: int, classes: int, widths: Widths) -> None:
        super().__init__()
        width = widths.pyramid
        self.outputs = 1 + classes
        self.backbone = Backbone(channels, widths)
        self.pyramid = Pyramid(widths)
        self.extra = convolution(width, width, 3, 2)  # to stride 64
        self.shared = nn.ModuleList(convolution(width, width) for _ in STRIDES_4)
        self.classes = nn.ModuleList(nn.Conv2d(width, len(SHAPES) * self.outputs, 3, padding=1) for _ in STRIDES_4)
        self.offsets = nn.ModuleList(nn.Conv2d(width, len(SHAPES) * 4, 3, padding=1) for _ in STRIDES_4)

    def raw(self, images: Tensor) -> BoxOutput:
        """What the loss is computed from."""
        levels = list(self.pyramid(self.backbone(images)))
        levels.append(self.extra(levels[-1]))
        levels = [shared(level) for shared, level in zip(self.shared, levels, strict=True)]
        logits = self._all(self.classes, levels, self.outputs)
        offsets = self._all(self.offsets, levels, 4)
        defaults = default_boxes(levels)
        return BoxOutput(logits, offsets, decode(offsets, defaults), defaults)

    @staticmethod
    def _all(branches: nn.ModuleList, levels: list[Tensor], values: int) -> Tensor:
        """(B, N, values) of all default boxes."""
        maps = [rows(branch(level)) for branch, level in zip(branches, levels, strict=True)]
        return torch.cat([level.reshape(level.shape[0], -1, values) for level in maps], dim=1).float()

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Boxes (B, N, 4) [px] and class scores (B, N, C) in [0, 1], before suppression of doubles."""
        output = self.raw(images)
        return output.boxes, output.logits.softmax(dim=-1)[..., 1:]
