"""Gymnasium's batched environments as Stable-Baselines3 knows them.

The two vector interfaces differ: Gymnasium returns terminations, truncations and one dict of arrays; Stable-Baselines3
wants resets within the step, `dones`, and a list of dicts with `terminal_observation`, `TimeLimit.truncated` and
`episode`. Only finished worlds are looped over.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices

from aerograsp_env.wrappers import BASE_ACTION, ResidualActionVector
from agents.arguments import one_line
from agents.checkpoint import NetworkLayout
from agents.derived_inputs import DERIVED, GOALS, derive, derived_boxes
from agents.network_policy import analytic_policy
from agents.policies import env_spec
from agents.train_config import UNREAD, RunConfig

Observation = dict[str, NDArray]


class SB3VecEnv(VecEnv):
    """A `gymnasium.vector.VectorEnv` with Dict observations of vectors, behind Stable-Baselines3's `VecEnv`.

    A residual policy's base goes around `venv`: `SB3VecEnv(ResidualActionVector(venv, policy, scale))`.

    Args:
        venv: the batched environment; its autoreset mode is SAME_STEP, or one whose `reset` takes
            `options={"reset_mask": (N,) bool}` (Gymnasium's convention), which is then used to reset within the step.
        keys: observation keys to concatenate, in this order, into one flat float32 vector; None keeps the Dict, with
            its own keys. Those of `agents.derived_inputs` can be named too. A residual's "base_action" is always read,
            and always last.
        flatten: False keeps a Dict of `keys`, in their order.

    Raises:
        ValueError: the spaces are not as described, or a key is unknown.
    """

    def __init__(self, venv: VectorEnv, keys: Sequence[str] | None = None, flatten: bool = True) -> None:
        single, action = venv.single_observation_space, venv.single_action_space
        if not isinstance(single, spaces.Dict):
            raise ValueError(f"venv: expected a Dict observation space, got {single}")
        if not isinstance(action, spaces.Box) or not (np.all(action.low == -1) and np.all(action.high == 1)):
            raise ValueError(f"venv: expected an action space Box(-1, 1), got {action}")
        self.venv = venv
        boxes = {**single.spaces, **derived_boxes(single.spaces)}
        self.keys = _checked_keys(single.spaces if keys is None else keys, boxes)
        self.sizes = {key: int(np.prod(boxes[key].shape or ())) for key in self.keys}
        self._derived = [key for key in self.keys if key in DERIVED]
        self._goal: NDArray = np.zeros(())  # wanted in the observation before, if anything is derived
        self._flat = keys is not None and flatten
        # A sequence keeps its order, in which Stable-Baselines3 concatenates the parts; a mapping would be sorted.
        observation_space: spaces.Space = spaces.Dict([(key, boxes[key]) for key in self.keys])
        if self._flat:
            low, high = (np.concatenate([getattr(boxes[key], side) for key in self.keys]) for side in ("low", "high"))
            observation_space = spaces.Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)
        super().__init__(venv.num_envs, observation_space, action)
        self._same_step = venv.metadata.get("autoreset_mode") == AutoresetMode.SAME_STEP
        self._actions: NDArray = np.zeros((self.num_envs, *action.shape), np.float32)
        self._returns = np.zeros(self.num_envs)
        self._lengths = np.zeros(self.num_envs, dtype=np.int64)
        self._start = time.monotonic()

    def reset(self) -> NDArray | Observation:
        """Start an episode in every world, world i with the i-th seed given to `seed()` if it was called."""
        observation, _ = self.venv.reset(seed=self._seeds[0])
        self._reset_seeds()
        self._reset_options()
        self._returns[:] = 0.0
        self._lengths[:] = 0
        return self._to_learner(observation, np.ones(self.num_envs, dtype=bool))

    def step_async(self, actions: NDArray) -> None:
        self._actions = actions

    def step_wait(self) -> tuple[NDArray | Observation, NDArray, NDArray, list[dict[str, Any]]]:
        observation, reward, terminated, truncated, info = self.venv.step(self._actions)
        dones = np.logical_or(terminated, truncated)
        self._returns += reward
        self._lengths += 1
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if dones.any():
            final, final_info, observation = self._split_final(observation, info, dones)
            before = self._goal
            rows = self._to_learner(final, np.zeros(self.num_envs, dtype=bool))
            self._goal = before
            for i in np.flatnonzero(dones):
                infos[i] = {
                    "terminal_observation": {k: v[i] for k, v in rows.items()} if isinstance(rows, dict) else rows[i],
                    "TimeLimit.truncated": bool(truncated[i] and not terminated[i]),
                    "episode": {
                        "r": float(self._returns[i]),
                        "l": int(self._lengths[i]),
                        "t": round(time.monotonic() - self._start, 6),
                    },
                }
                if "success" in final_info:
                    infos[i]["is_success"] = bool(final_info["success"][i])
            self._returns[dones] = 0.0
            self._lengths[dones] = 0
        return self._to_learner(observation, dones), np.asarray(reward, np.float32), dones, infos

    def _split_final(
        self, observation: Any, info: Mapping[str, Any], dones: NDArray
    ) -> tuple[Observation, Mapping[str, Any], Any]:
        """The finished worlds' last observation (others: the current one) and info; every world's next observation."""
        # Environments may reuse their buffers: the last observations are copied before a reset overwrites them.
        final = {key: np.array(value) for key, value in observation.items()}
        if not self._same_step:
            fresh, _ = self.venv.reset(options={"reset_mask": dones})
            return final, info, fresh
        for i in np.flatnonzero(dones):
            for key, rows in final.items():
                rows[i] = info["final_obs"][i][key]
        return final, info.get("final_info", info), observation

    def _to_learner(self, observation: Any, begins: NDArray) -> NDArray | Observation:
        """The worlds' observations as the learner reads them; `begins` (N,), true for an episode's first one."""
        if self._derived:
            achieved, desired = (np.array(observation[key], np.float32) for key in GOALS)
            before = np.where(begins[:, None], desired, self._goal)
            self._goal = desired
            observation = {**observation, **{key: derive(key, achieved, desired, before) for key in self._derived}}
        if not self._flat:  # copied: the learner keeps this observation while the next step overwrites the buffers
            return {key: np.array(observation[key], np.float32) for key in self.keys}
        return np.concatenate([observation[key] for key in self.keys], axis=1).astype(np.float32, copy=False)

    def close(self) -> None:
        self.venv.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        return [getattr(self.venv, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        if indices is not None:
            raise ValueError("indices: an attribute of a batched environment belongs to all its worlds; expected None")
        setattr(self.venv, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any) -> list[Any]:
        result = getattr(_owner(self.venv, method_name), method_name)(*args, **kwargs)
        return [result] * len(list(self._get_indices(indices)))

    def env_is_wrapped(self, wrapper_class: Any, indices: VecEnvIndices = None) -> list[bool]:
        return [False] * len(list(self._get_indices(indices)))


def _checked_keys(keys: Iterable[str], boxes: Mapping[str, spaces.Space]) -> tuple[str, ...]:
    """`keys`, and the base action last if there is one. ValueError where a key is unknown, repeated or not a vector."""
    names = tuple(key for key in keys if key != BASE_ACTION)
    if not names or len(set(names)) != len(names):
        raise ValueError(f"keys: expected at least one key and none twice, got {', '.join(names) or 'none'}")
    if BASE_ACTION in boxes:
        names += (BASE_ACTION,)
    for key in names:
        if key not in boxes:
            raise ValueError(f"keys: {key!r} is not in the observation; there are: {', '.join(boxes)}")
        if not isinstance(box := boxes[key], spaces.Box) or len(box.shape) != 1:
            raise ValueError(f"keys: {key!r} is not a vector but {box}")
    return names


def _owner(venv: VectorEnv, name: str) -> Any:
    """What has the attribute: the batch with its wrappers or without, or else its first world, which is like all."""
    for owner in (venv, venv.unwrapped):
        if hasattr(owner, name):
            return owner
    return venv.unwrapped.envs[0].unwrapped if isinstance(venv.unwrapped, SyncVectorEnv) else venv.unwrapped


def has_goals(env: SB3VecEnv) -> bool:
    """Whether these are goal environments (gymnasium-robotics' interface), whose experience serves other goals too."""
    return set(GOALS) <= set(env.sizes) and hasattr(_owner(env.venv, "compute_reward"), "compute_reward")


def actor_layout(config: RunConfig, env: SB3VecEnv, squash: bool) -> NetworkLayout:
    """The layout of an actor that acts in this environment."""
    return NetworkLayout(
        keys=env.keys,
        sizes=tuple(env.sizes[key] for key in env.keys),
        actions=int(np.prod(env.action_space.shape or ())),
        hidden=config.hidden,
        activation=config.activation,
        clip=config.clip_observation,
        squash=squash,
    )


def make_learner_env(env_id: str, config: RunConfig, flatten: bool = True) -> SB3VecEnv:
    """The id's worlds as Stable-Baselines3 takes them, with the residual's base policy inside.

    The learner sees `config.keys`, flat or as a Dict; the base policy sees every key.

    Raises:
        ValueError: the environment does not take these options, or has no such keys or policy.
    """
    base = None if config.residual is None else analytic_policy(env_id, config.residual)
    venv = _make_worlds(env_id, config)
    try:
        if base is not None:
            venv = ResidualActionVector(venv, base, config.residual_scale)
        there = getattr(venv.single_observation_space, "spaces", {})
        keys = (*(key for key in there if key not in UNREAD), *derived_boxes(there))
        return SB3VecEnv(venv, config.keys or keys, flatten)
    except ValueError:
        venv.close()
        raise


def _make_worlds(env_id: str, config: RunConfig) -> VectorEnv:
    native = env_spec(env_id).vector_entry_point is not None
    options: dict[str, Any] = {"vector_kwargs": {"autoreset_mode": AutoresetMode.SAME_STEP}}
    if native:  # Gymnasium passes `vector_kwargs` to its own vector environments only; a native one takes plain options
        options = {"autoreset_mode": "same_step"}
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
            f"env_kwargs: {env_id} does not take all of {sorted(config.env_kwargs)}: {one_line(error)}"
        ) from error
