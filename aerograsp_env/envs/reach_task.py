"""Reach's own part of a step: a target on a path within the arm's reach, and what counts."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.envs.options import scalar
from aerograsp_env.envs.reach_path import POINTS, draw_path
from aerograsp_env.sim.config import CONTROL_STEP
from aerograsp_env.sim.kernel_math import compiled
from aerograsp_env.sim.manipulation import layout as lay
from aerograsp_env.sim.manipulation.config import ManipulationConfig
from aerograsp_env.sim.manipulation.kernel_rows import (
    clip_row,
    command_change,
    mishaps,
    put_action,
    put_gyro,
    put_joint_rates,
    put_joints,
    put_lag,
    put_position,
    put_tilt,
    put_velocity,
)
from aerograsp_env.sim.manipulation.kernel_track import begin_track, relative, track
from aerograsp_env.sim.manipulation.reset import COMMON_OPTIONS
from aerograsp_env.sim.manipulation.task import Episode, Task, arm_dimensions

SUCCESS_DISTANCE = 0.02  # [m]
SKIP = 2.0  # errors count from here [s]
START_SPREAD = 0.15  # of the first joint angles about home [rad]

RECORD = np.dtype(
    [
        ("path", np.float64, (POINTS, 3)),  # equidistant points of a closed curve, world [m]
        ("length", np.float64),  # of the curve [m]; 0: a point
        ("speed", np.float64),  # [m/s]
        ("target", np.float64, (4, 4)),  # T_world_target; not turned
        ("distance", np.float64),  # true, tool to target [m]
        ("error_sum", np.float64),
        ("error_max", np.float64),
        ("hover_sum", np.float64),
        ("count", np.int64),
        ("effort_sum", np.float64),
        ("mishaps", np.int64),
    ],
    align=True,
)
TERMS = ("distance", "outside")
METRICS = ("error", "error_max", "hover", "effort", "contacts", "crash")
_SKIP_STEPS = round(SKIP / CONTROL_STEP)


@compiled
def _place_target(task, time):
    """The target at `time` [s] since the episode's beginning."""
    share = 0.0
    if task.length > 0.0:
        share = task.speed * time / task.length
    at = POINTS * (share - math.floor(share))
    first = int(at) % POINTS
    second, part = (first + 1) % POINTS, at - math.floor(at)
    for i in range(3):
        task.target[i, 3] = (1.0 - part) * task.path[first, i] + part * task.path[second, i]
        for j in range(3):
            task.target[i, j] = 1.0 if i == j else 0.0
        task.target[3, i] = 0.0
    task.target[3, 3] = 1.0


@compiled
def _observe(p, s, slots, out, bounds):
    """Writes the row in the order of ReachTask.observation."""
    k = put_joints(p, s, 0, out, 0)
    k = put_joint_rates(p, s, 0, out, k)
    k = put_lag(p, s, 0, out, k)
    k = put_velocity(s, out, k)
    k = put_gyro(s, out, k)
    k = put_tilt(s, out, k)
    out[k] = s.track_age * CONTROL_STEP
    k = put_action(s, slots, out, k + 1)
    k = put_position(s.tool[0], out, k)
    put_position(s.track, out, k)
    clip_row(out, bounds)


@compiled
def goal_distance(row):
    """|achieved − desired| of the six last entries of a row, as `envs.reach.goal_reward` computes it."""
    k = row.shape[0] - 6
    x = np.float64(row[k]) - np.float64(row[k + 3])
    y = np.float64(row[k + 1]) - np.float64(row[k + 4])
    z = np.float64(row[k + 2]) - np.float64(row[k + 5])
    return math.sqrt(x * x + y * y + z * z)


@compiled
def _account(p, s, task, row, terms, metrics, flags):
    """True errors, rewards, figures so far."""
    distance, hover = 0.0, 0.0
    for i in range(3):
        at = s.position[i]
        for j in range(3):
            at += s.rotation[i, j] * s.true_tool[0, j, 3]
        distance += (task.target[i, 3] - at) ** 2
        hover += (s.position[i] - p.hold_position[i]) ** 2
    distance, hover = math.sqrt(distance), math.sqrt(hover)
    task.distance = distance
    task.effort_sum += command_change(s)
    task.mishaps += 1 if mishaps(s) else 0
    if s.step > _SKIP_STEPS:
        task.error_sum += distance
        task.error_max = max(task.error_max, distance)
        task.hover_sum += hover
        task.count += 1
    crashed = s.termination != lay.RUNNING
    observed = goal_distance(row)
    terms[0] = -observed
    terms[1] = -1.0 if observed > SUCCESS_DISTANCE else 0.0
    count = max(task.count, 1)
    metrics[0], metrics[1], metrics[2] = task.error_sum / count, task.error_max, task.hover_sum / count
    metrics[3] = math.sqrt(task.effort_sum / s.step)
    metrics[4], metrics[5] = task.mishaps, 1.0 if crashed else 0.0
    flags[0] = distance <= SUCCESS_DISTANCE and not crashed
    flags[1] = crashed
    flags[2] = task.count > 0


@compiled
def evaluate(
    parameters, states, records, noise, cursors, active, stepped, bounds, slots, observations, terms, metrics, flags,
    first, last,
):  # fmt: skip
    """Moves the targets and their estimates, and writes the worlds' rows; see `Task`."""
    body = np.empty((4, 4))
    for n in range(first, last):
        if not active[n]:
            continue
        p, s, task = parameters[n], states[n], records[n]
        row = noise[n, cursors[n] - 1]
        _place_target(task, s.step * CONTROL_STEP)
        relative(s.rotation, s.position, task.target, body)
        if stepped:
            track(p, s, body, row)
        else:
            begin_track(p, s, body, row)
        _observe(p, s, slots, observations[n], bounds)
        if stepped:
            _account(p, s, task, observations[n], terms[n], metrics[n], flags[n])


class ReachTask(Task):
    """The tool follows a moving point."""

    record = RECORD
    terms: ClassVar[tuple[str, ...]] = TERMS
    metrics: ClassVar[tuple[str, ...]] = METRICS
    always_reported: ClassVar[tuple[str, ...]] = ("effort", "contacts", "crash")
    reset_options: ClassVar[tuple[str, ...]] = ("goal", "start", *COMMON_OPTIONS)
    evaluate = staticmethod(evaluate)

    def __init__(self, config: ManipulationConfig, target_speed: float = 0.1) -> None:
        super().__init__(config)
        self.target_speed = scalar("target_speed", target_speed)
        if not 0.0 <= self.target_speed <= 1.0:
            raise ValueError(f"target_speed must be in [0, 1] m/s, got {target_speed}")
        dimensions, slots = arm_dimensions(config)
        self.actions, self.slots = tuple(dimensions), np.array(slots)
        self.arm = config.machine.mounts[0].arm
        self.parts = (
            ("joints", self.arm.n), ("joint_rates", self.arm.n), ("command_lag", self.arm.n), ("velocity", 3),
            ("angular_velocity", 3), ("tilt", 2), ("target_age", 1), ("previous_action", len(slots)),
        )  # fmt: skip
        size = sum(n for _, n in self.parts)
        self.observation = (("observation", size, 20.0), ("achieved_goal", 3, 5.0), ("desired_goal", 3, 5.0))

    @property
    def observation_layout(self) -> dict[str, slice]:
        """Where each part of the observation `observation` stands."""
        result, first = {}, 0
        for name, size in self.parts:
            result[name] = slice(first, first + size)
            first += size
        return result

    def reward_terms(self, reward_mode: str) -> tuple[str, ...]:
        """One term: the distance, or whether it is too large."""
        return ("distance",) if reward_mode == "dense" else ("outside",)

    def begin(self, episode: Episode) -> None:
        """Draw the arm's first configuration and the target's path, or take those of the options."""
        rng, p, record = episode.rng, episode.parameters, episode.record
        n, limits = self.arm.n, self.arm.limits
        start = np.clip(self.arm.home + rng.uniform(-START_SPREAD, START_SPREAD, n), limits[:, 0], limits[:, 1])
        goal = self._goal(episode.options)
        if goal is None:
            path, length = draw_path(episode, self.arm.limits)
            length = length if self.target_speed > 0.0 else 0.0
        else:
            path, length = np.tile(goal, (POINTS, 1)), 0.0
        record["path"] = p["hold_position"] + path
        record["length"], record["speed"] = length, self.target_speed
        episode.arm_joints(0)[:] = self._start(episode.options, start)

    def _goal(self, options: dict[str, Any]) -> NDArray[np.float64] | None:
        if "goal" not in options:
            return None
        goal = np.asarray(options["goal"], dtype=float)
        mount = self.config.machine.mounts[0]
        reach = sum(float(np.linalg.norm(joint.T_parent_joint[:3, 3])) for joint in self.arm.joints)
        reach += float(np.linalg.norm(self.arm.T_last_tool[:3, 3]))
        if goal.shape != (3,) or not np.isfinite(goal).all() or np.linalg.norm(goal - mount.T_body_base[:3, 3]) > reach:
            raise ValueError(
                f"options['goal'] must be a point within {reach:.3f} m of the arm's base, body frame of the level "
                f"vehicle (3,) [m], got {options['goal']!r}"
            )
        return goal

    def _start(self, options: dict[str, Any], drawn: NDArray[np.float64]) -> NDArray[np.float64]:
        if "start" not in options:
            return drawn
        start, limits = np.asarray(options["start"], dtype=float), self.arm.limits
        if start.shape != (self.arm.n,) or not ((start >= limits[:, 0]) & (start <= limits[:, 1])).all():
            raise ValueError(
                f"options['start'] must be {self.arm.n} joint angles within the limits [rad], got {options['start']!r}"
            )
        return start

    def mark(self, record: np.void, state: np.void) -> NDArray[np.float64]:
        """The target's position."""
        return np.array(record["target"][:3, 3])
