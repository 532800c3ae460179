"""PPO by Stable-Baselines3 as this project trains it, and its whole state as named arrays (no pickle)."""

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

from agents.checkpoint import CheckpointError, NetworkLayout
from agents.sb3_env import SB3VecEnv
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
    tensors: dict[str, NDArray] = {}
    for name, parameter in _parameters(model).items():
        tensors[name] = parameter.detach().numpy().copy()
        for key, value in model.policy.optimizer.state.get(parameter, {}).items():
            tensors[f"optimizer.{key}.{name}"] = value.detach().numpy().copy()
    observation: Any = env.obs_rms
    for prefix, rms in (("observation", observation), ("return", env.ret_rms)):
        tensors |= {f"{prefix}.{key}": np.array(getattr(rms, key), np.float64) for key in ("mean", "var", "count")}
    # Stable-Baselines3 samples actions with torch's global generator and shuffles minibatches with NumPy's.
    _, key, position, has_gauss, cached = np.random.get_state()  # noqa: NPY002
    tensors["rng.torch"] = torch.get_rng_state().numpy().copy()
    tensors["rng.numpy.key"] = np.array(key, dtype=np.uint32)
    tensors["rng.numpy.rest"] = np.array([position, has_gauss, cached], dtype=np.float64)
    tensors["counters"] = np.array([model.num_timesteps, model._n_updates], dtype=np.int64)
    return tensors


def restore(model: PPO, env: VecNormalize, tensors: Mapping[str, NDArray]) -> None:
    """Put `training_tensors` back.

    Raises:
        CheckpointError: a tensor is missing or of another shape (another network, or a checkpoint for inference only).
    """
    parameters = _parameters(model)
    shapes = {name: tuple(parameter.shape) for name, parameter in parameters.items()}
    shapes |= {
        "rng.numpy.key": (624,),
        "rng.numpy.rest": (3,),
        "counters": (2,),
        "rng.torch": torch.get_rng_state().shape,
    }
    shapes |= {f"return.{key}": () for key in ("mean", "var", "count")} | {"observation.count": ()}
    for name, shape in shapes.items():
        found = tensors[name].shape if name in tensors else None
        if found != shape:
            raise CheckpointError(
                f"expected a training checkpoint with tensor {name!r} of shape {tuple(shape)}, "
                + ("it has none" if found is None else f"its shape is {found}")
            )
    with torch.no_grad():
        for name, parameter in parameters.items():
            parameter.copy_(torch.from_numpy(tensors[name].copy()))
            moments = ("step", "exp_avg", "exp_avg_sq")
            if all(f"optimizer.{key}.{name}" in tensors for key in moments):
                model.policy.optimizer.state[parameter] = {
                    key: torch.from_numpy(tensors[f"optimizer.{key}.{name}"].copy()) for key in moments
                }
    observation: Any = env.obs_rms
    for prefix, rms in (("observation", observation), ("return", env.ret_rms)):
        rms.mean, rms.var = (np.array(tensors[f"{prefix}.{key}"], np.float64) for key in ("mean", "var"))
        rms.count = float(tensors[f"{prefix}.count"])
    torch.set_rng_state(torch.from_numpy(tensors["rng.torch"].copy()))
    position, has_gauss, cached = tensors["rng.numpy.rest"]
    np.random.set_state(("MT19937", tensors["rng.numpy.key"], int(position), int(has_gauss), float(cached)))  # noqa: NPY002
    model.num_timesteps, model._n_updates = (int(count) for count in tensors["counters"])


def layout(config: TrainConfig, env: SB3VecEnv) -> NetworkLayout:
    """The actor's layout in this environment."""
    return NetworkLayout(
        keys=env.keys,
        sizes=tuple(env.sizes[key] for key in env.keys),
        actions=int(np.prod(env.action_space.shape or ())),
        hidden=config.hidden,
        activation=config.activation,
        clip=config.clip_observation,
    )


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
