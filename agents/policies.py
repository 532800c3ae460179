"""Policies by name: zero, random, the analytic ones, shipped checkpoints, weight files and user factories.

Nothing here imports torch: checkpoints are handed to `agents.network_policy` when they are loaded.
"""

import difflib
import importlib
import inspect
import json
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
from gymnasium.envs.registration import EnvSpec, load_env_creator
from gymnasium.spaces import Space

from agents.trivial_policies import RandomPolicy, ZeroPolicy

if TYPE_CHECKING:
    from aerograsp_env.interfaces import Policy

NAMESPACE = "aerograsp/"
CHECKPOINTS = Path(__file__).parent / "checkpoints"
TRIVIAL = ("zero", "random")
MIXED = {"aerograsp/Detect-v0": {"cnn+icp": "agents.detect_cnn_icp:cnn_icp"}}
"""Policies in which a network has a part: by id, name → "module:factory"."""
LEARNED = ("ppo", "ppo-residual", "sac", "sac-her", "sac-residual", "learned")


class UnknownName(ValueError):
    """An id, a policy or another name that does not exist; the message lists the names that do."""

    def __init__(self, what: str, name: str, valid: Iterable[str]) -> None:
        names = list(valid)
        near = difflib.get_close_matches(name, names, n=3, cutoff=0.5)
        hint = f"did you mean {' or '.join(map(repr, near))}? " if near else ""
        super().__init__(f"unknown {what} {name!r}; {hint}valid: {', '.join(names) or 'none'}")


class PolicyUnavailable(ValueError):
    """A policy that is known by name but cannot be loaded here: no checkpoint, or an extra is not installed."""


def env_ids() -> list[str]:
    """All ids of this project, sorted."""
    importlib.import_module("aerograsp_env")  # registers them
    return sorted(id for id in gymnasium.registry if id.startswith(NAMESPACE))


def env_spec(env_id: str) -> EnvSpec:
    """The registered specification of any id (other projects' ids too).

    Raises:
        UnknownName: not registered.
    """
    ids = env_ids()
    if env_id not in gymnasium.registry:
        raise UnknownName("id", str(env_id), ids)
    return gymnasium.registry[env_id]


@contextmanager
def option_errors(spec: EnvSpec) -> Iterator[None]:
    """Turns Python's complaint about an unknown environment option into an `UnknownName` that lists the options."""
    try:
        yield
    except TypeError as error:
        unexpected = re.search(r"unexpected keyword argument '(\w+)'", str(error))
        if unexpected is None or spec.entry_point is None:
            raise
        creator = spec.entry_point if callable(spec.entry_point) else load_env_creator(spec.entry_point)
        valid = [*inspect.signature(creator).parameters, "max_episode_steps"]
        raise UnknownName(f"option of {spec.id}", unexpected[1], valid) from error


def registered_policies(env_id: str) -> dict[str, str]:
    """The analytic and the mixed policies of an id: name → "module:factory"; empty for ids of other projects."""
    from baselines.policies import POLICIES

    return {**POLICIES.get(env_id, {}), **MIXED.get(env_id, {})}


def policy_names(env_id: str) -> list[str]:
    """Every name that `load_policy` takes for this id, paths and factories aside."""
    env_spec(env_id)
    return [*TRIVIAL, *registered_policies(env_id), *checkpoints(env_id)]


def checkpoints(env_id: str) -> dict[str, Path]:
    """Shipped checkpoints by name: every training seed ("ppo-seed0"), and "ppo" for the best of its seeds.

    The best has the lowest "validation_error" [m] in its JSON card (measured on validation seeds, never on test
    seeds), or "validation_score" where the task has no error; cards without come last, in order of their names.
    """
    prefix = env_id.removeprefix(NAMESPACE).replace("/", "-").lower() + "-"
    found = {path.stem.removeprefix(prefix): path for path in sorted(CHECKPOINTS.glob(f"{prefix}*.safetensors"))}
    for kind in LEARNED:
        seeds = [path for name, path in found.items() if re.fullmatch(rf"{kind}-seed\d+", name)]
        if seeds and kind not in found:
            found[kind] = min(seeds, key=_validation_error)
    return dict(sorted(found.items()))


def _validation_error(path: Path) -> float:
    try:
        card = json.loads(path.with_suffix(".json").read_text())
    except (OSError, ValueError):
        return float("inf")
    figures = (card.get("validation_error"), card.get("validation_score"))
    return next((float(figure) for figure in figures if isinstance(figure, int | float)), float("inf"))


def load_policy(env_id: str, name_or_path: str | Path, env_kwargs: Mapping[str, Any] | None = None) -> "Policy":
    """The policy of an id by name.

    Args:
        env_id: a registered id.
        name_or_path: "zero"; "random"; an analytic policy of the id, e.g. "pid"; a shipped checkpoint, e.g. "ppo" or
            "ppo-seed1"; the path of a .safetensors file; or "module:function", a factory without arguments.
        env_kwargs: the environment's options, where they change its spaces ("zero" and "random" look at them).

    Raises:
        UnknownName: no such id or name; lists the nearest and all valid ones.
        PolicyUnavailable: no checkpoint is shipped under that name, or the `learn` extra is missing.
        FileNotFoundError: no such .safetensors file.
    """
    env_spec(env_id)
    name = str(name_or_path)
    if name in TRIVIAL:
        action_space, observation_space = spaces(env_id, env_kwargs)
        if name == "zero":
            return ZeroPolicy(action_space, observation_space)
        return RandomPolicy(action_space, observation_space)
    registered = registered_policies(env_id)
    if name in registered:
        return _from_factory(registered[name])
    if name.endswith(".safetensors"):
        return _from_checkpoint(Path(name))
    shipped = checkpoints(env_id)
    if name in shipped:
        return _from_checkpoint(shipped[name])
    if name in LEARNED:
        raise PolicyUnavailable(
            f"policy {name!r}: no checkpoint is shipped for {env_id}; train one and pass its .safetensors path"
        )
    if re.fullmatch(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*", name):
        return _from_factory(name)
    raise UnknownName(
        f"policy of {env_id}", name, [*TRIVIAL, *registered, *shipped, "PATH.safetensors", "module:function"]
    )


def _from_factory(path: str) -> "Policy":
    module_name, _, attribute = path.partition(":")
    if "" not in sys.path and str(Path.cwd()) not in sys.path:
        sys.path.append(str(Path.cwd()))  # a console script does not look in the working directory, `python -m` does
    try:
        module = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        if error.name is None or not (module_name == error.name or module_name.startswith(f"{error.name}.")):
            raise PolicyUnavailable(f"policy {path!r}: {error}") from error  # a dependency of the module
        raise ValueError(f"policy {path!r}: no module {module_name!r}, neither installed nor in this folder") from error
    if not hasattr(module, attribute):
        public = [name for name in vars(module) if not name.startswith("_") and callable(getattr(module, name))]
        raise UnknownName(f"function of module {module_name!r}", attribute, public)
    policy = getattr(module, attribute)()
    if not callable(getattr(policy, "predict", None)):
        raise ValueError(
            f"policy {path!r}: expected a factory of an object with predict(), it made a {type(policy).__name__}"
        )
    return policy


def _from_checkpoint(path: Path) -> "Policy":
    if not path.is_file():
        raise FileNotFoundError(f"policy: no such file: {path}")
    try:
        kind = _kind(path)
        if kind.startswith("grasp-scorer"):
            from agents.grasp_policy import load_grasp_policy

            return load_grasp_policy(path)
        if kind.startswith("grasp-aim"):
            from agents.aim_policy import load_aim_policy

            return load_aim_policy(path)
        from agents.network_policy import load_network_policy
    except ModuleNotFoundError as error:
        raise PolicyUnavailable(f"policy {path.name!r}: {error}; install the extra: aerograsp[learn]") from error
    return load_network_policy(path)


def _kind(path: Path) -> str:
    """What the card beside a checkpoint says that it is; what is inside is checked when it is loaded."""
    try:
        return str(json.loads(path.with_suffix(".json").read_text()).get("kind", ""))
    except (OSError, ValueError):
        return ""


def spaces(env_id: str, env_kwargs: Mapping[str, Any] | None = None) -> tuple[Space, Space]:
    """The action and the observation space of an id with these options.

    Raises:
        UnknownName: no such id or option.
    """
    with option_errors(env_spec(env_id)):
        env = gymnasium.make(env_id, disable_env_checker=True, **(env_kwargs or {}))
    try:
        return env.action_space, env.observation_space
    finally:
        env.close()
