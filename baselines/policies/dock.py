"""Docked positioning: the thesis's PID, a tuned one, and an LQG with a disturbance estimate.

All three read the observation alone, take an optional leading batch axis, and keep what they remember in the returned
state.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from importlib import resources
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.control import PID
from baselines.control.lqg import AxisModel, LinearQuadraticGaussian

Array = NDArray[np.float64]
Observation = Mapping[str, NDArray[Any]]
Limit = float | tuple[float, float, float]  # [m/s] of a full action, for all axes or each

STEP = 0.02  # [s] of the docking environments
VELOCITY_LIMIT = 0.5  # [m/s] of a full action: the environments' default

# Thesis Table 5.2: X, Y, Z
THESIS_GAINS = {
    "kp": (0.8, 0.8, 0.3),
    "ki": (0.01, 0.01, 0.03),
    "kd": (0.7, 0.7, 0.7),
    "integral_limit": (10.0, 10.0, 10.0),
    "output_limit": (2.0, 2.0, 1.0),
    "derivative_time_constant": (0.15, 0.15, 0.15),  # the text filters the position by an EKF before the PID
}


@cache
def _tuned(name: str) -> dict[str, Any]:
    """Gains found by `aerograsp tune`, shipped as data."""
    text = resources.files("baselines.policies").joinpath("dock_gains.json").read_text(encoding="utf-8")
    return json.loads(text)[name]["gains"]


class PIDPolicy:
    """Velocity set-point = PID(position error), after the thesis's cascade (figure 5.16)."""

    def __init__(self, controller: PID, velocity_limit: Limit = VELOCITY_LIMIT, step: float = STEP) -> None:
        self.controller, self.step = controller, step
        self.velocity_limit = np.broadcast_to(np.asarray(velocity_limit, dtype=float), (3,))

    def predict(self, observation: Observation, state=None, episode_start=None, deterministic: bool = True):
        """(action, state): action (3,) or (N, 3) float32 in [−1, 1]."""
        del deterministic
        error = np.asarray(observation["position_error"], dtype=float)
        if state is not None and episode_start is not None and np.any(episode_start):
            state = self.controller.reset(state, np.asarray(episode_start, dtype=bool).reshape(error.shape[:-1]))
        velocity, state = self.controller.step(error, self.step, state)
        return np.clip(velocity / self.velocity_limit, -1.0, 1.0).astype(np.float32), state


def pid(velocity_limit: Limit = VELOCITY_LIMIT) -> PIDPolicy:
    """The reference policy: the gains of the thesis's Table 5.2."""
    return PIDPolicy(PID(**THESIS_GAINS), velocity_limit)


def pid_from_gains(gains: Mapping[str, Any], velocity_limit: Limit = VELOCITY_LIMIT) -> PIDPolicy:
    """A PID from horizontal and vertical gains {"kp": (xy, z), "ki": …, "kd": …, "derivative_time_constant": …}."""
    axes = {name: (value[0], value[0], value[1]) for name, value in gains.items()}
    return PIDPolicy(PID(integral_limit=(1.0, 1.0, 1.0), output_limit=(2.0, 2.0, 1.0), **axes), velocity_limit)


def pid_tuned(velocity_limit: Limit = VELOCITY_LIMIT) -> PIDPolicy:
    """The PID with gains found on training seeds by `aerograsp tune aerograsp/Dock-v0 --policy pid-tuned`."""
    return pid_from_gains(_tuned("pid-tuned"), velocity_limit)


class LQGState(NamedTuple):
    """What `LQGPolicy` remembers."""

    estimate: Array  # (..., 3, n) state estimate of each axis
    started: NDArray[np.bool_]  # (...,)


class LQGPolicy:
    """One linear-quadratic-Gaussian regulator an axis; see `baselines.control.lqg`.

    It knows the autopilot's structure and PX4's default gains, models the slow error of the velocity estimate and a
    wind acceleration as disturbance states, and predicts through the command delay.
    """

    def __init__(self, regulators: tuple[LinearQuadraticGaussian, ...], velocity_limit: Limit = VELOCITY_LIMIT) -> None:
        self.velocity_limit = np.broadcast_to(np.asarray(velocity_limit, dtype=float), (3,))
        self._transition = np.stack([r.transition for r in regulators])
        self._input = np.stack([r.input for r in regulators])
        self._measurement = np.stack([r.measurement for r in regulators])
        self._filter = np.stack([r.filter_gain for r in regulators])
        self._feedback = np.stack([r.feedback for r in regulators])
        self._command = regulators[0].command_index

    def predict(self, observation: Observation, state=None, episode_start=None, deterministic: bool = True):
        """(action, state): action (3,) or (N, 3) float32 in [−1, 1]."""
        del deterministic
        position = -np.asarray(observation["position_error"], dtype=float)
        velocity = np.asarray(observation["velocity"], dtype=float)
        batch = position.shape[:-1]
        n = self._transition.shape[-1]
        if state is None:
            state = LQGState(np.zeros((*batch, 3, n)), np.zeros(batch, bool))
        started = state.started
        if episode_start is not None:
            started = started & ~np.asarray(episode_start, dtype=bool).reshape(batch)
        x = np.where(started[..., None, None], state.estimate, 0.0)
        fresh = ~started[..., None]
        x[..., 0] = np.where(fresh, position, x[..., 0])
        seen = np.stack([position, velocity], axis=-1)
        x = x + np.einsum("aij,...aj->...ai", self._filter, seen - np.einsum("aij,...aj->...ai", self._measurement, x))
        change = -np.einsum("aj,...aj->...a", self._feedback, x)
        command = np.clip(x[..., self._command] + change, -self.velocity_limit, self.velocity_limit)
        change = command - x[..., self._command]
        x = np.einsum("aij,...aj->...ai", self._transition, x) + self._input * change[..., None]
        return (command / self.velocity_limit).astype(np.float32), LQGState(x, np.ones(batch, bool))


def lqg_from_gains(gains: Mapping[str, Any], velocity_limit: Limit = VELOCITY_LIMIT) -> LQGPolicy:
    """An LQG from its design weights: each name of `AxisModel` as (horizontal, vertical), or one number for both."""

    def axis(k: int) -> LinearQuadraticGaussian:
        return AxisModel(**{name: float(np.broadcast_to(value, (2,))[k]) for name, value in gains.items()}).design(STEP)

    horizontal, vertical = axis(0), axis(1)
    return LQGPolicy((horizontal, horizontal, vertical), velocity_limit)


def lqg(velocity_limit: Limit = VELOCITY_LIMIT) -> LQGPolicy:
    """The LQG with weights found on training seeds by `aerograsp tune aerograsp/Dock-v0 --policy lqg`."""
    return lqg_from_gains(_tuned("lqg"), velocity_limit)
