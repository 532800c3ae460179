"""Visual servoing: tracked poses brought to now, the fed-forward twist, rates within limits."""

import math

import numpy as np
import pytest

from aerograsp_env.spatial import matrix_from_rpy, se3_log, so3_exp, transform
from baselines.kinematics.arm import Arm
from baselines.kinematics.servo import ServoSettings, joint_rates, servo_rates, target_twist
from baselines.kinematics.tracking import REMEMBERED, Track, TrackSettings, attitude_matrix, start_track, update_track

DT = 0.02
T_WORLD_OBJECT = transform(so3_exp([0.3, -0.2, 1.1]), [0.5, 0.1, -0.4])
SEAT = np.array([0.45, 0.2, -0.45])


def body_at(t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Roll, pitch, yaw; position and velocity in the world."""
    rpy = np.array([0.1 * math.sin(3 * t), 0.08 * math.cos(2 * t) - 0.08, 0.05 * math.sin(t)])
    place = np.array([0.1 * math.sin(2 * t), 0.08 * math.sin(3 * t), 0.05 * math.sin(t)])
    speed = np.array([0.2 * math.cos(2 * t), 0.24 * math.cos(3 * t), 0.05 * math.cos(t)])
    return rpy, place, speed


def seen_at(t: float, drift=(0.0, 0.0, 0.0)) -> tuple[np.ndarray, np.ndarray]:
    rpy, place, _ = body_at(t)
    R = matrix_from_rpy(rpy)
    T = np.eye(4)
    T[:3, :3] = R.T @ T_WORLD_OBJECT[:3, :3]
    T[:3, 3] = R.T @ (T_WORLD_OBJECT[:3, 3] + np.asarray(drift) * t - place)
    return T, R.T @ (SEAT - place)


def track_for(seconds: float, delay: float, *, bias=(0.0, 0.0, 0.0), noise=0.0, drift=(0.0, 0.0, 0.0)) -> Track:
    """30 images a second, `delay` old when they come; the velocity estimate errs by `bias`."""
    rng = np.random.default_rng(3)

    def estimate(t):
        rpy, _, speed = body_at(t)
        return rpy, matrix_from_rpy(rpy).T @ (speed + bias)

    steps, late = round(seconds / DT), round(delay / DT)
    T, seat = seen_at(0.0, drift)
    rpy, velocity = estimate(0.0)
    track = start_track(T, seat[None], rpy, velocity)
    image, phase, images = 0, 0.0, {0: (T, seat)}
    for k in range(1, steps + 1):
        phase += DT * 30.0
        if phase >= 1.0:
            phase -= 1.0
            T, seat = seen_at(k * DT, drift)
            shift = noise * rng.standard_normal(3)
            T[:3, 3] += shift
            images[k] = T, seat + shift
        image = max((i for i in images if i <= k - late), default=0)
        rpy, velocity = estimate(k * DT)
        T, seat = images[image]
        track = update_track(track, T, seat[None], (k - image) * DT, rpy, velocity, TrackSettings())
    return track


def test_attitude_is_the_rotation_of_roll_pitch_yaw():
    rpy = np.array([0.3, -0.4, 1.2])
    np.testing.assert_allclose(attitude_matrix(rpy), matrix_from_rpy(rpy), atol=1e-15)


@pytest.mark.parametrize("delay", [0.0, 0.06, 0.10, 0.2])
def test_late_images_of_a_moving_body_give_the_pose_of_now(delay):
    track = track_for(3.0, delay)
    truth, seat = seen_at(3.0)
    naive = np.linalg.norm(seen_at(3.0 - delay)[0][:3, 3] - truth[:3, 3])
    error = se3_log(np.linalg.inv(truth) @ track.pose)
    assert np.linalg.norm(error[:3]) < 1e-3 or np.linalg.norm(error[3:]) < 1e-3
    assert np.linalg.norm(track.pose[:3, 3] - truth[:3, 3]) < 6e-4  # of the trapezoidal rule
    assert np.linalg.norm(track.point(1) - seat) < 6e-4
    assert delay < 0.05 or naive > 5e-3  # what it would be without


def test_a_wrong_velocity_estimate_becomes_the_drift_and_leaves_little_error():
    track = track_for(6.0, 0.06, bias=(0.02, -0.01, 0.015))
    truth, _ = seen_at(6.0)
    np.testing.assert_allclose(track.drifts[0], [0.02, -0.01, 0.015], atol=3e-3)
    assert np.linalg.norm(track.pose[:3, 3] - truth[:3, 3]) < 1.5e-3


def test_the_objects_own_motion_is_followed():
    track = track_for(4.0, 0.06, drift=(0.05, 0.0, 0.0))
    truth, _ = seen_at(4.0, (0.05, 0.0, 0.0))
    assert np.linalg.norm(track.pose[:3, 3] - truth[:3, 3]) < 1.5e-3
    np.testing.assert_allclose(track.drifts[0], [0.05, 0.0, 0.0], atol=4e-3)


def test_noise_of_single_images_is_averaged():
    errors = []
    for end in np.arange(3.0, 5.0, 0.2):
        track = track_for(end, 0.06, noise=0.004)
        errors.append(np.linalg.norm(track.pose[:3, 3] - seen_at(end)[0][:3, 3]))
    assert np.sqrt(np.mean(np.square(errors))) < 0.75 * 0.004 * math.sqrt(3.0)


def test_without_images_the_pose_goes_on_by_odometry():
    track = track_for(3.0, 0.0)
    T, seat = seen_at(3.0)
    for k in range(1, 26):
        rpy, _, speed = body_at(3.0 + k * DT)
        track = update_track(track, T, seat[None], k * DT, rpy, matrix_from_rpy(rpy).T @ speed, TrackSettings())
    assert track.image == 150  # the first of them; it only grew older
    assert np.linalg.norm(track.pose[:3, 3] - seen_at(3.5)[0][:3, 3]) < 2e-3


def test_an_image_older_than_what_is_remembered_is_not_believed():
    track = track_for(2.0, 0.0)
    rpy, _, speed = body_at(2.0)
    T, seat = seen_at(2.0)
    far = T.copy()
    far[:3, 3] += 1.0
    after = update_track(track, far, seat[None], REMEMBERED * DT, rpy, matrix_from_rpy(rpy).T @ speed, TrackSettings())
    np.testing.assert_allclose(after.points, track.points + DT * track.drifts)


def test_a_step_leaves_the_track_before_it_alone():
    track = track_for(0.5, 0.06)
    copies = [np.array(part) for part in track[2:]]
    T, seat = seen_at(0.52)
    rpy, _, speed = body_at(0.52)
    update_track(track, T, seat[None], 0.0, rpy, speed, TrackSettings())
    for part, copy in zip(track[2:], copies, strict=True):
        np.testing.assert_array_equal(part, copy)


def test_twist_of_a_fixed_target_is_the_finite_difference_of_its_pose():
    t, h = 1.3, 1e-5
    before, now, after = (seen_at(t + s)[0] for s in (-h, 0.0, h))
    rpy, _, speed = body_at(t)
    R, R_later = matrix_from_rpy(rpy), matrix_from_rpy(body_at(t + h)[0])
    spin = np.array([(R.T @ R_later)[k] for k in ((2, 1), (0, 2), (1, 0))]) / h
    twist = target_twist(now, np.zeros(3), R.T @ speed, spin)
    np.testing.assert_allclose(twist[:3], (after - before)[:3, 3] / (2 * h), atol=1e-4)
    change = after[:3, :3] @ before[:3, :3].T
    np.testing.assert_allclose(twist[3:], np.array([change[2, 1], change[0, 2], change[1, 0]]) / (2 * h), atol=1e-3)


ARM = Arm.hecatonquiros_6dof()
HOME = np.radians([0.0, 10.0, -80.0, 0.0, 70.0, 0.0])


def test_rates_move_the_tool_towards_the_target_as_fast_as_the_gain_says():
    T = ARM.forward(HOME)
    T_target = T.copy()
    T_target[:3, 3] += [0.004, -0.003, 0.002]
    step = servo_rates(ARM, HOME, np.zeros(6), T_target, np.zeros(6), ServoSettings(gain=5.0))
    np.testing.assert_allclose(step.error[:3], [0.004, -0.003, 0.002], atol=1e-12)
    moved = ARM.jacobian(HOME) @ step.rates
    np.testing.assert_allclose(moved[:3], 5.0 * step.error[:3], rtol=1e-3)
    np.testing.assert_allclose(moved[3:], 0.0, atol=1e-5)
    assert step.singular > 0.0


def test_a_moving_target_is_followed_without_lag_by_the_feed_forward():
    settings, q = ServoSettings(), HOME.copy()
    start = ARM.forward(HOME)
    speed = np.array([0.06, 0.05, -0.06])
    for forward in (True, False):
        q = HOME.copy()
        for k in range(60):
            T = start.copy()
            T[:3, 3] += speed * k * DT
            twist = np.concatenate([speed, np.zeros(3)]) if forward else np.zeros(6)
            q = q + DT * servo_rates(ARM, q, np.zeros(6), T, twist, settings).rates
        T[:3, 3] = start[:3, 3] + speed * 60 * DT
        error = np.linalg.norm(ARM.forward(q)[:3, 3] - T[:3, 3])
        assert error < 1e-3 if forward else error > 0.005


def test_rates_stay_within_limits_near_singularities_and_joint_limits():
    rng = np.random.default_rng(5)
    settings = ServoSettings()
    for _ in range(200):
        q = rng.uniform(ARM.limits[:, 0], ARM.limits[:, 1])
        q[rng.integers(6)] = 0.0  # straight wrists and elbows among them
        q[rng.integers(6)] = ARM.limits[0, rng.integers(2)]
        T = ARM.forward(rng.uniform(ARM.limits[:, 0], ARM.limits[:, 1]))
        rates = servo_rates(ARM, q, np.zeros(6), T, rng.uniform(-0.5, 0.5, 6), settings).rates
        assert np.isfinite(rates).all() and np.abs(rates).max() <= settings.rate * (1 + 1e-9)
        after = q + DT * rates
        assert (after >= ARM.limits[:, 0] - 1e-12).all() and (after <= ARM.limits[:, 1] + 1e-12).all()


def test_a_joint_that_lags_far_behind_is_not_commanded_farther():
    T = ARM.forward(HOME + [0.0, 0.3, 0.3, 0.0, 0.0, 0.0])
    free = servo_rates(ARM, HOME, np.zeros(6), T, np.zeros(6), ServoSettings()).rates
    lag = 0.3 * np.sign(free)
    assert np.abs(free).max() > 0.1
    np.testing.assert_array_equal(servo_rates(ARM, HOME, lag, T, np.zeros(6), ServoSettings()).rates, 0.0)
    np.testing.assert_allclose(servo_rates(ARM, HOME, -lag, T, np.zeros(6), ServoSettings()).rates, free)


def test_joints_arrive_together_and_none_is_too_fast():
    rates = joint_rates(np.zeros(3), [1.0, -0.5, 0.0], 1.2)
    np.testing.assert_allclose(rates, [1.2, -0.6, 0.0])
    np.testing.assert_allclose(joint_rates(np.zeros(2), [0.01, 0.0], 1.2, gain=4.0), [0.04, 0.0])
    np.testing.assert_array_equal(joint_rates(np.ones(2), np.ones(2), 1.0), 0.0)


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda: TrackSettings(position_gain=1.2), "position_gain"),
        (lambda: TrackSettings(step=0.0), "step"),
        (lambda: ServoSettings(gain=-1.0), "gain"),
        (lambda: start_track(np.eye(3), SEAT[None], np.zeros(3), np.zeros(3)), "T_body_object"),
        (lambda: start_track(np.eye(4), SEAT[None], np.full(3, np.nan), np.zeros(3)), "rpy"),
        (lambda: servo_rates(ARM, np.zeros(5), np.zeros(6), np.eye(4), np.zeros(6), ServoSettings()), "q"),
        (
            lambda: servo_rates(ARM, HOME, np.zeros(6), np.full((4, 4), np.nan), np.zeros(6), ServoSettings()),
            "T_target",
        ),
    ],
)
def test_bad_input_is_refused_by_name(make, name):
    with pytest.raises(ValueError, match=name):
        make()


@pytest.mark.parametrize("age", [-0.1, np.nan, np.inf])
def test_an_age_must_be_a_time(age):
    track = track_for(0.1, 0.0)
    with pytest.raises(ValueError, match="age"):
        update_track(track, np.eye(4), SEAT[None], age, np.zeros(3), np.zeros(3), TrackSettings())
