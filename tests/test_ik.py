"""Inverse kinematics: reachable targets met, unreachable ones said so, closed forms complete, servo steps bounded."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aerograsp_env.spatial import so3_exp, so3_log, transform
from agents import ik_speed
from baselines.kinematics import Arm, branches_4dof, branches_6dof, servo_step, solve_ik
from baselines.kinematics.dls import dls_step, least_singular_value, weights
from baselines.kinematics.search import search

SIX, FOUR = Arm.hecatonquiros_6dof(), Arm.hecatonquiros_4dof()
TASKS = ("pose", "position", "position+roll")


def configurations(arm: Arm, count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(arm.limits[:, 0], arm.limits[:, 1], (count, arm.n))


def roll_left(R: np.ndarray, R_target: np.ndarray) -> float:
    """The turn about z that remains between two rotations once the z axes are aligned by the smallest rotation."""
    z, goal = R[:, 2], R_target[:, 2]
    axis = np.cross(z, goal)
    sine = np.linalg.norm(axis)
    swing = so3_exp(axis / max(sine, 1e-15) * math.atan2(sine, z @ goal))
    return float(so3_log((swing @ R).T @ R_target)[2])


def errors(arm: Arm, q: np.ndarray, target: np.ndarray, task: str) -> tuple[float, float]:
    T = arm.forward(q)
    angle = 0.0
    if task == "pose":
        angle = float(np.linalg.norm(so3_log(T[:3, :3].T @ target[:3, :3])))
    elif task == "position+roll":
        angle = abs(roll_left(T[:3, :3], target[:3, :3]))
    return float(np.linalg.norm(T[:3, 3] - target[:3, 3])), angle


# damped search ------------------------------------------------------------------------------------


@pytest.mark.parametrize("arm", [SIX, FOUR], ids=["six", "four"])
@pytest.mark.parametrize("task", TASKS)
def test_reachable_targets_are_met_within_limits(arm, task):
    met = 0
    for target in arm.forward(configurations(arm, 1000, 1)):
        result = solve_ik(arm, target, task=task)
        position, angle = errors(arm, result.q, target, task)
        assert result.position_error == pytest.approx(position, abs=1e-12)
        assert result.orientation_error == pytest.approx(angle, abs=1e-7)
        assert arm.within_limits(result.q)
        assert result.converged == (position <= 1e-4 and angle <= 1e-3)
        assert result.converged == (result.reason == "")
        met += result.converged
    assert met >= 995


def test_tighter_tolerances():
    for target in SIX.forward(configurations(SIX, 100, 2)):
        result = solve_ik(SIX, target, position_tolerance=1e-9, orientation_tolerance=1e-9)
        assert result.converged
        assert max(errors(SIX, result.q, target, "pose")) <= 1e-9 * (1 + 1e-6)


def test_any_arm():
    rng = np.random.default_rng(3)
    axes = rng.standard_normal((7, 3))
    arm = Arm(
        transform(Rotation.random(7, random_state=rng).as_matrix(), rng.normal(0, 0.2, (7, 3))),
        axes / np.linalg.norm(axes, axis=1, keepdims=True),
        np.tile([-2.5, 2.5], (7, 1)),
        T_base=transform(so3_exp([0.3, 0.2, 1.0]), [1.0, 2.0, 3.0]),
    )
    targets = arm.forward(configurations(arm, 200))
    assert sum(solve_ik(arm, target).converged for target in targets) >= 199


def test_the_same_every_time_and_the_arm_is_left_alone():
    target = SIX.forward([0.3, 0.5, -0.7, 0.2, 0.9, -1.0])
    q0 = np.zeros(6)
    first, second = solve_ik(SIX, target, q0), solve_ik(SIX, target, q0)
    np.testing.assert_array_equal(first.q, second.q)
    np.testing.assert_array_equal(q0, np.zeros(6))
    assert first.iterations == second.iterations > 1


def test_a_start_at_the_target_is_the_answer():
    for q in configurations(SIX, 20, 4):
        result = solve_ik(SIX, SIX.forward(q), q)
        np.testing.assert_array_equal(result.q, q)
        assert (result.iterations, result.jump) == (1, 0.0)
    assert math.isnan(solve_ik(SIX, SIX.forward(q)).jump)


def test_a_near_start_stays_on_its_branch():
    rng = np.random.default_rng(5)
    followed = 0
    for q in configurations(SIX, 200, 5) * 0.9:
        if least_singular_value(SIX.jacobian(q), weights(SIX), 6) < 0.01:
            continue
        near = q + 0.02 * rng.uniform(-1, 1, 6)
        result = solve_ik(SIX, SIX.forward(near), q, position_tolerance=1e-8, orientation_tolerance=1e-8)
        np.testing.assert_allclose(result.q, near, atol=1e-5)
        assert result.jump == pytest.approx(np.abs(near - q).max(), abs=1e-5)
        followed += 1
    assert followed > 100


def test_a_start_beyond_the_limits_is_brought_to_them():
    target = SIX.forward(np.zeros(6))
    result = solve_ik(SIX, target, [3.0, 0, 0, 0, 0, 0])
    assert result.converged
    assert SIX.within_limits(result.q)
    assert result.jump == pytest.approx(np.abs(result.q - [3.0, 0, 0, 0, 0, 0]).max())


# unreachable --------------------------------------------------------------------------------------


def outside(arm: Arm, distance: float, direction: np.ndarray) -> np.ndarray:
    """A pose that far from the shoulder."""
    shoulder = arm.link_poses(np.zeros(arm.n))[1, :3, 3]
    return transform(np.eye(3), shoulder + distance * direction)


def test_the_nearest_position_is_the_stretched_arm():
    links = (0.148, 0.175 + math.hypot(0.16, 0.015)), (0.148, 0.06 + 0.235)
    rng = np.random.default_rng(6)
    for arm, lengths in zip((SIX, FOUR), links, strict=True):
        for _ in range(10):
            lean, heading = rng.uniform(0.2, 1.2), rng.uniform(-1.4, 1.4)
            direction = np.array(
                [math.sin(lean) * math.cos(heading), math.sin(lean) * math.sin(heading), math.cos(lean)]
            )
            result = solve_ik(arm, outside(arm, 0.9, direction), task="position")
            assert not result.converged
            assert result.position_error == pytest.approx(0.9 - sum(lengths), abs=2e-6)
            assert "no configuration within the limits" in result.reason
            assert arm.within_limits(result.q)


@pytest.mark.parametrize(("arm", "method"), [(SIX, "dls"), (SIX, "global"), (FOUR, "dls"), (FOUR, "analytic")])
def test_unreachable_targets_are_never_called_converged(arm, method):
    rng = np.random.default_rng(7)
    for _ in range(20):
        direction = rng.standard_normal(3)
        target = outside(arm, rng.uniform(0.6, 2.0), direction / np.linalg.norm(direction))
        result = solve_ik(arm, target, method=method)
        position, angle = errors(arm, result.q, target, "pose")
        assert not result.converged
        assert (result.position_error, result.orientation_error) == pytest.approx((position, angle), abs=1e-9)
        assert f"{position:.3g} m" in result.reason
        assert np.isfinite(result.q).all()


def test_the_nearest_pose_is_a_minimum():
    """No small move within the limits brings the weighted error down."""
    radian = weights(SIX)[5]
    rng = np.random.default_rng(8)
    for direction in rng.standard_normal((5, 3)):
        target = outside(SIX, 0.7, direction / np.linalg.norm(direction))
        q = solve_ik(SIX, target).q

        def cost(q, target=target):
            position, angle = errors(SIX, q, target, "pose")
            return position**2 + (radian * angle) ** 2

        tried = np.clip(q + 1e-3 * rng.standard_normal((100, 6)), *SIX.limits.T)
        assert min(cost(row) for row in tried) >= cost(q) - 1e-9


def test_a_pose_that_only_limits_forbid():
    narrow = Arm(FOUR.placements, FOUR.axes, FOUR.limits * [[0.5], [1], [1], [1]], FOUR.T_tool)
    target = FOUR.forward([1.2, -0.8, 1.0, 0.3])
    assert solve_ik(FOUR, target).converged
    for method in ("dls", "analytic"):
        result = solve_ik(narrow, target, method=method)
        assert not result.converged
        assert narrow.within_limits(result.q)


# closed forms -------------------------------------------------------------------------------------


def test_four_joints_to_rounding():
    arm = FOUR.at_base(transform(so3_exp([0.4, -0.3, 2.0]), [0.1, 0.2, -0.3]))
    for q in configurations(arm, 1000, 9):
        target = arm.forward(q)
        found = branches_4dof(arm, target)
        assert np.abs(found - q).max(axis=1).min() <= 1e-9
        for row in found:
            assert max(errors(arm, row, target, "position+roll")) <= 1e-9
        result = solve_ik(arm, target, q, "analytic")  # the whole pose, as it comes from the arm itself
        assert result.converged
        assert max(errors(arm, result.q, target, "pose")) <= 1e-9
        assert result.branches == len(found)


def test_four_joints_take_any_rotation_for_its_roll():
    rng = np.random.default_rng(10)
    solved = 0
    for q in configurations(FOUR, 300, 10):
        target = transform(Rotation.random(random_state=rng).as_matrix(), FOUR.forward(q)[:3, 3])
        result = solve_ik(FOUR, target, method="analytic", task="position+roll")
        if result.branches:
            assert result.converged
            assert max(errors(FOUR, result.q, target, "position+roll")) <= 1e-9
            assert not solve_ik(FOUR, target, method="analytic").converged  # of the pose only the position fits
            solved += 1
        at_point = solve_ik(FOUR, target, method="analytic", task="position")
        assert at_point.converged and at_point.position_error <= 1e-9
    assert solved > 100


def test_six_joints_have_every_branch():
    arm = SIX.at_base(transform(so3_exp([np.pi, 0.0, 0.0]), [0.1, -0.2, -0.08]))
    counts = np.zeros(9, int)
    for q in configurations(arm, 1000, 11):
        target = arm.forward(q)
        found = branches_6dof(arm, target)
        assert np.abs(found - q).max(axis=1).min() <= 1e-9
        assert np.all(arm.within_limits(found))
        np.testing.assert_allclose(arm.forward(found), np.broadcast_to(target, (len(found), 4, 4)), atol=1e-9)
        counts[len(found)] += 1
    assert counts[0] == 0 and counts[8] > 0


def test_the_damped_search_finds_no_other_branch():
    """From many starts, what the iteration reaches is in the closed form's list, and most of the list is reached."""
    rng = np.random.default_rng(12)
    listed = reached = 0
    for q in configurations(SIX, 30, 12):
        target = SIX.forward(q)
        if least_singular_value(SIX.jacobian(q), weights(SIX), 6) < 5e-3:
            continue
        found = branches_6dof(SIX, target)
        seen = set()
        for start in rng.uniform(SIX.limits[:, 0], SIX.limits[:, 1], (60, 6)):
            result = search(SIX, target, start, 0, 1e-10, 1e-10, searches=1, nearest=False)
            if result.converged:
                gaps = np.abs(found - result.q).max(axis=1)
                assert gaps.min() < 1e-6
                seen.add(int(np.argmin(gaps)))
        listed += len(found)
        reached += len(seen)
    assert reached >= 0.9 * listed > 30


def test_global_takes_the_branch_nearest_to_the_start():
    for q, q0 in zip(configurations(SIX, 100, 13), configurations(SIX, 100, 14), strict=True):
        target = SIX.forward(q)
        found = branches_6dof(SIX, target, q0)
        result = solve_ik(SIX, target, q0, "global")
        assert result.jump == pytest.approx(np.abs(found - q0).max(axis=1).min())
        assert (result.iterations, result.branches) == (0, len(found))
        assert max(result.position_error, result.orientation_error) < 1e-9


def test_singular_poses_keep_the_reference():
    straight = np.array([0.4, 0.6, -0.8, 0.5, 0.0, -0.3])  # only the sum of the last roll angles counts
    upright = np.array([0.7, -0.5, 0.0, 0.2, 0.4, 0.1])  # the wrist's centre over the base: any yaw would do
    upright[2] = math.asin(0.148 * math.sin(0.5) / 0.175) + 0.5
    assert np.linalg.norm(SIX.link_poses(upright)[4, :2, 3]) < 1e-15
    for q in (straight, np.zeros(6), upright):
        target = SIX.forward(q)
        result = solve_ik(SIX, target, q, "global")
        assert result.converged
        assert result.jump < 1e-6
        assert solve_ik(SIX, target, np.full(6, 0.2), "global").converged


def test_closed_forms_refuse_other_arms():
    five = Arm(SIX.placements[:5], SIX.axes[:5], SIX.limits[:5])
    with pytest.raises(ValueError, match="needs 6 joints, got 5"):
        solve_ik(five, np.eye(4), method="global")
    with pytest.raises(ValueError, match="needs 4 joints, got 6"):
        solve_ik(SIX, np.eye(4), method="analytic")
    with pytest.raises(ValueError, match='method "global" solves poses'):
        solve_ik(SIX, np.eye(4), method="global", task="position")

    for arm, joint, message in (
        (SIX, 1, "joint0 and joint1 to cross"),
        (SIX, 4, "joint3 and joint4 to cross"),
        (SIX, 5, "meet in one point"),
    ):
        with pytest.raises(ValueError, match=message):
            branches_6dof(moved(arm, joint), np.eye(4))
    for change, message in (
        (transform(np.eye(3), [0.01, 0, 0]), "tool on the axis of joint3"),
        (transform(so3_exp([0.1, 0, 0]), np.zeros(3)), "tool's z along the axis of joint3"),
    ):
        arm = Arm(FOUR.placements, FOUR.axes, FOUR.limits, FOUR.T_tool @ change)
        with pytest.raises(ValueError, match=message):
            branches_4dof(arm, np.eye(4))


def moved(arm: Arm, joint: int) -> Arm:
    """One joint's frame, and all after it, set aside."""
    placements = arm.placements.copy()
    placements[joint] = placements[joint] @ transform(so3_exp([0.1, 0.2, -0.1]), [0.01, -0.02, 0.015])
    return Arm(placements, arm.axes, arm.limits, arm.T_tool)


@pytest.mark.parametrize(("arm", "joint"), [(FOUR, 2), (FOUR, 3), (SIX, 2), (SIX, 3)])
def test_closed_forms_take_offsets_and_skew_axes(arm, joint):
    other = moved(arm, joint)
    for q in configurations(other, 200, 16):
        found = (branches_4dof if other.n == 4 else branches_6dof)(other, other.forward(q))
        assert np.abs(found - q).max(axis=1).min() <= 1e-9


# servo steps --------------------------------------------------------------------------------------


def test_no_step_above_its_limit_near_singularities():
    caps = np.array([0.05, 0.04, 0.06, 0.1, 0.02, 0.08])
    rng = np.random.default_rng(15)
    for q in configurations(SIX, 300, 15):
        q[2 if rng.random() < 0.5 else 4] = rng.choice([0.0, 1e-12, 1e-6, 1e-3])  # arm or wrist all but straight
        after = servo_step(SIX, q, 0.5 * rng.standard_normal(6), caps)
        assert np.all(np.abs(after - q) <= caps * (1 + 1e-12))
        assert SIX.within_limits(after)


def test_damping_bounds_the_step_where_the_inverse_does_not():
    q = np.array([0.3, 0.6, -0.9, 0.2, 1e-4, 0.1])
    J = SIX.jacobian(q)
    worst = np.linalg.svd(J)[0][:, -1]  # the direction that cannot be had
    assert np.abs(np.linalg.solve(J, 0.01 * worst)).max() > 5.0
    assert np.abs(servo_step(SIX, q, 0.01 * worst, 100.0) - q).max() < 0.3


def test_far_from_singularities_the_step_is_newton_s():
    q = np.array([0.3, 0.4, -1.0, 0.2, 0.9, 0.1])
    twist = np.array([0.002, -0.001, 0.003, 0.01, 0.02, -0.01])
    step = servo_step(SIX, q, twist, 1.0, threshold=0.01) - q
    np.testing.assert_allclose(SIX.jacobian(q) @ step, twist, atol=1e-7)
    position = servo_step(SIX, q, twist[:3], 1.0, threshold=0.01) - q
    np.testing.assert_allclose(SIX.jacobian(q)[:3] @ position, twist[:3], atol=1e-7)
    assert np.linalg.norm(position) <= np.linalg.norm(step)


def test_other_joints_take_over_from_one_at_its_limit():
    q = np.array([0.3, 0.4, -1.0, 0.2, 0.9, SIX.limits[5, 1]])
    twist = 0.01 * SIX.jacobian(q)[:3, :5].sum(axis=1)
    after = servo_step(SIX, q, twist, 1.0, threshold=0.01)
    assert after[5] <= SIX.limits[5, 1]
    np.testing.assert_allclose(SIX.jacobian(q)[:3] @ (after - q), twist, atol=1e-7)


def test_servoing_converges_on_a_pose():
    start, goal = np.array([0.3, 0.4, -1.0, 0.2, 0.9, 0.1]), np.array([-0.3, 0.6, -1.3, 0.5, 0.6, 0.6])
    q, target = start, SIX.forward(goal)
    for _ in range(400):
        T = SIX.forward(q)
        error = np.r_[target[:3, 3] - T[:3, 3], so3_log(target[:3, :3] @ T[:3, :3].T)]
        after = servo_step(SIX, q, 0.1 * error, 0.04)
        assert np.abs(after - q).max() <= 0.04 * (1 + 1e-12)
        q = after
    assert max(errors(SIX, q, target, "pose")) < 1e-6


def test_the_step_tells_how_singular_the_arm_is():
    q, after = np.array([0.3, 0.4, -1.0, 0.2, 0.9, 0.1]), np.empty(6)
    sigma = dls_step(SIX.chain, SIX.limits, np.ones(6), weights(SIX), q, np.zeros(6), 6, 0.01, 0.01, after)
    expected = np.linalg.svd(weights(SIX)[:, None] * SIX.jacobian(q), compute_uv=False)[-1]
    assert sigma == pytest.approx(expected, rel=1e-9)
    np.testing.assert_array_equal(after, q)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"q": np.zeros(5)}, "q: expected"),
        ({"q": np.zeros((2, 6))}, "q: expected shape"),
        ({"q": np.full(6, np.nan)}, "q: expected finite"),
        ({"twist": np.zeros(5)}, "twist: expected"),
        ({"twist": np.full(6, np.inf)}, "twist: expected finite"),
        ({"step_limits": 0.0}, "step_limits: expected positive"),
        ({"step_limits": np.ones(5)}, "step_limits: expected shape"),
        ({"step_limits": math.nan}, "step_limits: expected positive"),
        ({"damping": 0.0}, "damping: expected a positive"),
        ({"threshold": -1.0}, "threshold: expected a positive"),
    ],
)
def test_bad_steps(changes, message):
    good = {"q": np.zeros(6), "twist": np.zeros(6), "step_limits": 0.1}
    with pytest.raises(ValueError, match=message):
        servo_step(SIX, **(good | changes))


# bad input ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["dls", "global"])
@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"T_target": np.diag([1.0, 1.0, -1.0, 1.0])}, r"T_target: expected det R = \+1.*reflection"),
        ({"T_target": np.diag([1.0, 1.0, 1.1, 1.0])}, "T_target: expected orthonormal"),
        ({"T_target": np.full((4, 4), np.nan)}, "T_target: expected finite"),
        ({"T_target": np.eye(3)}, "T_target: expected shape"),
        ({"T_target": np.tile(np.eye(4), (2, 1, 1))}, "T_target: expected shape"),
        ({"T_target": np.eye(4) + np.eye(4)[[3, 0, 1, 2]]}, "T_target: expected"),
        ({"q0": np.zeros(4)}, "q0: expected shape"),
        ({"q0": np.zeros((1, 6))}, "q0: expected shape"),
        ({"q0": np.full(6, np.nan)}, "q0: expected finite"),
        ({"task": "poise"}, "task: expected one of pose, position"),
        ({"method": "ikfast"}, "method: expected one of dls, analytic, global"),
        ({"position_tolerance": 0.0}, "position_tolerance: expected a positive"),
        ({"orientation_tolerance": math.nan}, "orientation_tolerance: expected a positive"),
    ],
)
def test_bad_targets(method, changes, message):
    with pytest.raises(ValueError, match=message):
        solve_ik(SIX, **({"T_target": np.eye(4), "method": method} | changes))


def test_bad_references():
    with pytest.raises(ValueError, match="reference: expected shape"):
        branches_6dof(SIX, np.eye(4), np.zeros(5))
    with pytest.raises(ValueError, match="T_target: expected shape"):
        branches_4dof(FOUR, np.tile(np.eye(4), (2, 1, 1)))


# the benchmark ------------------------------------------------------------------------------------


def test_benchmark_without_a_peer(capsys):
    assert ik_speed.main(["--targets", "20", "--rounds", "1"]) == 0
    out = capsys.readouterr().out
    assert out.count("100.00%") == 2
    found = ik_speed.measure(None, count=10, rounds=2)
    assert set(found) == {"dls", "global"}
    assert all(row["solved"] == 1.0 and row["median_ms"] > 0.0 for row in found.values())


def test_benchmark_says_why_a_peer_is_not_there(capsys, tmp_path):
    assert ik_speed.main(["--targets", "2", "--peer-python", str(tmp_path / "python")]) == 1
    assert "--peer-python" in capsys.readouterr().err
    fake = tmp_path / "fake"
    fake.write_text("#!/bin/sh\necho 'no module' >&2\nexit 3\n")
    fake.chmod(0o755)
    assert ik_speed.main(["--targets", "2", "--peer-python", str(fake)]) == 1
    assert "status 3: no module" in capsys.readouterr().err


def test_benchmark_checks_what_a_solver_claims():
    q = configurations(SIX, 3)
    T = SIX.forward(q)
    claimed = np.array([True, False, True])
    wrong = q.copy()
    wrong[2, 1] += 0.01
    np.testing.assert_array_equal(ik_speed.reached(SIX, wrong, T, claimed), [True, False, False])
