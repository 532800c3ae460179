"""Reachability maps: against the arms' geometry, sampled configurations and single solves."""

from __future__ import annotations

import math

import numpy as np
import pytest

from agents.figure_5_9 import run as figure
from agents.reproduction import Request
from baselines.kinematics import Arm, approach_directions, branches_4dof, branches_6dof, reachability
from baselines.kinematics.reachability import _frames

SIX, FOUR = Arm.hecatonquiros_6dof(), Arm.hecatonquiros_4dof()
PNG = b"\x89PNG\r\n\x1a\n"


def test_directions_are_even():
    for count in (1, 2, 32, 200):
        directions = approach_directions(count)
        np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0)
    assert np.linalg.norm(directions.mean(axis=0)) < 0.01
    np.testing.assert_allclose(directions.T @ directions / 200, np.eye(3) / 3, atol=0.01)
    with pytest.raises(ValueError, match="count: expected 1 or more"):
        approach_directions(0)


def test_rolls_are_turns_about_their_direction():
    towards = approach_directions(5)
    frames = _frames(towards, 4)
    assert frames.shape == (5, 4, 3, 3)
    np.testing.assert_allclose(
        frames @ np.swapaxes(frames, -1, -2), np.broadcast_to(np.eye(3), frames.shape), atol=1e-15
    )
    np.testing.assert_allclose(np.linalg.det(frames), 1.0)
    np.testing.assert_allclose(frames[..., 2], np.repeat(towards[:, None], 4, axis=1))
    np.testing.assert_allclose(np.sum(frames[:, 0, :, 0] * frames[:, 1, :, 0], axis=-1), 0.0, atol=1e-15)


def test_served_is_what_single_solves_say():
    axis = np.linspace(-0.4, 0.4, 5)
    found = reachability(SIX, axis, axis, axis + 0.1, approach_directions(6), rolls=3)
    assert found.served.shape == (5, 5, 5, 6)
    frames = _frames(found.approaches, 3)
    target = np.eye(4)
    for index in np.ndindex(5, 5, 5, 6):
        target[:3, 3] = found.x[index[0]], found.y[index[1]], found.z[index[2]]
        some = False
        for R in frames[index[3]]:
            target[:3, :3] = R
            some |= len(branches_6dof(SIX, target)) > 0
        assert found.served[index] == some
    assert 0.05 < found.share.mean() < 0.6


def test_nothing_beyond_the_stretched_arm_and_the_sampled_tool_inside():
    step = 0.05
    axis = step * np.arange(-13, 14)
    found = reachability(FOUR, axis, axis, axis)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    distance = np.sqrt(x**2 + y**2 + (z - 0.08) ** 2)
    some = found.share > 0.0
    assert not some[distance > 0.148 + 0.295 + 1e-9].any()
    assert found.volume() == pytest.approx(some.sum() * step**3)
    # a Monte Carlo volume of the same set
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.65, 0.65, (2000, 3))
    target = np.eye(4)
    inside = 0
    for point in points:
        target[:3, 3] = point
        inside += len(branches_4dof(FOUR, target, roll=False)) > 0
    assert found.volume() == pytest.approx(inside / 2000 * 1.3**3, rel=0.12)


def test_four_joints_serve_the_directions_they_come_from():
    q = np.array([0.2, -0.6, 1.0, 0.4])
    T = FOUR.forward(q)
    around = [T[:3, 2], -T[:3, 2]]
    found = reachability(FOUR, T[0, 3], T[1, 3], T[2, 3], approaches=around, cone=math.radians(1.0))
    assert found.served.ravel().tolist() == [True, False]


def test_the_map_is_as_symmetric_as_the_arm():
    """Mirrored at the plane y = 0 the six-joint arm is itself, up to the offset of its tool."""
    axis = np.linspace(-0.45, 0.45, 10)
    down = reachability(SIX, axis, axis, axis, [[0.0, 0.0, 1.0]], rolls=16).served[..., 0]
    assert np.mean(down != down[:, ::-1]) < 0.01
    assert down.any()


def test_known_volumes():
    """Of the arm's frame: top-down and level grasps. Rolls matter little, the base frame not at all."""
    axis = 0.05 * np.arange(-12, 13)
    found = reachability(SIX, axis, axis, axis, [[0, 0, 1], [1, 0, 0]])
    down, ahead = found.served[..., 0], found.served[..., 1]
    assert 0.055 < down.sum() * 0.05**3 < 0.070
    assert 0.085 < ahead.sum() * 0.05**3 < 0.105
    assert found.volume(0.5) == pytest.approx((down & ahead).sum() * 0.05**3)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"x": [math.nan]}, "x: expected finite"),
        ({"z": np.zeros((2, 2))}, "z: expected finite"),
        ({"approaches": [[0.0, 0.0, 0.0]]}, "approaches: expected"),
        ({"approaches": [[0.0, 1.0]]}, "approaches: expected"),
        ({"rolls": 0}, "rolls: expected"),
        ({"cone": 0.0}, "cone: expected"),
        ({"x": np.zeros(10_000), "y": np.zeros(1000)}, "take a coarser grid"),
        ({"arm": Arm(SIX.placements[:5], SIX.axes[:5], SIX.limits[:5])}, "needs 6 joints, got 5"),
    ],
)
def test_bad_maps(changes, message):
    good = {"arm": SIX, "x": [0.0], "y": [0.0], "z": [0.0]}
    with pytest.raises(ValueError, match=message):
        reachability(**(good | changes))


def test_figure_5_9():
    result = figure(Request(picture=True), resolution=0.15, fine=0.1)
    assert result.picture is not None and result.picture.startswith(PNG)
    volumes = result.data["volumes"]
    for row in volumes.values():
        assert row["both"] <= min(row["right"], row["left"])
    some = volumes["any direction served"]
    assert some["right"] == pytest.approx(some["left"], rel=0.2)
    assert volumes["straight down"]["right"] < some["right"]
    assert "any direction served" in result.text
    assert figure(Request(), resolution=0.3).picture is None
