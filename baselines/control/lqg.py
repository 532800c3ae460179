"""Linear-quadratic-Gaussian regulation of one axis of a velocity-controlled multirotor.

The axis under PX4's velocity loop, about the set-point: position p, velocity v, acceleration a reached through the
attitude loop's lag, the loop's integrator z, a slow error b of the autopilot's velocity estimate v̂ = v + b, a
disturbing acceleration d:

    ṗ = v,   v̇ = a + d,   ȧ = (P (u_d − v̂) + z − D a − a) / τ_a,
    ż = I (u_d − v̂),   ḃ = −b/τ_b + …,   ḋ = −d/τ_d + …

with u_d the command delayed by k steps. b and d cannot be controlled but are observed (position and v̂ are measured), so
the regulator cancels them: the cost is on position and on the *change* of the command, which lets a constant command
cost nothing. Discretised exactly; both gains from the discrete algebraic Riccati equation (Anderson & Moore, Optimal
Control, 1990).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm, solve_discrete_are

Array = NDArray[np.float64]


class LinearQuadraticGaussian(NamedTuple):
    """A designed regulator: x̂⁺ = transition x̂ + input Δu, x̂ ← x̂ + filter_gain (y − measurement x̂), Δu = −feedback x̂."""

    transition: Array  # (n, n)
    input: Array  # (n,)
    measurement: Array  # (2, n): position [m], estimated velocity [m/s]
    filter_gain: Array  # (n, 2)
    feedback: Array  # (n,)
    command_index: int  # where the newest command stands in the state


@dataclass(frozen=True)
class AxisModel:
    """The axis' constants (PX4's defaults for a horizontal axis), the disturbances' sizes and the design weights."""

    velocity_p: float = 1.8  # [1/s]
    velocity_i: float = 0.4  # [1/s²]
    velocity_d: float = 0.2
    lag: float = 0.20  # τ_a [s]
    delay: float = 0.08  # of the command [s]
    bias_std: float = 0.04  # of b [m/s]
    bias_time: float = 20.0  # τ_b [s]
    disturbance_std: float = 0.15  # of d [m/s²]
    disturbance_time: float = 3.0  # τ_d [s]
    position_std: float = 0.002  # measurement noise [m]
    velocity_std: float = 0.02  # [m/s]
    change_weight: float = 0.003  # cost of (Δu / step)² beside (p)²: trades error against effort

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            may_vanish = name in ("velocity_i", "velocity_d", "delay")
            if not np.isfinite(value) or value < 0 or (value == 0 and not may_vanish):
                raise ValueError(f"AxisModel.{name} must be positive and finite, got {value}")

    def design(self, step: float) -> LinearQuadraticGaussian:
        """The regulator for a control period `step` [s].

        Raises ValueError if the Riccati equations have no stabilising solution.
        """
        delays = round(self.delay / step)
        # p v a z b d, then the commands on their way, oldest first; the newest is the last one given
        n = 6 + max(delays, 1)
        a = np.zeros((6, 6))
        a[0, 1] = 1.0
        a[1, 2] = a[1, 5] = 1.0
        a[2] = np.array([0.0, -self.velocity_p, -1.0 - self.velocity_d, 1.0, -self.velocity_p, 0.0]) / self.lag
        a[3, 1] = a[3, 4] = -self.velocity_i
        a[4, 4], a[5, 5] = -1.0 / self.bias_time, -1.0 / self.disturbance_time
        b = np.array([0.0, 0.0, self.velocity_p / self.lag, self.velocity_i, 0.0, 0.0])
        block = np.zeros((7, 7))
        block[:6, :6], block[:6, 6] = a, b
        discrete = expm(block * step)

        transition, inputs = np.zeros((n, n)), np.zeros(n)
        transition[:6, :6] = discrete[:6, :6]
        transition[:6, 6] = discrete[:6, 6]  # the oldest command acts during this step
        transition[6:-1, 7:] = np.eye(n - 7)
        transition[-1, -1] = inputs[-1] = 1.0
        if delays == 0:
            inputs[:6] = discrete[:6, 6]  # … together with the change decided now
        measurement = np.zeros((2, n))
        measurement[0, 0] = 1.0
        measurement[1, 1] = measurement[1, 4] = 1.0

        noise = 1e-10 * np.eye(6)
        for index, std, time in ((4, self.bias_std, self.bias_time), (5, self.disturbance_std, self.disturbance_time)):
            noise[index, index] = std**2 * (1.0 - np.exp(-2.0 * step / time))
        seen = np.diag([self.position_std**2, self.velocity_std**2])
        state_cost = np.zeros((n, n))
        state_cost[0, 0] = 1.0
        try:
            c = measurement[:, :6]
            covariance = solve_discrete_are(discrete[:6, :6].T, c.T, noise, seen)
            change_cost = np.array([[self.change_weight / step**2]])
            value = solve_discrete_are(transition, inputs[:, None], state_cost, change_cost)
        except np.linalg.LinAlgError as error:
            raise ValueError(f"AxisModel: no stabilising regulator for these constants ({error})") from error
        gain = np.zeros((n, 2))  # commands are known: nothing is estimated about them
        gain[:6] = np.linalg.solve(c @ covariance @ c.T + seen, c @ covariance).T
        bv = inputs @ value
        feedback = (bv @ transition) / (self.change_weight / step**2 + bv @ inputs)
        return LinearQuadraticGaussian(transition, inputs, measurement, gain, feedback, n - 1)
