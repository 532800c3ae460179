"""Options of a training by soft actor-critic."""

import math
from dataclasses import dataclass
from typing import ClassVar

from agents.train_config import RunConfig, option


@dataclass(frozen=True)
class SacConfig(RunConfig):
    """Hyper-parameters of SAC (Haarnoja et al. 2018) and of the run. A value out of range is a ValueError.

    Where the observation has goals (and no base policy acts on them), experience is replayed with the goals of
    hindsight too (HER, Andrychowicz et al. 2017): `goals` made-up transitions for each one that happened, their goal
    a position that was reached later in the episode and their reward the environment's `compute_reward`.
    """

    num_envs: int = option(8, "worlds side by side")
    hidden: tuple[int, ...] = option((128, 128), "widths of the hidden layers, of actor and critics each")
    activation: str = option("relu", "tanh or relu")
    learning_rate: float = option(1e-3, "Adam's, at the start")
    final_learning_rate: float = option(1e-4, "at the end; linear in between")
    gamma: float = option(0.95, "discount factor a step")
    batch_size: int = option(512, "transitions a gradient step")
    checkpoint_every: int = option(
        100_000, "steps between checkpoints; the worlds restart there, so that resuming is exact"
    )
    eval_every: int = option(50_000, "steps between evaluations on the validation seeds")
    goals: int = option(4, "goals of hindsight a transition, where the observation has goals; 0: never")
    replay_size: int = option(500_000, "transitions that are remembered")
    replay_saved: bool = option(True, "store the replay buffer beside the checkpoint; without, a resumed one is empty")
    learning_starts: int = option(5_000, "steps before the first gradient step, by random actions")
    gradient_steps: int = option(2, "gradient steps for each step of all worlds")
    tau: float = option(0.005, "share of the critics that their targets take on at a gradient step")
    entropy: float = option(0.1, "initial temperature, i.e. weight of the entropy; it is adapted from there")
    target_entropy: float | None = option(None, "entropy that the temperature is adapted to; none: minus the actions")

    FAMILY: ClassVar[str] = "sac"

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_integers(1, "replay_size", "gradient_steps")
        self._check_integers(0, "goals", "learning_starts")
        if self.replay_size < self.num_envs:
            raise ValueError(
                f"replay_size: expected at least a transition a world, {self.num_envs}, got {self.replay_size}"
            )
        self._check_number("entropy", math.ulp(0.0), math.inf)
        self._check_number("tau", math.ulp(0.0), 1.0)
        if self.target_entropy is not None:
            self._check_number("target_entropy", -math.inf, math.inf)
