"""The simulated AscTec Firefly beside a real one: statistics of a flight of the EuRoC data set (Burri et al. 2016).

The simulated vehicle is given the recorded velocities as set-points, so that both fly about the same path.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from aerograsp_env.sim.config import TABLE_5_2_SATURATION, DockConfig
from agents.reproduction import DATA_VARIABLE, Reproduction, Request, data_folder, text_table

RECORDING = Path("drone_euroc_gt") / "V1_01_easy.csv"
CALM = 10.0  # length of the calmest stretch [s]

NOTES = """\
Real: the ground truth of {file}, {duration:.0f} s in the air, sampled at {rate:.0f} Hz;
calmest: the {calm:.0f} s of it with the least mean square speed (it never hovers). Simulated: the Firefly airframe in
still air, the recorded velocities as set-points, at the same instants; hover: set-points of zero. Root mean squares;
tilt: rate about the horizontal axes, yaw: about the vertical. The docking task commands no yaw, and the docking tool
hangs from the simulated vehicle."""


class Flight(NamedTuple):
    """A recorded motion."""

    time: NDArray[np.float64]  # (T,) from 0 [s]
    position: NDArray[np.float64]  # (T, 3) world, z up [m]
    attitude: NDArray[np.float64]  # (T, 4) wxyz, body to world
    velocity: NDArray[np.float64]  # (T, 3) world [m/s]

    def part(self, keep: Any) -> Flight:
        """The samples in `keep`, a mask or a slice, its time from 0."""
        time = self.time[keep]
        return Flight(time - time[0], self.position[keep], self.attitude[keep], self.velocity[keep])


class MotionStatistics(NamedTuple):
    """Root mean squares over a flight."""

    speed: float  # horizontal [m/s]
    climb: float  # vertical [m/s]
    acceleration: float  # horizontal [m/s²]
    lift: float  # vertical acceleration [m/s²]
    tilt_rate: float  # [rad/s]
    yaw_rate: float  # [rad/s]


def read_flight(path: str | Path) -> Flight:
    """A recording in EuRoC's ground-truth layout: time [ns], p (3), q wxyz, v (3), biases (6); one header line.

    Raises:
        FileNotFoundError: there is no such file; says how to name the folder.
        ValueError: the file is not of this layout.
    """
    path = Path(path)
    if not path.is_file():
        hint = f"set {DATA_VARIABLE} to the folder that holds {RECORDING.parent}"
        raise FileNotFoundError(f"no recording {path.name} in {path.parent}: {hint}")
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
        rows = np.array([line.split(",") for line in lines if line and not line.startswith("#")], dtype=np.float64)
    except ValueError as error:
        raise ValueError(f"{path.name}: expected numbers in EuRoC's ground-truth layout: {error}") from None
    if rows.ndim != 2 or len(rows) < 2 or rows.shape[1] != 17 or not np.isfinite(rows).all():
        raise ValueError(f"{path.name}: expected at least two rows of 17 finite numbers, got shape {rows.shape}")
    time = (rows[:, 0] - rows[0, 0]) * 1e-9
    if (np.diff(time) <= 0).any() or not np.allclose(np.linalg.norm(rows[:, 4:8], axis=1), 1.0, atol=1e-3):
        raise ValueError(f"{path.name}: expected rising times and unit quaternions")
    return Flight(time, rows[:, 1:4], rows[:, 4:8], rows[:, 8:11])


def statistics(flight: Flight) -> MotionStatistics:
    """Root mean squares of velocity, acceleration and rates of turn; independent of how the body's axes are called."""
    steps = np.diff(flight.time)[:, None]
    acceleration = np.diff(flight.velocity, axis=0) / steps
    turns = Rotation.from_quat(flight.attitude, scalar_first=True)
    rates = (turns[1:] * turns[:-1].inv()).as_rotvec() / steps  # in the world

    def rms(x: NDArray[np.float64]) -> float:
        return float(np.sqrt(np.mean(np.sum(x**2, axis=1))))

    return MotionStatistics(
        rms(flight.velocity[:, :2]), rms(flight.velocity[:, 2:]), rms(acceleration[:, :2]), rms(acceleration[:, 2:]),
        rms(rates[:, :2]), rms(rates[:, 2:]),
    )  # fmt: skip


def airborne(flight: Flight, speed: float = 0.1) -> Flight:
    """From when the vehicle first moves faster than `speed` [m/s] to when it last does."""
    moving = np.flatnonzero(np.linalg.norm(flight.velocity, axis=1) > speed)
    if moving.size < 2:
        raise ValueError(f"flight: nothing in it moves faster than {speed} m/s")
    return flight.part(slice(int(moving[0]), int(moving[-1]) + 1))


def calmest(flight: Flight, duration: float = CALM) -> slice:
    """The stretch of `duration` [s] with the least mean square speed; the whole flight if it is shorter."""
    count = int(np.searchsorted(flight.time, duration))
    if count >= len(flight.time):
        return slice(0, len(flight.time))
    energy = np.cumsum(np.concatenate([[0.0], np.sum(flight.velocity**2, axis=1)]))
    first = int(np.argmin(energy[count:] - energy[:-count]))
    return slice(first, first + count)


def simulate(time: NDArray[np.float64], velocity: NDArray[np.float64], seed: int) -> Flight:
    """The Firefly under velocity set-points (T, 3) [m/s] at `time` (T,) [s], sampled at those times.

    Raises:
        RuntimeError: the simulated vehicle crashed.
    """
    env = gymnasium.make(
        "aerograsp/Dock-v0",
        max_episode_steps=10**6,
        airframe="firefly",
        docked=False,
        localization="truth",
        wind="calm",
        velocity_limit=TABLE_5_2_SATURATION,
        config=DockConfig(bound=100.0),
    )
    world: Any = env.unwrapped
    env.reset(seed=seed, options={"start": (-1.0, 0.0, 1.5)})  # well above the pipe
    ticks = world.dt * np.arange(int(np.ceil(time[-1] / world.dt - 1e-9)) + 1)
    wanted = np.stack([np.interp(ticks, time, column) for column in velocity.T], axis=1) / TABLE_5_2_SATURATION
    motion = [np.concatenate([world.data.qpos[:7], world.data.qvel[:3]])]
    for now, action in zip(ticks[:-1], np.clip(wanted, -1.0, 1.0).astype(np.float32)[:-1], strict=True):
        _, _, terminated, _, info = env.step(action)
        if terminated:
            raise RuntimeError(f"the simulated flight ended after {now:.1f} s: {info['termination']}")
        motion.append(np.concatenate([world.data.qpos[:7], world.data.qvel[:3]]))
    env.close()
    sampled = np.stack([np.interp(time, ticks, column) for column in np.array(motion).T], axis=1)
    attitude = sampled[:, 3:7] / np.linalg.norm(sampled[:, 3:7], axis=1, keepdims=True)
    return Flight(time, sampled[:, :3], attitude, sampled[:, 7:])


def run(request: Request) -> Reproduction:
    """The whole flight and its calmest part, real and simulated, and a simulated hover."""
    real = airborne(read_flight(data_folder(request.data) / RECORDING))
    flown = simulate(real.time, real.velocity, request.seed)
    calm = calmest(real)
    time = np.arange(0.0, 30.0, 0.05)
    held = simulate(time, np.zeros((len(time), 3)), request.seed)
    found = {
        "flight": {"real": statistics(real), "simulated": statistics(flown)},
        "calmest": {"real": statistics(real.part(calm)), "simulated": statistics(flown.part(calm))},
        "hover": {"simulated": statistics(held)},
    }
    rows = [["", "", "speed [m/s]", "climb [m/s]", "accel. [m/s²]", "lift [m/s²]", "tilt [rad/s]", "yaw [rad/s]"]]
    for kind, pair in found.items():
        for i, (name, values) in enumerate(pair.items()):
            rows.append([kind if i == 0 else "", name, *(f"{value:.3f}" for value in values)])
    notes = NOTES.format(
        file=RECORDING.name, duration=real.time[-1], rate=1.0 / np.median(np.diff(real.time)), calm=CALM
    )
    data = {kind: {name: values._asdict() for name, values in pair.items()} for kind, pair in found.items()}
    return Reproduction(text_table(rows) + "\n" + notes, {"recording": RECORDING.name, "statistics": data})
