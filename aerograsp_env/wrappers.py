"""Learning on top of a base policy: residual actions, for single and for vector environments.

The action that reaches the environment is ``clip(base + scale · agent, −1, 1)``, where ``base`` is the base policy's
action for the observation that the agent saw (Silver et al. 2018, "Residual policy learning"; Johannink et al. 2019).
The agent sees it as the key "base_action", without which the step it takes would not be a function of what it observes.

The base policy is passed in, never imported. Its state lives in the wrapper and starts afresh with each episode; it is
asked once for each observation, deterministically.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from gymnasium import Env, Wrapper
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box, Dict, Space
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from aerograsp_env.interfaces import Policy

BASE_ACTION = "base_action"

Observation = dict[str, NDArray[Any]]


def _check(observation_space: Space, action_space: Space, policy: Policy, scale: float) -> Dict:
    """The single world's observation space with the base action added, after checking all that is wrapped."""
    if not isinstance(observation_space, Dict):
        raise ValueError(f"env: expected a Dict observation space, got {observation_space}")
    if BASE_ACTION in observation_space.spaces:
        raise ValueError(f"env: expected no observation {BASE_ACTION!r} yet, got one: it is wrapped already")
    if not isinstance(action_space, Box) or np.any(action_space.low != -1.0) or np.any(action_space.high != 1.0):
        raise ValueError(f"env: expected a Box action space of [-1, 1], got {action_space}")
    if len(action_space.shape) != 1:
        raise ValueError(f"env: expected one-dimensional actions, got shape {action_space.shape}")
    if not isinstance(policy, Policy):
        raise ValueError(f"policy: expected an object with a predict method (see Policy), got {policy!r}")
    if not 0.0 <= scale < math.inf:
        raise ValueError(f"scale: expected a finite value ≥ 0, got {scale}")
    return Dict({**observation_space.spaces, BASE_ACTION: Box(-1.0, 1.0, action_space.shape, np.float32)})


def _base_action(action: Any, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """The policy's answer as a float32 array in [−1, 1]."""
    action = np.asarray(action)
    if action.shape != shape or not np.isfinite(action).all():
        raise ValueError(f"policy: expected finite actions of shape {shape}, got {action}")
    return np.clip(action, -1.0, 1.0).astype(np.float32)


def _final_action(base: NDArray[np.float32], action: Any, scale: float) -> NDArray[np.float32]:
    action = np.asarray(action, dtype=np.float32)
    if action.shape != base.shape:
        raise ValueError(f"action: expected shape {base.shape}, got {action.shape}")
    return np.clip(base + np.float32(scale) * action, -1.0, 1.0)


class ResidualAction(Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Adds the agent's action, scaled, to a base policy's, in a single environment.

    The action space is the environment's. The observation gains "base_action" (n,) float32 in [−1, 1]: the base
    policy's action for this very observation; `info` repeats it under the same key.

    Args:
        env: an environment with a Dict observation space and actions in a one-dimensional Box of [−1, 1].
        policy: the base policy; it sees the observation without "base_action".
        scale: share of the action range that the agent commands. 0 leaves the base policy alone.

    Raises:
        ValueError: for another kind of environment, policy or scale, an action of the wrong shape, or a base policy
            whose actions are of the wrong shape or not finite.
        gymnasium.error.ResetNeeded: if stepped before the first reset.
    """

    def __init__(self, env: Env[Any, Any], policy: Policy, scale: float = 0.3) -> None:
        RecordConstructorArgs.__init__(self, policy=policy, scale=scale, _disable_deepcopy=True)
        Wrapper.__init__(self, env)
        self.observation_space = _check(env.observation_space, env.action_space, policy, scale)
        self.policy, self.scale = policy, float(scale)
        self._shape: tuple[int, ...] = env.action_space.shape  # type: ignore[assignment]  # a Box, so never None
        self._state: Any = None
        self._base: NDArray[np.float32] | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Resets the environment and the base policy's state."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._state = None
        return self._respond(observation, info)

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, Any, bool, bool, dict[str, Any]]:
        """Steps with ``clip(base + scale · action, −1, 1)``."""
        if self._base is None:
            raise ResetNeeded("step: expected a call of reset() first")
        observation, reward, terminated, truncated, info = self.env.step(_final_action(self._base, action, self.scale))
        observation, info = self._respond(observation, info)
        return observation, reward, terminated, truncated, info

    def _respond(self, observation: Observation, info: dict[str, Any]) -> tuple[Observation, dict[str, Any]]:
        answer, self._state = self.policy.predict(observation, state=self._state, deterministic=True)
        self._base = _base_action(answer, self._shape)
        return {**observation, BASE_ACTION: self._base.copy()}, {**info, BASE_ACTION: self._base.copy()}


class ResidualActionVector(VectorWrapper[Any, Any, Any, Any, Any]):
    """`ResidualAction` for a vector environment, with a base policy that takes batches.

    Worlds restart in the base policy exactly where their observation is the first of an episode: one step after they
    end with next-step autoreset, at the step that ends them with same-step autoreset (`final_obs` then carries the base
    action of the old episode), and where `reset(options={"reset_mask": mask})` says so.

    Args:
        env: a vector environment of N worlds that declares ``metadata["autoreset_mode"]``.
        policy, scale: as for `ResidualAction`; the policy sees arrays (N, …) and gives (N, n).

    Raises:
        ValueError: as `ResidualAction` does, and if the autoreset mode is not declared.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], policy: Policy, scale: float = 0.3) -> None:
        super().__init__(env)
        self.single_observation_space = _check(env.single_observation_space, env.single_action_space, policy, scale)
        self.observation_space = batch_space(self.single_observation_space, env.num_envs)
        mode = env.metadata.get("autoreset_mode")
        if not isinstance(mode, AutoresetMode):
            raise ValueError(f'env: expected metadata["autoreset_mode"] to be an AutoresetMode, got {mode!r}')
        self.policy, self.scale = policy, float(scale)
        self._mode = mode
        self._shape = (env.num_envs, *env.single_action_space.shape)  # type: ignore[misc]  # a Box, so never None
        self._none = np.zeros(env.num_envs, dtype=np.bool_)
        # The state before and after the last answer: a partial reset asks again for the same observations, from before.
        self._state_before: Any = None
        self._state: Any = None
        self._start = ~self._none  # worlds that restarted at the last answer
        self._done = self._none  # worlds that ended at the last step
        self._base: NDArray[np.float32] | None = None

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Observation, dict[str, Any]]:
        """Resets all worlds, or those in ``options["reset_mask"]`` (N,), and the base policy's state in them."""
        mask = None if options is None else options.get("reset_mask")  # Gymnasium's environments pop it
        observations, infos = self.env.reset(seed=seed, options=options)
        if mask is None:
            self._state, start = None, ~self._none
        else:
            # The other worlds return their last observation again: the same question gets the same answer.
            self._state, start = self._state_before, self._start | mask
        self._done = self._none if mask is None else self._done & ~mask
        return self._respond(observations, start, infos)

    def step(self, actions: NDArray[np.float32]) -> tuple[Observation, Any, Any, Any, dict[str, Any]]:
        """Steps with ``clip(base + scale · actions, −1, 1)``, actions (N, n)."""
        if self._base is None:
            raise ResetNeeded("step: expected a call of reset() first")
        final = _final_action(self._base, actions, self.scale)
        observations, rewards, terminations, truncations, infos = self.env.step(final)
        done = np.logical_or(terminations, truncations)
        if self._mode is AutoresetMode.SAME_STEP:
            start = done
            infos = self._with_final(observations, done, infos)
        else:
            start = self._done if self._mode is AutoresetMode.NEXT_STEP else self._none
        self._done = done
        observations, infos = self._respond(observations, start, infos)
        return observations, rewards, terminations, truncations, infos

    def _respond(
        self, observations: Observation, start: NDArray[np.bool_], infos: dict[str, Any]
    ) -> tuple[Observation, dict[str, Any]]:
        self._state_before, self._start = self._state, start
        base, self._state = self._predict(observations, start)
        self._base = base
        infos = {**infos, BASE_ACTION: base.copy(), f"_{BASE_ACTION}": ~self._none}
        return {**observations, BASE_ACTION: base.copy()}, infos

    def _predict(self, observations: Observation, start: NDArray[np.bool_]) -> tuple[NDArray[np.float32], Any]:
        answer, state = self.policy.predict(
            observations, state=self._state, episode_start=start.copy(), deterministic=True
        )
        return _base_action(answer, self._shape), state

    def _with_final(self, observations: Observation, done: NDArray[np.bool_], infos: dict[str, Any]) -> dict[str, Any]:
        """`infos` with the base action in `final_obs`: what the policy would have done had the episode gone on."""
        if not done.any() or "final_obs" not in infos:
            return infos
        finals = infos["final_obs"].copy()
        last = {key: value.copy() for key, value in observations.items()}
        for i in np.flatnonzero(done):
            for key, value in finals[i].items():
                last[key][i] = value
        base, _ = self._predict(last, self._none)  # the state it returns would be of a step not taken
        for i in np.flatnonzero(done):
            finals[i] = {**finals[i], BASE_ACTION: base[i].copy()}
        return {**infos, "final_obs": finals}
