"""Images from files: metres, RGB, and one line about what cannot be used."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from aerograsp_env.cameras.image_files import DepthUnitError, ImageFileError, read_color, read_depth

RNG = np.random.default_rng(0)
DEPTH = RNG.integers(500, 3000, (24, 32)).astype(np.uint16)
COLOR = RNG.integers(0, 256, (24, 32, 3)).astype(np.uint8)


def written(path: Path, image: np.ndarray) -> Path:
    assert cv2.imwrite(str(path), image)
    return path


def test_colours_come_as_rgb(tmp_path: Path) -> None:
    assert (read_color(written(tmp_path / "a.png", COLOR[..., ::-1])) == COLOR).all()
    gray = written(tmp_path / "g.png", COLOR[..., 0])
    assert (read_color(gray) == COLOR[..., :1]).all()


def test_depth_comes_in_metres(tmp_path: Path) -> None:
    image = DEPTH.copy()
    image[0, 0], image[0, 1] = 0, 65535
    depth = read_depth(written(tmp_path / "d.png", image))
    assert depth.dtype == np.float32
    assert depth[0, 0] == 0.0 and depth[0, 1] == 0.0
    np.testing.assert_allclose(depth[1:], DEPTH[1:] / 1000.0, rtol=1e-6)
    np.testing.assert_allclose(read_depth(written(tmp_path / "t.png", DEPTH), 5000.0), DEPTH / 5000.0, rtol=1e-6)
    metres = (DEPTH / 1000.0).astype(np.float32)
    metres[0, 0] = np.nan
    depth = read_depth(written(tmp_path / "f.tiff", metres))
    assert depth[0, 0] == 0.0 and (depth[1:] == metres[1:]).all()


def test_an_empty_depth_image_is_one(tmp_path: Path) -> None:
    assert not read_depth(written(tmp_path / "d.png", np.zeros_like(DEPTH))).any()


@pytest.mark.parametrize("end", [".png", ".jpg"])
@pytest.mark.parametrize("share", [0.0, 0.5, 0.98])
def test_a_truncated_image_is_refused(tmp_path: Path, end: str, share: float) -> None:
    path = written(tmp_path / f"cut{end}", COLOR)
    code = path.read_bytes()
    path.write_bytes(code[: int(share * len(code))])
    with pytest.raises(ImageFileError, match=rf"cut\{end}: expected a whole"):
        read_color(path)


@pytest.mark.parametrize("unit", [1.0, 1e6])
def test_a_wrong_unit_is_refused(tmp_path: Path, unit: float) -> None:
    with pytest.raises(DepthUnitError, match=r"d.png: expected depths in steps of .*: set the unit"):
        read_depth(written(tmp_path / "d.png", DEPTH), unit)


def test_what_is_no_depth_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ImageFileError, match="16 bits a pixel, got mode RGB"):
        read_depth(written(tmp_path / "c.png", COLOR))
    with pytest.raises(ImageFileError, match="16 bits a pixel, got mode L"):
        read_depth(written(tmp_path / "b.png", COLOR[..., 0]))
    (tmp_path / "text.png").write_text("not an image")
    with pytest.raises(ImageFileError, match="expected a whole"):
        read_depth(tmp_path / "text.png")
    with pytest.raises(FileNotFoundError):
        read_depth(tmp_path / "none.png")
    with pytest.raises(ValueError, match="unit: expected a positive"):
        read_depth(written(tmp_path / "d.png", DEPTH), 0.0)
