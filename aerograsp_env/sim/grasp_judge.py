"""Does a grasp hold? The gripper closes on the object, takes its weight, lifts and shakes it; contacts alone hold it.

The sequence, in MuJoCo (`aerograsp_env.sim.grasp_scene`):

0. approach: the open gripper comes from behind along the approach axis; deep contact anywhere is a collision.
1. close: the fingers press with their constant force; the object's support carries its weight.
2. load: its weight comes onto the fingers. 3. lift. 4. shake along the gripper's three axes. 5. hold still.

**Held**: at the end both fingers touch the object, and its centre of mass has moved less than 0.10 m relative to the
gripper since the fingers closed. **Strict**: held, and the object's point at the grasp centre has moved less than
20 mm and the object turned less than 20° relative to the gripper.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import NamedTuple

import mujoco
import numpy as np
from mujoco import rollout
from numpy.typing import NDArray

from aerograsp_env.interfaces import Grasp
from aerograsp_env.sim.grasp_scene import TIMESTEP, grasp_model
from aerograsp_env.sim.gripper import GripperConfig, gripper_pose
from aerograsp_env.sim.objects import GraspObject
from aerograsp_env.spatial import check_transform, inverse, matrix_from_quat_wxyz, quat_wxyz_from_matrix

Array = NDArray[np.float64]

OUTCOMES = ("held", "dropped", "slipped away", "missed", "collision", "degenerate", "too wide")
HELD_DISTANCE = 0.10  # [m] the centre of mass may move relative to the gripper
STRICT_SLIP = 0.020  # [m]
STRICT_TURN = math.radians(20.0)
GRAVITY = 9.81  # [m/s²]

_CHUNK = 50  # steps in one call of the simulator, after which it may end early
_TOUCH_STEPS = 10  # a finger touches if it has within this many steps: contacts come and go for single steps
_STILL = 0.002  # [m/s] finger speed at which the grip has settled
_CONTROL = int(mujoco.mjtState.mjSTATE_CTRL) | int(mujoco.mjtState.mjSTATE_XFRC_APPLIED)
_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS


@dataclass(frozen=True)
class JudgeConfig:
    """How a grasp is tried.

    Raises:
        ValueError: a value that is negative or not finite.
    """

    approach_distance: float = 0.12  # [m] from which the open gripper comes
    approach_checks: int = 12  # places on its way that are checked
    penetration: float = 0.001  # [m] deeper contact on the way is a collision
    closing_time: float = 0.6  # [s] at most
    load_time: float = 0.2  # [s] over which the weight comes
    lift: float = 0.15  # [m]
    lift_time: float = 0.5  # [s]
    shake_acceleration: float = 4.0  # [m/s²] amplitude along each axis; running in and out reaches 1.6 times that
    shake_frequencies: tuple[float, float, float] = (3.0, 4.0, 5.0)  # [Hz] along closing, cross and approach axis
    shake_time: float = 1.0  # [s]
    hold_time: float = 0.1  # [s] of stillness at the end

    def __post_init__(self) -> None:
        for field in fields(self):
            values = np.atleast_1d(getattr(self, field.name))
            if not (np.isfinite(values).all() and (values >= 0.0).all()):
                raise ValueError(f"{field.name}: expected finite values ≥ 0, got {getattr(self, field.name)}")
        if not self.approach_checks >= 1 or not min(self.shake_frequencies) > 0.0:
            raise ValueError("approach_checks and shake_frequencies: expected positive values")


class Judgement(NamedTuple):
    """What became of a grasp."""

    held: bool
    strict: bool
    slip: float  # [m] of the object's point at the grasp centre since closing, relative to the gripper; NaN if not held
    turn: float  # [rad] of the object since closing, relative to the gripper; NaN if not held
    outcome: str  # of `OUTCOMES`
    survived: float  # share of the time under load for which it was held, in [0, 1]
    contact_points: Array  # (C, 3) [m] where the closed fingers touched, in the grasp's frame
    contact_normals: Array  # (C, 3) unit, into the object


class Recording(NamedTuple):
    """A judgement and how it went, for pictures. Poses are in the grasp's frame."""

    judgement: Judgement
    times: Array  # (T,) [s], negative on the approach
    T_gripper: Array  # (T, 4, 4)
    width: Array  # (T,) [m] between the pads
    T_object: Array  # (T, 4, 4)


def judge_grasp(
    item: GraspObject,
    grasp: Grasp | None,
    T_cloud_object: Array,
    gripper: GripperConfig | None = None,
    config: JudgeConfig | None = None,
) -> Judgement:
    """Try a grasp by physics. Equal arguments give bit-equal results, whatever was judged before.

    Args:
        item: the object.
        grasp: in the cloud's frame, whose z axis points up; None for one whose axes say nothing ("degenerate").
        T_cloud_object: (4, 4) where the object is.
        gripper, config: by default `GripperConfig()`, `JudgeConfig()`.

    Raises:
        ValueError: a `T_cloud_object` that is not a rigid transform.
    """
    return _Trial(item, grasp, T_cloud_object, gripper or GripperConfig(), config or JudgeConfig()).judgement


def record_grasp(
    item: GraspObject,
    grasp: Grasp,
    T_cloud_object: Array,
    gripper: GripperConfig | None = None,
    config: JudgeConfig | None = None,
) -> Recording:
    """As `judge_grasp`, with everything's motion."""
    trial = _Trial(item, grasp, T_cloud_object, gripper or GripperConfig(), config or JudgeConfig())
    return trial.recording()


class _Trial:
    """One grasp's way through the phases."""

    def __init__(
        self, item: GraspObject, grasp: Grasp | None, T_cloud_object: Array, gripper: GripperConfig, config: JudgeConfig
    ) -> None:
        self._item, self._gripper, self._config = item, gripper, config
        self._T_cloud_object = check_transform(T_cloud_object, "T_cloud_object")
        self._rows: list[Array] = []  # (n, 12) qpos of the steps taken
        self._points = self._normals = np.zeros((0, 3))
        self._retreat = 0.0  # [m] behind the grasp, where the approach ended
        if grasp is None or grasp.width > gripper.max_width:
            self._opening, self._T_cloud_gripper = gripper.max_width, np.eye(4)
            self.judgement = self._failed("degenerate" if grasp is None else "too wide")
            return
        self._opening = grasp.width
        self._T_cloud_gripper = gripper_pose(grasp)
        self._T_object = inverse(self._T_cloud_gripper) @ self._T_cloud_object
        self._model = grasp_model(item, gripper)
        self._data = mujoco.MjData(self._model)  # a fresh one: nothing of an earlier trial can come in
        self._body = self._model.body("object").id
        self.judgement = self._judge()

    def _judge(self) -> Judgement:
        self._place(0.0)
        if self._collides():
            return self._failed("collision")
        ever, now = self._close()
        if not now:
            return self._failed("slipped away" if ever else "missed")
        self._read_contacts()
        closed = self._rows[-1][-1]
        held = self._load(closed)
        steps = len(_motion(self._config)[0])
        survived = float(held.sum()) / steps
        if len(held) < steps or not held[-1]:
            return self._failed("dropped", survived)
        slip, turn = self._slip_and_turn(closed, self._rows[-1][-1])
        strict = slip < STRICT_SLIP and turn < STRICT_TURN
        return Judgement(True, strict, slip, turn, "held", survived, self._points, self._normals)

    def _failed(self, outcome: str, survived: float = 0.0) -> Judgement:
        return Judgement(False, False, math.nan, math.nan, outcome, survived, self._points, self._normals)

    def _place(self, retreat: float) -> None:
        """The open gripper `retreat` metres behind the grasp, the object where it is."""
        qpos = self._data.qpos
        qpos[:] = 0.0
        qpos[2] = -retreat
        qpos[3:5] = 0.5 * (self._gripper.max_width - self._opening)
        qpos[5:8] = self._T_object[:3, 3]
        qpos[8:12] = quat_wxyz_from_matrix(self._T_object[:3, :3])

    def _collides(self) -> bool:
        """Whether the open gripper cuts into the object on its way; ends with it at the grasp."""
        config = self._config
        for retreat in np.linspace(config.approach_distance, 0.0, config.approach_checks):
            self._place(float(retreat))
            mujoco.mj_kinematics(self._model, self._data)
            mujoco.mj_collision(self._model, self._data)
            self._retreat = float(retreat)
            if self._data.ncon and self._data.contact.dist.min() < -config.penetration:
                return True
        return False

    def _run(self, control: Array) -> NDArray[np.bool_]:
        """Advance by rows of control (n, 5 + 6 bodies); (n,) whether both fingers touch the object."""
        state = np.empty(mujoco.mj_stateSize(self._model, _STATE))
        mujoco.mj_getState(self._model, self._data, state, _STATE)
        warm = self._data.qacc_warmstart.copy()
        states, touch = rollout.rollout(
            self._model, self._data, state, control[None], control_spec=_CONTROL, initial_warmstart=warm
        )
        self._rows.append(states[0, :, 1:13])
        return (touch[0] > 0.0).all(axis=1)

    def _control(self, steps: int) -> Array:
        control = np.zeros((steps, mujoco.mj_stateSize(self._model, _CONTROL)))
        control[:, 3:5] = self._gripper.force
        return control

    def _close(self) -> tuple[bool, bool]:
        """Until the grip has settled; whether both fingers touched at any time, and whether they do at the end."""
        control = self._control(_CHUNK)
        ever = before = False
        for _ in range(max(1, round(self._config.closing_time / (_CHUNK * TIMESTEP)))):
            touching = self._run(control)
            now = bool(touching[-_TOUCH_STEPS:].any())
            ever = ever or bool(touching.any())
            if before == now and np.abs(self._data.qvel[3:5]).max() < _STILL:
                break
            before = now
        return ever, now

    def _read_contacts(self) -> None:
        contact = self._data.contact
        into = np.where(self._model.geom_bodyid[contact.geom[:, 1]] == self._body, 1.0, -1.0)
        R, t = self._T_cloud_gripper[:3, :3], self._T_cloud_gripper[:3, 3]
        self._points = contact.pos @ R.T + t
        self._normals = (into[:, None] * contact.frame[:, :3]) @ R.T

    def _load(self, closed: Array) -> NDArray[np.bool_]:
        """Load, lift, shake, hold; (n,) whether it was held at each step, ending early once it is lost."""
        up = self._T_cloud_gripper[2, :3]  # the cloud's z axis in the gripper's
        load, lift, shake = _motion(self._config)
        control = self._control(len(load))
        control[:, :3] = lift[:, None] * up + shake
        force = 5 + 6 * self._body
        control[:, force : force + 3] = (-GRAVITY * self._item.mass) * load[:, None] * up
        start = self._center_of_mass(closed[None])[0]
        held: list[NDArray[np.bool_]] = []
        recent = np.ones(_TOUCH_STEPS - 1, dtype=bool)
        for first in range(0, len(control), _CHUNK):
            touch = np.concatenate([recent, self._run(control[first : first + _CHUNK])])
            recent = touch[1 - _TOUCH_STEPS :]
            touching = np.lib.stride_tricks.sliding_window_view(touch, _TOUCH_STEPS).any(axis=1)
            near = np.linalg.norm(self._center_of_mass(self._rows[-1]) - start, axis=1) < HELD_DISTANCE
            held.append(np.logical_and(touching, near))
            if not held[-1][-1]:
                break
        return np.concatenate(held)

    def _center_of_mass(self, qpos: Array) -> Array:
        """(n, 3) relative to the gripper, of states (n, 12)."""
        R = matrix_from_quat_wxyz(qpos[:, 8:12])
        return R @ self._item.center_of_mass + qpos[:, 5:8] - qpos[:, :3]

    def _slip_and_turn(self, closed: Array, end: Array) -> tuple[float, float]:
        before, after = matrix_from_quat_wxyz(closed[8:12]), matrix_from_quat_wxyz(end[8:12])
        point = before.T @ (closed[:3] - closed[5:8])
        slip = float(np.linalg.norm(after @ point + end[5:8] - end[:3]))
        cosine = abs(float(closed[8:12] @ end[8:12])) / float(np.linalg.norm(closed[8:12]) * np.linalg.norm(end[8:12]))
        return slip, 2.0 * math.acos(min(1.0, cosine))

    def recording(self) -> Recording:
        """The motion, approach first. Raises ValueError for a grasp that was not tried."""
        if self.judgement.outcome in ("degenerate", "too wide"):
            raise ValueError(f"grasp: expected one that can be tried, got one that is {self.judgement.outcome}")
        steps = round(0.5 / TIMESTEP)
        approach = np.zeros((steps, 12))
        approach[:, 2] = -np.linspace(self._config.approach_distance, self._retreat, steps)
        self._place(0.0)
        approach[:, 3:] = self._data.qpos[3:]
        qpos = np.concatenate([approach, *self._rows])
        base = np.tile(self._T_cloud_gripper, (len(qpos), 1, 1))
        base[:, :3, 3] += qpos[:, :3] @ self._T_cloud_gripper[:3, :3].T
        item = np.tile(np.eye(4), (len(qpos), 1, 1))
        item[:, :3, :3], item[:, :3, 3] = matrix_from_quat_wxyz(qpos[:, 8:12]), qpos[:, 5:8]
        times = TIMESTEP * np.arange(1.0 - steps, len(qpos) - steps + 1.0)
        width = self._gripper.max_width - qpos[:, 3] - qpos[:, 4]
        return Recording(self.judgement, times, base, width, self._T_cloud_gripper @ item)


@lru_cache(maxsize=8)
def _motion(config: JudgeConfig) -> tuple[Array, Array, Array]:
    """Per step after closing: share of the weight (n,), height (n,) [m], and shaking (n, 3) [m] along gripper axes."""
    load, lift, shake, hold = (
        round(t / TIMESTEP) for t in (config.load_time, config.lift_time, config.shake_time, config.hold_time)
    )
    weight = np.ones(load + lift + shake + hold)
    weight[:load] = _smooth_step(load)
    height = np.full(len(weight), float(config.lift))
    height[:load] = 0.0
    height[load : load + lift] *= _smooth_step(lift)
    path = np.zeros((len(weight), 3))
    time = TIMESTEP * np.arange(1, shake + 1)
    # in and out within a fifth of the time each, so that neither place nor speed jumps
    window = (
        _smooth(np.minimum(1.0, np.minimum(time, time[::-1] - TIMESTEP) / (0.2 * config.shake_time))) if shake else 0
    )
    for axis, frequency in enumerate(config.shake_frequencies):
        rate = 2.0 * np.pi * frequency
        path[load + lift : load + lift + shake, axis] = (
            config.shake_acceleration / rate**2 * np.sin(rate * time) * window
        )
    return weight, height, path


def _smooth_step(steps: int) -> Array:
    return _smooth(np.arange(1, steps + 1) / max(steps, 1))


def _smooth(s: Iterable[float] | Array) -> Array:
    """Least-jerk step: 0 at 0, 1 at 1, at rest and unaccelerated at both (Flash and Hogan 1985)."""
    s = np.asarray(s, dtype=np.float64)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
