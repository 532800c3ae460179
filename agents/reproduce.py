"""`aerograsp reproduce TABLE`: a published table or figure beside what this project measures."""

from __future__ import annotations

import importlib
import sys
from typing import Any, NamedTuple

from agents.arguments import Parser, add_episodes, add_json, add_seed, guarded
from agents.files import write_atomic, write_json
from agents.reproduction import DATA_VARIABLE, Reproduction, Request
from agents.seeds import TEST_SEED


class Table(NamedTuple):
    """One reproduction."""

    module: str  # has `run(Request) -> Reproduction`
    title: str
    counts: bool = False  # takes a number of episodes
    draws: bool = False  # has a picture
    real: bool = False  # needs a folder of real data


TABLES = {
    "figure-2.8": Table("agents.figure_2_8", "half an apple by prior (thesis figure 2.8)", draws=True),
    "figure-2.12": Table(
        "agents.figure_2_12", "aligned models, varying or fixed noise (figures 2.10-2.12)", draws=True
    ),
    "figure-2.20": Table("agents.figure_2_20", "a U too wide for the jaws (thesis figure 2.20)", draws=True),
    "figure-3.15": Table("agents.figure_3_15", "an object of which half is hidden (thesis figure 3.15)", draws=True),
    "grasp-judge": Table("agents.grasp_judge_gate", "grasps that must hold and grasps that must not, by the physics"),
    "table-5.3": Table("agents.table_5_3", "holding error by GPS, vision and tool (thesis Table 5.3)", counts=True),
    "reach": Table("agents.reach_table", "the tool at a point, from a drifting hover (Reach-v0)", counts=True),
    "step-response": Table("agents.step_response", "velocity steps under PX4's gains", draws=True),
    "figure-5.9": Table("agents.figure_5_9", "where the two arms reach (thesis figure 5.9)", draws=True),
    "figure-5.15": Table("agents.figure_5_15", "the tool's workspace quality (thesis figure 5.15)", draws=True),
    "figure-5.24": Table(
        "agents.figure_5_24", "an end-effector held docked or hovering (thesis figure 5.24)", counts=True, draws=True
    ),
    "firefly-motion": Table(
        "agents.firefly_motion", "motion beside a real Firefly's flight (EuRoC data set)", real=True
    ),
    "real-objects": Table(
        "agents.real_objects", "grasps on scanned objects, single views made whole", counts=True, draws=True, real=True
    ),
}


def reproduce(name: str, request: Request | None = None) -> Reproduction:
    """Run one reproduction.

    Raises:
        ValueError: an unknown name, or episodes a picture or data asked of or given to one without.
        FileNotFoundError: a data set that it needs is absent.
    """
    request = request or Request()
    if name not in TABLES:
        import difflib

        near = difflib.get_close_matches(name, TABLES, n=1, cutoff=0.3)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise ValueError(f"unknown table {name!r}; there are: {', '.join(TABLES)}{hint}")
    table = TABLES[name]
    if request.episodes is not None and not table.counts:
        raise ValueError(f"--episodes: {name} does not count episodes")
    if request.picture and not table.draws:
        raise ValueError(
            f"--out: {name} has no picture; pictures: {', '.join(n for n, t in TABLES.items() if t.draws)}"
        )
    if request.data is not None and not table.real:
        raise ValueError(
            f"--data: {name} reads none; of real data: {', '.join(n for n, t in TABLES.items() if t.real)}"
        )
    result: Reproduction = importlib.import_module(table.module).run(request)
    return result


def main(argv: list[str]) -> int:
    """`aerograsp reproduce`."""
    from agents.provenance import provenance

    listing = "; ".join(f"{name}: {table.title}" for name, table in TABLES.items())
    parser = Parser(prog="aerograsp reproduce", description=__doc__, epilog=listing)
    parser.add_argument("table", metavar="TABLE", help=", ".join(TABLES))
    add_episodes(parser, default=None)
    add_seed(parser, TEST_SEED)
    add_json(parser)
    parser.add_argument("--out", metavar="FILE", type=_picture_target, default=None, help="write the picture (PNG)")
    parser.add_argument("--data", metavar="FOLDER", default=None, help=f"real data (else {DATA_VARIABLE})")
    args = parser.parse_args(argv)
    result = reproduce(args.table, Request(args.seed, args.episodes, args.out is not None, args.data))
    if args.json != "-":
        print(result.text)
    if args.out is not None and result.picture is not None:
        write_atomic(args.out, result.picture)
        print(f"picture: {args.out}", file=sys.stderr)
    if args.json:
        record: dict[str, Any] = {
            "provenance": provenance(" ".join(["aerograsp reproduce", *argv])),
            "table": args.table,
        }
        write_json(args.json, record | result.data)
    return 0


def _picture_target(text: str) -> str:
    import argparse
    from pathlib import Path

    path = Path(text)
    if path.suffix.lower() != ".png":
        raise argparse.ArgumentTypeError(f"expected a name that ends in .png, got {text!r}")
    if not path.absolute().parent.is_dir():
        raise argparse.ArgumentTypeError(f"no such folder: {path.absolute().parent}")
    return text


if __name__ == "__main__":
    sys.exit(guarded("aerograsp reproduce", main, sys.argv[1:]))
