"""PPO by Stable-Baselines3 as this project trains it, and its whole state as named arrays (no pickle)."""

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

from agents.checkpoint import NetworkLayout
from agents.learner_state import (
    check_training,
    generator_tensors,
    parameter_tensors,
    restore_generators,
    restore_parameters,
)
from agents.sb3_env import SB3VecEnv, actor_layout
from agents.train_config import TrainConfig


def build(config: TrainConfig, env: SB3VecEnv) -> tuple[PPO, VecNormalize]:
    """The learner and its normalised environment. The actor's last layer starts small; a residual one's at zero."""
    normalized = VecNormalize(
        env,
        norm_obs=True,
        norm_reward=config.normalize_reward,
        clip_obs=config.clip_observation,
        gamma=config.gamma,
    )
    slope, final = config.learning_rate - config.final_learning_rate, config.final_learning_rate
    model = PPO(
        "MlpPolicy",
        normalized,
        learning_rate=lambda progress_remaining: final + slope * progress_remaining,
        n_steps=config.n_steps,
        batch_size=config.batch_size,
        n_epochs=config.epochs,
        gamma=config.gamma,
        gae_lambda=config.gae_lambda,
        clip_range=config.clip_range,
        ent_coef=config.entropy,
        vf_coef=config.value_weight,
        max_grad_norm=config.max_grad_norm,
        target_kl=config.target_kl,
        use_sde=config.sde_hold > 0,
        sde_sample_freq=config.sde_hold or -1,
        policy_kwargs={
            "net_arch": {"pi": list(config.hidden), "vf": list(config.hidden)},
            "activation_fn": {"tanh": torch.nn.Tanh, "relu": torch.nn.ReLU}[config.activation],
            "log_std_init": config.log_std,
            "optimizer_kwargs": {"eps": 1e-5, "fused": True},
        },
        seed=config.seed,
        device="cpu",
    )
    if config.residual is not None:
        torch.nn.init.zeros_(model.policy.action_net.weight)  # type: ignore[arg-type]
    return model, normalized


def actor_tensors(model: PPO, env: VecNormalize) -> dict[str, NDArray]:
    """What inference needs, in float32: see `NetworkLayout.shapes`."""
    tensors = {
        name: parameter.detach().numpy().astype(np.float32)
        for name, parameter in _parameters(model).items()
        if not name.startswith("critic.")
    }
    if model.use_sde:  # its deviation depends on the state; alone, the actor gets that of hidden units of mean square ½
        tensors["log_std"] = 0.5 * np.log(0.5 * np.exp(2.0 * tensors["log_std"]).sum(axis=0))
    statistics: Any = env.obs_rms
    return tensors | {f"observation.{key}": getattr(statistics, key).astype(np.float32) for key in ("mean", "var")}


def training_tensors(model: PPO, env: VecNormalize) -> dict[str, NDArray]:
    """A training's whole state but for the worlds: network, Adam's moments, normalisation, counters, generators."""
    tensors = parameter_tensors(_parameters(model), model.policy.optimizer)
    observation: Any = env.obs_rms
    for prefix, rms in (("observation", observation), ("return", env.ret_rms)):
        tensors |= {f"{prefix}.{key}": np.array(getattr(rms, key), np.float64) for key in ("mean", "var", "count")}
    counters = np.array([model.num_timesteps, model._n_updates], dtype=np.int64)
    return tensors | generator_tensors() | {"counters": counters}


def restore(model: PPO, env: VecNormalize, tensors: Mapping[str, NDArray]) -> None:
    """Put `training_tensors` back.

    Raises:
        CheckpointError: a tensor is missing or of another shape (another network, or a checkpoint for inference only).
    """
    parameters = _parameters(model)
    check_training(tensors, parameters)
    restore_parameters(parameters, model.policy.optimizer, tensors)
    observation: Any = env.obs_rms
    for prefix, rms in (("observation", observation), ("return", env.ret_rms)):
        rms.mean, rms.var = (np.array(tensors[f"{prefix}.{key}"], np.float64) for key in ("mean", "var"))
        rms.count = float(tensors[f"{prefix}.count"])
    restore_generators(tensors)
    model.num_timesteps, model._n_updates = (int(count) for count in tensors["counters"])


def layout(config: TrainConfig, env: SB3VecEnv) -> NetworkLayout:
    """The actor's layout in this environment."""
    return actor_layout(config, env, squash=False)


def _parameters(model: PPO) -> dict[str, torch.nn.Parameter]:
    """Every parameter under this project's names: actor.k.*, critic.k.* (k-th dense layer) and log_std."""
    renamed: dict[str, torch.nn.Parameter] = {}
    last = len(model.policy.net_arch["pi"])  # type: ignore[call-overload]
    for name, parameter in model.policy.named_parameters():
        part = {"policy": "actor", "value": "critic", "action": "actor"}
        if match := re.fullmatch(r"mlp_extractor\.(policy|value)_net\.(\d+)\.(weight|bias)", name):
            renamed[f"{part[match[1]]}.{int(match[2]) // 2}.{match[3]}"] = parameter
        elif match := re.fullmatch(r"(action|value)_net\.(weight|bias)", name):
            renamed[f"{part[match[1]]}.{last}.{match[2]}"] = parameter
        else:
            renamed[name] = parameter
    return renamed
