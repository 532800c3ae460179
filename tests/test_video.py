"""Frames written as GIF, MP4 and PNG come back, and what cannot be written is said."""

import cv2
import numpy as np
import pytest
from PIL import Image, ImageSequence

from aerograsp_env.sim.video import write_gif, write_mp4, write_png, write_video


def moving_square(count, height=48, width=64):
    for i in range(count):
        frame = np.full((height, width, 3), (40, 60, 90), dtype=np.uint8)
        frame[10:22, 2 + 4 * i : 14 + 4 * i] = (230, 120, 30)
        yield frame


def test_gif_round_trip(tmp_path):
    frames = list(moving_square(7))
    assert write_gif(tmp_path / "a.gif", frames, fps=20) == tmp_path / "a.gif"
    with Image.open(tmp_path / "a.gif") as gif:
        assert (len(list(ImageSequence.Iterator(gif))), gif.size, gif.info["loop"], gif.info["duration"]) == (
            7,
            (64, 48),
            0,
            50,
        )
        for frame, image in zip(frames, ImageSequence.Iterator(gif), strict=True):
            difference = np.abs(np.asarray(image.convert("RGB")).astype(int) - frame)
            assert difference.max() <= 4  # two colours fit into any palette
    assert [file.name for file in tmp_path.iterdir()] == ["a.gif"]


def test_gif_frame_times_add_up(tmp_path):
    write_gif(tmp_path / "a.gif", moving_square(12), fps=30)
    with Image.open(tmp_path / "a.gif") as gif:
        times = [image.info["duration"] for image in ImageSequence.Iterator(gif)]
    assert sum(times) == 400  # [ms]
    assert set(times) == {30, 40}


def test_gif_palette_keeps_small_bright_things(tmp_path):
    """A smooth floor covers 99 % of the picture; a shaded ball must still not turn into bands."""
    y, x = np.mgrid[0:120, 0:160]
    frame = np.stack([80 + y / 2, 90 + y / 3 + x / 8, 100 + x / 3], axis=-1)
    inside = np.hypot(x - 40, y - 40) < 8
    frame[inside] = np.stack([120 + 8 * (x - 40), 20 + 0 * x, 20 + 0 * x], axis=-1)[inside]
    frame = frame.clip(0, 255).astype(np.uint8)
    write_gif(tmp_path / "a.gif", [frame], fps=10)
    with Image.open(tmp_path / "a.gif") as gif:
        error = np.abs(np.asarray(gif.convert("RGB")).astype(int) - frame)
    assert error[inside].mean() < 5
    assert error.mean() < 3


def test_mp4_round_trip_from_a_generator(tmp_path):
    write_mp4(tmp_path / "a.mp4", moving_square(9), fps=25)
    video = cv2.VideoCapture(str(tmp_path / "a.mp4"))
    assert video.get(cv2.CAP_PROP_FPS) == pytest.approx(25)
    read = []
    while (answer := video.read())[0]:
        read.append(answer[1][..., ::-1].astype(int))
    video.release()
    assert len(read) == 9
    for frame, image in zip(moving_square(9), read, strict=True):
        assert image.shape == frame.shape
        assert np.abs(image - frame).mean() < 12  # lossy, but the right way round and in the right colours
    assert [file.name for file in tmp_path.iterdir()] == ["a.mp4"]


def test_mp4_pads_odd_sizes(tmp_path):
    write_mp4(tmp_path / "a.mp4", moving_square(3, height=47, width=63), fps=25)
    video = cv2.VideoCapture(str(tmp_path / "a.mp4"))
    assert (video.get(cv2.CAP_PROP_FRAME_WIDTH), video.get(cv2.CAP_PROP_FRAME_HEIGHT)) == (64, 48)
    assert video.get(cv2.CAP_PROP_FRAME_COUNT) == 3
    video.release()


def test_png_is_lossless(tmp_path):
    frame = np.random.default_rng(0).integers(0, 256, (30, 40, 3), dtype=np.uint8)
    write_png(tmp_path / "a.png", frame)
    with Image.open(tmp_path / "a.png") as image:
        np.testing.assert_array_equal(np.asarray(image), frame)


def test_suffix_chooses_the_writer(tmp_path):
    for name in ("a.gif", "b.MP4"):
        assert write_video(tmp_path / name, moving_square(2), fps=10).stat().st_size > 0
    with pytest.raises(ValueError, match=r"\.gif, \.mp4.*movie\.avi"):
        write_video(tmp_path / "movie.avi", moving_square(2), fps=10)
    with pytest.raises(ValueError, match=r"\.png"):
        write_png(tmp_path / "a.jpg", next(moving_square(1)))


@pytest.mark.parametrize("suffix", [".gif", ".mp4"])
def test_bad_frames_leave_the_old_file(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    write_video(path, moving_square(2), fps=10)
    before = path.read_bytes()
    good = next(moving_square(1))
    for frames, message in (
        ([], "at least one"),
        ([good.astype(float)], r"frames\[0\].*uint8.*float64"),
        ([good, good[..., :2]], r"frames\[1\].*\(48, 64, 2\)"),
        ([good, good[:-2]], r"frames\[1\].*first.*\(46, 64, 3\)"),
        ([good[:0]], r"\(0, 64, 3\)"),
    ):
        with pytest.raises(ValueError, match=message):
            write_video(path, frames, fps=10)
    for fps in (0, -1, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="fps"):
            write_video(path, [good], fps=fps)
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


def test_gif_is_not_faster_than_viewers(tmp_path):
    write_gif(tmp_path / "a.gif", moving_square(2), fps=50)
    with pytest.raises(ValueError, match="at most 50"):
        write_gif(tmp_path / "a.gif", moving_square(2), fps=60)


@pytest.mark.parametrize("suffix", [".gif", ".mp4"])
def test_folders_that_cannot_be_written(tmp_path, suffix, monkeypatch):
    with pytest.raises(NotADirectoryError, match="nowhere"):
        write_video(tmp_path / "nowhere" / f"a{suffix}", moving_square(2), fps=10)
    (tmp_path / f"folder{suffix}").mkdir()
    with pytest.raises(IsADirectoryError, match="folder"):
        write_video(tmp_path / f"folder{suffix}", moving_square(2), fps=10)

    def refuse(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("pathlib.Path.touch", refuse)  # a read-only folder does not stop root
    with pytest.raises(PermissionError, match="cannot be written to: Permission denied"):
        write_video(tmp_path / f"a{suffix}", moving_square(2), fps=10)


def test_a_codec_that_does_not_open_is_named(tmp_path, monkeypatch):
    class Closed:
        def __init__(self, *_):
            pass

        def isOpened(self):
            return False

        def release(self):
            pass

        fourcc = staticmethod(cv2.VideoWriter.fourcc)

    monkeypatch.setattr(cv2, "VideoWriter", Closed)
    with pytest.raises(RuntimeError, match=r"mp4v.*\.gif"):
        write_mp4(tmp_path / "a.mp4", moving_square(2), fps=10)
    assert not list(tmp_path.iterdir())
