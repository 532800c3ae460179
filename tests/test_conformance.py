"""What every id promises, for every option: checkers, determinism, resets, rewards, documented tables, refusals."""

from __future__ import annotations

import inspect
import json
import re
import warnings
from typing import Any

import gymnasium
import mujoco
import numpy as np
import pytest
from dock_worlds import AT_NOMINAL, ATTACH, DOCK
from dock_worlds import make as make_dock
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as sb3_check_env

import aerograsp_env
from aerograsp_env.envs.detect import DetectEnv
from aerograsp_env.envs.detect_action import SLOTS
from aerograsp_env.envs.detect_options import detect_options
from aerograsp_env.envs.dock import DockAttachEnv, DockEnv
from aerograsp_env.envs.dock_manipulate import DockManipulateEnv, dock_manipulate_task
from aerograsp_env.envs.grasp import GraspEnv, grasp_task
from aerograsp_env.envs.grasp_dual import GraspDualEnv, grasp_dual_task
from aerograsp_env.envs.grasp_levels import GraspLevel
from aerograsp_env.envs.grasp_options import GraspRandomizeConfig
from aerograsp_env.envs.grasp_plan import GraspPlanEnv
from aerograsp_env.envs.options import available_render_modes
from aerograsp_env.envs.reach import ReachEnv, reach_task
from aerograsp_env.registration import ENTRY_POINTS
from aerograsp_env.rewards import tolerance
from aerograsp_env.sim.config import DockConfig, RandomizeConfig
from aerograsp_env.sim.depth_view import DepthCameraConfig
from aerograsp_env.sim.grasp_judge import JudgeConfig
from aerograsp_env.sim.gripper import GripperConfig
from aerograsp_env.sim.manipulation.config import (
    ManipulationConfig,
    ManipulationRandomizeConfig,
    PoseEstimateConfig,
)
from aerograsp_env.sim.objects import test_objects as named_objects
from aerograsp_env.sim.rgbd_camera import RGBDCameraConfig
from aerograsp_env.sim.scene import JOINT_NAMES, PIPE_HEIGHT
from aerograsp_env.sim.sensors import SensorConfig
from aerograsp_env.sim.wind import WindConfig

IDS = tuple(ENTRY_POINTS)
PLAN = "aerograsp/GraspPlan-v0"
REACH = "aerograsp/Reach-v0"
DOCK_MANIPULATE = "aerograsp/DockManipulate-v0"
GRASP, GRASP_DUAL = "aerograsp/Grasp-v0", "aerograsp/GraspDual-v0"
DETECT = "aerograsp/Detect-v0"
DOCKS = (DOCK, ATTACH)
LIFTS = (GRASP, GRASP_DUAL)
CLASSES = {
    DOCK: DockEnv,
    ATTACH: DockAttachEnv,
    PLAN: GraspPlanEnv,
    REACH: ReachEnv,
    DOCK_MANIPULATE: DockManipulateEnv,
    GRASP: GraspEnv,
    GRASP_DUAL: GraspDualEnv,
    DETECT: DetectEnv,
}
# What a picture shows is tested elsewhere: here it is small, and shows what is soon made.
QUICK: dict[str, Any] = {"camera_config": RGBDCameraConfig(width=48, height=36), "labels": ("can", "box")}
SMALL: dict[str, Any] = {"width": 48, "height": 40}

# Every value of every named option, and one instance of each configuration.
DOCK_OPTIONS: list[dict[str, Any]] = [
    {},
    *({"wind": wind} for wind in ("calm", "light", "gusty", WindConfig(4.0, 0.3, 1.0), {"mean_speed": 1.0})),
    *({"localization": source} for source in ("dock", "gps", "vision", "truth")),
    *({"localization": source, "docked": False} for source in ("gps", "vision", "truth")),
    *({"randomize": value} for value in (False, True, RandomizeConfig(mass=(1.1, 1.2)), {"drag": (1.0, 2.0)})),
    *({"airframe": name} for name in ("belerofonte", "firefly")),
    *({"command_frame": frame} for frame in ("world", "heading")),
    *({"command_delay": delay} for delay in (0.0, 0.1, (0.06, 0.10))),
    *({"payload": mass} for mass in (0.0, 0.5)),
    *({"velocity_limit": limit} for limit in (0.3, (2.0, 2.0, 1.0))),
    *({"reward_mode": mode} for mode in ("dense", "sparse")),
    *({"render_mode": mode} for mode in (None, *available_render_modes())),
    *({"camera": camera, "render_mode": "rgb_array"} for camera in ("side", "front")),
    {"sensors": SensorConfig().scaled(0.5)},
    {"autopilot": {"mpc_xy_vel_p_acc": 2.5}},
    {"tool": {"flex_stiffness": 20.0}},
    {"config": DockConfig(set_point_spread=0.0, skip=1.0)},
]
PLAN_OPTIONS: list[dict[str, Any]] = [
    {},
    *({"objects": objects} for objects in ("test", "train", "validation", "mug", ["mug", "can"], named_objects()[3])),
    *({"randomize": value} for value in (False, True, GraspRandomizeConfig(mass=(1.1, 1.2)), {"noise": (1.0, 2.0)})),
    *({"points": points} for points in (64, 512)),
    *({"gripper": value} for value in (GripperConfig(force=40.0), {"max_width": 0.08})),
    *({"depth_camera": value} for value in (DepthCameraConfig(sigma=0.0), {"occluded_probability": 1.0})),
    *({"judge": value} for value in (JudgeConfig(shake_time=0.5), {"lift": 0.1})),
    *({"reward_mode": mode} for mode in ("dense", "sparse")),
    *({"render_mode": mode} for mode in (None, "rgb_array", "depth_array")),
    *({"camera": camera, "render_mode": "rgb_array"} for camera in ("side", "front", "view")),
]
REACH_OPTIONS: list[dict[str, Any]] = [
    {},
    *({"vehicle": name} for name in ("belerofonte", "aquiles")),
    *({"action_mode": mode} for mode in ("joint_velocity", "ee_twist")),
    {"vehicle": "aquiles", "action_mode": "ee_twist"},
    *({"target_speed": speed} for speed in (0.0, 0.2)),
    *({"pose": pose} for pose in ("exact", "estimated")),
    *({"pose": "estimated", "estimate": value} for value in (PoseEstimateConfig(delay=0.2), {"loss_interval": 1.0})),
    *({"wind": wind} for wind in ("calm", "light", "gusty", WindConfig(4.0, 0.3, 1.0), {"mean_speed": 1.0})),
    *({"localization": source} for source in ("gps", "vision", "truth")),
    *({"payload": mass} for mass in (0.0, 0.3)),
    *({"com_feedforward": value} for value in (True, False)),
    *({"command_delay": delay} for delay in (0.0, 0.1, (0.06, 0.10))),
    *(
        {"randomize": value}
        for value in (False, True, ManipulationRandomizeConfig(mass=(1.1, 1.2)), {"servo_gains": (1.0, 2.0)})
    ),
    {"sensors": SensorConfig().scaled(0.5)},
    {"autopilot": {"mpc_xy_vel_p_acc": 2.5}},
    {"config": ManipulationConfig(active=("right", "left"), joint_rate=1.0)},
    *({"reward_mode": mode} for mode in ("dense", "sparse")),
    *({"render_mode": mode} for mode in (None, *available_render_modes())),
    *({"camera": camera, "render_mode": "rgb_array"} for camera in ("side", "front", "close", "vehicle")),
]
DOCK_MANIPULATE_OPTIONS: list[dict[str, Any]] = [
    {},
    *({"localization": source} for source in ("dock", "gps", "vision", "truth")),
    *({"localization": source, "docked": False} for source in ("gps", "vision", "truth")),
    *({"wind": wind} for wind in ("calm", "light", "gusty", WindConfig(4.0, 0.3, 1.0), {"mean_speed": 1.0})),
    *({"payload": mass} for mass in (0.0, 0.3)),
    *({"com_feedforward": value} for value in (True, False)),
    *({"velocity_limit": limit} for limit in (0.3, (2.0, 2.0, 1.0))),
    *({"command_frame": frame} for frame in ("world", "heading")),
    *({"command_delay": delay} for delay in (0.0, 0.1, (0.06, 0.10))),
    *({"randomize": value} for value in (False, True, {"servo_gains": (1.0, 2.0)})),
    {"sensors": SensorConfig().scaled(0.5)},
    {"tool": {"flex_stiffness": 20.0}},
    {"autopilot": {"mpc_xy_vel_p_acc": 2.5}},
    {"config": ManipulationConfig(joint_rate=1.0)},
    *({"reward_mode": mode} for mode in ("dense", "sparse")),
    *({"render_mode": mode} for mode in (None, *available_render_modes())),
    *({"camera": camera, "render_mode": "rgb_array"} for camera in ("side", "front", "vehicle")),
]
LEVELS = ("easy", "gusty", "biased", "oblique", "heavy")
GRASP_DUAL_OPTIONS: list[dict[str, Any]] = [
    {},
    *({"level": level} for level in (*LEVELS, GraspLevel(mass=None), {"mass": (0.3, 0.4)})),
    {"vehicle": "belerofonte"},
    *({"action_mode": mode} for mode in ("joint_velocity", "ee_twist")),
    *({"pose": pose} for pose in ("exact", "estimated")),
    {"estimate": {"loss_interval": 1.0}},
    *({"wind": wind} for wind in ("calm", "light", "gusty", WindConfig(4.0, 0.3, 1.0), {"mean_speed": 1.0})),
    *({"com_feedforward": value} for value in (True, False)),
    *({"velocity_limit": limit} for limit in (0.3, (2.0, 2.0, 1.0))),
    *({"command_delay": delay} for delay in (0.0, 0.1, (0.06, 0.10))),
    *({"randomize": value} for value in (False, True, {"servo_gains": (1.0, 2.0)})),
    {"sensors": SensorConfig().scaled(0.5)},
    {"autopilot": {"mpc_xy_vel_p_acc": 2.5}},
    {"config": ManipulationConfig(joint_rate=1.0)},
    *({"reward_mode": mode} for mode in ("dense", "sparse")),
    *({"render_mode": mode} for mode in (None, *available_render_modes())),
    *({"camera": camera, "render_mode": "rgb_array"} for camera in ("side", "front", "close", "vehicle")),
]
GRASP_OPTIONS: list[dict[str, Any]] = [
    *GRASP_DUAL_OPTIONS,
    {"vehicle": "aquiles"},
    {"level": "combined"},
    *({"objects": objects} for objects in ("test", "train", "validation", "mug", ["mug", "can"], named_objects()[3])),
]
DETECT_OPTIONS: list[dict[str, Any]] = [
    {},
    *({"level": level} for level in ("easy", "cluttered", "dark", "blurred")),
    *({"labels": labels} for labels in ("crawler", ("can", "fruit"))),
    *({"motion": motion} for motion in ("any", "hover", "pass", "orbit")),
    *({"sensors": sensors} for sensors in ("rgbd", "stereo")),
    {"camera_backend": "ray"},
    *({"camera_config": camera} for camera in (RGBDCameraConfig(40, 36), {"width": 36, "height": 40})),
    *({"wind": wind} for wind in ("calm", "light", "gusty", WindConfig(4.0, 0.3, 1.0), {"mean_speed": 1.0})),
    *(
        {"randomize": value}
        for value in (False, True, ManipulationRandomizeConfig(mass=(1.1, 1.2)), {"drag": (1.0, 2.0)})
    ),
    *({"reward_mode": mode} for mode in ("dense", "sparse")),
    *({"render_mode": mode} for mode in (None, "rgb_array", "depth_array")),
]
OPTIONS = {
    DETECT: DETECT_OPTIONS,
    GRASP: GRASP_OPTIONS,
    GRASP_DUAL: GRASP_DUAL_OPTIONS,
    DOCK: DOCK_OPTIONS,
    ATTACH: DOCK_OPTIONS,
    PLAN: PLAN_OPTIONS,
    REACH: REACH_OPTIONS,
    DOCK_MANIPULATE: DOCK_MANIPULATE_OPTIONS,
}


def make(env_id: str = DOCK, **options: Any) -> Any:
    """The bare environment of any id, without Gymnasium's wrappers; where it has a camera, with a small image."""
    if env_id == DETECT:
        options = {**QUICK, **options}
    return make_dock(env_id, **options) if env_id in DOCKS else gymnasium.make(env_id, **options).unwrapped


def named(options: dict[str, Any]) -> str:
    return ",".join(
        f"{name}={value if np.isscalar(value) else type(value).__name__}" for name, value in options.items()
    )


every_option = pytest.mark.parametrize(
    ("env_id", "options"),
    [(env_id, options) for env_id in IDS for options in OPTIONS[env_id]],
    ids=lambda value: (named(value) or "default") if isinstance(value, dict) else value,
)
every_id = pytest.mark.parametrize("env_id", IDS)
every_dock = pytest.mark.parametrize("env_id", DOCKS)


def equal(first: Any, second: Any) -> bool:
    """Exact equality of nested dicts of arrays and numbers."""
    if isinstance(first, dict):
        return first.keys() == second.keys() and all(equal(first[k], second[k]) for k in first)
    return np.array_equal(first, second, equal_nan=False) and np.asarray(first).dtype == np.asarray(second).dtype


# checkers -----------------------------------------------------------------------------------------


@every_option
def test_gymnasiums_and_stable_baselines3s_checkers_find_nothing(env_id, options):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        quick = QUICK if env_id == DETECT else {}
        env = gymnasium.make(env_id, **SMALL, **{**quick, **options})
        check_env(env.unwrapped)
        sb3_check_env(env.unwrapped if hasattr(env.unwrapped, "compute_reward") else env, warn=True)
        env.close()


def test_every_registered_id_is_covered():
    registered = {name for name in gymnasium.registry if name.startswith("aerograsp/")}
    assert registered == set(IDS) == set(CLASSES)


def test_the_options_above_name_every_option_there_is():
    from aerograsp_env.envs.base import DockBase
    from aerograsp_env.envs.options import dock_config

    known = {*inspect.signature(DockBase.__init__).parameters, *inspect.signature(dock_config).parameters}
    looks = {"width", "height", "render_backend", "render_samples"}  # only how pictures are drawn
    assert known - {"self", "options", "attach"} - looks == {name for options in DOCK_OPTIONS for name in options}
    known = {*inspect.signature(ReachEnv.__init__).parameters, *inspect.signature(reach_task).parameters}
    assert known - {"self", "options"} - looks == {name for options in REACH_OPTIONS for name in options}
    known = {
        *inspect.signature(DockManipulateEnv.__init__).parameters,
        *inspect.signature(dock_manipulate_task).parameters,
    }
    named_ones = {name for options in DOCK_MANIPULATE_OPTIONS for name in options}
    assert known - {"self", "options"} - looks == named_ones
    for env, task, options in (
        (GraspEnv, grasp_task, GRASP_OPTIONS),
        (GraspDualEnv, grasp_dual_task, GRASP_DUAL_OPTIONS),
    ):
        known = {*inspect.signature(env.__init__).parameters, *inspect.signature(task).parameters}
        assert known - {"self", "options"} - looks == {name for option in options for name in option}
    known = {*inspect.signature(DetectEnv.__init__).parameters, *inspect.signature(detect_options).parameters}
    tested = {name for option in DETECT_OPTIONS for name in option} | {"mesh"}  # in test_detect_env
    assert known - {"self", "options"} - looks == tested
    known = {*inspect.signature(GraspPlanEnv.__init__).parameters}
    assert known - {"self"} - looks == {name for options in PLAN_OPTIONS for name in options}


# determinism and reset ----------------------------------------------------------------------------


def rollout(env: gymnasium.Env, seed: int, steps: int = 130) -> list[Any]:
    rng = np.random.default_rng(0)
    steps = {GraspPlanEnv: 6, DetectEnv: 12}.get(type(env), steps)  # of the first every one is an episode
    trace: list[Any] = [env.reset(seed=seed)]
    for _ in range(steps):  # more than two blocks of the noise that is drawn ahead
        trace.append(env.step(rng.uniform(-0.3, 0.3, env.action_space.shape).astype(np.float32)))
        if trace[-1][2]:
            trace.append(env.reset())
    return trace


def truth(env) -> tuple[np.ndarray, ...]:
    """Everything that the future depends on: simulator state, its parameters, both records, the generator."""
    generator = np.frombuffer(json.dumps(env.np_random.bit_generator.state).encode(), np.uint8)
    if isinstance(env, GraspPlanEnv):  # no state outlives a judgement: the object, where it lies, what is seen
        item = env.object
        body = (np.array([item.mass, item.friction]), item.inertia, item.center_of_mass, item.vertices)
        return generator, env.T_cloud_object, *env._observation.values(), *body
    if isinstance(env, DetectEnv):  # the flight's state, and what the camera saw
        poses = [item.T_c_object for item in env.truths]
        return generator, *env._flight.truth(), env.T_world_camera, *poses, *env._observation().values()
    model, data = env.model, env.data
    for flag in (mujoco.mjtState.mjSTATE_FULLPHYSICS, mujoco.mjtState.mjSTATE_INTEGRATION):
        assert mujoco.mj_stateSize(model, flag) > 0
    state = np.zeros(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_INTEGRATION))
    mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
    full = np.zeros(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
    mujoco.mj_getState(model, data, full, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    worlds = env._worlds
    return (
        state, full, data.ctrl.copy(), data.xfrc_applied.copy(), data.qacc_warmstart.copy(), data.sensordata.copy(),
        model.body_mass.copy(), model.body_inertia.copy(), model.body_subtreemass.copy(), model.dof_damping.copy(),
        model.jnt_stiffness.copy(), model.dof_invweight0.copy(), model.actuator_gainprm.copy(),
        model.actuator_biasprm.copy(), model.actuator_forcerange.copy(), model.geom_friction.copy(),
        np.frombuffer(getattr(worlds, "records", np.zeros(0)).tobytes(), np.uint8),
        np.frombuffer(worlds.parameters.tobytes(), np.uint8), np.frombuffer(worlds.states.tobytes(), np.uint8),
        worlds._noise.copy(), worlds._cursors.copy(), worlds.terms.copy(), worlds.metrics.copy(), worlds.flags.copy(),
        generator,
    )  # fmt: skip


VARIANTS = [
    {},
    {"randomize": True, "command_delay": (0.02, 0.10)},
    {"wind": "gusty", "localization": "gps", "docked": False},
]
REACH_VARIANTS: list[dict[str, Any]] = [
    {},
    {"randomize": True, "command_delay": (0.02, 0.10), "pose": "estimated", "wind": "gusty"},
    {"vehicle": "aquiles", "action_mode": "ee_twist", "payload": 0.2},
]
DOCK_MANIPULATE_VARIANTS: list[dict[str, Any]] = [*VARIANTS, {"payload": 0.2, "command_frame": "heading"}]
LIFT_VARIANTS: list[dict[str, Any]] = [{}, {"randomize": True, "command_delay": (0.02, 0.10), "level": "oblique"}]
DETECT_VARIANTS: list[dict[str, Any]] = [
    {},
    {"randomize": True, "wind": "gusty", "level": "cluttered"},
    {"sensors": "stereo", "motion": "orbit"},
]
PLAN_VARIANTS: list[dict[str, Any]] = [{}, {"randomize": True, "objects": "train"}, {"points": 64}]
every_variant = pytest.mark.parametrize(
    ("env_id", "options"),
    [
        *((env_id, options) for env_id in DOCKS for options in VARIANTS),
        *((PLAN, options) for options in PLAN_VARIANTS),
        *((DETECT, options) for options in DETECT_VARIANTS),
        *((REACH, options) for options in REACH_VARIANTS),
        *((DOCK_MANIPULATE, options) for options in DOCK_MANIPULATE_VARIANTS),
        *((env_id, options) for env_id in LIFTS for options in LIFT_VARIANTS),
    ],
    ids=lambda value: named(value) if isinstance(value, dict) else value,
)


@every_variant
def test_a_seed_determines_everything(env_id, options):
    first, second = make(env_id, **options), make(env_id, **options)
    a, b = rollout(first, 7), rollout(second, 7)
    for x, y in zip(a, b, strict=True):
        assert all(equal(p, q) for p, q in zip(x, y, strict=True))
    assert all(np.array_equal(p, q) for p, q in zip(truth(first), truth(second), strict=True))
    other = rollout(make(env_id, **options), 8)
    assert not equal(a[0][0], other[0][0])


@pytest.mark.parametrize(
    ("env_id", "options"),
    [
        *((env_id, options) for env_id in DOCKS for options in VARIANTS),
        *((REACH, options) for options in REACH_VARIANTS),
        *((DOCK_MANIPULATE, options) for options in DOCK_MANIPULATE_VARIANTS),
        *((env_id, options) for env_id in LIFTS for options in LIFT_VARIANTS),
    ],
    ids=lambda value: named(value) if isinstance(value, dict) else value,
)
def test_reset_restores_the_whole_simulator(env_id, options):
    fresh, used = make(env_id, **options), make(env_id, **options)
    fresh.reset(seed=3)
    used.reset(seed=99)
    for _ in range(60):
        used.step(used.action_space.sample())
    data, model = used.data, used.model  # and dirty by hand what a task might touch
    for array in (
        data.qpos,
        data.qvel,
        data.ctrl,
        data.xfrc_applied,
        data.qfrc_applied,
        data.qacc_warmstart,
        data.mocap_pos,
    ):
        array += 0.1
    data.eq_active[:] = 1 - data.eq_active
    data.time = 12.0
    used._worlds.states["rotor_speed"] += 100.0
    if options.get("randomize"):  # what a draw changes
        model.body("airframe").mass *= 1.5
        model.body("airframe").inertia *= 0.5
        if env_id in (REACH, DOCK_MANIPULATE, *LIFTS):
            model.body_mass *= 2.0
            for array in (model.actuator_gainprm, model.actuator_forcerange, model.geom_friction):
                array *= 1.5
        else:
            model.joint("flex").stiffness *= 2.0
            for name in JOINT_NAMES:
                model.joint(name).damping *= 3.0
    used.reset(seed=3)
    for x, y in zip(truth(fresh), truth(used), strict=True):
        assert np.array_equal(x, y)
    action = np.full(used.action_space.shape, 0.1, np.float32)
    for _ in range(30):
        assert all(equal(p, q) for p, q in zip(fresh.step(action), used.step(action), strict=True))


def test_randomisation_draws_a_new_vehicle_each_episode_from_the_nominal_one():
    env = make(randomize={"mass": (0.8, 1.2)})
    nominal = float(make().model.body("airframe").mass[0])
    masses = []
    for seed in range(80):
        env.reset(seed=seed)
        masses.append(float(env.model.body("airframe").mass[0]) / nominal)
    assert 0.8 <= min(masses) < 0.83 and 1.17 < max(masses) <= 1.2  # a product over episodes would leave the range
    assert np.mean(masses) == pytest.approx(1.0, abs=0.05)


def test_two_environments_do_not_share_a_model_they_change():
    one, two = make(randomize=True), make(randomize=True)
    one.reset(seed=0)
    before = one.model.body_mass.copy()
    two.reset(seed=1)
    assert np.array_equal(one.model.body_mass, before)


# explicit start and goal --------------------------------------------------------------------------


@every_dock
def test_explicit_start_and_goal_are_honoured_exactly(env_id):
    env = make(env_id, wind="gusty", randomize=True)
    start, goal = (
        np.array([-0.30, 0.02, 0.40]) if env_id == ATTACH else np.array([0.02, -0.03, 0.01]),
        [0.01, 0.015, -0.01],
    )
    observation, _ = env.reset(seed=1, options={"start": start, "goal": goal, "wind_direction": 1.0})
    nominal = env._worlds.parameters["nominal"][0]
    np.testing.assert_array_equal(env.data.qpos[:3], nominal + start)
    np.testing.assert_array_equal(env._worlds.parameters["set_point"][0], nominal + goal)
    np.testing.assert_array_equal(observation["set_point"], np.float32(goal))
    mean = env._worlds.parameters["mean_wind"][0]
    assert np.arctan2(mean[1], mean[0]) == pytest.approx(1.0)


# info, properties ---------------------------------------------------------------------------------


@every_id
def test_the_documented_attributes_exist(env_id):
    env = gymnasium.make(env_id)
    _, info = env.reset(seed=0)
    assert isinstance(env.unwrapped.model, mujoco.MjModel)
    assert isinstance(env.unwrapped.data, mujoco.MjData)
    assert env.unwrapped.dt > 0.0
    assert env.unwrapped.action_layout
    assert info["success"] is False
    assert info["termination"] == ""
    _, reward, terminated, truncated, info = env.step(env.action_space.sample())
    assert (type(reward), type(terminated), type(truncated), type(info["success"])) == (float, bool, bool, bool)
    assert all(type(value) is float for value in info["reward_terms"].values())
    assert all(type(value) is float for value in info["metrics"].values())
    assert reward == sum(info["reward_terms"].values())
    assert type(info["termination"]) is str
    assert terminated is (info["termination"] != "")


@every_dock
def test_a_dock_step_lasts_twenty_milliseconds_and_an_episode_a_minute(env_id):
    env = gymnasium.make(env_id)
    assert env.unwrapped.dt == pytest.approx(0.02)
    assert env.unwrapped.dt == pytest.approx(10 * env.unwrapped.model.opt.timestep)
    assert env.spec.max_episode_steps * env.unwrapped.dt == pytest.approx(60.0)
    env.reset(seed=0)
    time = env.unwrapped.data.time
    env.step(np.zeros(env.action_space.shape, np.float32))
    assert env.unwrapped.data.time - time == pytest.approx(0.02)


@pytest.mark.parametrize("env_id", IDS)
def test_every_id_has_a_reference_policy_that_speaks_its_spaces(env_id):
    env, policy = gymnasium.make(env_id), aerograsp_env.reference_policy(env_id)
    observation, _ = env.reset(seed=0)
    action, _ = policy.predict(observation)
    assert env.action_space.contains(action)


# rewards ------------------------------------------------------------------------------------------


def expected_terms(env, action_change: float, terminated: bool) -> dict[str, float]:
    """The docstring's reward table, from the true state, by the package's one reward primitive."""
    error = float(np.linalg.norm(env._worlds.parameters["set_point"][0] - env.data.qpos[:3]))
    attach = isinstance(env, DockAttachEnv)
    coupled = bool(env.state["coupled"])
    work = 1.0 if coupled or not attach else 0.0
    terms = {
        "position": work * 0.5 * tolerance(error, margin=0.20, sigmoid="linear"),
        "precision": work * 0.5 * tolerance(error, margin=0.02, sigmoid="long_tail"),
        "effort": -0.2 * min(action_change, 4.0),
        "crash": -10.0 * terminated,
    }
    if attach:
        mujoco.mj_kinematics(env.model, env.data)
        gap = float(np.linalg.norm(env.data.site("base").xpos - env._worlds.parameters["seat_position"][0]))
        terms["approach"] = 0.3 if coupled else 0.3 * tolerance(gap, margin=1.0, sigmoid="long_tail")
    return terms


@every_dock
def test_the_dense_reward_is_the_sum_of_its_documented_terms(env_id):
    env = make(env_id, wind="gusty")
    rng, previous = np.random.default_rng(0), np.zeros(env.action_space.shape)
    env.reset(seed=0)
    for _ in range(200):
        action = rng.uniform(-0.5, 0.5, env.action_space.shape).astype(np.float32)
        _, reward, terminated, _, info = env.step(action)
        assert reward == sum(info["reward_terms"].values())
        expected = expected_terms(env, float(np.sum((action.astype(float) - previous) ** 2)), terminated)
        assert info["reward_terms"].keys() == expected.keys()
        for name, value in expected.items():
            # bodies' places are a tick older than joint positions: 2 ms of motion of the seat's distance
            assert info["reward_terms"][name] == pytest.approx(value, abs=1e-3 if name == "approach" else 1e-9), name
        previous = action.astype(float)
        if terminated:
            break


@every_dock
def test_the_sparse_reward_says_whether_every_axis_is_within_five_centimetres(env_id):
    env, policy = make(env_id, reward_mode="sparse"), aerograsp_env.reference_policy(env_id)
    observation, _ = env.reset(seed=0)
    state, seen = None, set()
    for _ in range(1500):
        action, state = policy.predict(observation, state)
        observation, reward, terminated, _, info = env.step(action)
        error = np.abs(env._worlds.parameters["set_point"][0] - env.data.qpos[:3])
        held = env_id == DOCK or bool(env.state["coupled"])
        within = float(held and not terminated and (error <= 0.05).all())
        assert info["reward_terms"] == {"within": within}
        assert reward == within
        seen.add(reward)
    assert 1.0 in seen


def test_metrics_are_those_of_the_true_error_after_the_first_five_seconds():
    env, policy, state = make(), aerograsp_env.reference_policy(DOCK), None
    observation, _ = env.reset(seed=2)
    errors, changes, previous = [], [], np.zeros(3)
    for _ in range(600):
        action, state = policy.predict(observation, state)
        observation, _, terminated, _, info = env.step(action)
        errors.append(env._worlds.parameters["set_point"][0] - env.data.qpos[:3])
        changes.append(np.sum((action - previous) ** 2))
        previous = action
        assert not terminated
    late = np.array(errors)[250:]
    for i, axis in enumerate("xyz"):
        assert info["metrics"][f"error_{axis}"] == pytest.approx(np.abs(late[:, i]).mean(), rel=1e-9)
        assert info["metrics"][f"bias_{axis}"] == pytest.approx(late[:, i].mean(), abs=1e-12)
        assert info["metrics"][f"std_{axis}"] == pytest.approx(late[:, i].std(), rel=1e-6)
    assert info["metrics"]["error"] == pytest.approx(np.abs(late).mean(), rel=1e-9)
    assert info["metrics"]["effort"] == pytest.approx(np.sqrt(np.mean(changes)), rel=1e-6)
    assert info["success"] is bool((np.abs(late).mean(axis=0) <= 0.05).all())


# terminations -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("reason", "options", "action"),
    [
        ("overload", {"tool": {"overload_force": 1.0}}, (1.0, 1.0, 1.0)),
        ("joint_limit", {"tool": {"overload_force": 1e4}}, (1.0, 0.0, -1.0)),
        ("out_of_bounds", {"docked": False, "localization": "truth", "config": DockConfig(bound=0.5)}, (0.0, 0.0, 1.0)),
        ("collision", {"docked": False, "localization": "truth"}, (0.0, 0.0, -1.0)),
    ],
)
def test_each_termination_happens_and_is_named(reason, options, action):
    env = make(**options)
    env.reset(seed=0)
    if reason == "collision":  # right over the pipe
        above = np.array([0.0, 0.0, PIPE_HEIGHT + 0.7]) - env._worlds.parameters["nominal"][0]
        env.reset(seed=0, options={"goal": (0.0, 0.0, 0.0), "start": above})
    for _ in range(500):
        _, reward, terminated, truncated, info = env.step(np.float32(action))
        if terminated:
            break
    assert terminated and not truncated
    assert info["termination"] == reason
    assert info["reward_terms"]["crash"] == -10.0
    assert reward == sum(info["reward_terms"].values())
    assert info["metrics"]["crash"] == 1.0
    assert info["success"] is False


# documented tables --------------------------------------------------------------------------------


def tables(cls: type) -> list[list[list[str]]]:
    """The Markdown tables of a class's docstring, each a list of rows of cells without its header."""
    found: list[list[list[str]]] = []
    rows: list[list[str]] = []
    for line in [*inspect.getdoc(cls).splitlines(), ""]:
        if line.startswith("|"):
            rows.append([cell.strip() for cell in line.strip("|").split(" | ")])
        elif rows:
            found.append(rows[2:])
            rows = []
    return found


@every_id
def test_the_documented_action_table_is_the_action_space(env_id):
    env, table = make(env_id), tables(CLASSES[env_id])[0]
    if env_id == DETECT:  # the table is that of one slot
        table = [[str(k * len(table) + int(row[0])), *row[1:]] for k in range(SLOTS) for row in table]
    assert env.action_space == gymnasium.spaces.Box(-1.0, 1.0, (len(table),), np.float32)
    assert len(env.action_layout) == len(table)
    for i, (row, dimension) in enumerate(zip(table, env.action_layout, strict=True)):
        number, name, scale, unit, frame = row
        assert (int(number), name, unit, frame) == (i, dimension.name, dimension.unit, dimension.frame)
        assert float(scale) == dimension.scale


@every_id
def test_the_documented_observation_table_is_the_observation_space(env_id):
    env, table = gymnasium.make(env_id).unwrapped, tables(CLASSES[env_id])[1]
    observation, _ = env.reset(seed=0)
    assert {row[0] for row in table} == set(env.observation_space.spaces) == set(observation)
    for name, size, bound, _ in table:  # a bound is "high" for ± high, or "low … high"
        box = env.observation_space[name]
        low, _, high = bound.rpartition(" … ")
        image = " x " in size
        assert box.shape == tuple(int(n) for n in size.split(" x "))
        assert box.dtype == (np.uint8 if image else np.float32)
        np.testing.assert_allclose(box.high, float(high), rtol=1e-7)
        np.testing.assert_allclose(box.low, float(low) if low else -float(high), rtol=1e-7)


@every_id
def test_the_documented_reward_table_is_the_rewards(env_id):
    env, table = make(env_id), tables(CLASSES[env_id])[2]
    _, info = env.reset(seed=0)
    assert {row[0] for row in table} == set(info["reward_terms"])


@every_id
def test_the_documented_options_exist(env_id):
    text = inspect.getdoc(CLASSES[DOCK if env_id in DOCKS else env_id])
    options = text[text.index("Options:") :]
    names = set(re.findall(r"`(\w+)", options)) - {"aerograsp_env", "mesh"}
    assert names and names <= {key for option in OPTIONS[env_id] for key in option}


def test_previous_actions_are_newest_first():
    env = make()
    env.reset(seed=0)
    given = np.random.default_rng(0).uniform(-0.2, 0.2, (8, 3)).astype(np.float32)
    for action in given:
        observation, *_ = env.step(action)
    np.testing.assert_allclose(observation["previous_actions"].reshape(6, 3), given[::-1][:6], atol=1e-7)


def test_the_error_integral_is_the_leaky_integral_of_the_observed_error():
    env = make(wind="gusty")
    observation, _ = env.reset(seed=0)
    total = np.zeros(3)
    for _ in range(100):
        total = np.exp(-env.dt / 10.0) * total + observation["position_error"].astype(float) * env.dt
        observation, *_ = env.step(np.zeros(3, np.float32))
        np.testing.assert_allclose(observation["error_integral"], total, atol=1e-6)


# refusals -----------------------------------------------------------------------------------------


DOCK_REFUSALS: list[tuple[dict[str, Any], tuple[str, ...]]] = [
    ({"wind": "gustyy"}, ("wind", "'gusty'", "'calm'")),
    ({"wind": 3}, ("wind", "WindConfig")),
    ({"localization": "GPS "}, ("localization", "'gps'")),
    ({"localisation": "gps"}, ("localisation", "did you mean 'localization'")),
    ({"windd": "calm"}, ("windd", "did you mean 'wind'")),
    ({"reward_mode": "spars"}, ("reward_mode", "'sparse'")),
    ({"render_mode": "rgb"}, ("render_mode", "'rgb_array'")),
    ({"width": 0}, ("width",)),
    ({"height": 1.5}, ("height",)),
    ({"render_backend": "rays"}, ("render_backend", "'ray'")),
    ({"render_samples": 0}, ("render_samples",)),
    ({"airframe": "firefl"}, ("airframe", "'firefly'")),
    ({"command_frame": "body"}, ("command_frame", "'heading'")),
    ({"command_delay": -0.1}, ("command_delay",)),
    ({"command_delay": 1.0}, ("command_delay", "0.28")),
    ({"command_delay": (0.1, 0.05)}, ("command_delay",)),
    ({"command_delay": "soon"}, ("command_delay", "'soon'")),
    ({"command_delay": float("nan")}, ("command_delay",)),
    ({"payload": -1.0}, ("payload",)),
    ({"payload": "heavy"}, ("payload", "'heavy'")),
    ({"velocity_limit": 3.0}, ("velocity_limit", "Table 5.2")),
    ({"velocity_limit": (1.0, 2.0)}, ("velocity_limit",)),
    ({"velocity_limit": 0.0}, ("velocity_limit",)),
    ({"docked": 1}, ("docked",)),
    ({"randomize": "yes"}, ("randomize", "RandomizeConfig")),
    ({"randomize": {"mas": (1, 1)}}, ("randomize", "mas")),
    ({"randomize": {"mass": (2, 1)}}, ("mass",)),
    ({"sensors": 0.1}, ("sensors", "SensorConfig")),
    ({"autopilot": {"kp": 1}}, ("autopilot", "kp")),
    ({"tool": {"lengths": (0.1, 0.2)}}, ("lengths",)),
    ({"config": {}}, ("config", "DockConfig")),
    ({"camera": "top"}, ("camera", "'side'")),
]
PLAN_REFUSALS: list[tuple[dict[str, Any], tuple[str, ...]]] = [
    ({"objects": "mugg"}, ("objects", "'mug'")),
    ({"objects": 3}, ("objects", "GraspObject")),
    ({"objects": []}, ("objects", "sequence")),
    ({"objects": ["mug", "mug"]}, ("objects", "names of their own")),
    ({"objects": ["mug", "train"]}, ("objects", "'train'")),
    ({"points": 3}, ("points",)),
    ({"points": 64.0}, ("points",)),
    ({"gripper": {"forse": 1.0}}, ("gripper", "forse")),
    ({"gripper": {"force": -1.0}}, ("force",)),
    ({"gripper": 0.1}, ("gripper", "GripperConfig")),
    ({"depth_camera": {"sigma": -1.0}}, ("sigma",)),
    ({"depth_camera": "rgbd"}, ("depth_camera", "DepthCameraConfig")),
    ({"judge": {"lift": -0.1}}, ("lift",)),
    ({"judge": True}, ("judge", "JudgeConfig")),
    ({"randomize": "yes"}, ("randomize", "GraspRandomizeConfig")),
    ({"randomize": {"mass": (2, 1)}}, ("mass",)),
    ({"reward_mode": "spars"}, ("reward_mode", "'sparse'")),
    ({"render_mode": "rgb"}, ("render_mode", "'rgb_array'")),
    ({"width": 0}, ("width",)),
    ({"render_backend": "rays"}, ("render_backend", "'ray'")),
    ({"camera": "tool"}, ("camera", "'side'")),
]


REACH_REFUSALS: list[tuple[dict[str, Any], tuple[str, ...]]] = [
    ({"vehicle": "aquilles"}, ("vehicle", "'aquiles'")),
    ({"action_mode": "joints"}, ("action_mode", "'joint_velocity'")),
    ({"target_speed": -0.1}, ("target_speed",)),
    ({"target_speed": "fast"}, ("target_speed", "'fast'")),
    ({"pose": "exakt"}, ("pose", "'exact'")),
    ({"pose": "estimated", "estimate": {"rate": 60.0}}, ("rate", "50")),
    ({"pose": "estimated", "estimate": {"delay": 1.0}}, ("delay",)),
    ({"estimate": {"position_std": -1.0}}, ("position_std",)),
    ({"estimate": 0.01}, ("estimate", "PoseEstimateConfig")),
    ({"wind": "gustyy"}, ("wind", "'gusty'")),
    ({"localization": "dock"}, ("localization", "'vision'")),
    ({"payload": -1.0}, ("payload",)),
    ({"payload": "heavy"}, ("payload", "'heavy'")),
    ({"com_feedforward": 1}, ("com_feedforward",)),
    ({"command_delay": 1.0}, ("command_delay", "0.28")),
    ({"randomize": {"mas": (1, 1)}}, ("randomize", "mas")),
    ({"randomize": {"mass": (2, 1)}}, ("mass",)),
    ({"sensors": 0.1}, ("sensors", "SensorConfig")),
    ({"config": {}}, ("config", "ManipulationConfig")),
    ({"vehicel": "aquiles"}, ("vehicel", "did you mean 'vehicle'")),
    ({"reward_mode": "spars"}, ("reward_mode", "'sparse'")),
    ({"camera": "top"}, ("camera", "'side'")),
    ({"width": 0}, ("width",)),
]


DOCK_MANIPULATE_REFUSALS: list[tuple[dict[str, Any], tuple[str, ...]]] = [
    ({"docked": 1}, ("docked",)),
    ({"docked": False}, ("localization='dock' needs docked=True",)),
    ({"localization": "GPS "}, ("localization", "'gps'")),
    ({"localisation": "gps"}, ("localisation", "did you mean 'localization'")),
    ({"vehicle": "aquiles"}, ("vehicle", "options")),
    ({"command_frame": "body"}, ("command_frame", "'heading'")),
    ({"velocity_limit": 3.0}, ("velocity_limit", "Table 5.2")),
    ({"tool": {"lengths": (0.1, 0.2)}}, ("lengths",)),
    ({"tool": 0.1}, ("tool", "DockingToolConfig")),
    ({"wind": "gustyy"}, ("wind", "'gusty'")),
    ({"payload": -1.0}, ("payload",)),
    ({"com_feedforward": 1}, ("com_feedforward",)),
    ({"command_delay": 1.0}, ("command_delay", "0.28")),
    ({"randomize": {"mas": (1, 1)}}, ("randomize", "mas")),
    ({"sensors": 0.1}, ("sensors", "SensorConfig")),
    ({"config": {}}, ("config", "ManipulationConfig")),
    ({"reward_mode": "spars"}, ("reward_mode", "'sparse'")),
    ({"camera": "close"}, ("camera", "'side'")),
]


DETECT_REFUSALS: list[tuple[dict[str, Any], tuple[str, ...]]] = [
    ({"level": "darc"}, ("level", "'dark'")),
    ({"labels": "hamer"}, ("labels", "'hammer'")),
    ({"labels": ()}, ("labels", "at least one")),
    ({"mesh": "nowhere.obj"}, ("mesh", "labels=")),
    ({"mesh": "nowhere.obj", "labels": "can"}, ("mesh", "nowhere.obj")),
    ({"motion": "orbits"}, ("motion", "'orbit'")),
    ({"sensors": "rgb"}, ("sensors", "'rgbd'")),
    ({"camera_backend": "rays"}, ("camera_backend", "'ray'")),
    ({"camera_config": {"widht": 3}}, ("camera_config", "widht")),
    ({"camera_config": {"max_depth": 9.0}}, ("camera_config", "max_depth", "6 m")),
    ({"camera_config": "small"}, ("camera_config", "RGBDCameraConfig")),
    ({"wind": "gustyy"}, ("wind", "'gusty'")),
    ({"randomize": "yes"}, ("randomize", "ManipulationRandomizeConfig")),
    ({"level ": "dark"}, ("level ", "did you mean 'level'")),
    ({"reward_mode": "spars"}, ("reward_mode", "'sparse'")),
    ({"render_mode": "rgb"}, ("render_mode", "'rgb_array'")),
    ({"width": 0}, ("width",)),
]


GRASP_REFUSALS: list[tuple[dict[str, Any], tuple[str, ...]]] = [
    ({"level": "eazy"}, ("level", "'easy'")),
    ({"level": {"masse": (0.1, 0.2)}}, ("level", "'mass'")),
    ({"level": {"mass": (0.2, 0.1)}}, ("GraspLevel.mass",)),
    ({"level": {"slope": (0.0, 1.0)}}, ("GraspLevel.slope",)),
    ({"level": {"supports": ()}}, ("GraspLevel.supports",)),
    ({"level": {"spread": (0.1, 0.1)}}, ("GraspLevel.spread",)),
    ({"objects": "mugg"}, ("objects", "'mug'")),
    ({"objects": []}, ("objects", "sequence")),
    ({"vehicle": "aquilles"}, ("vehicle", "'aquiles'")),
    ({"pose": "exakt"}, ("pose", "'exact'")),
    ({"estimate": 0.01}, ("estimate", "PoseEstimateConfig")),
    ({"wind": "gustyy"}, ("wind", "'gusty'")),
    ({"velocity_limit": 3.0}, ("velocity_limit", "Table 5.2")),
    ({"localization": "gps"}, ("localization", "options")),
    ({"config": {}}, ("config", "ManipulationConfig")),
    ({"camera": "top"}, ("camera", "'side'")),
]


@pytest.mark.parametrize(
    ("env_id", "options", "words"),
    [
        *((GRASP, options, words) for options, words in GRASP_REFUSALS),
        (GRASP_DUAL, {"vehicle": "aquiles"}, ("aquiles", "'left'")),
        (GRASP_DUAL, {"objects": "mug"}, ("objects", "options")),
        *((REACH, options, words) for options, words in REACH_REFUSALS),
        *((DOCK_MANIPULATE, options, words) for options, words in DOCK_MANIPULATE_REFUSALS),
        *((env_id, options, words) for env_id in DOCKS for options, words in DOCK_REFUSALS),
        *((PLAN, options, words) for options, words in PLAN_REFUSALS),
        *((DETECT, options, words) for options, words in DETECT_REFUSALS),
    ],
    ids=lambda value: named(value) if isinstance(value, dict) else "" if isinstance(value, tuple) else value,
)
def test_bad_options_are_refused_by_name(env_id, options, words):
    with pytest.raises(ValueError) as caught, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Gymnasium itself warns of an unknown render_mode
        gymnasium.make(env_id, **options)
    assert all(word in str(caught.value) for word in words), str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_undocked_tool_senses_no_position():
    with pytest.raises(ValueError, match="localization='dock' needs docked=True"):
        gymnasium.make(DOCK, docked=False)


@pytest.mark.parametrize("wrong", ["aerograsp/Dokc-v0", "aerograsp/Dock-v7", "aerograsp/Dck-v0"])
def test_unknown_ids_name_the_nearest(wrong):
    with pytest.raises((ValueError, gymnasium.error.Error), match="Dock"):
        gymnasium.make(wrong)
    with pytest.raises(ValueError, match="aerograsp/Dock-v0"):
        aerograsp_env.reference_policy(wrong)


@every_id
@pytest.mark.parametrize(
    ("action", "word"),
    [
        (lambda n: np.full(n, np.nan, np.float32), "finite"),
        (lambda n: np.full(n, np.inf, np.float32), "finite"),
        (lambda n: np.zeros(n + 1, np.float32), "shape"),
        (lambda n: np.zeros((1, n), np.float32), "shape"),
        (lambda n: 0.0, "shape"),
        (lambda n: ["a"] * n, "numeric"),
        (lambda n: np.zeros(n, bool), "numeric"),
        (lambda n: np.zeros(n, complex), "numeric"),
        (lambda n: None, "numeric"),
    ],
)
def test_bad_actions_are_refused_and_change_nothing(env_id, action, word):
    env = make(env_id)
    env.reset(seed=0)
    before = truth(env)
    with pytest.raises(ValueError, match=f"action must .*{word}"):
        env.step(action(env.action_space.shape[0]))
    assert all(np.array_equal(a, b) for a, b in zip(before, truth(env), strict=True))


@every_id
def test_actions_beyond_one_count_as_one(env_id):
    one, two = make(env_id), make(env_id)
    one.reset(seed=0)
    two.reset(seed=0)
    n = one.action_space.shape
    for _ in range(1 if env_id == PLAN else 5):
        assert all(equal(a, b) for a, b in zip(one.step(np.full(n, 7.0)), two.step(np.ones(n)), strict=True))


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"gaol": (0, 0, 0)}, "goal"),
        ({"goal": (0.0, 0.0)}, "goal"),
        ({"goal": (0.0, np.nan, 0.0)}, "goal"),
        ({"start": (1.0, 0.0, 0.0)}, "start"),
        ({"tilt": (1.0, 0.0)}, "tilt"),
        ({"wind_direction": np.inf}, "wind_direction"),
    ],
)
def test_bad_reset_options_are_refused(options, word):
    env = make()
    with pytest.raises(ValueError, match=word):
        env.reset(seed=0, options=options)
    env.reset(seed=0, options=AT_NOMINAL)  # and the environment is still good


@every_id
def test_stepping_before_the_first_reset_is_refused(env_id):
    env = make(env_id)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros(env.action_space.shape, np.float32))
