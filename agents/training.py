"""One training run: learning, evaluating, saving and stopping."""

import shlex
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import configure
from tqdm import tqdm

from agents import ppo
from agents.checkpoint import Checkpoint, CheckpointError, load_checkpoint, save_checkpoint
from agents.evaluation import evaluate
from agents.files import to_json, write_json
from agents.network_policy import NetworkPolicy, analytic_policy
from agents.policies import UnknownName
from agents.provenance import provenance
from agents.sb3_env import make_learner_env
from agents.seeds import TRAIN_SEEDS, VALIDATION_SEED
from agents.train_config import AUTO, BEST, LATEST, RunConfig, TrainingInterrupted, TrainResult


def world_seed(config: RunConfig, steps: int) -> int:
    """The seed of world 0 after `steps`; world i's is i more, all within the training seeds."""
    draw = int(np.random.SeedSequence([config.seed, steps]).generate_state(1)[0])
    return TRAIN_SEEDS.start + draw % (len(TRAIN_SEEDS) - config.num_envs)


class Run:
    """One training from its start, or its checkpoint, to its end; a context manager that closes the worlds.

    By PPO; other algorithms derive from it, with a `learner` module that has the same functions as `agents.ppo`.
    """

    learner: ClassVar[Any] = ppo
    flatten: ClassVar[bool] = True  # whether the learner takes flat observations

    def __init__(
        self,
        env_id: str,
        config: Any,  # of the learner's class
        folder: Path,
        checkpoint: Checkpoint | None,
        progress: bool,
        command: list[str],
    ) -> None:
        self.env_id, self.config, self.folder, self.command = env_id, config, folder, command
        self.provenance = provenance(shlex.join(command))  # now: the checkout may change while this runs
        self.progress = progress
        self.learner_env = make_learner_env(env_id, config, self.flatten)
        self._threads = torch.get_num_threads()
        torch.set_num_threads(config.threads)
        try:
            self.model, self.env = self.learner.build(config, self.learner_env)
            self.layout = self.learner.layout(config, self.learner_env)
            history: dict[str, Any] = {}
            if checkpoint is not None:
                self._restore(checkpoint)
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
            self.model.set_logger(configure(str(folder / "tensorboard"), ["tensorboard"]))
            self._restart_worlds()
        except BaseException:
            self.__exit__()
            raise

    def __enter__(self) -> "Run":
        return self

    def __exit__(self, *_: object) -> None:
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

    @property
    def algorithm(self) -> str:
        """What the card calls it."""
        return self.config.algorithm

    def _restore(self, checkpoint: Checkpoint) -> None:
        try:
            self.learner.restore(self.model, self.env, checkpoint.tensors)
        except CheckpointError as error:
            raise CheckpointError(f"{checkpoint.path}: {error}") from None

    def _restart_worlds(self) -> None:
        """Begin new episodes, as a resumed run must: the rollout before is complete, its last value bootstrapped."""
        self.env.seed(world_seed(self.config, self.model.num_timesteps))
        self.model._last_obs = self.env.reset()
        self.model._last_episode_starts = np.ones(self.config.num_envs, dtype=bool)

    def _evaluate(self) -> None:
        began = time.perf_counter()
        tensors = self.learner.actor_tensors(self.model, self.env)
        base = None if self.config.residual is None else analytic_policy(self.env_id, self.config.residual)
        policy = NetworkPolicy(self.layout, tensors, base=base, scale=self.config.residual_scale)
        with _immediate_interrupt(self):
            result = evaluate(self.env_id, policy, self.config.eval_episodes, VALIDATION_SEED, self.config.env_kwargs)
        names = {"return": "returns", "success": "success"}
        metric = self.config.metric
        if metric == AUTO:
            metric = "error" if "error" in result.metrics else "success"
        name = names.get(metric, metric)
        if name not in result.names:
            raise UnknownName("metric", metric, [AUTO, *names, *result.metrics])
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
        save_checkpoint(
            self.folder / LATEST, self.learner.training_tensors(self.model, self.env), self._card("training")
        )
        self.saved = self.model.num_timesteps

    def _export(self, path: Path) -> None:
        best = self.folder / BEST
        card, tensors = self._card("policy"), self.learner.actor_tensors(self.model, self.env)
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
            "algorithm": self.algorithm,
            "steps": self.model.num_timesteps,
            "validation_error": error,  # [m], the best row's
            "validation_score": (self.best or {}).get("score"),  # lower is better
            "network": asdict(self.layout),
            "base": None if config.residual is None else residual,
            "training": {
                "command": self.command,
                "seed": config.seed,
                "provenance": self.provenance,
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
            tqdm.write(line, file=sys.stderr)


def _callback(run: Run) -> Any:
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
def _deferred_interrupt(run: Run) -> Iterator[None]:
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
def _immediate_interrupt(run: Run) -> Iterator[None]:
    """Within it, nothing that is saved changes, so Ctrl-C need not wait."""
    deferring, run.deferring = run.deferring, False
    try:
        yield
    finally:
        run.deferring = deferring
