"""Which cells or default boxes answer for which objects."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

TOP, ALPHA, BETA = 10, 0.5, 6.0
"""Cells an object gets, and the exponents of score and overlap in their alignment (Feng et al. 2021, TOOD)."""
SMALLEST = 16.0
"""Side [px] that a box is grown to when its cells are looked for: less has no cell of its own."""
PADDING, IGNORED = -1, -2
"""Labels of rows of `Targets` that hold no object, and of boxes that are neither right nor wrong to find."""


class Targets(NamedTuple):
    """The objects of a batch."""

    boxes: Tensor  # (B, M, 4) xyxy [px]
    labels: Tensor  # (B, M) int64: a class, PADDING or IGNORED


class Assignment(NamedTuple):
    """What each cell is to answer."""

    truth: Tensor  # (B, N) int64 row of its object, -1 for none
    quality: Tensor  # (B, N) in [0, 1]: the score that it is to give; 0 for none


def pairwise_iou(a: Tensor, b: Tensor) -> Tensor:
    """(..., N, M) intersection over union of xyxy boxes (..., N, 4) and (..., M, 4)."""
    a, b = a[..., :, None, :], b[..., None, :, :]
    sides = (torch.minimum(a[..., 2:], b[..., 2:]) - torch.maximum(a[..., :2], b[..., :2])).clamp(min=0.0)
    both = sides[..., 0] * sides[..., 1]
    return both / (area(a) + area(b) - both).clamp(min=1e-9)


def area(boxes: Tensor) -> Tensor:
    """(...,) of boxes (..., 4)."""
    return (boxes[..., 2] - boxes[..., 0]) * (boxes[..., 3] - boxes[..., 1])


def inside(centers: Tensor, boxes: Tensor) -> Tensor:
    """(B, M, N) whether centres (N, 2) lie in boxes (B, M, 4)."""
    boxes = boxes[:, :, None]
    return ((centers > boxes[..., :2]) & (centers < boxes[..., 2:])).all(dim=-1)


@torch.no_grad()
def align(scores: Tensor, boxes: Tensor, centers: Tensor, targets: Targets) -> Assignment:
    """Task-aligned assignment (Feng et al. 2021, TOOD): an object gets the TOP cells in it of the largest
    scoreᵅ · IoUᵝ; a cell of several objects goes to the one that it overlaps most.

    Args:
        scores: (B, N, C) probabilities; boxes: (B, N, 4) predicted; centers: (N, 2).
        targets: the objects.
    """
    real = targets.labels >= 0
    if not real.any():
        nothing = torch.full(scores.shape[:2], -1, dtype=torch.int64)
        return Assignment(nothing, torch.zeros_like(scores[..., 0]))
    middle = (targets.boxes[..., :2] + targets.boxes[..., 2:]) / 2
    half = ((targets.boxes[..., 2:] - targets.boxes[..., :2]) / 2).clamp(min=SMALLEST / 2)
    candidates = inside(centers, torch.cat([middle - half, middle + half], dim=-1)) & real[..., None]
    overlap = pairwise_iou(targets.boxes, boxes) * candidates  # (B, M, N)
    columns = targets.labels.clamp(min=0)[..., None].expand(-1, -1, scores.shape[1])
    of_class = torch.gather(scores.transpose(1, 2), 1, columns)
    alignment = of_class.clamp(min=1e-9).pow(ALPHA) * overlap.pow(BETA) * candidates
    top = alignment.topk(min(TOP, alignment.shape[-1]), dim=-1)
    chosen = torch.zeros_like(candidates).scatter_(-1, top.indices, top.values > 0.0)
    owner = (overlap * chosen).argmax(dim=1)  # (B, N)
    taken = chosen.any(dim=1)
    chosen &= torch.nn.functional.one_hot(owner, targets.labels.shape[1]).transpose(1, 2).bool()
    alignment, overlap = alignment * chosen, overlap * chosen
    best_alignment, best_overlap = alignment.amax(dim=-1, keepdim=True), overlap.amax(dim=-1, keepdim=True)
    quality = (alignment / best_alignment.clamp(min=1e-12) * best_overlap).amax(dim=1)
    return Assignment(torch.where(taken, owner, -1), torch.where(taken, quality, 0.0))


@torch.no_grad()
def match_defaults(defaults: Tensor, targets: Targets, least: float = 0.5) -> tuple[Tensor, Tensor]:
    """SSD's rule (Liu et al. 2016, section 2.2): a default box stands for the object that it overlaps most if by at
    least `least`; and each object's best default box stands for it in any case.

    Args:
        defaults: (N, 4) xyxy or (B, N, 4).

    Returns:
        The row of the object (B, N), -1 for none, and the largest overlap (B, N) with any real object.
    """
    real = targets.labels >= 0
    overlap = pairwise_iou(targets.boxes, defaults.expand(targets.boxes.shape[0], -1, -1)) * real[..., None]
    best, truth = overlap.max(dim=1)
    truth = torch.where(best >= least, truth, -1)
    of_object, default = overlap.max(dim=-1)  # (B, M)
    for image, row in (real & (of_object > 0.0)).nonzero().tolist():
        truth[image, default[image, row]] = row
    return truth, best
