"""One pinned episode, step by step, for plots."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from agents.evaluation import make_worlds
from agents.policies import load_policy
from agents.seeds import TEST_SEED

if TYPE_CHECKING:
    from aerograsp_env.interfaces import Policy


@dataclass(frozen=True)
class Trace:
    """One episode, step by step."""

    policy: str
    time: NDArray[np.float64]  # (T,) [s]
    error: NDArray[np.float64]  # (T,) [m] norm of the position error that the policy observed


def trace(
    env_id: str,
    policy: "Policy | str | Path",
    seed: int = TEST_SEED,
    env_kwargs: Mapping[str, Any] | None = None,
    label: str = "",
) -> Trace:
    """The observed position error over one pinned episode, for plots.

    Raises:
        ValueError: as `evaluate`; or the id has no observation "position_error".
    """
    kwargs = dict(env_kwargs or {})
    actor: Any = load_policy(env_id, policy, kwargs) if isinstance(policy, str | Path) else policy
    env = make_worlds(env_id, 1, kwargs)
    try:
        observation, _ = env.reset(seed=seed)
        if not isinstance(observation, dict) or "position_error" not in observation:
            raise ValueError(f"env_id: {env_id} has no observation 'position_error' to trace")
        dt = float(getattr(env.envs[0].unwrapped, "dt", 1.0))  # type: ignore[attr-defined]
        errors, state, start, done = [], None, np.ones(1, dtype=np.bool_), False
        while not done:
            errors.append(float(np.linalg.norm(observation["position_error"])))
            action, state = actor.predict(observation, state=state, episode_start=start, deterministic=True)
            observation, _, terminated, truncated, _ = env.step(action)
            start, done = np.zeros(1, dtype=np.bool_), bool(terminated[0] or truncated[0])
    finally:
        env.close()
    return Trace(label or str(policy), dt * np.arange(len(errors), dtype=np.float64), np.array(errors))
