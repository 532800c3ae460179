"""Detect-v0: what it shows, what it scores, and how the vehicle that carries its camera flies."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import trimesh

from aerograsp_env import spatial as sp
from aerograsp_env.envs.detect import DetectEnv
from aerograsp_env.envs.detect_action import detections_to_action, observed_frame, observed_intrinsics
from aerograsp_env.envs.detect_motion import DISTANCE, TILT, camera_mount, draw_start
from aerograsp_env.envs.detect_outcome import Outcome, reward_terms
from aerograsp_env.envs.detect_view import draw_detections, label_color
from aerograsp_env.interfaces import Detection, Intrinsics
from aerograsp_env.metrics import PoseModel, TrueObject, score_frame
from aerograsp_env.sim.flight import Flight, Reference
from aerograsp_env.sim.rgbd_camera import RGBDCameraConfig
from aerograsp_env.sim.visual import CLASSES
from aerograsp_env.sim.wind import WIND_LEVELS
from baselines.policies.detect import truth

SMALL = RGBDCameraConfig(width=96, height=72)
BOX = np.array([10.0, 10.0, 50.0, 50.0])
CUBE = PoseModel(np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * 0.1, 0.35, np.eye(3)[None])


def pose(x: float = 0.0, turn: float = 0.0) -> np.ndarray:
    return sp.transform(sp.so3_exp([0.0, 0.0, turn]), [x, 0.0, 1.0])


def true(difficult: bool = False) -> TrueObject:
    return TrueObject("can", BOX, pose(), CUBE, difficult, 0)


def play(env: DetectEnv, policy: Any, seed: int, steps: int) -> tuple[float, dict[str, Any]]:
    observation, info = env.reset(seed=seed)
    state, total = None, 0.0
    for _ in range(steps):
        action, state = policy.predict(observation, state)
        observation, reward, _, _, info = env.step(action)
        total += reward
    return total, info


# the task -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("sensors", ["rgbd", "stereo"])
def test_the_truth_scores_full_marks_and_nothing_scores_none(sensors: str) -> None:
    env, oracle = DetectEnv(camera_config=SMALL, labels=("can", "box"), sensors=sensors), truth()
    oracle.watch([env])
    total, info = play(env, oracle, 1, 4)
    assert total == pytest.approx(4.0, abs=1e-4)
    assert info["success"] is True
    metrics = info["metrics"]
    shares = ("map50", "map75", "recall", "precision", "f1", "add_s")
    assert {name: metrics[name] for name in shares} == dict.fromkeys(shares, 1.0)
    assert metrics["position_error"] < 1e-6 and metrics["rotation_error"] < 1e-6 and metrics["jumps"] == 0.0
    env.reset(seed=1)
    *_, info = env.step(np.zeros(184, np.float32))
    assert info["success"] is False and info["metrics"]["f1"] == 0.0
    assert info["reward_terms"] == {"found": 0.0, "position": 0.0, "rotation": 0.0}


def test_random_reports_fail() -> None:
    env = gymnasium.make("aerograsp/Detect-v0", camera_config=SMALL, labels=("can", "box"), max_episode_steps=4)
    env.action_space.seed(0)
    for seed in range(2):
        env.reset(seed=seed)
        for _ in range(4):
            *_, truncated, info = env.step(env.action_space.sample())
        assert truncated and info["success"] is False


def test_what_is_scored_is_the_frame_that_was_seen() -> None:
    env = DetectEnv(camera_config=SMALL, labels=("can", "box"), motion="pass", wind="gusty")
    observation, _ = env.reset(seed=2)
    for _ in range(3):
        seen = [Detection(t.label, 1.0, t.box, t.T_c_object) for t in env.truths if not t.difficult]
        before = env.T_world_camera
        observation, _, _, _, info = env.step(detections_to_action(seen, observed_intrinsics(observation)))
        assert not np.allclose(before, env.T_world_camera, atol=1e-4)  # and since then it has moved
    assert info["metrics"]["position_error"] < 1e-6


def test_depth_shows_the_objects_where_their_poses_are() -> None:
    env = DetectEnv(camera_config=RGBDCameraConfig(width=160, height=120), labels=("box",))
    observation, _ = env.reset(seed=4)
    frame = observed_frame(observation)
    checked = 0
    for item in env.truths:
        if item.difficult or item.T_c_object is None or item.model is None:
            continue
        x1, y1, x2, y2 = item.box.astype(int)
        depth = frame.depth[(y1 + y2) // 2, (x1 + x2) // 2]
        if depth > 0.0:
            assert abs(depth - item.T_c_object[2, 3]) < 0.6 * item.model.diameter
            checked += 1
    assert checked


def test_reset_options() -> None:
    env = DetectEnv(camera_config=SMALL, labels=("can",))
    for motion in ("hover", "pass", "orbit"):
        env.reset(seed=0, options={"motion": motion, "wind_direction": 1.0})
        assert env.motion == motion
    for options, word in (
        ({"moton": "hover"}, "moton"),
        ({"motion": "dance"}, "motion"),
        ({"wind_direction": np.nan}, "wind"),
    ):
        with pytest.raises(ValueError, match=word):
            env.reset(seed=0, options=options)


def test_a_users_mesh_is_what_there_is_to_see(tmp_path: Path) -> None:
    trimesh.creation.box((0.3, 0.2, 0.1)).export(tmp_path / "brick.obj")
    env = DetectEnv(camera_config=SMALL, labels="box", mesh=tmp_path / "brick.obj")
    for seed in range(3):
        env.reset(seed=seed)
        for item in env.truths:
            assert item.label == "box" and item.model is not None
            assert item.model.diameter == pytest.approx(np.linalg.norm([0.3, 0.2, 0.1]))


def test_pictures_show_what_was_reported() -> None:
    env = DetectEnv(render_mode="rgb_array", width=192, height=144, camera_config=SMALL, labels=("can", "box"))
    observation, _ = env.reset(seed=1)
    plain = env.render()
    found = [Detection("hammer", 0.5, np.array([20.0, 20.0, 60.0, 50.0]), pose())]
    env.step(detections_to_action(found, observed_intrinsics(observation)))
    drawn = env.render()
    assert plain.shape == drawn.shape == (144, 192, 3)
    changed = (plain != drawn).any(axis=2)
    np.testing.assert_array_equal(drawn[80, 40], label_color("hammer"))  # the box's left edge
    assert not changed[:20].any() and not changed[:, 150:].any()
    depth = DetectEnv(render_mode="depth_array", width=192, height=144, camera_config=SMALL, labels=("can",))
    depth.reset(seed=1)
    picture = depth.render()
    assert picture.shape == (144, 192) and picture.dtype == np.float32 and picture.max() > 0.3


def test_axes_are_drawn_where_they_project_to() -> None:
    camera = Intrinsics(200, 100, 100.0, 100.0, 99.5, 49.5)
    T = sp.transform(np.eye(3), [0.0, 0.0, 1.0])
    found = [Detection(CLASSES[0], 1.0, np.array([90.0, 40.0, 110.0, 60.0]), T)]
    picture = draw_detections(np.zeros((100, 200, 3), np.uint8), found, camera, axis_length=0.3)
    assert picture[50, 118].tolist() == pytest.approx([230, 60, 50], abs=60)  # along x: red
    assert picture[72, 100].tolist() == pytest.approx([60, 190, 70], abs=60)  # along y, down: green
    with pytest.raises(ValueError, match="rgb: expected shape"):
        draw_detections(np.zeros((10, 10, 3), np.uint8), found, camera)


# rewards and outcomes -----------------------------------------------------------------------------


def test_rewards_by_hand() -> None:
    near = Detection("can", 1.0, BOX, pose(0.01, np.radians(10.0)))
    wrong = Detection("box", 1.0, BOX, pose())
    terms = reward_terms(score_frame([near, wrong], [true()]), "dense")
    assert terms["found"] == pytest.approx(0.5 * 2 / 3)
    assert terms["position"] == pytest.approx(0.25 * (1 - 0.9 * 0.01 / 0.05))
    assert terms["rotation"] == pytest.approx(0.25 * (1 - 0.9 * 10.0 / 30.0))
    assert reward_terms(score_frame([near], [true()]), "sparse") == {"within": 1.0}
    assert reward_terms(score_frame([near, wrong], [true()]), "sparse") == {"within": 0.0}  # F1 is 2/3
    far = Detection("can", 1.0, BOX, pose(0.03))
    assert reward_terms(score_frame([far], [true()]), "sparse") == {"within": 0.0}
    boxed = Detection("can", 1.0, BOX)
    assert reward_terms(score_frame([boxed], [true()]), "dense") == {"found": 0.5, "position": 0.0, "rotation": 0.0}
    assert reward_terms(score_frame([boxed], [true()]), "sparse") == {"within": 0.0}
    for truths in ([], [true(difficult=True)]):
        assert reward_terms(score_frame([], truths), "dense")["found"] == 0.5
    assert reward_terms(score_frame([wrong], []), "dense")["found"] == 0.0


def test_outcomes_pool_frames_and_count_jumps() -> None:
    outcome = Outcome("dense")
    nothing = {"found": 0.0, "position": 0.0, "rotation": 0.0}
    assert outcome.info("") == {"success": False, "reward_terms": nothing, "metrics": {}, "termination": ""}
    camera = sp.transform(np.eye(3), np.zeros(3))
    for turn in (0.0, 1.0, 1.1, 0.0):
        outcome.add([Detection("can", 1.0, BOX, pose(0.0, turn))], [true()], camera)
    assert outcome.info("")["metrics"]["jumps"] == 2.0
    assert outcome.info("")["success"] is True
    assert outcome.info("diverged")["success"] is False
    for _ in range(2):
        outcome.add([], [true()], camera)
    # Four of six found, nothing false: F1 is 0.8; the next miss leaves 8/11, the one after that 8/12.
    for expected, success in ((0.8, True), (8 / 11, True), (8 / 12, False)):
        assert outcome.info("")["metrics"]["f1"] == pytest.approx(expected)
        assert outcome.info("")["success"] is success
        outcome.add([], [true()], camera)


# flight -------------------------------------------------------------------------------------------


def test_the_camera_looks_at_its_target_whatever_the_motion() -> None:
    target = np.array([0.2, -0.1, 0.7])
    for seed in range(12):
        start = draw_start("any", target, 4.0, np.random.default_rng(seed))
        middle = start.path(2.0)
        turn = sp.so3_exp([0.0, 0.0, _yaw(start.path, 2.0)])
        T = start.T_world_start @ sp.transform(turn, middle.position) @ camera_mount(start.tilt)
        at = (sp.inverse(T) @ [*target, 1.0])[:3]
        assert TILT[0] <= start.tilt <= TILT[1]
        assert DISTANCE[0] - 0.3 < at[2] < DISTANCE[1] + 0.3
        assert np.abs(at[:2] / at[2]).max() < 0.25, (start.motion, at)


def _yaw(path: Any, time: float) -> float:
    times = np.linspace(0.0, time, 101)
    return float(np.trapezoid([path(t).yaw_rate for t in times], times))


def test_paths_are_the_integral_of_their_velocity() -> None:
    for seed in range(6):
        path = draw_start("any", np.zeros(3), 4.0, np.random.default_rng(seed)).path
        np.testing.assert_array_equal(path(0.0).position, 0.0)
        for t in (0.2, 0.8, 3.0):
            slope = (path(t + 1e-5).position - path(t - 1e-5).position) / 2e-5
            np.testing.assert_allclose(path(t).velocity, slope, atol=1e-6)


def test_the_vehicle_follows_its_path_in_wind() -> None:
    flight, velocity = Flight(WIND_LEVELS["gusty"]), np.array([0.1, 0.2, 0.0])
    rng = np.random.default_rng(0)
    flight.reset(rng)
    np.testing.assert_allclose(flight.T_start_body(), np.eye(4), atol=1e-12)
    flight.advance(lambda t: Reference(t * velocity, velocity, 0.2), 4.0, rng)
    T = flight.T_start_body()
    assert np.linalg.norm(T[:3, 3] - 4.0 * velocity) < 0.25
    roll, pitch, yaw = sp.rpy_from_matrix(T[:3, :3])
    assert yaw == pytest.approx(0.8, abs=0.1) and abs(roll) < 0.3 and abs(pitch) < 0.3
    readings = flight.readings()
    twist = flight.twist_b()
    np.testing.assert_allclose(readings["velocity"], twist[:3], atol=0.15)
    np.testing.assert_allclose(readings["angular_velocity"], twist[3:], atol=0.1)
    np.testing.assert_allclose(readings["attitude"], [roll, pitch, yaw], atol=0.05)
    assert flight.termination == ""
    flight.close()


# OpenGL -------------------------------------------------------------------------------------------

COMPARE = """
import json
try:
    import mujoco
except Exception as error:  # it cannot even be imported without libEGL
    print(json.dumps(str(error)))
    raise SystemExit
from dataclasses import replace
import numpy as np
from aerograsp_env.envs.detect import DetectEnv
from aerograsp_env.envs.detect_action import ACTION_SIZE
from aerograsp_env.sim.gl_probe import gl_fault
from aerograsp_env.sim.rgbd_camera import RGBDCameraConfig
fault = gl_fault()
if fault is not None:
    print(json.dumps(fault))
    raise SystemExit
camera = replace(RGBDCameraConfig.ideal(160, 120, 0.8), max_depth=6.0)
envs = [DetectEnv(camera_config=camera, camera_backend=backend) for backend in ("ray", "gl")]
seen = [[env.reset(seed=0)[0] for env in envs]]
for _ in range(2):
    steps = [env.step(np.zeros(ACTION_SIZE)) for env in envs]
    assert steps[0][1] == steps[1][1], "what is true of the frames is the same"
    seen.append([step[0] for step in steps])
for env in envs:
    env.close()
found = []
for a, b in seen:
    assert all((a[name] == b[name]).all() for name in a if name not in ("rgb", "depth"))
    both = (a["depth"] > 0) & (b["depth"] > 0)
    rgb = [one["rgb"].astype(float) for one in (a, b)]
    found.append([
        float(np.median(np.abs(a["depth"] - b["depth"])[both])), float(both.mean()),
        float(np.abs(rgb[0] - rgb[1]).mean()), float(np.corrcoef(rgb[0].ravel(), rgb[1].ravel())[0, 1]),
    ])
print(json.dumps(found))
"""


def test_opengl_shows_the_same_episode() -> None:
    environment = {**os.environ, "MUJOCO_GL": "egl"}
    done = subprocess.run([sys.executable, "-c", COMPARE], env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    if isinstance(found, str):
        pytest.skip(f"OpenGL (EGL) does not work here: {found}")
    for depth, seen, color, alike in found:
        assert depth < 1e-3 and seen > 0.9  # [m]
        assert color < 40 and alike > 0.9  # of 255: the lights are MuJoCo's own
