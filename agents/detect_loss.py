"""What each family of detectors is trained to make small."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn import functional

from agents.detect_assign import IGNORED, Targets, align, area, inside, match_defaults, pairwise_iou
from agents.networks.detector import Network
from agents.networks.detector_ssd import BoxOutput, Ssd, encode
from agents.networks.detector_two_stage import StagesOutput, TwoStage, centered
from agents.networks.detector_yolo import BINS, DenseOutput

CLASS, BOX, SIDES = 1.0, 2.5, 0.5
"""Weights of the dense head's three terms (Xu et al. 2022, PP-YOLOE)."""
NEGATIVES = 3
"""Default boxes of background that are counted for each one of an object: the hardest (Liu et al. 2016)."""
REGIONS, JITTER = 32, 0.15
"""Proposals of an image that the second stage is trained on beside the objects, whose boxes are shaken so much."""


def detection_loss(network: Network, images: Tensor, targets: Targets) -> Tensor:
    """The mean loss of a batch of images (B, C, H, W)."""
    if isinstance(network, TwoStage):
        return _two_stage(network, network.raw(images), targets)
    if isinstance(network, Ssd):
        return _ssd(network.raw(images), targets)
    return dense_loss(network.raw(images), targets)


def complete_iou(predicted: Tensor, true: Tensor) -> Tensor:
    """CIoU of rows of boxes (N, 4) (Zheng et al. 2020): overlap, less the distance of the centres over the diagonal of
    the box around both, less how much the aspect ratios differ."""
    sides = (torch.minimum(predicted[:, 2:], true[:, 2:]) - torch.maximum(predicted[:, :2], true[:, :2])).clamp(min=0.0)
    both = sides.prod(dim=-1)
    iou = both / (area(predicted) + area(true) - both).clamp(min=1e-9)
    around = torch.maximum(predicted[:, 2:], true[:, 2:]) - torch.minimum(predicted[:, :2], true[:, :2])
    between = (predicted[:, :2] + predicted[:, 2:] - true[:, :2] - true[:, 2:]) / 2
    distance = between.pow(2).sum(dim=-1) / around.pow(2).sum(dim=-1).clamp(min=1e-9)
    size, true_size = (predicted[:, 2:] - predicted[:, :2]).clamp(min=1e-6), true[:, 2:] - true[:, :2]
    angle = torch.atan2(true_size[:, 0], true_size[:, 1]) - torch.atan2(size[:, 0], size[:, 1])
    aspect = 4.0 / math.pi**2 * angle.pow(2)
    with torch.no_grad():
        weight = aspect / (1.0 - iou + aspect).clamp(min=1e-9)
    return iou - distance - weight * aspect


def dense_loss(output: DenseOutput, targets: Targets) -> Tensor:
    """Binary cross-entropy of the classes against the quality of each cell's box, CIoU, and the cross-entropy of the
    sides' bins (Li et al. 2020), all weighed by quality."""
    assigned = align(output.logits.detach().sigmoid(), output.boxes.detach(), output.centers, targets)
    positive = assigned.truth >= 0
    wanted = torch.zeros_like(output.logits)
    image, cell = positive.nonzero(as_tuple=True)
    row = assigned.truth[image, cell]
    wanted[image, cell, targets.labels[image, row]] = assigned.quality[image, cell]
    counted = ~_ignored(output.centers, targets) | positive
    total = assigned.quality.sum().clamp(min=1.0)
    entropy = functional.binary_cross_entropy_with_logits(output.logits, wanted, reduction="none")
    loss = CLASS * (entropy * counted[..., None]).sum() / total
    if len(image):
        true, weight = targets.boxes[image, row], assigned.quality[image, cell]
        fit = 1.0 - complete_iou(output.boxes[image, cell], true)
        loss = loss + BOX * (fit * weight).sum() / total
        sides = torch.cat([output.centers[cell] - true[:, :2], true[:, 2:] - output.centers[cell]], dim=-1)
        sides = (sides / output.strides[cell]).clamp(0.0, BINS - 1.01)
        low = sides.floor().long()
        bins, share = output.bins[image, cell].flatten(0, 1), (sides - low).flatten()
        entropy = functional.cross_entropy(bins, low.flatten(), reduction="none") * (1.0 - share)
        entropy = entropy + functional.cross_entropy(bins, low.flatten() + 1, reduction="none") * share
        loss = loss + SIDES * (entropy.view(-1, 4).mean(dim=-1) * weight).sum() / total
    return loss


def _ignored(centers: Tensor, targets: Targets) -> Tensor:
    """(B, N) whether a centre lies in a box that is neither right nor wrong to find."""
    there = targets.labels == IGNORED
    return (inside(centers, targets.boxes) & there[..., None]).any(dim=1)


def _ssd(output: BoxOutput, targets: Targets) -> Tensor:
    """Cross-entropy with hard negative mining, and the smooth L1 distance of the offsets (Liu et al. 2016, eq. 1)."""
    defaults = output.defaults
    corners = torch.cat([defaults[:, :2] - defaults[:, 2:] / 2, defaults[:, :2] + defaults[:, 2:] / 2], dim=-1)
    truth, best = match_defaults(corners, targets)
    positive = truth >= 0
    image, box = positive.nonzero(as_tuple=True)
    row = truth[image, box]
    wanted = torch.zeros_like(truth)
    wanted[image, box] = targets.labels[image, row] + 1
    entropy = functional.cross_entropy(output.logits.transpose(1, 2), wanted, reduction="none")
    negative = ~positive & (best < 0.4) & ~_ignored(defaults[:, :2], targets)
    hardness = (entropy.detach() * negative).argsort(dim=1, descending=True).argsort(dim=1)
    count = (NEGATIVES * positive.sum(dim=1, keepdim=True)).clamp(min=NEGATIVES)
    counted = positive | (negative & (hardness < count))
    total = positive.sum().clamp(min=1)
    loss = (entropy * counted).sum() / total
    if len(image):
        offsets = encode(targets.boxes[image, row], defaults[box])
        loss = loss + functional.smooth_l1_loss(output.offsets[image, box], offsets, reduction="sum") / total
    return loss


def _two_stage(network: TwoStage, output: StagesOutput, targets: Targets) -> Tensor:
    """The proposals' dense loss, with one class, and the cross-entropy and smooth L1 distance of the second stage."""
    anything = Targets(targets.boxes, targets.labels.clamp(max=0))
    loss = dense_loss(output.dense, anything)
    size = targets.boxes[..., 2:] - targets.boxes[..., :2]
    shaken = targets.boxes + JITTER * (torch.rand_like(targets.boxes) - 0.5) * torch.cat([size, size], dim=-1)
    middle, half = (shaken[..., :2] + shaken[..., 2:]) / 2, (shaken[..., 2:] - shaken[..., :2]).clamp(min=4.0) / 2
    regions = torch.cat([output.proposals[:, :REGIONS], torch.cat([middle - half, middle + half], dim=-1)], dim=1)
    found = network.regions(output.features, regions)
    overlap = pairwise_iou(targets.boxes, regions) * (targets.labels >= 0)[..., None]
    best, truth = overlap.max(dim=1)  # (B, R)
    positive = best >= 0.5
    centers = (regions[..., :2] + regions[..., 2:]) / 2
    boxes = targets.boxes[:, :, None]
    within = ((centers[:, None] > boxes[..., :2]) & (centers[:, None] < boxes[..., 2:])).all(dim=-1)
    ignored = (within & (targets.labels == IGNORED)[..., None]).any(dim=1)
    padding = torch.cat([torch.zeros_like(best[:, :REGIONS], dtype=torch.bool), targets.labels < 0], dim=1)
    counted = positive | ((best < 0.4) & ~ignored & ~padding)
    wanted = torch.where(positive, torch.gather(targets.labels, 1, truth) + 1, 0).clamp(min=0)
    entropy = functional.cross_entropy(found.logits.transpose(1, 2), wanted, reduction="none")
    loss = loss + 2.0 * (entropy * counted).sum() / counted.sum().clamp(min=1)
    image, region = positive.nonzero(as_tuple=True)
    if len(image):
        offsets = encode(targets.boxes[image, truth[image, region]], centered(regions[image, region]))
        distance = functional.smooth_l1_loss(found.offsets[image, region], offsets, reduction="sum")
        loss = loss + distance / len(image)
    return loss
