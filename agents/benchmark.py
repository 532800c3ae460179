"""`aerograsp bench`: policies on the same pinned episodes, as a table, JSON and an HTML report.

Every finished row is kept in the output folder under a key of all that it depends on (policy, weights, settings,
version, commit, sources), so an interrupted run goes on where it stopped.
"""

import hashlib
import importlib.util
import json
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from agents.arguments import Parser, add_env_kwargs, add_episodes, add_json, add_policy, add_seed, guarded
from agents.evaluation import EvaluationResult, evaluate
from agents.files import to_json, writable_folder, write_atomic, write_json
from agents.policies import (
    LEARNED,
    TRIVIAL,
    PolicyUnavailable,
    checkpoints,
    env_spec,
    load_policy,
    registered_policies,
    spaces,
)
from agents.provenance import provenance
from agents.report import write_report
from agents.seeds import TEST_SEED
from agents.table import Published, Row, table_data, table_text
from agents.traces import Trace, trace

DOCK = "aerograsp/Dock-v0"
CONDITIONS: dict[str, dict[str, Any]] = {DOCK: {"wind": "gusty", "command_delay": (0.06, 0.1)}}
PUBLISHED = {
    DOCK: (
        Published(
            "thesis, docking tool",
            {"error_x": (0.034, 0.032), "error_y": (0.036, 0.028), "error_z": (0.040, 0.039)},
            "P. Ramon Soria, PhD thesis, 2018, Table 5.3: mean ± standard deviation of the held position's error, real "
            "vehicle and wind, total station; not the conditions simulated here.",
        ),
    )
}
QUICK_ROWS = (*TRIVIAL, "pid", "pid-tuned", "lqg", "ppo")
QUICK_EPISODES, FULL_EPISODES = 10, 100
QUICK_STEPS = 1000  # 20 s at 50 Hz
TRACE_STEPS = 1000


class BenchResult(NamedTuple):
    """What was measured, and where it was written."""

    rows: list[Row]
    folder: Path
    table: str

    @property
    def report(self) -> Path:
        return self.folder / "report.html"


def default_rows(env_id: str, quick: bool) -> list[str]:
    """The rows of a comparison: quick, or every analytic policy and every training seed that is shipped."""
    analytic, shipped = list(registered_policies(env_id)), checkpoints(env_id)
    if quick:
        return [name for name in QUICK_ROWS if name in (*TRIVIAL, *LEARNED) or name in analytic]
    seeds = [name for name in shipped if re.fullmatch(r".+-seed\d+", name)]
    missing = [kind for kind in LEARNED if not any(name.startswith(f"{kind}-seed") for name in seeds)]
    return [*TRIVIAL, *analytic, *seeds, *missing]


def bench(
    env_id: str = DOCK,
    policies: Sequence[str] | None = None,
    episodes: int | None = None,
    seed: int = TEST_SEED,
    env_kwargs: Mapping[str, Any] | None = None,
    out_dir: str | Path = "runs/bench",
    quick: bool = False,
    fresh: bool = False,
    progress: bool = True,
    command: str = "agents.benchmark.bench",
) -> BenchResult:
    """Compare policies and write `results.json`, `table.md` and `report.html` into `out_dir`.

    Args:
        env_id: a registered id.
        policies: names for `load_policy`; by default `default_rows`.
        episodes: per policy; 100, or 10 if `quick`.
        seed: of episode 0.
        env_kwargs: options of the environment, over `CONDITIONS` of the id.
        out_dir: made if need be.
        quick: few rows, few short episodes.
        fresh: measure rows again that are there already.
        progress: a bar a row on a terminal, a line a row on standard error.
        command: what to write into the report.

    Raises:
        ValueError: unknown id, policy or option, before anything is run.
        OSError: the folder cannot be written.
    """
    env_spec(env_id)
    folder = writable_folder(out_dir)
    kwargs = {
        **CONDITIONS.get(env_id, {}),
        **({"max_episode_steps": QUICK_STEPS} if quick else {}),
        **(env_kwargs or {}),
    }
    episodes = episodes if episodes is not None else QUICK_EPISODES if quick else FULL_EPISODES
    names = list(dict.fromkeys(policies or default_rows(env_id, quick)))
    facts, sources = provenance(command), _sources()
    _, observation_space = spaces(env_id, kwargs)
    traceable = "position_error" in getattr(observation_space, "spaces", {})
    loaded = [(name, _load(env_id, name, kwargs)) for name in names]
    rows: list[Row] = []
    traces: list[Trace] = []
    for name, policy in loaded:
        if isinstance(policy, PolicyUnavailable):
            rows.append(Row(name, note=f"not run: {policy}"))
            continue
        settings = {"id": env_id, "policy": name, "episodes": episodes, "seed": seed, "env_kwargs": kwargs}
        key = {**settings, "content": content_hash(env_id, name), "commit": facts["commit"], "sources": sources}
        key["version"] = facts["versions"].get("aerograsp", "")
        result, reused = stored(folder, key), True
        if result is None or fresh:
            measured = evaluate(env_id, policy, episodes, seed, kwargs, progress)
            result, reused = replace(measured, policy=name), False
            store(folder, key, result)
        rows.append(Row.of(result))
        if progress:
            print(f"{name}: {'kept from an earlier run' if reused else 'done'}", file=sys.stderr)
        if traceable:
            steps = min(kwargs.get("max_episode_steps", TRACE_STEPS), TRACE_STEPS)
            traces.append(trace(env_id, policy, seed, {**kwargs, "max_episode_steps": steps}, name))
    rows = with_pooled(rows)
    published = PUBLISHED.get(env_id, ())
    settings = {
        "environment": env_id,
        "options": kwargs,
        "episodes": f"{episodes} a policy, the same ones for each",
        "seeds": f"{seed} to {seed + episodes - 1}",
    }
    table = table_text(rows, published=published)
    write_json(
        folder / "results.json",
        {"provenance": facts, "settings": {**settings, "seed": seed}, **table_data(rows, published)},
    )
    write_atomic(folder / "table.md", table_text(rows, markdown=True, published=published) + "\n")
    write_report(
        folder / "report.html",
        title=f"{env_id}: comparison of policies",
        rows=rows,
        provenance=facts,
        settings=settings,
        published=published,
        traces=traces,
    )
    return BenchResult(rows, folder, table)


def with_pooled(rows: Sequence[Row]) -> list[Row]:
    """The rows, and after the training seeds of one kind a row over all of them."""
    pooled = list(rows)
    for kind in LEARNED:
        seeds = [row for row in rows if row.values and re.fullmatch(rf"{kind}-seed\d+", row.policy)]
        if len(seeds) > 1:
            note = f"each episode averaged over {len(seeds)} trainings"
            pooled.insert(pooled.index(seeds[-1]) + 1, Row.pooled(f"{kind} ({len(seeds)} seeds)", seeds, note))
    return pooled


def content_hash(env_id: str, name: str) -> str:
    """Hash of the file that a policy's behaviour is read from, "" where the project's sources cover it."""
    path = Path(name) if name.endswith(".safetensors") else checkpoints(env_id).get(name)
    module = name.partition(":")[0]
    if path is None and ":" in name:
        found = importlib.util.find_spec(module)
        path = Path(found.origin) if found is not None and found.origin else None
    return hashlib.sha256(path.read_bytes()).hexdigest() if path is not None and path.is_file() else ""


def _load(env_id: str, name: str, env_kwargs: Mapping[str, Any]) -> Any:
    try:
        return load_policy(env_id, name, env_kwargs)
    except PolicyUnavailable as error:
        return error


def _row_file(folder: Path, key: Mapping[str, Any]) -> Path:
    name = str(key["policy"])
    stem = re.sub(r"[^\w.-]+", "-", Path(name).stem if name.endswith(".safetensors") else name)
    digest = hashlib.sha256(json.dumps(to_json(dict(key)), sort_keys=True).encode()).hexdigest()
    return folder / "rows" / f"{stem}-{digest[:16]}.json"


def stored(folder: Path, key: Mapping[str, Any]) -> EvaluationResult | None:
    """The finished row of this key in the folder; None if there is none, or what is there is damaged."""
    try:
        return EvaluationResult.from_dict(json.loads(_row_file(folder, key).read_text())["result"])
    except (FileNotFoundError, ValueError, KeyError, TypeError):
        return None


def store(folder: Path, key: Mapping[str, Any], result: EvaluationResult) -> None:
    """Keep a finished row under its key."""
    path = _row_file(folder, key)
    path.parent.mkdir(exist_ok=True)
    write_json(path, {"key": key, "result": result.to_dict()})


def _sources() -> str:
    """Hash of the project's sources, so that a row never outlives an uncommitted change."""
    digest = hashlib.sha256()
    root = Path(__file__).resolve().parents[1]
    for package in ("aerograsp_env", "baselines", "agents"):
        for path in sorted((root / package).rglob("*")):
            if path.suffix in (".py", ".xml", ".npz", ".json") and path.is_file():
                digest.update(path.relative_to(root).as_posix().encode())
                digest.update(path.read_bytes())
    return digest.hexdigest()


def main(argv: list[str]) -> int:
    """`aerograsp bench`."""
    if "--speed" in argv:
        from agents.speed import main as speed_main

        return speed_main([argument for argument in argv if argument != "--speed"])
    parser = Parser(prog="aerograsp bench", description="Compare policies on pinned episodes: table, JSON and report.")
    parser.add_argument("id", metavar="ID", nargs="?", default=DOCK, help="environment")
    parser.add_argument("--quick", action="store_true", help="few rows, ten episodes of 20 s")
    parser.add_argument("--speed", action="store_true", help="measure speed instead; --speed --help lists its options")
    add_policy(parser, default="every analytic and shipped policy, zero and random")
    add_episodes(parser, None)
    add_seed(parser, TEST_SEED)
    add_env_kwargs(parser)
    parser.add_argument("--out", metavar="FOLDER", default="runs/bench", help="folder of the results")
    parser.add_argument("--fresh", action="store_true", help="measure rows again that the folder holds already")
    add_json(parser)
    args = parser.parse_args(argv)
    result = bench(
        args.id,
        args.policies,
        args.episodes,
        args.seed,
        args.env_kwargs,
        args.out,
        args.quick,
        args.fresh,
        command=" ".join(["aerograsp", "bench", *argv]),
    )
    if args.json != "-":
        print(f"{result.table}\n\nreport: {result.report.resolve()}")
    if args.json:
        write_json(args.json, json.loads((result.folder / "results.json").read_text()))
    return 0


if __name__ == "__main__":
    sys.exit(guarded("aerograsp bench", main, sys.argv[1:]))
