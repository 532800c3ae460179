"""`aerograsp bench`: policies on the same pinned episodes, as a table, JSON and an HTML report.

Finished rows are kept in the output folder (`agents.rows`), so an interrupted run goes on where it stopped.
"""

import importlib
import json
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from agents.arguments import Parser, add_env_kwargs, add_episodes, add_json, add_policy, add_seed, guarded
from agents.bench_setup import DETECT, DOCK, GRASP, GRASP_PLAN, REACH, SETUPS, Condition, Measured, Study, setup_of
from agents.files import writable_folder, write_atomic, write_json
from agents.policies import PolicyUnavailable, env_spec, spaces
from agents.provenance import provenance
from agents.report import pairings, write_report
from agents.robustness import Robustness, measured_rows, robustness, summary, tables_text
from agents.rows import RowStore, load_all
from agents.seeds import TEST_SEED
from agents.table import Row, best_row, table_data, table_text, with_pooled, without_trainings
from agents.traces import Trace, trace

CONDITIONS: dict[str, dict[str, Any]] = {env_id: dict(setup.options) for env_id, setup in SETUPS.items()}
TRACE_STEPS = 1000
FILM_SECONDS, FILM_RATE, FILM_SIZE = 6.0, 10.0, {"width": 320, "height": 240}


class BenchResult(NamedTuple):
    """What was measured, and where it was written."""

    rows: list[Row]
    folder: Path
    table: str

    @property
    def report(self) -> Path:
        return self.folder / "report.html"

    @property
    def data(self) -> Path:
        return self.folder / "results.json"


def default_rows(env_id: str, quick: bool) -> list[str]:
    """The rows of a comparison (`agents.bench_setup.Setup.rows`)."""
    return setup_of(env_id).rows(env_id, quick)


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
        episodes: per policy; by default what `agents.bench_setup` says of the id: 100, or 10 if `quick`.
        seed: of episode 0.
        env_kwargs: options of the environment, over those of the id's setup.
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
    setup = setup_of(env_id)
    folder = writable_folder(out_dir)
    base = {**setup.options, **(setup.quick_options if quick else {}), **(env_kwargs or {})}
    conditions = setup.conditions_under(env_kwargs or {})
    first, kwargs = next((name, {**base, **changes}) for name, changes in conditions.items())
    for changes in conditions.values():
        spaces(env_id, {**base, **changes})  # refuses unknown options
    episodes = episodes if episodes is not None else setup.quick_episodes if quick else setup.episodes
    names = list(dict.fromkeys(policies or default_rows(env_id, quick)))
    facts = provenance(command)
    _, observation_space = spaces(env_id, kwargs)
    traceable = "position_error" in getattr(observation_space, "spaces", {}) and not setup.conditions
    loaded = load_all(env_id, names, kwargs)
    store = RowStore(folder, env_id, episodes, seed, facts, fresh, progress)
    rows: list[Row] = []
    traces: list[Trace] = []
    for name, policy in loaded.items():
        if isinstance(policy, PolicyUnavailable):
            rows.append(Row(name, note=f"not run: {policy}"))
            continue
        oracle = callable(getattr(policy, "watch", None))
        rows.append(Row.of(store.row(name, policy, kwargs), oracle=oracle))
        if traceable:
            steps = min(kwargs.get("max_episode_steps", TRACE_STEPS), TRACE_STEPS)
            traces.append(trace(env_id, policy, seed, {**kwargs, "max_episode_steps": steps}, name))
    best = None if quick or not setup.film_episodes else best_row([row for row in rows if row.values])
    film = None if best is None else film_of(env_id, best.policy, seed, kwargs, progress, setup.film_episodes)
    rows = with_pooled(rows)
    studied = {first: Condition(conditions[first], kwargs, without_trainings(rows))}
    for name, changes in list(conditions.items())[1:]:
        options = {**base, **changes}
        studied[name] = Condition(changes, options, measured_rows(store, name, options, loaded))
    ran = {name: policy for name, policy in loaded.items() if not isinstance(policy, PolicyUnavailable)}
    having = [row for row in rows if row.values]
    measured = Measured(env_id, kwargs, seed, episodes, having, ran, quick, progress, studied)
    study = _study(setup.study, measured)
    settings = {
        "environment": env_id,
        "options": kwargs,
        **({"condition": first} if first else {}),
        "episodes": f"{episodes} a policy, the same ones for each",
        "seeds": f"{seed} to {seed + episodes - 1}",
    }
    published = setup.published
    table = table_text(rows, published=published)
    paired = [pair.to_dict() for pair in pairings(measured.rows)]
    content = {**table_data(rows, published), "paired": paired, **study.data}
    tables = [table_text(rows, markdown=True, published=published)]
    by_condition = {name: condition.rows for name, condition in studied.items()}
    if len(studied) > 1:
        table = f"{first}\n{table}\n\n{tables_text(by_condition, conditions)}"
        tables = [f"## {first}", *tables, "## All conditions", tables_text(by_condition, conditions, markdown=True)]
        content["conditions"] = {name: _condition_data(condition) for name, condition in studied.items()}
    write_atomic(folder / "table.md", "\n\n".join(tables) + "\n")
    write_json(folder / "results.json", {"provenance": facts, "settings": {**settings, "seed": seed}, **content})
    write_report(
        folder / "report.html",
        title=f"{env_id}: comparison of policies",
        rows=rows,
        provenance=facts,
        settings=settings,
        condition=first,
        summary=summary(by_condition),
        published=published,
        traces=traces,
        film=film,
        film_caption="" if best is None else _film_caption(best.policy, setup.film_episodes),
        sections=study.sections,
    )
    return BenchResult(rows, folder, table)


def _study(function: str, measured: Measured) -> Study:
    if not function or not measured.rows:
        return Study([], {})
    module, _, name = function.partition(":")
    found: Study = getattr(importlib.import_module(module), name)(measured)
    return found


def _condition_data(condition: Condition) -> dict[str, Any]:
    paired = [pair.to_dict() for pair in pairings([row for row in condition.rows if row.values])]
    return {"options": condition.options, "rows": table_data(condition.rows)["rows"], "paired": paired}


def _film_caption(policy: str, episodes: int) -> str:
    if episodes == 1:
        return f"{policy}, the first seconds of the first pinned episode"
    return f"{policy}, the first {episodes} pinned episodes"


def film_of(
    env_id: str, policy: str, seed: int, env_kwargs: Mapping[str, Any], progress: bool = False, episodes: int = 1
) -> bytes | None:
    """A small GIF of a policy's first seconds; None where the id draws no pictures, or they cannot be drawn here."""
    from agents.play import draws_pictures, play

    if not draws_pictures(env_id, env_kwargs):
        return None
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "film.gif"
        look = {**env_kwargs, **FILM_SIZE}
        try:
            play(
                env_id,
                policy,
                out,
                episodes=episodes,
                seconds=FILM_SECONDS,
                seed=seed,
                env_kwargs=look,
                fps=FILM_RATE,
            )
        except (ValueError, RuntimeError) as error:
            if progress:
                print(f"no film: {error}", file=sys.stderr)
            return None
        return out.read_bytes()


def main(argv: list[str]) -> int:
    """`aerograsp bench`."""
    if "--speed" in argv:
        rest = [argument for argument in argv if argument not in ("--speed", "--env")]
        if GRASP_PLAN in rest:
            from agents.speed_grasp import main as speed_main

            rest.remove(GRASP_PLAN)
        elif any(env_id in rest for env_id in (REACH, GRASP)):
            from agents.speed_manipulation import main as speed_main
        elif DETECT in rest:
            from agents.camera_speed import main as speed_main

            rest.remove(DETECT)
        else:
            from agents.speed import main as speed_main
        return speed_main([argument for argument in rest if argument != DOCK])
    parser = Parser(prog="aerograsp bench", description="Compare policies on pinned episodes: table, JSON and report.")
    parser.add_argument("id", metavar="ID", nargs="?", default=None, help=f"environment (default: {DOCK})")
    parser.add_argument("--env", metavar="ID", default=None, help="the same by name")
    parser.add_argument("--quick", action="store_true", help="few rows, few short episodes")
    parser.add_argument("--speed", action="store_true", help="measure speed instead; --speed --help lists its options")
    parser.add_argument(
        "--robustness",
        action="store_true",
        help="conditions that no policy was made for (delays, winds, noise, masses, friction) instead",
    )
    add_policy(parser, default="every analytic and shipped policy, zero and random")
    add_episodes(parser, None)
    add_seed(parser, TEST_SEED)
    add_env_kwargs(parser)
    parser.add_argument("--out", metavar="FOLDER", default="runs/bench", help="folder of the results")
    parser.add_argument("--fresh", action="store_true", help="measure rows again that the folder holds already")
    add_json(parser)
    args = parser.parse_args(argv)
    if args.id and args.env and args.id != args.env:
        parser.error(f"the environment is given twice, as {args.id} and as {args.env}")
    command = " ".join(["aerograsp", "bench", *argv])
    shared = (args.id or args.env or DOCK, args.policies, args.episodes, args.seed, args.env_kwargs, args.out)
    result: BenchResult | Robustness
    if args.robustness:
        result = robustness(*shared, quick=args.quick, fresh=args.fresh, command=command)
    else:
        result = bench(*shared, quick=args.quick, fresh=args.fresh, command=command)
    if args.json != "-":
        print(f"{result.table}\n\nreport: {result.report.resolve()}")
    if args.json:
        write_json(args.json, json.loads(result.data.read_text()))
    return 0


if __name__ == "__main__":
    sys.exit(guarded("aerograsp bench", main, sys.argv[1:]))
