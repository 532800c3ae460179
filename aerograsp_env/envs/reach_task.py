"""Reach's own part of a step: a target on a path within the arm's reach, and what counts.

Paths are closed curves of joint angles, q(s) = q₀ + a sin s + b cos s, taken through the arm's kinematics at the
hover's nominal pose: what they pass through can be reached, and is checked to be clear of the vehicle. With a and b
the joint motions that move the tool along two perpendicular vectors of equal length, they are nearly circles. They are
followed at constant speed.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from aerograsp_env.envs.options import scalar
from aerograsp_env.sim.config import CONTROL_STEP
from aerograsp_env.sim.kernel_math import compiled
from aerograsp_env.sim.manipulation import layout as lay
from aerograsp_env.sim.manipulation.config import ManipulationConfig
from aerograsp_env.sim.manipulation.kernel_arm import forward, jacobian
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
POINTS = 128  # of a path
RADII = (0.06, 0.12)  # of the nearly circular paths [m]
MARGIN = 0.15  # of a path from the joint limits [rad]
LOWEST_GAIN = 0.05  # least singular value of the position's Jacobian along a path [m/rad]
HIGHEST, HINDMOST = -0.22, -0.10  # of a path, body z and x [m]: below the vehicle and in front
BENDING_RADIUS = 0.04  # least along a path [m]
START_SPREAD = 0.15  # of the first joint angles about home [rad]
CHECKED = 8  # configurations along a path that are checked for reach and collisions
_ATTEMPTS, _BATCH = 400, 64

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


@compiled
def _trace(p, center, sine, cosine, out):
    """Tool positions (M, 3), body frame, along q(s) = center + sine sin s + cosine cos s."""
    poses, tool, q = np.empty((lay.JOINTS, 4, 4)), np.empty((4, 4)), np.empty(lay.JOINTS)
    for m in range(out.shape[0]):
        s = 2.0 * math.pi * m / out.shape[0]
        for i in range(center.shape[0]):
            q[i] = center[i] + sine[i] * math.sin(s) + cosine[i] * math.cos(s)
        forward(p, 0, q, poses, tool)
        for i in range(3):
            out[m, i] = tool[i, 3]


@compiled
def _gain(p, q, moves):
    """The square of the least singular value of the tool's Jacobian (position) at q (n,); its pseudo-inverse (n, 3)."""
    n = q.shape[0]
    poses, tool, j = np.empty((lay.JOINTS, 4, 4)), np.empty((4, 4)), np.empty((6, lay.JOINTS))
    padded = np.zeros(lay.JOINTS)
    padded[:n] = q
    forward(p, 0, padded, poses, tool)
    jacobian(p, 0, poses, tool, j)
    gram = np.zeros((3, 3))
    for a in range(3):
        for b in range(3):
            for i in range(n):
                gram[a, b] += j[a, i] * j[b, i]
    least = np.linalg.eigvalsh(gram)[0]
    if least > LOWEST_GAIN**2:
        inverse = np.linalg.inv(gram)
        moves[:] = 0.0
        for i in range(n):
            for a in range(3):
                for b in range(3):
                    moves[i, a] += j[b, i] * inverse[b, a]
    return least


@compiled
def _bends(curve):
    """The least radius of curvature of a closed curve (M, 3) of equal parameter steps, by central differences [m]."""
    count, least = curve.shape[0], 1e9
    for m in range(count):
        before, here, after = curve[m - 1], curve[m], curve[(m + 1) % count]
        u, v = 0.5 * (after - before), after - 2.0 * here + before
        x, y, z = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
        speed = math.sqrt(u[0] ** 2 + u[1] ** 2 + u[2] ** 2)
        turning = math.sqrt(x * x + y * y + z * z)
        if turning > 0.0:
            least = min(least, speed**3 / turning)
    return least


@compiled
def _search(p, low, high, uniforms, normals, curve, waves):
    """The first of M drawn paths that is good, or −1: uniforms (M, n + 1) in [0, 1), normals (M, 2, 3).

    Writes its points (POINTS, 3), body frame, and its joint waves (3, n): centre, sine, cosine.
    """
    n = low.shape[0]
    moves, q = np.empty((n, 3)), np.empty(n)
    for k in range(uniforms.shape[0]):
        center = low + uniforms[k, :n] * (high - low)
        if _gain(p, center, moves) < LOWEST_GAIN**2:
            continue
        u = normals[k, 0] / np.linalg.norm(normals[k, 0])
        v = normals[k, 1] - np.sum(normals[k, 1] * u) * u
        v /= np.linalg.norm(v)
        largest = RADII[1]  # that the joints' limits leave
        for i in range(n):
            sine, cosine = np.sum(moves[i] * u), np.sum(moves[i] * v)
            waves[0, i], waves[1, i], waves[2, i] = center[i], sine, cosine
            room = min(center[i] - low[i], high[i] - center[i])
            largest = min(largest, room / max(math.sqrt(sine**2 + cosine**2), 1e-9))
        if largest < RADII[0]:
            continue
        waves[1:] *= RADII[0] + uniforms[k, n] * (largest - RADII[0])
        _trace(p, waves[0], waves[1], waves[2], curve)
        if curve[:, 2].max() > HIGHEST or curve[:, 0].min() < HINDMOST or _bends(curve) < BENDING_RADIUS:
            continue
        able = True
        for m in range(CHECKED):
            s = 2.0 * math.pi * m / CHECKED
            for i in range(n):
                q[i] = waves[0, i] + waves[1, i] * math.sin(s) + waves[2, i] * math.cos(s)
            able = able and _gain(p, q, moves) >= LOWEST_GAIN**2
        if able:
            return k
    return -1


def equidistant(curve: NDArray[np.float64], count: int) -> tuple[NDArray[np.float64], float]:
    """`count` points at equal distances along the closed polygon `curve` (M, 3), and its length [m]."""
    closed = np.concatenate([curve, curve[:1]])
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    at = np.arange(count) * along[-1] / count
    return np.stack([np.interp(at, along, closed[:, i]) for i in range(3)], axis=1), float(along[-1])


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
            path, length = self._draw_path(episode)
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

    def _draw_path(self, episode: Episode) -> tuple[NDArray[np.float64], float]:
        """Equidistant points (POINTS, 3), body frame of the level vehicle, and the length of a clear path."""
        rng, n, p = episode.rng, self.arm.n, episode.parameters.reshape(1)[0]
        low, high = self.arm.limits.T + np.array([[MARGIN], [-MARGIN]])
        curve, waves, angles = np.empty((POINTS, 3)), np.empty((3, n)), 2.0 * np.pi * np.arange(CHECKED) / CHECKED
        for _ in range(_ATTEMPTS):
            uniforms, normals = rng.uniform(size=(_BATCH, n + 1)), rng.standard_normal((_BATCH, 2, 3))
            if _search(p, low, high, uniforms, normals, curve, waves) < 0:
                continue
            configurations = waves[0] + np.outer(np.sin(angles), waves[1]) + np.outer(np.cos(angles), waves[2])
            if self._clear(episode, configurations):
                path, length = equidistant(curve, POINTS)
                return np.roll(path, -rng.integers(POINTS), axis=0), length if self.target_speed > 0.0 else 0.0
        raise RuntimeError(f"no path of targets found for {self.arm.name!r} in {_ATTEMPTS * _BATCH} attempts")

    @staticmethod
    def _clear(episode: Episode, configurations: NDArray[np.float64]) -> bool:
        joints = episode.arm_joints(0)
        for q in configurations:
            joints[:] = q
            mujoco.mj_fwdPosition(episode.model, episode.data)
            if episode.data.ncon:
                return False
        return True

    def mark(self, record: np.void, state: np.void) -> NDArray[np.float64]:
        """The target's position."""
        return np.array(record["target"][:3, 3])
