"""How the vehicle follows a step of its velocity set-point: PX4's default gains, each airframe, free, in still air."""

from __future__ import annotations

from typing import Any, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim.airframe import AIRFRAMES
from aerograsp_env.sim.config import DockConfig
from aerograsp_env.sim.sensors import SensorConfig
from agents.pictures import figure_grid, png
from agents.reproduction import Reproduction, Request, text_table

STEP = 0.5  # [m/s]
DURATION = 15.0  # [s]
BAND = 0.05  # settled: within this share of the step from then on

NOTES = """\
Velocity set-point 0 → {step} m/s along one axis, undocked, still air, position and velocity sensed without error; PX4
v1.14's default gains. Rise: 10 → 90 % of the step; overshoot: of the step; settling: from then on within
± {band:.0f} %."""


class StepMetrics(NamedTuple):
    """Figures of one step response. NaN where the response never gets there."""

    rise_time: float  # 10 → 90 % [s]
    overshoot: float  # share of the step
    peak_time: float  # [s]
    settling_time: float  # [s]
    final_error: float  # mean of the last second's, share of the step


def step_metrics(time: NDArray[np.float64], response: NDArray[np.float64], target: float) -> StepMetrics:
    """Figures of `response` (T,) at `time` (T,) to a step from 0 to `target` at time 0.

    Raises:
        ValueError: fewer than two samples, differing lengths, or a target of zero.
    """
    if time.shape != response.shape or time.ndim != 1 or len(time) < 2:
        raise ValueError(
            f"response: expected as many samples as times, two at least, got {response.shape}, {time.shape}"
        )
    if target == 0.0 or not np.isfinite(target):
        raise ValueError(f"target: expected a finite value that is not zero, got {target}")
    y = response / target
    outside = np.flatnonzero(np.abs(y - 1.0) > BAND)
    if outside.size == 0:
        settled = float(time[0])
    elif outside[-1] + 1 < len(time):
        settled = float(time[outside[-1] + 1])
    else:
        settled = float("nan")
    return StepMetrics(
        rise_time=_crossing(time, y, 0.9) - _crossing(time, y, 0.1),
        overshoot=max(float(y.max()) - 1.0, 0.0),
        peak_time=float(time[np.argmax(y)]),
        settling_time=settled,
        final_error=float(np.mean(y[time >= time[-1] - 1.0])) - 1.0,
    )


def _crossing(time: NDArray[np.float64], y: NDArray[np.float64], level: float) -> float:
    """When y first reaches the level, interpolated; NaN if never."""
    above = np.flatnonzero(y >= level)
    if above.size == 0:
        return float("nan")
    k = int(above[0])
    if k == 0:
        return float(time[0])
    return float(time[k - 1] + (level - y[k - 1]) / (y[k] - y[k - 1]) * (time[k] - time[k - 1]))


def respond(airframe: str, axis: int, seed: int, duration: float = DURATION) -> tuple[NDArray, NDArray]:
    """Times (T,) [s] and true velocities (T, 3) [m/s] after a step of `STEP` along one axis."""
    env = gymnasium.make(
        "aerograsp/Dock-v0",
        airframe=airframe,
        docked=False,
        localization="truth",
        wind="calm",
        velocity_limit=STEP,
        sensors=SensorConfig().scaled(0.0),
        config=DockConfig(bound=50.0),
    )
    world: Any = env.unwrapped
    env.reset(seed=seed, options={"goal": (0.0, 0.0, 0.0), "start": (0.0, 0.0, 0.0)})
    action = np.eye(3, dtype=np.float32)[axis]
    velocities = [world.data.qvel[:3].copy()]
    for _ in range(round(duration / world.dt)):
        env.step(action)
        velocities.append(world.data.qvel[:3].copy())
    env.close()
    return world.dt * np.arange(len(velocities)), np.array(velocities)


def run(request: Request) -> Reproduction:
    """Both airframes, all three axes."""
    rows = [["airframe", "axis", "rise [s]", "overshoot [%]", "peak at [s]", "settling [s]", "final error [%]"]]
    data: dict[str, Any] = {}
    curves: dict[str, list[tuple[NDArray, NDArray]]] = {}
    for airframe in AIRFRAMES:
        data[airframe], curves[airframe] = {}, []
        for i, axis in enumerate("xyz"):
            time, velocity = respond(airframe, i, request.seed)
            m = step_metrics(time, velocity[:, i], STEP)
            data[airframe][axis] = m._asdict()
            curves[airframe].append((time, velocity[:, i]))
            figures = [m.rise_time, 100 * m.overshoot, m.peak_time, m.settling_time, 100 * m.final_error]
            cells = [f"{value:.{digits}f}" for value, digits in zip(figures, (2, 1, 2, 2, 1), strict=True)]
            rows.append([airframe if i == 0 else "", axis, *cells])
    text = text_table(rows) + "\n" + NOTES.format(step=STEP, band=100 * BAND)
    return Reproduction(text, {"step": STEP, "responses": data}, _picture(curves) if request.picture else None)


def _picture(curves: dict[str, list[tuple[NDArray, NDArray]]]) -> bytes:
    figure, axes = figure_grid(1, len(curves), (8.4, 3.2))
    for axis, (airframe, lines) in zip(axes, curves.items(), strict=True):
        axis.axhline(STEP, color="#9aa0a6", lw=0.8)
        for (time, velocity), name, color in zip(lines, "xyz", ("#3b7dd8", "#e8833a", "#3fa66b"), strict=True):
            axis.plot(time, velocity, color=color, lw=1.4, label=name)
        axis.set_title(airframe, fontsize=10)
        axis.set_xlabel("time [s]")
    axes[0].set_ylabel("velocity [m/s]")
    axes[0].legend(frameon=False)
    return png(figure)
