"""An arm of simulated servos behind the interface of the real ones; its time is passed in."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.backends.interface import ArmBackend
from aerograsp_env.backends.limits import ArmLimits, ArmState
from aerograsp_env.backends.servos import ServoParameters, SimulatedServos

if TYPE_CHECKING:
    from aerograsp_env.sim.arms.description import ArmConfig

Array = NDArray[np.float64]
Load = Callable[[Array], Array]

DOWN = (0.0, 0.0, 9.81)  # [m/s²] in the base frame of an arm that hangs below its vehicle


def gravity_load(arm: ArmConfig, gravity: ArrayLike = DOWN) -> Load:
    """Torques (n,) [N m] of the weight of a described arm, as a function of its angles (n,) [rad].

    Args:
        arm: fixed at its base, gripper open.
        gravity: (3,) acceleration in the arm's base frame [m/s²].
    """
    g, links = np.asarray(gravity, dtype=float), arm.with_fingers()
    axes = np.array([joint.axis for joint in arm.joints])
    mass, centers = np.array([link.mass for link in links]), np.array([link.center_of_mass for link in links])

    def load(q: Array) -> Array:
        poses = arm.link_poses(q)[:-1]
        at = np.einsum("nij,nj->ni", poses[:, :3, :3], centers) + poses[:, :3, 3]
        turned = np.einsum("nij,nj->ni", poses[:, :3, :3], axes)
        lever = at[None] - poses[:, None, :3, 3]  # (joint, link, 3)
        outboard = np.triu(np.ones((arm.n, arm.n))) * mass
        moments = np.einsum("jl,jlk->jk", outboard, np.cross(lever, g))
        return np.einsum("jk,jk->j", turned, moments)

    return load


def joint_inertias(arm: ArmConfig, q: ArrayLike) -> Array:
    """(n,) inertias [kg m²] about each joint of all that it moves at angles `q` (n,), its motor's included."""
    poses, links, inertias = arm.link_poses(q), arm.with_fingers(), []
    for i, joint in enumerate(arm.joints):
        axis, total = poses[i, :3, :3] @ joint.axis, joint.armature
        for T, link in zip(poses[i:-1], links[i:], strict=True):
            arm_length = np.cross(axis, T[:3, :3] @ link.center_of_mass + T[:3, 3] - poses[i, :3, 3])
            own = T[:3, :3].T @ axis
            total += link.mass * arm_length @ arm_length + own @ link.inertia @ own
        inertias.append(total)
    return np.array(inertias)


class SimulatedArm(ArmBackend):
    """An arm of servos that are simulated joint by joint.

    Args:
        limits: what may be commanded.
        position: (n,) where the arm starts [rad]; by default, the middle of its limits.
        parameters: of the servos. Their own rate limit applies too.
        load: torques (n,) [N m] on the joints at angles (n,) [rad], as gravity's; none by default.
        enable_motion: False makes it read-only, as a real arm is by default.

    Raises:
        ValueError: a position or parameters that do not fit the limits' joints.
    """

    def __init__(
        self,
        limits: ArmLimits,
        position: ArrayLike | None = None,
        *,
        parameters: ServoParameters | None = None,
        load: Load | None = None,
        enable_motion: bool = True,
    ) -> None:
        start = limits.position.mean(axis=1) if position is None else np.array(position, dtype=float)
        if start.shape != (limits.n,):
            raise ValueError(f"position: expected {limits.n} angles [rad], got {position!r}")
        self.servos = SimulatedServos(start, parameters or ServoParameters())
        self._load = load
        super().__init__(limits, enable_motion=enable_motion, clock=lambda: self.servos.time)

    @classmethod
    def of(
        cls, arm: ArmConfig, limits: ArmLimits | None = None, *, gravity: ArrayLike = DOWN, enable_motion: bool = True
    ) -> Self:
        """A described arm, at its home configuration, under its own weight; inertias are those at home.

        Args:
            arm: with the ratings of its servos.
            limits: what may be commanded; by default `ArmLimits.of(arm)`.
            gravity: (3,) in the arm's base frame [m/s²].
            enable_motion: False makes it read-only.
        """
        parameters = ServoParameters(
            stiffness=[joint.stiffness for joint in arm.joints],
            damping=[joint.damping for joint in arm.joints],
            torque_limit=[joint.torque_limit for joint in arm.joints],
            rate_limit=[joint.rate_limit for joint in arm.joints],
            inertia=joint_inertias(arm, arm.home),
        )
        load = gravity_load(arm, gravity)
        return cls(limits or ArmLimits.of(arm), arm.home, parameters=parameters, load=load, enable_motion=enable_motion)

    def advance(self, dt: float) -> None:
        """Let `dt` [s] pass, connected or not; the watchdog acts as it would on a real arm that is polled.

        Raises:
            ValueError: a dt that is negative or not finite.
        """
        if not 0.0 <= dt < math.inf:
            raise ValueError(f"dt: expected a time [s] of 0 or more, got {dt}")
        end = self.servos.time + dt
        while (left := end - self.servos.time) > 0.5e-3:
            torque = np.zeros(self.limits.n) if self._load is None else self._load(self.servos.position)
            self.servos.advance(min(left, 0.002), torque)
            if self.connected:
                self.poll()

    def _open(self) -> None:
        pass

    def _shut(self) -> None:
        if self.motion_enabled:
            self.servos.goal[:] = self.servos.measured_position

    def _measure(self) -> ArmState:
        servos = self.servos
        return ArmState(
            servos.time,
            servos.measured_position,
            servos.velocity.copy(),
            servos.load,
            servos.temperature.copy(),
            servos.voltage.copy(),
            servos.errors,
        )

    def _send(self, target: Array, rate: Array) -> None:
        self.servos.goal[:] = target
        self.servos.speed[:] = rate
