"""The arms' description: the robot files' frames and limits, known poses, masses, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from aerograsp_env.sim.arms.description import Shape
from aerograsp_env.sim.arms.hecatonquiros import (
    ARMS,
    HECATONQUIROS_4DOF,
    HECATONQUIROS_5DOF,
    HECATONQUIROS_6DOF,
    SERIAL_TORQUE,
)
from aerograsp_env.sim.arms.worm_gripper import WormGripper
from aerograsp_env.sim.gripper import GripperConfig
from aerograsp_env.spatial import se3_exp, so3_exp, transform

DOWN = np.radians(-90.0)
everyone = pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS)

# Joints as the robot files write them: translation [m], successive <rotationaxis> (axis, degrees), hinge, limits [deg].
_TRUNK = (
    ((0, 0, 0.05), ()),  # arm_0_top 0.02 and arm_0_bottom 0.03
    ((0, 0, 0.03), (("x", -90), ("y", -90), ("z", 180))),
    ((0.148, 0, 0), ()),
    ((0.06, 0, 0), (("y", 90),)),
)
FILES = {
    "hecatonquiros-4dof": (_TRUNK, (-1, 1, 1, -1), ((-90, 90), (-100, 30), (-15, 150), (-110, 110))),
    "hecatonquiros-5dof": (
        (*_TRUNK, ((0, 0, 0.124), (("y", 90), ("x", 180)))),
        (-1, 1, 1, 1, 1),
        ((-110, 110),) * 5,
    ),
    "hecatonquiros-6dof": (
        (*_TRUNK, ((0, 0, 0.115), (("y", -90),)), ((0.04, 0, 0), (("y", 90),))),
        (-1, 1, 1, 1, 1, 1),
        ((-110, 110),) * 6,
    ),
}


def random_angles(arm, count: int = 20) -> np.ndarray:
    rng = np.random.default_rng(7)
    return rng.uniform(arm.limits[:, 0], arm.limits[:, 1], size=(count, arm.n))


# frames -----------------------------------------------------------------------------------------------------------


@everyone
def test_frames_hinges_and_limits_are_the_robot_files(arm):
    placements, hinges, limits = FILES[arm.name]
    for joint, (translation, turns), hinge, limit in zip(arm.joints, placements, hinges, limits, strict=True):
        rotation = np.eye(3)
        for axis, degrees in turns:  # each multiplies from the left
            rotation = so3_exp(np.radians(degrees) * np.eye(3)["xyz".index(axis)]) @ rotation
        np.testing.assert_allclose(joint.T_parent_joint, transform(rotation, translation), atol=1e-15)
        np.testing.assert_array_equal(joint.axis, (0, 0, hinge))
        np.testing.assert_allclose(joint.limits, np.radians(limit))


@pytest.mark.parametrize(
    ("arm", "offsets", "sideways"),
    [
        (HECATONQUIROS_4DOF, (0.02, 0.03, 0.03, 0.148, 0.06, 0.235), 0.0),
        (HECATONQUIROS_5DOF, (0.02, 0.03, 0.03, 0.148, 0.06, 0.124, 0.14), 0.0),
        (HECATONQUIROS_6DOF, (0.02, 0.03, 0.03, 0.148, 0.06, 0.115, 0.04, 0.12), 0.015),
    ],
)
def test_straight_arm_reaches_the_sum_of_its_offsets(arm, offsets, sideways):
    tool = arm.link_poses(np.zeros(arm.n))[-1]
    np.testing.assert_allclose(tool[:3, 3], (0.0, -sideways, sum(offsets)), atol=1e-15)
    np.testing.assert_allclose(tool[:3, 2], (0, 0, 1), atol=1e-15)  # approaches along the arm …
    np.testing.assert_allclose(tool[:3, 0], (0, 1, 0), atol=1e-15)  # … and closes along the hinges of joints 1 and 2


@everyone
def test_shoulder_leans_to_x_elbow_bends_back_and_yaw_turns_about_minus_z(arm):
    q = np.zeros(arm.n)
    q[1] = DOWN
    elbow = arm.link_poses(q)[2][:3, 3]
    np.testing.assert_allclose(elbow, (0.148, 0.0, 0.08), atol=1e-15)
    q[2] = -DOWN  # forearm along base z again
    tool = arm.link_poses(q)[-1]
    np.testing.assert_allclose(tool[:3, 2], (0, 0, 1), atol=1e-15)
    assert tool[0, 3] == pytest.approx(0.148, abs=1e-15)
    q[0] = -DOWN
    np.testing.assert_allclose(arm.link_poses(q)[2][:3, 3], (0.0, -0.148, 0.08), atol=1e-15)


@everyone
def test_poses_are_products_of_exponentials(arm):
    # Brockett's formula, from the axes at zero alone: T(q) = exp(ξ0 q0) … exp(ξn qn) T(0).
    rest = arm.link_poses(np.zeros(arm.n))
    screws = []
    for pose, joint in zip(rest[:-1], arm.joints, strict=True):
        axis = pose[:3, :3] @ joint.axis
        screws.append(np.concatenate([-np.cross(axis, pose[:3, 3]), axis]))
    for q in random_angles(arm):
        expected = rest[-1]
        for screw, angle in reversed(list(zip(screws, q, strict=True))):
            expected = se3_exp(screw * angle) @ expected
        np.testing.assert_allclose(arm.link_poses(q)[-1], expected, atol=1e-13)


def test_roll_pitch_roll_axes_of_the_six_joint_wrist_meet():
    for q in random_angles(HECATONQUIROS_6DOF):
        poses = HECATONQUIROS_6DOF.link_poses(q)
        center = poses[4][:3, 3]
        for i in (3, 5):
            offset = center - poses[i][:3, 3]
            assert np.linalg.norm(np.cross(offset, poses[i][:3, 2])) < 1e-14


def test_roll_of_the_four_joint_arm_turns_the_tool_in_place():
    q = HECATONQUIROS_4DOF.home.copy()
    before = HECATONQUIROS_4DOF.link_poses(q)[-1]
    q[3] += 1.0
    after = HECATONQUIROS_4DOF.link_poses(q)[-1]
    np.testing.assert_allclose(after[:3, 3], before[:3, 3], atol=1e-15)
    np.testing.assert_allclose(before[:3, :3].T @ after[:3, :3], so3_exp([0.0, 0.0, -1.0]), atol=1e-15)


@everyone
def test_home_looks_along_the_base_axis_from_the_front(arm):
    tool = arm.link_poses(arm.home)[-1]
    np.testing.assert_allclose(tool[:3, 2], (0, 0, 1), atol=1e-12)
    assert 0.10 < tool[0, 3] < 0.20 and 0.35 < tool[2, 3] < 0.50
    if arm.n > 4:
        assert abs(np.sin(arm.home[4])) > 0.5  # far from where the wrist's roll axes line up


@everyone
def test_stowed_arm_is_short(arm):
    def depth(q):
        return arm.link_poses(q)[:, 2, 3].max()

    assert depth(arm.stowed) < 0.55 * depth(np.zeros(arm.n))


# masses -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arm", "mass"), [(HECATONQUIROS_4DOF, 0.72), (HECATONQUIROS_5DOF, 0.665), (HECATONQUIROS_6DOF, 0.72)]
)
def test_masses_sum_to_the_arm(arm, mass):
    assert arm.total_mass == pytest.approx(mass, abs=1e-12)
    assert arm.total_mass == pytest.approx(arm.base.mass + sum(link.mass for link in arm.with_fingers()), abs=1e-12)
    assert arm.mass_properties(arm.home)[0] == pytest.approx(mass, abs=1e-12)


@everyone
def test_links_are_of_printed_plastic_and_servos(arm):
    for link in (arm.base, *arm.links):
        assert 0.05 < link.mass < 0.20
        gyration = np.sqrt(np.linalg.eigvalsh(link.inertia) / link.mass)  # within a part a few centimetres across
        assert gyration.min() > 0.005 and gyration.max() < 0.06
        reach = max(
            np.linalg.norm(shape.T_link_shape[:3, 3] - link.center_of_mass) - sum(shape.size) for shape in link.shapes
        )
        assert reach < 0.0  # the centre of mass is where the part is


@everyone
def test_fingers_close_about_the_tool(arm):
    opened, closed = arm.with_fingers()[-1], arm.with_fingers(0.0)[-1]
    assert opened.mass == pytest.approx(arm.links[-1].mass + 2 * arm.gripper.finger_mass, abs=1e-15)
    np.testing.assert_allclose(closed.center_of_mass, opened.center_of_mass, atol=1e-15)
    jaws, axis = arm.gripper.jaws, arm.T_last_tool[:3, 0]
    near = jaws.pad_depth + 0.5 * jaws.finger_thickness  # of a finger's middle from the tool frame when closed
    gained = 2 * arm.gripper.finger_mass * ((near + arm.gripper.travel) ** 2 - near**2)
    # Point masses on the closing axis add nothing about it, and m r² about the two others.
    np.testing.assert_allclose(opened.inertia - closed.inertia, gained * (np.eye(3) - np.outer(axis, axis)), atol=1e-15)


@everyone
def test_servos_hold_the_arm_everywhere_with_half_their_torque(arm):
    # Torque of joint i: what its axis feels of the weight of everything behind it, base z pointing down.
    for q in random_angles(arm, 200):
        poses = arm.link_poses(q)
        for i, joint in enumerate(arm.joints):
            axis = poses[i][:3, :3] @ joint.axis
            torque = 0.0
            for pose, link in list(zip(poses[:-1], arm.with_fingers(), strict=True))[i:]:
                center = pose[:3, :3] @ link.center_of_mass + pose[:3, 3]
                torque += axis @ np.cross(center - poses[i][:3, 3], (0, 0, 9.81 * link.mass))
            assert abs(torque) < 0.5 * joint.torque_limit


def test_servos_have_the_text_torque_and_two_of_them_lift_the_shoulder():
    assert all(j.torque_limit == pytest.approx(25 * 0.0980665) for j in HECATONQUIROS_4DOF.joints)
    limits = [j.torque_limit for j in HECATONQUIROS_6DOF.joints]
    np.testing.assert_allclose(limits, SERIAL_TORQUE * np.array([1, 2, 1, 1, 1, 1]))


# shapes -----------------------------------------------------------------------------------------------------------


def test_capsule_and_cylinder_span_their_ends():
    start, end = np.array([0.1, -0.2, 0.3]), np.array([0.1, 0.4, -0.5])
    for make in (Shape.capsule, Shape.cylinder):
        shape = make("s", start, end, 0.02)
        radius, half = shape.size
        T = shape.T_link_shape
        assert radius == 0.02
        np.testing.assert_allclose(T[:3, :3].T @ T[:3, :3], np.eye(3), atol=1e-14)
        assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)
        np.testing.assert_allclose(T[:3, 3] - half * T[:3, 2], start, atol=1e-15)
        np.testing.assert_allclose(T[:3, 3] + half * T[:3, 2], end, atol=1e-15)


def test_moved_shape_keeps_its_size():
    shape = Shape.box("s", (0.1, 0.0, 0.0), (0.1, 0.2, 0.3))
    moved = shape.moved(transform(so3_exp([0, 0, np.pi / 2]), (0.0, 0.0, 1.0)), "other")
    assert moved.name == "other" and moved.size == shape.size
    np.testing.assert_allclose(moved.T_link_shape[:3, 3], (0.0, 0.1, 1.0), atol=1e-15)


# bad input --------------------------------------------------------------------------------------------------------

JOINT = HECATONQUIROS_4DOF.joints[0]
LINK = HECATONQUIROS_4DOF.links[0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"axis": (0, 0, 2)}, "unit vector"),
        ({"axis": (0, 0, np.nan)}, "finite"),
        ({"axis": (0, 1)}, "shape"),
        ({"limits": (1.0, 1.0)}, "low < high"),
        ({"limits": (-np.inf, 1.0)}, "finite"),
        ({"torque_limit": 0.0}, "torque_limit"),
        ({"rate_limit": -1.0}, "rate_limit"),
        ({"armature": np.nan}, "armature"),
        ({"T_parent_joint": np.diag([1.0, 1.0, -1.0, 1.0])}, "reflection"),
        ({"T_parent_joint": 2 * np.eye(4)}, "T_parent_joint"),
    ],
)
def test_bad_joints_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        replace(JOINT, **change)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mass": 0.0}, "mass"),
        ({"inertia": np.zeros((3, 3))}, "principal moments"),
        ({"inertia": np.diag([1e-4, 1e-4, 3e-4])}, "principal moments"),
        ({"inertia": np.diag([-1e-4, 1e-4, 1e-4])}, "principal moments"),
        ({"inertia": np.diag([1e-4] * 3) + np.eye(3, k=1) * 1e-5}, "symmetric"),
        ({"center_of_mass": (0, 0)}, "center_of_mass"),
    ],
)
def test_bad_links_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        replace(LINK, **change)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"links": HECATONQUIROS_4DOF.links[:3]}, "one link per joint"),
        ({"joints": (), "links": ()}, "one link per joint"),
        ({"joints": (JOINT, *HECATONQUIROS_4DOF.joints[:3])}, "names"),
        ({"home": np.radians([0, 60, 0, 0])}, "home must lie within the joint limits"),
        ({"stowed": np.zeros(3)}, "stowed"),
        ({"T_last_tool": np.full((4, 4), np.nan)}, "T_last_tool"),
    ],
)
def test_bad_arms_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        replace(HECATONQUIROS_4DOF, **change)


@pytest.mark.parametrize("q", [np.zeros(3), np.zeros((1, 4)), (0, 0, 0, np.nan)])
def test_bad_angles_are_refused(q):
    with pytest.raises(ValueError, match="q"):
        HECATONQUIROS_4DOF.link_poses(q)


@pytest.mark.parametrize("width", [-1e-9, 0.11, np.nan])
def test_openings_the_jaws_do_not_have_are_refused(width):
    with pytest.raises(ValueError, match="width"):
        HECATONQUIROS_6DOF.with_fingers(width)


@pytest.mark.parametrize("field", ["jaw_speed", "stall_force", "stiffness", "damping", "finger_mass"])
def test_grippers_without_strength_are_refused(field):
    with pytest.raises(ValueError, match=field):
        WormGripper(GripperConfig(), **{field: 0.0})


@pytest.mark.parametrize(
    ("kind", "size", "message"),
    [("sphere", (0.1,), "kind"), ("box", (0.1, 0.1), "3 positive sizes"), ("capsule", (0.1, 0.0), "positive sizes")],
)
def test_bad_shapes_are_refused(kind, size, message):
    with pytest.raises(ValueError, match=message):
        Shape("s", kind, np.eye(4), size)
    with pytest.raises(ValueError, match="two different ends"):
        Shape.capsule("s", (0, 0, 0), (0, 0, 0), 0.1)


def test_arrays_cannot_be_written_to():
    own = np.eye(4)
    joint = replace(JOINT, T_parent_joint=own)
    own[0, 3] = 5.0
    assert joint.T_parent_joint[0, 3] == 0.0
    for array in (joint.T_parent_joint, joint.axis, LINK.inertia, HECATONQUIROS_4DOF.home):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
