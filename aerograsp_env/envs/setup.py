"""What one world's environment and a batch of worlds need to know of a task."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim.actions import ActionDimension


class Batch(Protocol):
    """`n` worlds as environments use them; results are rows of arrays that the next call overwrites."""

    models: list[Any]  # MjModel of each
    datas: list[Any]  # MjData of each
    observations: NDArray[np.float32]  # (n, D)
    terms: NDArray[np.float64]  # (n, terms)
    metrics: NDArray[np.float64]  # (n, metrics)
    flags: NDArray[np.bool_]  # (n, 2 or more) = (success, terminated, …)
    states: NDArray[Any]  # (n,) records with `step` and `termination`
    active: NDArray[np.bool_]  # (n,) worlds that `step` advances

    @property
    def action_size(self) -> int: ...
    def reset(self, index: int, rng: np.random.Generator, options: dict[str, Any]) -> None: ...
    def step(self, actions: NDArray[np.float64], rngs: list[np.random.Generator]) -> None: ...
    def close(self) -> None: ...


class Setup(NamedTuple):
    """What a task makes of the options: its worlds, and how to read their results."""

    config: Any
    worlds: Batch
    observation: tuple[tuple[str, int, float], ...]  # name, size, bound: parts of an observation row
    action_layout: tuple[ActionDimension, ...]
    terms: tuple[tuple[str, int], ...]  # name and column of those that make up the reward
    metrics: tuple[str, ...]
    always_reported: tuple[str, ...]  # metrics that mean something before errors count
    counted: NDArray[Any]  # (n,) view of the worlds' results: not zero where they do
    check_options: Callable[[dict[str, Any] | None], dict[str, Any]]  # of reset
