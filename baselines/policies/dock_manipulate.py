"""Manipulation while docked: a regulator holds the vehicle, damped least squares hold the free arm's tool at the point.

The arm is servoed as in Reach (`baselines.policies.reach`): the point is seen from the estimated pose, so that the
vehicle's motion, fed forward, and its slow changes are all compensated; what is left is the pose estimate's own error.
The thesis does the same with the docking tool's estimate (section 5.4.7).

The policy sees the observation alone, takes an optional leading batch axis, and keeps what it remembers in the returned
state.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.policies.dock import VELOCITY_LIMIT, Limit, LQGPolicy, PIDPolicy, pid, pid_tuned
from baselines.policies.reach import JOINT_RATE, ServoPolicy
from baselines.policies.reach_state import Settings

Array = NDArray[np.float64]
Observation = Mapping[str, NDArray[Any]]

# The point does not move; what seems to is the drift of the velocity estimate by which the vehicle's motion is known.
SETTINGS = Settings(acceleration=0.4, exact_noise=0.001)


class DockManipulateState(NamedTuple):
    """What `DockManipulatePolicy` remembers."""

    base: Any
    arm: Any


class DockManipulatePolicy:
    """Velocity commands of `base`, joint rates of `arm`.

    Args:
        base: holds the vehicle at its set-point: any policy of Dock-v0 whose action is a velocity.
        arm: servos the tool: any policy of Reach-v0 with joint rates.
        heading_frame: velocities are commanded and observed in the heading's frame, not the world's.
    """

    def __init__(self, base: PIDPolicy | LQGPolicy, arm: ServoPolicy, heading_frame: bool = False) -> None:
        self.base, self.arm, self.heading_frame = base, arm, heading_frame

    def predict(self, observation: Observation, state=None, episode_start=None, deterministic: bool = True):
        """(action, state): action (9,) or (N, 9) float32 in [−1, 1]."""
        del deterministic
        base, arm = (None, None) if state is None else state
        velocity, base = self.base.predict(observation, state=base, episode_start=episode_start)
        rates, arm = self.arm.predict(self.as_reaching(observation), state=arm, episode_start=episode_start)
        return np.concatenate([velocity, rates], axis=-1), DockManipulateState(base, arm)

    def as_reaching(self, observation: Observation) -> dict[str, Array]:
        """The observation of Reach-v0 that says the same: the point was seen just now."""
        roll, pitch, yaw = np.moveaxis(np.asarray(observation["attitude"], dtype=float), -1, 0)
        if self.heading_frame:
            yaw = np.zeros_like(yaw)
        velocity = np.asarray(observation["velocity"], dtype=float)
        joints, action = observation["arm_joints"], observation["previous_actions"]
        parts = (
            joints,
            observation["arm_rates"],
            observation["arm_lag"],
            in_body_axes(velocity, roll, pitch, yaw),
            observation["angular_velocity"],
            observation["attitude"][..., :2],
            np.zeros((*velocity.shape[:-1], 1)),
            action[..., 3 : 3 + joints.shape[-1]],
        )
        return {
            "observation": np.concatenate(parts, axis=-1, dtype=float),
            "achieved_goal": observation["end_effector"][..., :3],
            "desired_goal": observation["target"],
        }


def in_body_axes(vector: Array, roll: Array, pitch: Array, yaw: Array) -> Array:
    """Vectors (..., 3) in the axes of a body with R = Rz(yaw) Ry(pitch) Rx(roll), angles (...) [rad]."""
    cr, sr, cp, sp, cy, sy = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch), np.cos(yaw), np.sin(yaw)
    x, y, z = np.moveaxis(vector, -1, 0)
    ahead, left = cy * x + sy * y, cy * y - sy * x
    down = sp * ahead + cp * z
    return np.stack([cp * ahead - sp * z, cr * left + sr * down, cr * down - sr * left], axis=-1)


def dls(
    velocity_limit: Limit = VELOCITY_LIMIT, joint_rate: float = JOINT_RATE, heading_frame: bool = False
) -> DockManipulatePolicy:
    """The reference policy: the tuned PID of Dock-v0 and servoing with feed-forward."""
    return DockManipulatePolicy(pid_tuned(velocity_limit), ServoPolicy(True, joint_rate, SETTINGS), heading_frame)


def pid_dls(
    velocity_limit: Limit = VELOCITY_LIMIT, joint_rate: float = JOINT_RATE, heading_frame: bool = False
) -> DockManipulatePolicy:
    """The thesis's PID and the same servoing."""
    return DockManipulatePolicy(pid(velocity_limit), ServoPolicy(True, joint_rate, SETTINGS), heading_frame)
