"""`aerograsp bench aerograsp/GraspPlan-v0 --speed`: what planning's parts cost beside the bare work, in one run.

Everything on one BLAS thread, warm, medians: implicit surfaces against the same matrix products and factorisations
alone (and GPyTorch's gradient kernel, where an interpreter has it), grasp analysis against Qhull, rays against Embree.
"""

from __future__ import annotations

import os
import subprocess
import sys
from typing import NamedTuple

from agents.arguments import Parser, add_json, guarded, positive_int
from agents.files import write_json
from agents.gpis_speed import THREADS, single_thread
from agents.provenance import provenance
from agents.table import aligned

BARE = {  # ours → the bare counterpart, and the greatest ratio wanted
    "mean and gradient": ("bare product", 2.0),
    "with variance": ("bare product and solve", 3.0),
    "fit": ("bare Cholesky", 1.5),
}


class Cost(NamedTuple):
    """One comparison."""

    name: str
    seconds: float  # ours
    other: str
    other_seconds: float
    wanted: float  # the greatest ratio ours / other wanted; 0 where it is for information

    @property
    def ratio(self) -> float:
        """Ours over the other's."""
        return self.seconds / self.other_seconds


def costs(repeats: int, peer_python: str | None = None) -> list[Cost]:
    """All comparisons.

    Raises:
        OSError: the peer's interpreter cannot be run, or has no GPyTorch.
    """
    from agents import gpis_speed, grasp_speed, ray_speed

    seconds = gpis_speed.measure(repeats)
    rows = [
        Cost(f"implicit surface, {ours}", seconds[ours], bare, seconds[bare], wanted)
        for ours, (bare, wanted) in BARE.items()
    ]
    if peer_python is not None:
        found = gpis_speed.peer(peer_python)
        version = f"GPyTorch {found['versions'][0]}, RBFKernelGrad"
        name = "implicit surface, mean and gradient"
        rows.append(Cost(name, seconds["mean and gradient"], version, found["seconds"], 0.1))
    for row in grasp_speed.measure(repeats):
        name, _, other = row.name.partition(" / ")
        rows.append(Cost(name, row.seconds, other, row.bound_seconds, 1.0 / row.target if row.target else 0.0))
    for cast in ray_speed.measure(repeats):
        rows.append(Cost(cast.name, cast.seconds, "Embree", cast.bound_seconds, 1.5))
    return rows


def table(rows: list[Cost]) -> str:
    """Text for a terminal."""
    lines = [["", "ours [ms]", "beside", "[ms]", "ratio", "wanted"]]
    for row in rows:
        wanted = f"≤ {row.wanted:.3g}" if row.wanted else ""
        times = (f"{1e3 * row.seconds:.2f}", row.other, f"{1e3 * row.other_seconds:.2f}")
        lines.append([row.name, *times, f"{row.ratio:.3g}", wanted])
    return aligned(lines, ["One BLAS thread; medians after a warm-up."])


def main(argv: list[str]) -> int:
    """Print the table."""
    parser = Parser(prog="aerograsp bench aerograsp/GraspPlan-v0 --speed", description=__doc__)
    parser.add_argument("--peer-python", metavar="PATH", help="interpreter with gpytorch")
    parser.add_argument("--repeats", metavar="R", type=positive_int, default=5, help="of every measurement")
    add_json(parser)
    args = parser.parse_args(argv)
    if any(os.environ.get(name) != "1" for name in THREADS):  # BLAS reads them as it is loaded: start over
        command = [sys.executable, "-m", "agents.speed_grasp", *argv]
        return subprocess.run(command, env=os.environ | single_thread()).returncode
    rows = costs(args.repeats, args.peer_python)
    facts = provenance(" ".join([parser.prog, *argv]))
    if args.json != "-":
        print(table(rows))
        print(f"{facts['machine']['cpu']}, {facts['machine']['cores']} cores; commit {facts['commit'] or 'unknown'}")
    if args.json:
        write_json(args.json, {"provenance": facts, "rows": [{**row._asdict(), "ratio": row.ratio} for row in rows]})
    return 0


if __name__ == "__main__":
    sys.exit(guarded("aerograsp bench", main, sys.argv[1:]))
