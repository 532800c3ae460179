"""`aerograsp smoke`: contract checks of policies over a few short episodes, quick enough for every CI run.

| check | what must hold |
| --- | --- |
| actions | dtype, shape and bounds of the action space; finite |
| worlds | observations lie in their space, rewards are finite |
| determinism | two runs with fresh policies give the same actions and rewards |
| batch | rows side by side, and a single unbatched one, give the actions of each row alone |
| restart | `episode_start` makes the state forget the last episode ("random" goes on in its stream by design) |
| floor | the id's own policies succeed in at least half of the episodes; not those that are `WEAK` by design |

An oracle looks at its world, not at observations (`aerograsp_env.interfaces.Oracle`): recorded ones say nothing about
it, so that batch and restart, which replay them, are left out.
"""

import math
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from agents.arguments import FAILED, Parser, add_json, add_policy, add_seed, guarded, one_line, positive_int
from agents.files import write_json
from agents.policies import checkpoints, env_ids, env_spec, load_policy, policy_names, registered_policies
from agents.provenance import provenance
from agents.seeds import VALIDATION_SEED

CHECKS = ("actions", "worlds", "determinism", "batch", "restart", "floor")
EPISODES, STEPS = 3, 750
LONGER = {"aerograsp/DockAttach-v0": 1500}  # ids that need more steps to succeed
FLOOR = 0.5
WEAK = {"aerograsp/GraspPlan-v0": ("gpis-constant", "cloud", "com", "random-eligible")}  # what others are measured by
_TOLERANCE = 1e-5  # on actions, between batch sizes: sums may be ordered differently


@dataclass(frozen=True)
class SmokeRow:
    """One policy on one id: the failed checks, each with what was seen."""

    env_id: str
    policy: str
    failures: dict[str, str] = field(default_factory=dict)
    success: float = float("nan")  # rate over the episodes
    floor: float = 0.0  # success rate required
    oracle: bool = False  # looks at its world
    seconds: float = 0.0

    @property
    def passed(self) -> bool:
        return not self.failures


class _Episode(NamedTuple):
    observations: list[Any]  # T, each unbatched
    actions: NDArray  # (T, n)
    rewards: NDArray  # (T,)
    success: bool


def smoke(
    ids: Sequence[str] | None = None,
    policies: Sequence[str] | None = None,
    episodes: int = EPISODES,
    steps: int | None = None,
    seed: int = VALIDATION_SEED,
    floor: float = FLOOR,
    progress: bool = False,
) -> list[SmokeRow]:
    """Check policies on ids.

    Args:
        ids: registered ids; by default all of this project.
        policies: names for `load_policy`; by default zero, random and every analytic and shipped one. Given names are
            tried on the ids that have them, "module:function" and paths on all.
        episodes: episodes a run.
        steps: time limit of an episode; by default long enough to succeed.
        seed: of episode 0.
        floor: success rate that the id's own policies must reach, `WEAK` ones aside.
        progress: a bar, if standard error is a terminal.

    Raises:
        ValueError: unknown id, or a policy that none of the ids has.
    """
    from tqdm import tqdm

    chosen = list(ids or env_ids())
    pairs = [(env_id, name) for env_id in chosen for name in _names(env_id, policies)]
    for name in policies or ():  # a name that is wrong is the caller's mistake, not a failed check
        load_policy(next((env_id for env_id, other in pairs if other == name), chosen[0]), name)
    rows = []
    for env_id, name in tqdm(pairs, desc="smoke", leave=False, disable=None if progress else True):
        limit = steps or min(env_spec(env_id).max_episode_steps or STEPS, LONGER.get(env_id, STEPS))
        own = name in registered_policies(env_id) or name in checkpoints(env_id)
        required = floor if own and name not in WEAK.get(env_id, ()) else 0.0
        rows.append(check(env_id, name, episodes, limit, seed, required))
    return rows


def _names(env_id: str, policies: Sequence[str] | None) -> list[str]:
    known = policy_names(env_id)
    if policies is None:
        return known
    return [name for name in policies if name in known or ":" in name or name.endswith(".safetensors")]


def check(env_id: str, name: str, episodes: int, steps: int, seed: int, floor: float) -> SmokeRow:
    """Run all checks of one policy on one id. What the policy raises, loading it included, is a failed check, "run"."""
    began = time.perf_counter()
    env = gymnasium.make(env_id, disable_env_checker=True, max_episode_steps=steps)
    failures: dict[str, str] = {}
    rate, oracle = float("nan"), False
    try:
        policy = load_policy(env_id, name)
        oracle = callable(getattr(policy, "watch", None))
        first = _run(env, policy, episodes, seed, failures)
        rate = float(np.mean([episode.success for episode in first]))
        if not failures:
            again = _run(env, load_policy(env_id, name), episodes, seed, {})
            _compare_runs(first, again, failures)
            if not oracle:
                _compare_batch(load_policy(env_id, name), first, failures)
            if name != "random" and not oracle:
                _compare_restart(load_policy(env_id, name), first[0], failures)
            if rate < floor:
                failures["floor"] = f"success {rate:.2f}, expected at least {floor:.2f}"
    except Exception as error:
        failures["run"] = f"{type(error).__name__}: {one_line(error)}"
    finally:
        env.close()
    return SmokeRow(env_id, name, failures, rate, floor, oracle, time.perf_counter() - began)


def _run(env: gymnasium.Env, policy: Any, episodes: int, seed: int, failures: dict[str, str]) -> list[_Episode]:
    """Play the episodes, one row a batch, the state carried on; stops at the first faulty action."""
    played = []
    if callable(watch := getattr(policy, "watch", None)):
        watch([env.unwrapped])
    state, space = None, env.action_space
    shape = (1, *(space.shape or ()))
    for k in range(episodes):
        observation, info = env.reset(seed=seed + k)
        observations: list[Any] = []
        actions: list[NDArray] = []
        rewards: list[float] = []
        done = False
        start = np.array([True])
        while not done:
            if not env.observation_space.contains(observation):
                failures.setdefault("worlds", f"step {len(rewards)}: an observation is outside its space")
            observations.append(observation)
            action, state = policy.predict(_batch([observation]), state=state, episode_start=start, deterministic=True)
            fault = _fault(action, space, shape)
            if fault:
                failures["actions"] = f"step {len(rewards)}: {fault}"
                break
            actions.append(action[0])
            observation, reward, terminated, truncated, info = env.step(action[0])
            if not math.isfinite(reward):
                failures.setdefault("worlds", f"step {len(rewards)}: reward {reward}")
            rewards.append(float(reward))
            start, done = np.array([False]), terminated or truncated
        played.append(_Episode(observations, np.array(actions), np.array(rewards), bool(info.get("success", False))))
        if "actions" in failures:
            break
    return played


def _fault(action: Any, space: Any, shape: tuple[int, ...]) -> str:
    if not isinstance(action, np.ndarray):
        return f"expected an array, got {type(action).__name__}"
    if action.shape != shape:
        return f"expected shape {shape}, got {action.shape}"
    if action.dtype != space.dtype:
        return f"expected dtype {space.dtype}, got {action.dtype}"
    if not np.isfinite(action).all():
        return "not finite"
    if not space.contains(action[0]):
        return f"out of bounds, up to {np.abs(action).max():.3g}"
    return ""


def _batch(observations: Sequence[Any]) -> Any:
    if isinstance(observations[0], dict):
        return {key: np.stack([observation[key] for observation in observations]) for key in observations[0]}
    return np.stack(observations)


def _compare_runs(first: list[_Episode], again: list[_Episode], failures: dict[str, str]) -> None:
    for k, (a, b) in enumerate(zip(first, again, strict=False)):
        if not np.array_equal(a.actions, b.actions) or not np.array_equal(a.rewards, b.rewards):
            failures["determinism"] = f"episode {k} differs between two runs"
            return


def _compare_batch(policy: Any, episodes: list[_Episode], failures: dict[str, str]) -> None:
    """Replay: all episodes as rows of one batch, then the first one without a batch axis."""
    common = min(len(episode.rewards) for episode in episodes)
    state: Any = None
    start = np.ones(len(episodes), dtype=np.bool_)
    for t in range(common):
        observation = _batch([episode.observations[t] for episode in episodes])
        actions, state = policy.predict(observation, state=state, episode_start=start, deterministic=True)
        start = np.zeros(len(episodes), dtype=np.bool_)
        expected = np.stack([episode.actions[t] for episode in episodes])
        if np.shape(actions) != expected.shape or not np.allclose(actions, expected, atol=_TOLERANCE):
            failures["batch"] = f"step {t}: rows of a batch differ from rows alone"
            return
    state = None
    for t, expected in enumerate(episodes[0].actions[:100]):
        action, state = policy.predict(episodes[0].observations[t], state=state, deterministic=True)
        if np.shape(action) != expected.shape or not np.allclose(action, expected, atol=_TOLERANCE):
            failures["batch"] = f"step {t}: an unbatched observation gives {np.shape(action)}, or another action"
            return


def _compare_restart(policy: Any, episode: _Episode, failures: dict[str, str]) -> None:
    """Replay an episode twice in a row: the second time from a used state, with `episode_start`."""
    state: Any = None
    for _ in range(2):
        for t, expected in enumerate(episode.actions):
            flag = np.array([t == 0])
            batch = _batch([episode.observations[t]])
            action, state = policy.predict(batch, state=state, episode_start=flag, deterministic=True)
            if not np.allclose(action[0], expected, atol=_TOLERANCE):
                failures["restart"] = f"step {t}: the state remembers the episode before"
                return


def smoke_text(rows: Sequence[SmokeRow]) -> str:
    """A line a policy, a mark a check, and below what failed."""
    width = max(len(row.env_id) for row in rows)
    names = max(6, *(len(row.policy) for row in rows))
    lines = [f"{'id':<{width}}  {'policy':<{names}}  {'  '.join(CHECKS)}  success      s"]
    for row in rows:
        marks = "  ".join(_mark(row, name).center(len(name)) for name in CHECKS)
        lines.append(f"{row.env_id:<{width}}  {row.policy:<{names}}  {marks}  {row.success:7.2f}  {row.seconds:5.1f}")
    lines += [f"FAILED {row.env_id} {row.policy}: {name}: {why}" for row in rows for name, why in row.failures.items()]
    failed = sum(not row.passed for row in rows)
    return "\n".join([*lines, f"{len(rows) - failed} passed, {failed} failed"])


def _mark(row: SmokeRow, name: str) -> str:
    if name in row.failures:
        return "✗"
    if "run" in row.failures or (row.failures.keys() & {"actions", "worlds"} and name not in ("actions", "worlds")):
        return "?"
    left_out = {
        "batch": row.oracle,
        "restart": row.oracle or row.policy == "random",
        "floor": not row.floor,
    }
    return "–" if left_out.get(name) else "✓"


def main(argv: list[str]) -> int:
    """`aerograsp smoke`."""
    parser = Parser(prog="aerograsp smoke", description="Contract checks of policies over a few short episodes.")
    parser.add_argument("ids", metavar="ID", nargs="*", help="environments (default: all)")
    add_policy(parser, default="zero, random, every analytic and shipped one")
    parser.add_argument("--episodes", metavar="N", type=positive_int, default=EPISODES, help="episodes a run")
    parser.add_argument("--steps", metavar="N", type=positive_int, default=None, help="time limit of an episode")
    add_seed(parser, VALIDATION_SEED)
    add_json(parser)
    args = parser.parse_args(argv)
    for env_id in args.ids:
        env_spec(env_id)
    rows = smoke(args.ids, args.policies, args.episodes, args.steps, args.seed, progress=True)
    if not rows:
        raise ValueError("smoke: no environment is registered")
    if args.json != "-":
        print(smoke_text(rows))
    if args.json:
        data = [{**vars(row), "passed": row.passed} for row in rows]
        write_json(args.json, {"provenance": provenance(" ".join(["aerograsp smoke", *argv])), "rows": data})
    return 0 if all(row.passed for row in rows) else FAILED


if __name__ == "__main__":
    sys.exit(guarded("aerograsp smoke", main, sys.argv[1:]))
