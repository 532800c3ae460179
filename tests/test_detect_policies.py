"""The analytic policies of Detect-v0 and what they are made of."""

from __future__ import annotations

import copy
from pathlib import Path

import numpy as np
import pytest

from aerograsp_env import spatial as sp
from aerograsp_env.envs.detect import DetectEnv
from aerograsp_env.envs.detect_action import action_to_detections, observed_intrinsics
from aerograsp_env.envs.detect_motion import camera_mount
from aerograsp_env.interfaces import RGBD, Intrinsics
from aerograsp_env.metrics import rotation_error
from aerograsp_env.sim.visual import CLASSES
from aerograsp_env.sim.visual.objects import nominal_object
from agents.detect_forest import accuracy, grow
from baselines.policies.detect import clusters_icp, seen_frame, truth
from baselines.policies.detect_descriptors import FEATURES, describe
from baselines.policies.detect_pose import fit_pose
from baselines.policies.detect_proposals import Proposal, find_proposals, find_surfaces
from baselines.policies.detect_recognition import NAMES, Forest, shipped
from baselines.policies.detect_tracks import FRAME, Odometry, Track, associate

CAMERA = Intrinsics(160, 120, 130.0, 130.0, 79.5, 59.5)
DOWN = np.diag([1.0, -1.0, -1.0])  # R_world_camera of one that looks down
UP = np.array([0.0, 0.0, -1.0])  # in its frame


def looking_down(height: float = 1.0, block: tuple[float, float, float] = (0.06, 0.04, 0.05)) -> RGBD:
    """A block, of half-sides and height `block`, on the floor below a camera, with the floor's texture grey."""
    rows, columns = np.mgrid[: CAMERA.height, : CAMERA.width]
    x, y = (columns - CAMERA.cx) / CAMERA.fx, (rows - CAMERA.cy) / CAMERA.fy
    top = height - block[2]
    on = (np.abs(x * top) < block[0]) & (np.abs(y * top) < block[1])
    rgb = np.where(on[..., None], np.uint8([200, 40, 30]), np.uint8([120, 120, 120])).astype(np.uint8)
    return RGBD(rgb, np.where(on, top, height).astype(np.float32), CAMERA)


# proposals ----------------------------------------------------------------------------------------


def test_a_block_on_a_floor_is_proposed_with_its_box_and_size() -> None:
    frame = looking_down()
    (found,) = find_proposals(frame, UP, np.random.default_rng(0))
    half = CAMERA.fx * np.array([0.06, 0.04]) / 0.95
    expected = [
        CAMERA.cx + 0.5 - half[0],
        CAMERA.cy + 0.5 - half[1],
        CAMERA.cx + 0.5 + half[0],
        CAMERA.cy + 0.5 + half[1],
    ]
    np.testing.assert_allclose(found.box, expected, atol=1.5)
    assert found.floor == pytest.approx(-1.0, abs=2e-3)
    np.testing.assert_allclose(found.up, UP, atol=0.01)
    description = describe(found, 1.0 / (CAMERA.fx * CAMERA.fy))
    np.testing.assert_allclose(description.extents, [0.12, 0.08, 0.05], atol=0.012)
    np.testing.assert_allclose(description.T_c_box[:3, 3], [0.0, 0.0, 0.975], atol=0.006)
    assert abs(description.T_c_box[0, 0]) > 0.99 and description.T_c_box[2, 2] == pytest.approx(-1.0, abs=0.01)
    assert description.features.shape == (FEATURES,) and np.isfinite(description.features).all()


def test_nothing_is_proposed_where_nothing_stands_out_or_nothing_is_seen() -> None:
    empty = looking_down(block=(0.0, 0.0, 0.0))
    assert find_proposals(empty, UP, np.random.default_rng(0)) == []
    blind = RGBD(empty.rgb, np.zeros_like(empty.depth), CAMERA)
    assert find_proposals(blind, UP, np.random.default_rng(0)) == []


def test_a_pipe_is_a_surface_to_lie_on() -> None:
    rng = np.random.default_rng(0)
    turn, along = rng.uniform(-1.2, 1.2, 4000), rng.uniform(-0.8, 0.8, 4000)
    world = np.stack([0.2 * np.sin(turn), along, 0.2 * np.cos(turn)], axis=1) + 0.001 * rng.normal(size=(4000, 3))
    points = (world - [0.0, 0.0, 1.3]) @ DOWN  # seen from 1.1 m over its top
    pipes = [surface for surface in find_surfaces(points, UP, rng) if surface.axis is not None]
    assert len(pipes) == 1
    assert pipes[0].radius == pytest.approx(0.2, abs=0.01)
    assert abs(float(pipes[0].axis @ [0.0, 1.0, 0.0])) > 0.99
    assert np.abs(pipes[0].height(points)).mean() < 0.005
    assert pipes[0].offset == pytest.approx(float(UP @ [0.0, 0.0, 1.1]), abs=0.01)


# recognition --------------------------------------------------------------------------------------


def test_a_forest_learns_saves_and_refuses(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    labels = np.array(NAMES)[rng.integers(0, len(NAMES), 600)]
    centers = rng.normal(size=(len(NAMES), FEATURES))
    x = centers[[NAMES.index(label) for label in labels]] + 0.3 * rng.normal(size=(600, FEATURES))
    forest = grow(x[:500], labels[:500])
    objects, nothing = accuracy(forest, x[500:], labels[500:])
    assert objects > 0.9 and nothing > 0.8
    p = np.exp(forest.log_probabilities(x[0]))
    assert p.shape == (len(NAMES),) and p.sum() == pytest.approx(1.0, abs=0.06) and (p > 0).all()
    forest.save(tmp_path / "forest.npz")
    again = Forest.load(tmp_path / "forest.npz")
    np.testing.assert_array_equal(again.log_probabilities(x[1]), forest.log_probabilities(x[1]))
    with pytest.raises(ValueError, match="none of"):
        grow(x[labels != "can"], labels[labels != "can"])
    np.savez(tmp_path / "other.npz", roots=np.zeros(3))
    with pytest.raises(ValueError, match="without feature"):
        Forest.load(tmp_path / "other.npz")
    with pytest.raises(ValueError, match="nodes: expected"):
        Forest(again.roots, again.feature, again.threshold[:-1], again.children, again.votes)


def test_the_shipped_forest_fits_the_descriptors() -> None:
    assert int(shipped().feature.max()) < FEATURES
    assert shipped() is shipped()


# poses --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("label", ["can", "hammer", "crawler", "screwdriver"])
def test_a_nominal_object_on_a_floor_is_posed(label: str) -> None:
    item, rng = nominal_object(label), np.random.default_rng(1)
    points, normals, colors = item.surface(6000, rng)
    for yaw in (0.4, 2.0):
        R = sp.so3_exp([0.0, 0.0, yaw])
        lowest = (item.vertices @ R.T)[:, 2].min()
        T = sp.transform(R, [0.05, -0.03, -lowest])
        T_camera_world = sp.inverse(sp.transform(DOWN, [-0.3, 0.2, 1.1]))
        T_c_object = T_camera_world @ T
        seen = sp.transform_points(T_c_object, points)
        facing = (seen * (normals @ T_c_object[:3, :3].T)).sum(axis=1) < 0.0
        visible = seen[facing] + 0.001 * rng.normal(size=(int(facing.sum()), 3))
        proposal = Proposal(visible, colors[facing], np.array([0.0, 0.0, 9.0, 9.0]), UP, -1.1)
        fit = fit_pose(label, proposal, describe(proposal, 1e-4))
        assert np.linalg.norm(fit.T_c_object[:3, 3] - T_c_object[:3, 3]) < 0.012, yaw
        assert rotation_error(fit.T_c_object, T_c_object, item.symmetries) < np.radians(12.0), yaw


# tracks -------------------------------------------------------------------------------------------


def test_odometry_integrates_the_estimates() -> None:
    odometry, T = Odometry.begin(), np.eye(4)
    observation = {"attitude": np.array([0.0, 0.0, np.pi / 2]), "velocity": np.array([0.5, 0.0, 0.0])}
    observation["camera_tilt"] = np.array([0.8])
    for k in range(11):
        odometry, T = odometry.advance(observation, k == 0)
    body = T @ sp.inverse(camera_mount(0.8))
    np.testing.assert_allclose(body[:3, 3], [0.0, 0.5, 0.0], atol=1e-12)  # 1 s forward, which is the start's y
    np.testing.assert_allclose(body[:3, :3], sp.so3_exp([0.0, 0.0, np.pi / 2]), atol=1e-12)
    assert odometry.stamp == pytest.approx(10 * FRAME)


def test_places_go_to_the_nearest_free_tracks() -> None:
    tracks = tuple(Track(np.array([x, 0.0, 0.0]), np.zeros(10), 1, 0) for x in (0.0, 0.1))
    places = np.array([[0.06, 0.0, 0.0], [0.09, 0.0, 0.0], [1.0, 0.0, 0.0]])
    assert associate(tracks, places, 0.08) == [0, 1, -1]
    assert associate((), places, 0.08) == [-1, -1, -1]
    assert associate(tracks, np.zeros((0, 3)), 0.08) == []


# policies -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def flown() -> tuple[DetectEnv, list[dict]]:
    env = DetectEnv(labels=("can", "fruit"), wind="calm")
    observation, _ = env.reset(seed=1)
    observations = [observation]
    for _ in range(2):
        observations.append(env.step(np.zeros(184, np.float32))[0])
    return env, observations


def test_clusters_icp_keeps_its_state_outside_and_takes_batches(flown: tuple[DetectEnv, list[dict]]) -> None:
    _, observations = flown
    policy, state, actions = clusters_icp(), None, []
    for observation in observations:
        before = copy.deepcopy(state)
        action, following = policy.predict(observation, state)
        again, _ = policy.predict(observation, before)
        np.testing.assert_array_equal(action, again)
        assert action.shape == (184,) and action.dtype == np.float32 and np.abs(action).max() <= 1.0
        actions.append(action)
        state = following
    batch = {name: np.stack([observations[0][name], observations[1][name]]) for name in observations[0]}
    both, rows = policy.predict(batch, None, np.array([True, True]))
    np.testing.assert_array_equal(both[0], actions[0])
    restarted, _ = policy.predict(batch, rows, np.array([True, True]))
    np.testing.assert_array_equal(restarted, both)


def test_clusters_icp_finds_most_of_an_easy_scene(flown: tuple[DetectEnv, list[dict]]) -> None:
    _, observations = flown
    state = None
    for observation in observations:
        action, state = clusters_icp().predict(observation, state)
    found = action_to_detections(action, observed_intrinsics(observations[-1]))
    assert found and all(item.label in CLASSES and item.T_c_object is not None for item in found)


def test_a_stereo_pair_gives_depth() -> None:
    rng = np.random.default_rng(0)
    texture = rng.integers(0, 255, (120, 200, 3), dtype=np.uint8)
    observation = {
        "rgb": texture[:, 20:180], "right": texture[:, 32:192],  # a disparity of 12 px
        "intrinsics": np.array([130.0, 130.0, 79.5, 59.5]), "baseline": np.array([0.12]),
    }  # fmt: skip
    depth = seen_frame(observation).depth
    assert np.median(depth[depth > 0]) == pytest.approx(130.0 * 0.12 / 12.0, rel=0.02)


def test_the_oracle_must_be_told_of_its_worlds(flown: tuple[DetectEnv, list[dict]]) -> None:
    env, observations = flown
    oracle = truth()
    with pytest.raises(ValueError, match="watch: expected to be told of 1 worlds"):
        oracle.predict(observations[-1])
    oracle.watch([env])
    action, _ = oracle.predict(observations[-1])
    found = action_to_detections(action, observed_intrinsics(observations[-1]))
    assert len(found) == sum(not item.difficult for item in env.truths)
