"""Training states and policies on disk, without pickle.

One checkpoint is one `.safetensors` file: named arrays, and in its metadata a JSON card that says what they are (the
environment, the network's layout, the command, seeds, versions and learning curve). The same card lies beside it as
readable `.json`; only the one inside the file is read back. Loading needs NumPy and safetensors, not torch.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from aerograsp_env.wrappers import BASE_ACTION
from agents.files import write_atomic

SCHEMA = "aerograsp-checkpoint"
VERSION = 1
ACTIVATIONS = ("tanh", "relu")
SCORER_KIND, AIM_KIND = "grasp-scorer", "grasp-aim"  # of networks that score and that aim grasps
DETECTOR_KIND = "detector"  # of networks that find objects in images; all others are actors


class CheckpointError(ValueError):
    """A file that is no whole checkpoint of the expected kind; its one line names the file and what was expected."""


class Checkpoint(NamedTuple):
    """A validated checkpoint as read from disk."""

    path: Path
    tensors: dict[str, NDArray]  # name -> array
    card: dict[str, Any]

    @property
    def network(self) -> NetworkLayout:
        """The actor's layout, as the card has it."""
        return NetworkLayout.from_card(self.card)


@dataclass(frozen=True)
class NetworkLayout:
    """What an actor reads and how it is wired.

    The input is the concatenation of the observation's `keys` in this order, normalised as
    clip((x − mean) / √(var + epsilon), ±clip); then dense layers `hidden` with `activation`; a linear one to `actions`.
    Keys may be derived ones (`agents.derived_inputs`). A residual policy's last key is "base_action". A squashed
    actor's mean action is the tanh of that output, and its deviation, before the tanh, depends on the state: a linear
    layer on the last hidden one gives its logarithm.
    """

    keys: tuple[str, ...]
    sizes: tuple[int, ...]  # length of each key's vector
    actions: int
    hidden: tuple[int, ...] = (64, 64)
    activation: str = "tanh"
    clip: float = 10.0
    epsilon: float = 1e-8
    squash: bool = False  # cards without it are of networks that do not squash

    @classmethod
    def from_card(cls, card: Mapping[str, Any]) -> NetworkLayout:
        """Read `card["network"]`. Raises ValueError where a field is missing or not what it should be."""
        network = card.get("network")
        if not isinstance(network, dict):
            raise ValueError('the card has no "network" object')
        try:
            layout = cls(
                keys=tuple(str(key) for key in network["keys"]),
                sizes=tuple(int(size) for size in network["sizes"]),
                actions=int(network["actions"]),
                hidden=tuple(int(size) for size in network["hidden"]),
                activation=str(network["activation"]),
                clip=float(network["clip"]),
                epsilon=float(network["epsilon"]),
                squash=network.get("squash", False),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f'the card\'s "network" is not a network layout ({error!r})') from None
        if len(layout.keys) != len(layout.sizes) or not layout.keys:
            raise ValueError('the card\'s network "keys" and "sizes" must be of one length, at least 1')
        if min(layout.sizes + layout.hidden + (layout.actions,)) < 1 or not layout.clip > 0 or not layout.epsilon >= 0:
            raise ValueError("the card's network sizes and clip must be positive")
        if not isinstance(layout.squash, bool):
            raise ValueError(f"the card's network squash must be true or false, got {layout.squash!r}")
        if layout.activation not in ACTIVATIONS:
            raise ValueError(f"the card's network activation {layout.activation!r} is none of {', '.join(ACTIVATIONS)}")
        return layout

    @property
    def layers(self) -> int:
        """The number of dense layers, the output's included."""
        return len(self.hidden) + 1

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Name and shape of every tensor that inference needs."""
        inputs = sum(self.sizes)
        widths = (inputs, *self.hidden, self.actions)
        shapes: dict[str, tuple[int, ...]] = {"observation.mean": (inputs,), "observation.var": (inputs,)}
        for k in range(self.layers):
            shapes[f"actor.{k}.weight"] = (widths[k + 1], widths[k])
            shapes[f"actor.{k}.bias"] = (widths[k + 1],)
        if self.squash:
            return shapes | {"log_std.weight": (self.actions, widths[-2]), "log_std.bias": (self.actions,)}
        return shapes | {"log_std": (self.actions,)}


def save_checkpoint(path: str | Path, tensors: Mapping[str, Any], card: Mapping[str, Any]) -> Path:
    """Write `tensors` and `card` to `path` (.safetensors), and the card beside it as .json.

    Both are written under temporary names, then renamed, so that an interrupt at any moment leaves the
    last checkpoint whole.

    Args:
        path: file to write, ending in `.safetensors`; its folder is made if need be.
        tensors: name -> NumPy array, or anything `np.asarray` takes (a torch tensor on the CPU too).
        card: JSON object; `schema` and `version` are filled in.

    Returns:
        The path written.

    Raises:
        ValueError: the name does not end in .safetensors, or the card is not JSON (NaN included).
        OSError: the folder cannot be written to.
    """
    path = Path(path)
    if path.suffix != ".safetensors":
        raise ValueError(f"path: a checkpoint's name must end in .safetensors, got {path.name!r}")
    full_card = {"schema": SCHEMA, "version": VERSION, **card}
    try:
        line = json.dumps(full_card, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise ValueError(f"card: expected a JSON object, got one that cannot be written ({error})") from None
    arrays = {name: np.asarray(_to_numpy(value), order="C") for name, value in tensors.items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(path.with_suffix(".json"), json.dumps(full_card, indent=1) + "\n")
    return write_atomic(path, save(arrays, metadata={"card": line}))


def load_checkpoint(path: str | Path, env_id: str | None = None) -> Checkpoint:
    """Read and validate a checkpoint.

    Args:
        path: the .safetensors file.
        env_id: the environment the checkpoint must be for; any if None.

    Raises:
        CheckpointError: the file is missing, truncated, corrupt, of another program or version, for another
            environment, or its tensors do not fit the network its card describes.
    """
    path = Path(path)
    if not path.is_file():
        raise CheckpointError(f"{path}: expected a checkpoint file (.safetensors), but there is no such file")
    try:
        with safe_open(path, framework="np") as file:
            metadata = file.metadata() or {}
            # A foreign file may hold types that NumPy lacks: its card is checked before its tensors are read.
            card = _parse_card(metadata.get("card"))
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a mapping)
        _check(tensors, card, env_id)
    except (SafetensorError, OSError, TypeError, KeyError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise CheckpointError(
            f"{path}: expected a whole safetensors file of aerograsp, but it is corrupt ({reason})"
        ) from None
    except ValueError as error:
        raise CheckpointError(f"{path}: expected an aerograsp checkpoint (version {VERSION}), but {error}") from None
    return Checkpoint(path, tensors, card)


def _to_numpy(value: Any) -> NDArray:
    return value.detach().cpu().numpy() if hasattr(value, "detach") else np.asarray(value)


def _parse_card(text: str | None) -> dict[str, Any]:
    if text is None:
        raise ValueError("the file carries no card: it is another program's")
    try:
        card = json.loads(text)
    except json.JSONDecodeError:
        raise ValueError("its card is not JSON") from None
    if not isinstance(card, dict) or card.get("schema") != SCHEMA:
        raise ValueError(f"its card is not of the schema {SCHEMA!r}")
    if card.get("version") != VERSION:
        raise ValueError(f"its version is {card.get('version')!r}")
    return card


def _check(tensors: Mapping[str, NDArray], card: Mapping[str, Any], env_id: str | None) -> None:
    if not isinstance(card.get("env_id"), str):
        raise ValueError('its card names no "env_id"')
    if env_id is not None and card["env_id"] != env_id:
        raise ValueError(f"it is for {card['env_id']}, not {env_id}")
    for name, array in tensors.items():
        if np.issubdtype(array.dtype, np.floating) and not np.all(np.isfinite(array)):
            raise ValueError(f"tensor {name!r} is not finite")
    if str(card.get("kind", "")).startswith((SCORER_KIND, AIM_KIND, DETECTOR_KIND)):
        return  # their own modules check the weights against their layouts
    layout = NetworkLayout.from_card(card)
    base = card.get("base")
    if (base is not None) != (layout.keys[-1] == BASE_ACTION):
        raise ValueError(f'its "base" policy and the network\'s last key ({layout.keys[-1]!r}) contradict each other')
    if base is not None and not (
        isinstance(base, dict)
        and isinstance(base.get("env_id"), str)
        and isinstance(base.get("name"), str)
        and isinstance(base.get("scale"), int | float)
    ):
        raise ValueError('its "base" must be an object with env_id, name and scale')
    for name, shape in layout.shapes().items():
        if name not in tensors:
            raise ValueError(f"tensor {name!r} {shape} is missing")
        if tensors[name].shape != shape:
            raise ValueError(f"tensor {name!r} has shape {tensors[name].shape} where {shape} was expected")
    if np.any(tensors["observation.var"] < 0):
        raise ValueError("tensor 'observation.var' is negative")
