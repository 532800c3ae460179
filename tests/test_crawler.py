"""The pipe crawler: a sound solid with its symmetries, and handles that two jaws take with its weight between them."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull, cKDTree
from scipy.spatial.transform import Rotation

from aerograsp_env.sim.gripper import GripperConfig
from aerograsp_env.sim.objects import mass_properties
from aerograsp_env.sim.objects.build import is_watertight
from aerograsp_env.sim.objects.crawler import crawler_handles, pipe_crawler
from aerograsp_env.sim.objects.variants import heavier


def depths(item, points):
    """How deep points lie inside the deepest of the pieces [m]; negative outside."""
    hulls = [ConvexHull(piece.vertices).equations for piece in item.pieces]
    return np.max([-(points @ planes[:, :3].T + planes[:, 3]).max(axis=1) for planes in hulls], axis=0)


def test_it_is_one_closed_solid_of_convex_pieces_that_overlap_nowhere_beyond_it():
    item = pipe_crawler()
    assert is_watertight(item.faces)
    assert len(item.pieces) <= 40
    assert 0.30 <= np.ptp(item.vertices, axis=0).max() <= 0.45
    assert 1.0 <= item.mass <= 1.5
    volume = mass_properties(item.vertices, item.faces).mass
    assert max(mass_properties(*piece).mass for piece in item.pieces) < volume
    for piece in item.pieces:
        hull = trimesh.convex.convex_hull(piece.vertices)
        assert hull.volume == pytest.approx(mass_properties(*piece).mass, rel=1e-9)


def test_three_lobes_make_it_its_own_image_at_120_degrees_and_in_three_planes():
    item = pipe_crawler()
    corners = np.concatenate([piece.vertices for piece in item.pieces])
    assert item.center_of_mass[:2] == pytest.approx((0.0, 0.0), abs=1e-8)
    for turn in (Rotation.from_euler("z", 120.0, degrees=True).as_matrix(), np.diag((1.0, -1.0, 1.0))):
        assert cKDTree(corners).query(corners @ turn.T)[0].max() < 1e-8
        assert turn @ item.inertia @ turn.T == pytest.approx(item.inertia, abs=1e-9)
    principal = np.diag(item.inertia)
    assert item.inertia == pytest.approx(np.diag(principal), abs=1e-9)
    assert principal[0] == pytest.approx(principal[1], rel=1e-6)


def test_inertia_lies_between_that_of_its_weight_at_the_axis_and_at_the_rim():
    item = pipe_crawler()
    radius = np.linalg.norm(item.vertices[:, :2], axis=1).max()
    assert 0.1 * item.mass * radius**2 < item.inertia[2, 2] < 0.7 * item.mass * radius**2


def test_handles_are_bars_of_the_surface_which_a_jaw_takes():
    item = pipe_crawler()
    for handle in crawler_handles():
        assert 2.0 * handle.radius < 0.5 * GripperConfig().max_width
        middles = handle.start + np.linspace(0.1, 0.9, 9)[:, None] * (handle.end - handle.start)
        depth = depths(item, middles)
        assert np.all((depth > 0.9 * handle.radius) & (depth <= handle.radius + 1e-6))


@pytest.mark.parametrize(("width", "shares"), [(0.05, (0.04, 0.5, 0.96)), (0.10, (0.3, 0.5, 0.7))])
def test_room_for_the_fingers_on_both_sides_of_a_handle(width, shares):
    item, down = pipe_crawler(), np.array([0.0, 0.0, -1.0])
    grid = np.stack(np.meshgrid(*[np.linspace(-1.0, 1.0, 7)] * 3), axis=-1).reshape(-1, 3)
    for handle in crawler_handles():
        out = 0.5 * (handle.start + handle.end) * (1.0, 1.0, 0.0)
        out /= np.linalg.norm(out)
        for share in shares:  # the ends hold it level, see below
            place = handle.start + share * (handle.end - handle.start)
            for box in GripperConfig().boxes(width):
                points = grid * box.half_size + box.center
                assert depths(item, place + points @ np.stack([out, np.cross(down, out), down])).max() < -2e-3


def test_two_handles_hold_it_level_with_the_arms_that_are_04_m_apart():
    item = pipe_crawler()
    first, _, last = crawler_handles()

    def above_center(handle):
        share = -handle.start[0] / (handle.end[0] - handle.start[0])  # where the bar crosses the plane x = 0
        assert 0.03 < share < 0.97
        return handle.start + share * (handle.end - handle.start)

    left, right = above_center(first), above_center(last)
    assert 0.30 <= left[1] - right[1] <= 0.40
    middle = 0.5 * (left + right)
    assert middle[:2] == pytest.approx(item.center_of_mass[:2], abs=1e-8)
    assert middle[2] > item.center_of_mass[2] + 0.02  # it hangs, and does not turn over


def test_mass_and_friction_are_free_and_the_same_object_comes_back():
    assert pipe_crawler(1.4) is pipe_crawler(1.4)
    heavy = pipe_crawler(1.4, 0.3)
    assert (heavy.mass, heavy.friction) == (1.4, 0.3)
    assert heavy.inertia == pytest.approx(pipe_crawler().inertia * (1.4 / 1.2), rel=1e-12)
    with pytest.raises(ValueError, match="mass"):
        pipe_crawler(0.0)


def test_heavier_keeps_the_shape_and_scales_the_inertia():
    item = pipe_crawler()
    other = heavier(item, 0.6, 0.2)
    assert (other.mass, other.friction) == (0.6, 0.2)
    assert other.inertia == pytest.approx(0.5 * item.inertia, rel=1e-12)
    assert other.vertices is item.vertices
    assert heavier(item, friction=0.2).mass == item.mass
    assert heavier(item, 2.0).friction == item.friction
    for mass in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(ValueError, match="mass"):
            heavier(item, mass)
    with pytest.raises(ValueError, match="friction"):
        heavier(item, friction=-0.1)
