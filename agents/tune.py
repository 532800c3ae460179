"""Find a controller's gains on training seeds, in the wind and with the delay that it will meet.

    aerograsp tune aerograsp/Dock-v0 --policy pid-tuned --out baselines/policies/dock_gains.json

The search is `agents.tuning`'s; the better gains are written beside the others in the file. An interrupted run goes on
where it stopped.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from agents.arguments import Parser, add_env_kwargs, add_json, guarded, positive_int, seed_int
from agents.files import writable_folder, write_json
from agents.provenance import provenance
from agents.seeds import TRAIN_SEED
from agents.tuning import CONDITIONS, Settings, tune


def _read_entries(path: Path) -> dict[str, Any]:
    """The entries of a gains file, empty if there is none yet."""
    try:
        entries = json.loads(path.read_text()) if path.exists() else {}
    except ValueError as error:
        raise ValueError(f"out: {path} is not JSON ({error})") from error
    if not isinstance(entries, dict):
        raise ValueError(f"out: {path} holds no JSON object")
    return entries


def table(entry: Mapping[str, Any]) -> str:
    """Before and after on the validation seeds."""
    lines = [f"{'gains':<8}{'|error| x, y, z [mm]':>24}{'effort':>9}{'crash':>8}{'cost [mm]':>11}"]
    for name in ("before", "after"):
        row = entry[name]
        errors = ", ".join(f"{1000.0 * e:.1f}" for e in row["error"])
        effort, cost = float(np.mean(row["effort"])), 1000.0 * float(np.mean(row["cost"]))
        lines.append(f"{name:<8}{errors:>24}{effort:>9.4f}{row['crash']:>8.2f}{cost:>11.2f}")
    gains = ", ".join(f"{name} {value}" for name, value in entry["gains"].items())
    kept = "" if entry["improved"] else "not better: the gains stay as they were\n"
    return "\n".join(lines) + f"\n{kept}{gains}"


def main(argv: list[str]) -> int:
    """`aerograsp tune ID`."""
    parser = Parser(prog="aerograsp tune", description="Find a controller's gains on training seeds; resumable.")
    parser.add_argument("id", metavar="ID", help="environment, e.g. aerograsp/Dock-v0")
    parser.add_argument("--policy", metavar="NAME", required=True, help="pid-tuned or lqg")
    parser.add_argument("--episodes", metavar="N", type=positive_int, default=10, help="side by side, a candidate")
    parser.add_argument("--seconds", metavar="S", type=float, default=20.0, help="of an episode")
    parser.add_argument("--iterations", metavar="N", type=positive_int, default=12, help="generations")
    parser.add_argument("--population", metavar="N", type=positive_int, default=12, help="candidates a generation")
    parser.add_argument("--seed", metavar="S", type=seed_int, default=TRAIN_SEED, help="first training seed")
    add_env_kwargs(parser)
    parser.add_argument("--out", metavar="FILE", default="dock_gains.json", help="gains file; other entries in it stay")
    add_json(parser)
    args = parser.parse_args(argv)
    settings = Settings(
        args.id, args.policy, args.episodes, args.seconds, args.iterations, args.population, args.seed,
        {**CONDITIONS, **args.env_kwargs},
    )  # fmt: skip
    out = Path(args.out)
    writable_folder(out.absolute().parent)
    _read_entries(out)
    state_file = out.with_name(f".{out.stem}-{args.policy}.state.json")
    entry = tune(settings, state_file, progress=True)
    entry["provenance"] = provenance(" ".join(["aerograsp tune", *argv]))
    write_json(out, {**_read_entries(out), args.policy: entry})
    state_file.unlink(missing_ok=True)
    if args.json != "-":
        print(f"{table(entry)}\nwritten to {out}")
    if args.json:
        write_json(args.json, entry)
    return 0


if __name__ == "__main__":
    sys.exit(guarded("aerograsp tune", main, sys.argv[1:]))
