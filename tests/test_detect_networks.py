"""Detector networks: shapes, boxes against closed forms, assignment, losses that vanish where they should."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from aerograsp_env.metrics import box_iou
from agents.detect_assign import IGNORED, PADDING, Targets, align, match_defaults, pairwise_iou
from agents.detect_loss import complete_iou, dense_loss, detection_loss
from agents.networks.detector import FAMILIES, DetectorLayout, build
from agents.networks.detector_parts import STRIDES, cell_centers
from agents.networks.detector_ssd import STRIDES_4, decode, default_boxes, encode
from agents.networks.detector_two_stage import BINS, centered, roi_align
from agents.networks.detector_yolo import BINS as SIDE_BINS
from agents.networks.detector_yolo import DenseOutput

SMALL = {"stages": (8, 8, 8, 8, 8), "pyramid": 8}


def layout(family: str, inputs: str = "rgbd") -> DetectorLayout:
    return DetectorLayout(("a", "b", "c"), family, inputs, **SMALL)


def some_boxes(count: int, seed: int = 0) -> torch.Tensor:
    corners = torch.from_numpy(np.random.default_rng(seed).uniform(4.0, 60.0, (count, 2)))
    sizes = torch.from_numpy(np.random.default_rng(seed + 1).uniform(8.0, 50.0, (count, 2)))
    return torch.cat([corners, corners + sizes], dim=-1).float()


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize(("inputs", "channels"), [("rgb", 3), ("rgbd", 4)])
def test_every_family_gives_boxes_and_scores(family: str, inputs: str, channels: int) -> None:
    torch.manual_seed(0)
    network = build(layout(family, inputs)).eval()
    boxes, scores = network(torch.rand(2, channels, 128, 192))
    assert boxes.shape == (*scores.shape[:2], 4) and scores.shape[0] == 2 and scores.shape[2] == 3
    assert bool(((scores >= 0) & (scores <= 1)).all()) and bool((boxes[..., 2:] >= boxes[..., :2]).all())


@pytest.mark.parametrize("family", FAMILIES)
def test_loss_falls_on_one_batch(family: str) -> None:
    torch.manual_seed(1)
    network = build(layout(family)).train()
    images = torch.rand(2, 4, 96, 96)
    targets = Targets(some_boxes(4).view(2, 2, 4), torch.tensor([[0, 1], [2, PADDING]]))
    optimizer = torch.optim.AdamW(network.parameters(), 3e-3)
    losses = []
    for _ in range(25):
        loss = detection_loss(network, images, targets)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    assert np.mean(losses[-5:]) < 0.8 * np.mean(losses[:5])


@pytest.mark.parametrize("family", FAMILIES)
def test_pictures_without_objects_have_a_finite_loss(family: str) -> None:
    network = build(layout(family)).train()
    targets = Targets(torch.zeros(1, 1, 4), torch.full((1, 1), PADDING))
    loss = detection_loss(network, torch.rand(1, 4, 128, 128), targets)
    loss.backward()
    assert math.isfinite(float(loss.detach()))


def test_cells_lie_in_the_middle_of_their_strides() -> None:
    centers, strides = cell_centers([torch.zeros(1, 1, 2, 3), torch.zeros(1, 1, 1, 1)], (8, 16))
    expected = [[4, 4], [12, 4], [20, 4], [4, 12], [12, 12], [20, 12], [8, 8]]
    np.testing.assert_array_equal(centers.numpy(), expected)
    np.testing.assert_array_equal(strides.numpy()[:, 0], [8] * 6 + [16])


def test_overlap_agrees_with_the_metrics() -> None:
    a, b = some_boxes(20), some_boxes(15, 5)
    np.testing.assert_allclose(pairwise_iou(a, b).numpy(), box_iou(a.numpy(), b.numpy()), atol=1e-6)


def test_complete_iou_is_one_for_equal_boxes_and_smaller_than_iou_otherwise() -> None:
    a, b = some_boxes(20), some_boxes(20, 9)
    np.testing.assert_allclose(complete_iou(a, a).numpy(), 1.0, atol=1e-6)
    iou = pairwise_iou(a, b).diagonal()
    assert bool((complete_iou(a, b) <= iou + 1e-6).all())
    # Beside each other, of one shape: no overlap, centres 10 apart, diagonal² 20² + 10².
    boxes = torch.tensor([[0.0, 0.0, 10.0, 10.0]]), torch.tensor([[10.0, 0.0, 20.0, 10.0]])
    assert float(complete_iou(*boxes)) == pytest.approx(-100.0 / 500.0)


def test_offsets_invert() -> None:
    boxes, defaults = some_boxes(30), centered(some_boxes(30, 3))
    np.testing.assert_allclose(decode(encode(boxes, defaults), defaults).numpy(), boxes.numpy(), atol=1e-3)
    corners = torch.cat([defaults[:, :2] - defaults[:, 2:] / 2, defaults[:, :2] + defaults[:, 2:] / 2], dim=-1)
    np.testing.assert_allclose(encode(corners, defaults).numpy(), 0.0, atol=1e-5)


def test_default_boxes_have_their_areas() -> None:
    levels = [torch.zeros(1, 1, max(64 // stride, 1), max(128 // stride, 1)) for stride in STRIDES_4]
    boxes = default_boxes(levels)
    assert len(boxes) == 6 * (8 * 16 + 4 * 8 + 2 * 4 + 1 * 2)
    np.testing.assert_allclose(boxes[:5, 2:].prod(dim=-1).numpy(), 24.0**2, rtol=1e-5)


def test_objects_get_the_cells_that_fit_best() -> None:
    centers, _ = cell_centers([torch.zeros(1, 1, 8, 8)], (8,))
    truth = torch.tensor([[[8.0, 8.0, 40.0, 40.0], [0.0, 0.0, 0.0, 0.0]]])
    boxes = truth[:, :1].expand(1, 64, 4).clone()
    scores = torch.full((1, 64, 2), 0.5)
    assigned = align(scores, boxes, centers, Targets(truth, torch.tensor([[1, PADDING]])))
    taken = assigned.truth[0] >= 0
    assert int(taken.sum()) == 10 and bool(((centers[taken] > 8) & (centers[taken] < 40)).all())
    np.testing.assert_allclose(assigned.quality[0][taken].numpy(), 1.0, atol=1e-6)  # every box is exact
    assert not assigned.quality[0][~taken].any()


def test_a_cell_of_two_objects_goes_to_the_one_it_overlaps_more() -> None:
    centers, _ = cell_centers([torch.zeros(1, 1, 2, 2)], (8,))
    truth = torch.tensor([[[0.0, 0.0, 16.0, 16.0], [0.0, 0.0, 12.0, 16.0]]])
    boxes = truth[:, 1:].expand(1, 4, 4)
    assigned = align(torch.full((1, 4, 1), 0.3), boxes, centers, Targets(truth, torch.zeros(1, 2, dtype=torch.int64)))
    assert set(assigned.truth[0].tolist()) <= {1, 0} and int((assigned.truth[0] == 1).sum()) == 4


def test_every_object_has_a_default_box() -> None:
    defaults = torch.tensor([[0.0, 0.0, 10.0, 10.0], [50.0, 50.0, 90.0, 90.0]])
    targets = Targets(torch.tensor([[[0.0, 0.0, 4.0, 4.0], [50.0, 50.0, 90.0, 88.0]]]), torch.tensor([[0, 1]]))
    truth, best = match_defaults(defaults, targets)
    assert truth.tolist() == [[0, 1]] and best[0, 0] < 0.5 < best[0, 1]


def dense(logits: torch.Tensor, boxes: torch.Tensor) -> DenseOutput:
    levels = [torch.zeros(1, 1, 64 // stride, 64 // stride) for stride in STRIDES]
    centers, strides = cell_centers(levels, STRIDES)
    sides = torch.cat([centers - boxes[0, :, :2], boxes[0, :, 2:] - centers], dim=-1) / strides
    sides = sides.clamp(0.0, SIDE_BINS - 1.01)
    low = sides.floor().long()
    bins = torch.full((len(centers), 4, SIDE_BINS), 1e-9)
    bins.scatter_(-1, low[..., None], (1 - (sides - low))[..., None])
    bins.scatter_(-1, low[..., None] + 1, (sides - low)[..., None] + 1e-9)
    return DenseOutput(logits, bins.log()[None], boxes, centers, strides)


def test_ignored_objects_cost_nothing() -> None:
    truth = torch.tensor([[[8.0, 8.0, 40.0, 40.0]]])
    cells = 64 + 16 + 4
    logits = torch.full((1, cells, 1), -12.0)
    output = dense(logits, truth.expand(1, cells, 4))
    inside = ((output.centers > 8) & (output.centers < 40)).all(dim=-1)
    found = dense(torch.where(inside, 12.0, -12.0)[None, :, None], truth.expand(1, cells, 4))
    label = torch.tensor([[IGNORED]])
    assert float(dense_loss(found, Targets(truth, label))) < 0.01  # a detection is no fault
    assert float(dense_loss(output, Targets(truth, label))) < 0.01  # nor is none
    assert float(dense_loss(found, Targets(truth, torch.tensor([[PADDING]])))) > 1.0


def test_exact_answers_cost_the_entropy_of_the_bins_alone() -> None:
    truth = torch.tensor([[[8.0, 8.0, 40.0, 40.0]]])
    cells = 84
    targets = Targets(truth, torch.tensor([[0]]))
    output = dense(torch.full((1, cells, 1), -12.0), truth.expand(1, cells, 4))
    assigned = align(output.logits.sigmoid(), output.boxes, output.centers, targets).truth[0] >= 0
    output = output._replace(logits=torch.where(assigned, 12.0, -12.0)[None, :, None])
    wrong = output._replace(boxes=output.boxes + 6.0)
    assert float(dense_loss(output, targets)) < 1.5 < float(dense_loss(wrong, targets))


def test_aligned_samples_of_a_ramp_are_its_values() -> None:
    """Features that grow linearly with x and y: each bin is the value in its middle."""
    y, x = torch.meshgrid(torch.arange(16.0), torch.arange(16.0), indexing="ij")
    features = torch.stack([x + 0.5, y + 0.5])[None] * 8.0  # the coordinates [px] of the cells' centres
    box = torch.tensor([[[24.0, 32.0, 84.0, 92.0]]])
    samples = roi_align(features, box, 8)
    assert samples.shape == (1, 1, 2, BINS, BINS)
    middles = (np.arange(BINS) + 0.5) / BINS * 60.0
    np.testing.assert_allclose(samples[0, 0, 0].numpy(), np.tile(24.0 + middles, (BINS, 1)), rtol=1e-4)
    np.testing.assert_allclose(samples[0, 0, 1].numpy(), np.tile(32.0 + middles, (BINS, 1)).T, rtol=1e-4)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"family": "frcnn"}, "family: expected one of yolo, ssd, two-stage"),
        ({"input": "depth"}, "input: expected one of rgb, rgbd"),
        ({"classes": ()}, "classes: expected different names"),
        ({"classes": ("a", "a")}, "classes: expected different names"),
        ({"stages": (8, 8)}, "stages, pyramid"),
    ],
)
def test_layouts_that_cannot_be(changes: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        DetectorLayout(**{"classes": ("a",), **changes})
