"""Colour classes: membership by hand, what is learned, regions, files and errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from baselines.detection.color import ColorSegmenter


def test_the_and_of_three_tables_is_the_box_of_each_class() -> None:
    segmenter = ColorSegmenter.from_ranges(
        {"warm": [(100, 255), (0, 99), (0, 99)], "red": [(200, 255), (0, 20), (0, 20)]}, space="rgb"
    )
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (40, 50, 3)).astype(np.uint8)
    image[0, 0], image[0, 1], image[0, 2] = (255, 0, 0), (120, 50, 50), (0, 255, 0)
    bits = segmenter.segment(image)
    assert bits[0, :3].tolist() == [3, 1, 0]
    r, g, b = np.moveaxis(image.astype(int), -1, 0)
    np.testing.assert_array_equal(segmenter.mask(image, "warm"), (r >= 100) & (g <= 99) & (b <= 99))
    np.testing.assert_array_equal(segmenter.mask(image, "red"), (r >= 200) & (g <= 20) & (b <= 20))


def test_hue_wraps_around() -> None:
    segmenter = ColorSegmenter.from_ranges({"red": [(245, 10), (100, 255), (50, 255)]})
    image = np.array([[(255, 0, 0), (255, 0, 30), (255, 30, 0), (0, 255, 0), (0, 0, 255), (255, 255, 255)]], np.uint8)
    assert segmenter.segment(image).tolist() == [[1, 1, 1, 0, 0, 0]]


def test_thirty_two_classes_fit_and_no_more() -> None:
    ranges = {f"grey{k}": [(8 * k, 8 * k + 7)] * 3 for k in range(32)}
    segmenter = ColorSegmenter.from_ranges(ranges, space="rgb")
    grey = np.repeat(np.arange(256, dtype=np.uint8)[None, :, None], 3, axis=2)
    np.testing.assert_array_equal(segmenter.segment(grey)[0], np.uint32(1) << (np.arange(256) // 8).astype(np.uint32))
    with pytest.raises(ValueError, match="labels: expected 1 to 32"):
        ColorSegmenter.from_ranges({**ranges, "more": [(0, 1)] * 3}, space="rgb")


@pytest.mark.parametrize("space", ["hsv", "yuv", "lab", "rgb"])
def test_learned_classes_hold_new_pixels_of_their_own_and_not_the_others(space: str) -> None:
    rng = np.random.default_rng(1)

    def sample(color: tuple[int, int, int], n: int) -> np.ndarray:
        return np.clip(np.array(color) + rng.normal(0.0, 8.0, (n, 3)), 0, 255).astype(np.uint8)

    colors = {"orange": (230, 120, 20), "blue": (30, 60, 200), "grey": (90, 95, 90)}
    segmenter = ColorSegmenter.learn({k: sample(c, 4000) for k, c in colors.items()}, space)
    for k, (label, color) in enumerate(colors.items()):
        bits = segmenter.segment(sample(color, 1000)[None])
        assert (bits >> np.uint32(k) & 1).mean() > 0.85, label
        for other in range(3):
            assert other == k or (bits >> np.uint32(other) & 1).mean() < 0.02, label


def test_coverage_is_met_in_every_channel() -> None:
    rng = np.random.default_rng(2)
    pixels = rng.normal(120.0, 12.0, (5000, 3)).clip(0, 255).astype(np.uint8)
    segmenter = ColorSegmenter.learn({"one": pixels}, "rgb", coverage=0.9)
    for channel in range(3):
        share = (segmenter.tables[channel][pixels[:, channel]] > 0).mean()
        assert 0.9 <= share < 0.95


def test_regions_by_hand() -> None:
    image = np.zeros((60, 80, 3), dtype=np.uint8)
    image[10:20, 5:25] = (255, 0, 0)
    image[40:50, 60:66] = (255, 0, 0)
    image[30:33, 30:33] = (0, 0, 255)
    image[0, 79] = (0, 0, 255)
    segmenter = ColorSegmenter.from_ranges(
        {"red": [(200, 255), (0, 9), (0, 9)], "blue": [(0, 9), (0, 9), (200, 255)]}, space="rgb"
    )
    regions = segmenter.regions(image, min_area=5)
    assert [(r.label, r.area) for r in regions] == [("red", 200), ("red", 60), ("blue", 9)]
    np.testing.assert_allclose(regions[0].box, [4.5, 9.5, 24.5, 19.5])
    np.testing.assert_allclose(regions[0].centroid, [14.5, 14.5])
    # Two pixels that touch at a corner are one region of eight neighbours, and two of four.
    corner = np.zeros((4, 4, 3), dtype=np.uint8)
    corner[1, 1] = corner[2, 2] = (255, 0, 0)
    assert [len(segmenter.regions(corner, 1, c)) for c in (8, 4)] == [1, 2]


def test_classes_come_back_from_their_file(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    segmenter = ColorSegmenter.learn({f"c{k}": rng.integers(0, 256, (300, 3)).astype(np.uint8) for k in range(5)})
    segmenter.save(tmp_path / "colors.json")
    again = ColorSegmenter.load(tmp_path / "colors.json")
    assert again.labels == segmenter.labels and again.space == segmenter.space
    np.testing.assert_array_equal(again.tables, segmenter.tables)


def test_errors_name_what_was_expected(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"image: expected \(H, W, 3\) uint8"):
        ColorSegmenter.from_ranges({"a": [(0, 1)] * 3}).segment(np.zeros((4, 4, 3)))
    with pytest.raises(ValueError, match="ranges"):
        ColorSegmenter.from_ranges({"a": [(0, 256)] * 3})
    with pytest.raises(ValueError, match="pixels"):
        ColorSegmenter.learn({"a": np.zeros((0, 3), dtype=np.uint8)})
    with pytest.raises(ValueError, match="space"):
        ColorSegmenter.learn({"a": np.zeros((1, 3), dtype=np.uint8)}, "cmyk")
    with pytest.raises(ValueError, match="label: expected one of a"):
        ColorSegmenter.from_ranges({"a": [(0, 1)] * 3}).mask(np.zeros((4, 4, 3), dtype=np.uint8), "b")
    for text in ("{", "[]", '{"classes": {"a": [[]]}, "space": "hsv"}', '{"classes": {"a": [[], [], [[5, 300]]]}}'):
        (tmp_path / "bad.json").write_text(text)
        with pytest.raises(ValueError, match=r"bad\.json: expected colour classes"):
            ColorSegmenter.load(tmp_path / "bad.json")
