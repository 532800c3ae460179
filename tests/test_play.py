"""Films and pictures of episodes, and what is refused before anything is simulated."""

import cv2
import numpy as np
import pytest
from PIL import Image, ImageSequence

from agents import overlay, play
from agents.arguments import guarded

ID = "aerograsp/Dock-v0"
SMALL = ["--width", "64", "--height", "48"]


def run(*argv):
    return guarded("aerograsp play", play.main, list(argv))


def test_gif_and_picture(tmp_path, capsys):
    film, picture = tmp_path / "a.gif", tmp_path / "a.png"
    args = [ID, "--policy", "zero", "--out", str(film), "--picture", str(picture), "--seconds", "0.4", "--fps", "10"]
    assert run(*args, *SMALL, "--no-overlay") == 0
    out = capsys.readouterr().out
    assert out.count("\n") == 1 and str(film) in out and "still running after 0.4 s" in out
    with Image.open(film) as gif:
        frames = len(list(ImageSequence.Iterator(gif)))
        assert (frames, gif.size) == (5, (64, 48))  # at 0, 0.1, … 0.4 s
    with Image.open(picture) as image:
        assert image.size == (64, 48) and np.asarray(image).std() > 10
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a.gif", "a.png"]


def test_mp4_of_two_episodes_to_their_ends(tmp_path, capsys):
    film = tmp_path / "a.mp4"
    args = ["aerograsp/DockAttach-v0", "--out", str(film), "--episodes", "2", "--seed", "7", "--camera", "tool"]
    assert run(*args, "--env-kwarg", "max_episode_steps=10", *SMALL) == 0
    assert "seed 7: failure after 0.2 s" in (out := capsys.readouterr().out) and "seed 8: " in out
    assert cv2.VideoCapture(str(film)).get(cv2.CAP_PROP_FRAME_COUNT) == 10


@pytest.mark.parametrize(
    ("options", "status", "message"),
    [
        ([], 2, "nothing to write"),
        (["--out", "a.avi"], 2, r".gif or .mp4"),
        (["--picture", "a.jpg"], 2, ".png"),
        (["--out", "nowhere/a.gif"], 2, "no such folder"),
        (["--out", "/proc/a.gif"], 1, "cannot write to folder /proc"),
        (["--out", "a.gif", "--fps", "60"], 2, "at most 50"),
        (["--out", "a.gif", "--seconds", "0"], 2, "seconds"),
        (["--out", "a.gif", "--camera", "sde"], 2, "did you mean 'side'"),
        (["--out", "a.gif", "--policy", "pdi"], 2, "did you mean 'pid'"),
    ],
)
def test_mistakes_are_one_line_and_cost_nothing(options, status, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run(ID, *options) == status
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_overlay_leaves_the_frame_and_its_middle_alone():
    frame = np.full((180, 240, 3), (40, 60, 90), dtype=np.uint8)
    before = frame.copy()
    drawn = overlay.annotate(frame, overlay.Readings(3.2, "pid", 0.012, (1.0, 2.0), "coupled"))
    np.testing.assert_array_equal(frame, before)
    assert drawn.shape == frame.shape and drawn.dtype == np.uint8
    np.testing.assert_array_equal(drawn[120:], before[120:])
    assert (drawn[:60, :60] != before[:60, :60]).any() and (drawn[:60, -60:] != before[:60, -60:]).any()


def test_the_wind_arrow_points_downwind():
    """Blue pixels of the arrow lie more on the side of its head, which is wider than its tail."""
    frame = np.full((400, 400, 3), 255, dtype=np.uint8)
    for wind, axis, sign in (((3.0, 0.0), 1, 1), ((-3.0, 0.0), 1, -1), ((0.0, 3.0), 0, -1), ((0.0, -3.0), 0, 1)):
        drawn = overlay.annotate(frame, overlay.Readings(0.0, "x", wind=wind)).astype(int)
        blue = np.argwhere(drawn[..., 2] - drawn[..., 0] > 100)
        middle = 0.5 * (blue.min(axis=0) + blue.max(axis=0))
        assert sign * (blue.mean(axis=0) - middle)[axis] > 1.0
