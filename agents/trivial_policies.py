"""The policies that need no skill: nothing at all, and chance."""

from typing import Any, NamedTuple

import numpy as np
from gymnasium.spaces import Box, Dict, Space
from numpy.typing import NDArray


def batch_size(observation: Any, space: Space) -> int | None:
    """Number of rows N of a batched observation, None for a single one.

    Raises:
        ValueError: neither one observation of `space` nor a batch of them.
    """
    if isinstance(space, Dict):
        key = next(iter(space.spaces))
        return batch_size(observation[key], space[key])
    shape, expected = np.shape(observation), space.shape or ()
    if shape == expected:
        return None
    if shape[1:] == expected:
        return shape[0]
    raise ValueError(f"observation: expected shape {expected} or (N, *{expected}), got {shape}")


class ZeroPolicy:
    """The null row: always the action 0, clipped into the action space."""

    def __init__(self, action_space: Space, observation_space: Space) -> None:
        space = _bounded(action_space)
        self._observation_space = observation_space
        self._action = np.clip(np.zeros(space.shape, space.dtype), space.low, space.high)

    def predict(
        self,
        observation: Any,
        state: None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray, None]:
        rows = batch_size(observation, self._observation_space)
        return (self._action.copy() if rows is None else np.tile(self._action, (rows, *[1] * self._action.ndim))), None


class RandomState(NamedTuple):
    """Where each row stands in its own random stream."""

    episode: NDArray[np.uint64]  # (N,) number of the row's episode
    step: NDArray[np.uint64]  # (N,) steps taken in it
    episodes: int  # started so far


class RandomPolicy:
    """Uniform actions. Row by row its own counter-based stream (Salmon et al. 2011, Philox), keyed by (seed, episode).

    Episodes are numbered in the order in which they start, rows in order, so that the actions of episode k do not
    depend on how many rows run side by side. All state is in what `predict` returns.
    """

    def __init__(self, action_space: Space, observation_space: Space, seed: int = 0) -> None:
        if seed < 0:
            raise ValueError(f"seed: expected a non-negative integer, got {seed!r}")
        self._space = _bounded(action_space)
        self._observation_space = observation_space
        self._seed = seed

    def predict(
        self,
        observation: Any,
        state: RandomState | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray, RandomState]:
        rows = batch_size(observation, self._observation_space)
        state = self._restart(rows or 1, state, episode_start)
        space = self._space
        actions = np.stack(
            [self._stream(*key).uniform(space.low, space.high) for key in zip(state.episode, state.step, strict=True)]
        ).astype(space.dtype)
        return (actions[0] if rows is None else actions), state._replace(step=state.step + np.uint64(1))

    def _restart(self, rows: int, state: RandomState | None, episode_start: NDArray[np.bool_] | None) -> RandomState:
        if state is None:
            return RandomState(np.arange(rows, dtype=np.uint64), np.zeros(rows, dtype=np.uint64), rows)
        if episode_start is None:
            return state
        starts = np.broadcast_to(np.asarray(episode_start, dtype=bool), (rows,))
        episode = state.episode.copy()
        episode[starts] = np.arange(state.episodes, state.episodes + starts.sum(), dtype=np.uint64)
        return RandomState(episode, np.where(starts, np.uint64(0), state.step), state.episodes + int(starts.sum()))

    def _stream(self, episode: np.uint64, step: np.uint64) -> np.random.Generator:
        # One step owns the 2⁶⁴ blocks that share the upper counter words.
        return np.random.Generator(np.random.Philox(key=[self._seed, int(episode)], counter=[0, int(step), 0, 0]))


def _bounded(space: Space) -> Box:
    if not isinstance(space, Box) or not space.is_bounded():
        raise ValueError(f"action space: expected a bounded Box, got {space}")
    return space
