"""DockManipulate's own part of a step: a point in the world for the free arm's tool, and what counts.

The point is drawn by a joint configuration taken through the arm's kinematics with the vehicle level at its set-point:
what is drawn can be reached, in front and below, clear of the vehicle and away from the pipe.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim.actions import ActionDimension
from aerograsp_env.sim.config import CONTROL_STEP, DockConfig
from aerograsp_env.sim.docking_tool import R_WORLD_BASE
from aerograsp_env.sim.kernel_math import clip, compiled
from aerograsp_env.sim.layout import DOCK_OBSERVATION, INTEGRAL_LEAK, OBSERVED_ACTIONS
from aerograsp_env.sim.manipulation import layout as lay
from aerograsp_env.sim.manipulation.config import ManipulationConfig
from aerograsp_env.sim.manipulation.kernel_arm import forward, jacobian
from aerograsp_env.sim.manipulation.kernel_rows import (
    clip_row,
    command_change,
    mishaps,
    put_gyro,
    put_heading,
    put_joint_rates,
    put_joints,
    put_lag,
    put_loads,
    put_position,
    put_rotation,
    put_tilt,
)
from aerograsp_env.sim.manipulation.reset import COMMON_OPTIONS
from aerograsp_env.sim.manipulation.task import Episode, Task, arm_dimensions
from aerograsp_env.sim.reset import offset_option
from aerograsp_env.sim.scene import DOCK_POSITION, PIPE_HEIGHT, PIPE_RADIUS, quaternion

SUCCESS_ERROR = 0.02  # [m], mean over an episode's counted steps
SKIP = 5.0  # errors count from here [s]
MARGIN = 0.15  # of a drawn configuration from the joint limits [rad]
LOWEST_GAIN = 0.05  # least singular value of the position's Jacobian there [m/rad]
HIGHEST, HINDMOST = -0.22, -0.10  # of a point, body z and x [m]: below the vehicle and in front
PIPE_CLEARANCE = 0.15  # of a point from the pipe's surface [m]
ARM_SPREAD = 0.15  # of the first joint angles about home [rad]
FARTHEST_START = 0.10  # of an explicit start from the set-point, per axis: the tool's room [m]
_ATTEMPTS = 4000
_SPREADS = DockConfig()  # set-points, starts and the clamped base's tilt are drawn as in Dock-v0

RECORD = np.dtype(
    [
        ("nominal", np.float64, (3,)),  # airframe origin with the tool in its nominal docked pose, world [m]
        ("set_point", np.float64, (3,)),  # airframe origin to hold, world [m]
        ("target", np.float64, (3,)),  # for the arm's tool, world [m]
        ("error_integral", np.float64, (3,)),  # as observed
        ("distance", np.float64),  # true, arm's tool to target [m]
        ("error_sum", np.float64),
        ("error_max", np.float64),
        ("estimate_sum", np.float64),  # of the estimated tool's distance from the true one
        ("hover_sum", np.float64),
        ("count", np.int64),
        ("effort_sum", np.float64),
        ("mishaps", np.int64),
    ],
    align=True,
)
TERMS = ("position", "precision", "effort", "crash", "within")
METRICS = (
    "error", "error_max", "estimate_error", "hover", "effort", "contacts", "crash", "clamp_force_max",
)  # fmt: skip
_SKIP_STEPS = round(SKIP / CONTROL_STEP)


@compiled
def _put_in_command_frame(p, s, vector, out, k):
    """A world vector (3) in the frame of velocity commands: the world's, or turned with the estimated heading."""
    c, d = 1.0, 0.0
    if p.heading_frame == 1:
        heading = math.atan2(s.attitude[1, 0], s.attitude[0, 0])
        c, d = math.cos(heading), math.sin(heading)
    out[k], out[k + 1], out[k + 2] = c * vector[0] + d * vector[1], c * vector[1] - d * vector[0], vector[2]
    return k + 3


@compiled
def _observe(p, s, task, slots, out, bounds):
    """Writes the row in the order of DockManipulateTask.observation."""
    away = np.empty(3)
    for i in range(3):
        away[i] = task.set_point[i] - s.estimate[i]
    k = _put_in_command_frame(p, s, away, out, 0)
    for i in range(3):
        out[k + i] = task.error_integral[i]
    k = _put_in_command_frame(p, s, s.velocity_estimate, out, k + 3)
    k = put_tilt(s, out, k)
    k = put_heading(s, out, k)
    k = put_gyro(s, out, k)
    for i in range(3):
        out[k + i] = s.specific_force[i]
    for j in range(5):
        out[k + 3 + j] = s.joints[j]
    for i in range(3):
        out[k + 8 + i] = s.base_acceleration[i]
    k += 11
    for a in range(OBSERVED_ACTIONS):
        for i in range(slots.shape[0]):
            out[k] = s.commands[a, slots[i]]
            k += 1
    for i in range(3):
        out[k + i] = task.set_point[i] - task.nominal[i]
        away[i] = task.target[i] - s.estimate[i]
    k = put_joints(p, s, 0, out, k + 3)
    k = put_joint_rates(p, s, 0, out, k)
    k = put_loads(p, s, 0, out, k)
    k = put_lag(p, s, 0, out, k)
    k = put_position(s.tool[0], out, k)
    k = put_rotation(s.tool[0], out, k)
    for j in range(3):
        out[k + j] = s.attitude[0, j] * away[0] + s.attitude[1, j] * away[1] + s.attitude[2, j] * away[2]
    clip_row(out, bounds)


@compiled
def _account(p, s, task, terms, metrics, flags):
    """True errors, rewards, figures so far."""
    distance, believed, hover = 0.0, 0.0, 0.0
    for i in range(3):
        true, estimated = s.position[i], s.estimate[i]
        for j in range(3):
            true += s.rotation[i, j] * s.true_tool[0, j, 3]
            estimated += s.attitude[i, j] * s.tool[0, j, 3]
        distance += (task.target[i] - true) ** 2
        believed += (estimated - true) ** 2
        hover += (task.set_point[i] - s.position[i]) ** 2
    distance, believed, hover = math.sqrt(distance), math.sqrt(believed), math.sqrt(hover)
    change = command_change(s)
    task.distance = distance
    task.effort_sum += change
    task.mishaps += 1 if mishaps(s) else 0
    if s.step > _SKIP_STEPS:
        task.error_sum += distance
        task.error_max = max(task.error_max, distance)
        task.estimate_sum += believed
        task.hover_sum += hover
        task.count += 1
    crashed = s.termination != lay.RUNNING
    terms[0] = 0.5 * max(1.0 - 0.9 * distance / 0.5, 0.0)
    terms[1] = 0.5 / (1.0 + 9.0 * (distance / SUCCESS_ERROR) ** 2)
    terms[2] = -0.2 * min(change, 4.0)
    terms[3] = -10.0 if crashed else 0.0
    terms[4] = 1.0 if distance <= SUCCESS_ERROR and not crashed else 0.0
    count = max(task.count, 1)
    metrics[0], metrics[1], metrics[2] = task.error_sum / count, task.error_max, task.estimate_sum / count
    metrics[3], metrics[4] = task.hover_sum / count, math.sqrt(task.effort_sum / s.step)
    metrics[5], metrics[6], metrics[7] = task.mishaps, 1.0 if crashed else 0.0, s.clamp_force_max
    flags[0] = task.count > 0 and metrics[0] <= SUCCESS_ERROR and not crashed
    flags[1] = crashed
    flags[2] = task.count > 0


@compiled
def evaluate(
    parameters, states, records, noise, cursors, active, stepped, bounds, slots, observations, terms, metrics, flags,
    first, last,
):  # fmt: skip
    """Writes the worlds' rows; see `Task`."""
    for n in range(first, last):
        if not active[n]:
            continue
        p, s, task = parameters[n], states[n], records[n]
        if stepped:
            for i in range(3):  # of what was observed until now: a row starts with the position error
                task.error_integral[i] = clip(
                    INTEGRAL_LEAK * task.error_integral[i] + observations[n, i] * CONTROL_STEP,
                    -bounds[3 + i],
                    bounds[3 + i],
                )
            _account(p, s, task, terms[n], metrics[n], flags[n])
        _observe(p, s, task, slots, observations[n], bounds)


@compiled
def _reached(p, q, position):
    """Writes the tool's place (3,), body frame, at q (n,); returns its Jacobian's least singular value [m/rad]."""
    n = q.shape[0]
    poses, tool, j = np.empty((lay.JOINTS, 4, 4)), np.empty((4, 4)), np.empty((6, lay.JOINTS))
    padded = np.zeros(lay.JOINTS)
    padded[:n] = q
    forward(p, 0, padded, poses, tool)
    jacobian(p, 0, poses, tool, j)
    gram = np.zeros((3, 3))
    for a in range(3):
        position[a] = tool[a, 3]
        for b in range(3):
            for i in range(n):
                gram[a, b] += j[a, i] * j[b, i]
    return math.sqrt(max(np.linalg.eigvalsh(gram)[0], 0.0))


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
            if _reached(p, q, point) < LOWEST_GAIN or point[2] > HIGHEST or point[0] < HINDMOST:
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
