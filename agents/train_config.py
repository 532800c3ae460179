"""A training's options, typed, validated and turned into command-line options, and what it results in."""

import argparse
import math
from collections.abc import Mapping
from dataclasses import MISSING, Field, asdict, dataclass, field, fields
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, Self

from agents.arguments import add_env_kwargs
from agents.checkpoint import ACTIVATIONS
from agents.derived_inputs import DERIVED

LATEST, BEST = "latest.safetensors", "best.safetensors"
AUTO = "auto"
UNREAD = ("object_cloud",)  # observations that are no input of a perceptron: an object's model, constant in an episode


class TrainingInterrupted(KeyboardInterrupt):
    """Ctrl-C, after a checkpoint was written; the message says how to resume."""


@dataclass(frozen=True)
class TrainResult:
    """What a finished training left behind."""

    out: Path
    steps: int
    wall_time: float  # [s], over all resumed parts
    seconds_per_million_steps: float  # [s], this part, evaluations left out
    best: dict[str, Any] | None  # the curve's best row; None if never evaluated
    curve: list[dict[str, Any]]


def option(default: Any, text: str) -> Any:
    """A configuration's field, with what `--help` says of it."""
    return field(default=default, metadata={"help": text})


@dataclass(frozen=True)
class RunConfig:
    """What every algorithm's configuration has: the run's options, apart from how it learns."""

    steps: int = option(1_000_000, "environment steps in all, over all worlds (a resumed run's earlier ones included)")
    num_envs: int = option(64, "worlds side by side")
    seed: int = option(0, "of the network, the sampling and the worlds")
    keys: tuple[str, ...] = option(
        (),
        f"observation keys the network reads, in this order; none: all but {', '.join(UNREAD)}, and where there are "
        f"goals {' and '.join(DERIVED)}",
    )
    residual: str | None = option(None, "name of the analytic policy to correct; none: the network acts alone")
    residual_scale: float = option(0.3, "what the correction is multiplied by before it is added to the base action")
    hidden: tuple[int, ...] = option((64, 64), "widths of the hidden layers, of actor and critic each")
    activation: str = option("tanh", " or ".join(ACTIVATIONS))
    learning_rate: float = option(3e-4, "Adam's, at the start")
    final_learning_rate: float = option(0.0, "at the end; linear in between")
    gamma: float = option(0.99, "discount factor a step")
    batch_size: int = option(2048, "minibatch size")
    normalize_reward: bool = option(False, "divide rewards by the running deviation of the return (training only)")
    clip_observation: float = option(10.0, "bound of the normalised observation")
    checkpoint_every: int = option(
        500_000, "steps between checkpoints; the worlds restart there, so that resuming is exact"
    )
    eval_every: int = option(500_000, "steps between evaluations on the validation seeds")
    eval_episodes: int = option(20, "episodes of an evaluation; 0: never evaluate")
    metric: str = option(
        AUTO,
        "metric by which the best policy is kept (lower is better), or success, or return; auto: error where the id "
        "reports it, else success",
    )
    crash_penalty: float = option(1.0, "added to the metric of an episode that crashes")
    threads: int = option(1, "torch's")
    env_kwargs: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))

    FAMILY: ClassVar[str] = ""  # "ppo" or "sac"

    def __post_init__(self) -> None:
        for name in ("keys", "hidden"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        # A card gives lists back where the command line gave tuples: both are one configuration.
        object.__setattr__(self, "env_kwargs", {key: _tuples(value) for key, value in self.env_kwargs.items()})
        self._check_integers(1, "steps", "num_envs", "checkpoint_every", "eval_every", "threads")
        self._check_integers(2, "batch_size")  # PPO's advantages are normalised within a minibatch
        self._check_integers(0, "seed", "eval_episodes")
        if not all(isinstance(width, int) and width > 0 for width in self.hidden):
            raise ValueError(f"hidden: expected positive widths, got {self.hidden}")
        if self.activation not in ACTIVATIONS:
            raise ValueError(f"activation: expected {' or '.join(ACTIVATIONS)}, got {self.activation!r}")
        for name in ("learning_rate", "clip_observation", "residual_scale"):
            self._check_number(name, math.ulp(0.0), math.inf)
        for name in ("final_learning_rate", "crash_penalty"):
            self._check_number(name, 0.0, math.inf)
        self._check_number("gamma", 0.0, 1.0)
        if self.seed >= 2**32:
            raise ValueError(f"seed: expected less than 2**32, got {self.seed}")

    def _check_integers(self, minimum: int, *names: str) -> None:
        for name in names:
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or value < minimum:
                raise ValueError(f"{name}: expected an integer of at least {minimum}, got {value!r}")

    def _check_number(self, name: str, low: float, high: float) -> None:
        value = getattr(self, name)
        if (
            isinstance(value, bool)
            or not isinstance(value, int | float)
            or not low <= value <= high
            or math.isinf(value)
        ):
            kind = "a finite positive number" if low > 0 else f"a finite number in [{low:g}, {high:g}]"
            raise ValueError(f"{name}: expected {kind}, got {value!r}")

    @property
    def algorithm(self) -> str:
        """The family's name, with "-residual" where an analytic policy is corrected."""
        return self.FAMILY if self.residual is None else f"{self.FAMILY}-residual"

    def to_card(self) -> dict[str, Any]:
        """The configuration as a JSON object (if `env_kwargs` is)."""
        return asdict(self)

    @classmethod
    def from_card(cls, card: Mapping[str, Any], **changes: Any) -> Self:
        """Read what `to_card` wrote, with some fields changed. Raises ValueError on unknown fields."""
        known = {item.name for item in fields(cls)}
        unknown = sorted(set(card) - known)
        if unknown:
            raise ValueError(f"config: unknown fields {', '.join(unknown)}")
        return cls(**{**card, **changes})


@dataclass(frozen=True)
class TrainConfig(RunConfig):
    """Hyper-parameters of PPO (Schulman et al. 2017) and of the run. A value out of range is a ValueError."""

    log_std: float = option(-1.0, "initial log standard deviation of the action")
    sde_hold: int = option(
        0, "steps that exploration by a random function of the state (gSDE, Raffin et al. 2021) is held; 0: white noise"
    )
    n_steps: int = option(128, "steps a world and rollout")
    epochs: int = option(10, "passes over a rollout")
    gae_lambda: float = option(0.95, "λ of the generalised advantage estimate")
    clip_range: float = option(0.2, "PPO's ε")
    target_kl: float | None = option(None, "stop an update's epochs beyond 1.5 times this KL divergence; none: never")
    entropy: float = option(0.0, "weight of the entropy bonus")
    value_weight: float = option(0.5, "weight of the value loss")
    max_grad_norm: float = option(0.5, "gradient clipping")

    FAMILY: ClassVar[str] = "ppo"

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_integers(1, "n_steps", "epochs")
        self._check_integers(0, "sde_hold")
        for name in ("clip_range", "max_grad_norm"):
            self._check_number(name, math.ulp(0.0), math.inf)
        for name in ("entropy", "value_weight"):
            self._check_number(name, 0.0, math.inf)
        self._check_number("gae_lambda", 0.0, 1.0)
        self._check_number("log_std", -20.0, 2.0)
        if self.target_kl is not None:
            self._check_number("target_kl", math.ulp(0.0), math.inf)
        if (self.num_envs * self.n_steps) % self.batch_size:
            raise ValueError(
                f"batch_size: expected a divisor of num_envs * n_steps = {self.num_envs * self.n_steps}, "
                f"got {self.batch_size}"
            )


def add_config(parser: argparse.ArgumentParser, title: str, kind: type[RunConfig] = TrainConfig) -> None:
    """One option a field of the configuration `kind`. Only those given appear in the parsed namespace."""
    group = parser.add_argument_group(title)
    for item in fields(kind):
        if item.name != "env_kwargs":
            _add_field(group, item)
    add_env_kwargs(parser)
    parser.set_defaults(env_kwargs=None)


def given_options(arguments: argparse.Namespace, kind: type[RunConfig] = TrainConfig) -> dict[str, Any]:
    """The fields of the configuration `kind` that the command line sets."""
    names = {item.name for item in fields(kind)}
    return {name: value for name, value in vars(arguments).items() if name in names and value is not None}


def _add_field(parser: argparse._ArgumentGroup, item: Field) -> None:
    default = item.default
    assert default is not MISSING
    flag = "--" + item.name.replace("_", "-")
    if isinstance(default, bool):
        text = f"{item.metadata['help']} (default: {'yes' if default else 'no'})"
        parser.add_argument(flag, action=argparse.BooleanOptionalAction, default=argparse.SUPPRESS, help=text)
        return
    kind: Any
    if isinstance(default, tuple):
        kind, name = (_widths, "N,N") if item.name == "hidden" else (_words, "KEY,KEY")
        shown = ",".join(map(str, default)) or "none"
    elif item.name == "residual":
        kind, name, shown = str, "BASE", "none"
    elif default is None or isinstance(default, float):
        kind, name, shown = float, "X", "none" if default is None else f"{default:g}"
    elif isinstance(default, int):
        kind, name, shown = _integer, "N", str(default)
    else:
        kind, name, shown = str, "NAME", default
    text = f"{item.metadata['help']} (default: {shown})"
    parser.add_argument(flag, metavar=name, type=kind, default=argparse.SUPPRESS, help=text)


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list | tuple) else value


def _integer(text: str) -> int:
    """An integer, also as 2_000_000 or 2e6."""
    try:
        value = float(text)
        if value != int(value):
            raise ValueError
        return int(text) if "e" not in text.lower() else int(value)
    except (ValueError, OverflowError):
        raise argparse.ArgumentTypeError(f"expected an integer, got {text!r}") from None


def _widths(text: str) -> tuple[int, ...]:
    return tuple(_integer(part) for part in text.split(",") if part)


def _words(text: str) -> tuple[str, ...]:
    return tuple(part.strip() for part in text.split(",") if part.strip())
