"""A point that is pushed by a constant wind: a task that learns in seconds, single and natively batched."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

SINGLE, BATCHED = "toy/Point-v0", "toy/Points-v0"
SIZES = {"error": 2, "velocity": 2, "wind": 1}
LIMIT = 20


def spaces_of() -> tuple[spaces.Dict, spaces.Box]:
    boxes = {key: spaces.Box(-10.0, 10.0, (size,), np.float32) for key, size in SIZES.items()}
    return spaces.Dict(boxes), spaces.Box(-1.0, 1.0, (2,), np.float32)


class Points(VectorEnv):
    """N points; world i of a seeded reset draws from its own generator, seeded with seed + i."""

    def __init__(
        self,
        num_envs: int,
        wind: float = 0.1,
        max_episode_steps: int | None = LIMIT,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ) -> None:
        self.num_envs, self.wind, self.limit = num_envs, wind, max_episode_steps
        self.mode = AutoresetMode[autoreset_mode.upper()] if isinstance(autoreset_mode, str) else autoreset_mode
        self.metadata = {"autoreset_mode": self.mode}
        self.single_observation_space, self.single_action_space = spaces_of()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.render_mode = None
        self.rngs = [np.random.default_rng(i) for i in range(num_envs)]
        self.x = np.zeros((num_envs, 2))
        self.v = np.zeros((num_envs, 2))
        self.total = np.zeros(num_envs)
        self.t = np.zeros(num_envs, dtype=int)
        self.pending = np.zeros(num_envs, dtype=bool)
        self.actions: list[np.ndarray] = []  # what was executed

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> Any:
        mask = np.ones(self.num_envs, dtype=bool) if not options else options["reset_mask"]
        if seed is not None:
            self.rngs = [np.random.default_rng(seed + i) for i in range(self.num_envs)]
        self._restart(mask)
        return self._observe(), {}

    def step(self, actions: np.ndarray) -> Any:
        assert np.all(np.abs(actions) <= 1.0)
        self.actions.append(np.array(actions))
        pending = self.pending.copy()
        self.v = 0.8 * self.v + 0.1 * actions + 0.1 * self.wind
        self.x = self.x + self.v
        self.t += 1
        distance = np.linalg.norm(self.x, axis=1)
        self.total += distance
        crashed, late = distance > 4.0, self.t >= (self.limit or 10**9)
        reward = -distance
        crashed, late, reward = crashed & ~pending, late & ~pending, np.where(pending, 0.0, reward)
        everyone = np.ones(self.num_envs, dtype=bool)
        error = self.total / np.maximum(self.t, 1)
        info: dict[str, Any] = {
            "success": ~crashed & (error < 1.0),
            "metrics": {"error": error, "_error": everyone, "crash": crashed.astype(float), "_crash": everyone},
            "_success": everyone,
            "_metrics": everyone,
        }
        done = crashed | late
        if self.mode is AutoresetMode.SAME_STEP and done.any():
            last = np.full(self.num_envs, None, dtype=object)
            observation = self._observe()
            for i in np.flatnonzero(done):
                last[i] = {key: value[i] for key, value in observation.items()}
            info = {"final_obs": last, "_final_obs": done, "final_info": info, "_final_info": done}
            self._restart(done)
        elif self.mode is AutoresetMode.NEXT_STEP:
            self._restart(pending)
            self.pending = done
        return self._observe(), reward, crashed, late, info

    def _restart(self, mask: np.ndarray) -> None:
        for i in np.flatnonzero(mask):
            self.x[i] = self.rngs[i].uniform(-1.0, 1.0, 2)
        self.v[mask], self.t[mask], self.total[mask], self.pending[mask] = 0.0, 0, 0.0, False

    def _observe(self) -> dict[str, np.ndarray]:
        wind = np.full((self.num_envs, 1), self.wind)
        values = {"error": -self.x, "velocity": self.v, "wind": wind}
        return {key: value.astype(np.float32) for key, value in values.items()}

    def close(self, **_: Any) -> None:
        pass


class Point(gymnasium.Env):
    """One of them."""

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 (Gymnasium's)

    def __init__(self, wind: float = 0.1) -> None:
        self.observation_space, self.action_space = spaces_of()
        self.world = Points(1, wind, None, AutoresetMode.DISABLED)

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        observation, info = self.world.reset(seed=seed)
        return {key: value[0] for key, value in observation.items()}, info

    def step(self, action: np.ndarray) -> Any:
        observation, reward, crashed, late, info = self.world.step(np.asarray(action)[None])
        one = {"success": bool(info["success"][0])}
        one["metrics"] = {key: float(info["metrics"][key][0]) for key in ("error", "crash")}
        return {k: v[0] for k, v in observation.items()}, float(reward[0]), bool(crashed[0]), bool(late[0]), one


class Integral:
    """A stateful base policy: a PI law on the error, its state the running sum, restarted by `episode_start`."""

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> Any:
        error = np.asarray(observation["error"], dtype=np.float64)
        total = np.zeros_like(error) if state is None else np.array(state)
        if episode_start is not None:
            total[np.asarray(episode_start, dtype=bool)] = 0.0
        total = total + error
        action = np.clip(0.8 * error + 0.05 * total - 2.0 * observation["velocity"], -1.0, 1.0)
        return action.astype(np.float32), total


def register() -> None:
    """Register both ids, and the base policy "pi" for each."""
    from baselines.policies import POLICIES

    for env_id, options in (
        (SINGLE, {"entry_point": Point}),
        (BATCHED, {"entry_point": Point, "vector_entry_point": Points}),
    ):
        if env_id not in gymnasium.registry:
            gymnasium.register(env_id, max_episode_steps=LIMIT, **options)
        POLICIES.setdefault(env_id, {})["pi"] = "toy_environment:Integral"
