"""What a control step means for grasping, compiled: estimates, observation, reward, figures, and why it failed."""

from __future__ import annotations

import math

import numpy as np

from aerograsp_env.sim.config import CONTROL_STEP
from aerograsp_env.sim.kernel_math import compiled
from aerograsp_env.sim.manipulation import layout as lay
from aerograsp_env.sim.manipulation.kernel_rows import (
    clip_row,
    command_change,
    mishaps,
    put_action,
    put_gripper,
    put_gyro,
    put_heading,
    put_joint_rates,
    put_joints,
    put_lag,
    put_loads,
    put_position,
    put_rotation,
    put_tilt,
    put_velocity,
)
from aerograsp_env.sim.manipulation.kernel_track import begin_track, relative, track

CLOUD = 256  # points of the tracker's model
SUCCESS_RISE, SUCCESS_TIME = 0.10, 1.0  # [m], [s]
LIFTED = 0.02  # [m] of rise from which the object counts as lifted
FALLEN = 0.05  # [m] below its start: it left its support
PRESSED_STEPS = 10  # of both fingers' touch in a row: the object is between the jaws
CLOSED = 0.3  # of the jaws' travel from which they count as closed at some time
MISHAP_STEPS = 50  # in which the arm touched the surroundings: it collided
_SUCCESS_STEPS = round(SUCCESS_TIME / CONTROL_STEP)

CAUSES = ("", "missed", "slipped", "collided", "jammed", "timed_out")
NONE, MISSED, SLIPPED, COLLIDED, JAMMED, TIMED_OUT = range(len(CAUSES))

TERMS = ("reach", "grip", "lift", "hold", "effort", "crash", "held")
METRICS = ("lift", "lift_time", "hover", "slip", "effort", "contacts", "crash", *CAUSES[1:])

F, I = np.float64, np.int64  # noqa: E741
RECORD = np.dtype(
    [
        ("scene", I, (4,)),  # by which the pool knows what stands in the world
        ("support", F, (4, 4)),  # T_world_seat
        ("center", F, (3,)),  # the object's centre of mass, its frame [m]
        ("cloud", F, (CLOUD, 6)),  # points and normals, object frame
        # the estimate of the support, by the names that `kernel_track` reads
        ("track", F, (4, 4)),
        ("track_age", I),
        ("track_phase", F),
        ("track_lost", I),
        ("track_slow", F, (2, 3)),
        ("captures", F, (lay.CAPTURES, 4, 4)),
        ("capture_age", I, (lay.CAPTURES,)),
        # what happened so far
        ("start", F, (3,)),  # airframe, world [m]
        ("start_height", F),  # of the object's centre of mass [m]
        ("rise", F),  # of it since then [m]
        ("rise_max", F),
        ("up_steps", I),  # in a row with a rise of 0.10 m
        ("success_step", I),  # 0: none yet
        ("pressed_steps", I),  # in a row with every finger on the object
        ("pressed", I),  # it was between the jaws at some time
        ("lifted", I),
        ("fallen", I),
        ("closed", I),
        ("mishaps", I),
        ("hold_point", F, (3,)),  # centre of mass in the first arm's tool frame when it came between the jaws [m]
        ("slip", F),
        ("hover_sum", F),
        ("effort_sum", F),
        ("cause", I),
    ],
    align=True,
)


@compiled
def _observe(p, s, task, slots, out, bounds):
    """Writes the row in the order of GraspTask.observation; the cloud, which does not change, is left alone."""
    k = put_velocity(s, out, 0)
    k = put_tilt(s, out, k)
    k = put_heading(s, out, k)
    k = put_gyro(s, out, k)
    for arm in range(p.arms):
        k = put_joints(p, s, arm, out, k)
    for arm in range(p.arms):
        k = put_joint_rates(p, s, arm, out, k)
    for arm in range(p.arms):
        k = put_loads(p, s, arm, out, k)
    for arm in range(p.arms):
        k = put_lag(p, s, arm, out, k)
    for arm in range(p.arms):
        k = put_gripper(p, s, arm, out, k)
    for arm in range(p.arms):
        k = put_position(s.tool[arm], out, k)
        k = put_rotation(s.tool[arm], out, k)
    k = put_position(s.track, out, k)
    k = put_rotation(s.track, out, k)
    out[k] = s.track_age * CONTROL_STEP
    k += 1
    for i in range(3):
        out[k + i] = task.track[i, 2]
        out[k + 3 + i] = task.track[i, 3]
    k = put_action(s, slots, out, k + 6)
    clip_row(out[:k], bounds[:k])
    return k


@compiled
def _center(s, task, out):
    """The object's centre of mass (3,), world."""
    for i in range(3):
        out[i] = s.object[i, 3]
        for j in range(3):
            out[i] += s.object[i, j] * task.center[j]


@compiled
def _point_in_tool(s, arm, point, out):
    """A world point in the true tool frame of an arm."""
    body = np.empty(3)
    for i in range(3):
        body[i] = 0.0
        for j in range(3):
            body[i] += s.rotation[j, i] * (point[j] - s.position[j])
    tool = s.true_tool[arm]
    for i in range(3):
        out[i] = 0.0
        for j in range(3):
            out[i] += tool[j, i] * (body[j] - tool[j, 3])


@compiled
def _reach(p, s, task):
    """Mean over the arms of the distance [m] from the tool to the nearest point of the object's surface."""
    total = 0.0
    at, local = np.empty(3), np.empty(3)
    for arm in range(p.arms):
        for i in range(3):
            at[i] = s.position[i] - s.object[i, 3]
            for j in range(3):
                at[i] += s.rotation[i, j] * s.true_tool[arm, j, 3]
        for i in range(3):
            local[i] = s.object[0, i] * at[0] + s.object[1, i] * at[1] + s.object[2, i] * at[2]
        nearest = 1e9
        for c in range(CLOUD):
            x, y, z = local[0] - task.cloud[c, 0], local[1] - task.cloud[c, 1], local[2] - task.cloud[c, 2]
            nearest = min(nearest, x * x + y * y + z * z)
        total += math.sqrt(nearest)
    return total / p.arms


@compiled
def _touching(p, s):
    """How many of the vehicle's fingers touch the object."""
    fingers = 0
    for arm in range(p.arms):
        fingers += s.contacts[lay.C_LEFT_0 + 2 * arm] > 0
        fingers += s.contacts[lay.C_RIGHT_0 + 2 * arm] > 0
    return fingers


@compiled
def _follow(p, s, task, fingers):
    """What the object and the gripper did in this step."""
    center, local = np.empty(3), np.empty(3)
    _center(s, task, center)
    task.rise = center[2] - task.start_height
    task.rise_max = max(task.rise_max, task.rise)
    task.up_steps = task.up_steps + 1 if task.rise >= SUCCESS_RISE else 0
    if task.up_steps >= _SUCCESS_STEPS and task.success_step == 0:
        task.success_step = s.step
    task.pressed_steps = task.pressed_steps + 1 if fingers == 2 * p.arms else 0
    _point_in_tool(s, 0, center, local)
    if task.pressed_steps == PRESSED_STEPS:
        task.pressed = 1
        task.hold_point[:] = local
    if task.pressed_steps >= PRESSED_STEPS:
        slip = math.sqrt(
            (local[0] - task.hold_point[0]) ** 2
            + (local[1] - task.hold_point[1]) ** 2
            + (local[2] - task.hold_point[2]) ** 2
        )
        task.slip = max(task.slip, slip)
    if fingers > 0 and task.rise > LIFTED:
        task.lifted = 1
    if task.rise < -FALLEN:
        task.fallen = 1
    for arm in range(p.arms):
        if s.screw[arm] > CLOSED * p.jaw_travel[arm]:
            task.closed = 1
    if mishaps(s):
        task.mishaps += 1


@compiled
def _protected(p, s):
    for arm in range(p.arms):
        for i in range(p.joints[arm]):
            if s.protected[arm, i] == 1:
                return True
    return False


@compiled
def failure(p, s, task):
    """Why the episode has not succeeded, were it to end now; the order of the rules is that of `GraspEnv`'s table."""
    if s.termination != lay.RUNNING:
        return COLLIDED
    if task.success_step > 0:
        return NONE
    if task.pressed_steps >= PRESSED_STEPS:
        return TIMED_OUT if task.rise > LIFTED else JAMMED
    if task.lifted == 1 or task.pressed == 1:
        return SLIPPED
    if task.mishaps >= MISHAP_STEPS or task.fallen == 1:
        return COLLIDED
    if _protected(p, s):
        return JAMMED
    return MISSED if task.closed == 1 else TIMED_OUT


@compiled
def _account(p, s, task, terms, metrics, flags):
    """Rewards and figures so far."""
    fingers = _touching(p, s)
    _follow(p, s, task, fingers)
    change = command_change(s)
    task.effort_sum += change
    away = 0.0
    for i in range(3):
        away += (s.position[i] - task.start[i]) ** 2
    task.hover_sum += math.sqrt(away)
    crashed = s.termination != lay.RUNNING
    task.cause = failure(p, s, task)
    distance = _reach(p, s, task)
    terms[0] = 0.2 / (1.0 + 9.0 * (distance / 0.15) ** 2)
    terms[1] = 0.1 * fingers / p.arms
    terms[2], terms[3] = 0.0, 0.0
    if fingers > 0:
        terms[2] = 0.3 * min(max(task.rise / SUCCESS_RISE, 0.0), 1.0)
        terms[3] = 0.3 if task.rise >= SUCCESS_RISE else 0.0
    terms[4] = -0.1 * min(change, 4.0)
    terms[5] = -10.0 if crashed else 0.0
    terms[6] = 1.0 if task.up_steps >= _SUCCESS_STEPS and not crashed else 0.0
    metrics[0] = task.rise_max
    metrics[1] = CONTROL_STEP * (task.success_step if task.success_step > 0 else s.step)
    metrics[2] = task.hover_sum / s.step
    metrics[3] = task.slip
    metrics[4] = math.sqrt(task.effort_sum / s.step)
    metrics[5] = task.mishaps
    metrics[6] = 1.0 if crashed else 0.0
    for c in range(1, len(CAUSES)):
        metrics[6 + c] = 1.0 if task.cause == c else 0.0
    flags[0] = task.success_step > 0 and not crashed
    flags[1] = crashed
    flags[2] = True


@compiled
def _begin(p, s, task):
    """What an episode is measured against."""
    center = np.empty(3)
    _center(s, task, center)
    task.start_height = center[2]
    for i in range(3):
        task.start[i] = s.position[i]
    task.track_slow[:] = s.track_slow
    task.track_phase = s.track_phase
    task.cause = TIMED_OUT


@compiled
def evaluate(
    parameters, states, records, noise, cursors, active, stepped, bounds, slots, observations, terms, metrics, flags,
    first, last,
):  # fmt: skip
    """Follows the object and its support with the tracker, and writes the worlds' rows; see `Task`.

    The support is seen by the same camera in the same images: the tracker's noise, wander and bias are the object's.
    """
    body, seat = np.empty((4, 4)), np.empty((4, 4))
    for n in range(first, last):
        if not active[n]:
            continue
        p, s, task = parameters[n], states[n], records[n]
        row, out = noise[n, cursors[n] - 1], observations[n]
        relative(s.rotation, s.position, s.object, body)
        relative(s.rotation, s.position, task.support, seat)
        if stepped:
            track(p, s, body, row)
            track(p, task, seat, row)
        else:
            _begin(p, s, task)
            begin_track(p, s, body, row)
            begin_track(p, task, seat, row)
        k = _observe(p, s, task, slots, out, bounds)
        if stepped:
            _account(p, s, task, terms[n], metrics[n], flags[n])
        else:
            for c in range(CLOUD):
                for i in range(6):
                    out[k + 6 * c + i] = task.cloud[c, i]
