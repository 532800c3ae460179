"""Grasping's own part of a world: an object on a support within the arm's reach, and what counts."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Any, ClassVar, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from aerograsp_env.envs.grasp_kernel import CAUSES, CLOUD, METRICS, RECORD, TERMS, evaluate
from aerograsp_env.envs.grasp_levels import GraspLevel
from aerograsp_env.envs.grasp_pool import GraspPool, Setting
from aerograsp_env.envs.manipulation_options import manipulation_config
from aerograsp_env.envs.options import choose, instance
from aerograsp_env.sim.actions import ActionDimension
from aerograsp_env.sim.autopilot import AutopilotConfig
from aerograsp_env.sim.manipulation import layout as lay
from aerograsp_env.sim.manipulation.config import ManipulationConfig
from aerograsp_env.sim.manipulation.reset import COMMON_OPTIONS
from aerograsp_env.sim.manipulation.scene import Piece
from aerograsp_env.sim.manipulation.standing import SUPPORT_BODY, set_item, standing
from aerograsp_env.sim.manipulation.task import Episode, Task, arm_dimensions
from aerograsp_env.sim.objects import GraspObject
from aerograsp_env.sim.objects.surface_points import surface_points
from aerograsp_env.sim.objects.variants import heavier
from aerograsp_env.sim.scene import quaternion
from aerograsp_env.sim.wind import WindConfig
from aerograsp_env.spatial import so3_exp, transform

Array = NDArray[np.float64]

CLEARANCE = 0.03  # [m] at least between the open fingers and the object's top


class Posture(NamedTuple):
    """How an arm begins, and where the object then lies."""

    joints: tuple[float, ...]  # [rad]; the tool points down, 0.36 m below the base
    place: tuple[float, float]  # of the object's centre of mass: ahead of the arm's base, below it [m]


POSTURES = {
    "hecatonquiros-4dof": Posture(tuple(np.radians([0.0, -90.0, 90.0, 0.0])), (0.15, 0.46)),
    "hecatonquiros-6dof": Posture(tuple(np.radians([0.0, 0.0, -100.0, 0.0, 100.0, 0.0])), (0.16, 0.49)),
}


_JAW_UNIT = "m/s of each finger, > 0 closes"


class _Drawn(NamedTuple):
    """What `scene` drew for the episode that `begin` places."""

    setting: Setting
    item: GraspObject  # with its mass and surface


class GraspTask(Task):
    """Take an object with every active arm, and lift it.

    Args:
        config: of the vehicle; the active arms grasp.
        level: what is drawn.
        pool: of objects at rest.

    Raises:
        ValueError: an arm that has no posture to begin in.
    """

    record = RECORD
    terms: ClassVar[tuple[str, ...]] = TERMS
    metrics: ClassVar[tuple[str, ...]] = METRICS
    always_reported: ClassVar[tuple[str, ...]] = METRICS
    reset_options: ClassVar[tuple[str, ...]] = ("object", *COMMON_OPTIONS)
    evaluate = staticmethod(evaluate)

    def __init__(self, config: ManipulationConfig, level: GraspLevel, pool: GraspPool) -> None:
        super().__init__(config)
        self.level, self.pool = level, pool
        self.mounts = config.machine.mounts
        for mount in self.mounts:
            if mount.arm.name not in POSTURES:
                raise ValueError(f"vehicle: expected arms among {sorted(POSTURES)}, got {mount.arm.name!r}")
        self.actions, self.slots = _actions(config)
        self.observation = _observation(config, len(self.slots))
        self._pads = [
            mount.prefix + name
            for mount in self.mounts
            for name in ("left_pad", "right_pad", "left_finger", "right_finger")
        ]
        self._drawn: _Drawn | None = None
        self._names: dict[bytes, tuple[str, str]] = {}  # of object and support, by their scene

    def reward_terms(self, reward_mode: str) -> tuple[str, ...]:
        """All but `held`, or that alone."""
        return tuple(name for name in TERMS if name != "held") if reward_mode == "dense" else ("held",)

    def pieces(self) -> tuple[Piece]:
        """Any object on a support: every episode has its own."""
        setting = self.pool.draw(np.random.default_rng(0))
        return (standing(setting.item, setting.support),)

    def shown_pieces(self, record: np.void) -> tuple[Piece]:
        """The episode's object and support."""
        return (standing(*self.pool.scene(record["scene"])),)

    def scene(self, rng: np.random.Generator, options: dict[str, Any]) -> mujoco.MjModel:
        """Draw the object, what it stands on and how, its mass and surface."""
        name = options.get("object")
        if name is not None:
            name = choose("options['object']", name, self.pool.names)
        setting = self.pool.draw(rng, name)
        share = rng.random(2)
        item = heavier(setting.item, _within(self.level.mass, share[0]), _within(self.level.friction, share[1]))
        model = copy.copy(self.pool.model(self.config, setting))
        set_item(model, item, setting.support, self._pads, self.mounts[0].arm.gripper.jaws.friction)
        self._drawn = _Drawn(setting, item)
        return model

    def begin(self, episode: Episode) -> None:
        """Arms into their postures, the object and its support below and ahead of them, the estimate's errors."""
        drawn, p, record, rng = self._drawn, episode.parameters, episode.record, episode.rng
        assert drawn is not None  # `scene` came first
        for i, mount in enumerate(self.mounts):
            episode.arm_joints(i)[:] = POSTURES[mount.arm.name].joints
        heading = rng.uniform(*self.level.heading)
        offset = rng.uniform(-1.0, 1.0, 3) * self.level.spread
        setting, item = drawn.setting, drawn.item
        turned = transform(so3_exp([0.0, 0.0, heading]), np.zeros(3))
        standing_there = turned @ setting.T_world_object
        center = standing_there[:3, :3] @ item.center_of_mass + standing_there[:3, 3]
        top = float((item.vertices @ standing_there[2, :3]).max() + standing_there[2, 3] - center[2])
        turned[:3, 3] = p["hold_position"] + self._place(offset, top) - center
        T = turned @ setting.T_world_object
        a, mocap = int(p["object_address"]), int(episode.model.body(SUPPORT_BODY).mocapid[0])
        episode.data.qpos[a : a + 3], episode.data.qpos[a + 3 : a + 7] = T[:3, 3], quaternion(T[:3, :3])
        episode.data.mocap_pos[mocap] = turned[:3, 3]
        episode.data.mocap_quat[mocap] = quaternion(turned[:3, :3])
        record["scene"] = setting.scene
        record["support"] = turned @ setting.support.T_world_seat
        record["center"] = item.center_of_mass
        record["cloud"] = surface_points(setting.item, CLOUD)
        lengths = rng.uniform(*self.level.position_bias), rng.uniform(*self.level.rotation_bias)
        directions = rng.standard_normal((2, 3))
        p["track_bias"] = np.array(lengths)[:, None] * directions / np.linalg.norm(directions, axis=1, keepdims=True)

    def _place(self, offset: Array, top: float) -> Array:
        """(3,) of the object's centre of mass, body frame of the level vehicle [m]; lower where its top comes too near.

        With two arms it is midway between their bases.
        """
        base = np.mean([mount.T_body_base[:3, 3] for mount in self.mounts], axis=0)
        posture = POSTURES[self.mounts[0].arm.name]
        ahead, below = posture.place
        place = base + (ahead, 0.0, -below) + offset
        mount = self.mounts[0]
        T_body_tool = mount.T_body_base @ mount.arm.link_poses(np.array(posture.joints))[-1]
        tips = T_body_tool[2, 3] - 0.5 * mount.arm.gripper.jaws.pad_height
        place[2] = min(place[2], tips - CLEARANCE - top)
        return np.asarray(place)

    def told(self, record: np.void) -> dict[str, str]:
        """What `info` says of an episode: the cause of its failure so far, its object and support."""
        key = record["scene"].tobytes()
        if key not in self._names:
            item, support = self.pool.scene(record["scene"])
            self._names[key] = item.name, support.name
        name, kind = self._names[key]
        return {"cause": CAUSES[record["cause"]], "object": name, "support": kind}


def _within(bounds: tuple[float, float] | None, share: float) -> float | None:
    return None if bounds is None else bounds[0] + share * (bounds[1] - bounds[0])


def _actions(config: ManipulationConfig) -> tuple[tuple[ActionDimension, ...], NDArray[np.int64]]:
    """Velocity, then each arm's joints and gripper."""
    frame = config.autopilot.command_frame
    axes = zip("xyz", config.velocity_limit, strict=True)
    actions = [ActionDimension(f"velocity_{axis}", limit, "m/s", frame) for axis, limit in axes]
    slots = [lay.BASE_SLOT + i for i in range(3)]
    dimensions, arm_slots = arm_dimensions(config)
    each = len(dimensions) // len(config.machine.mounts)
    for i, mount in enumerate(config.machine.mounts):
        prefix = f"{mount.side}_" if len(config.machine.mounts) > 1 else ""
        actions += dimensions[each * i : each * (i + 1)]
        actions.append(
            ActionDimension(f"{prefix}gripper", mount.arm.gripper.jaw_speed, "m/s of each finger, > 0 closes", "jaws")
        )
        slots += [*arm_slots[each * i : each * (i + 1)], lay.GRIPPER_SLOT + i]
    return tuple(actions), np.array(slots)


def _observation(config: ManipulationConfig, actions: int) -> tuple[tuple[str, int, float], ...]:
    arms = config.machine.mounts
    joints = sum(mount.arm.n for mount in arms)
    return (
        ("velocity", 3, 5.0), ("attitude", 3, np.pi), ("angular_velocity", 3, 20.0), ("joints", joints, np.pi),
        ("joint_rates", joints, 20.0), ("joint_loads", joints, 1.5), ("command_lag", joints, 1.0),
        ("gripper", 2 * len(arms), 2.0), ("tool", 9 * len(arms), 2.0), ("object", 9, 5.0), ("object_age", 1, 20.0),
        ("support", 6, 5.0), ("previous_action", actions, 1.0), ("object_cloud", 6 * CLOUD, 1.0),
    )  # fmt: skip


def grasp_config(
    level: GraspLevel,
    active: tuple[str, ...],
    *,
    wind: str | WindConfig | dict | None,
    autopilot: AutopilotConfig | dict | None,
    config: ManipulationConfig | None,
    **options: Any,
) -> ManipulationConfig:
    """A vehicle that flies by velocity commands in its heading's frame; air and tracker as the level says."""
    base = config if config is not None else ManipulationConfig()
    if not isinstance(base, ManipulationConfig):
        raise ValueError(f"config must be a ManipulationConfig, got {config!r}")
    pilot = base.autopilot if autopilot is None else instance("autopilot", autopilot, AutopilotConfig)
    settings = manipulation_config(
        wind=level.wind if wind is None else wind,
        autopilot=replace(pilot, command_frame="heading"),
        config=replace(base, active=active, hold=False),
        **options,
    )
    if settings.estimate is None:
        return settings
    return replace(settings, estimate=replace(settings.estimate, delay=level.delay))
