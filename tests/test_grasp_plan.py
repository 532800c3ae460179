"""GraspPlan-v0: what is seen, how actions and grasps translate, the episode's one step, and its pictures."""

from __future__ import annotations

import math
import re

import gymnasium
import numpy as np
import pytest
import trimesh
from grasp_worlds import X, Z, box, cylinder, grasp
from scipy.spatial.transform import Rotation

import aerograsp_env  # noqa: F401  registers the ids
from aerograsp_env.envs import grasp_start
from aerograsp_env.envs.grasp_options import draw_orientation, draw_view
from aerograsp_env.envs.grasp_plan import GraspPlanEnv, decode_action, encode_grasp, unpack_cloud
from aerograsp_env.envs.grasp_start import VIEWS
from aerograsp_env.interfaces import Grasp
from aerograsp_env.sim.cameras import camera_view
from aerograsp_env.sim.depth_view import DepthCameraConfig, UnseenError, look_at, middle_and_radius, partial_view
from aerograsp_env.sim.grasp_judge import record_grasp
from aerograsp_env.sim.grasp_view import GraspView
from aerograsp_env.sim.gripper import GripperConfig
from aerograsp_env.sim.objects import test_objects as named_objects
from aerograsp_env.spatial import inverse, transform_points

PLAN = "aerograsp/GraspPlan-v0"
PERFECT = DepthCameraConfig(sigma=0.0, sigma_quadratic=0.0, occluded_probability=0.0)
SMALL = {"width": 96, "height": 72}


def make(**options) -> GraspPlanEnv:
    env = gymnasium.make(PLAN, **options).unwrapped
    assert isinstance(env, GraspPlanEnv)
    return env


def good_grasp(env: GraspPlanEnv) -> Grasp:
    """Across the middle of a box or cylinder of `grasp_worlds`."""
    T = env.T_cloud_object
    closing, approach = T[:3, 0], T[:3, 1]
    return Grasp(T[:3, 3], closing / np.linalg.norm(closing), approach / np.linalg.norm(approach), 0.09)


# what is seen ---------------------------------------------------------------------------------------


def box_distance(points: np.ndarray, half: np.ndarray) -> np.ndarray:
    """Signed distance of points (N, 3) to the surface of a box about the origin."""
    excess = np.abs(points) - half
    return np.linalg.norm(np.maximum(excess, 0.0), axis=1) + np.minimum(excess.max(axis=1), 0.0)


@pytest.mark.parametrize("seed", range(4))
def test_without_noise_the_points_lie_on_the_surface_and_normals_are_its_own(seed):
    rng, half = np.random.default_rng(seed), np.array([0.025, 0.03, 0.06])
    view = partial_view(box(), draw_orientation(rng), draw_view(rng), 512, PERFECT, rng)
    local = transform_points(inverse(view.T_cloud_object), view.points)
    assert np.abs(box_distance(local, half)).max() < 1e-8  # MuJoCo keeps vertices in single precision
    normals = view.normals @ view.T_cloud_object[:3, :3]
    inner = (np.sort(half - np.abs(local), axis=1)[:, 1]) > 0.0125  # whose patch lies within one face
    face = np.argmin(half - np.abs(local), axis=1)
    aligned = np.abs(normals[np.arange(512), face])
    assert inner.sum() > 100 and aligned[inner].min() > 1.0 - 1e-7
    facing = np.einsum("ij,ij->i", view.normals, view.viewpoint - view.points)
    assert (facing >= 0.0).all()
    np.testing.assert_allclose(np.linalg.norm(view.normals, axis=1), 1.0, rtol=1e-12)
    assert (view.noise == 0.0).all()


def test_nothing_is_seen_through_the_object():
    rng = np.random.default_rng(0)
    view = partial_view(cylinder(), np.eye(3), X, 512, PERFECT, rng)
    local = transform_points(inverse(view.T_cloud_object), view.points)
    assert (local[:, 0] > 0.0).all()
    np.testing.assert_allclose(np.hypot(local[:, 0], local[:, 1]), 0.03, atol=1e-4)  # of 48 sides


def test_the_noise_has_the_stated_spread_along_the_rays():
    camera = DepthCameraConfig(sigma=0.001, sigma_quadratic=0.002, occluded_probability=0.0)
    rng, errors = np.random.default_rng(1), []
    for _ in range(20):
        view = partial_view(box((0.10, 0.10, 0.02)), np.eye(3), Z, 512, camera, rng)
        depth = view.viewpoint[2] - view.points[:, 2]
        errors.append((depth - 0.49) / (0.001 + 0.002 * (0.49 / 0.5) ** 2))
        ray = np.linalg.norm(view.points - view.viewpoint, axis=1) / depth
        np.testing.assert_allclose(view.noise, ray * (0.001 + 0.002 * (0.49 / 0.5) ** 2), rtol=1e-6)
    errors = np.concatenate(errors)
    assert np.std(errors) == pytest.approx(1.0, abs=0.03) and np.mean(errors) == pytest.approx(0.0, abs=0.05)


def test_the_frame_is_level_and_centred_and_knows_where_the_object_is():
    rng = np.random.default_rng(2)
    R, direction = draw_orientation(rng), draw_view(rng)
    item = named_objects()[0]
    view = partial_view(item, R, direction, 512, DepthCameraConfig(), rng)
    np.testing.assert_allclose(view.points.mean(axis=0), 0.0, atol=1e-12)
    np.testing.assert_array_equal(view.T_cloud_object[:3, :3], R)
    middle = transform_points(view.T_cloud_object, middle_and_radius(item)[0])
    np.testing.assert_allclose(view.viewpoint - middle, 0.5 * direction, atol=1e-12)


def test_an_occluder_hides_the_stated_share_of_one_side():
    shares = []
    for seed in range(12):
        camera = DepthCameraConfig(sigma=0.0, sigma_quadratic=0.0, grazing_start=1.4, grazing_limit=1.5)
        views = [
            partial_view(box((0.10, 0.10, 0.02)), np.eye(3), Z, 20000, camera, np.random.default_rng(seed), hidden)
            for hidden in (False, True)
        ]
        shares.append(1.0 - views[1].distinct / views[0].distinct)
        shown = views[1].points[:, :2] - views[1].T_cloud_object[:2, 3]
        assert (np.abs(shown.mean(axis=0)) > 0.004).any()  # one side is missing
    assert min(shares) > 0.18 and max(shares) < 0.42 and np.ptp(shares) > 0.05


def test_grazing_surfaces_return_nothing():
    camera = DepthCameraConfig(grazing_start=math.radians(40.0), grazing_limit=math.radians(50.0))
    view = partial_view(cylinder(), np.eye(3), X, 512, camera, np.random.default_rng(0), False)
    local = transform_points(inverse(view.T_cloud_object), view.points)
    assert np.abs(np.arctan2(local[:, 1], local[:, 0])).max() < math.radians(52.0)


def test_few_seen_points_repeat_and_are_counted():
    camera = DepthCameraConfig(width=16, height=16)
    view = partial_view(box(), np.eye(3), X, 512, camera, np.random.default_rng(0), False)
    assert view.points.shape == (512, 3)
    assert view.distinct == len(np.unique(view.points, axis=0)) < 100


def test_a_view_that_shows_nothing_is_drawn_again(monkeypatch):
    narrow = DepthCameraConfig(grazing_start=math.radians(14.0), grazing_limit=math.radians(15.0))  # faces it looks at
    tries = []

    def counted(*arguments):
        tries.append(arguments[2])
        return partial_view(*arguments)

    monkeypatch.setattr(grasp_start, "partial_view", counted)
    env, seen = make(objects=box((0.07, 0.07, 0.07)), depth_camera=narrow), 0
    for seed in range(12):
        begun = len(tries)
        try:
            first, _ = env.reset(seed=seed)
        except UnseenError as error:
            assert len(tries) == begun + VIEWS and re.search(
                "object: expected one that can be seen.*10 views", str(error)
            )
            continue
        seen += 1
        again, _ = env.reset(seed=seed)
        np.testing.assert_array_equal(first["points"], again["points"])
    views = np.array(tries)
    assert len(views) > 30 and seen > 5 and len(np.unique(views, axis=0)) > 20


def test_a_view_that_is_asked_for_is_not_exchanged():
    env = make(objects=box(), depth_camera=DepthCameraConfig(grazing_start=0.01, grazing_limit=0.02))
    with pytest.raises(UnseenError, match=r"view: expected one that shows at least 3 pixels of 'box', got \d+ from"):
        env.reset(seed=0, options={"orientation": (1, 0, 0, 0), "view": (1, 1, 1)})
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros(10, np.float32))


@pytest.mark.parametrize("direction", [Z, -Z, X, np.array([0.6, 0.0, -0.8])])
def test_a_camera_that_looks_somewhere_is_a_rotation_and_upright(direction):
    R = look_at(direction)
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)
    np.testing.assert_array_equal(R[:, 2], direction)
    assert R[2, 0] == 0.0 and R[2, 1] <= 1e-12  # x level, y down


def test_views_and_orientations_are_drawn_as_documented():
    rng = np.random.default_rng(0)
    views = np.array([draw_view(rng) for _ in range(2000)])
    elevation = np.degrees(np.arcsin(views[:, 2]))
    assert -20.0 <= elevation.min() < -18.0 and 68.0 < elevation.max() <= 70.0
    assert np.abs(views[:, :2].mean(axis=0)).max() < 0.05
    turns = np.array([draw_orientation(rng) for _ in range(4000)])
    assert np.abs(turns.mean(axis=0)).max() < 0.04  # uniform rotations have mean zero,
    np.testing.assert_allclose((turns**2).mean(axis=0), 1.0 / 3.0, atol=0.02)  # and no preferred axis


@pytest.mark.parametrize(
    ("changes", "word"),
    [({"sigma": np.nan}, "sigma"), ({"width": 2}, "width"), ({"distance": 5.0}, "distance")]
    + [({"occluded_fraction": (0.5, 0.4)}, "occluded_fraction"), ({"grazing_start": 1.55}, "grazing_start")],
)
def test_bad_cameras_are_refused(changes, word):
    with pytest.raises(ValueError, match=word):
        DepthCameraConfig(**changes)


def test_an_object_in_millimetres_is_refused():
    env = make(objects=box((50.0, 60.0, 120.0)))
    with pytest.raises(ValueError, match="millimetres"):
        env.reset(seed=0)


# actions and observations -------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(5))
def test_a_grasp_survives_encoding(seed):
    rng, gripper = np.random.default_rng(seed), GripperConfig()
    R = Rotation.random(random_state=seed).as_matrix()
    given = Grasp(rng.uniform(-0.2, 0.2, 3), R[:, 0], R[:, 2], rng.uniform(0.01, 0.1))
    action = encode_grasp(given, gripper)
    assert action.shape == (10,) and action.dtype == np.float32 and np.abs(action).max() <= 1.0
    back = decode_action(action, gripper)
    for name in ("center", "closing_axis", "approach_axis", "width"):
        np.testing.assert_allclose(getattr(back, name), getattr(given, name), atol=1e-7)


def test_axes_are_normalised_and_made_orthogonal():
    action = np.zeros(10)
    action[3:6], action[6:9] = (0.01, 0.0, 0.0), (0.5, 0.0, -0.1)
    decoded = decode_action(action, GripperConfig())
    np.testing.assert_allclose(decoded.closing_axis, X)
    np.testing.assert_allclose(decoded.approach_axis, -Z)
    assert decoded.width == pytest.approx(0.05)


@pytest.mark.parametrize("closing", [(0, 0, 0), (1e-4, 0, 0), (1, 0, 0), (-0.5, 0, 0)])
def test_axes_that_say_nothing_are_no_grasp(closing):
    action = np.zeros(10, np.float32)
    action[3:6], action[6:9] = closing, (0.7, 0.0, 0.0)
    assert decode_action(action, GripperConfig()) is None


@pytest.mark.parametrize("change", [{"center": (0.3, 0.0, 0.0)}, {"width": 0.12}, {"width": 1e-4}])
def test_a_grasp_no_action_can_say_is_refused(change):
    with pytest.raises(ValueError, match="grasp"):
        encode_grasp(grasp(**change), GripperConfig())


def test_the_narrowest_action_still_opens():
    assert decode_action(encode_grasp(grasp(width=0.001), GripperConfig()), GripperConfig()).width == 0.001
    action = np.array([0, 0, 0, 1, 0, 0, 0, 1, 0, -1.0])
    assert decode_action(action, GripperConfig()).width == 0.001


def test_a_cloud_unpacks_alone_and_in_batches():
    env = make(points=64)
    observations = [env.reset(seed=k)[0] for k in range(3)]
    one = unpack_cloud(observations[1])
    assert one.points.shape == one.normals.shape == (64, 3) and one.noise.shape == (64,)
    assert one.viewpoint.shape == (3,) and one.count == 64 and one.points.dtype == np.float64
    np.testing.assert_allclose(np.linalg.norm(one.normals, axis=1), 1.0, atol=1e-6)
    batch = unpack_cloud({key: np.stack([o[key] for o in observations]) for key in observations[0]})
    assert batch.points.shape == (3, 64, 3) and batch.count.shape == (3,)
    np.testing.assert_array_equal(batch.points[1], one.points)


@pytest.mark.parametrize("name", ["points", "count", "noise"])
def test_an_observation_with_parts_missing_is_refused(name):
    observation, _ = make(points=64).reset(seed=0)
    with pytest.raises(ValueError, match=name):
        unpack_cloud({key: value for key, value in observation.items() if key != name})
    with pytest.raises(ValueError, match="observation"):
        unpack_cloud({**observation, name: np.zeros(7, np.float32)})


# episodes -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", ["dense", "sparse"])
def test_a_good_grasp_is_held_and_ends_the_episode(mode):
    env = make(objects=box(), reward_mode=mode)
    first, info = env.reset(seed=0)
    assert (info["object"], info["family"], info["success"], info["metrics"]) == ("box", "box", False, {})
    last, reward, terminated, truncated, info = env.step(encode_grasp(good_grasp(env), env.gripper))
    assert terminated and not truncated and info["success"] is True
    assert info["termination"] == "held" and info["metrics"].keys() == {"held", "strict", "survived", "slip", "turn"}
    assert all(np.array_equal(first[key], last[key]) for key in first)
    metrics = info["metrics"]
    if mode == "sparse":
        assert info["reward_terms"] == {"held": 1.0} and reward == 1.0
    else:
        assert info["reward_terms"] == {
            "survived": 0.5 * metrics["survived"],
            "slip": pytest.approx(0.25 * (1.0 - metrics["slip"] / 0.020)),
            "turn": pytest.approx(0.25 * (1.0 - metrics["turn"] / math.radians(20.0))),
        }
        assert 0.9 < reward <= 1.0
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros(10, np.float32))


@pytest.mark.parametrize("mode", ["dense", "sparse"])
def test_no_grasp_and_a_missed_one_earn_nothing(mode):
    env = make(objects=box(), reward_mode=mode)
    for action, outcome in ((np.zeros(10), "degenerate"), (np.array([1, 1, 1, 1, 0, 0, 0, 1, 0, 1.0]), "missed")):
        env.reset(seed=0)
        _, reward, terminated, _, info = env.step(action.astype(np.float32))
        assert (reward, terminated, info["termination"], info["success"]) == (0.0, True, outcome, False)
        assert "slip" not in info["metrics"] and info["metrics"]["held"] == 0.0


def test_judging_without_a_step_changes_nothing_and_agrees_with_it():
    env = make(objects=cylinder())
    env.reset(seed=4)
    at = decode_action(encode_grasp(good_grasp(env), env.gripper), env.gripper)
    judgement = env.judge(at)
    assert env.judge(None).outcome == "degenerate"
    info = env.step(encode_grasp(good_grasp(env), env.gripper))[4]
    assert info["metrics"]["slip"] == judgement.slip and info["termination"] == judgement.outcome


def test_consecutive_seeds_take_the_test_objects_in_turn():
    env = make(points=16)
    names = [item.name for item in named_objects()]
    assert [env.reset(seed=seed)[1]["object"] for seed in range(2 * len(names))] == 2 * names
    drawn = {env.reset()[1]["object"] for _ in range(30)}
    assert len(drawn) > 5 and drawn <= set(names)


def test_training_objects_are_new_at_every_reset():
    env = make(objects="train", points=16)
    seen = [(env.reset(seed=seed)[1]["family"], env.object.mass) for seed in range(12)]
    assert len({mass for _, mass in seen}) == 12 and len({family for family, _ in seen}) > 3
    assert (env.reset(seed=3)[1]["family"], env.object.mass) == seen[3]


def test_objects_are_chosen_by_name_by_value_and_by_path(tmp_path):
    mesh = tmp_path / "brick.stl"
    trimesh.creation.box((0.04, 0.05, 0.09)).export(mesh)
    env = make(objects=["can", box(), str(mesh)], points=16)
    assert [env.reset(seed=seed)[1]["object"] for seed in range(3)] == ["can", "box", "brick"]
    assert env.reset(seed=0, options={"object": "box"})[1]["object"] == "box"
    assert make(objects=mesh, points=16).reset(seed=0)[1]["object"] == "brick"


def test_an_explicit_start_is_honoured_and_leaves_the_rest_as_drawn():
    env = make(objects=[box(), cylinder()])
    env.reset(seed=2)
    drawn = env.T_cloud_object
    quaternion = np.array([2.0, 0.0, 0.0, 0.0])
    env.reset(seed=2, options={"object": "cylinder", "orientation": quaternion, "view": (0.0, 0.0, 3.0)})
    np.testing.assert_allclose(env.T_cloud_object[:3, :3], np.eye(3), atol=1e-12)
    cloud = unpack_cloud(env.reset(seed=2, options={"orientation": quaternion, "view": (0.0, 0.0, 3.0)})[0])
    np.testing.assert_allclose(cloud.viewpoint - env.T_cloud_object[:3, 3], (0.0, 0.0, 0.5), atol=1e-6)
    env.reset(seed=2, options={"view": (1.0, 0.0, 0.0)})
    np.testing.assert_array_equal(env.T_cloud_object[:3, :3], drawn[:3, :3])
    hidden = env.reset(seed=2, options={"occluded": True})[0], env.reset(seed=2, options={"occluded": False})[0]
    assert not np.array_equal(hidden[0]["points"], hidden[1]["points"])


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"objekt": "box"}, "object"),
        ({"object": "bax"}, "'box'"),
        ({"orientation": (1.0, 0.0, 0.0)}, "orientation"),
        ({"orientation": (0.0, 0.0, 0.0, 0.0)}, "orientation"),
        ({"view": (0.0, 0.0, 0.0)}, "view"),
        ({"view": (np.nan, 0.0, 0.0)}, "view"),
        ({"occluded": 1}, "occluded"),
    ],
)
def test_bad_reset_options_are_refused_and_change_nothing(options, word):
    env = make(objects=box(), points=16)
    first, _ = env.reset(seed=0)
    with pytest.raises(ValueError, match=word):
        env.reset(seed=1, options=options)
    np.testing.assert_array_equal(env._observation["points"], first["points"])


def test_randomisation_varies_mass_friction_and_noise_from_the_nominal_ones():
    env, item = make(objects=box(), randomize={"mass": (0.5, 2.0), "noise": (0.5, 2.0)}, points=16), box()
    masses, frictions, noises = [], [], []
    for seed in range(60):
        observation, _ = env.reset(seed=seed)
        masses.append(env.object.mass / item.mass)
        np.testing.assert_allclose(env.object.inertia, masses[-1] * item.inertia)
        frictions.append(env.object.friction / item.friction)
        noises.append(float(observation["noise"].mean()))
    assert 0.5 <= min(masses) < 0.7 and 1.8 < max(masses) <= 2.0
    assert 0.8 <= min(frictions) < 0.85 and 1.15 < max(frictions) <= 1.2
    assert max(noises) > 2.0 * min(noises)


def test_a_registered_episode_is_one_step_without_a_time_limit():
    spec = gymnasium.spec(PLAN)
    assert spec.max_episode_steps is None
    batch = gymnasium.make_vec(PLAN, num_envs=2, points=32)
    batch.reset(seed=0)
    _, rewards, terminations, truncations, info = batch.step(np.zeros((2, 10), np.float32))
    assert terminations.all() and not truncations.any() and (rewards == 0.0).all()
    assert list(info["termination"]) == ["degenerate", "degenerate"]
    batch.close()


# pictures -----------------------------------------------------------------------------------------


def test_pictures_show_the_seen_points_before_and_the_gripper_after():
    env = make(objects=box(), render_mode="rgb_array", **SMALL)
    env.reset(seed=0)
    before = env.render()
    assert before.shape == (72, 96, 3) and before.dtype == np.uint8
    dots = (before == (20, 200, 230)).all(axis=2)
    assert dots.sum() > 30
    env.step(encode_grasp(good_grasp(env), env.gripper))
    after = env.render()
    assert not (after == (20, 200, 230)).all(axis=2).any() and not np.array_equal(before, after)
    np.testing.assert_array_equal(env.render(), after)
    env.close()


def test_depth_pictures_measure_the_object():
    env = make(objects=box(), render_mode="depth_array", camera="view", **SMALL)
    env.reset(seed=0)
    depth = env.render()
    assert depth.dtype == np.float32 and depth.shape == (72, 96)
    assert 0.5 - 0.07 < depth[36, 48] < 0.5  # the camera stands where the depth camera does
    env.close()


def test_a_film_shows_the_last_judgement():
    env = make(objects=box(), render_mode="rgb_array", **SMALL)
    env.reset(seed=0)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.film()
    env.step(encode_grasp(good_grasp(env), env.gripper))
    frames = env.film(5.0)
    assert 10 <= len(frames) <= 18 and all(frame.shape == (72, 96, 3) for frame in frames)
    np.testing.assert_array_equal(frames[-1], env.render())
    assert not np.array_equal(frames[0], frames[-1])
    assert all(np.array_equal(a, b) for a, b in zip(frames, env.film(5.0), strict=True))
    env.reset(seed=1)
    env.step(np.zeros(10, np.float32))
    assert len(env.film()) == 1
    with pytest.raises(ValueError, match="fps"):
        env.film(0.0)
    env.close()


@pytest.mark.parametrize("camera", ["side", "front", "view"])
def test_what_is_lifted_stays_in_the_picture(camera):
    tall, gripper = cylinder(0.02, 0.40), GripperConfig()
    seen = partial_view(tall, np.eye(3), X, 64, PERFECT, np.random.default_rng(0))
    held = record_grasp(tall, Grasp(seen.T_cloud_object[:3, 3], X, -Z, 0.08), seen.T_cloud_object, gripper)
    upright = record_grasp(
        tall, Grasp(seen.T_cloud_object[:3, 3], np.array([0, 1.0, 0]), -X, 0.08), seen.T_cloud_object
    )
    assert upright.judgement.held and not held.judgement.held  # from above the palm cuts into it
    for recording, (width, height) in ((held, (96, 72)), (upright, (96, 72)), (upright, (60, 90))):
        view = GraspView(tall, gripper, seen, width, height, camera)
        placed = camera_view(None, None, view.framing(recording), width, height)
        for k in range(0, len(recording.times), 7):
            local = (transform_points(recording.T_object[k], tall.vertices) - placed.position) @ placed.R_w_c
            column = placed.cx - placed.fx * local[:, 0] / local[:, 2]
            row = placed.cy + placed.fy * local[:, 1] / local[:, 2]
            assert column.min() > 0.0 and column.max() < width and row.min() > 0.0 and row.max() < height
        view.close()


def test_the_closing_axis_has_no_sign():
    env = make(objects=box())
    env.reset(seed=0)
    one = good_grasp(env)
    other = Grasp(one.center, -one.closing_axis, one.approach_axis, one.width)
    assert env.judge(one).outcome == env.judge(other).outcome == "held"
