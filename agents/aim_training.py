"""`aerograsp train aerograsp/Grasp-v0 --algorithm aim`: learn from flights what comes of a grasp, to aim the next.

    aerograsp train aerograsp/Grasp-v0 --algorithm aim --level combined --seed 0 --export aim.safetensors

First flights are collected (`agents.aim_dataset`) into the out folder's `flights`, or into another folder; blocks that
are there already are not flown again, so that the same command goes on where it was interrupted. Fitting the network
then takes seconds (`agents.networks.aim_fit`); `best.safetensors` holds the policy.
"""

from __future__ import annotations

import argparse
import shlex
import sys
import time
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from aerograsp_env.envs.grasp_levels import LEVELS
from agents.aim_choice import OUTCOMES
from agents.aim_dataset import Attempts, collect
from agents.aim_features import NAMES
from agents.arguments import INTERRUPTED, Parser, add_json
from agents.bench_setup import GRASP
from agents.checkpoint import AIM_KIND, save_checkpoint
from agents.config_checks import check_numbers
from agents.files import to_json, writable_folder, write_json
from agents.policies import UnknownName
from agents.provenance import provenance
from agents.seeds import TRAIN_SEED, TRAIN_SEEDS, VALIDATION_SEED

BEST = "best.safetensors"
SPAN = 800  # episodes that a training can have: those of the next seed come after
SHARES = (0.125, 0.25, 0.5, 1.0)  # of the flights, for the learning curve


@dataclass(frozen=True)
class AimConfig:
    """Options of the flights and of the fit. A value out of range is a ValueError."""

    level: str = "combined"
    episodes: int = 280  # with training objects, at most SPAN
    validation_episodes: int = 60  # with validation objects
    epochs: int = 40
    batch_size: int = 128
    learning_rate: float = 3e-3  # of AdamW, cosine to zero
    weight_decay: float = 0.1
    hidden: tuple[int, ...] = (32, 32)
    members: int = 4  # of the ensemble
    copies: int = 8  # of each attempt, with jitter
    seed: int = 0  # of the flights, of the network and of the order; validation flights are the same for all

    def __post_init__(self) -> None:
        if self.level not in LEVELS:
            raise UnknownName("level", self.level, LEVELS)
        if not self.hidden or min(self.hidden) < 1:
            raise ValueError(f"hidden: expected positive widths, got {self.hidden}")
        if isinstance(self.episodes, int) and self.episodes > SPAN:
            raise ValueError(f"episodes: expected at most {SPAN}, got {self.episodes}")
        if isinstance(self.seed, int) and self.seed >= len(TRAIN_SEEDS) // SPAN:
            raise ValueError(f"seed: expected less than {len(TRAIN_SEEDS) // SPAN}, got {self.seed}")
        check_numbers(self, skip=("level", "hidden"))


def train_aim(
    config: AimConfig,
    out: str | Path,
    *,
    flights: str | Path | None = None,
    export: str | Path | None = None,
    progress: bool = False,
    command: list[str] | None = None,
) -> dict[str, Any]:
    """Collect flights and fit the network; returns the policy's card.

    Args:
        config: the options.
        out: folder of the run.
        flights: folder of the flights, to share them between trainings; the run's own by default.
        export: also write the policy here (.safetensors).
        progress: bars on a terminal, and a line a fit.
        command: what to record in the card.

    Raises:
        ValueError: flights in which nothing was grasped, or a name that does not end in .safetensors.
        OSError: a folder cannot be written.
    """
    from agents.networks.aim_fit import fit  # torch: not before it is needed

    if export is not None and Path(export).suffix != ".safetensors":
        raise ValueError(f"export: expected a name that ends in .safetensors, got {str(export)!r}")
    folder, began = writable_folder(out), time.perf_counter()
    origin = provenance(shlex.join(command or []))
    shelf = Path(flights) if flights is not None else folder / "flights"
    first = TRAIN_SEED + SPAN * config.seed
    data = collect(shelf, "train", config.level, first, config.episodes, progress)
    held_out = collect(shelf, "validation", config.level, VALIDATION_SEED, config.validation_episodes, progress)
    curve = []
    for share in SHARES:
        some = data.take(data.episode < first + max(1, round(share * config.episodes)))
        if len(some.outcome):
            tensors, epochs = fit(config, some, held_out, progress)
            best = min(epochs, key=lambda row: row["validation_loss"])
            curve.append({"episodes": round(share * config.episodes), "attempts": len(some.outcome), **best})
    card = to_json(
        {
            "kind": AIM_KIND,
            "env_id": GRASP,
            "env_kwargs": {"level": config.level, "objects": "train"},
            "algorithm": "aim",
            "steps": None,
            "validation_score": best["validation_loss"],  # lower is better
            "features": list(NAMES),
            "outcomes": list(OUTCOMES),
            "members": config.members,
            "hidden": list(config.hidden),
            "training": {
                "command": command or [],
                "seed": config.seed,
                "provenance": origin,
                "wall_time": time.perf_counter() - began,
                "attempts": _counts(data),
                "validation_attempts": _counts(held_out),
                "guess_loss": guess_loss(data, held_out),
                "curve": curve,
                "epochs": epochs,
                "config": asdict(config),
            },
        }
    )
    for path in (folder / BEST, *([] if export is None else [Path(export)])):
        save_checkpoint(path, tensors, card)
    return card


def _counts(data: Attempts) -> dict[str, int]:
    return {name: int((data.outcome == k).sum()) for k, name in enumerate(OUTCOMES)}


def guess_loss(data: Attempts, held_out: Attempts) -> float:
    """The validation loss of who knows only how often each outcome is."""
    shares = (np.bincount(data.outcome, minlength=len(OUTCOMES)) + 1.0) / (len(data.outcome) + len(OUTCOMES))
    return float(-np.log(shares[held_out.outcome]).mean())


def default_folder(config: AimConfig) -> Path:
    """`runs/Grasp-v0-aim-<seed>`."""
    return Path("runs") / f"{GRASP.rpartition('/')[2]}-aim-{config.seed}"


def main(argv: list[str]) -> int:
    """`aerograsp train aerograsp/Grasp-v0 --algorithm aim`."""
    parser = Parser(
        prog="aerograsp train",
        description="Learn from flights of grasp-dls what comes of a grasp, to choose and aim the next one.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument("id", metavar="ID", choices=[GRASP], help=GRASP)
    parser.add_argument("--algorithm", metavar="NAME", choices=["aim"], help="aim")
    parser.add_argument("--out", metavar="FOLDER", help="of the run; by default runs/<id>-aim-<seed>")
    parser.add_argument("--flights", metavar="FOLDER", help="of the flights; by default in the run's folder")
    parser.add_argument("--export", metavar="FILE", help="also write the policy here (.safetensors)")
    for field in fields(AimConfig):
        if field.name != "hidden":
            name = "--" + field.name.replace("_", "-")
            kind: Any = type(field.default)
            parser.add_argument(name, metavar="X", type=kind, default=field.default, help="of the training")
    add_json(parser)
    args = parser.parse_args(argv)
    given = {field.name: getattr(args, field.name) for field in fields(AimConfig) if hasattr(args, field.name)}
    config = replace(AimConfig(), **given)
    out = Path(args.out) if args.out else default_folder(config)
    began = time.perf_counter()
    try:
        card = train_aim(
            config,
            out,
            flights=args.flights,
            export=args.export,
            progress=True,
            command=["aerograsp", "train", *argv],
        )
    except KeyboardInterrupt:
        print("aerograsp train: interrupted; the same command goes on after the last block", file=sys.stderr)
        return INTERRUPTED
    if args.json != "-":
        print(f"validation loss {card['validation_score']:.4f} in {time.perf_counter() - began:.0f} s: {out}")
    if args.json:
        write_json(args.json, card)
    return 0
