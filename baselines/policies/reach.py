"""Reaching: damped-least-squares servoing of the tool to a point, with feed-forward of the base's and its own motion.

The policy keeps a reference configuration that it moves towards the point by one damped least-squares step a control
step (Wampler 1986; Chiaverini, Siciliano & Egeland 1994), and gives the servos what brings the joints onto it. The
point's estimate comes late, and the vehicle has moved meanwhile: it is carried on by dead reckoning.

It sees the observation alone, takes an optional leading batch axis, and keeps what it remembers in the returned state.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim.arms.hecatonquiros import ARMS
from aerograsp_env.sim.config import CONTROL_STEP
from baselines.kinematics.arm import Arm
from baselines.policies.reach_kernel import servo_rows
from baselines.policies.reach_state import STATE, Settings

Observation = Mapping[str, NDArray[Any]]

JOINT_RATE = 2.0  # [rad/s] of a full action: the environment's default
# The four-joint arm turns its light vehicle: near its yaw axis, a fast answer to how the body turns keeps it turning.
SETTINGS = {4: Settings(gain=6.0, rotation_time=1.0)}
SEEDS = 24  # of a search for a configuration
BELOW = np.diag([1.0, -1.0, -1.0, 1.0])  # turns an arm's base as the vehicles carry it: z down, x forward


class _Machine(NamedTuple):
    """An arm's arrays as the kernel takes them."""

    chain: NDArray[np.float64]
    limits: NDArray[np.float64]
    seeds: NDArray[np.float64]  # (SEEDS, n) configurations to look for others from
    servo_time: NDArray[np.float64]  # [s] damping / stiffness: how long a servo trails a command that moves
    rate_limits: NDArray[np.float64]  # [rad/s] of a joint, a full action's or its servo's
    length: float


@cache
def _machine(joints: int, joint_rate: float) -> _Machine:
    """The arm with so many joints, in axes parallel to the body's.

    Raises:
        ValueError: there is none.
    """
    for config in ARMS.values():
        if config.n == joints:
            arm = Arm.from_config(config, BELOW)
            servo_time = np.array([joint.damping / joint.stiffness for joint in config.joints])
            rates = np.array([min(joint.rate_limit, joint_rate) for joint in config.joints])
            low, high = arm.limits.T
            seeds = low + (high - low) * np.random.default_rng(0).uniform(0.1, 0.9, (SEEDS, joints))
            return _Machine(arm.chain, arm.limits, seeds, servo_time, rates, arm.length)
    raise ValueError(f"observation: expected that of an arm of {[a.n for a in ARMS.values()]} joints, got {joints}")


class ServoPolicy:
    """Joint rates that take the tool to the point `desired_goal` of Reach-v0.

    Args:
        feedforward: whether the base's motion and the point's own are fed forward, and its delay made up for.
        joint_rate: of a full action [rad/s].
        settings: gains; by default those chosen for the arm on validation seeds.
    """

    def __init__(
        self, feedforward: bool = True, joint_rate: float = JOINT_RATE, settings: Settings | None = None
    ) -> None:
        if not (np.isfinite(joint_rate) and joint_rate > 0.0):
            raise ValueError(f"joint_rate: expected a positive number [rad/s], got {joint_rate}")
        self.feedforward, self.joint_rate = feedforward, float(joint_rate)
        self.settings = settings

    def predict(self, observation: Observation, state=None, episode_start=None, deterministic: bool = True):
        """(action, state): action (n,) or (N, n) float32 in [−1, 1].

        Raises:
            ValueError: an observation that is not one of Reach-v0 with joint rates as actions.
        """
        del deterministic
        flat = np.asarray(observation["observation"])
        batch, width = flat.shape[:-1], flat.shape[-1]
        joints, rest = divmod(width - 9, 4)  # joints, their rates, lags and the action; 9 of the vehicle and the target
        if rest:
            raise ValueError(f"observation: expected 4 n + 9 entries for n joints driven by their rates, got {width}")
        machine = _machine(joints, self.joint_rate)
        settings = self.settings or SETTINGS.get(joints, Settings())
        rows = np.ascontiguousarray(flat.reshape(-1, width), np.float64)
        tool = np.ascontiguousarray(np.asarray(observation["achieved_goal"]).reshape(-1, 3), np.float64)
        goal = np.ascontiguousarray(np.asarray(observation["desired_goal"]).reshape(-1, 3), np.float64)
        state = np.zeros(len(rows), STATE) if state is None else state.copy()
        if episode_start is not None:
            state["started"][np.asarray(episode_start, bool).reshape(-1)] = 0
        action = np.empty((len(rows), joints), np.float32)
        servo_rows(*machine, self.joint_rate, settings, self.feedforward, CONTROL_STEP, rows, tool, goal, state, action)
        return action.reshape(*batch, joints), state


def dls(joint_rate: float = JOINT_RATE) -> ServoPolicy:
    """The reference policy: servoing with feed-forward."""
    return ServoPolicy(True, joint_rate)


def dls_no_feedforward(joint_rate: float = JOINT_RATE) -> ServoPolicy:
    """The same servoing towards the point as it was last seen."""
    return ServoPolicy(False, joint_rate)
