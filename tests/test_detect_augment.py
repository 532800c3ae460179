"""Training pictures: boxes move as their pixels do, what is cut off is ignored, one seed gives one picture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from agents.detect_assign import IGNORED
from agents.detect_augment import UNITS, Augmentation, Frame, example
from agents.detect_input import inverse_depth, network_input, suppress

PLAIN = Augmentation.none()


def frame(box: tuple[int, int, int, int] = (70, 60, 130, 100), label: int = 1) -> Frame:
    """A white object on black, nearer than its ground."""
    rgb, near = np.zeros((240, 320, 3), dtype=np.uint8), np.zeros((240, 320), dtype=np.int16)
    x1, y1, x2, y2 = box
    rgb[y1:y2, x1:x2] = 255
    near[y1:y2, x1:x2] = UNITS // 4
    return Frame(rgb, near, np.array([box], dtype=np.float32), np.array([label]))


def white_box(image: np.ndarray) -> np.ndarray:
    rows, columns = np.nonzero(image[..., :3].min(axis=2) > 0.5)
    return np.array([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1])


@pytest.mark.parametrize("seed", range(12))
def test_boxes_follow_the_pixels(seed: int) -> None:
    settings = replace(PLAIN, turn=1.0, zoom=0.5, smallest_scale=0.5, largest_scale=1.5)
    picture = example([frame()], 0, 224, settings, np.random.default_rng(seed))
    kept = picture.labels >= 0
    for box in picture.boxes[kept]:
        shown = picture.image.copy()
        outside = np.ones((224, 224), dtype=bool)  # the border may be bright too
        low, high = np.floor(box[:2] - 3).astype(int).clip(0), np.ceil(box[2:] + 3).astype(int)
        outside[low[1] : high[1], low[0] : high[0]] = False
        shown[outside] = 0.0
        inner = np.clip(box + [2, 2, -2, -2], 0, 224).astype(int)
        assert (picture.image[inner[1] : inner[3], inner[0] : inner[2], :3] > 0.9).all()
        if (box > 2).all() and (box < 222).all() and not shown[:, :, :3][outside].any():
            np.testing.assert_allclose(white_box(shown), box, atol=1.5)


def test_inverse_depth_grows_with_the_scale() -> None:
    settings = replace(PLAIN, smallest_scale=2.0, largest_scale=2.0, turn=0.0)
    picture = example([frame()], 0, 224, settings, np.random.default_rng(3))
    assert np.unique(picture.image[..., 3]).tolist() == [0.0, 0.5]


def test_a_mosaic_shows_four_frames() -> None:
    frames = [frame(label=label) for label in range(4)]
    settings = replace(PLAIN, mosaic=1.0, smallest_scale=0.4, largest_scale=0.5)
    seen = set()
    for seed in range(6):
        picture = example(frames, 0, 224, settings, np.random.default_rng(seed))
        seen |= set(picture.labels.tolist())
        assert (picture.boxes >= 0).all() and (picture.boxes <= 224).all()
    assert {0, 1, 2, 3} <= seen


def test_what_is_mostly_cut_off_is_ignored() -> None:
    labels = []
    for seed in range(40):
        picture = example([frame((0, 0, 320, 40))], 0, 96, PLAIN, np.random.default_rng(seed))
        labels += picture.labels.tolist()
        for box in picture.boxes[picture.labels == IGNORED]:
            assert (box[2] - box[0]) * (box[3] - box[1]) < 0.45 * 320 * 40 + 1e-3
    assert set(labels) == {IGNORED}  # at most 96 of 320 px are ever in the picture


def test_equal_seeds_give_equal_pictures_and_others_do_not() -> None:
    frames = [frame(), frame((100, 100, 180, 200), 0)]
    first, second, other = (example(frames, 0, 160, Augmentation(), np.random.default_rng(s)) for s in (7, 7, 8))
    np.testing.assert_array_equal(first.image, second.image)
    np.testing.assert_array_equal(first.boxes, second.boxes)
    assert not np.array_equal(first.image, other.image)


@pytest.mark.parametrize("seed", range(30))
def test_every_change_keeps_shape_and_range(seed: int) -> None:
    always = Augmentation(0.5, 0.5, 1.0, 0.3, 1.0, 0.5, 1.0, 1.0, 1.0, 1.0, 0.3, 2.0)
    picture = example([frame()], 0, 128, always, np.random.default_rng(seed))
    assert picture.image.shape == (128, 128, 4) and picture.image.dtype == np.float32
    assert np.isfinite(picture.image).all() and picture.image[..., :3].min() >= 0 and picture.image[..., :3].max() <= 1
    assert len(picture.boxes) == len(picture.labels)


def test_depth_dropout_leaves_no_depth() -> None:
    picture = example([frame()], 0, 128, replace(PLAIN, depth_dropout=1.0), np.random.default_rng(0))
    assert not picture.image[..., 3].any()


def test_inverse_depth_is_about_its_median_and_zero_where_unknown() -> None:
    depth = np.full((60, 80), 2.0, dtype=np.float32)
    depth[:10], depth[10:20] = 0.0, 1.0
    near = inverse_depth(depth)
    assert not near[:10].any() and np.allclose(near[10:20], 0.5) and not near[20:].any()
    assert not inverse_depth(np.zeros((4, 4), dtype=np.float32)).any()


def test_letterboxed_boxes_come_back() -> None:
    rgb = np.zeros((100, 50, 3), dtype=np.uint8)
    rgb[20:40, 10:30] = 255
    image, placed = network_input(rgb, None, (256, 320), 4)
    assert image.shape == (1, 4, 256, 320) and not image[0, 3].any()
    rows, columns = np.nonzero(image[0, 0] > 0.75)
    box = [[columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]]
    np.testing.assert_allclose(placed.to_image(np.array(box), 50, 100), [[10, 20, 30, 40]], atol=0.5)


@pytest.mark.parametrize(
    ("rgb", "depth", "message"),
    [
        (np.zeros((4, 4), dtype=np.uint8), None, "rgb: expected an image"),
        (np.zeros((4, 4, 3)), None, "rgb: expected an image .* float64"),
        (np.zeros((4, 4, 3), dtype=np.uint8), np.zeros((4, 5)), "depth: expected the image's size"),
    ],
)
def test_pictures_that_cannot_be_fed(rgb: np.ndarray, depth: np.ndarray | None, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        network_input(rgb, depth, (64, 64), 4)


def test_suppression_keeps_the_best_of_each_class() -> None:
    boxes = np.array([[0, 0, 10, 10], [1, 0, 11, 10], [30, 30, 40, 40], [5, 5, 5, 9]], dtype=float)
    scores = np.array([[0.9, 0.0], [0.8, 0.7], [0.3, 0.0], [0.99, 0.99]])
    kept, values, labels = suppress(boxes, scores, 0.2, 0.5)
    assert values.tolist() == [0.9, 0.7, 0.3] and labels.tolist() == [0, 1, 0]
    np.testing.assert_array_equal(kept, boxes[[0, 1, 2]])
    assert suppress(boxes, scores, 0.2, 0.5, classes_compete=True)[1].tolist() == [0.9, 0.3]
    assert len(suppress(boxes[:0], scores[:0], 0.2, 0.5)[0]) == 0
