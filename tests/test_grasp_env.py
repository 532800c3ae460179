"""Grasp-v0 and GraspDual-v0: what is drawn, what is seen, what counts, and why an episode failed."""

from __future__ import annotations

from typing import Any

import gymnasium
import mujoco
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

import aerograsp_env  # noqa: F401  registers the ids
from aerograsp_env.envs.grasp import GraspEnv, object_cloud
from aerograsp_env.envs.grasp_dual import GraspDualEnv
from aerograsp_env.envs.grasp_kernel import (
    CAUSES,
    COLLIDED,
    JAMMED,
    MISHAP_STEPS,
    MISSED,
    NONE,
    PRESSED_STEPS,
    RECORD,
    SLIPPED,
    TIMED_OUT,
    failure,
)
from aerograsp_env.envs.grasp_levels import DUAL_LEVELS, LEVELS, GraspLevel
from aerograsp_env.rewards import tolerance
from aerograsp_env.sim.manipulation import layout as lay
from aerograsp_env.sim.objects import build_object
from aerograsp_env.sim.objects import test_objects as named_objects
from aerograsp_env.sim.objects.crawler import crawler_handles
from aerograsp_env.sim.objects.shapes import box

CALM: dict[str, Any] = {"wind": "calm", "pose": "exact"}
OPEN, CLOSE = -1.0, 1.0
ENVS = pytest.mark.parametrize("cls", [GraspEnv, GraspDualEnv], ids=["one arm", "two arms"])


def matrix(row: np.ndarray) -> np.ndarray:
    """T (4, 4) of a position and a 6-D rotation."""
    x, y = row[3:6].astype(float), row[6:9].astype(float)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.stack([x, y, np.cross(x, y)], axis=1), row[:3]
    return T


def body_pose(env) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = env.state["rotation"], env.state["position"]
    return T


def address(env) -> int:
    return int(env._worlds.parameters["object_address"][0])


def put_object(env, T: np.ndarray) -> None:
    """The object at rest there, as if it had always been."""
    a = address(env)
    x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat()
    env.data.qpos[a : a + 7] = (*T[:3, 3], w, x, y, z)
    env.data.qvel[a - 1 : a + 5] = 0.0


def idle(env, gripper: float = 0.0) -> np.ndarray:
    action = np.zeros(env.action_space.shape, np.float32)
    action[9::7] = gripper
    return action


# what is drawn ------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", LEVELS)
def test_episodes_are_as_the_level_says(name):
    env, level = GraspEnv(level=name), LEVELS[name]
    assert level.mass is not None
    assert level.friction is not None
    slopes, masses, seen = set(), [], set()
    for seed in range(25):
        observation, info = env.reset(seed=seed)
        p, model = env._worlds.parameters[0], env.model
        mass = float(model.body("object").mass[0])
        assert level.mass[0] <= mass <= level.mass[1]
        friction = model.geom_friction[model.geom("right_left_pad").id, 0] ** 2 / 0.7
        assert level.friction[0] - 1e-9 <= friction <= level.friction[1] + 1e-9
        shift, turn = np.linalg.norm(p["track_bias"], axis=1)
        assert level.position_bias[0] <= shift <= level.position_bias[1]
        assert level.rotation_bias[0] <= turn <= level.rotation_bias[1]
        assert level.delay - 1e-6 <= observation["object_age"][0] <= level.delay + 0.04
        normal = env.record["support"][:3, 2]
        slopes.add(round(np.degrees(np.arccos(min(normal[2], 1.0)))))
        masses.append(mass)
        seen.add((info["object"], info["support"]))
    steep = name in ("oblique", "combined")
    assert slopes == ({15, 20, 25, 30} if steep else {0})
    assert len(set(masses)) == 25
    assert {support for _, support in seen} == {"inclined_table" if steep else "table", "pipe_saddle"}
    assert len({item for item, _ in seen}) > 8
    assert env.config.wind.mean_speed == (3.0 if name in ("gusty", "combined") else 2.0)


@ENVS
def test_the_object_begins_within_reach_below_the_open_fingers(cls):
    for name in ("easy", "oblique"):
        env = cls(level=name, pose="exact")
        base = np.mean([mount.T_body_base[:3, 3] for mount in env.task.mounts], axis=0)
        spread = (DUAL_LEVELS if cls is GraspDualEnv else LEVELS)[name].spread
        for seed in range(12):
            observation, _ = env.reset(seed=seed)
            T = matrix(observation["object"])
            center = T[:3, :3] @ env.record["center"] + T[:3, 3]
            offset = center - base - (0.16, 0.0, -0.49)
            assert (np.abs(offset[:2]) <= np.array(spread[:2]) + 1e-6).all()
            assert -0.08 <= offset[2] <= spread[2] + 1e-6
            item = env.task.pool.scene(env.record["scene"]).item
            top = (item.vertices @ T[:3, :3].T + T[:3, 3])[:, 2].max()
            for i in range(len(env.task.mounts)):
                assert observation["tool"][9 * i + 2] - 0.004 - top >= 0.03 - 1e-3
            env.step(idle(env))
            assert env.data.ncon > 0  # it stands on its support, and nothing else touches
            touching = {tuple(sorted(map(int, env.model.geom_bodyid[pair]))) for pair in env.data.contact.geom}
            assert touching == {tuple(sorted((env.model.body("object").id, env.model.body("support").id)))}


@ENVS
@pytest.mark.parametrize("level", ["easy", "oblique", "heavy"])
def test_left_alone_the_object_stays(cls, level):
    env = cls(level=level, wind="calm")
    for seed in range(5):
        env.reset(seed=seed)
        env.step(idle(env))
        before = env.state["object"].copy()
        for _ in range(75):
            env.step(idle(env))
        moved = np.linalg.norm(env.state["object"][:3, 3] - before[:3, 3])
        turned = Rotation.from_matrix(before[:3, :3].T @ env.state["object"][:3, :3]).magnitude()
        assert moved < 1e-3
        assert turned < np.radians(1.0)


def test_objects_can_be_chosen_and_keep_their_own_mass_where_the_level_draws_none():
    can = next(item for item in named_objects() if item.name == "can")
    env = GraspEnv(objects=can, level={"mass": None, "friction": None})
    _, info = env.reset(seed=0)
    assert info["object"] == "can"
    assert env.model.body("object").mass[0] == pytest.approx(can.mass)
    np.testing.assert_allclose(env.model.body("object").inertia.sum(), np.trace(can.inertia), rtol=1e-6)
    env = GraspEnv(objects=["mug", "capsule"])
    assert {env.reset(seed=seed)[1]["object"] for seed in range(12)} == {"mug", "capsule"}
    assert env.reset(seed=0, options={"object": "capsule"})[1]["object"] == "capsule"
    with pytest.raises(ValueError, match=r"options\['object'\].*'mug'"):
        env.reset(options={"object": "mugg"})


def test_a_mesh_of_the_users_own_can_be_grasped(tmp_path):
    path = tmp_path / "wedge.stl"
    trimesh.creation.box((0.04, 0.06, 0.10)).export(path)
    env = GraspEnv(objects=path)
    observation, info = env.reset(seed=0)
    assert info["object"] == "wedge"
    np.testing.assert_allclose(np.ptp(object_cloud(observation)[:, :3], axis=0), (0.04, 0.06, 0.10), atol=5e-3)
    batch = gymnasium.make_vec("aerograsp/Grasp-v0", num_envs=2, objects=str(path))
    assert batch.reset(seed=0)[1]["object"].tolist() == ["wedge", "wedge"]
    batch.close()


def test_a_mass_that_is_drawn_scales_the_inertia():
    env = GraspEnv(objects="spanner", level={"mass": (0.3, 0.3)})
    env.reset(seed=0)
    item = env.task.pool.scene(env.record["scene"]).item
    principal = np.sort(np.linalg.eigvalsh(item.inertia)) * 0.3 / item.mass
    np.testing.assert_allclose(np.sort(env.model.body("object").inertia), principal, rtol=1e-6)


def test_the_crawlers_handles_lie_to_the_left_and_right():
    env = GraspDualEnv(pose="exact", level={"heading": (0.0, 0.0)})
    for seed in range(8):
        observation, _ = env.reset(seed=seed)
        T = matrix(observation["object"])
        middles = np.array([0.5 * (h.start + h.end) for h in crawler_handles()]) @ T[:3, :3].T + T[:3, 3]
        across = (middles - T[:3, 3])[:, :2]
        angles = np.degrees(np.arctan2(across[:, 1], across[:, 0])) % 120.0
        gaps = np.minimum(angles % 60.0, 60.0 - angles % 60.0)
        np.testing.assert_allclose(gaps, 0.0, atol=1.0)  # at ± 60° and 180°, or at 0° and ± 120°


# what is seen -------------------------------------------------------------------------------------


@ENVS
def test_exact_poses_are_the_true_ones(cls):
    env = cls(**CALM, level="oblique")
    observation, _ = env.reset(seed=1)
    for _ in range(20):
        to_body = np.linalg.inv(body_pose(env))
        np.testing.assert_allclose(matrix(observation["object"]), to_body @ env.state["object"], atol=1e-6)
        seat = to_body @ env.record["support"]
        np.testing.assert_allclose(observation["support"], [*seat[:3, 2], *seat[:3, 3]], atol=1e-6)
        assert observation["object_age"][0] == 0.0
        observation, *_ = env.step(np.full(env.action_space.shape, 0.2, np.float32))


@ENVS
def test_support_and_object_are_seen_in_the_same_images_with_the_same_error_of_place(cls):
    env = cls(level="biased", wind="calm")
    observation, _ = env.reset(seed=2)
    errors = []
    for _ in range(40):  # nothing moves relative to the vehicle but by its slow drift
        to_body = np.linalg.inv(body_pose(env))
        error = observation["object"][:3] - (to_body @ env.state["object"])[:3, 3]
        other = observation["support"][3:] - (to_body @ env.record["support"])[:3, 3]
        np.testing.assert_allclose(error, other, atol=1.5e-3)  # the vehicle tilts and moves within 0.1 s
        errors.append(error)
        observation, *_ = env.step(idle(env))
        assert 0.1 - 1e-6 <= observation["object_age"][0] <= 0.16
    bias = env._worlds.parameters["track_bias"][0, 0]
    assert 0.005 <= np.linalg.norm(bias) <= 0.015
    assert np.linalg.norm(np.mean(errors, axis=0) - bias) < 0.006


@ENVS
def test_tools_are_those_of_the_encoders(cls):
    env = cls()
    observation, _ = env.reset(seed=0)
    for _ in range(10):
        observation, *_ = env.step(env.action_space.sample())
    n = 6
    for i, mount in enumerate(env.task.mounts):
        T = mount.T_body_base @ mount.arm.link_poses(observation["joints"][n * i : n * i + n].astype(float))[-1]
        np.testing.assert_allclose(matrix(observation["tool"][9 * i : 9 * i + 9]), T, atol=2e-6)


def test_an_estimate_that_stops_arriving_is_held_and_grows_old():
    env = GraspEnv(estimate={"loss_interval": 0.5, "loss_duration": 60.0})
    observation, _ = env.reset(seed=0)
    ages, held = [], []
    for _ in range(250):
        observation, *_ = env.step(idle(env))
        ages.append(float(observation["object_age"][0]))
        held.append(np.concatenate([observation["object"], observation["support"]]))
    assert ages[-1] > 1.0
    lost = int(np.argmax(np.array(ages) > 0.15))
    np.testing.assert_allclose(np.diff(ages[lost:]), 0.02, atol=1e-5)
    assert all(np.array_equal(row, held[-1]) for row in held[lost:])


def test_the_cloud_is_the_objects_surface_and_stays():
    env = GraspEnv()
    observation, _ = env.reset(seed=3)
    first = observation["object_cloud"].copy()
    cloud = object_cloud(observation)
    assert cloud.shape == (256, 6)
    np.testing.assert_allclose(np.linalg.norm(cloud[:, 3:], axis=1), 1.0, atol=1e-6)
    item = env.task.pool.scene(env.record["scene"]).item
    a, b, c = (item.vertices[item.faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    for row in cloud[::16]:  # on the plane of some facet whose normal it has
        plane = np.abs(np.einsum("ij,ij->i", normals, row[:3] - a)) < 1e-6
        assert (plane & (np.abs(normals - row[3:]).max(axis=1) < 1e-5)).any()
    for _ in range(30):
        observation, *_ = env.step(env.action_space.sample())
        assert np.array_equal(observation["object_cloud"], first)
    batch = {"object_cloud": np.stack([first, first])}
    assert object_cloud(batch).shape == (2, 256, 6)
    with pytest.raises(ValueError, match="object_cloud"):
        object_cloud({"object": first})
    with pytest.raises(ValueError, match="1536"):
        object_cloud({"object_cloud": first[:6]})


# what counts --------------------------------------------------------------------------------------


def raised(T: np.ndarray, height: float) -> np.ndarray:
    """The same pose, moved up."""
    T = T.copy()
    T[2, 3] += height
    return T


@ENVS
def test_success_is_a_rise_of_ten_centimetres_for_one_second_without_a_break(cls):
    env = cls(**CALM)
    env.reset(seed=0)
    start = env.state["object"].copy()

    def hold(height: float, steps: int) -> dict[str, Any]:
        for _ in range(steps):
            put_object(env, raised(start, height))
            info = env.step(idle(env))[-1]
        return info

    fall = 0.5 * 9.81 * 0.02**2  # [m] within a step
    assert hold(0.10 - fall - 1e-4, 60)["success"] is False
    assert hold(0.10 + fall + 1e-3, 49)["success"] is False
    assert hold(0.08, 1)["success"] is False
    assert hold(0.10 + fall + 1e-3, 49)["success"] is False
    info = hold(0.10 + fall + 1e-3, 1)
    assert info["success"] is True
    assert info["cause"] == ""
    assert info["metrics"]["lift_time"] == pytest.approx(0.02 * 160)
    assert info["metrics"]["lift"] == pytest.approx(0.10 + 1e-3, abs=2e-3)
    assert hold(0.0, 5)["success"] is True  # the episode goes on


def test_a_crash_undoes_success():
    env = GraspEnv(**CALM)
    env.reset(seed=0)
    start = env.state["object"].copy()
    for _ in range(51):
        put_object(env, raised(start, 0.12))
        info = env.step(idle(env))[-1]
    assert info["success"]
    env.data.qpos[0] += 3.5  # out of bounds
    *_, terminated, _, info = env.step(idle(env))
    assert terminated
    assert info["success"] is False
    assert (info["cause"], info["termination"]) == ("collided", "out_of_bounds")
    assert info["reward_terms"]["crash"] == -10.0


@ENVS
def test_nothing_and_noise_fail(cls):
    env = gymnasium.make("aerograsp/Grasp-v0" if cls is GraspEnv else "aerograsp/GraspDual-v0")
    rng = np.random.default_rng(0)
    for noise in (0.0, 1.0):
        env.reset(seed=4)
        over, steps = False, 0
        while not over:
            action = noise * rng.uniform(-1.0, 1.0, env.action_space.shape).astype(np.float32)
            *_, terminated, truncated, info = env.step(action)
            over, steps = terminated or truncated, steps + 1
        assert info["success"] is False
        assert info["cause"] in CAUSES[1:]
        assert sum(info["metrics"][name] for name in CAUSES[1:]) == 1.0
        if noise == 0.0:
            assert steps == 1000
            assert info["cause"] == "timed_out"
            assert info["metrics"]["lift_time"] == pytest.approx(20.0)


def between_jaws(env) -> np.ndarray:
    """T_world_object with the object's centre of mass in the tool's origin, its axes along the tool's."""
    T = body_pose(env) @ env.state["true_tool"][0]
    T[:3, 3] -= T[:3, :3] @ env.record["center"]
    return T


def take(env, seed: int) -> dict:
    """Close the jaws on an object that is held between them until they press it; then let go of it."""
    env.reset(seed=seed)
    info: dict = {}
    for _ in range(60):
        put_object(env, between_jaws(env))
        *_, info = env.step(idle(env, CLOSE))
        if env.state["gripper_load"][0] > 0.95:
            break
    env._worlds.records["up_steps"] = env._worlds.records["success_step"] = 0
    return info


def test_contact_forces_alone_hold_an_object():
    env = GraspEnv(**CALM, objects="juice_box", level={"mass": (0.25, 0.25)})
    take(env, 0)
    up = idle(env, CLOSE)
    up[2] = 0.6
    held = [env.step(up)[-1] for _ in range(80)]
    assert held[-1]["success"] is True
    assert held[-1]["metrics"]["slip"] < 2e-3
    assert held[-1]["metrics"]["contacts"] == 0.0
    terms = held[-1]["reward_terms"]
    assert terms["grip"] == pytest.approx(0.2)
    assert (terms["lift"], terms["hold"]) == (0.3, 0.3)
    observation, *_ = env.step(idle(env, 0.0))  # the worm holds without the motor
    width = observation["gripper"][0]
    for _ in range(50):
        observation, *_ = env.step(idle(env, 0.0))
    assert observation["gripper"][0] == pytest.approx(width, abs=3e-4)
    assert env.record["rise"] > 0.1


def test_an_object_let_go_too_early_has_slipped():
    env = GraspEnv(**CALM, objects="juice_box")
    take(env, 0)
    for _ in range(PRESSED_STEPS + 2):
        *_, info = env.step(idle(env, CLOSE))
    assert info["cause"] == "timed_out"  # it holds the object, and has not held it for a second
    for _ in range(60):
        *_, info = env.step(idle(env, OPEN))
    assert info["success"] is False
    assert info["cause"] == "slipped"
    assert info["metrics"]["slipped"] == 1.0
    assert info["reward_terms"]["hold"] == 0.0


def test_the_dense_reward_is_that_of_the_table():
    env = GraspEnv(wind="calm", objects="juice_box")
    take(env, 1)
    rng, previous = np.random.default_rng(0), idle(env, CLOSE)
    for _ in range(30):
        action = np.clip(idle(env, CLOSE) + rng.normal(0.0, 0.1, 10), -1.0, 1.0).astype(np.float32)
        _, reward, _, _, info = env.step(action)
        s = env.state
        tool = (body_pose(env) @ s["true_tool"][0])[:3, 3]
        points = env.record["cloud"][:, :3] @ s["object"][:3, :3].T + s["object"][:3, 3]
        distance = np.linalg.norm(points - tool, axis=1).min()
        rise = (s["object"][:3, :3] @ env.record["center"] + s["object"][:3, 3])[2] - env.record["start_height"]
        touching = (s["contacts"][[lay.C_LEFT_0, lay.C_RIGHT_0]] > 0).sum()
        change = float(np.sum((action.astype(float) - previous.astype(float)) ** 2))
        expected = {
            "reach": 0.2 * tolerance(distance, margin=0.15, sigmoid="long_tail"),
            "grip": 0.1 * touching,
            "lift": 0.3 * np.clip(rise / 0.10, 0.0, 1.0) * (touching > 0),
            "hold": 0.3 * (rise >= 0.10 and touching > 0),
            "effort": -0.1 * min(change, 4.0),
            "crash": 0.0,
        }
        assert info["reward_terms"] == pytest.approx(expected, abs=1e-9)
        assert reward == sum(info["reward_terms"].values())
        previous = action


@pytest.mark.parametrize(
    ("facts", "cause"),
    [
        ({}, TIMED_OUT),
        ({"closed": 1}, MISSED),
        ({"protected": 1}, JAMMED),
        ({"protected": 1, "mishaps": MISHAP_STEPS}, COLLIDED),
        ({"closed": 1, "mishaps": MISHAP_STEPS - 1}, MISSED),
        ({"closed": 1, "fallen": 1}, COLLIDED),
        ({"closed": 1, "pressed": 1, "fallen": 1}, SLIPPED),
        ({"closed": 1, "lifted": 1}, SLIPPED),
        ({"closed": 1, "pressed": 1, "pressed_steps": PRESSED_STEPS}, JAMMED),
        ({"closed": 1, "pressed": 1, "pressed_steps": PRESSED_STEPS, "rise": 0.03}, TIMED_OUT),
        ({"closed": 1, "pressed": 1, "lifted": 1, "success_step": 300}, NONE),
        ({"success_step": 300, "termination": lay.COLLISION}, COLLIDED),
    ],
)
def test_causes_are_sorted_by_the_documented_rules(facts, cause):
    p, s, task = (np.zeros(1, dtype) for dtype in (lay.PARAMETERS, lay.STATE, RECORD))
    p["arms"], p["joints"] = 1, 6
    for name, value in facts.items():
        if name == "protected":
            s[name][0, 0, 2] = value
        else:
            (s if name == "termination" else task)[name] = value
    assert failure(p[0], s[0], task[0]) == cause


def test_hitting_the_table_for_a_second_is_a_collision_of_the_arm():
    env = GraspEnv(**CALM, level={"supports": ("table",)})
    env.reset(seed=0)
    down = idle(env)
    for k in range(300):
        down[:3] = (0.0, 0.6, -0.3) if k < 60 else (0.0, 0.0, -0.3)  # beside the object, then down on the table
        *_, terminated, _, info = env.step(down)
        if info["metrics"]["contacts"] > MISHAP_STEPS or terminated:
            break
    assert info["cause"] == "collided"


# batches ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("env_id", ["aerograsp/Grasp-v0", "aerograsp/GraspDual-v0"])
@pytest.mark.parametrize("mode", ["next_step", "same_step"])
def test_a_batch_equals_single_worlds_exactly(env_id, mode):
    options: dict[str, Any] = {"level": "heavy", "randomize": True}
    batch = gymnasium.make_vec(env_id, num_envs=2, max_episode_steps=12, autoreset_mode=mode, **options)
    singles = [gymnasium.make(env_id, max_episode_steps=12, **options) for _ in range(2)]
    rng = np.random.default_rng(0)
    observation, info = batch.reset(seed=9)
    firsts = [env.reset(seed=9 + i) for i, env in enumerate(singles)]
    for i, (single, single_info) in enumerate(firsts):
        assert all(np.array_equal(single[name], observation[name][i]) for name in single)
        assert all(single_info[name] == info[name][i] for name in ("cause", "object", "support", "success"))
    done = False
    for _ in range(30):
        actions = rng.uniform(-1.0, 1.0, batch.action_space.shape).astype(np.float32)
        observation, rewards, _, truncations, info = batch.step(actions)
        for i, env in enumerate(singles):
            reward: Any
            if mode == "next_step" and done:
                (single, single_info), reward = env.reset(), 0.0
            else:
                single, reward, _, truncated, single_info = env.step(actions[i])
                assert truncated == truncations[i]
                if mode == "same_step" and truncated:
                    assert info["final_info"]["cause"][i] == single_info["cause"]
                    single, single_info = env.reset()
            assert reward == rewards[i]
            assert all(np.array_equal(single[name], observation[name][i]) for name in single)
            assert all(single_info[name] == info[name][i] for name in ("cause", "object", "support", "success"))
            assert all(value == info["metrics"][name][i] for name, value in single_info["metrics"].items())
        done = bool(truncations[0])
    batch.close()


# misuse -------------------------------------------------------------------------------------------


def test_what_no_jaw_can_take_is_refused():
    too_wide = build_object("block", "block", [box((0.12, 0.12, 0.12))])
    with pytest.raises(ValueError, match=r"jaws of 0\.10 m.*block"):
        GraspEnv(objects=too_wide)


def test_levels_refuse_what_they_cannot_mean():
    with pytest.raises(ValueError, match=r"GraspLevel\.heading"):
        GraspLevel(heading=(0.0, 4.0))
    with pytest.raises(ValueError, match="supports"):
        GraspLevel(supports=("shelf",))


def test_a_model_is_shared_by_nobody():
    one, two = GraspEnv(objects="can"), GraspEnv(objects="can")
    one.reset(seed=0)
    before = one.model.body_mass.copy(), one.model.geom_friction.copy()
    two.reset(seed=1)
    two.model.body_mass[:] *= 2.0
    two.model.geom_friction[:] *= 2.0
    one.step(idle(one))
    assert np.array_equal(one.model.body_mass, before[0])
    assert np.array_equal(one.model.geom_friction, before[1])
    assert isinstance(one.data, mujoco.MjData)
