"""One world or many: what the policies of Detect-v0 do with a batch of observations."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Observation = Mapping[str, NDArray[Any]]
State = TypeVar("State")


def rows_of(observation: Observation) -> tuple[list[Observation], bool]:
    """The observations of the single worlds, and whether they came as a batch."""
    if np.ndim(observation["rgb"]) == 3:
        return [observation], False
    return [{name: value[k] for name, value in observation.items()} for k in range(len(observation["rgb"]))], True


def act_by_rows(
    act: Callable[[Observation, State | None], tuple[NDArray[np.float32], State]],
    observation: Observation,
    state: tuple[State | None, ...] | None,
    episode_start: NDArray[np.bool_] | None,
) -> tuple[NDArray[np.float32], tuple[State, ...]]:
    """`Policy.predict` of a policy that acts on one world: `act(observation, state)`, None where an episode begins.

    Returns:
        The action (184,) or (N, 184) float32, and the worlds' next states.
    """
    rows, batched = rows_of(observation)
    before = list(state) if state is not None else [None] * len(rows)
    if episode_start is not None:
        fresh = np.broadcast_to(np.asarray(episode_start, dtype=bool), (len(rows),))
        before = [None if new else old for new, old in zip(fresh, before, strict=True)]
    results = [act(row, old) for row, old in zip(rows, before, strict=True)]
    actions = np.stack([action for action, _ in results])
    return (actions if batched else actions[0]), tuple(new for _, new in results)
