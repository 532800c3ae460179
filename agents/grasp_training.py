"""`aerograsp train aerograsp/GraspPlan-v0`: a point-cloud network learns from physics which grasps hold.

    aerograsp train aerograsp/GraspPlan-v0 --views 3000 --workers 2 --export graspplan.safetensors

Labels are collected first (`agents.grasp_dataset`) into the out folder's `labels`, then the network is trained on them.
Both go on where they were interrupted when the command is given again with --resume; `latest.safetensors` holds the
whole state of the training after every epoch, `best.safetensors` the weights of the least loss on validation families.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from agents.arguments import INTERRUPTED, Parser, add_json
from agents.config_checks import check_numbers
from agents.files import writable_folder, write_json
from agents.grasp_dataset import GRASP_PLAN, collect
from agents.seeds import TRAIN_SEED, VALIDATION_SEED

LATEST, BEST = "latest.safetensors", "best.safetensors"


@dataclass(frozen=True)
class GraspTrainConfig:
    """Options of the labels and of the training. A value out of range is a ValueError."""

    views: int = 3000  # of objects of the training families
    validation_views: int = 400  # of objects of the validation families
    grasps: int = 6  # labelled on each view
    epochs: int = 30
    batch_size: int = 256  # grasps
    learning_rate: float = 1e-3  # of AdamW, cosine to zero
    weight_decay: float = 1e-3
    seed: int = 0  # of the network and of the order; the labels are the same for all

    def __post_init__(self) -> None:
        check_numbers(self)


def train_scorer(
    config: GraspTrainConfig,
    out: str | Path,
    *,
    labels: str | Path | None = None,
    workers: int = 1,
    resume: bool = False,
    overwrite: bool = False,
    export: str | Path | None = None,
    progress: bool = False,
    command: list[str] | None = None,
) -> dict[str, Any]:
    """Collect labels and train; returns the card of the best network.

    Args:
        config: the options.
        out: folder of the run.
        labels: folder of the labels, to share them between trainings; the run's own by default.
        workers: processes that label.
        resume: go on with a run that the folder holds.
        overwrite: begin anew there.
        export: also write the best network here (.safetensors).
        progress: bars on a terminal, a line an epoch.
        command: what to record in the card.

    Raises:
        ValueError: a folder that holds another run, or options that do not fit the run resumed.
        OSError: a folder cannot be written.
    """
    folder = Path(out)
    if (folder / LATEST).exists() and not (resume or overwrite):
        raise ValueError(f"out: {folder} already holds a run; resume it, overwrite it, or name another folder")
    if export is not None and Path(export).suffix != ".safetensors":
        raise ValueError(f"export: expected a name that ends in .safetensors, got {str(export)!r}")
    writable_folder(folder)
    if export is not None:
        writable_folder(Path(export).absolute().parent)
    shelf = Path(labels) if labels is not None else folder / "labels"
    data = collect(shelf, "train", TRAIN_SEED, config.views, config.grasps, workers, progress)
    held_out = collect(shelf, "validation", VALIDATION_SEED, config.validation_views, config.grasps, workers, progress)
    from agents.networks.grasp_fit import fit  # torch: not before it is needed

    return fit(config, data, held_out, folder, resume and not overwrite, export, progress, command or [])


def default_folder(config: GraspTrainConfig) -> Path:
    """`runs/GraspPlan-v0-learned-<seed>`."""
    return Path("runs") / f"{GRASP_PLAN.rpartition('/')[2]}-learned-{config.seed}"


def main(argv: list[str]) -> int:
    """`aerograsp train aerograsp/GraspPlan-v0`."""
    parser = Parser(
        prog="aerograsp train",
        description="Train a point-cloud network that scores grasps, on grasps labelled by the physics.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument("id", metavar="ID", choices=[GRASP_PLAN], help=GRASP_PLAN)
    parser.add_argument("--out", metavar="FOLDER", help="of the run; by default runs/<id>-learned-<seed>")
    parser.add_argument("--labels", metavar="FOLDER", help="of the labels; by default in the run's folder")
    parser.add_argument("--workers", metavar="N", type=int, default=1, help="processes that label")
    parser.add_argument("--resume", action="store_true", help="go on with the run in the folder")
    parser.add_argument("--overwrite", action="store_true", help="begin anew in a folder that holds a run")
    parser.add_argument("--export", metavar="FILE", help="also write the best network here (.safetensors)")
    for field in fields(GraspTrainConfig):
        name = "--" + field.name.replace("_", "-")
        parser.add_argument(name, metavar="X", type=type(field.default), default=field.default, help="of the training")
    add_json(parser)
    args = parser.parse_args(argv)
    config = GraspTrainConfig(**{field.name: getattr(args, field.name) for field in fields(GraspTrainConfig)})
    out = Path(args.out) if args.out else default_folder(config)
    began = time.perf_counter()
    try:
        card = train_scorer(
            config,
            out,
            labels=args.labels,
            workers=args.workers,
            resume=args.resume,
            overwrite=args.overwrite,
            export=args.export,
            progress=True,
            command=["aerograsp", "train", *argv],
        )
    except KeyboardInterrupt:
        print("aerograsp train: interrupted; --resume goes on from the last block and epoch", file=sys.stderr)
        return INTERRUPTED
    if args.json != "-":
        print(f"validation loss {card['validation_loss']:.4f} in {time.perf_counter() - began:.0f} s: {out}")
    if args.json:
        write_json(args.json, {"config": asdict(config), **{k: card[k] for k in ("curve", "validation_loss")}})
    return 0


def standardisation(context: np.ndarray, valid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and scale (F,) of the context (V, K, F) over the grasps that there are."""
    rows = context[valid].astype(np.float64)
    return rows.mean(axis=0), np.maximum(rows.std(axis=0), 1e-6)
