"""Soft actor-critic by Stable-Baselines3 as this project trains it, and its whole state as named arrays (no pickle)."""

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import SAC, HerReplayBuffer
from stable_baselines3.common.buffers import DictReplayBuffer
from stable_baselines3.common.type_aliases import DictReplayBufferSamples
from stable_baselines3.common.vec_env import VecNormalize

from agents.checkpoint import NetworkLayout
from agents.derived_inputs import FINE_OFFSET, GOALS, OFFSET, derive
from agents.learner_state import (
    check_training,
    generator_tensors,
    parameter_tensors,
    restore_generators,
    restore_parameters,
)
from agents.sac_config import SacConfig
from agents.sb3_env import SB3VecEnv, actor_layout, has_goals


class HindsightBuffer(HerReplayBuffer):
    """A memory that makes up goals which move as the true ones did.

    The goals of an episode are all shifted alike, so that they meet what was achieved at a later step of it; where the
    goal does not move, that is what was achieved then (the strategy "future" of Andrychowicz et al. 2017).
    """

    env: Any

    def _get_virtual_samples(self, batch_indices: Any, env_indices: Any, env: VecNormalize | None = None) -> Any:
        """Transitions with made-up goals, what is derived from these, and the rewards they earn."""
        before = {key: rows[batch_indices, env_indices] for key, rows in self.observations.items()}
        after = {key: rows[batch_indices, env_indices] for key, rows in self.next_observations.items()}
        start, length = self.ep_start[batch_indices, env_indices], self.ep_length[batch_indices, env_indices]
        later = np.random.randint((batch_indices - start) % self.buffer_size, length)  # noqa: NPY002 (its state is saved)
        met = ((start + later) % self.buffer_size, env_indices)
        achieved, desired = (self.next_observations[key][met] for key in GOALS)
        for part in (before, after):
            part[GOALS[1]] = achieved + (part[GOALS[1]] - desired)
            for key in (OFFSET, FINE_OFFSET):
                if key in part:
                    part[key] = derive(key, part[GOALS[0]], part[GOALS[1]], part[GOALS[1]])
        rewards = self.env.env_method("compute_reward", *(after[key] for key in GOALS), {}, indices=[0])[0]
        ended = self.dones[batch_indices, env_indices] * (1 - self.timeouts[batch_indices, env_indices])
        observations: Any = self._normalize_obs(before, env)
        following: Any = self._normalize_obs(after, env)
        return DictReplayBufferSamples(
            observations={key: self.to_torch(rows) for key, rows in observations.items()},
            actions=self.to_torch(self.actions[batch_indices, env_indices]),
            next_observations={key: self.to_torch(rows) for key, rows in following.items()},
            dones=self.to_torch(ended).reshape(-1, 1),
            rewards=self.to_torch(self._normalize_reward(rewards.astype(np.float32).reshape(-1, 1), env)),
        )


class Learner(SAC):
    """SAC that waits for experience: for enough of it, and for a whole episode where goals of hindsight are drawn.

    A run that was resumed without its replay buffer thereby gathers new experience with the policy it has.
    """

    def train(self, gradient_steps: int, batch_size: int = 64) -> None:
        """Take gradient steps if there is experience for them."""
        replay: Any = self.replay_buffer
        if replay.size() * replay.n_envs < min(self.learning_starts, replay.buffer_size * replay.n_envs):
            return
        if isinstance(replay, HindsightBuffer) and not replay.ep_length.any():
            return
        super().train(gradient_steps, batch_size)


def hindsight(config: SacConfig, env: SB3VecEnv) -> bool:
    """Whether experience is replayed with goals of hindsight.

    Not under a base policy: its action would have been another for another goal, and it is a part of the observation.
    """
    return config.goals > 0 and config.residual is None and has_goals(env)


def build(config: SacConfig, env: SB3VecEnv) -> tuple[Learner, VecNormalize]:
    """The learner and its normalised environment, whose observations are a Dict. A residual's mean starts at zero."""
    normalized = VecNormalize(
        env,
        norm_obs=True,
        norm_reward=config.normalize_reward,
        clip_obs=config.clip_observation,
        gamma=config.gamma,
    )
    slope, final = config.learning_rate - config.final_learning_rate, config.final_learning_rate
    goals = {"n_sampled_goal": config.goals, "goal_selection_strategy": "future"}
    relabels = hindsight(config, env)
    model = Learner(
        "MultiInputPolicy",
        normalized,
        learning_rate=lambda progress_remaining: final + slope * progress_remaining,
        buffer_size=config.replay_size,
        learning_starts=config.learning_starts,
        batch_size=config.batch_size,
        tau=config.tau,
        gamma=config.gamma,
        train_freq=1,
        gradient_steps=config.gradient_steps,
        replay_buffer_class=HindsightBuffer if relabels else DictReplayBuffer,
        replay_buffer_kwargs=goals if relabels else None,
        ent_coef=f"auto_{config.entropy!r}",
        target_entropy="auto" if config.target_entropy is None else config.target_entropy,
        policy_kwargs={
            "net_arch": list(config.hidden),
            "activation_fn": {"tanh": torch.nn.Tanh, "relu": torch.nn.ReLU}[config.activation],
            "optimizer_kwargs": {"fused": True},
        },
        seed=config.seed,
        device="cpu",
    )
    if config.residual is not None:
        torch.nn.init.zeros_(model.actor.mu.weight)  # type: ignore[arg-type]
        torch.nn.init.zeros_(model.actor.mu.bias)  # type: ignore[arg-type]
    return model, normalized


def layout(config: SacConfig, env: SB3VecEnv) -> NetworkLayout:
    """The actor's layout in this environment."""
    return actor_layout(config, env, squash=True)


def actor_tensors(model: Learner, env: VecNormalize) -> dict[str, NDArray]:
    """What inference needs, in float32: see `NetworkLayout.shapes`."""
    tensors = {
        name: parameter.detach().numpy().astype(np.float32)
        for name, parameter in _parameters(model).items()
        if name.startswith(("actor.", "log_std."))
    }
    statistics = _statistics(env)
    return tensors | {f"observation.{key}": statistics[key].astype(np.float32) for key in ("mean", "var")}


def training_tensors(model: Learner, env: VecNormalize) -> dict[str, NDArray]:
    """A training's state but for the worlds and the replay buffer."""
    tensors: dict[str, NDArray] = {}
    for optimizer, parameters in _optimized(model):
        tensors |= parameter_tensors(parameters, optimizer)
    tensors |= {f"observation.{key}": value for key, value in _statistics(env).items()}
    tensors |= {f"return.{key}": np.array(getattr(env.ret_rms, key), np.float64) for key in ("mean", "var", "count")}
    counters = np.array([model.num_timesteps, model._n_updates], dtype=np.int64)
    return tensors | generator_tensors() | {"counters": counters}


def restore(model: Learner, env: VecNormalize, tensors: Mapping[str, NDArray]) -> None:
    """Put `training_tensors` back.

    Raises:
        CheckpointError: a tensor is missing or of another shape (another network, or a checkpoint for inference only).
    """
    check_training(tensors, _parameters(model))
    for optimizer, parameters in _optimized(model):
        restore_parameters(parameters, optimizer, tensors)
    observation: Any = env.obs_rms
    ends = np.cumsum([rms.mean.size for rms in observation.values()])[:-1]
    for key in ("mean", "var"):
        parts = np.split(np.array(tensors[f"observation.{key}"], np.float64), ends)
        for rms, part in zip(observation.values(), parts, strict=True):
            setattr(rms, key, part)
        setattr(env.ret_rms, key, np.array(tensors[f"return.{key}"], np.float64))
    for rms in observation.values():
        rms.count = float(tensors["observation.count"])
    env.ret_rms.count = float(tensors["return.count"])
    restore_generators(tensors)
    model.num_timesteps, model._n_updates = (int(count) for count in tensors["counters"])


def _statistics(env: VecNormalize) -> dict[str, NDArray]:
    """Mean, variance and count of the observation's parts, in the order in which the network reads them."""
    parts: Any = env.obs_rms
    statistics = {key: np.concatenate([getattr(rms, key) for rms in parts.values()]) for key in ("mean", "var")}
    return statistics | {"count": np.array(next(iter(parts.values())).count, np.float64)}  # all were updated alike


def _parameters(model: Learner) -> dict[str, torch.Tensor]:
    """Every parameter under this project's names: actor.k.* (k-th dense layer), log_std.*, critic*.*, temperature."""
    renamed: dict[str, torch.Tensor] = {}
    last = len(model.actor.net_arch)
    for name, parameter in model.policy.named_parameters():
        if match := re.fullmatch(r"actor\.latent_pi\.(\d+)\.(weight|bias)", name):
            renamed[f"actor.{int(match[1]) // 2}.{match[2]}"] = parameter
        elif match := re.fullmatch(r"actor\.mu\.(weight|bias)", name):
            renamed[f"actor.{last}.{match[1]}"] = parameter
        else:
            renamed[name.removeprefix("actor.")] = parameter
    assert model.log_ent_coef is not None  # it is adapted
    return renamed | {"temperature.log": model.log_ent_coef}


def _optimized(model: Learner) -> list[tuple[torch.optim.Optimizer, dict[str, torch.Tensor]]]:
    """The parameters by the optimiser that moves them; the targets, which none moves, are with their critics."""
    named = _parameters(model)
    parts = {"critic": model.critic.optimizer, "temperature": model.ent_coef_optimizer}
    groups: dict[str, dict[str, torch.Tensor]] = {"actor": {}, "critic": {}, "temperature": {}}
    for name, parameter in named.items():
        group = next((part for part in parts if name.startswith(part)), "actor")
        groups[group][name] = parameter
    return [(parts.get(group, model.actor.optimizer), part) for group, part in groups.items()]  # type: ignore[misc]
