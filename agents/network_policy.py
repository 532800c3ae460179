"""A trained actor in NumPy: inference without torch.

The actor is the multi-layer perceptron that `agents.train` writes. Alone, its output is the action; a residual policy
adds it to an analytic base policy's (Johannink et al. 2019, "Residual Reinforcement Learning for Robot Control"; Silver
et al. 2018, "Residual Policy Learning"): action = clip(base + scale · clip(net, −1, 1), −1, 1). The output of a
soft actor-critic is squashed by tanh instead of clipped (Haarnoja et al. 2018).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from aerograsp_env.wrappers import BASE_ACTION
from agents.checkpoint import NetworkLayout, load_checkpoint
from agents.derived_inputs import DERIVED, GOALS, STEP, derive
from agents.policies import UnknownName, load_policy, registered_policies

LOG_STD_BOUNDS = (-20.0, 2.0)  # of a squashed actor, Stable-Baselines3's


class Memory(NamedTuple):
    """The state of a policy that reads how the goal moves."""

    goal: NDArray | None = None  # desired_goal of the last call, (size,) or (N, size)
    base: Any = None  # the base policy's state


class NetworkPolicy:
    """A perceptron over keys of the observation, or derived ones, with the signature of every policy here.

    Args:
        layout: what the network reads and how it is wired; see `agents.derived_inputs` for derived keys.
        tensors: the arrays `layout.shapes()` lists (others are ignored).
        base: the analytic policy a residual one corrects; required exactly when the layout's last key is "base_action".
        scale: what the network's output is multiplied by before it is added to the base action.
        seed: of the generator that `deterministic=False` draws from.
        dtype: float64 or float32, what the network is computed in.
    """

    def __init__(
        self,
        layout: NetworkLayout,
        tensors: Mapping[str, NDArray],
        *,
        base: Any | None = None,
        scale: float = 1.0,
        seed: int | None = None,
        dtype: DTypeLike = np.float64,
    ) -> None:
        self.dtype = np.dtype(dtype)
        if self.dtype not in (np.dtype(np.float64), np.dtype(np.float32)):
            raise ValueError(f"dtype: expected float64 or float32, got {self.dtype}")
        residual = layout.keys[-1] == BASE_ACTION
        if residual != (base is not None):
            raise ValueError(
                f"base: expected {'a policy' if residual else 'None'} for keys {layout.keys}, got {base!r}"
            )
        for name, shape in layout.shapes().items():
            found = tensors[name].shape if name in tensors else None
            if found != shape:
                raise ValueError(f"tensors: expected {name!r} of shape {shape}, got {found}")
        self.layout = layout
        self.base = base
        self.scale = float(scale)
        self._keys = layout.keys[:-1] if residual else layout.keys
        self._remembers = STEP in self._keys
        self._weights = [self._cast(tensors[f"actor.{k}.weight"]).T.copy() for k in range(layout.layers)]
        self._biases = [self._cast(tensors[f"actor.{k}.bias"]) for k in range(layout.layers)]
        self._mean = self._cast(tensors["observation.mean"])
        self._inverse_std = self._cast(1.0 / np.sqrt(tensors["observation.var"].astype(np.float64) + layout.epsilon))
        names = ("log_std.weight", "log_std.bias") if layout.squash else ("log_std",)
        self._log_std = [self._cast(tensors[name]) for name in names]
        self._rng = np.random.default_rng(seed)

    def predict(
        self,
        observation: Mapping[str, NDArray],
        state: Any = None,
        episode_start: NDArray | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray, Any]:
        """The action for one observation or a batch.

        Args:
            observation: key -> (size,) or (N, size).
            state: what the last call returned: the base policy's state, in a `Memory` if the network reads "goal_step";
                None in an episode's first call.
            episode_start: None or (N,) bool, true where an episode begins.
            deterministic: the mean action, else one drawn with the trained standard deviation.

        Returns:
            action: (actions,) or (N, actions) float32 in [−1, 1], and the state for the next call.

        Raises:
            ValueError: a key is missing or of the wrong length.
        """
        remembered = None
        if self._remembers:
            remembered, state = Memory() if state is None else state
        parts = [
            self._part(observation, key, size, remembered, episode_start)
            for key, size in zip(self._keys, self.layout.sizes, strict=False)
        ]
        base_action = None
        if self.base is not None:
            base_action, state = self.base.predict(observation, state, episode_start, True)
            base_action = np.clip(self._cast(base_action), -1.0, 1.0)
            parts.append(base_action)
        # NumPy refuses to concatenate (N, a) with (b,), so a mixture of batched and single arrays cannot pass unseen.
        x = (np.concatenate(parts, axis=-1) - self._mean) * self._inverse_std
        x = np.clip(x, -self.layout.clip, self.layout.clip)
        for weight, bias in zip(self._weights[:-1], self._biases[:-1], strict=True):
            x = x @ weight + bias
            x = np.tanh(x) if self.layout.activation == "tanh" else np.maximum(x, 0.0)
        action = x @ self._weights[-1] + self._biases[-1]
        if not deterministic:
            action = action + self._std(x) * self._rng.standard_normal(action.shape).astype(self.dtype)
        action = np.tanh(action) if self.layout.squash else np.clip(action, -1.0, 1.0)
        if base_action is not None:
            action = np.clip(base_action + self.scale * action, -1.0, 1.0)
        if self._remembers:
            state = Memory(np.array(observation[GOALS[1]], dtype=self.dtype), state)
        return action.astype(np.float32), state

    def _std(self, features: NDArray) -> NDArray:
        """The deviation of an action, before the squashing if there is one."""
        if not self.layout.squash:
            return np.exp(self._log_std[0])
        weight, bias = self._log_std
        return np.exp(np.clip(features @ weight.T + bias, *LOG_STD_BOUNDS))

    def _part(
        self,
        observation: Mapping[str, NDArray],
        key: str,
        size: int,
        remembered: NDArray | None = None,
        episode_start: NDArray | None = None,
    ) -> NDArray:
        """The value of a key; `remembered` is the goal that the last call saw."""
        if key in DERIVED:
            achieved, desired = (self._part(observation, goal, size) for goal in GOALS)
            before = desired if remembered is None else remembered
            if episode_start is not None:
                before = np.where(np.reshape(episode_start, (*desired.shape[:-1], 1)), desired, before)
            return derive(key, achieved, desired, before)
        if key not in observation:
            raise ValueError(f"observation: expected the key {key!r}, got {', '.join(map(str, observation))}")
        value = self._cast(observation[key])
        if value.ndim not in (1, 2) or value.shape[-1] != size:
            raise ValueError(f"observation[{key!r}]: expected shape ({size},) or (N, {size}), got {value.shape}")
        return value

    def _cast(self, value: Any) -> NDArray:
        return np.asarray(value, dtype=self.dtype)


def analytic_policy(env_id: str, name: str) -> Any:
    """Build the analytic policy registered under `name` for `env_id`.

    Raises:
        UnknownName: no such policy; the message has the names there are.
    """
    names = registered_policies(env_id)
    if name not in names:
        raise UnknownName(f"analytic policy of {env_id}", name, names)
    return load_policy(env_id, name)


def load_network_policy(
    path: str | Path, env_id: str | None = None, *, seed: int | None = None, dtype: DTypeLike = np.float64
) -> NetworkPolicy:
    """Load a policy from any checkpoint `agents.train` wrote (`best`, `latest` or exported).

    A residual policy's base is looked up by the name on the card among the registered analytic policies only, so that a
    file cannot name code to run.

    Raises:
        CheckpointError: not a whole checkpoint, or for another environment than `env_id`.
        UnknownName: the base policy is not registered.
    """
    checkpoint = load_checkpoint(path, env_id)
    base_card = checkpoint.card.get("base")
    base = analytic_policy(base_card["env_id"], base_card["name"]) if base_card else None
    scale = float(base_card["scale"]) if base_card else 1.0
    return NetworkPolicy(checkpoint.network, checkpoint.tensors, base=base, scale=scale, seed=seed, dtype=dtype)
