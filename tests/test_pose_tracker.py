"""Tracking a pose: exactness on the model's own motions, symmetric objects that do not flip, gates and bad input."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import trimesh
from detection_clouds import box_of, cast, frame_of, looking, noisy, pose_error, surface_of

from aerograsp_env.sim.objects.crawler import pipe_crawler
from aerograsp_env.spatial import inverse, se3_exp, so3_exp, transform
from baselines.detection import PoseTracker, ShapeModel, pose_from_box
from baselines.detection.tracking import constant_acceleration_model, nearest_symmetric

SYMMETRIES = np.stack([so3_exp([0.0, 0.0, 2.0 * np.pi / 3.0 * k]) for k in range(3)])


def test_model_moves_as_the_closed_form_and_its_noise_adds_up() -> None:
    model = constant_acceleration_model(0.7, np.eye(3))
    x = np.arange(9.0)
    moved = model.f(x, None, 0.3)
    np.testing.assert_allclose(moved[:3], x[:3] + 0.3 * x[3:6] + 0.045 * x[6:])
    F, Q = model.F(x, None, 0.2), model.Q(0.2, 9)
    np.testing.assert_allclose(model.Q(0.4, 9), F @ Q @ F.T + Q, atol=1e-15)  # two half steps equal one


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_constant_acceleration_and_rate_are_followed_through_whole_turns(kind: str) -> None:
    tracker = PoseTracker(filter=kind, position_noise=1e-3, rotation_noise=1e-3)  # type: ignore[arg-type]
    rate, acceleration = np.array([0.9, -1.2, 1.5]), np.array([0.1, 0.0, -0.2])
    track = None
    for k in range(81):
        t = 0.1 * k
        T = transform(so3_exp(t * rate), [0.0, 0.1 * t, 1.0] + 0.5 * t * t * acceleration)
        if track is not None and k > 40:
            angle, distance = pose_error(tracker.predict(track, t).T, T)
            assert angle < 0.1 and distance < 1e-3
        track = tracker.update(track, T, t)
    assert track is not None and track.accepted
    np.testing.assert_allclose(track.twist[3:], rate, atol=0.01)
    np.testing.assert_allclose(track.twist[:3], [0.8, 0.1, -1.6], atol=0.01)


def test_covariance_is_that_of_the_errors() -> None:
    rng = np.random.default_rng(0)
    noise = np.diag([1e-4, 4e-4, 1e-4, 1e-3, 1e-3, 4e-3])
    tracker = PoseTracker(jerk=0.1, angular_jerk=0.1)
    squares = []
    for _ in range(30):
        track = None
        for k in range(15):
            measured = se3_exp(np.concatenate([np.zeros(3), np.sqrt(noise.diagonal()[3:]) * rng.normal(size=3)]))
            measured[:3, 3] = np.sqrt(noise.diagonal()[:3]) * rng.normal(size=3)
            track = tracker.update(track, measured, 0.1 * k, noise)
        assert track is not None
        error = np.concatenate([track.T[:3, 3], [track.T[2, 1], track.T[0, 2], track.T[1, 0]]])
        squares.append(error @ np.linalg.solve(track.covariance, error))
    assert 4.0 < np.mean(squares) < 9.0  # chi-square of six degrees


def test_symmetric_measurements_are_brought_to_the_prediction() -> None:
    rng = np.random.default_rng(1)
    tracker, track, T = PoseTracker(SYMMETRIES), None, np.eye(4)
    for k in range(30):
        T = transform(so3_exp([0.1, 0.2, 0.3 * k]), [0.02 * k, 0.0, 1.0])
        seen = T.copy()
        seen[:3, :3] = T[:3, :3] @ SYMMETRIES[0 if k == 0 else rng.integers(3)]
        track = tracker.update(track, seen, 0.1 * k)
        assert track.accepted and pose_error(track.T, T)[0] < (3.0 if k > 5 else 30.0)  # the rate is not known at first
    pose, which = nearest_symmetric(T, SYMMETRIES, T[:3, :3] @ SYMMETRIES[2])
    assert which == 2 and pose_error(pose, T)[0] == pytest.approx(120.0)


def test_outliers_are_left_out_until_they_persist() -> None:
    tracker = PoseTracker(patience=3)
    track = None
    for k in range(20):
        track = tracker.update(track, np.eye(4), 0.1 * k)
    assert track is not None
    twisted = transform(so3_exp([0.0, 0.0, np.pi / 3.0]), np.zeros(3))
    for k in range(3):
        track = tracker.update(track, twisted, 2.0 + 0.1 * k)
        assert not track.accepted and track.rejected == k + 1 and pose_error(track.T, np.eye(4))[0] < 2.0
    track = tracker.update(track, twisted, 2.3)
    assert track.rejected == 0 and pose_error(track.T, twisted)[0] < 2.0
    waited = tracker.update(track, None, 3.0)
    assert np.trace(waited.covariance) > np.trace(track.covariance)


def test_the_crawler_seen_from_a_moving_camera_does_not_flip() -> None:
    """At least 95 % of the frames within 1 cm and 5°, and no jump above 30°; each frame by itself jumps."""
    shape = pipe_crawler()
    mesh = trimesh.Trimesh(shape.vertices, shape.faces, process=False)
    floor = trimesh.creation.box((4.0, 4.0, 0.02), transform=transform(np.eye(3), [0, 0, -0.01]))
    scene = trimesh.util.concatenate([mesh, floor])
    model = ShapeModel(*surface_of(mesh, 1500), SYMMETRIES)
    rng = np.random.default_rng(0)
    tracker, track, alone, errors = PoseTracker(SYMMETRIES), None, [], []
    poses: list[np.ndarray] = []
    for k in range(25):
        t = 0.1 * k
        eye = np.array([0.9 * np.cos(0.4 * t), 0.9 * np.sin(0.4 * t), 0.8 + 0.1 * np.sin(1.3 * t)])
        T = inverse(looking(eye, np.array([0.05 * np.sin(t), 0.05 * np.cos(1.7 * t), 0.05])))
        frame, box = frame_of(noisy(cast(scene, T), rng)), box_of(cast(mesh, T)) + rng.normal(size=4)
        start = None if track is None else tracker.predict(track, t).T
        track = tracker.update(track, pose_from_box(frame, box, model, start).T_c_object, t)
        poses.append(track.T)
        errors.append(pose_error(track.T, T, SYMMETRIES))
        raw = pose_from_box(frame, box, model).T_c_object
        alone.append(poses[-1] if raw is None else raw)
    angles, distances = np.array(errors).T
    assert np.mean((angles < 5.0) & (distances < 0.01)) >= 0.95

    def flips(track: list[np.ndarray]) -> int:
        return sum(pose_error(after, before)[0] > 30.0 for before, after in itertools.pairwise(track))

    assert flips(poses) == 0 and flips(alone) > 0


def test_a_restarted_track_is_at_rest_in_the_nearest_symmetric_pose() -> None:
    tracker = PoseTracker(SYMMETRIES)
    track = tracker.update(tracker.start(np.eye(4), 0.0), transform(np.eye(3), [0.1, 0.0, 0.0]), 0.1)
    T = transform(so3_exp([0.0, 0.0, 2.0 * np.pi / 3.0 + 1.0]), [1.0, 2.0, 3.0])
    again = tracker.restart(track, T, 0.2)
    np.testing.assert_allclose(again.T, transform(so3_exp([0.0, 0.0, 1.0]), [1.0, 2.0, 3.0]), atol=1e-12)
    np.testing.assert_array_equal(again.twist, np.zeros(6))
    assert again.accepted and again.stamp == 0.2


def test_every_filter_makes_noisy_poses_better_and_they_agree() -> None:
    errors: dict[str, list[tuple[float, float]]] = {"ekf": [], "ukf": [], "particle": [], "measured": []}
    trackers = {
        kind: PoseTracker(filter=kind, position_noise=0.02, rotation_noise=0.05)  # type: ignore[arg-type]
        for kind in ("ekf", "ukf", "particle")
    }
    tracks = dict.fromkeys(trackers)
    rng = np.random.default_rng(2)
    for k in range(30):
        T = transform(so3_exp([0.0, 0.0, 0.03 * k]), [0.02 * k, 0.0, 1.0])
        seen = T @ se3_exp(np.concatenate([0.02 * rng.normal(size=3), 0.05 * rng.normal(size=3)]))
        errors["measured"].append(pose_error(seen, T))
        for kind, tracker in trackers.items():
            tracks[kind] = tracker.update(tracks[kind], seen, 0.1 * k)
            errors[kind].append(pose_error(tracks[kind].T, T))
    late = {kind: np.mean(values[10:], axis=0) for kind, values in errors.items()}
    np.testing.assert_allclose(late["ekf"], late["ukf"], rtol=1e-6)  # the model is linear in the tangent space
    for kind in ("ekf", "particle"):
        assert (late[kind] < late["measured"]).all() and np.allclose(late[kind], late["ekf"], rtol=0.2)


def test_bad_input_is_named() -> None:
    with pytest.raises(ValueError, match="filter: expected"):
        PoseTracker(filter="kalman")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="symmetries"):
        PoseTracker(2.0 * np.eye(3)[None])
    with pytest.raises(ValueError, match="gate: expected"):
        PoseTracker(gate=2.0)
    tracker = PoseTracker()
    with pytest.raises(ValueError, match="T: expected a pose to start from"):
        tracker.update(None, None, 0.0)
    with pytest.raises(ValueError, match="T: expected"):
        tracker.update(None, 2.0 * np.eye(4), 0.0)
    track = tracker.start(np.eye(4), 1.0)
    with pytest.raises(ValueError, match="stamp: expected one not before"):
        tracker.update(track, np.eye(4), 0.5)
    with pytest.raises(ValueError, match="covariance: expected a positive definite"):
        tracker.update(track, np.eye(4), 1.5, np.zeros((6, 6)))
