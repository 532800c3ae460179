"""A point to be pushed to a goal that is drawn anew each episode: a goal environment that learns in seconds."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, SyncVectorEnv

SINGLE, BATCHED = "toy/Goal-v0", "toy/Goals-v0"
LIMIT, CLOUD = 25, 30
SIZES = {"achieved_goal": 2, "desired_goal": 2, "object_cloud": CLOUD, "observation": 2}


class Goal(gymnasium.Env):
    """Position and goal in the plane; the action is an acceleration; "object_cloud" is the same throughout an episode.

    The reward is the negative distance, or −1 further than 0.1 from the goal (`reward_mode="sparse"`).
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 (Gymnasium's)

    def __init__(self, reward_mode: str = "dense") -> None:
        self.reward_mode = reward_mode
        boxes = {key: spaces.Box(-10.0, 10.0, (size,), np.float32) for key, size in SIZES.items()}
        self.observation_space = spaces.Dict(boxes)
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)

    def compute_reward(self, achieved: Any, desired: Any, info: Any) -> Any:
        distance = np.linalg.norm(np.asarray(achieved) - np.asarray(desired), axis=-1)
        return -(distance > 0.1).astype(np.float64) if self.reward_mode == "sparse" else -distance

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        self.x, self.v = np.zeros(2), np.zeros(2)
        self.goal = self.np_random.uniform(-1.0, 1.0, 2)
        self.cloud = self.np_random.uniform(0.5, 1.0, CLOUD)
        self.errors: list[float] = []
        return self._observe(), {}

    def step(self, action: Any) -> Any:
        self.v = 0.7 * self.v + 0.1 * np.asarray(action, dtype=np.float64)
        self.x = self.x + self.v
        observation = self._observe()
        reward = float(self.compute_reward(observation["achieved_goal"], observation["desired_goal"], {}))
        self.errors.append(float(np.linalg.norm(self.x - self.goal)))
        info = {"success": self.errors[-1] < 0.1, "metrics": {"final_error": self.errors[-1]}}
        return observation, reward, bool(np.abs(self.x).max() > 5.0), False, info

    def _observe(self) -> dict[str, np.ndarray]:
        values = {"achieved_goal": self.x, "desired_goal": self.goal, "object_cloud": self.cloud, "observation": self.v}
        return {key: value.astype(np.float32) for key, value in values.items()}


class Goals(SyncVectorEnv):
    """The native batch: it has no single worlds to ask for a reward, so it answers itself."""

    def __init__(self, num_envs: int, autoreset_mode: Any = "next_step", **options: Any) -> None:
        mode = AutoresetMode[autoreset_mode.upper()] if isinstance(autoreset_mode, str) else autoreset_mode
        self.limit = options.pop("max_episode_steps", LIMIT)
        make = [lambda: gymnasium.wrappers.TimeLimit(Goal(**options), self.limit)] * num_envs
        super().__init__(make, autoreset_mode=mode)

    def compute_reward(self, achieved: Any, desired: Any, info: Any) -> Any:
        return self.envs[0].unwrapped.compute_reward(achieved, desired, info)


class Servo:
    """A base policy whose gain is a number of the cloud, which no network reads."""

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> Any:
        error = np.asarray(observation["desired_goal"]) - observation["achieved_goal"]
        gain = 0.5 * np.asarray(observation["object_cloud"])[..., :1]
        return np.clip(gain * error - 2.0 * observation["observation"], -1.0, 1.0).astype(np.float32), None


def register() -> None:
    """Register both ids, and the base policy "servo" for each."""
    from baselines.policies import POLICIES

    for env_id, options in ((SINGLE, {}), (BATCHED, {"vector_entry_point": Goals})):
        if env_id not in gymnasium.registry:
            gymnasium.register(env_id, entry_point=Goal, max_episode_steps=LIMIT, **options)
        POLICIES.setdefault(env_id, {})["servo"] = "toy_goal:Servo"
