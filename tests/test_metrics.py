"""Metrics against hand-worked cases, separately written formulas, and a published trajectory."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize

from aerograsp_env import metrics as m
from aerograsp_env import spatial as sp

DATA = Path(os.environ.get("AEROGRASP_DATA", Path(__file__).parents[2] / "shared" / "data"))


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(11)


def random_pose(rng: np.random.Generator, *batch: int) -> np.ndarray:
    return sp.transform(sp.so3_exp(rng.uniform(-1.5, 1.5, (*batch, 3))), rng.normal(size=(*batch, 3)))


# --- detection ---------------------------------------------------------------


def test_iou_by_hand() -> None:
    a = [[0, 0, 2, 2], [0, 0, 0, 5]]
    b = [[0, 0, 2, 2], [1, 1, 3, 3], [2, 0, 4, 2], [0, 0, 1, 1]]
    # 1×1 of overlap in 4 + 4 − 1; touching edges share nothing; a quarter; no area, no overlap.
    np.testing.assert_allclose(m.box_iou(a, b), [[1.0, 1 / 7, 0.0, 1 / 4], [0.0] * 4], atol=1e-15)


def test_iou_is_symmetric_batched_and_takes_no_boxes(rng: np.random.Generator) -> None:
    corner, size = rng.uniform(0, 10, (2, 3, 5, 2)), rng.uniform(0, 10, (2, 3, 5, 2))
    boxes = np.concatenate([corner, corner + size], axis=-1)
    iou = m.box_iou(boxes[0], boxes[1])
    assert iou.shape == (3, 5, 5)
    np.testing.assert_allclose(iou, np.swapaxes(m.box_iou(boxes[1], boxes[0]), -1, -2))
    np.testing.assert_allclose(iou[2], m.box_iou(boxes[0, 2], boxes[1, 2]))
    assert ((iou >= 0) & (iou <= 1)).all()
    assert m.box_iou(np.zeros((0, 4)), boxes[0, 0]).shape == (0, 5)
    with pytest.raises(ValueError, match="b: expected boxes"):
        m.box_iou([[0, 0, 1, 1]], [[1, 0, 0, 1]])


def test_each_true_box_is_found_once() -> None:
    truth = [[0, 0, 10, 10], [20, 0, 30, 10]]
    boxes = [[0, 0, 10, 9], [0, 0, 10, 10], [20, 0, 30, 4], [20, 0, 30, 6]]
    # The second overlaps better but comes later in score; the third's IoU is 0.4.
    correct = m.match_detections(boxes, [0.9, 0.8, 0.7, 0.6], truth)
    np.testing.assert_array_equal(correct, [True, False, False, True])
    np.testing.assert_array_equal(m.match_detections(boxes, [0.9, 0.95, 0.7, 0.6], truth), [False, True, False, True])
    np.testing.assert_array_equal(m.match_detections(boxes, [0.9, 0.8, 0.7, 0.6], []), [False] * 4)
    assert m.match_detections([], [], truth).shape == (0,)


def test_average_precision_by_hand() -> None:
    # Hits 1, 0, 1, 0, 1 of 4 objects: precisions at recalls 1/4, 1/2, 3/4 are 1, 2/3, 3/5.
    expected = 0.25 * (1 + 2 / 3 + 3 / 5)
    assert m.average_precision([0.9, 0.8, 0.7, 0.6, 0.5], [1, 0, 1, 0, 1], 4) == pytest.approx(expected, abs=1e-15)
    # 0, 1, 1 of 2: precision rises from 1/2 to 2/3, which counts for both recalls.
    assert m.average_precision([0.9, 0.8, 0.7], [0, 1, 1], 2) == pytest.approx(2 / 3, abs=1e-15)
    assert m.average_precision([0.9, 0.8], [1, 1], 2) == 1.0
    assert m.average_precision([], [], 3) == 0.0
    # Equal scores stand or fall together, in whichever order they come.
    for correct in ([1, 0], [0, 1]):
        assert m.average_precision([0.5, 0.5], correct, 1) == 0.5


def test_average_precision_refuses_what_has_no_answer() -> None:
    with pytest.raises(ValueError, match="positives: expected at least one"):
        m.average_precision([0.5], [0], 0)
    with pytest.raises(ValueError, match="correct: expected"):
        m.average_precision([0.5, 0.4], [1, 1], 1)
    with pytest.raises(ValueError, match="scores: expected finite"):
        m.average_precision([np.nan], [1], 1)


def test_mean_average_precision() -> None:
    box, other = [0, 0, 10, 10], [20, 20, 30, 30]
    truths = [([box, other], ["wrench", "hammer"]), ([box], ["wrench"])]
    detections = [
        ([box, box, other], [0.9, 0.95, 0.3], ["wrench", "hammer", "plier"]),
        ([box, other], [0.8, 0.85], ["wrench", "wrench"]),
    ]
    result = m.mean_average_precision(detections, truths)
    # wrench: hit 0.9, miss 0.85, hit 0.8 of 2 -> ½·1 + ½·2/3; hammer: its only detection misses; plier has no object.
    assert result.per_class == {"wrench": pytest.approx(5 / 6), "hammer": 0.0}
    assert result.mean == pytest.approx(5 / 12)
    assert m.mean_average_precision([([], [], [])] * 2, truths).mean == 0.0
    with pytest.raises(ValueError, match="truths: expected at least one true object"):
        m.mean_average_precision(detections, [([], [])] * 2)
    with pytest.raises(ValueError, match="detections: expected one entry"):
        m.mean_average_precision(detections[:1], truths)
    with pytest.raises(ValueError, match="another number in image 1"):
        m.mean_average_precision(detections, [truths[0], ([box], [])])


# --- object pose and shape ---------------------------------------------------


def test_add_of_a_shift_is_its_length_and_add_s_is_smaller(rng: np.random.Generator) -> None:
    points = rng.normal(size=(200, 3))
    T = random_pose(rng, 4)
    shift = sp.transform(np.eye(3), [0.3, 0.0, 0.4])
    np.testing.assert_allclose(m.add_error(shift @ T, T, points), 0.5, atol=1e-12)
    assert (m.add_s_error(shift @ T, T, points) < 0.5).all()
    np.testing.assert_allclose(m.add_error(T, T, points), 0.0)
    assert m.add_error(T[0], T[0], points).shape == ()


def test_add_s_matches_all_pairs_and_forgives_symmetry(rng: np.random.Generator) -> None:
    points = rng.normal(size=(50, 3))
    A, B = random_pose(rng, 2, 3)
    pairs = np.linalg.norm(
        sp.transform_points(A, points)[:, None, :, :] - sp.transform_points(B, points)[:, :, None, :], axis=-1
    )
    np.testing.assert_allclose(m.add_s_error(A, B, points), pairs.min(axis=-1).mean(axis=-1), atol=1e-12)
    square = np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0.0]])
    quarter = sp.transform(sp.so3_exp([0, 0, np.pi / 2]), np.zeros(3))
    assert m.add_s_error(A[0] @ quarter, A[0], square) == pytest.approx(0.0, abs=1e-12)
    assert m.add_error(A[0] @ quarter, A[0], square) == pytest.approx(np.sqrt(2), abs=1e-12)


def test_rotation_and_translation_errors(rng: np.random.Generator) -> None:
    T = random_pose(rng, 6)
    axis = rng.normal(size=3)
    for angle in (0.0, 1e-9, 0.3, np.pi):
        turn = sp.transform(sp.so3_exp(angle * axis / np.linalg.norm(axis)), np.array([0, 0, 0.25]))
        np.testing.assert_allclose(m.rotation_error(T @ turn, T), angle, atol=1e-14 if angle < 3 else 1e-7)
        np.testing.assert_allclose(m.translation_error(T @ turn, T), 0.25, atol=1e-14)


def test_rotation_error_with_symmetries(rng: np.random.Generator) -> None:
    T = random_pose(rng)
    symmetries = sp.so3_exp(np.outer([0, 2 * np.pi / 3, -2 * np.pi / 3], [0, 0, 1]))  # the crawler's kind
    turned = T @ sp.transform(sp.so3_exp([0, 0, 2 * np.pi / 3 + 0.1]), np.zeros(3))
    assert m.rotation_error(turned, T) == pytest.approx(2 * np.pi / 3 + 0.1)
    assert m.rotation_error(turned, T, symmetries) == pytest.approx(0.1)
    with pytest.raises(ValueError, match="symmetries: expected shape"):
        m.rotation_error(T, T, np.eye(3))
    with pytest.raises(ValueError, match="symmetries: expected det"):
        m.rotation_error(T, T, np.diag([1.0, 1, -1])[None])


def test_chamfer_by_hand() -> None:
    # From a: distances 0 and 1, mean ½; from b: 0. Half their sum.
    assert m.chamfer_distance([[0, 0, 0], [1, 0, 0]], [[0, 0, 0]]) == pytest.approx(0.25)
    assert m.chamfer_distance([[0, 0, 0]], [[0, 0, 0], [1, 0, 0]]) == pytest.approx(0.25)
    with pytest.raises(ValueError, match="a: expected shape"):
        m.chamfer_distance(np.zeros((0, 3)), [[0, 0, 0]])


# --- trajectories ------------------------------------------------------------


def horn_rmse(p: np.ndarray, q: np.ndarray) -> float:
    """RMSE after the best rigid motion, by the largest eigenvalue of Horn's (1987) quaternion matrix: no SVD."""
    x, y = p - p.mean(axis=0), q - q.mean(axis=0)
    S = x.T @ y
    delta = [S[1, 2] - S[2, 1], S[2, 0] - S[0, 2], S[0, 1] - S[1, 0]]
    N = np.zeros((4, 4))
    N[0, 0], N[0, 1:], N[1:, 0] = np.trace(S), delta, delta
    N[1:, 1:] = S + S.T - np.trace(S) * np.eye(3)
    squares = (x**2).sum() + (y**2).sum() - 2 * np.linalg.eigvalsh(N)[-1]
    return float(np.sqrt(max(squares, 0.0) / len(p)))


def test_alignment_recovers_a_known_motion(rng: np.random.Generator) -> None:
    p, T = rng.normal(size=(30, 3)), random_pose(rng)
    alignment = m.umeyama(p, sp.transform_points(T, 2.5 * p), with_scale=True)
    np.testing.assert_allclose(alignment.T_target_source, T, atol=1e-12)
    assert alignment.scale == pytest.approx(2.5)
    assert m.umeyama(p, sp.transform_points(T, p)).scale == 1.0


def test_alignment_never_mirrors(rng: np.random.Generator) -> None:
    p = rng.normal(size=(30, 3))
    alignment = m.umeyama(p, p * [1, 1, -1], with_scale=True)
    assert sp.is_rotation(alignment.T_target_source[:3, :3])
    assert m.absolute_trajectory_error(p, p * [1, 1, -1]).rmse > 0.1
    # Still the best among rotations, by an optimiser that knows nothing of the closed form.
    cost = minimize(lambda v: np.sum((p @ sp.so3_exp(v).T - p * [1, 1, -1]) ** 2), rng.normal(size=3), tol=1e-12).fun
    q = p * [1, 1, -1]
    mean_free = m.absolute_trajectory_error(p - p.mean(axis=0), q - q.mean(axis=0)).rmse
    assert mean_free <= np.sqrt(cost / 30) + 1e-9


def test_ate_equals_a_formula_written_separately(rng: np.random.Generator) -> None:
    for noise in (0.0, 0.01, 1.0):
        p = np.cumsum(rng.normal(size=(100, 3)), axis=0)
        q = sp.transform_points(random_pose(rng), p) + noise * rng.normal(size=(100, 3))
        result = m.absolute_trajectory_error(p, q)
        assert result.rmse == pytest.approx(horn_rmse(p, q), abs=1e-6)
        assert result.rmse == pytest.approx(np.sqrt(np.mean(result.errors**2)))
        assert m.absolute_trajectory_error(p, q, with_scale=True).rmse <= result.rmse + 1e-12
        assert m.absolute_trajectory_error(p, q, align=False).rmse >= result.rmse - 1e-12


def test_ate_of_a_straight_line_is_defined_though_the_turn_is_not() -> None:
    line = np.outer(np.arange(5.0), [1, 0, 0])
    bent = line + [[0, 0.1, 0], [0, -0.1, 0], [0, 0, 0], [0, -0.1, 0], [0, 0.1, 0]]
    assert m.absolute_trajectory_error(line, line[:, [2, 0, 1]]).rmse == pytest.approx(0, abs=1e-12)
    assert m.absolute_trajectory_error(bent, line).rmse == pytest.approx(horn_rmse(bent, line), abs=1e-9)


def test_trajectory_errors_refuse_what_has_no_answer(rng: np.random.Generator) -> None:
    T = random_pose(rng, 5)
    with pytest.raises(ValueError, match=r"T_estimate: expected shape \(N, 3\) with N ≥ 3"):
        m.absolute_trajectory_error(T[:2], T[:2])
    with pytest.raises(ValueError, match="T_true: expected as many poses"):
        m.absolute_trajectory_error(T, T[:4])
    with pytest.raises(ValueError, match="T_estimate: expected finite"):
        m.absolute_trajectory_error(T * np.nan, T)
    with pytest.raises(ValueError, match="coincide"):
        m.absolute_trajectory_error(np.ones((5, 3)), T[:, :3, 3], with_scale=True)
    with pytest.raises(ValueError, match="with_scale: expected align"):
        m.absolute_trajectory_error(T, T, align=False, with_scale=True)
    with pytest.raises(ValueError, match="delta: expected"):
        m.relative_pose_error(T, T, delta=5)


def test_rpe_sees_drift_and_not_where_it_began(rng: np.random.Generator) -> None:
    T = random_pose(rng, 20)
    assert m.relative_pose_error(random_pose(rng) @ T, T).translation_rmse == pytest.approx(0, abs=1e-12)
    # Every step of the estimate carries the same extra motion, which is the error itself at delta = 1.
    step, extra = sp.se3_exp([0.1, 0, 0, 0, 0, 0.2]), sp.se3_exp([0.03, 0.0, 0.04, 0.0, 0.02, 0.0])
    true, estimate = [np.eye(4)], [np.eye(4)]
    for _ in range(10):
        true.append(true[-1] @ step)
        estimate.append(estimate[-1] @ step @ extra)
    result = m.relative_pose_error(estimate, true)
    assert result.translation_rmse == pytest.approx(np.linalg.norm(extra[:3, 3]), abs=1e-12)
    assert result.rotation_rmse == pytest.approx(0.02, abs=1e-12)
    assert m.relative_pose_error(estimate, true, delta=4).translation.shape == (7,)


def test_association_pairs_nearest_stamps_once() -> None:
    a, b = m.associate([0.0, 0.1, 0.2, 0.3], [0.005, 0.11, 0.114, 0.25], max_difference=0.02)
    np.testing.assert_array_equal(a, [0, 1])
    np.testing.assert_array_equal(b, [0, 1])
    with pytest.raises(ValueError, match="stamps_b: expected strictly increasing"):
        m.associate([0.0], [1.0, 0.5])


def read_tum(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Stamps (N,) and poses (N, 4, 4) of a trajectory in TUM's format: stamp, position, quaternion xyzw."""
    rows = np.loadtxt(path)
    R = sp.matrix_from_quat_wxyz(sp.quat_wxyz_from_xyzw(rows[:, 4:]))
    return rows[:, 0], sp.transform(R, rows[:, 1:4])


@pytest.mark.skipif(not (DATA / "trajectories_evo").is_dir(), reason="real data not present")
def test_ate_and_rpe_of_a_published_trajectory() -> None:
    """RGB-D SLAM on TUM's fr1_xyz: a trajectory, the same moved as a whole, and a monocular one of unknown scale."""
    folder = DATA / "trajectories_evo"
    stamps, true = read_tum(folder / "freiburg1_xyz-groundtruth.txt")
    ate = {}
    for name in ("rgbdslam", "rgbdslam_drift", "ORB_kf_mono"):
        t, estimate = read_tum(folder / f"freiburg1_xyz-{name}.txt")
        i, j = m.associate(t, stamps, 0.01)
        assert len(i) > 0.95 * len(t)
        P, Q = estimate[i], true[j]
        ate[name] = m.absolute_trajectory_error(P, Q).rmse
        assert ate[name] == pytest.approx(horn_rmse(P[:, :3, 3], Q[:, :3, 3]), abs=1e-9)
        if name == "ORB_kf_mono":
            ate["scaled"] = m.absolute_trajectory_error(P, Q, with_scale=True).rmse
        else:
            ate[f"{name} as it is"] = m.absolute_trajectory_error(P, Q, align=False).rmse
            rpe = m.relative_pose_error(P, Q)
            k = 100  # one frame by hand, with plain matrix inverses
            E = np.linalg.inv(np.linalg.inv(Q[k]) @ Q[k + 1]) @ np.linalg.inv(P[k]) @ P[k + 1]
            assert rpe.translation[k] == pytest.approx(np.linalg.norm(E[:3, 3]), abs=1e-12)
            assert rpe.translation_rmse < 0.02
    assert ate["rgbdslam"] < 0.02
    assert ate["rgbdslam_drift"] == pytest.approx(ate["rgbdslam"], abs=1e-6)
    assert ate["rgbdslam_drift as it is"] > ate["rgbdslam as it is"] > ate["rgbdslam"]
    assert ate["scaled"] < 0.02 < ate["ORB_kf_mono"]


# --- control -----------------------------------------------------------------


def test_mean_absolute_error_leaves_the_start_out() -> None:
    dt = 0.02
    errors = np.full((500, 2), [0.1, -0.3])
    errors[:250] = 99.0  # times 0 to 4.98 s
    np.testing.assert_allclose(m.mean_absolute_error(errors, dt), [0.1, 0.3])
    assert m.mean_absolute_error(errors, dt, skip=4.98)[0] > 0.1
    np.testing.assert_allclose(m.mean_absolute_error([[1.0], [-3.0]], 1.0, skip=0.0), [2.0])
    with pytest.raises(ValueError, match="errors: expected more than 250 rows"):
        m.mean_absolute_error(errors[:250], dt)
    with pytest.raises(ValueError, match="errors: expected finite"):
        m.mean_absolute_error(errors * np.nan, dt)
    with pytest.raises(ValueError, match="dt, skip: expected dt > 0"):
        m.mean_absolute_error(errors, 0.0)


def test_trueness_and_precision() -> None:
    result = m.trueness_precision([[1.0, -2.0], [3.0, -2.0]])
    np.testing.assert_allclose(result.trueness, [2.0, 2.0])
    np.testing.assert_allclose(result.precision, [1.0, 0.0])
    # Both parts together are the mean square: μ² + σ² = E[e²].
    errors = np.random.default_rng(0).normal(0.2, 0.5, (100, 3))
    mu, sigma = m.trueness_precision(errors)
    np.testing.assert_allclose(mu**2 + sigma**2, (errors**2).mean(axis=0))
    with pytest.raises(ValueError, match="errors: expected finite"):
        m.trueness_precision(np.zeros((0, 3)))
