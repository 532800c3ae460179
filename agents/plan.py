"""Rank grasps on a mesh or a point cloud by every metric, and draw them in a page that one can turn.

aerograsp plan mug.stl --top 10 --html mug.html
aerograsp plan view.pcd --viewpoint 0 0 0 --prior ellipsoid --html view.html

Exit status: 0 done; 1 no grasp, with the reasons counted; 2 misused.
"""

from __future__ import annotations

import argparse
import math
import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, get_args

from agents.arguments import FAILED, Parser, add_json, guarded, positive_int, seed_int
from agents.files import write_atomic, write_json
from agents.provenance import provenance
from agents.table import aligned

if TYPE_CHECKING:
    from agents.plan_settings import Settings
    from agents.planning import Plan

SUMMARIES = {
    "too wide": "opposite contacts farther apart than the jaws open (--gripper-width)",
    "too thin": "contacts closer together than 1 mm",
    "outside cone": "pairs of contacts whose closing line leaves a friction cone (--friction)",
    "no clearance": "placements where pads or fingers have no room",
    "palm collision": "placements where the palm meets the object",
    "did not converge": "descents that found no surface near the data",
    "no opposite side": "contacts whose opposite side is out of the jaws' reach (--gripper-width)",
    "ray missed": "rays that met nothing",
    "ray saw no opposite side": "rays that met seen points on one side only (--method gpis guesses the other)",
}


class Shown(NamedTuple):
    """How one metric is shown."""

    head: str
    show: Callable[[float], str]


COLUMNS = {
    "pfc": Shown("PFC", "{:.3f}".format),
    "lmrw_sum": Shown("LMRW sum", "{:.4f}".format),
    "lmrw_independent": Shown("LMRW indep.", "{:.4f}".format),
    "closing_angle": Shown("angle [deg]", lambda value: f"{math.degrees(value):.1f}"),
    "line_distance": Shown("line to c.o.m. [mm]", lambda value: f"{1e3 * value:.1f}"),
    "force_closure": Shown("closure", lambda value: "yes" if value else "no"),
    "q_min": Shown("Q min", "{:.3f}".format),
    "q_volume": Shown("Q volume", "{:.2f}".format),
    "q_isotropy": Shown("Q isotropy", "{:.4f}".format),
    "wrench_volume": Shown("wrench vol.", "{:.3g}".format),
}
WIDTH = "opening [mm]"
LEGEND = (
    "LMRW: largest minimum resisted wrench about the centre of mass, torques over 0.1 m, for normal forces that sum to "
    "1 or are each at most 1. Angle: of the closing line to the normals. Q: of the grasp matrix."
)


def _head(metric: str) -> str:
    return COLUMNS[metric].head if metric in COLUMNS else metric


def reasons(plan: Plan) -> list[str]:
    """Why candidates were turned down, the most frequent first."""
    counted = sorted(plan.grasps.reasons.items(), key=lambda item: -item[1])
    return [f"{count} {SUMMARIES.get(reason, reason)}" for reason, count in counted]


def cells(plan: Plan) -> list[tuple[str, ...]]:
    """What the table shows of each grasp: the metrics of `COLUMNS`, and the opening."""
    return [
        (*(column.show(float(plan.metrics[name][k])) for name, column in COLUMNS.items()), f"{1e3 * width:.0f}")
        for k, width in enumerate(plan.grasps.widths)
    ]


def plan_text(plan: Plan, rank: str) -> str:
    """The ranked table for a terminal."""
    heads = ["rank", *(column.head for column in COLUMNS.values()), WIDTH]
    lines = [[str(k + 1), *row] for k, row in enumerate(cells(plan))]
    return aligned([heads, *lines], [f"Ranked by {_head(rank)}.", LEGEND, *plan.notes])


def plan_data(plan: Plan, settings: Settings, source: str, origin: Mapping[str, Any]) -> dict[str, Any]:
    """The plan for JSON, SI units, in the frame of the file (scaled to metres)."""
    grasps = plan.grasps
    return {
        "object": source,
        "method": plan.method,
        "settings": asdict(settings),
        "grasps": [
            {
                "rank": k + 1,
                **{name: getattr(grasp, name) for name in ("center", "closing_axis", "approach_axis", "width")},
                "positions": grasps.positions[k],
                "normals": grasps.normals[k],
                "metrics": {name: values[k] for name, values in plan.metrics.items()},
            }
            for k, grasp in enumerate(grasps.grasps())
        ],
        "found": plan.found,
        "tried": dict(grasps.counts),
        "turned_down": dict(grasps.reasons),
        "center_of_mass": plan.scene.center,
        "notes": plan.notes,
        "provenance": origin,
    }


def plan_html(plan: Plan, settings: Settings, source: str, origin: Mapping[str, Any]) -> str:
    """The page: see `plan_page`."""
    from agents.plan_page import DrawnGrasp, plan_page

    on = {
        "mesh": "the mesh",
        "gpis": "an implicit surface through the points, which guesses what was not seen",
        "cloud": "the points that were seen",
    }[plan.method]
    found = f"{len(plan.grasps)} of {plan.found} grasps on {on}, ranked by {_head(settings.rank)}."
    why = "; ".join(reasons(plan))
    drawn = [
        DrawnGrasp(grasp, plan.grasps.positions[k], plan.grasps.normals[k], row)
        for k, (grasp, row) in enumerate(zip(plan.grasps.grasps(), cells(plan), strict=True))
    ]
    heads = [*(column.head for column in COLUMNS.values()), WIDTH]
    notes = [*([LEGEND] if drawn else []), *plan.notes, *([f"Turned down: {why}."] if why else [])]
    lead = found if drawn else f"No grasp on {on}: {why or 'nothing was found to hold'}."
    return plan_page(f"Grasps on {Path(source).name}", lead, plan.scene, drawn, heads, settings.gripper, notes, origin)


def _parser() -> Parser:
    from agents.plan_settings import METRICS, RANK, Method, PriorName

    parser = Parser(prog="aerograsp plan", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("object", metavar="MESH|CLOUD", help="obj stl ply off glb dae, or pcd ply npy npz xyz")
    parser.add_argument(
        "--method", choices=get_args(Method), default="auto", help="auto: closed meshes mesh, else gpis"
    )
    parser.add_argument("--prior", choices=get_args(PriorName), default="ellipsoid", help="of the implicit surface")
    parser.add_argument("--rank", choices=METRICS, default=RANK, help=f"what to rank by (default: {RANK})")
    parser.add_argument("--top", type=positive_int, default=10, metavar="N", help="how many to keep (default: 10)")
    parser.add_argument("--seed", type=seed_int, default=0, metavar="S")
    parser.add_argument("--scale", type=_positive, metavar="M", help="metres per unit of the file: 0.001 for mm")
    parser.add_argument("--viewpoint", type=float, nargs=3, metavar=("X", "Y", "Z"), help="where a cloud was seen from")
    parser.add_argument("--all-round", action="store_true", help="a cloud was seen from everywhere: normals outwards")
    corners = ("X0", "Y0", "Z0", "X1", "Y1", "Z1")
    parser.add_argument(
        "--crop", type=float, nargs=6, metavar=corners, help="the box of a cloud that is the object [m]"
    )
    parser.add_argument("--gripper-width", type=_positive, default=0.10, metavar="M", help="opening (default: 0.10 m)")
    parser.add_argument("--friction", type=_positive, default=0.7, metavar="MU", help="(default: 0.7)")
    parser.add_argument("--noise", type=float, default=0.001, metavar="M", help="of surface or points (default: 1 mm)")
    parser.add_argument("--points", type=positive_int, default=300, metavar="N", help="of a cloud's implicit surface")
    parser.add_argument("--rays", type=positive_int, default=2000, metavar="N", help="effort (default: 2000)")
    parser.add_argument("--no-cache", dest="cache", action="store_false", help="search a mesh anew")
    parser.add_argument("--html", type=_target, metavar="FILE", help="write the page")
    add_json(parser)
    return parser


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"expected a positive number, got {text!r}")
    return value


def _target(text: str) -> str:
    folder = Path(text).absolute().parent
    if not folder.is_dir():  # say so before the work, not after it
        raise argparse.ArgumentTypeError(f"no such folder: {folder}")
    return text


class _Progress:
    """One line on a terminal's standard error that tells what is being done; nothing elsewhere."""

    def __init__(self) -> None:
        self.shown = sys.stderr.isatty()

    def __call__(self, text: str) -> None:
        if self.shown:
            print(f"\r\x1b[K{text} …", end="", file=sys.stderr, flush=True)

    def close(self) -> None:
        if self.shown:
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)


def main(argv: Sequence[str]) -> int:
    """`aerograsp plan`."""
    args = _parser().parse_args(argv)
    from aerograsp_env.sim.gripper import GripperConfig
    from agents.plan_settings import Settings
    from agents.planning import plan

    settings = Settings(
        **{name: getattr(args, name) for name in ("method", "prior", "rank", "top", "seed", "noise", "scale")},
        **{name: getattr(args, name) for name in ("points", "rays", "cache", "all_round")},
        gripper=GripperConfig(max_width=args.gripper_width, friction=args.friction),
        viewpoint=None if args.viewpoint is None else tuple(args.viewpoint),
        crop=None if args.crop is None else tuple(args.crop),
    )
    if args.html:
        import plotly  # noqa: F401  a missing package shall be said before the work
    progress = _Progress()
    try:
        found = plan(args.object, settings, progress)
    except ValueError as error:  # the library names its argument, a user has the option
        raise ValueError(str(error).replace("pass scale=", "pass --scale ")) from error
    finally:
        progress.close()
    origin = provenance(shlex.join(["aerograsp", "plan", *argv]))
    if args.html:
        write_atomic(args.html, plan_html(found, settings, args.object, origin))
    if args.json:
        write_json(args.json, plan_data(found, settings, args.object, origin))
    if not len(found.grasps):
        why = "; ".join(reasons(found)) or "nothing was found to hold"
        print(f"aerograsp plan: no grasp on {Path(args.object).name}: {why}", file=sys.stderr)
        return FAILED
    if args.json != "-":
        print(plan_text(found, settings.rank))
    return 0


if __name__ == "__main__":
    sys.exit(guarded("aerograsp plan", main, sys.argv[1:]))
