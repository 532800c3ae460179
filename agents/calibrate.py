"""Calibrate the sensors' noise against the thesis's Table 5.3, on seeds of its own.

Only noise amplitudes change, each by the ratio of the published figure to the simulated one, over and over:
GPS offsets follow the mean errors and its wander the spreads; vision's wander and, on the axis whose
spread is larger than wander alone can make it, its slips follow both; docked, the velocity estimate's wander does.
The result is printed as the defaults of `aerograsp_env.sim.sensors.SensorConfig`, where it stands.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim.config import DockConfig
from aerograsp_env.sim.sensors import SensorConfig
from agents.arguments import Parser, add_json, guarded
from agents.evaluation import evaluate
from agents.files import write_json
from agents.published import TABLE_5_3
from agents.seeds import VALIDATION_SEED

SEED = VALIDATION_SEED + 500_000
ENV_ID = "aerograsp/Dock-v0"


def measure(sensors: SensorConfig, source: str, episodes: int, seed: int) -> NDArray[np.float64]:
    """(2, 3) mean |error| and spread per axis [m] of the thesis's PID in light wind with one position source."""
    options = {
        "config": DockConfig(set_point_spread=0.0), "sensors": sensors, "wind": "light",
        "localization": source, "docked": source == "dock",
    }  # fmt: skip
    result = evaluate(ENV_ID, "pid", episodes, seed, options)
    return np.array([[result.mean(f"{kind}_{axis}") for axis in "xyz"] for kind in ("error", "std")])


def adjusted(sensors: SensorConfig, source: str, ratio: NDArray[np.float64], damping: float) -> SensorConfig:
    """The sensors with one source's amplitudes moved by `ratio` (2, 3) of published to simulated figures."""
    mean, spread = ratio**damping
    config = getattr(sensors, source)

    def times(name: str, factor: NDArray[np.float64]) -> tuple[float, float, float]:
        x, y, z = (np.asarray(getattr(config, name)) * factor).round(5).tolist()
        return x, y, z

    if source == "gps":
        config = replace(config, offset=times("offset", mean), wander_limit=times("wander_limit", spread))
    elif source == "vision":
        both = np.sqrt(mean * spread)
        config = replace(config, wander_limit=times("wander_limit", both), jump_size=times("jump_size", both))
    else:
        config = replace(config, velocity_limit=times("velocity_limit", np.sqrt(mean * spread)))
        sensors = replace(sensors, truth=replace(sensors.truth, velocity_limit=config.velocity_limit))
    return replace(sensors, **{source: config})


def calibrate(sensors: SensorConfig, episodes: int, rounds: int, seed: int = SEED) -> SensorConfig:
    """Repeat measuring and adjusting `rounds` times."""
    for k in range(rounds):
        for source in ("gps", "vision", "dock"):
            figures = measure(sensors, source, episodes, seed + 1000 * k)
            ratio = np.asarray(TABLE_5_3[source]) / figures
            print(f"round {k + 1} {source:6s} simulated/published", np.round(1.0 / ratio, 2).tolist(), flush=True)
            sensors = adjusted(sensors, source, ratio, 0.7)
    return sensors


def main(argv: list[str]) -> int:
    """`aerograsp calibrate`."""
    parser = Parser(prog="aerograsp calibrate", description=__doc__)
    parser.add_argument("--episodes", type=int, default=60, help="per source and round")
    parser.add_argument("--rounds", type=int, default=6)
    add_json(parser)
    args = parser.parse_args(argv)
    sensors = calibrate(SensorConfig(), args.episodes, args.rounds)
    found = {
        "gps": {"offset": sensors.gps.offset, "wander_limit": sensors.gps.wander_limit},
        "vision": {"wander_limit": sensors.vision.wander_limit, "jump_size": sensors.vision.jump_size},
        "dock": {"velocity_limit": sensors.dock.velocity_limit},
    }
    for source, values in found.items():
        print(source, values)
    if args.json:
        write_json(args.json, found)
    return 0


if __name__ == "__main__":
    sys.exit(guarded("aerograsp calibrate", main, sys.argv[1:]))
