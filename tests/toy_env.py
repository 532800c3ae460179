"""A point that is moved by its velocity command and pushed by noise: small, with Dock's interface, single and batched.

The batched environment steps the very same objects, so both must give the same numbers to the last bit.
"""

from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Dict
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

TOY, TOY_SINGLE = "toy/Hold-v0", "toy/HoldSingle-v0"
STEPS = 40


class HoldEnv(gymnasium.Env):
    """Hold a point at its set-point against noise.

    Success: mean |error| over the episode at most 0.2 m. Terminates beyond 2 m ("out_of_bounds").
    """

    dt = 0.1

    def __init__(self, noise: float = 0.05, render_mode: str | None = None) -> None:
        if noise < 0.0:
            raise ValueError(f"noise: expected at least 0, got {noise!r}")
        self.noise, self.render_mode = noise, render_mode
        self.action_space = Box(-1.0, 1.0, (3,), np.float32)
        self.observation_space = Dict(
            {"position_error": Box(-5.0, 5.0, (3,), np.float32), "set_point": Box(-5.0, 5.0, (3,), np.float32)}
        )

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[dict, dict]:
        super().reset(seed=seed)
        self._set_point = self.np_random.uniform(-1.0, 1.0, 3)
        self._position = self._set_point + self.np_random.uniform(-0.5, 0.5, 3)
        self._sum, self._steps = np.zeros(3), 0
        return self._observation(), {}

    def step(self, action: NDArray) -> tuple[dict, float, bool, bool, dict]:
        self._position = (
            self._position + self.dt * action.astype(np.float64) + self.noise * self.np_random.normal(size=3)
        )
        error = np.abs(self._set_point - self._position)
        self._sum, self._steps = self._sum + error, self._steps + 1
        terminated = bool(error.max() > 2.0)
        mean = self._sum / self._steps
        metrics = {f"error_{axis}": float(value) for axis, value in zip("xyz", mean, strict=True)}
        metrics |= {"error": float(mean.mean()), "crash": float(terminated)}
        info = {
            "success": bool(mean.max() <= 0.2) and not terminated,
            "metrics": metrics,
            "termination": "out_of_bounds" if terminated else "",
        }
        return self._observation(), -float(error.sum()), terminated, False, info

    def _observation(self) -> dict[str, NDArray]:
        error = np.clip(self._set_point - self._position, -5.0, 5.0)
        return {"position_error": error.astype(np.float32), "set_point": self._set_point.astype(np.float32)}


class HoldVectorEnv(VectorEnv):
    """N of them."""

    metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(self, num_envs: int = 1, max_episode_steps: int = STEPS, **options: Any) -> None:
        self.num_envs, self._limit = num_envs, max_episode_steps
        self._envs = [HoldEnv(**options) for _ in range(num_envs)]
        self.single_action_space, self.single_observation_space = (
            self._envs[0].action_space,
            self._envs[0].observation_space,
        )
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[dict, dict]:
        self._done = np.zeros(self.num_envs, dtype=bool)
        seeds = [None if seed is None else seed + i for i in range(self.num_envs)]
        return _stack([env.reset(seed=s)[0] for env, s in zip(self._envs, seeds, strict=True)]), {}

    def step(self, actions: NDArray) -> tuple[dict, NDArray, NDArray, NDArray, dict]:
        observations: list[dict[str, NDArray]] = []
        infos: dict[str, Any] = {}
        rewards = np.zeros(self.num_envs)
        terminated, truncated = np.zeros((2, self.num_envs), dtype=bool)
        for i, env in enumerate(self._envs):
            if self._done[i]:
                observation, info = env.reset()
            else:
                observation, rewards[i], terminated[i], _, info = env.step(actions[i])
                truncated[i] = env._steps >= self._limit
            observations.append(observation)
            infos = self._add_info(infos, info, i)
        self._done = terminated | truncated
        return _stack(observations), rewards, terminated, truncated, infos


def _stack(observations: list[dict[str, NDArray]]) -> dict[str, NDArray]:
    return {key: np.stack([observation[key] for observation in observations]) for key in observations[0]}


class Proportional:
    """A controller with a state: it counts the steps of each row's episode."""

    def __init__(self, gain: float = 3.0) -> None:
        self.gain = gain

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> Any:
        error = np.asarray(observation["position_error"])
        count = np.zeros(error.shape[:-1]) if state is None else state
        if episode_start is not None:
            count = np.where(np.reshape(episode_start, count.shape), 0.0, count)
        ramp = np.minimum(1.0, 0.2 * (count + 1.0))[..., None]
        return np.clip(self.gain * ramp * error, -1.0, 1.0).astype(np.float32), count + 1.0


class Forgetful(Proportional):
    """The same, with the bug that its state outlives an episode."""

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> Any:
        return super().predict(observation, state, None, deterministic)


class Undecided(Proportional):
    """The same, with the bug that it draws from a generator of its own whatever it is asked."""

    def __init__(self) -> None:
        super().__init__()
        self._rng = np.random.default_rng()

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> Any:
        action, state = super().predict(observation, state, episode_start, deterministic)
        return np.clip(action + self._rng.normal(0.0, 0.1, action.shape), -1.0, 1.0).astype(np.float32), state


class Wild(Proportional):
    """The same, in float64 and beyond the bounds."""

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> Any:
        action, state = super().predict(observation, state, episode_start, deterministic)
        return 10.0 * action.astype(np.float64), state


def not_a_policy() -> int:
    """A factory of something without predict()."""
    return 3


def register() -> None:
    """Register the ids once."""
    if TOY not in gymnasium.registry:
        gymnasium.register(TOY, "toy_env:HoldEnv", max_episode_steps=STEPS, vector_entry_point="toy_env:HoldVectorEnv")
        gymnasium.register(TOY_SINGLE, "toy_env:HoldEnv", max_episode_steps=STEPS)


POLICIES = {TOY: {"p": "toy_env:Proportional"}, TOY_SINGLE: {"p": "toy_env:Proportional"}}
register()
