"""Arms: poses and Jacobians against other descriptions and finite differences, URDFs read and refused, kernels."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio
import pytest
from scipy.spatial.transform import Rotation

from aerograsp_env.sim.arms.hecatonquiros import ARMS
from aerograsp_env.sim.arms.urdf import urdf
from aerograsp_env.spatial import inverse, so3_exp, so3_log, transform
from baselines.kinematics import Arm, condition_number, manipulability
from baselines.kinematics.chain import (
    bounded_step,
    forward_kernel,
    jacobian_kernel,
    pose_error_kernel,
    roll_kernel,
    solve_damped,
)
from baselines.kinematics.dls import least_singular_value
from baselines.kinematics.manipulability import singular_values


def any_arm(n: int, seed: int = 0) -> Arm:
    """Random placements and axes."""
    rng = np.random.default_rng(seed)
    axes = rng.standard_normal((n, 3))

    def pose(count: int) -> np.ndarray:
        return transform(Rotation.random(count, random_state=rng).as_matrix(), rng.normal(0, 0.2, (count, 3)))

    return Arm(
        placements=pose(n),
        axes=axes / np.linalg.norm(axes, axis=1, keepdims=True),
        limits=np.tile([-2.0, 2.5], (n, 1)),
        T_tool=pose(1)[0],
        T_base=pose(1)[0],
    )


def planar(*lengths: float) -> Arm:
    """Joints about z, links along x."""
    places = [np.eye(4)] + [transform(np.eye(3), [length, 0, 0]) for length in lengths]
    n = len(lengths)
    return Arm(np.array(places[:-1]), np.tile([0.0, 0.0, 1.0], (n, 1)), np.tile([-3.0, 3.0], (n, 1)), places[-1])


@pytest.fixture(scope="module", params=sorted(ARMS))
def config(request):
    return ARMS[request.param]


def configurations(arm: Arm, count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(arm.limits[:, 0], arm.limits[:, 1], (count, arm.n))


# poses --------------------------------------------------------------------------------------------


def test_poses_are_the_description_s(config):
    arm = Arm.from_config(config)
    q = configurations(arm, 50)
    expected = np.array([config.link_poses(row) for row in q])
    np.testing.assert_allclose(arm.link_poses(q), expected, atol=1e-14)
    np.testing.assert_allclose(arm.forward(q), expected[:, -1], atol=1e-14)
    np.testing.assert_array_equal(arm.limits, config.limits)
    assert arm.names == tuple(joint.name for joint in config.joints)
    assert arm.n == config.n


def test_named_arms():
    for arm, joints in ((Arm.hecatonquiros_4dof(), 4), (Arm.hecatonquiros_6dof(), 6)):
        q = configurations(arm, 3)
        assert arm.n == joints
        np.testing.assert_array_equal(arm.forward(q), Arm.from_config(ARMS[f"hecatonquiros-{joints}dof"]).forward(q))


def test_a_chain_multiplied_out():
    arm, q = any_arm(5), np.array([0.3, -1.0, 2.0, 0.7, -0.2])
    T = arm.T_base
    for placement, axis, angle in zip(arm.placements, arm.axes, q, strict=True):
        T = T @ placement @ transform(so3_exp(angle * axis), np.zeros(3))
    np.testing.assert_allclose(arm.forward(q), T @ arm.T_tool, atol=1e-14)


@pytest.mark.parametrize("axis", [[0, 0, 1], [0, 0, -1], [1, 0, 0], [0, -1, 0], [1e-9, 0, -1]])
def test_any_axis(axis):
    arm = Arm(np.eye(4)[None], np.array([axis], float), np.array([[-1.0, 1.0]]))
    np.testing.assert_allclose(arm.forward([0.7])[:3, :3], so3_exp(0.7 * np.array(axis)), atol=1e-15)


def test_leading_axes_and_another_base():
    arm = any_arm(4)
    q = configurations(arm, 6).reshape(2, 3, 4)
    T = arm.forward(q)
    assert (T.shape, arm.jacobian(q).shape) == ((2, 3, 4, 4), (2, 3, 6, 4))
    assert arm.link_poses(q).shape == (2, 3, 5, 4, 4)
    np.testing.assert_array_equal(T[1, 2], arm.forward(q[1, 2]))
    assert arm.forward(np.empty((0, 4))).shape == (0, 4, 4)
    moved = transform(so3_exp([0.2, 0.3, -1.0]), [1.0, 2.0, 3.0])
    np.testing.assert_allclose(inverse(moved) @ arm.at_base(moved).forward(q), inverse(arm.T_base) @ T, atol=1e-14)


def test_the_tool_stays_within_the_arm_s_length():
    arm = any_arm(5)
    T = arm.link_poses(configurations(arm, 500))
    reach = np.linalg.norm(T[:, -1, :3, 3] - T[:, 0, :3, 3], axis=1)
    assert reach.max() <= arm.length
    straight = planar(0.3, 0.2, 0.1)
    assert straight.length == pytest.approx(np.linalg.norm(straight.forward(np.zeros(3))[:3, 3]))


@pytest.mark.parametrize("arm", [any_arm(6), any_arm(7, 1), Arm.hecatonquiros_6dof(), Arm.hecatonquiros_4dof()])
def test_jacobian_is_the_finite_difference(arm):
    h = 1e-5
    for q in configurations(arm, 20, 3):
        expected = np.empty((6, arm.n))
        for i, step in enumerate(h * np.eye(arm.n)):
            ahead, behind = arm.forward(q + step), arm.forward(q - step)
            expected[:3, i] = (ahead[:3, 3] - behind[:3, 3]) / (2 * h)
            expected[3:, i] = so3_log(ahead[:3, :3] @ behind[:3, :3].T) / (2 * h)
        np.testing.assert_allclose(arm.jacobian(q), expected, atol=1e-7 / 10)


def test_arrays_cannot_be_written_to():
    arm = any_arm(3)
    for name in ("placements", "axes", "limits", "T_tool", "T_base", "chain"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(arm, name)[:] = 0.0


GOOD: dict[str, Any] = {
    "placements": np.tile(np.eye(4), (2, 1, 1)),
    "axes": np.tile([0.0, 0.0, 1.0], (2, 1)),
    "limits": np.tile([-1.0, 1.0], (2, 1)),
}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"placements": np.eye(4)}, "placements"),
        ({"placements": np.empty((0, 4, 4))}, "placements"),
        ({"placements": np.tile(np.diag([1.0, 1.0, -1.0, 1.0]), (2, 1, 1))}, "placements: expected det"),
        ({"axes": np.ones((2, 3))}, "axes: expected unit vectors"),
        ({"axes": np.ones((3, 3))}, "axes: expected shape"),
        ({"limits": np.array([[1.0, -1.0], [-1.0, 1.0]])}, "limits: expected lower < upper"),
        ({"limits": np.array([[-np.inf, 1.0], [-1.0, 1.0]])}, "limits: expected finite"),
        ({"T_tool": np.diag([1.0, 1.0, 2.0, 1.0])}, "T_tool: expected orthonormal"),
        ({"T_base": np.full((4, 4), np.nan)}, "T_base: expected finite"),
        ({"names": ("a",)}, "names: expected 2"),
        ({"names": ("a", "a")}, "names: expected 2"),
    ],
)
def test_bad_arms(changes, message):
    with pytest.raises(ValueError, match=message):
        Arm(**(GOOD | changes))


@pytest.mark.parametrize("q", [np.zeros(3), np.zeros((2, 3)), 0.0, [0.0, np.nan]])
def test_bad_angles(q):
    arm = Arm(**GOOD)
    for call in (arm.forward, arm.jacobian, arm.link_poses, arm.within_limits):
        with pytest.raises(ValueError, match="q: expected"):
            call(q)


# URDF ---------------------------------------------------------------------------------------------


def test_urdf_is_read_as_pinocchio_reads_it(config, tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(urdf(config))
    arm = Arm.from_urdf(path, tip="tool")
    model = pinocchio.buildModelFromUrdf(str(path))
    data, frame = model.createData(), model.getFrameId("tool")
    for q in configurations(arm, 20):
        pinocchio.forwardKinematics(model, data, q)
        pinocchio.updateFramePlacements(model, data)
        np.testing.assert_allclose(arm.forward(q), data.oMf[frame].homogeneous, atol=1e-12)
        np.testing.assert_allclose(arm.forward(q), config.link_poses(q)[-1], atol=1e-12)
    np.testing.assert_allclose(arm.limits, config.limits, atol=1e-15)
    assert arm.names == tuple(joint.name for joint in config.joints)


INERTIAL = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
HINGE = '<origin xyz="0 0 0.1" rpy="0 0 0.5"/><axis xyz="0 2 0"/><limit lower="-1" upper="2" effort="1" velocity="1"/>'


def robot(inertial=INERTIAL, joint=HINGE, kind="revolute", extra="", parent="base") -> str:
    return (
        f'<robot name="r"><link name="base"/><link name="arm">{inertial}</link><link name="hand"/>'
        f'<joint name="hinge" type="{kind}"><parent link="{parent}"/><child link="arm"/>{joint}</joint>'
        '<joint name="weld" type="fixed"><parent link="arm"/><child link="hand"/><origin xyz="0.3 0 0"/></joint>'
        f"{extra}</robot>"
    )


def read(tmp_path, text, **links):
    path = tmp_path / "robot.urdf"
    path.write_text(text)
    return Arm.from_urdf(path, **links)


def test_a_small_urdf(tmp_path):
    arm = read(tmp_path, robot())
    assert arm.names == ("hinge",)
    np.testing.assert_array_equal(arm.limits, [[-1.0, 2.0]])
    expected = transform(so3_exp([0, 0, 0.5]) @ so3_exp([0, 0.7, 0]), [0, 0, 0.1]) @ transform(np.eye(3), [0.3, 0, 0])
    np.testing.assert_allclose(arm.forward([0.7]), expected, atol=1e-15)
    np.testing.assert_allclose(read(tmp_path, robot(), tip="arm").forward([0.7])[:3, 3], [0, 0, 0.1], atol=1e-15)
    np.testing.assert_allclose(read(tmp_path, robot(kind="continuous")).limits, [[-np.pi, np.pi]])


@pytest.mark.parametrize(
    ("text", "links", "message"),
    [
        ("no XML", {}, "not XML"),
        ("<sdf/>", {}, "expected a URDF's <robot>"),
        (robot(), {"base": "bas"}, "base: .* no link 'bas'; there are: base, arm, hand"),
        (robot(), {"tip": "tool"}, "tip: .* no link 'tool'"),
        (robot(), {"base": "hand", "tip": "base"}, "'base' is not carried by 'hand'"),
        (robot(), {"base": "arm", "tip": "hand"}, "expected a joint that turns"),
        (robot(parent="missing"), {}, "unknown parent link 'missing'"),
        (robot(kind="prismatic"), {}, "got 'prismatic'"),
        (robot(kind="twisty"), {}, "got 'twisty'"),
        (robot(joint=HINGE + '<mimic joint="weld"/>'), {}, "mimics"),
        (robot(joint='<axis xyz="0 0 0"/><limit lower="-1" upper="1"/>'), {}, "axis of positive length"),
        (robot(joint=""), {}, "needs <limit"),
        (robot(joint='<limit lower="1" upper="-1"/>'), {}, "lower < upper"),
        (robot(joint='<origin xyz="0 ${pi} 0"/>' + HINGE[40:]), {}, "expand xacro first"),
        (robot(joint='<origin xyz="0 0"/>'), {}, "expected 3 finite numbers in xyz"),
        (robot(joint='<origin xyz="0 0 nan"/>'), {}, "finite numbers in xyz"),
        (robot(inertial=""), {}, "link 'arm' moves, but has zero mass or inertia"),
        (robot(inertial=INERTIAL.replace('mass value="1"', 'mass value="0"')), {}, "zero mass or inertia"),
        (robot(inertial=INERTIAL.replace('izz="1"', 'izz="0"')), {}, "zero mass or inertia"),
        (robot(inertial=INERTIAL.replace('mass value="1"', 'mass value="-1"')), {}, "negative mass"),
        (robot(extra='<link name="spare"/>'), {}, "expected one root link"),
        (
            robot(
                extra='<link name="eye"/><joint name="e" type="fixed"><parent link="arm"/><child link="eye"/></joint>'
            ),
            {},
            r"branches from 'base' to \['hand', 'eye'\]",
        ),
        (
            robot(extra='<joint name="loop" type="fixed"><parent link="base"/><child link="hand"/></joint>'),
            {},
            "two parents",
        ),
        (
            robot(extra='<joint name="loop" type="fixed"><parent link="hand"/><child link="base"/></joint>'),
            {},
            "expected one root link",
        ),
        (robot().replace('<link name="hand"/>', "<link/>"), {}, "has no name"),
    ],
)
def test_urdfs_refused(tmp_path, text, links, message):
    with pytest.raises(ValueError, match=message):
        read(tmp_path, text, **links)


def test_inertia_may_lie_in_what_is_fixed_to_a_link(tmp_path):
    text = robot(inertial="").replace('<link name="hand"/>', f'<link name="hand">{INERTIAL}</link>')
    assert read(tmp_path, text).n == 1


def test_meshes_must_exist(tmp_path):
    text = robot(inertial=INERTIAL + '<visual><geometry><mesh filename="{}"/></geometry></visual>')
    for name in ("arm.stl", "package://robots/meshes/arm.stl", f"file://{tmp_path}/nowhere.stl", "http://a/b.stl", ""):
        with pytest.raises(FileNotFoundError, match=r"robot\.urdf: 1 meshes are missing"):
            read(tmp_path, text.format(name))
    folder = tmp_path / "robots"
    (folder / "meshes").mkdir(parents=True)
    (folder / "meshes" / "arm.stl").touch()
    for name in ("meshes/arm.stl", "package://robots/meshes/arm.stl", f"file://{folder}/meshes/arm.stl"):
        assert read(folder, text.format(name)).n == 1
    with pytest.raises(FileNotFoundError, match="no such file"):
        Arm.from_urdf(tmp_path / "absent.urdf")


# compiled parts -----------------------------------------------------------------------------------


def test_kernels_are_the_methods():
    arm = any_arm(6)
    q, tool, jacobian = configurations(arm, 1)[0], np.empty((3, 4)), np.empty((6, 6))
    forward_kernel(arm.chain, q, tool)
    np.testing.assert_array_equal(tool, arm.forward(q)[:3])
    jacobian_kernel(arm.chain, q, tool, jacobian)
    np.testing.assert_array_equal(jacobian, arm.jacobian(q))


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-7, 1e-3, 1.0, 3.0, np.pi - 1e-7, np.pi - 1e-9, np.pi])
def test_pose_error_is_the_logarithm(angle):
    rng = np.random.default_rng(4)
    for axis in [*np.eye(3), *-np.eye(3), *rng.standard_normal((10, 3))]:
        rotvec = angle * axis / np.linalg.norm(axis)
        tool = transform(Rotation.random(random_state=rng).as_matrix(), rng.standard_normal(3))
        target = transform(so3_exp(rotvec) @ tool[:3, :3], rng.standard_normal(3))
        error = np.empty(6)
        pose_error_kernel(tool, target, error)
        np.testing.assert_allclose(error[:3], target[:3, 3] - tool[:3, 3])
        assert np.linalg.norm(error[3:]) == pytest.approx(angle, abs=1e-12 if angle < 3.0 else 1e-7)
        np.testing.assert_allclose(so3_exp(error[3:]), so3_exp(rotvec), atol=3e-7 if angle > 3.0 else 1e-14)


def test_roll_is_what_remains_after_aligning_the_approach_axes():
    rng = np.random.default_rng(5)
    for roll, tilt, about in rng.uniform([-3, 0, -3], [3, 3, 3], (50, 3)):
        R = Rotation.random(random_state=rng).as_matrix()
        swing = so3_exp(tilt * np.array([np.cos(about), np.sin(about), 0.0]))
        target = R @ swing @ so3_exp([0, 0, roll])
        row = np.empty(3)
        assert roll_kernel(R, target, row) == pytest.approx(roll, abs=1e-9)
        h, numbers = 1e-6, np.empty(3)
        slope = [
            (roll_kernel(so3_exp(-h * e) @ R, target, numbers) - roll_kernel(so3_exp(h * e) @ R, target, numbers))
            / 2
            / h
            for e in np.eye(3)
        ]
        np.testing.assert_allclose(row, slope, atol=1e-6 * max(1.0, np.abs(row).max() ** 2))


@pytest.mark.parametrize("shape", [(6, 6), (6, 4), (6, 7), (3, 6), (4, 4), (1, 1)])
def test_least_singular_value(shape):
    rng, weights = np.random.default_rng(6), np.array([1.0, 1.0, 1.0, 0.2, 0.2, 0.2])
    rows = shape[0]
    for k in range(20):
        jacobian = np.zeros((6, shape[1]))
        jacobian[:rows] = rng.standard_normal(shape)
        if k == 0:
            jacobian[:, 0] = jacobian[:, -1]
        expected = np.linalg.svd(weights[:rows, None] * jacobian[:rows], compute_uv=False)[-1]
        assert least_singular_value(jacobian, weights, rows) == pytest.approx(expected, rel=1e-9, abs=1e-7)


def test_damped_solution_is_numpy_s():
    rng = np.random.default_rng(7)
    J = rng.standard_normal((6, 6))
    gram, gradient, step = J.T @ J, rng.standard_normal(6), np.empty(6)
    for free in (np.ones(6, bool), np.array([True, False, True, True, False, True])):
        solve_damped(gram, gradient, 0.3, free, step)
        expected = np.zeros(6)
        expected[free] = np.linalg.solve(gram[np.ix_(free, free)] + 0.3 * np.eye(free.sum()), gradient[free])
        np.testing.assert_allclose(step, expected, atol=1e-12)


def test_bounded_steps_keep_their_direction_and_the_limits():
    rng = np.random.default_rng(8)
    limits, caps = np.tile([-1.0, 1.0], (4, 1)), np.array([0.1, 0.2, 0.3, 0.4])
    blocked = 0
    for _ in range(300):
        J = rng.standard_normal((6, 4))
        gram, gradient = J.T @ J, 3.0 * rng.standard_normal(4)
        q = np.clip(rng.uniform(-1.5, 1.5, 4), -1.0, 1.0)
        after = np.empty(4)
        bounded_step(gram, gradient, 0.01, q, limits, caps, after)
        step = after - q
        assert np.all(np.abs(step) <= caps + 1e-15) and np.all(np.abs(after) <= 1.0)
        assert gradient @ step >= 0.0  # never away from the target
        held = (np.abs(q) == 1.0) & (step == 0.0)
        blocked += held.sum()
        free = ~held
        full = np.linalg.solve(gram[np.ix_(free, free)] + 0.01 * np.eye(free.sum()), gradient[free])
        inside = (np.abs(after) < 1.0)[free]
        shrink = min(1.0, *(caps[free] / np.abs(full)))
        np.testing.assert_allclose(step[free][inside], shrink * full[inside], atol=1e-12)
    assert blocked > 50


def test_a_joint_beyond_its_limit_comes_back_without_a_jump():
    q, after = np.array([1.5]), np.empty(1)
    bounded_step(np.eye(1), np.array([-1.0]), 0.0, q, np.array([[-1.0, 1.0]]), np.array([0.1]), after)
    assert after[0] == pytest.approx(1.4)
    bounded_step(np.eye(1), np.array([1.0]), 0.0, q, np.array([[-1.0, 1.0]]), np.array([0.1]), after)
    assert after[0] == 1.5


# manipulability -----------------------------------------------------------------------------------


def test_manipulability_of_the_planar_arm():
    arm = planar(0.4, 0.3)
    bend = np.linspace(-2.5, 2.5, 11)
    q = np.stack([np.full(11, 0.3), bend], axis=1)
    J = arm.jacobian(q)[:, :2]
    np.testing.assert_allclose(np.abs(np.linalg.det(J)), 0.4 * 0.3 * np.abs(np.sin(bend)), atol=1e-15)
    np.testing.assert_allclose(manipulability(arm, q, "position"), 0.12 * np.abs(np.sin(bend)), atol=1e-12)
    # isotropic: Salisbury & Craig's arm, links in the ratio √2 : 1 at ± 135°
    isotropic = planar(0.3 * np.sqrt(2.0), 0.3)
    assert condition_number(isotropic, [0.0, np.radians(135.0)], "position") == pytest.approx(1.0)
    assert condition_number(isotropic, [0.0, 0.0], "position") > 1e12


def test_manipulability_of_six_joints():
    arm = Arm.hecatonquiros_6dof()
    q = configurations(arm, 20)
    np.testing.assert_allclose(manipulability(arm, q), np.abs(np.linalg.det(arm.jacobian(q))), rtol=1e-9)
    straight = np.zeros(6)
    assert manipulability(arm, straight) < 1e-12
    assert singular_values(arm, q, "rotation", 1.0).shape == (20, 3)
    assert np.all(condition_number(arm, q) >= 1.0)
    with pytest.raises(ValueError, match="part: expected one of pose, position, rotation"):
        manipulability(arm, straight, "twist")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="radian: expected a positive"):
        condition_number(arm, straight, radian=0.0)
