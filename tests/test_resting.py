"""Resting poses: closed forms for boxes, an independent reference, and that gravity agrees."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh

from aerograsp_env.sim.objects import TRAIN_FAMILIES, build_object, shapes
from aerograsp_env.sim.objects import test_objects as fixed_objects
from aerograsp_env.sim.objects.crawler import pipe_crawler
from aerograsp_env.sim.objects.resting import resting_poses

OBJECTS = (*fixed_objects(), pipe_crawler())


def test_a_cube_rests_on_every_face_alike():
    poses = resting_poses(build_object("cube", "cube", [shapes.box((0.1, 0.1, 0.1))]))
    assert [pose.probability for pose in poses] == pytest.approx([1.0 / 6.0] * 6, rel=1e-9)
    for pose in poses:
        assert pose.height == pytest.approx(0.1)
        assert pose.center_height == pytest.approx(0.05)
        assert pose.margin() == pytest.approx(0.05)


def test_a_box_rests_on_a_face_as_often_as_its_solid_angle_says():
    a, b, c = 0.05, 0.08, 0.16
    poses = resting_poses(build_object("box", "box", [shapes.box((a, b, c))]))
    diagonal = math.sqrt(a * a + b * b + c * c)
    expected = {
        round(h, 6): math.asin(u * v / math.sqrt((u * u + h * h) * (v * v + h * h))) / math.pi
        for h, u, v in ((a, b, c), (b, a, c), (c, a, b))
    }  # solid angle 4 asin(…) of a rectangle seen from above its middle, over the whole sphere's 4 π
    assert diagonal > c
    assert sum(expected.values()) == pytest.approx(0.5)
    assert [pose.probability for pose in poses] == sorted((pose.probability for pose in poses), reverse=True)
    for pose in poses:
        assert pose.probability == pytest.approx(expected[round(pose.height, 6)], rel=1e-6)


def test_a_box_tips_on_the_slope_whose_tangent_is_its_half_width_over_the_height_of_its_center():
    poses = resting_poses(build_object("box", "box", [shapes.box((0.05, 0.08, 0.16))]))
    upright = max(poses, key=lambda pose: pose.height)
    widths = []
    for downhill in np.arange(4) * 0.5 * np.pi:
        width = upright.margin() if upright.margin(1e-9, downhill) > 0.0 else 0.0
        limit = next(s for s in np.linspace(0.0, 0.8, 1601) if upright.margin(s, downhill) < 0.0)
        widths.append(2.0 * 0.08 * math.tan(limit))
        assert width > 0.0
    assert sorted(widths) == pytest.approx([0.05, 0.05, 0.08, 0.08], abs=2e-4)
    assert upright.margin() == pytest.approx(0.025)


def test_a_body_whose_weight_lies_beyond_a_face_rolls_over():
    tall = shapes.hull(  # a prism so oblique that it cannot stand on its ends
        [(x + z, y, z) for x in (0.0, 0.04) for y in (0.0, 0.04) for z in (0.0, 0.12)]
    )
    poses = resting_poses(build_object("oblique", "oblique", [tall]))
    assert len(poses) == 4
    assert sum(pose.probability for pose in poses) == pytest.approx(1.0)
    assert max(pose.height for pose in poses) < 0.1


def test_density_moves_the_poses():
    low, high = shapes.box((0.06, 0.06, 0.06), (0.0, 0.0, 0.03)), shapes.box((0.06, 0.06, 0.06), (0.0, 0.0, 0.09))
    even = resting_poses(build_object("even", "even", [low, high]))
    heavy = resting_poses(build_object("heavy", "heavy", [low, high], densities=[20.0, 1.0]))

    def standing(poses):
        return sum(pose.probability for pose in poses if pose.height > 0.1 and pose.T_support_object[2, 2] > 0.9)

    assert standing(heavy) > 1.5 * standing(even)


@pytest.mark.parametrize("item", OBJECTS, ids=lambda item: item.name)
def test_poses_stand_on_the_plane_below_the_center_of_mass(item):
    poses = resting_poses(item)
    assert poses is resting_poses(item)
    assert sum(pose.probability for pose in poses) == pytest.approx(1.0)
    for pose in poses:
        T = pose.T_support_object
        assert T[:3, :3] @ T[:3, :3].T == pytest.approx(np.eye(3), abs=1e-12)
        assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)
        points = item.vertices @ T[:3, :3].T + T[:3, 3]
        assert points[:, 2].min() == pytest.approx(0.0, abs=1e-12)
        assert points[:, 2].max() == pytest.approx(pose.height, abs=1e-12)
        center = T[:3, :3] @ item.center_of_mass + T[:3, 3]
        assert center == pytest.approx((0.0, 0.0, pose.center_height), abs=3e-5)
        assert pose.margin() > 0.0
        touching = points[points[:, 2] < 5e-5, :2]
        for corner in pose.polygon:
            assert np.linalg.norm(touching - corner, axis=1).min() < 5e-5
        with pytest.raises(ValueError, match="read-only"):
            T[0, 0] = 2.0


@pytest.mark.parametrize(
    "name", ["staple", "hammer", "drill", "half_filled_bottle", "mug", "pipe_crawler", "juice_box"]
)
def test_agrees_with_the_independent_poses_of_trimesh(name):
    item = next(item for item in OBJECTS if item.name == name)
    mesh = trimesh.Trimesh(item.vertices, item.faces, process=False)
    transforms, theirs = trimesh.poses.compute_stable_poses(
        mesh, center_mass=item.center_of_mass, sigma=0.0, n_samples=1, threshold=0.005
    )
    ours = resting_poses(item)
    assert len(ours) == len(theirs)
    assert [pose.probability for pose in ours] == pytest.approx(theirs, abs=0.004)
    heights = [np.ptp(trimesh.transform_points(item.vertices, T)[:, 2]) for T in transforms]
    assert sorted(pose.height for pose in ours) == pytest.approx(sorted(heights), abs=1e-4)


def test_every_training_family_has_a_pose():
    for family in TRAIN_FAMILIES.values():
        for seed in range(2):
            assert len(resting_poses(family(np.random.default_rng(seed)))) >= 2
