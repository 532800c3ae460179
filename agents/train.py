"""Train a policy by PPO, alone or as a residual over an analytic one; resumable to the bit.

    aerograsp train aerograsp/Dock-v0 --residual pid --env-kwarg wind=gusty --export dock.safetensors

The out folder holds `latest.safetensors` (the whole state of the training), `best.safetensors` (the best policy on the
validation seeds, for inference), a JSON card beside each, `summary.json` and TensorBoard's log. The simulator's state
is not saved: the worlds restart at every periodic checkpoint, in an uninterrupted run too, with seeds drawn from (seed,
steps). A run resumed from a periodic checkpoint is therefore the uninterrupted one, bit for bit, on one machine.
"""

import argparse
import shlex
import signal
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv

from aerograsp_env.wrappers import ResidualActionVector
from agents.arguments import INTERRUPTED, Parser, add_json, guarded, one_line
from agents.checkpoint import Checkpoint, CheckpointError, load_checkpoint, save_checkpoint
from agents.evaluation import evaluate
from agents.files import to_json, writable_folder, write_json
from agents.network_policy import NetworkPolicy, analytic_policy
from agents.policies import NAMESPACE, UnknownName, env_spec
from agents.provenance import provenance
from agents.seeds import TRAIN_SEEDS, VALIDATION_SEED
from agents.train_config import TrainConfig, add_config, given_options

if TYPE_CHECKING:
    from agents.sb3_env import SB3VecEnv

LATEST, BEST = "latest.safetensors", "best.safetensors"


class TrainingInterrupted(KeyboardInterrupt):
    """Ctrl-C, after a checkpoint was written; the message says how to resume."""


@dataclass(frozen=True)
class TrainResult:
    """What a finished training left behind."""

    out: Path
    steps: int
    wall_time: float  # [s], over all resumed parts
    seconds_per_million_steps: float  # [s], this part, evaluations left out
    best: dict[str, Any] | None  # the curve's best row; None if never evaluated
    curve: list[dict[str, Any]]


def train(
    env_id: str,
    config: TrainConfig | None = None,
    *,
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
        config: the hyper-parameters; with `resume`, the checkpoint's if None.
        out: folder for checkpoints and logs; `runs/<id>-<ppo or ppo-residual>-<seed>` by default.
        resume: a training checkpoint, or the folder of one, to go on from; its folder is the default `out`.
        export: also write the best policy (the latest, if never evaluated) here, for inference.
        overwrite: begin anew in a folder that holds a run.
        progress: a bar on standard error, and a line an evaluation.
        command: what to record as the command in the cards.
        **changes: fields of `TrainConfig` that override `config`'s.

    Raises:
        ValueError: a user's mistake: unknown id, option or policy, a number out of range, a checkpoint that does not
            fit, a folder that holds another run.
        OSError: a folder cannot be written.
        TrainingInterrupted: after Ctrl-C, with a new whole checkpoint on disk.
    """
    env_spec(env_id)
    checkpoint = None
    if resume is not None:
        path = Path(resume)
        checkpoint = load_checkpoint(path / LATEST if path.is_dir() else path, env_id)
        if checkpoint.card.get("kind") != "training":
            raise CheckpointError(f"{checkpoint.path}: expected a training checkpoint, got one for inference only")
        out = out if out is not None else checkpoint.path.parent
    try:
        if config is None:
            config = TrainConfig.from_card(checkpoint.card["training"]["config"] if checkpoint else {}, **changes)
        elif changes:
            config = TrainConfig.from_card(config.to_card(), **changes)
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
    with _Run(env_id, config, folder, checkpoint, progress, list(command or [])) as run:
        return run.train(Path(export) if export is not None else None)


def default_folder(env_id: str, config: TrainConfig) -> Path:
    """`runs/<id>-<algorithm>-<seed>`."""
    return Path("runs") / f"{env_id.removeprefix(NAMESPACE).replace('/', '-')}-{_algorithm(config)}-{config.seed}"


def make_learner_env(env_id: str, config: TrainConfig) -> "SB3VecEnv":
    """The id's worlds as Stable-Baselines3 takes them, with the residual's base policy inside.

    Raises:
        ValueError: the environment does not take these options, or has no such keys or policy.
    """
    from agents.sb3_env import SB3VecEnv

    base = None if config.residual is None else analytic_policy(env_id, config.residual)
    venv = _make_worlds(env_id, config)
    try:
        if base is not None:
            venv = ResidualActionVector(venv, base, config.residual_scale)
        return SB3VecEnv(venv, keys=config.keys or tuple(getattr(venv.single_observation_space, "spaces", ())))
    except ValueError:
        venv.close()
        raise


def _make_worlds(env_id: str, config: TrainConfig) -> VectorEnv:
    native = env_spec(env_id).vector_entry_point is not None
    mode = AutoresetMode.SAME_STEP
    # Gymnasium passes `vector_kwargs` on to its own vector environments only; a native one takes plain options.
    options: dict[str, Any] = {"autoreset_mode": mode} if native else {"vector_kwargs": {"autoreset_mode": mode}}
    try:
        return gymnasium.make_vec(
            env_id,
            num_envs=config.num_envs,
            vectorization_mode="vector_entry_point" if native else "sync",
            **options,
            **config.env_kwargs,
        )
    except TypeError as error:
        if "unexpected keyword argument" not in str(error):
            raise
        raise ValueError(
            f"env_kwargs: {env_id} does not take {sorted(config.env_kwargs)}: {one_line(error)}"
        ) from error


def world_seed(config: TrainConfig, steps: int) -> int:
    """The seed of world 0 after `steps`; world i's is i more, all within the training seeds."""
    draw = int(np.random.SeedSequence([config.seed, steps]).generate_state(1)[0])
    return TRAIN_SEEDS.start + draw % (len(TRAIN_SEEDS) - config.num_envs)


def _algorithm(config: TrainConfig) -> str:
    return "ppo" if config.residual is None else "ppo-residual"


class _Run:
    """One training from its start, or its checkpoint, to its end; a context manager that closes the worlds."""

    def __init__(
        self,
        env_id: str,
        config: TrainConfig,
        folder: Path,
        checkpoint: Checkpoint | None,
        progress: bool,
        command: list[str],
    ) -> None:
        import torch
        from stable_baselines3.common.logger import configure

        from agents import ppo

        self.env_id, self.config, self.folder, self.command = env_id, config, folder, command
        self.learner_env = make_learner_env(env_id, config)
        self._threads = torch.get_num_threads()
        torch.set_num_threads(config.threads)
        try:
            self.model, self.env = ppo.build(config, self.learner_env)
            self.layout = ppo.layout(config, self.learner_env)
            history: dict[str, Any] = {}
            if checkpoint is not None:
                try:
                    ppo.restore(self.model, self.env, checkpoint.tensors)
                except CheckpointError as error:
                    raise CheckpointError(f"{checkpoint.path}: {error}") from None
                history = checkpoint.card["training"]
            self.start_steps = self.model.num_timesteps
            if self.start_steps >= config.steps:
                raise ValueError(
                    f"steps: expected more than the {self.start_steps} the checkpoint has already, got {config.steps}"
                )
            self.curve: list[dict[str, Any]] = list(history.get("curve", []))
            self.best: dict[str, Any] | None = history.get("best")
            self.earlier = float(history.get("wall_time", 0.0))
            self.began = time.perf_counter()
            self.evaluating = 0.0  # [s] spent in evaluations
            self.evaluated = self.saved = self.start_steps
            self.stopping = False
            self.deferring = False
            self.progress = progress
            self.model.set_logger(configure(str(folder / "tensorboard"), ["tensorboard"]))
            self._restart_worlds()
        except BaseException:
            self.__exit__()
            raise

    def __enter__(self) -> "_Run":
        return self

    def __exit__(self, *_: object) -> None:
        import torch

        self.learner_env.close()
        if hasattr(self, "model") and hasattr(self.model, "_logger"):
            self.model.logger.close()
        torch.set_num_threads(self._threads)

    def train(self, export: Path | None) -> TrainResult:
        """Learn until `config.steps`, then evaluate, save and export."""
        try:
            with _deferred_interrupt(self):
                self.model.learn(
                    self.config.steps - self.start_steps, callback=_callback(self), reset_num_timesteps=False
                )
            if self.stopping:
                raise KeyboardInterrupt
            if self.config.eval_episodes and (not self.curve or self.curve[-1]["steps"] != self.model.num_timesteps):
                self._evaluate()
        except KeyboardInterrupt:
            self._save()
            raise TrainingInterrupted(
                f"interrupted after {self.model.num_timesteps} steps; resume with: "
                f"aerograsp train {self.env_id} --resume {shlex.quote(str(self.folder))}"
            ) from None
        self._save()
        if export is not None:
            self._export(export)
        steps = self.model.num_timesteps
        learning = time.perf_counter() - self.began - self.evaluating
        result = TrainResult(
            self.folder,
            steps,
            self._wall_time(),
            learning / (steps - self.start_steps) * 1e6,
            self.best,
            self.curve,
        )
        write_json(self.folder / "summary.json", asdict(result))
        return result

    def boundary(self) -> None:
        """Between an update and the next rollout: evaluate and save when due."""
        steps = self.model.num_timesteps
        every = self.config.eval_every
        if self.config.eval_episodes and steps // every > self.evaluated // every:
            self._evaluate()
        every = self.config.checkpoint_every
        if steps // every > self.saved // every:
            self._save()
            self._restart_worlds()

    def _restart_worlds(self) -> None:
        """Begin new episodes, as a resumed run must: the rollout before is complete, its last value bootstrapped."""
        self.env.seed(world_seed(self.config, self.model.num_timesteps))
        self.model._last_obs = self.env.reset()
        self.model._last_episode_starts = np.ones(self.config.num_envs, dtype=bool)

    def _evaluate(self) -> None:
        from agents import ppo

        began = time.perf_counter()
        tensors = ppo.actor_tensors(self.model, self.env)
        base = None if self.config.residual is None else analytic_policy(self.env_id, self.config.residual)
        policy = NetworkPolicy(self.layout, tensors, base=base, scale=self.config.residual_scale)
        with _immediate_interrupt(self):
            result = evaluate(self.env_id, policy, self.config.eval_episodes, VALIDATION_SEED, self.config.env_kwargs)
        names = {"return": "returns", "success": "success"}
        name = names.get(self.config.metric, self.config.metric)
        if name not in result.names:
            raise UnknownName("metric", self.config.metric, [*names, *result.metrics])
        values = result.values(name)
        crashes = result.metrics.get("crash", np.zeros(result.episodes))
        # An episode that ended before its metric was defined (NaN) counts with the penalty alone.
        score = float(np.mean(np.nan_to_num(values if name not in names.values() else -values)))
        score += self.config.crash_penalty * float(np.mean(np.nan_to_num(crashes)))
        self.evaluated = self.model.num_timesteps
        row = {
            "steps": self.evaluated,
            "wall_time": round(self._wall_time(), 3),
            "score": score,
            "return": result.mean("returns"),
            "length": result.mean("lengths"),
            "success": result.mean("success"),
            "metrics": {key: result.mean(key) for key in result.metrics},
        }
        row = to_json(row)
        self.curve.append(row)
        if self.best is None or score < self.best["score"]:
            self.best = row
            save_checkpoint(self.folder / BEST, tensors, self._card("policy"))
        for key in ("score", "return", "success"):
            self.model.logger.record(f"eval/{key}", row[key])
        self.evaluating += time.perf_counter() - began
        self.say(f"{self.evaluated} steps: score {score:.6g}, success {row['success']:.2f}, return {row['return']:.6g}")

    def _save(self) -> None:
        from agents import ppo

        save_checkpoint(self.folder / LATEST, ppo.training_tensors(self.model, self.env), self._card("training"))
        self.saved = self.model.num_timesteps

    def _export(self, path: Path) -> None:
        from agents import ppo

        best = self.folder / BEST
        card, tensors = self._card("policy"), ppo.actor_tensors(self.model, self.env)
        if self.best is not None and best.exists():
            found = load_checkpoint(best, self.env_id)
            if found.network == self.layout:
                tensors = found.tensors
                card["steps"] = self.best["steps"]
        save_checkpoint(path, tensors, card)

    def _card(self, kind: str) -> dict[str, Any]:
        config = self.config
        residual = {"env_id": self.env_id, "name": config.residual, "scale": config.residual_scale}
        error = (self.best or {}).get("metrics", {}).get("error")
        card = {
            "kind": kind,
            "env_id": self.env_id,
            "env_kwargs": dict(config.env_kwargs),
            "algorithm": _algorithm(config),
            "steps": self.model.num_timesteps,
            "validation_error": error,  # [m], the best row's
            "network": asdict(self.layout),
            "base": None if config.residual is None else residual,
            "training": {
                "command": self.command,
                "seed": config.seed,
                "provenance": provenance(self.command),
                "steps": self.model.num_timesteps,
                "wall_time": self._wall_time(),
                "best": self.best,
                "curve": self.curve,
                "config": config.to_card(),
            },
        }
        return to_json(card)

    def _wall_time(self) -> float:
        return self.earlier + time.perf_counter() - self.began

    def say(self, line: str) -> None:
        """One line on standard error that leaves the progress bar whole."""
        if self.progress:
            from tqdm import tqdm

            tqdm.write(line, file=sys.stderr)


def _callback(run: _Run) -> Any:
    from stable_baselines3.common.callbacks import BaseCallback
    from tqdm import tqdm

    class Callback(BaseCallback):
        def _on_training_start(self) -> None:
            disable = None if run.progress else True  # None: shown on a terminal only
            self.bar = tqdm(
                total=run.config.steps, initial=run.start_steps, unit="step", unit_scale=True, disable=disable
            )

        def _on_rollout_start(self) -> None:
            if not run.stopping:
                run.boundary()

        def _on_step(self) -> bool:
            self.bar.update(run.config.num_envs)
            return not run.stopping

        def _on_training_end(self) -> None:
            self.bar.close()

    return Callback()


@contextmanager
def _deferred_interrupt(run: _Run) -> Iterator[None]:
    """While learning, the first Ctrl-C waits for the step or update it met, so that the saved state is consistent."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def handler(signum: int, frame: Any) -> None:
        if run.stopping or not run.deferring:
            raise KeyboardInterrupt
        run.stopping = True
        run.say("stopping after this update (Ctrl-C again: at once)")

    previous = signal.signal(signal.SIGINT, handler)
    run.deferring = True
    try:
        yield
    finally:
        run.deferring = False
        signal.signal(signal.SIGINT, previous)


@contextmanager
def _immediate_interrupt(run: _Run) -> Iterator[None]:
    """Within it, nothing that is saved changes, so Ctrl-C need not wait."""
    deferring, run.deferring = run.deferring, False
    try:
        yield
    finally:
        run.deferring = deferring


def main(argv: list[str]) -> int:
    """`aerograsp train ID`."""
    parser = Parser(
        prog="aerograsp train",
        description="Train a policy by PPO, alone or over an analytic policy.",
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
    add_json(parser)
    add_config(parser, "hyper-parameters")
    arguments = parser.parse_args(argv)
    changes = given_options(arguments)
    env_spec(arguments.id)
    resume = arguments.resume
    if resume == "":
        resume = arguments.out or default_folder(arguments.id, TrainConfig.from_card({}, **changes))
    try:
        result = train(
            arguments.id,
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
