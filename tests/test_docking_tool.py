"""The docking tool's kinematics against matrix products, finite differences and brute force."""

import numpy as np
import pytest

from baselines.kinematics import DockingTool, Unreachable, level_pose

LENGTHS = (0.071, 0.105, 0.155, 0.07, 0.075)
STRAIGHT = DockingTool()
MOUNTED = DockingTool(joint_centers=tuple(np.deg2rad([0.0, -35.0, 95.0, 30.0, 0.0])))
ODD = DockingTool(joint_centers=(3.0, -0.4, 1.2, 0.5, -2.9), lengths=(0.05, 0.2, 0.12, 0.09, 0.11))
TOOLS = pytest.mark.parametrize("tool", [STRAIGHT, MOUNTED, ODD], ids=["straight", "mounted", "odd"])
UP = pytest.mark.parametrize("up", [True, False])


def rotation(axis, angle):
    c, s = np.cos(angle), np.sin(angle)
    T = np.eye(4)
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    T[i, i], T[i, j], T[j, i], T[j, j] = c, -s, s, c
    return T


def translation(x, y, z):
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def chain(q, lengths=LENGTHS):
    """Thesis section 5.4.1 as a product of matrices, translations along the links."""
    T = rotation("z", q[0]) @ translation(0, 0, lengths[0])
    for i in (1, 2, 3):
        T = T @ rotation("x", q[i]) @ translation(0, 0, lengths[i])
    return T @ rotation("y", q[4]) @ translation(0, lengths[4], 0)


def random_q(tool, n, seed=0):
    return np.random.default_rng(seed).uniform(*tool.limits.T, size=(n, 5))


def level_q(tool, n, up, seed=0):
    """Random joints within limits whose φ is ± 90° to the last bit that the sum allows."""
    q = random_q(tool, 400 * n, seed)
    q[:, 3] = (1 if up else -1) * np.pi / 2 - q[:, 1] - q[:, 2]
    return q[(np.abs(q - tool.joint_centers) < np.deg2rad(75)).all(axis=1)][:n]


def test_forward_at_known_angles():
    T = STRAIGHT.forward(np.zeros(5))
    np.testing.assert_allclose(T, translation(0, 0.075, 0.071 + 0.105 + 0.155 + 0.07), atol=1e-15)
    # Elbow at a right angle, tip link up again: level, y axis up.
    T = STRAIGHT.forward(np.deg2rad([0, 0, 90, 0, 0]))
    np.testing.assert_allclose(T[:3, 3], [0, -0.155 - 0.07, 0.071 + 0.105 + 0.075], atol=1e-15)
    np.testing.assert_allclose(T[:3, 1], [0, 0, 1], atol=1e-15)


@TOOLS
def test_forward_equals_the_product_of_matrices(tool):
    q = random_q(tool, 60).reshape(3, 4, 5, 5)
    T = tool.forward(q)
    assert T.shape == (3, 4, 5, 4, 4)
    for index in np.ndindex(3, 4, 5):
        np.testing.assert_allclose(T[index], chain(q[index], tool.lengths), atol=1e-14)


@TOOLS
def test_jacobian_equals_finite_differences(tool):
    h = 1e-6
    for q in random_q(tool, 50, seed=1):
        J = tool.jacobian(q)
        assert J.shape == (6, 5)
        for i, e in enumerate(np.eye(5)):
            above, below = tool.forward(q + h * e), tool.forward(q - h * e)
            np.testing.assert_allclose(J[:3, i], (above[:3, 3] - below[:3, 3]) / (2 * h), atol=1e-9)
            W = (above[:3, :3] - below[:3, :3]) / (2 * h) @ tool.forward(q)[:3, :3].T  # [ω]×, in the base's axes
            np.testing.assert_allclose(J[3:, i], [W[2, 1], W[0, 2], W[1, 0]], atol=1e-9)
    batch = random_q(tool, 6, seed=2).reshape(2, 3, 5)
    np.testing.assert_array_equal(tool.jacobian(batch)[1, 2], tool.jacobian(batch[1, 2]))


@TOOLS
def test_forward_undoes_inverse_within_limits(tool):
    q = random_q(tool, 1000, seed=3)
    T = tool.forward(q)
    found = tool.inverse(T)
    np.testing.assert_allclose(tool.forward(found), T, atol=1e-12)
    assert ((found >= tool.limits[:, 0]) & (found <= tool.limits[:, 1])).all()
    # Of all branches the best: never worse than the angles the pose was made from.
    assert (tool.quality(found) >= tool.quality(q) - 1e-9).all()
    np.testing.assert_allclose(tool.inverse(T[17]), found[17], atol=1e-12)


def test_inverse_recovers_angles_where_the_other_branches_are_beyond_the_limits():
    q = MOUNTED.joint_centers + 0.2 * (random_q(MOUNTED, 300, seed=4) - MOUNTED.joint_centers)
    np.testing.assert_allclose(MOUNTED.inverse(MOUNTED.forward(q)), q, atol=1e-9)


@pytest.mark.parametrize("tool", [STRAIGHT, MOUNTED], ids=["straight", "mounted"])
@UP
def test_inverse_of_level_poses(tool, up):
    """θ1 + θ2 + θ3 = ± 90°, where the tip's rotation does not tell θ0 from θ4 and its position must."""
    q = level_q(tool, 200, up)
    assert len(q) == 200
    T = tool.forward(q)
    np.testing.assert_allclose(T[:, 2, 1], 1.0 if up else -1.0, atol=1e-12)
    np.testing.assert_allclose(tool.forward(tool.inverse(T)), T, atol=1e-9)


@UP
def test_inverse_is_well_conditioned_near_level_poses(up):
    for tilt in 10.0 ** np.arange(-16, -2):
        q = level_q(STRAIGHT, 20, up, seed=5)
        q[:, 2] += tilt
        T = STRAIGHT.forward(q)
        np.testing.assert_allclose(STRAIGHT.forward(STRAIGHT.inverse(T)), T, atol=1e-9)


@UP
def test_free_base_joint_is_split_between_the_two_ends(up):
    """Level with the tip over the base, only θ0 ± θ4 is given: both then stand equally far from their centres."""
    tool = DockingTool(joint_centers=(0.2, -1.0 if up else 1.0, 1.8 if up else -1.8, 0.5 if up else -0.5, -0.3))
    sense = 1.0 if up else -1.0
    heading = 0.5
    T = level_pose([0.0, 0.0, 0.26 if up else 0.11], heading, up)
    q = tool.inverse(T)
    np.testing.assert_allclose(tool.forward(q), T, atol=1e-12)
    assert q[0] + sense * q[4] == pytest.approx(heading)
    assert q[0] - 0.2 == pytest.approx(sense * (q[4] + 0.3))
    # Hardly off that pose the answer is another, but still an answer.
    for offset in 10.0 ** np.arange(-12, -3):
        near = level_pose([0.3 * offset, -offset, 0.26 if up else 0.11], heading, up)
        near[:3, :3] = near[:3, :3] @ rotation("y", 0.1)[:3, :3]
        np.testing.assert_allclose(tool.forward(tool.inverse(near)), near, atol=1.1e-6)


def test_noise_below_the_tolerance_is_met():
    rng = np.random.default_rng(6)
    T = STRAIGHT.forward(np.concatenate([random_q(STRAIGHT, 300), level_q(STRAIGHT, 100, True)]))
    T[:, :3, 3] += rng.uniform(-1e-8, 1e-8, size=(400, 3))
    T[:, :3, :3] += rng.uniform(-1e-8, 1e-8, size=(400, 3, 3))
    solution = STRAIGHT.solve(T)
    assert solution.reachable.mean() > 0.99  # the rest were at a limit
    assert solution.position_error[solution.reachable].max() < 1e-6
    assert solution.orientation_error[solution.reachable].max() < 1e-6


def test_angles_come_within_half_a_turn_of_their_centres():
    turned = DockingTool(joint_centers=tuple(np.array(MOUNTED.joint_centers) + 2 * np.pi * np.array([1, -2, 0, 3, 1])))
    q = random_q(turned, 100, seed=7)
    found = turned.inverse(turned.forward(q))
    assert (np.abs(found - turned.joint_centers) <= np.deg2rad(75)).all()
    plain = MOUNTED.inverse(MOUNTED.forward(q))
    np.testing.assert_allclose(turned.quality(found), MOUNTED.quality(plain), atol=1e-9)


def test_limits_are_75_degrees_either_side():
    np.testing.assert_allclose(np.rad2deg(MOUNTED.limits), [[-75, 75], [-110, 40], [20, 170], [-45, 105], [-75, 75]])
    for side in (0, 1):
        T = MOUNTED.forward(MOUNTED.limits[:, side])
        np.testing.assert_allclose(MOUNTED.forward(MOUNTED.inverse(T)), T, atol=1e-9)


def test_quality_is_one_at_the_centres_and_zero_at_every_limit():
    assert MOUNTED.quality(MOUNTED.joint_centers) == 1.0
    for joint in range(5):
        for side in (0, 1):
            q = np.array(MOUNTED.joint_centers)
            q[joint] = MOUNTED.limits[joint, side]
            assert MOUNTED.quality(q) == pytest.approx(0.0, abs=1e-15)
            q[joint] += 0.3 * (2 * side - 1)
            assert MOUNTED.quality(q) == 0.0
    np.testing.assert_allclose(STRAIGHT.quality(np.deg2rad([15, -15, 37.5, 0, -60])), 0.8 * 0.8 * 0.5 * 0.2)
    q = random_q(MOUNTED, 24).reshape(2, 3, 4, 5)
    assert MOUNTED.quality(q).shape == (2, 3, 4)
    assert ((MOUNTED.quality(q) >= 0) & (MOUNTED.quality(q) <= 1)).all()


def test_too_far_is_unreachable_by_the_missing_distance():
    with pytest.raises(Unreachable, match="closest pose is off") as caught:
        MOUNTED.inverse(level_pose([0.0, -1.07, 0.071 + 0.075]))
    assert caught.value.position_error == pytest.approx(1.07 - 0.07 - 0.105 - 0.155)
    assert caught.value.orientation_error == pytest.approx(0.0, abs=1e-12)
    assert isinstance(caught.value, ValueError)


def test_lateral_tilt_is_what_five_joints_cannot_do():
    T = MOUNTED.forward(np.deg2rad([0, -35, 95, 30, 0]))
    tilted = T.copy()
    tilted[:3, :3] = rotation("y", 0.1)[:3, :3] @ T[:3, :3]  # about y', across the axis of joints 1–3
    with pytest.raises(Unreachable) as caught:
        MOUNTED.inverse(tilted)
    assert 0.05 < caught.value.orientation_error < 0.1 + 1e-9
    q = MOUNTED.inverse(tilted, tolerance=0.11)
    np.testing.assert_allclose(MOUNTED.forward(q)[:3, 3], T[:3, 3], atol=1e-9)


def test_a_pose_beyond_the_limits_is_unreachable_by_the_excess():
    q = MOUNTED.joint_centers + np.deg2rad([10, 10, -10, 5, 100])
    with pytest.raises(Unreachable, match="beyond its limit") as caught:
        MOUNTED.inverse(MOUNTED.forward(q))
    assert caught.value.limit_excess == pytest.approx(np.deg2rad(25))
    assert caught.value.position_error < 1e-9
    wide = DockingTool(joint_centers=tuple(np.array(MOUNTED.joint_centers) + [0, 0, 0, 0, 1.0]))
    np.testing.assert_allclose(wide.inverse(MOUNTED.forward(q)), q, atol=1e-9)


def test_solve_marks_what_inverse_raises():
    T = MOUNTED.forward(random_q(MOUNTED, 6)).reshape(2, 3, 4, 4)
    T[1, 1, :3, 3] += 5.0
    solution = MOUNTED.solve(T)
    np.testing.assert_array_equal(solution.reachable, [[True, True, True], [True, False, True]])
    assert np.isnan(solution.q[1, 1]).all()
    assert solution.quality[1, 1] == 0.0
    np.testing.assert_allclose(MOUNTED.forward(solution.q[0]), T[0], atol=1e-9)
    with pytest.raises(Unreachable, match=r"index \(1, 1\)"):
        MOUNTED.inverse(T)
    assert MOUNTED.solve(np.empty((0, 4, 4))).q.shape == (0, 5)


@UP
def test_workspace_quality_is_that_of_the_inverse(up):
    grid = MOUNTED.workspace(0.03, heading=0.2, up=up)
    assert np.isfinite(grid.quality).all()
    assert grid.quality.shape == (grid.x.size, grid.y.size, grid.z.size)
    for border in (grid.quality[[0, -1]], grid.quality[:, [0, -1]], grid.quality[:, :, [0, -1]]):
        assert (border == 0.0).all()
    rng = np.random.default_rng(8)
    cells = [*np.argwhere(grid.quality > 0)[::40], *rng.integers(0, grid.quality.shape, size=(30, 3))]
    for i, j, k in cells:
        T = level_pose([grid.x[i], grid.y[j], grid.z[k]], 0.2, up)
        np.testing.assert_allclose(T[:3, 1], [0, 0, 1 if up else -1])
        if grid.quality[i, j, k] > 0:
            assert MOUNTED.quality(MOUNTED.inverse(T)) == pytest.approx(grid.quality[i, j, k], abs=1e-12)
        else:
            solution = MOUNTED.solve(T)
            assert not solution.reachable or MOUNTED.quality(solution.q) < 1e-9


def test_workspace_is_symmetric_and_turns_with_its_base():
    grid = MOUNTED.workspace(0.03)
    np.testing.assert_allclose(grid.quality, grid.quality[::-1], atol=1e-12)
    np.testing.assert_allclose(grid.x, -grid.x[::-1], atol=1e-12)
    turn = 0.7
    turned = DockingTool(joint_centers=(turn, *MOUNTED.joint_centers[1:]))
    p = np.array([0.05, -0.18, 0.26])
    quality = MOUNTED.solve(level_pose(p)).quality
    assert quality > 0.1
    assert turned.solve(level_pose(rotation("z", turn)[:3, :3] @ p, turn)).quality == pytest.approx(quality)


def test_workspace_bounds_are_kept():
    grid = MOUNTED.workspace(0.01, bounds=[[-0.02, 0.02], [-0.2, -0.1], [0.2, 0.305]])
    assert grid.quality.shape == (5, 11, 11)
    np.testing.assert_allclose([grid.x[0], grid.x[-1], grid.y[0], grid.z[0], grid.z[-1]], [-0.02, 0.02, -0.2, 0.2, 0.3])


@pytest.mark.parametrize("radius", [0.03, (0.02, 0.03, 0.01)], ids=["ball", "box"])
def test_best_set_point_equals_a_search_by_hand(radius):
    center, step = np.array([0.01, -0.17, 0.27]), 0.01
    chosen = MOUNTED.best_set_point(center, radius, search=0.02, resolution=step)
    k = np.stack(np.meshgrid(*[np.arange(-3, 4)] * 3, indexing="ij"), axis=-1).reshape(-1, 3) * step
    extent = np.broadcast_to(radius, 3)
    inside = (
        np.linalg.norm(k, axis=1) <= 0.03 + 1e-9 if np.ndim(radius) == 0 else (np.abs(k) <= extent + 1e-9).all(axis=1)
    )
    candidates = center + k[(np.abs(k) <= 0.02 + 1e-9).all(axis=1)]
    worst = MOUNTED.solve(level_pose(candidates[:, None] + k[inside])).quality.min(axis=1)
    assert chosen.worst_quality == pytest.approx(worst.max(), abs=1e-12)
    at = np.argmin(np.linalg.norm(candidates - chosen.position, axis=1))
    np.testing.assert_allclose(chosen.position, candidates[at], atol=1e-12)
    assert worst[at] == pytest.approx(worst.max(), abs=1e-12)
    assert chosen.quality == pytest.approx(float(MOUNTED.solve(level_pose(chosen.position)).quality))
    assert chosen.quality >= chosen.worst_quality


def test_mounting_the_ranges_about_the_docked_pose_is_what_makes_room():
    chosen = MOUNTED.best_set_point(radius=0.05, resolution=0.02)
    assert chosen.worst_quality > 0.2
    assert chosen.position[0] == pytest.approx(0.0)
    with pytest.raises(ValueError, match="radius"):
        STRAIGHT.best_set_point(radius=0.05, resolution=0.02)
    with pytest.raises(ValueError, match="radius"):
        MOUNTED.best_set_point(radius=50.0, resolution=0.02)
    assert STRAIGHT.best_set_point(radius=0.01, resolution=0.02).worst_quality > 0


@pytest.mark.parametrize(
    ("T", "message"),
    [
        (np.eye(3), "shape"),
        (np.full((4, 4), np.nan), "finite"),
        (np.diag([1.0, 1.0, -1.0, 1.0]), "det"),
        (np.diag([2.0, 2.0, 2.0, 1.0]), "orthonormal"),
        (np.eye(4) + np.eye(4)[[3, 1, 2, 0]] * [0.5, 0, 0, 0], "last row"),
    ],
)
def test_what_is_no_rigid_transform_is_refused(T, message):
    with pytest.raises(ValueError, match=message) as caught:
        MOUNTED.inverse(T)
    assert not isinstance(caught.value, Unreachable)


def test_bad_arguments_are_refused_by_name():
    for function in (MOUNTED.forward, MOUNTED.jacobian, MOUNTED.quality):
        with pytest.raises(ValueError, match="q: expected"):
            function(np.zeros(4))
        with pytest.raises(ValueError, match="q: expected"):
            function([0, 0, np.nan, 0, 0])
    for arguments, name in (
        ({"joint_centers": (0, 0, 0)}, "joint_centers"),
        ({"joint_centers": (0, 0, 0, 0, np.inf)}, "joint_centers"),
        ({"joint_centers": np.zeros((2, 5))}, "joint_centers"),
        ({"lengths": (0.1, 0.1, 0.0, 0.1, 0.1)}, "lengths"),
    ):
        with pytest.raises(ValueError, match=name):
            DockingTool(**arguments)
    for tolerance in (0.0, -1.0, np.nan):
        with pytest.raises(ValueError, match="tolerance"):
            MOUNTED.inverse(np.eye(4), tolerance)
    for resolution in (0.0, -0.1, np.nan, 1e-5):
        with pytest.raises(ValueError, match="resolution"):
            MOUNTED.workspace(resolution)
        with pytest.raises(ValueError, match="resolution"):
            MOUNTED.best_set_point(resolution=resolution)
    with pytest.raises(ValueError, match="bounds"):
        MOUNTED.workspace(bounds=[[0.1, 0.0], [0, 1], [0, 1]])
    with pytest.raises(ValueError, match="heading"):
        MOUNTED.workspace(heading=np.nan)
    with pytest.raises(ValueError, match="radius"):
        MOUNTED.best_set_point(radius=-0.1)
    with pytest.raises(ValueError, match="center"):
        MOUNTED.best_set_point(center=[0.0, 1.0])
    with pytest.raises(ValueError, match="search"):
        MOUNTED.best_set_point(search=0.1)
    with pytest.raises(ValueError, match="position"):
        level_pose([0.0, 1.0])


def test_tools_are_values():
    assert DockingTool(joint_centers=np.zeros(5)) == STRAIGHT
    assert hash(DockingTool()) == hash(STRAIGHT)
    with pytest.raises(AttributeError):
        STRAIGHT.lengths = LENGTHS
