"""Train a policy by PPO or SAC, alone or as a residual over an analytic one; resumable to the bit.

    aerograsp train aerograsp/Dock-v0 --residual pid --env-kwarg wind=gusty --export dock.safetensors
    aerograsp train aerograsp/Reach-v0 --algorithm sac
    aerograsp train aerograsp/Grasp-v0 --algorithm aim

The out folder holds `latest.safetensors` (the whole state of the training), `best.safetensors` (the best policy on the
validation seeds, for inference), a JSON card beside each, `summary.json` and TensorBoard's log. The simulator's state
is not saved: the worlds restart at every periodic checkpoint, in an uninterrupted run too, with seeds drawn from (seed,
steps). A run resumed from a periodic checkpoint is therefore the uninterrupted one, bit for bit, on one machine. SAC's
memory lies beside, in `replay.npz`; a run resumed without it first gathers new experience with the policy it has.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from agents.arguments import INTERRUPTED, Parser, add_json, guarded, one_line
from agents.bench_setup import GRASP, GRASP_PLAN
from agents.checkpoint import Checkpoint, CheckpointError, load_checkpoint
from agents.files import to_json, writable_folder, write_json
from agents.policies import NAMESPACE, UnknownName, env_spec
from agents.sac_config import SacConfig
from agents.train_config import (
    LATEST,
    RunConfig,
    TrainConfig,
    TrainingInterrupted,
    TrainResult,
    add_config,
    given_options,
)

if TYPE_CHECKING:
    from agents.training import Run

__all__ = ["ALGORITHMS", "SacConfig", "TrainConfig", "TrainResult", "TrainingInterrupted", "default_folder", "train"]

ALGORITHMS: dict[str, type[RunConfig]] = {kind.FAMILY: kind for kind in (TrainConfig, SacConfig)}


def train(
    env_id: str,
    config: RunConfig | None = None,
    *,
    algorithm: str | None = None,
    out: str | Path | None = None,
    resume: str | Path | None = None,
    export: str | Path | None = None,
    overwrite: bool = False,
    progress: bool = False,
    command: Sequence[str] | None = None,
    **changes: Any,
) -> TrainResult:
    """Train a policy for an id.

    Args:
        env_id: a registered id with Dict observations of vectors and actions in [−1, 1].
        config: the hyper-parameters, a `TrainConfig` (PPO) or a `SacConfig`; with `resume`, the checkpoint's if None.
        algorithm: "ppo" or "sac"; the config's, the resumed checkpoint's, or else PPO if None.
        out: folder for checkpoints and logs; `runs/<id>-<algorithm>-<seed>` by default.
        resume: a training checkpoint, or the folder of one, to go on from; its folder is the default `out`.
        export: also write the best policy (the latest, if never evaluated) here, for inference.
        overwrite: begin anew in a folder that holds a run.
        progress: a bar on standard error, and a line an evaluation.
        command: what to record as the command in the cards.
        **changes: fields of the configuration that override `config`'s.

    Raises:
        ValueError: a user's mistake: unknown id, option or policy, a number out of range, a checkpoint that does not
            fit, a folder that holds another run.
        OSError: a folder cannot be written.
        TrainingInterrupted: after Ctrl-C, with a new whole checkpoint on disk.
    """
    env_spec(env_id)
    checkpoint = None
    if resume is not None:
        checkpoint = _training_checkpoint(resume, env_id)
        out = out if out is not None else checkpoint.path.parent
    named = (algorithm, None if config is None else config.FAMILY, None if checkpoint is None else _family(checkpoint))
    families = [family for family in named if family is not None]
    if len(set(families)) > 1:
        raise ValueError(f"algorithm: expected one for all, got {', '.join(families)}")
    kind = config_class(families[0] if families else None)
    try:
        if config is None:
            config = kind.from_card(checkpoint.card["training"]["config"] if checkpoint else {}, **changes)
        elif changes:
            config = kind.from_card(config.to_card(), **changes)
    except (KeyError, TypeError) as error:
        raise ValueError(f"config: {one_line(error)}") from None
    to_json(dict(config.env_kwargs))  # what the card cannot hold is refused before, not after, the work
    folder = Path(out) if out is not None else default_folder(env_id, config)
    if export is not None and Path(export).suffix != ".safetensors":
        raise ValueError(f"export: expected a name that ends in .safetensors, got {str(export)!r}")
    if checkpoint is None and not overwrite and (folder / LATEST).exists():
        raise ValueError(f"out: {folder} already holds a run; resume it, overwrite it, or name another folder")
    writable_folder(folder)
    if export is not None:
        writable_folder(Path(export).absolute().parent)
    with _run_class(config)(env_id, config, folder, checkpoint, progress, list(command or [])) as run:
        return run.train(Path(export) if export is not None else None)


def config_class(algorithm: str | None) -> type[RunConfig]:
    """The configuration of an algorithm, PPO's for None.

    Raises:
        UnknownName: no such algorithm.
    """
    if algorithm is None:
        return TrainConfig
    if algorithm not in ALGORITHMS:
        raise UnknownName("algorithm", algorithm, ALGORITHMS)
    return ALGORITHMS[algorithm]


def _run_class(config: RunConfig) -> "type[Run]":
    """The run of an algorithm; torch is not imported before."""
    if isinstance(config, SacConfig):
        from agents.sac_training import SacRun

        return SacRun
    from agents.training import Run

    return Run


def _training_checkpoint(resume: str | Path, env_id: str) -> Checkpoint:
    path = Path(resume)
    checkpoint = load_checkpoint(path / LATEST if path.is_dir() else path, env_id)
    if checkpoint.card.get("kind") != "training":
        raise CheckpointError(f"{checkpoint.path}: expected a training checkpoint, got one for inference only")
    return checkpoint


def _family(checkpoint: Checkpoint) -> str:
    return str(checkpoint.card.get("algorithm", TrainConfig.FAMILY)).partition("-")[0]


def default_folder(env_id: str, config: RunConfig) -> Path:
    """`runs/<id>-<algorithm>-<seed>`."""
    return Path("runs") / f"{env_id.removeprefix(NAMESPACE).replace('/', '-')}-{config.algorithm}-{config.seed}"


def _given_algorithm(argv: list[str]) -> str | None:
    """The algorithm whose options a command line has: the one it names, or that of the run it resumes."""
    parser = Parser(prog="aerograsp train", add_help=False)
    parser.add_argument("--algorithm")
    parser.add_argument("--resume", nargs="?", const="")
    parser.add_argument("--out")
    given, _ = parser.parse_known_args(argv)
    folder = given.resume or given.out
    if given.algorithm is not None or given.resume is None or folder is None:
        return given.algorithm
    path = Path(folder) / LATEST if Path(folder).is_dir() else Path(folder)
    try:
        return _family(load_checkpoint(path))
    except CheckpointError:
        return None  # what is wrong with it is said when it is resumed


def _names_algorithm(argv: list[str], name: str) -> bool:
    """Whether a command line names this algorithm."""
    parser = Parser(prog="aerograsp train", add_help=False)
    parser.add_argument("--algorithm")
    return parser.parse_known_args(argv)[0].algorithm == name


def main(argv: list[str]) -> int:
    """`aerograsp train ID`."""
    if GRASP_PLAN in argv[:1]:
        from agents.grasp_training import main as train_grasps

        return train_grasps(argv)
    if GRASP in argv[:1] and _names_algorithm(argv, "aim"):
        from agents.aim_training import main as train_aim

        return train_aim(argv)
    kind = config_class(_given_algorithm(argv))
    parser = Parser(
        prog="aerograsp train",
        description="Train a policy by PPO or SAC, alone or over an analytic policy.",
        formatter_class=argparse.HelpFormatter,  # the hyper-parameters tell their defaults themselves
    )
    parser.add_argument("id", metavar="ID", help="environment, e.g. aerograsp/Dock-v0")
    parser.add_argument("--out", metavar="FOLDER", help="checkpoints and logs (default: runs/<id>-<algorithm>-<seed>)")
    parser.add_argument(
        "--resume", metavar="PATH", nargs="?", const="", help="go on from a run's folder or checkpoint; alone: --out's"
    )
    parser.add_argument("--overwrite", action="store_true", help="begin anew in a folder that holds a run")
    parser.add_argument(
        "--export", metavar="FILE", help="also write the best policy here, for inference (.safetensors)"
    )
    parser.add_argument(
        "--algorithm",
        metavar="NAME",
        help=f"{' or '.join(ALGORITHMS)}, whose hyper-parameters are listed below with --help (default: ppo, or the "
        f"resumed run's); {GRASP} also learns by aim",
    )
    add_json(parser)
    add_config(parser, f"hyper-parameters of {kind.FAMILY}", kind)
    arguments = parser.parse_args(argv)
    changes = given_options(arguments, kind)
    env_spec(arguments.id)
    resume = arguments.resume
    if resume == "":
        resume = arguments.out or default_folder(arguments.id, kind.from_card({}, **changes))
    try:
        result = train(
            arguments.id,
            algorithm=arguments.algorithm,
            out=arguments.out,
            resume=resume,
            export=arguments.export,
            overwrite=arguments.overwrite,
            progress=True,
            command=["aerograsp", "train", *argv],
            **changes,
        )
    except TrainingInterrupted as interruption:
        print(f"aerograsp train: {interruption}", file=sys.stderr)
        return INTERRUPTED
    if arguments.json != "-":
        best = (
            "" if result.best is None else f", best score {result.best['score']:.6g} after {result.best['steps']} steps"
        )
        print(
            f"{result.steps} steps in {result.wall_time:.1f} s ({result.seconds_per_million_steps:.0f} s per million"
            f"{best}): {result.out}"
        )
    if arguments.json:
        write_json(arguments.json, asdict(result))
    return 0


if __name__ == "__main__":
    sys.exit(guarded("aerograsp train", main, sys.argv[1:]))
