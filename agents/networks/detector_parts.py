"""What the detectors are made of: plain convolutions, cross-stage-partial blocks, a backbone and a feature pyramid.

Plain convolutions train several times faster on a CPU than depthwise ones, and ReLU is fused into them when the network
runs in ONNX Runtime.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

STRIDES = (8, 16, 32)
"""Pixels a cell of each pyramid level."""


class Widths(NamedTuple):
    """Channels of the backbone's five stages (strides 2 to 32), and of every pyramid level."""

    stages: tuple[int, int, int, int, int] = (16, 32, 64, 128, 192)
    pyramid: int = 64


def convolution(inputs: int, outputs: int, kernel: int = 3, stride: int = 1) -> nn.Sequential:
    """Convolution, batch normalisation, ReLU."""
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, bias=False),
        nn.BatchNorm2d(outputs, eps=1e-3, momentum=0.03),
        nn.ReLU(inplace=True),
    )


class Residual(nn.Module):
    """x + f(x), f two 3×3 convolutions (He et al. 2016)."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.body = nn.Sequential(convolution(width, width), convolution(width, width))

    def forward(self, x: Tensor) -> Tensor:
        return x + self.body(x)


class PartialBlock(nn.Module):
    """Cross-stage partial block (Wang et al. 2020, CSPNet): half of the channels pass through `depth` residuals, and
    every intermediate result reaches the output."""

    def __init__(self, inputs: int, outputs: int, depth: int = 1) -> None:
        super().__init__()
        half = outputs // 2
        self.enter = convolution(inputs, 2 * half, 1)
        self.residuals = nn.ModuleList(Residual(half) for _ in range(depth))
        self.leave = convolution((2 + depth) * half, outputs, 1)

    def forward(self, x: Tensor) -> Tensor:
        parts = list(self.enter(x).chunk(2, dim=1))
        for residual in self.residuals:
            parts.append(residual(parts[-1]))
        return self.leave(torch.cat(parts, dim=1))


class PooledContext(nn.Module):
    """Maxima over growing neighbourhoods beside the features themselves (He et al. 2015, spatial pyramid pooling)."""

    def __init__(self, width: int) -> None:
        super().__init__()
        half = width // 2
        self.enter = convolution(width, half, 1)
        self.pool = nn.MaxPool2d(5, 1, 2)
        self.leave = convolution(4 * half, width, 1)

    def forward(self, x: Tensor) -> Tensor:
        parts = [self.enter(x)]
        for _ in range(3):
            parts.append(self.pool(parts[-1]))
        return self.leave(torch.cat(parts, dim=1))


class Backbone(nn.Module):
    """Features at strides 8, 16 and 32.

    Args:
        channels: of the image: 3, or 4 with inverse depth.
        widths: channels of the stages.
    """

    def __init__(self, channels: int, widths: Widths) -> None:
        super().__init__()
        first, second, third, fourth, fifth = widths.stages
        self.stem = nn.Sequential(convolution(channels, first, 3, 2), convolution(first, second, 3, 2))
        self.third = nn.Sequential(convolution(second, third, 3, 2), PartialBlock(third, third, 2))
        self.fourth = nn.Sequential(convolution(third, fourth, 3, 2), PartialBlock(fourth, fourth, 2))
        self.fifth = nn.Sequential(convolution(fourth, fifth, 3, 2), PartialBlock(fifth, fifth), PooledContext(fifth))

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """(B, C, H, W) -> three maps (B, width, H / stride, W / stride); H and W must be multiples of 32."""
        third = self.third(self.stem(images))
        fourth = self.fourth(third)
        return third, fourth, self.fifth(fourth)


class Pyramid(nn.Module):
    """Context goes down to the fine levels (Lin et al. 2017, FPN) and detail back up (Liu et al. 2018, PANet)."""

    def __init__(self, widths: Widths) -> None:
        super().__init__()
        third, fourth, fifth = widths.stages[2:]
        width = widths.pyramid
        self.enter = nn.ModuleList(convolution(inputs, width, 1) for inputs in (third, fourth, fifth))
        self.down = nn.ModuleList(PartialBlock(2 * width, width) for _ in range(2))  # to stride 16, to stride 8
        self.reduce = nn.ModuleList(convolution(width, width, 3, 2) for _ in range(2))
        self.up = nn.ModuleList(PartialBlock(2 * width, width) for _ in range(2))  # to stride 16, to stride 32

    def forward(self, features: tuple[Tensor, Tensor, Tensor]) -> tuple[Tensor, Tensor, Tensor]:
        """Three maps of `widths.pyramid` channels at strides 8, 16 and 32."""
        third, fourth, fifth = (enter(x) for enter, x in zip(self.enter, features, strict=True))
        fourth = self.down[0](torch.cat([_doubled(fifth), fourth], dim=1))
        third = self.down[1](torch.cat([_doubled(fourth), third], dim=1))
        fourth = self.up[0](torch.cat([self.reduce[0](third), fourth], dim=1))
        fifth = self.up[1](torch.cat([self.reduce[1](fourth), fifth], dim=1))
        return third, fourth, fifth


def _doubled(x: Tensor) -> Tensor:
    return nn.functional.interpolate(x, scale_factor=2.0, mode="nearest")


def cell_centers(maps: tuple[Tensor, ...] | list[Tensor], strides: tuple[int, ...]) -> tuple[Tensor, Tensor]:
    """Centres (N, 2) [px, as (x, y)] and strides (N, 1) of all cells of some maps, row by row, level after level."""
    centers, sizes = [], []
    for level, stride in zip(maps, strides, strict=True):
        height, width = level.shape[-2:]
        y, x = torch.meshgrid(
            torch.arange(height, device=level.device), torch.arange(width, device=level.device), indexing="ij"
        )
        points = (torch.stack([x, y], dim=-1).reshape(-1, 2).float() + 0.5) * stride
        centers.append(points)
        sizes.append(torch.full_like(points[:, :1], float(stride)))
    return torch.cat(centers), torch.cat(sizes)


def rows(level: Tensor) -> Tensor:
    """(B, C, H, W) -> (B, H·W, C)."""
    return level.flatten(2).transpose(1, 2)
