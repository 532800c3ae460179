"""`aerograsp bench`: policies on the same pinned episodes, as a table, JSON and an HTML report.

Finished rows are kept in the output folder (`agents.rows`), so an interrupted run goes on where it stopped.
"""

import json
import re
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import gymnasium

from agents.arguments import Parser, add_env_kwargs, add_episodes, add_json, add_policy, add_seed, guarded
from agents.files import writable_folder, write_atomic, write_json
from agents.policies import (
    LEARNED,
    TRIVIAL,
    PolicyUnavailable,
    checkpoints,
    env_spec,
    registered_policies,
    spaces,
)
from agents.provenance import provenance
from agents.report import write_report
from agents.rows import RowStore, load_all
from agents.seeds import TEST_SEED
from agents.table import Published, Row, best_row, table_data, table_text, with_pooled
from agents.traces import Trace, trace

if TYPE_CHECKING:
    from agents.robustness import Robustness

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
    facts = provenance(command)
    _, observation_space = spaces(env_id, kwargs)
    traceable = "position_error" in getattr(observation_space, "spaces", {})
    loaded = load_all(env_id, names, kwargs)
    store = RowStore(folder, env_id, episodes, seed, facts, fresh, progress)
    rows: list[Row] = []
    traces: list[Trace] = []
    for name, policy in loaded.items():
        if isinstance(policy, PolicyUnavailable):
            rows.append(Row(name, note=f"not run: {policy}"))
            continue
        rows.append(Row.of(store.row(name, policy, kwargs)))
        if traceable:
            steps = min(kwargs.get("max_episode_steps", TRACE_STEPS), TRACE_STEPS)
            traces.append(trace(env_id, policy, seed, {**kwargs, "max_episode_steps": steps}, name))
    best = None if quick else best_row([row for row in rows if row.values])
    film = None if best is None else film_of(env_id, best.policy, seed, kwargs, progress)
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
        film=film,
        film_caption="" if best is None else f"{best.policy}, the first seconds of the first pinned episode",
    )
    return BenchResult(rows, folder, table)


def film_of(env_id: str, policy: str, seed: int, env_kwargs: Mapping[str, Any], progress: bool = False) -> bytes | None:
    """A small GIF of a policy's first seconds; None where the id draws no pictures, or they cannot be drawn here."""
    from agents.play import play

    env = gymnasium.make(env_id, disable_env_checker=True, **env_kwargs)
    drawn = "rgb_array" in env.metadata.get("render_modes", ())
    env.close()
    if not drawn:
        return None
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "film.gif"
        look = {**env_kwargs, **FILM_SIZE}
        try:
            play(env_id, policy, out, seconds=FILM_SECONDS, seed=seed, env_kwargs=look, fps=FILM_RATE)
        except (ValueError, RuntimeError) as error:
            if progress:
                print(f"no film: {error}", file=sys.stderr)
            return None
        return out.read_bytes()


def main(argv: list[str]) -> int:
    """`aerograsp bench`."""
    if "--speed" in argv:
        from agents.speed import main as speed_main

        return speed_main([argument for argument in argv if argument != "--speed"])
    parser = Parser(prog="aerograsp bench", description="Compare policies on pinned episodes: table, JSON and report.")
    parser.add_argument("id", metavar="ID", nargs="?", default=DOCK, help="environment")
    parser.add_argument("--quick", action="store_true", help="few rows, ten episodes of 20 s")
    parser.add_argument("--speed", action="store_true", help="measure speed instead; --speed --help lists its options")
    parser.add_argument(
        "--robustness",
        action="store_true",
        help="delays, masses, winds and vehicles that no policy was made for, 40 episodes each, instead",
    )
    add_policy(parser, default="every analytic and shipped policy, zero and random")
    add_episodes(parser, None)
    add_seed(parser, TEST_SEED)
    add_env_kwargs(parser)
    parser.add_argument("--out", metavar="FOLDER", default="runs/bench", help="folder of the results")
    parser.add_argument("--fresh", action="store_true", help="measure rows again that the folder holds already")
    add_json(parser)
    args = parser.parse_args(argv)
    if args.quick and args.robustness:
        parser.error("--quick and --robustness do not go together")
    command = " ".join(["aerograsp", "bench", *argv])
    shared = (args.id, args.policies, args.episodes, args.seed, args.env_kwargs, args.out)
    result: BenchResult | Robustness
    if args.robustness:
        from agents.robustness import robustness

        result = robustness(*shared, fresh=args.fresh, command=command)
    else:
        result = bench(*shared, quick=args.quick, fresh=args.fresh, command=command)
    if args.json != "-":
        print(f"{result.table}\n\nreport: {result.report.resolve()}")
    if args.json:
        write_json(args.json, json.loads(result.data.read_text()))
    return 0


if __name__ == "__main__":
    sys.exit(guarded("aerograsp bench", main, sys.argv[1:]))
