"""A vehicle that carries a camera along a path in wind: flown by its autopilot, known to itself by its sensors alone.

The compiled vehicle of `sim.manipulation` flies over a ground of its own; what the camera looks at is another model,
placed against the path. So the scene is not felt: no ground effect of its table, no collisions with it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim.actions import ActionDimension
from aerograsp_env.sim.arms.vehicles import BELEROFONTE_ARMS
from aerograsp_env.sim.config import CONTROL_STEP
from aerograsp_env.sim.kernel_math import compiled
from aerograsp_env.sim.manipulation import layout as lay
from aerograsp_env.sim.manipulation.config import HOVER, ManipulationConfig, ManipulationRandomizeConfig
from aerograsp_env.sim.manipulation.kernel_rows import clip_row, put_gyro, put_heading, put_tilt, put_velocity
from aerograsp_env.sim.manipulation.task import Episode, Task
from aerograsp_env.sim.manipulation.worlds import ManipulationWorlds
from aerograsp_env.sim.sensors import SensorConfig
from aerograsp_env.sim.wind import WindConfig
from aerograsp_env.spatial import Array, transform

POSITION_GAINS = (0.95, 0.95, 1.0)  # MPC_XY_P, MPC_Z_P of PX4 [1/s]
VELOCITY_LIMIT = (2.0, 2.0, 1.0)  # Table 5.2 [m/s]
YAW_RATE_LIMIT = 1.0  # [rad/s]
READINGS = (("angular_velocity", 3, 20.0), ("velocity", 3, 5.0), ("attitude", 3, float(np.pi)))
"""Name, size and bound of what the vehicle knows of itself: gyroscope [rad/s] and velocity estimate [m/s] in the body
frame, estimated roll, pitch and yaw [rad]; the yaw that it began with is 0."""


class Reference(NamedTuple):
    """Where the vehicle should be at some time: offsets from where it began, axes of its first level frame."""

    position: Array  # (3,) [m]
    velocity: Array  # (3,) [m/s]
    yaw_rate: float  # [rad/s]; the autopilot integrates it


Path = Callable[[float], Reference]


@compiled
def _read(
    parameters, states, records, noise, cursors, active, stepped, bounds, slots, observations, terms, metrics, flags,
    first, last,
):  # fmt: skip
    for n in range(first, last):
        s, out = states[n], observations[n]
        k = put_gyro(s, out, 0)
        k = put_velocity(s, out, k)
        k = put_tilt(s, out, k)
        put_heading(s, out, k)
        clip_row(out, bounds)


class _Carry(Task):
    """Fly as told, with the arms stowed; nothing is scored."""

    observation = READINGS
    actions: tuple[ActionDimension, ...] = ()
    slots = lay.BASE_SLOT + np.arange(4)  # velocity and yaw rate
    record = np.dtype([("nothing", np.int64)])
    terms: ClassVar[tuple[str, ...]] = ()
    metrics: ClassVar[tuple[str, ...]] = ()
    reset_options: ClassVar[tuple[str, ...]] = ("wind_direction",)

    evaluate = staticmethod(_read)

    def reward_terms(self, reward_mode: str) -> tuple[str, ...]:
        return ()

    def begin(self, episode: Episode) -> None:
        for i, mount in enumerate(self.config.machine.mounts):
            episode.arm_joints(i)[:] = mount.arm.stowed


class Flight:
    """One vehicle and its autopilot, following a path by velocity commands as PX4's position loop would."""

    def __init__(
        self,
        wind: WindConfig,
        randomize: ManipulationRandomizeConfig | None = None,
        sensors: SensorConfig | None = None,
    ) -> None:
        config = ManipulationConfig(
            vehicle=BELEROFONTE_ARMS, hold=False, velocity_limit=VELOCITY_LIMIT, yaw_rate_limit=YAW_RATE_LIMIT,
            wind=wind, randomize=randomize, estimate=None, bound=20.0,
        )  # fmt: skip
        self.config = config if sensors is None else replace(config, sensors=sensors)
        self.worlds = ManipulationWorlds(self.config, _Carry(self.config), 1)
        self._state = self.worlds.states[0]
        self._start = np.zeros(3)
        self._steps = 0

    @property
    def termination(self) -> str:
        """Why the flight ended ("diverged", "out_of_bounds", …), or "" while it goes on."""
        return str(lay.TERMINATIONS[int(self._state["termination"])])

    @property
    def wind(self) -> Array:
        """(3,) where the vehicle is, flight frame [m/s]: the truth."""
        return np.array(self._state["wind"])

    def reset(self, rng: np.random.Generator, options: dict[str, Any] | None = None) -> None:
        """Hover level at the origin of the flight's frame, wind and slow errors from their stationary distributions.

        options: "wind_direction" [rad], the azimuth the mean wind blows towards.
        """
        self.worlds.reset(0, rng, options or {})
        self._start = np.array(self._state["autopilot_position"])
        self._steps = 0

    def advance(self, path: Path, seconds: float, rng: np.random.Generator) -> None:
        """Follow the path for a whole number of control steps."""
        for _ in range(round(seconds / CONTROL_STEP)):
            self.worlds.step(self._command(path(self._steps * CONTROL_STEP)), [rng])
            self._steps += 1

    def _command(self, wanted: Reference) -> NDArray[np.float64]:
        state = self._state
        offset = wanted.position - (state["autopilot_position"] - self._start)  # it knows only its own estimate
        velocity = (wanted.velocity + POSITION_GAINS * offset) / VELOCITY_LIMIT
        return np.append(velocity, wanted.yaw_rate / YAW_RATE_LIMIT)

    def readings(self) -> dict[str, NDArray[np.float32]]:
        """The present `READINGS`."""
        row, result, first = self.worlds.observations[0].copy(), {}, 0
        for name, size, _ in READINGS:
            result[name] = row[first : first + size]
            first += size
        return result

    def T_start_body(self) -> Array:
        """(4, 4) the true pose in the level frame in which it began."""
        return transform(self._state["rotation"], self._state["position"] - HOVER)

    def twist_b(self) -> Array:
        """(6,) the true velocity (linear, angular) of the body's origin in the body frame."""
        velocity = self.worlds.datas[0].qvel
        return np.concatenate([self._state["rotation"].T @ velocity[:3], velocity[3:6]])

    def truth(self) -> Sequence[NDArray[Any]]:
        """Everything that its future depends on, for tests of repeatability."""
        worlds = self.worlds
        arrays = worlds.datas[0].qpos, worlds.datas[0].qvel, worlds.datas[0].qacc_warmstart, worlds._noise
        records = (np.frombuffer(a.tobytes(), np.uint8) for a in (worlds.states, worlds.parameters))
        return (*(array.copy() for array in arrays), worlds._cursors.copy(), *records)

    def close(self) -> None:
        """Stop the worker threads."""
        self.worlds.close()
