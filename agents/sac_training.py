"""One training run by soft actor-critic: `agents.training.Run` with a memory."""

import io
import warnings
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from stable_baselines3 import HerReplayBuffer

from agents import sac
from agents.checkpoint import Checkpoint, CheckpointError
from agents.files import write_atomic
from agents.training import Run, world_seed

REPLAY = "replay.npz"
_EPISODES = ("ep_start", "ep_length")  # what a buffer with goals knows of each transition's episode
_ROWS = ("actions", "rewards", "dones", "timeouts")


class SacRun(Run):
    """A run that remembers: the replay buffer is stored beside `latest.safetensors`, and belongs to it."""

    learner: ClassVar[Any] = sac
    flatten: ClassVar[bool] = False

    @property
    def algorithm(self) -> str:
        """ "sac", "sac-her" with goals of hindsight, or "sac-residual"."""
        return "sac-her" if sac.hindsight(self.config, self.learner_env) else self.config.algorithm

    def _restore(self, checkpoint: Checkpoint) -> None:
        super()._restore(checkpoint)
        path = checkpoint.path.parent / REPLAY
        if self.config.replay_saved and path.is_file():
            load_replay(path, self.model.replay_buffer, self.model.num_timesteps)
        else:
            self.say(f"no {REPLAY} beside the checkpoint: new experience is gathered before learning goes on")

    def _save(self) -> None:
        super()._save()
        if self.config.replay_saved:
            save_replay(self.folder / REPLAY, self.model.replay_buffer, self.model.num_timesteps)

    def _restart_worlds(self) -> None:
        super()._restart_worlds()
        self.model._last_original_obs = self.env.get_original_obs()
        self.model.action_space.seed(world_seed(self.config, self.model.num_timesteps))  # of the random first actions
        if isinstance(self.model.replay_buffer, HerReplayBuffer):
            with warnings.catch_warnings():  # that the episodes end here, as meant
                warnings.simplefilter("ignore")
                self.model.replay_buffer.truncate_last_trajectory()


def save_replay(path: Path, replay: Any, steps: int) -> None:
    """Write what a replay buffer holds as .npz: arrays (T, worlds, …), and its position at the run's `steps`."""
    held = replay.size()
    arrays: dict[str, NDArray] = {"state": np.array([steps, replay.pos, replay.full], dtype=np.int64)}
    for name, rows in _arrays(replay).items():
        arrays[name] = rows[:held]
    if isinstance(replay, HerReplayBuffer):
        arrays["current_ep_start"] = replay._current_ep_start
    content = io.BytesIO()
    np.savez(content, **arrays)  # type: ignore[arg-type]
    write_atomic(path, content.getvalue())


def load_replay(path: Path, replay: Any, steps: int) -> None:
    """Fill an empty replay buffer with what `save_replay` wrote; nothing is unpickled.

    Raises:
        CheckpointError: the file is not whole, of another step than the checkpoint, or of another buffer.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            found = {name: file[name] for name in file.files}
        _fill(replay, found, steps)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise CheckpointError(
            f"{path}: expected the replay buffer of this checkpoint ({error}); without the file, a resumed run "
            "gathers new experience"
        ) from None


def _fill(replay: Any, found: Mapping[str, NDArray], steps: int) -> None:
    saved, position, full = (int(value) for value in found["state"])
    if saved != steps:
        raise ValueError(f"it is of step {saved}, not {steps}")
    held = replay.buffer_size if full else position
    for name, rows in _arrays(replay).items():
        if found[name].shape != (held, *rows.shape[1:]):
            raise ValueError(f"{name!r} has shape {found[name].shape} where {(held, *rows.shape[1:])} was expected")
        rows[:held] = found[name]
    replay.pos, replay.full = position, bool(full)
    if isinstance(replay, HerReplayBuffer):
        replay._current_ep_start[:] = found["current_ep_start"]


def _arrays(replay: Any) -> dict[str, NDArray]:
    """The arrays of a buffer by name, all with a row a step."""
    names = (*_ROWS, *(_EPISODES if isinstance(replay, HerReplayBuffer) else ()))
    arrays = {name: getattr(replay, name) for name in names}
    arrays |= {f"observation.{key}": rows for key, rows in replay.observations.items()}
    return arrays | {f"next.{key}": rows for key, rows in replay.next_observations.items()}
