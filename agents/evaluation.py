"""Run a policy on pinned episodes and keep what every episode gave.

Episode k resets with `seed + k` and its policy state starts afresh, so a result depends neither on how many worlds
run side by side nor on whether the id has a native batched environment.
"""

import math
import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv
from numpy.typing import NDArray

from agents.arguments import Parser, add_env_kwargs, add_episodes, add_json, add_policy, add_seed, guarded
from agents.evaluation_result import EvaluationResult
from agents.files import write_json
from agents.policies import env_spec, load_policy, option_errors, registered_policies
from agents.seeds import TEST_SEED

if TYPE_CHECKING:
    from aerograsp_env.interfaces import Policy

MAX_WORLDS = 50  # worlds of the native batched environment stepped side by side, at most


def evaluate(
    env_id: str,
    policy: "Policy | str | Path",
    episodes: int = 100,
    seed: int = 0,
    env_kwargs: Mapping[str, Any] | None = None,
    progress: bool = False,
    num_envs: int | None = None,
) -> EvaluationResult:
    """Run a policy for some episodes; episode k resets with `seed + k`.

    Args:
        env_id: a registered id.
        policy: an object with `predict`, or what `load_policy` takes.
        episodes: number of episodes E ≥ 1.
        seed: of episode 0; reported figures use `agents.seeds.TEST_SEED`.
        env_kwargs: options of the environment; `max_episode_steps` too.
        progress: show a bar, if standard error is a terminal.
        num_envs: worlds side by side; 1 forces the single environment. By default as many as divide the work well,
            at most 50, where the id has a native batched environment, and else 1. The result is the same.

    Raises:
        ValueError: unknown id, policy or option; a number out of range; an action of the wrong shape.
    """
    spec = env_spec(env_id)
    for name, value, least in (
        ("episodes", episodes, 1),
        ("seed", seed, 0),
        ("num_envs", 1 if num_envs is None else num_envs, 1),
    ):
        if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
            raise ValueError(f"{name}: expected an integer of at least {least}, got {value!r}")
    kwargs = dict(env_kwargs or {})
    named = isinstance(policy, str | Path)
    actor: Any = load_policy(env_id, policy, kwargs) if isinstance(policy, str | Path) else policy
    if num_envs is None:
        native = spec.vector_entry_point is not None
        num_envs = math.ceil(episodes / math.ceil(episodes / MAX_WORLDS)) if native else 1
    env = make_worlds(env_id, min(num_envs, episodes), kwargs)
    try:
        log = _run(env, actor, episodes, int(seed), progress, str(policy) if named else type(actor).__name__)
    finally:
        env.close()
    return EvaluationResult(
        env_id=env_id,
        policy=str(policy) if named else type(actor).__name__,
        seed=int(seed),
        env_kwargs=kwargs,
        **log,
    )


def make_worlds(env_id: str, num_envs: int, env_kwargs: Mapping[str, Any]) -> VectorEnv:
    """N worlds behind one interface: the native batched environment if N > 1 and there is one, else single ones.

    Raises:
        UnknownName: no such id.
        ValueError: the environment does not take these options (UnknownName if it has none of that name).
    """
    spec = env_spec(env_id)
    native = num_envs > 1 and spec.vector_entry_point is not None
    options = dict(env_kwargs) if native else {"disable_env_checker": True, **env_kwargs}
    with option_errors(spec):
        env = gymnasium.make_vec(
            env_id, num_envs=num_envs, vectorization_mode="vector_entry_point" if native else "sync", **options
        )
    if env.metadata.get("autoreset_mode") is not AutoresetMode.NEXT_STEP:
        env.close()
        raise ValueError(f"{env_id}: expected autoreset_mode NEXT_STEP, got {env.metadata.get('autoreset_mode')}")
    return env


def worlds_of(env: VectorEnv) -> list[gymnasium.Env]:
    """The worlds side by side, without their wrappers: what an oracle (`aerograsp_env.interfaces.Oracle`) watches.

    Raises:
        ValueError: a native batched environment, which has no single ones.
    """
    if not isinstance(env, SyncVectorEnv):
        raise ValueError(f"env: expected single environments side by side for an oracle, got {type(env).__name__}")
    return [world.unwrapped for world in env.envs]


def _run(env: VectorEnv, policy: Any, episodes: int, seed: int, progress: bool, label: str) -> dict[str, Any]:
    from tqdm import tqdm

    worlds = env.num_envs
    if callable(watch := getattr(policy, "watch", None)):
        watch(worlds_of(env))  # an oracle
    action_shape = env.single_action_space.shape or ()
    success = np.zeros(episodes, dtype=np.bool_)
    returns = np.zeros(episodes)
    lengths = np.zeros(episodes, dtype=np.int64)
    terminations: list[str] = [""] * episodes
    metrics: dict[str, NDArray[np.float64]] = {}
    state = None  # carried from chunk to chunk: episode_start restarts its rows
    with tqdm(total=episodes, desc=label, unit="episode", leave=False, disable=None if progress else True) as bar:
        for first in range(0, episodes, worlds):
            observation, _ = env.reset(seed=seed + first)
            running = np.arange(first, first + worlds) < episodes  # the last chunk may have idle worlds
            start = np.ones(worlds, dtype=np.bool_)
            while running.any():
                action, state = policy.predict(observation, state=state, episode_start=start, deterministic=True)
                if np.shape(action) != (worlds, *action_shape):
                    raise ValueError(
                        f"policy {label}: expected actions of shape {(worlds, *action_shape)}, got {np.shape(action)}"
                    )
                observation, reward, terminated, truncated, info = env.step(action)
                start = np.zeros(worlds, dtype=np.bool_)
                ended = running & (terminated | truncated)
                recorded = first + np.flatnonzero(running)
                returns[recorded] += reward[running]
                lengths[recorded] += 1
                for world in np.flatnonzero(ended).tolist():
                    k = first + world
                    success[k] = bool(_entry(info, "success", world, False))
                    terminations[k] = str(_entry(info, "termination", world, "")) if terminated[world] else ""
                    for name, value in _entries(info.get("metrics", {}), world):
                        metrics.setdefault(name, np.full(episodes, np.nan))[k] = value
                running &= ~ended  # a world that has ended starts another episode, which nobody records
                bar.update(int(ended.sum()))
    return {
        "success": success,
        "returns": returns,
        "lengths": lengths,
        "terminations": np.array(terminations, dtype=np.str_),
        "metrics": metrics,
    }


def _entry(info: Mapping[str, Any], key: str, world: int, default: Any) -> Any:
    """One world's value of a batched info (Gymnasium's convention: a mask `_key` tells who has it)."""
    if key not in info or not info.get(f"_{key}", np.ones(world + 1, dtype=np.bool_))[world]:
        return default
    return info[key][world]


def _entries(info: Mapping[str, Any], world: int) -> list[tuple[str, float]]:
    names = [name for name in info if not (name.startswith("_") and name[1:] in info)]
    return [(name, float(_entry(info, name, world, np.nan))) for name in names]


def main(argv: list[str]) -> int:
    """`aerograsp eval ID`."""
    from agents.provenance import provenance
    from agents.report import Row, table_text

    parser = Parser(prog="aerograsp eval", description="Evaluate policies on pinned episodes.")
    parser.add_argument("id", metavar="ID", help="environment, e.g. aerograsp/Dock-v0")
    add_policy(parser, default="the first analytic policy of the id")
    add_episodes(parser)
    add_seed(parser, TEST_SEED)
    add_env_kwargs(parser)
    parser.add_argument("--num-envs", metavar="N", type=int, default=None, help="worlds side by side; the same result")
    add_json(parser)
    args = parser.parse_args(argv)
    env_spec(args.id)
    names = args.policies or list(registered_policies(args.id))[:1] or ["zero"]
    policies = [(name, load_policy(args.id, name, args.env_kwargs)) for name in names]  # refuse all before running any
    results = []
    for name, policy in policies:
        began = time.perf_counter()
        result = evaluate(args.id, policy, args.episodes, args.seed, args.env_kwargs, True, args.num_envs)
        results.append(replace(result, policy=name))
        print(f"{name}: {args.episodes} episodes in {time.perf_counter() - began:.1f} s", file=sys.stderr)
    if args.json != "-":
        print(table_text([Row.of(result) for result in results]))
    if args.json:
        write_json(
            args.json,
            {
                "provenance": provenance(" ".join(["aerograsp eval", *argv])),
                "results": [result.to_dict() for result in results],
            },
        )
    return 0


if __name__ == "__main__":
    sys.exit(guarded("aerograsp eval", main, sys.argv[1:]))
