"""Features: BRIEF by its definition, every pair of detector and descriptor, invariances, errors."""

from __future__ import annotations

import itertools

import cv2
import numpy as np
import pytest

from baselines.detection.brief import BORDER, PLACES, brief
from baselines.detection.extraction import DESCRIPTORS, DETECTORS, extract, feature_kind
from baselines.objects.matching import match_descriptors


@pytest.fixture(scope="module")
def picture() -> np.ndarray:
    rng = np.random.default_rng(0)
    image = np.full((240, 320, 3), 128, dtype=np.uint8)
    for _ in range(60):
        a, b = rng.integers(0, 300, 2), rng.integers(5, 50, 2)
        color = tuple(int(c) for c in rng.integers(0, 255, 3))
        cv2.rectangle(image, tuple(map(int, a)), tuple(map(int, a + b)), color, -1)
        word, dark = "".join(rng.choice(list("AKMNRVXYZ247"), 4)), tuple(int(c) for c in rng.integers(0, 90, 3))
        cv2.putText(image, word, tuple(map(int, a)), cv2.FONT_HERSHEY_SIMPLEX, 0.5, dark, 2, cv2.LINE_AA)
    return image


def test_brief_is_512_comparisons_of_box_sums() -> None:
    rng = np.random.default_rng(1)
    gray = rng.integers(0, 256, (80, 90)).astype(np.uint8)
    pixels = np.array([[40.2, 35.7], [61.0, 51.0]])
    described, inside = brief(gray, pixels)
    assert inside.all() and described.shape == (2, 64)
    bits = np.unpackbits(described, axis=1)

    def box(y: int, x: int) -> int:
        return int(gray[y - 4 : y + 5, x - 4 : x + 5].astype(int).sum())

    for i, (x, y) in enumerate([(40, 36), (61, 51)]):
        expected = [box(y + ya, x + xa) < box(y + yb, x + xb) for ya, xa, yb, xb in PLACES]
        np.testing.assert_array_equal(bits[i], expected)


def test_brief_turns_with_the_keypoint() -> None:
    rng = np.random.default_rng(2)
    gray = cv2.resize(rng.integers(0, 256, (13, 13)).astype(np.uint8), (121, 121), interpolation=cv2.INTER_CUBIC)
    middle = np.array([[60.0, 60.0]])
    upright = np.unpackbits(brief(gray, middle)[0])
    turned = np.ascontiguousarray(np.rot90(gray, -1))  # clockwise, as angles are in images
    with_it = np.unpackbits(brief(turned, middle, np.array([90.0]))[0])
    assert (upright != with_it).mean() < 0.05  # places are cut to whole pixels
    assert (upright != np.unpackbits(brief(turned, middle)[0])).mean() > 0.3


def test_brief_leaves_out_what_is_near_the_edge() -> None:
    gray = np.zeros((60, 70), dtype=np.uint8)
    pixels = np.array([[BORDER, BORDER], [BORDER - 1, BORDER], [70 - BORDER - 1, 60 - BORDER - 1], [70 - BORDER, 30]])
    described, inside = brief(gray, pixels)
    assert inside.tolist() == [True, False, True, False] and not described.any()
    assert len(brief(gray, np.empty((0, 2)))[0]) == 0


@pytest.mark.parametrize(("detector", "descriptor"), list(itertools.product(DETECTORS, DESCRIPTORS)))
def test_every_pair_finds_its_features_again(detector: str, descriptor: str, picture: np.ndarray) -> None:
    kind = feature_kind(f"{detector}+{descriptor}")
    found = extract(picture, kind, 150)
    assert 20 < len(found.pixels) <= 150
    assert found.descriptors.shape == (len(found.pixels), kind.width) and found.descriptors.dtype == kind.dtype
    assert (np.diff(found.responses) <= 0).all()
    shifted = extract(np.roll(picture, (6, 9), axis=(0, 1)), kind, 150)
    pairs = match_descriptors(found.descriptors, shifted.descriptors)
    moved = shifted.pixels[pairs.train] - found.pixels[pairs.query]
    assert len(pairs.query) > 15 and (np.abs(moved - [9, 6]).max(axis=1) < 1.5).mean() > 0.8


def test_masks_names_and_empty_pictures(picture: np.ndarray) -> None:
    mask = np.zeros((240, 320), dtype=bool)
    mask[60:120, 100:200] = True
    x, y = extract(picture, "fast+sift", mask=mask).pixels.T
    assert len(x) and x.min() >= 100 and x.max() < 200 and y.min() >= 60 and y.max() < 120
    assert str(feature_kind("sift")) == "sift+sift"
    for detector, descriptor in itertools.product(DETECTORS, DESCRIPTORS):
        empty = extract(np.full((100, 100), 7, dtype=np.uint8), f"{detector}+{descriptor}")
        kind = feature_kind(f"{detector}+{descriptor}")
        assert empty.pixels.shape == (0, 2) and empty.descriptors.shape == (0, kind.width)


def test_errors(picture: np.ndarray) -> None:
    with pytest.raises(ValueError, match="image: expected uint8"):
        extract(picture.astype(np.float32))
    with pytest.raises(ValueError, match="image: expected uint8"):
        extract(np.zeros((4, 4, 4), dtype=np.uint8))
    with pytest.raises(ValueError, match="feature: expected"):
        extract(picture, "akaze")
    with pytest.raises(ValueError, match="n: expected"):
        extract(picture, n=0)
    with pytest.raises(ValueError, match="mask: expected the image's shape"):
        extract(picture, mask=np.ones((3, 3), dtype=bool))
