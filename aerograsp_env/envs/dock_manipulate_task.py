"""DockManipulate: what is drawn for an episode, and the names and order of what its step gives.

The point is drawn by a joint configuration taken through the arm's kinematics with the vehicle level at its set-point:
what is drawn can be reached, in front and below, clear of the vehicle and away from the pipe.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from aerograsp_env.envs.dock_manipulate_kernel import METRICS, RECORD, TERMS, evaluate, reached
from aerograsp_env.sim.actions import ActionDimension
from aerograsp_env.sim.config import DockConfig
from aerograsp_env.sim.docking_tool import R_WORLD_BASE
from aerograsp_env.sim.layout import DOCK_OBSERVATION, OBSERVED_ACTIONS
from aerograsp_env.sim.manipulation import layout as lay
from aerograsp_env.sim.manipulation.config import ManipulationConfig
from aerograsp_env.sim.manipulation.reset import COMMON_OPTIONS
from aerograsp_env.sim.manipulation.task import Episode, Task, arm_dimensions
from aerograsp_env.sim.reset import offset_option
from aerograsp_env.sim.scene import DOCK_POSITION, PIPE_HEIGHT, PIPE_RADIUS, quaternion

MARGIN = 0.15  # of a drawn configuration from the joint limits [rad]
LOWEST_GAIN = 0.05  # least singular value of the position's Jacobian there [m/rad]
HIGHEST, HINDMOST = -0.22, -0.10  # of a point, body z and x [m]: below the vehicle and in front
PIPE_CLEARANCE = 0.15  # of a point from the pipe's surface [m]
ARM_SPREAD = 0.15  # of the first joint angles about home [rad]
FARTHEST_START = 0.10  # of an explicit start from the set-point, per axis: the tool's room [m]
_ATTEMPTS = 4000
_SPREADS = DockConfig()  # set-points, starts and the clamped base's tilt are drawn as in Dock-v0


class DockManipulateTask(Task):
    """The arm's tool is held at a point."""

    record = RECORD
    terms: ClassVar[tuple[str, ...]] = TERMS
    metrics: ClassVar[tuple[str, ...]] = METRICS
    always_reported: ClassVar[tuple[str, ...]] = ("effort", "contacts", "crash", "clamp_force_max")
    reset_options: ClassVar[tuple[str, ...]] = ("goal", "start", "arm_start", "tilt", *COMMON_OPTIONS)
    evaluate = staticmethod(evaluate)

    def __init__(self, config: ManipulationConfig) -> None:
        super().__init__(config)
        dimensions, slots = arm_dimensions(config)
        frame = config.autopilot.command_frame
        velocity = [
            ActionDimension(f"velocity_{axis}", limit, "m/s", frame)
            for axis, limit in zip("xyz", config.velocity_limit, strict=True)
        ]
        self.actions = (*velocity, *dimensions)
        self.slots = np.array([lay.BASE_SLOT + i for i in range(3)] + slots)
        self.arm = config.machine.mounts[0].arm
        n, docking = self.arm.n, dict((name, (name, size, bound)) for name, size, bound in DOCK_OBSERVATION)
        docking["previous_actions"] = ("previous_actions", OBSERVED_ACTIONS * len(self.slots), 1.0)
        self.observation = (
            *docking.values(),
            ("arm_joints", n, float(np.pi)), ("arm_rates", n, 20.0), ("arm_loads", n, 2.0), ("arm_lag", n, 1.0),
            ("end_effector", 9, 5.0), ("target", 3, 5.0),
        )  # fmt: skip

    def reward_terms(self, reward_mode: str) -> tuple[str, ...]:
        """The shaped terms, or whether the tool is within the success distance."""
        return TERMS[:-1] if reward_mode == "dense" else TERMS[-1:]

    def begin(self, episode: Episode) -> None:
        """Draw set-point, start, the base's tilt, the arm's first configuration and the point."""
        rng, p, record, options = episode.rng, episode.parameters, episode.record, episode.options
        set_point = rng.uniform(-_SPREADS.set_point_spread, _SPREADS.set_point_spread, 3)
        start = rng.uniform(-_SPREADS.start_spread, _SPREADS.start_spread, 3)
        tilt = rng.normal(0.0, _SPREADS.tilt_std, 2)
        n, limits = self.arm.n, self.arm.limits
        arm = np.clip(self.arm.home + rng.uniform(-ARM_SPREAD, ARM_SPREAD, n), limits[:, 0], limits[:, 1])
        given = offset_option(options, "start", FARTHEST_START)
        start = start if given is None else given
        tip = DOCK_POSITION + R_WORLD_BASE @ np.asarray(self.config.tool.nominal_tip)
        record["nominal"] = tip - np.asarray(self.config.airframe.tip_position)
        record["set_point"] = p["hold_position"] = record["nominal"] + set_point
        goal = self._goal(options)
        episode.data.qpos[:3] = record["set_point"]
        record["target"] = self._draw_point(episode) if goal is None else record["nominal"] + goal
        episode.data.qpos[:3] += start
        episode.arm_joints(0)[:] = self._arm_start(options, arm)
        level, seat = np.zeros(4), np.zeros(4)
        mujoco.mju_euler2Quat(level, np.array([*_tilt(options, tilt), 0.0]), "xyz")
        mujoco.mju_mulQuat(seat, quaternion(R_WORLD_BASE), level)
        episode.data.mocap_quat[0] = seat

    def _goal(self, options: dict[str, Any]) -> NDArray[np.float64] | None:
        if "goal" not in options:
            return None
        goal = np.asarray(options["goal"], dtype=float)
        mount = self.config.machine.mounts[0]
        reach = sum(float(np.linalg.norm(joint.T_parent_joint[:3, 3])) for joint in self.arm.joints)
        reach += float(np.linalg.norm(self.arm.T_last_tool[:3, 3]))
        if goal.shape != (3,) or not np.isfinite(goal).all() or np.linalg.norm(goal - mount.T_body_base[:3, 3]) > reach:
            raise ValueError(
                f"options['goal'] must be a point within {reach:.3f} m of the arm's base, from the vehicle's nominal "
                f"place (3,) [m], got {options['goal']!r}"
            )
        return goal

    def _arm_start(self, options: dict[str, Any], drawn: NDArray[np.float64]) -> NDArray[np.float64]:
        if "arm_start" not in options:
            return drawn
        start, limits = np.asarray(options["arm_start"], dtype=float), self.arm.limits
        if start.shape != (self.arm.n,) or not ((start >= limits[:, 0]) & (start <= limits[:, 1])).all():
            raise ValueError(
                f"options['arm_start'] must be {self.arm.n} joint angles within the limits [rad], "
                f"got {options['arm_start']!r}"
            )
        return start

    def _draw_point(self, episode: Episode) -> NDArray[np.float64]:
        """A world point (3,) that the arm of the level vehicle reaches where it now stands."""
        low, high = self.arm.limits.T + np.array([[MARGIN], [-MARGIN]])
        p, origin, point = episode.parameters.reshape(1)[0], episode.data.qpos[:3].copy(), np.empty(3)
        joints = episode.arm_joints(0)
        for _ in range(_ATTEMPTS):
            q = episode.rng.uniform(low, high)
            if reached(p, q, point) < LOWEST_GAIN or point[2] > HIGHEST or point[0] < HINDMOST:
                continue
            x, _, z = origin + point
            if math.hypot(x, z - PIPE_HEIGHT) < PIPE_RADIUS + PIPE_CLEARANCE:
                continue
            joints[:] = q
            mujoco.mj_fwdPosition(episode.model, episode.data)
            if not episode.data.ncon:
                return origin + point
        raise RuntimeError(f"no point found for {self.arm.name!r} in {_ATTEMPTS} attempts")

    def mark(self, record: np.void, state: np.void) -> NDArray[np.float64]:
        """The point."""
        return np.array(record["target"])


def _tilt(options: dict[str, Any], drawn: NDArray[np.float64]) -> NDArray[np.float64]:
    """The clamped base's tilt about the two horizontal axes (2,) [rad]."""
    tilt = np.asarray(options.get("tilt", drawn), dtype=float)
    if tilt.shape != (2,) or not np.isfinite(tilt).all() or np.abs(tilt).max() > 0.35:
        raise ValueError(f"options['tilt'] must be two angles within ±0.35 rad, got {options['tilt']!r}")
    return tilt
