"""The search for a controller's gains on training seeds.

Horizontal and vertical gains are searched for apart, by two evolution strategies that share their episodes: each is
judged by the errors of its own axes. Every generation flies new training seeds. At the end the gains found and those
shipped meet on validation seeds, and the better ones are returned.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from agents.evaluation import make_worlds
from agents.files import write_json
from agents.policies import UnknownName, env_spec
from agents.search import Search
from agents.seeds import TRAIN_SEED, VALIDATION_SEED
from baselines.policies import dock

Array = NDArray[np.float64]

STEP = dock.STEP  # [s]
CONDITIONS: dict[str, Any] = {"wind": "gusty", "command_delay": (0.06, 0.1)}
CRASH_COST = 0.5  # of an episode that ends early [m]
EFFORT_WEIGHT = 0.02  # [m] per unit of rms change of the action in a step
SETTLING = 5.0  # errors count from here [s]


class Tunable(NamedTuple):
    """A policy made from named gains, each a pair (horizontal, vertical)."""

    make: Callable[[Mapping[str, Any]], Any]
    bounds: dict[str, tuple[float, float]]  # of what is searched for; other gains stay as shipped


TUNABLE: dict[str, dict[str, Tunable]] = {
    "aerograsp/Dock-v0": {
        "pid-tuned": Tunable(
            dock.pid_from_gains,
            {"kp": (0.1, 10.0), "ki": (0.01, 10.0), "kd": (0.01, 5.0), "derivative_time_constant": (0.01, 1.0)},
        ),
        "lqg": Tunable(
            dock.lqg_from_gains,
            {
                "lag": (0.02, 1.0),
                "bias_std": (0.001, 0.5),
                "disturbance_std": (0.005, 5.0),
                "disturbance_time": (0.3, 100.0),
                "position_std": (1e-4, 0.05),
                "change_weight": (1e-5, 1.0),
            },
        ),
    }
}


class Flight(NamedTuple):
    """What a batch of E episodes gave."""

    error: Array  # (E, 3) mean |true error| after SETTLING [m]
    effort: Array  # (E, 3) rms change of the action in a step
    crashed: NDArray[np.bool_]  # (E,)

    def cost(self) -> Array:
        """(2,) horizontal and vertical cost [m]: mean error, crashes, and a little effort."""
        error = np.where(self.crashed[:, None], CRASH_COST, self.error)
        axes = (error + EFFORT_WEIGHT * self.effort).mean(axis=0)
        return np.array([0.5 * (axes[0] + axes[1]), axes[2]])

    def summary(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "error": self.error.mean(axis=0),
            "effort": self.effort.mean(axis=0),
            "crash": float(self.crashed.mean()),
            "cost": self.cost(),
        }


@dataclass(frozen=True)
class Settings:
    """What a search depends on; a saved one goes on only if all of it is equal."""

    env_id: str
    policy: str
    episodes: int = 10  # a candidate
    seconds: float = 20.0
    iterations: int = 12
    population: int = 12
    seed: int = TRAIN_SEED
    env_kwargs: Mapping[str, Any] = field(default_factory=lambda: dict(CONDITIONS))

    def __post_init__(self) -> None:
        env_spec(self.env_id)
        if self.env_id not in TUNABLE:
            raise UnknownName("id to tune", self.env_id, TUNABLE)
        if self.policy not in TUNABLE[self.env_id]:
            raise UnknownName(f"policy to tune for {self.env_id}", self.policy, TUNABLE[self.env_id])
        if self.population < 4:
            raise ValueError(f"population: expected an integer of at least 4, got {self.population}")
        if not SETTLING + 1.0 <= self.seconds <= 600.0:
            raise ValueError(
                f"seconds: expected {SETTLING + 1.0:g} to 600 (errors count from {SETTLING:g} s), got {self.seconds}"
            )

    @property
    def tunable(self) -> Tunable:
        return TUNABLE[self.env_id][self.policy]


def fly(env: VectorEnv, policy: Any, seed: int, steps: int) -> Flight:
    """Run one episode of at most `steps` in every world; world i resets with `seed + i`."""
    worlds = env.num_envs
    observation, _ = env.reset(seed=seed)
    state, start = None, np.ones(worlds, dtype=np.bool_)
    error, crashed = np.zeros((worlds, 3)), np.zeros(worlds, dtype=np.bool_)
    squared, previous = np.zeros((worlds, 3)), np.zeros((worlds, 3))
    for _ in range(steps):
        action, state = policy.predict(observation, state=state, episode_start=start, deterministic=True)
        observation, _, terminated, _, info = env.step(action)
        start = np.zeros(worlds, dtype=np.bool_)
        squared += (action - previous) ** 2
        previous = action
        figures = [info["metrics"][f"error_{axis}"] for axis in "xyz"]
        error = np.where(crashed[:, None], error, np.stack(figures, axis=1))
        crashed |= terminated
    return Flight(error, np.sqrt(squared / steps), crashed)


def gains_from(tunable: Tunable, base: Mapping[str, Any], horizontal: Array, vertical: Array) -> dict[str, list[float]]:
    """Named pairs: `base` with what is searched for replaced, to four digits."""
    found = {
        name: [float(f"{h:.4g}"), float(f"{v:.4g}")]
        for name, h, v in zip(tunable.bounds, horizontal, vertical, strict=True)
    }
    return {**base, **found}


def shipped_gains(policy: str) -> dict[str, list[float]]:
    """The gains that come with the project, as pairs; what they leave out is the model's default."""
    gains = dict(dock._tuned(policy))
    if policy == "lqg":
        from baselines.control.lqg import AxisModel

        for name in TUNABLE["aerograsp/Dock-v0"]["lqg"].bounds:
            gains.setdefault(name, getattr(AxisModel(), name))
    return {name: np.broadcast_to(np.asarray(value, dtype=float), (2,)).tolist() for name, value in gains.items()}


def tune(settings: Settings, state_file: Path | None = None, progress: bool = False) -> dict[str, Any]:
    """Search for gains; returns {"gains", "before", "after", "improved", …}, the entry that is written.

    Args:
        settings: what to search with.
        state_file: where the state is kept after each generation, and read from if it is there.
        progress: a bar on standard error, if that is a terminal.

    Raises:
        ValueError: settings that do not fit; a state file of another search.
    """
    from tqdm import tqdm

    tunable, base = settings.tunable, shipped_gains(settings.policy)
    bounds = np.array(list(tunable.bounds.values()))
    searches = [Search.start(np.array([base[name][k] for name in tunable.bounds]), bounds) for k in (0, 1)]
    first = 0
    curve: list[list[float]] = []
    if state_file is not None and state_file.exists():
        first, curve, searches = _resume(state_file, settings)
    steps = round(settings.seconds / STEP)
    options = {**settings.env_kwargs, "max_episode_steps": steps + 1}  # the batch is cut by `steps`, before it resets
    env = make_worlds(settings.env_id, max(settings.episodes, 2), options)
    total = settings.iterations * settings.population
    try:
        with tqdm(
            total=total, initial=first * settings.population, desc=settings.policy, unit="candidate", leave=False,
            disable=None if progress else True,
        ) as bar:  # fmt: skip
            for generation in range(first, settings.iterations):
                rng = np.random.default_rng([settings.seed, generation])
                tried = [search.ask(settings.population, rng) for search in searches]
                costs = np.full((settings.population, 2), np.inf)
                for i in range(settings.population):
                    gains = gains_from(tunable, base, tried[0][i], tried[1][i])
                    seed = settings.seed + generation * env.num_envs
                    costs[i] = _cost(env, tunable, gains, seed, steps)
                    bar.update(1)
                searches = [search.tell(tried[k], costs[:, k]) for k, search in enumerate(searches)]
                curve.append(np.median(costs, axis=0).tolist())
                bar.set_postfix_str("median cost {:.1f} and {:.1f} mm".format(*(1000.0 * c for c in curve[-1])))
                if state_file is not None:
                    write_json(state_file, _state(settings, generation + 1, curve, searches))
    finally:
        env.close()
    found = gains_from(tunable, base, searches[0].values, searches[1].values)
    before, after = (_validate(settings, tunable, gains) for gains in (base, found))
    improved = bool(after.cost().mean() < before.cost().mean())
    seeds = settings.seed, settings.seed + settings.iterations * max(settings.episodes, 2) - 1
    return {
        "gains": found if improved else base,
        "improved": improved,
        "found": found,
        "before": before.summary(),
        "after": after.summary(),
        "curve": curve,
        "settings": asdict(settings),
        "training_seeds": seeds,
        "validation_seeds": (VALIDATION_SEED, VALIDATION_SEED + VALIDATION_EPISODES - 1),
    }


VALIDATION_EPISODES = 20


def _cost(env: VectorEnv, tunable: Tunable, gains: Mapping[str, Any], seed: int, steps: int) -> Array:
    try:
        policy = tunable.make(gains)
    except ValueError:  # no regulator exists for such weights
        return np.full(2, np.inf)
    return fly(env, policy, seed, steps).cost()


def _validate(settings: Settings, tunable: Tunable, gains: Mapping[str, Any]) -> Flight:
    steps = round(settings.seconds / STEP)
    env = make_worlds(settings.env_id, VALIDATION_EPISODES, {**settings.env_kwargs, "max_episode_steps": steps + 1})
    try:
        return fly(env, tunable.make(gains), VALIDATION_SEED, steps)
    finally:
        env.close()


def _state(settings: Settings, generation: int, curve: list, searches: list[Search]) -> dict[str, Any]:
    return {
        "settings": asdict(settings),
        "generation": generation,
        "curve": curve,
        "searches": [search.to_dict() for search in searches],
    }


def _resume(path: Path, settings: Settings) -> tuple[int, list, list[Search]]:
    try:
        data = json.loads(path.read_text())
        same = data["settings"] == json.loads(json.dumps(asdict(settings)))
        state = int(data["generation"]), list(data["curve"]), [Search.from_dict(s) for s in data["searches"]]
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path}: not the state of a search ({error}); delete it") from error
    if not same:
        raise ValueError(f"{path}: the state of a search with other settings; repeat those, or delete it")
    return state
