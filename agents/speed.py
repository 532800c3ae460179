"""`aerograsp bench --speed`: what a step costs, as ratios of things measured in turns within one run.

A machine's speed changes from second to second, so nothing is compared with a figure of another time: what is
compared runs in turns of a few milliseconds, warm, and each ratio is the median over repeats with its quartiles. What
runs in one thread is judged by that thread's processor time, which other processes' slices of time do not enter.
"""

import argparse
import math
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from aerograsp_env.sim.layout import SUBSTEPS
from agents.arguments import Parser, add_json, guarded, positive_int
from agents.files import write_json
from agents.provenance import provenance
from agents.speed_peers import PeerProcess
from agents.speed_runners import (
    DOCK,
    PROCESSOR,
    WALL,
    BareSteps,
    Replay,
    Runner,
    in_turns,
    make_batch,
    make_single,
    others_load,
    record,
    reset_times,
    start_time,
)

NUM_ENVS = 64
PPO_ROLLOUTS = 2
IDLE = 0.25  # cores that others may use while "all cores" is judged


@dataclass(frozen=True)
class Row:
    """One figure: median and quartiles over repeats, and what it should reach."""

    name: str
    unit: str
    values: tuple[float, ...] = ()
    target: str = ""  # "≥ 0.80"
    note: str = ""

    @property
    def median(self) -> float:
        return float(np.median(self.values)) if self.values else float("nan")

    @property
    def quartiles(self) -> tuple[float, float]:
        low, high = np.quantile(self.values, (0.25, 0.75)) if self.values else (float("nan"), float("nan"))
        return float(low), float(high)

    @property
    def verdict(self) -> str:
        """ "met", "missed", "not measured", or "" where there is no target."""
        if not self.values:
            return "not measured"
        if not self.target:
            return ""
        sign, bound = self.target.split()
        met = self.median >= float(bound) if sign == "≥" else self.median <= float(bound)
        return "met" if met else "missed"

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {**asdict(self), "median": self.median, "quartiles": self.quartiles, "verdict": self.verdict}


def single_rows(seconds: float, repeats: int, peer: PeerProcess | None, why_not: str) -> list[Row]:
    """The single environment against bare MuJoCo steps and against other simulators."""
    env, other = make_single(), make_single()
    flight = record(env, steps=500)
    bare = BareSteps(flight)
    runners: dict[str, Runner] = {
        "bare": bare,
        "env": Replay(env, flight),
        "unwrapped": Replay(other.unwrapped, flight),
    }
    times = in_turns(runners, seconds, repeats)
    step = {name: 1e6 * values / flight.chunk for name, values in times.items()}
    ratio = step["bare"] / step["env"]
    rows = [
        Row(
            f"bare loop of {SUBSTEPS} × mj_step",
            "µs",
            as_tuple(step["bare"]),
            note=f"{bare.constraints} active constraint rows",
        ),
        Row("Dock-v0, env.step", "µs", as_tuple(step["env"])),
        Row("Dock-v0 / bare loop, speed", "", as_tuple(ratio), "≥ 0.80"),
        Row("Dock-v0 / bare loop, speed by wall time", "", as_tuple(ratio, WALL)),
        Row("Dock-v0.unwrapped / bare loop, speed", "", as_tuple(step["bare"] / step["unwrapped"])),
        Row("Dock-v0, simulated / wall time", "×", as_tuple(1e6 * env.unwrapped.dt / step["env"], WALL)),
    ]
    rows += peer_rows(Replay(env, flight), flight.chunk * env.unwrapped.dt, seconds, repeats, peer, why_not)
    rows.append(Row("Dock-v0, reset", "ms", tuple((1e3 * reset_times(env, max(20, 5 * repeats))).tolist())))
    env.close()
    other.close()
    return rows


def peer_rows(
    ours: Replay, simulated: float, seconds: float, repeats: int, peer: PeerProcess | None, why_not: str
) -> list[Row]:
    """Simulated seconds per wall second, ours over theirs; `simulated` [s] passes in one call of `ours`."""
    if peer is None:
        return [Row("Dock-v0 / PyFlyt QuadX-Hover-v4, simulated time", "×", (), "≥ 5", why_not)]
    rows = []
    for name in (*peer.peers.found, *peer.peers.missing):
        target = "≥ 5" if name.startswith("PyFlyt") else ""
        if name in peer.peers.missing:
            rows.append(Row(f"Dock-v0 / {name}, simulated time", "×", (), target, peer.peers.missing[name]))
            continue
        theirs, own = np.zeros((repeats, 2)), np.zeros((repeats, 2))
        for repeat in range(repeats):
            own[repeat] = simulated / in_turns({"ours": ours}, seconds, 1)["ours"][0]
            theirs[repeat] = peer.speed(name, seconds)
        rows.append(Row(f"{name}, simulated / wall time", "×", as_tuple(theirs, WALL)))
        rows.append(Row(f"Dock-v0 / {name}, simulated time", "×", as_tuple(own / theirs), target))
        rows.append(Row(f"Dock-v0 / {name}, simulated time by wall time", "×", as_tuple(own / theirs, WALL), target))
    return rows


def batch_rows(seconds: float, repeats: int, num_envs: int = NUM_ENVS) -> list[Row]:
    """The native batched environment's time per world and step against the single environment's."""
    single, one, all_ = make_single(), make_batch(num_envs, threads=1), make_batch(num_envs, threads=None)
    flight, batch_flight = record(single, steps=400, chunk=200), record(one, steps=40, chunk=10)
    with others_load() as load:
        alone = in_turns({"single": Replay(single, flight), "batch": Replay(one, batch_flight)}, seconds, repeats)
        together = in_turns({"single": Replay(single, flight), "batch": Replay(all_, batch_flight)}, seconds, repeats)
    for env in (single, one, all_):
        env.close()
    rows = []
    for threads, times, clock, target in (
        ("1 thread", alone, PROCESSOR, "≥ 1.0"),
        ("all cores", together, WALL, "≥ 1.5"),
    ):
        world = 1e6 * times["batch"] / (batch_flight.chunk * num_envs)
        ratio = 1e6 * times["single"] / flight.chunk / world
        name = f"batch of {num_envs}, {threads}"
        rows.append(Row(f"{name}: a world's step", "µs", as_tuple(world, clock)))
        rows.append(Row(f"{name} / single env, speed", "", as_tuple(ratio, clock), target))
    if load.cores is not None and load.cores > IDLE:
        rows[-1] = replace(rows[-1], note=f"other work took {load.cores:.1f} cores meanwhile: judge on an idle machine")
    return rows


def ppo_row(repeats: int = 1, **changes: Any) -> Row:
    """PPO's wall time per million steps, from a few rollouts and updates of `aerograsp train`'s own settings."""
    name, unit = "PPO, wall time per million steps", "s"
    try:
        from agents.train import TrainConfig, train

        defaults = TrainConfig(eval_episodes=0)
        steps = PPO_ROLLOUTS * defaults.num_envs * defaults.n_steps
        values = []
        for seed in range(repeats):
            with tempfile.TemporaryDirectory() as folder:
                config = TrainConfig(**{"steps": steps, "eval_episodes": 0, "seed": seed, **changes})
                values.append(train(DOCK, config, out=Path(folder) / "run").seconds_per_million_steps)
    except ModuleNotFoundError as error:
        return Row(name, unit, (), "", f"{error}; install the extra: aerograsp[learn]")
    return Row(name, unit, tuple(values), "", f"{config.steps} steps measured, {config.num_envs} worlds")


def start_row(repeats: int) -> Row:
    """From starting Python to the first step's result, the compiled loop being cached on disk already."""
    return Row("start, import to first step", "s", tuple(start_time() for _ in range(repeats)), "≤ 3")


def speed(
    seconds: float = 0.5,
    repeats: int = 7,
    peer_python: str | None = None,
    num_envs: int = NUM_ENVS,
    ppo: Mapping[str, Any] | None = None,
    command: str = "agents.speed.speed",
) -> dict[str, Any]:
    """Measure everything.

    Args:
        seconds: that what is compared runs in all, a repeat.
        repeats: of every measurement; medians and quartiles are over them.
        peer_python: an interpreter that has PyFlyt, gym-pybullet-drones or both.
        num_envs: worlds of the batched environment.
        ppo: changes to the measured training's configuration.
        command: recorded in the result.

    Returns:
        A dict of "provenance", "settings", "peer" (its versions) and "rows" (`Row`).

    Raises:
        OSError: the peers' interpreter cannot be run.
    """
    facts = provenance(command)
    peer = None if peer_python is None else PeerProcess(peer_python)
    try:
        why_not = "--peer-python PATH names an interpreter that has it: a virtual environment of its own (numpy < 2)"
        rows = single_rows(seconds, repeats, peer, why_not)
    finally:
        if peer is not None:
            peer.close()
    rows += batch_rows(seconds, repeats, num_envs)
    rows.append(start_row(min(repeats, 3)))
    rows.append(ppo_row(min(repeats, 3), **(ppo or {})))
    settings = {"seconds": seconds, "repeats": repeats, "num_envs": num_envs}
    return {
        "provenance": facts,
        "settings": settings,
        "peer": {} if peer is None else peer.peers.versions,
        "rows": rows,
    }


def table(rows: list[Row]) -> str:
    """The rows as aligned text, notes below."""
    lines = [("", "median", "quartiles", "target", "verdict")]
    for row in rows:
        if row.values:
            low, high = row.quartiles
            cells = (f"{row.median:.4g} {row.unit}".strip(), f"{low:.4g} … {high:.4g}")
        else:
            cells = ("—", "—")
        lines.append((row.name, *cells, row.target, row.verdict))
    widths = [max(len(line[i]) for line in lines) for i in range(len(lines[0]))]
    texts = [
        "  ".join(t.ljust(w) if i in (0, 4) else t.rjust(w) for i, (t, w) in enumerate(zip(line, widths, strict=True)))
        for line in lines
    ]
    rule = "─" * max(map(len, texts))
    return "\n".join([texts[0], rule, *texts[1:], rule, *(f"{row.name}: {row.note}" for row in rows if row.note)])


def positive_seconds(text: str) -> float:
    """An argument type: a finite positive number."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0):
        raise argparse.ArgumentTypeError(f"expected a positive number of seconds, got {text!r}")
    return value


def as_tuple(values: np.ndarray, clock: int = PROCESSOR) -> tuple[float, ...]:
    """The repeats' values (repeats, 2) by one of the clocks."""
    return tuple(values[:, clock].tolist())


def main(argv: list[str]) -> int:
    """`aerograsp bench --speed`."""
    parser = Parser(prog="aerograsp bench --speed", description="What a step costs, as ratios measured in one run.")
    parser.add_argument("--peer-python", metavar="PATH", help="interpreter with PyFlyt, gym-pybullet-drones or both")
    parser.add_argument("--seconds", metavar="S", type=positive_seconds, default=0.5, help="of a repeat's measurement")
    parser.add_argument("--repeats", metavar="R", type=positive_int, default=7, help="of every measurement")
    add_json(parser)
    args = parser.parse_args(argv)
    command = " ".join(["aerograsp", "bench", "--speed", *argv])
    result = speed(args.seconds, args.repeats, args.peer_python, command=command)
    if args.json != "-":
        facts = result["provenance"]
        machine, versions = facts["machine"], {**facts["versions"]}
        print(table(result["rows"]))
        print(f"{machine['cpu']}, {machine['cores']} cores; commit {facts['commit'] or 'unknown'}")
        print(", ".join(f"{name} {version}" for name, version in versions.items()))
        if result["peer"]:
            print("peers: " + ", ".join(f"{name} {version}" for name, version in result["peer"].items()))
    if args.json:
        write_json(args.json, {**result, "rows": [row.to_dict() for row in result["rows"]]})
    return 0


if __name__ == "__main__":
    sys.exit(guarded("aerograsp bench --speed", main, sys.argv[1:]))
