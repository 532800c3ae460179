"""Visual servoing of a flying arm: joint rates towards a grasp on a tracked object (`baselines.kinematics.tracking`).

`servo_rates` is the damped step (thesis equation 2.23; `baselines.kinematics.dls`) towards a pose that moves: its
velocity as seen from the moving body is fed forward (Chaumette & Hutchinson 2007, "Visual servo control, part II",
section on target tracking), so that the feedback works on what is left.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.sim.kernel_math import compiled
from baselines.kinematics.arm import Arm, exactly
from baselines.kinematics.chain import forward_kernel, pose_error_kernel
from baselines.kinematics.dls import dls_step, weights

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ServoSettings:
    """Of `servo_rates`.

    Raises:
        ValueError: a value that is not positive.
    """

    step: float = 0.02  # [s]
    gain: float = 7.0  # error to velocity [1/s]
    speed: float = 0.35  # most that the feedback asks for [m/s]
    turn: float = 1.8  # [rad/s]
    rate: float = 2.0  # of a joint [rad/s]
    damping: float = 0.05  # see `dls.servo_step`
    threshold: float = 0.05
    lag: float = 0.25  # of a joint behind its command, above which it is not commanded further ahead [rad]

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not 0.0 < value < math.inf:
                raise ValueError(f"{name}: expected a positive number, got {value}")


class ServoStep(NamedTuple):
    """What the arm does next, and how far the tool is from where it should be."""

    rates: Array  # (n,) [rad/s]
    error: Array  # (6,) tool to target: position [m], rotation vector [rad], frame of the arm's poses
    singular: float  # least singular value of the weighted Jacobian [m]


def target_twist(T_body_target: ArrayLike, drift: ArrayLike, velocity: ArrayLike, angular_velocity: ArrayLike) -> Array:
    """Twist (6,) of a target as seen from the moving body, body axes.

    Args:
        T_body_target: (4, 4).
        drift: (3,) the target's own velocity [m/s], body axes.
        velocity: (3,) of the body [m/s], body axes.
        angular_velocity: (3,) of the body [rad/s].
    """
    p = np.asarray(T_body_target)[:3, 3]
    w = np.asarray(angular_velocity, dtype=np.float64)
    linear = np.asarray(drift) - np.asarray(velocity) - np.cross(w, p)
    return np.concatenate([linear, -w])


def servo_rates(
    arm: Arm,
    q: ArrayLike,
    lag: ArrayLike,
    T_target: ArrayLike,
    twist: ArrayLike,
    settings: ServoSettings,
) -> ServoStep:
    """Joint rates that bring the tool to a moving pose and keep it there, within limits and past singularities.

    The servos integrate rates into set-points, so that whatever they lag by against gravity is made up for.

    Args:
        arm: poses in the body frame.
        q: (n,) encoder angles [rad].
        lag: (n,) set-points less encoder angles [rad].
        T_target: (4, 4) where the tool should be now.
        twist: (6,) of the target, see `target_twist`.
        settings: gains and bounds.

    Raises:
        ValueError: arrays of other shapes or not finite.
    """
    n = arm.n
    rates, error = np.empty(n), np.empty(6)
    singular = _servo_kernel(
        arm.chain, arm.limits, weights(arm), exactly(q, (n,), "q"), exactly(lag, (n,), "lag"),
        exactly(T_target, (4, 4), "T_target"), exactly(twist, (6,), "twist"), settings.step, settings.gain,
        settings.speed, settings.turn, settings.rate, settings.damping * arm.length, settings.threshold * arm.length,
        settings.lag, rates, error,
    )  # fmt: skip
    return ServoStep(rates, error, float(singular))


@compiled
def _bounded_scale(x, y, z, most):
    length = math.sqrt(x * x + y * y + z * z)
    return most / length if length > most else 1.0


@compiled
def _servo_kernel(
    chain, limits, row_weights, q, lag, target, twist, dt, gain, speed, turn, rate, damping, threshold, most_lag,
    rates, error,
):  # fmt: skip
    n = q.shape[0]
    tool, wanted, q_next = np.empty((3, 4)), np.empty(6), np.empty(n)
    forward_kernel(chain, q, tool)
    pose_error_kernel(tool, target, error)
    linear = _bounded_scale(gain * error[0], gain * error[1], gain * error[2], speed)
    angular = _bounded_scale(gain * error[3], gain * error[4], gain * error[5], turn)
    for i in range(3):
        wanted[i] = dt * (gain * linear * error[i] + twist[i])
        wanted[3 + i] = dt * (gain * angular * error[3 + i] + twist[3 + i])
    sigma = dls_step(chain, limits, np.full(n, rate * dt), row_weights, q, wanted, 6, damping, threshold, q_next)
    for i in range(n):
        rates[i] = (q_next[i] - q[i]) / dt
        if rates[i] * lag[i] > 0.0 and abs(lag[i]) > most_lag:
            rates[i] = 0.0
    return sigma


def joint_rates(q_command: ArrayLike, q_target: ArrayLike, rate: float, gain: float = 4.0) -> Array:
    """(n,) rates [rad/s] that bring the set-points (n,) to a configuration, all joints arriving together."""
    wanted = gain * (np.asarray(q_target, dtype=np.float64) - np.asarray(q_command))
    fastest = float(np.abs(wanted).max())
    return np.asarray(wanted * min(1.0, rate / fastest) if fastest > 0.0 else wanted)
