"""`aerograsp detector train DATASET`: a detector learns, from scratch, to find objects in rendered pictures.

    aerograsp detector train data/train --validation data/validation --family yolo --out runs/detect-yolo

Interrupted by Ctrl-C or a kill, it goes on with --resume where it was, to the bit on the same machine: every step draws
its pictures from a seed of its own, and `latest.safetensors` holds the whole state. `best.safetensors` holds the
averaged weights with the best mAP on validation pictures. Progress counts steps, never seconds: a busy machine gives
the same network later.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any

from agents.arguments import INTERRUPTED, Parser, add_json
from agents.detect_augment import Augmentation
from agents.files import writable_folder, write_json

LATEST, BEST = "latest.safetensors", "best.safetensors"


@dataclass(frozen=True)
class DetectTrainConfig:
    """Options of a training. A value out of range is a ValueError."""

    family: str = "yolo"  # yolo, ssd or two-stage
    input: str = "rgbd"  # rgb, or rgbd with inverse depth as a fourth channel
    steps: int = 12000  # batches
    batch: int = 32  # pictures
    workers: int = 1  # processes that share every batch
    sizes: str = "160:6,224:4"  # side [px] of the pictures and share of the steps, one phase after another
    learning_rate: float = 2e-3  # of AdamW, after a warm-up; cosine to a hundredth
    weight_decay: float = 0.02
    warmup: int = 300  # steps
    averaging: float = 0.999  # decay of the exponential moving average of the weights
    plain: float = 0.12  # last share of the steps, without mosaics
    depth_dropout: float = 0.35  # share of the pictures that the network sees without depth
    balance: float = 0.5  # how much more often pictures of rare classes are shown: power of the ratio of frequencies
    validate_every: int = 1000  # steps
    validation_images: int = 300
    seed: int = 0

    def __post_init__(self) -> None:
        least = {"learning_rate": 1e-9, "weight_decay": 0.0, "averaging": 0.0, "plain": 0.0}
        least |= {"depth_dropout": 0.0, "balance": 0.0}
        most = {"averaging": 0.999999, "plain": 1.0, "depth_dropout": 1.0, "learning_rate": 1.0, "weight_decay": 1.0}
        most |= {"balance": 1.0}
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(field.default, str):
                continue
            whole = isinstance(field.default, int)
            low = least.get(field.name, 0 if field.name in ("warmup", "seed") else 1)
            high = most.get(field.name, 2**31)
            fits = isinstance(value, int if whole else int | float) and not isinstance(value, bool)
            if not fits or not low <= value <= high:
                raise ValueError(f"{field.name}: expected a number from {low:g} to {high:g}, got {value!r}")
        self.phases()
        if self.batch % self.workers:
            raise ValueError(f"workers: expected a divisor of the batch of {self.batch}, got {self.workers}")

    def phases(self) -> list[tuple[int, float]]:
        """(side of the pictures [px], share of the steps) of each phase; the shares add up to 1.

        Raises:
            ValueError: `sizes` is not SIDE:SHARE,…, with sides that are multiples of 32.
        """
        try:
            pairs = [part.split(":") for part in self.sizes.split(",")]
            phases = [(int(side), float(share)) for side, share in pairs]
        except ValueError:
            phases = []
        if not phases or any(side < 64 or side % 32 or not 0.0 < share < 1e6 for side, share in phases):
            raise ValueError(
                f"sizes: expected SIDE:SHARE,… with sides that are multiples of 32 from 64, got {self.sizes!r}"
            )
        total = sum(share for _, share in phases)
        return [(side, share / total) for side, share in phases]

    def size(self, step: int) -> int:
        """Side [px] of the pictures of a step."""
        done = (step + 0.5) / self.steps
        for side, share in self.phases():
            if done < share:
                return side
            done -= share
        return self.phases()[-1][0]

    def augmentation(self, step: int) -> Augmentation:
        """What is done to the pictures of a step."""
        if step >= self.steps * (1.0 - self.plain):
            return Augmentation(mosaic=0.0, depth_dropout=self.depth_dropout)
        return Augmentation(depth_dropout=self.depth_dropout)


def train_detector(
    config: DetectTrainConfig,
    datasets: Sequence[str | Path],
    validation: str | Path,
    out: str | Path,
    *,
    images: int | None = None,
    initial: str | Path | None = None,
    resume: bool = False,
    overwrite: bool = False,
    progress: bool = False,
    command: list[str] | None = None,
) -> dict[str, Any]:
    """Train a detector; returns the card of the network with the best mAP on validation pictures.

    Args:
        config: the options.
        datasets: folders of training pictures, written by `aerograsp dataset detect`.
        validation: folder of the validation pictures.
        out: folder of the run.
        images: how many of the first training pictures; all by default.
        initial: weights to begin with, of the same layout; none by default.
        resume: go on with the run that the folder holds.
        overwrite: begin anew there.
        progress: a bar on a terminal, a line a validation.
        command: what to record in the card.

    Raises:
        ValueError: a folder that holds another run, data sets of different classes, options that do not fit.
        OSError: a folder cannot be written or read.
    """
    folder = Path(out)
    if (folder / LATEST).exists() and not (resume or overwrite):
        raise ValueError(f"out: {folder} already holds a run; resume it, overwrite it, or name another folder")
    from agents.detect_train_parallel import ALONE, others  # torch: not before it is needed

    goes_on = resume and not overwrite and (folder / LATEST).exists()
    source = folder / LATEST if goes_on else None if initial is None else Path(initial)
    pictures, held_out = [Path(path) for path in datasets], Path(validation)
    make = partial(make_training, config, pictures, held_out, folder, images, source, command or [])
    training = make(ALONE)  # with its complaints, before there are other processes
    writable_folder(folder)
    with others(make, config.workers, folder) as shard:
        training.shard = shard
        return training.run(progress)


def make_training(
    config: DetectTrainConfig,
    datasets: list[Path],
    validation: Path,
    folder: Path,
    images: int | None,
    source: Path | None,
    command: list[str],
    shard: Any,
) -> Any:
    """One process's `agents.detect_train_loop.Training`, from a run's state or weights if there is a `source`."""
    from agents.detect_dataset import DetectDataset
    from agents.detect_frames import FrameCache
    from agents.detect_train_loop import Training
    from agents.networks.detector import DetectorLayout

    pictures, held_out = [DetectDataset(path) for path in datasets], DetectDataset(validation)
    classes = tuple(held_out.classes)
    for path, dataset in zip(datasets, pictures, strict=True):
        if tuple(dataset.classes) != classes:
            raise ValueError(
                f"{path}: expected the classes of the validation pictures, {', '.join(classes)}; "
                f"got {', '.join(dataset.classes)}"
            )
    layout = DetectorLayout(classes, config.family, config.input)
    training = Training(config, layout, FrameCache(pictures, images), held_out, folder, command, shard)
    if source is not None and source == folder / LATEST:
        training.restore(source)
    elif source is not None:
        training.begin_with(source)
    return training


def main(argv: list[str]) -> int:
    """`aerograsp detector train`."""
    parser = Parser(
        prog="aerograsp detector train",
        description="Train a detector from scratch on rendered pictures.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument("datasets", metavar="DATASET", nargs="+", help="folder of training pictures")
    parser.add_argument("--validation", metavar="FOLDER", required=True, help="folder of validation pictures")
    parser.add_argument("--out", metavar="FOLDER", help="of the run; by default runs/detect-<family>-<input>-<seed>")
    parser.add_argument("--images", metavar="N", type=int, help="only the first N training pictures")
    parser.add_argument("--initial", metavar="FILE", help="weights to begin with (.safetensors), as for fine-tuning")
    parser.add_argument("--resume", action="store_true", help="go on with the run in the folder")
    parser.add_argument("--overwrite", action="store_true", help="begin anew in a folder that holds a run")
    parser.add_argument("--export", metavar="FILE", help="also export the best network here (.onnx)")
    for field in fields(DetectTrainConfig):
        name = "--" + field.name.replace("_", "-")
        parser.add_argument(name, metavar="X", type=type(field.default), default=field.default, help="of the training")
    add_json(parser)
    args = parser.parse_args(argv)
    config = DetectTrainConfig(**{field.name: getattr(args, field.name) for field in fields(DetectTrainConfig)})
    out = Path(args.out) if args.out else Path("runs") / f"detect-{config.family}-{config.input}-{config.seed}"
    try:
        card = train_detector(
            config,
            args.datasets,
            args.validation,
            out,
            images=args.images,
            initial=args.initial,
            resume=args.resume,
            overwrite=args.overwrite,
            progress=True,
            command=["aerograsp", "detector", "train", *argv],
        )
    except KeyboardInterrupt:
        print("aerograsp detector train: interrupted; --resume goes on from this step", file=sys.stderr)
        return INTERRUPTED
    if args.export:
        from agents.detect_export import export_onnx

        export_onnx(out / BEST, args.export)
    if args.json != "-":
        print(f"validation mAP@0.5 {card['validation_score']:.4f} after {card['step']} steps: {out}")
    if args.json:
        write_json(args.json, card)
    return 0


if __name__ == "__main__":
    from agents.arguments import guarded

    sys.exit(guarded("aerograsp detector train", main, sys.argv[1:]))
