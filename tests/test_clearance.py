"""Room for the gripper: swept boxes against their definition, meshes and points against each other and closed forms."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from aerograsp_env.sim.gripper import GripperConfig
from baselines.grasping.clearance import (
    APPROACH,
    PALM,
    TOLERANCE,
    mesh_collisions,
    point_collisions,
    point_distances,
    swept_boxes,
)
from baselines.objects.mesh import MeshObject

GRIPPER = GripperConfig()


def one(opening=0.06, contact=0.04, **kwargs):
    return swept_boxes(GRIPPER, np.array([opening]), np.array([contact]), **kwargs)


def placed(mesh, center=(0.0, 0.0, 0.0), rotation=None, opening=0.06, contact=0.04):
    rotation = np.eye(3) if rotation is None else rotation
    return mesh_collisions(mesh, rotation[None], np.array([center]), one(opening, contact))[0]


def test_swept_boxes_cover_the_gripper_along_its_way():
    swept = one(tolerance=0.0)[0]
    for back in (0.0, 0.4 * APPROACH, APPROACH):
        for k, part in enumerate(GRIPPER.boxes(0.06)):
            low, high = np.subtract(part.center, part.half_size), np.add(part.center, part.half_size)
            assert (swept[k, :3] <= low - [0, 0, back] + 1e-12).all() and (
                swept[k, 3:] >= high - [0, 0, back] - 1e-12
            ).all()
    parts = {part.name: part for part in GRIPPER.boxes(0.04)}
    for k, name in ((5, "left_finger"), (6, "right_finger")):  # from open to closed
        low = np.subtract(parts[name].center, parts[name].half_size)
        high = np.add(parts[name].center, parts[name].half_size)
        assert (swept[k, :3] <= low + 1e-12).all() and (swept[k, 3:] >= high - 1e-12).all()
        assert swept[k, 3] - swept[k, 0] == pytest.approx(GRIPPER.finger_thickness + 0.01)
    assert GRIPPER.boxes(0.06)[PALM].name == "palm"


def test_tolerance_shrinks_every_side():
    assert np.allclose(one(tolerance=0.0)[..., :3] + TOLERANCE, one()[..., :3])
    assert np.allclose(one(tolerance=0.0)[..., 3:] - TOLERANCE, one()[..., 3:])


def test_a_block_between_the_jaws():
    def block(width, depth=0.05):
        return MeshObject.from_trimesh(trimesh.creation.box((width, 0.02, depth)))

    assert placed(block(0.04)) == -1
    # Pads are open by 60 mm: a block 0.5 mm deeper on each side is forgiven, 0.6 mm is not.
    assert placed(block(0.0608), contact=0.06) == -1
    assert placed(block(0.0612), contact=0.06) >= 0
    # The palm is 60 mm behind the pads' middle.
    assert placed(block(0.04, 2 * 0.0604)) == -1
    assert placed(block(0.04, 2 * 0.0606)) == PALM


def test_what_stands_in_the_way_of_approach():
    body = trimesh.creation.box((0.04, 0.02, 0.03))
    lintel = trimesh.creation.box((0.2, 0.02, 0.02), trimesh.transformations.translation_matrix((0, 0, -0.13)))
    both = MeshObject.from_trimesh(trimesh.util.concatenate([body, lintel]))
    assert placed(MeshObject.from_trimesh(body)) == -1
    assert placed(both) >= 0  # behind the palm when closed, but the gripper has to come through it


def test_a_finger_inside_of_a_solid_is_not_free():
    hollow = MeshObject.from_trimesh(trimesh.creation.box((1.0, 1.0, 1.0)))
    assert placed(hollow, contact=0.05) >= 0
    # Far away in every direction but inside: only containment can tell.
    boxes = one()
    assert (np.abs(boxes) < 0.4).all()


def test_a_triangle_larger_than_the_gripper_is_seen():
    slab = MeshObject.from_trimesh(trimesh.creation.box((2.0, 2.0, 0.01)))
    assert placed(slab) >= 0
    assert placed(slab, center=(0.0, 0.0, -0.02)) == -1  # in front of the pads' tips


def test_mesh_and_dense_points_agree():
    rng = np.random.default_rng(0)
    mesh = MeshObject.from_trimesh(trimesh.creation.torus(0.04, 0.012))
    points = mesh.sample(40_000, rng).points
    rotations = Rotation.random(300, rng=rng).as_matrix()
    centers = rng.uniform(-0.06, 0.06, (300, 3))
    opening = rng.uniform(0.03, 0.09, 300)
    boxes = swept_boxes(GRIPPER, opening, opening - 0.01)
    by_mesh = mesh_collisions(mesh, rotations, centers, boxes) >= 0
    by_points = point_collisions(points, rotations, centers, boxes) >= 0
    assert not (by_points & ~by_mesh).any()  # a point is on the mesh
    assert (by_points == by_mesh).mean() > 0.98
    assert 0.1 < by_mesh.mean() < 0.95


def test_points_against_the_definition():
    rng = np.random.default_rng(1)
    points = rng.uniform(-0.1, 0.1, (500, 3))
    rotations, centers = Rotation.random(50, rng=rng).as_matrix(), rng.uniform(-0.2, 0.2, (50, 3))
    boxes = swept_boxes(GRIPPER, np.full(50, 0.05), np.full(50, 0.04))
    found = point_collisions(points, rotations, centers, boxes)
    for g in range(50):
        local = (points - centers[g]) @ rotations[g]
        inside = ((local[:, None] > boxes[g, :, :3]) & (local[:, None] < boxes[g, :, 3:])).all(axis=2)
        assert inside.any() == (found[g] >= 0)
        if found[g] >= 0:
            assert inside[:, found[g]].any()


def test_distances_against_the_definition():
    rng = np.random.default_rng(2)
    points = rng.uniform(-0.1, 0.1, (60, 3))
    rotations, centers = Rotation.random(40, rng=rng).as_matrix(), rng.uniform(-0.2, 0.2, (40, 3))
    boxes = swept_boxes(GRIPPER, np.full(40, 0.05), np.full(40, 0.04))
    found = point_distances(points, rotations, centers, boxes, 1.0)
    capped = point_distances(points, rotations, centers, boxes, 0.01)
    for g in range(40):
        local = ((points - centers[g]) @ rotations[g])[:, None]
        nearest = np.clip(local, boxes[g, :, :3], boxes[g, :, 3:])
        np.testing.assert_allclose(found[g], np.linalg.norm(local - nearest, axis=2).min(), atol=1e-12)
    np.testing.assert_allclose(capped, np.minimum(found, 0.01), atol=1e-12)
    np.testing.assert_array_equal(found == 0.0, point_collisions(points, rotations, centers, boxes) >= 0)


def test_the_verdict_moves_with_everything():
    rng = np.random.default_rng(2)
    mesh = MeshObject.from_trimesh(trimesh.creation.torus(0.04, 0.012))
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.random(rng=rng).as_matrix(), (0.1, -0.2, 0.3)
    rotations, centers = Rotation.random(100, rng=rng).as_matrix(), rng.uniform(-0.06, 0.06, (100, 3))
    boxes = swept_boxes(GRIPPER, np.full(100, 0.05), np.full(100, 0.04))
    moved = mesh_collisions(mesh.transform(T), T[:3, :3] @ rotations, centers @ T[:3, :3].T + T[:3, 3], boxes)
    assert np.array_equal(mesh_collisions(mesh, rotations, centers, boxes) < 0, moved < 0)
