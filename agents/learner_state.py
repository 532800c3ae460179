"""What the learners' states have in common, as named arrays: Adam's moments, and the generators they draw from."""

from collections.abc import Mapping

import numpy as np
import torch
from numpy.typing import NDArray

from agents.checkpoint import CheckpointError

_MOMENTS = ("step", "exp_avg", "exp_avg_sq")
Parameters = Mapping[str, torch.Tensor]


def parameter_tensors(parameters: Parameters, optimizer: torch.optim.Optimizer) -> dict[str, NDArray]:
    """The named parameters, and Adam's moments of each that `optimizer` has moved, as "optimizer.…"."""
    tensors: dict[str, NDArray] = {}
    for name, parameter in parameters.items():
        tensors[name] = parameter.detach().numpy().copy()
        for key, value in optimizer.state.get(parameter, {}).items():
            tensors[f"optimizer.{key}.{name}"] = value.detach().numpy().copy()
    return tensors


def restore_parameters(
    parameters: Parameters, optimizer: torch.optim.Optimizer, tensors: Mapping[str, NDArray]
) -> None:
    """Put `parameter_tensors` back; their shapes have been checked."""
    with torch.no_grad():
        for name, parameter in parameters.items():
            parameter.copy_(torch.from_numpy(tensors[name].copy()))
            if all(f"optimizer.{key}.{name}" in tensors for key in _MOMENTS):
                optimizer.state[parameter] = {
                    key: torch.from_numpy(tensors[f"optimizer.{key}.{name}"].copy()) for key in _MOMENTS
                }


def generator_tensors() -> dict[str, NDArray]:
    """The state of torch's and NumPy's global generators, which Stable-Baselines3 draws from."""
    _, key, position, has_gauss, cached = np.random.get_state()  # noqa: NPY002
    return {
        "rng.torch": torch.get_rng_state().numpy().copy(),
        "rng.numpy.key": np.array(key, dtype=np.uint32),
        "rng.numpy.rest": np.array([position, has_gauss, cached], dtype=np.float64),
    }


def restore_generators(tensors: Mapping[str, NDArray]) -> None:
    """Put `generator_tensors` back."""
    torch.set_rng_state(torch.from_numpy(tensors["rng.torch"].copy()))
    position, has_gauss, cached = tensors["rng.numpy.rest"]
    np.random.set_state(("MT19937", tensors["rng.numpy.key"], int(position), int(has_gauss), float(cached)))  # noqa: NPY002


def check_training(tensors: Mapping[str, NDArray], parameters: Parameters) -> None:
    """Refuse what is not a whole training's state with these parameters.

    Raises:
        CheckpointError: a tensor is missing or of another shape (another network, or a checkpoint for inference only).
    """
    shapes = {name: tuple(parameter.shape) for name, parameter in parameters.items()}
    shapes |= {name: value.shape for name, value in generator_tensors().items()} | {"counters": (2,)}
    shapes |= {f"return.{key}": () for key in ("mean", "var", "count")} | {"observation.count": ()}
    for name, shape in shapes.items():
        found = tensors[name].shape if name in tensors else None
        if found != shape:
            raise CheckpointError(
                f"expected a training checkpoint with tensor {name!r} of shape {shape}, "
                + ("it has none" if found is None else f"its shape is {found}")
            )
