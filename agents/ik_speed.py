"""Inverse kinematics timed: the damped search and the closed form, beside the Robotics Toolbox's C++ solver.

Targets are the poses of uniform random joint angles within the limits of the six-joint arm. The peer (Corke & Haviland
2021, `ETS.ik_LM`) runs in an interpreter of its own, on the same arm and targets, in turns with ours. Both are called
from Python, one target a call, starting from no hint.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.kinematics import Arm, solve_ik
from baselines.kinematics.ik import IKResult

Array = NDArray[np.float64]

POSITION_TOLERANCE, ORIENTATION_TOLERANCE = 1e-4, 1e-3  # [m], [rad]
PEER_TOLERANCE = 0.5 * POSITION_TOLERANCE**2  # of half the squared error, metres and radians alike

PEER_SCRIPT = r"""
import json, sys, time
import numpy as np
import roboticstoolbox as rtb
from roboticstoolbox import ET, ETS
task = json.loads(sys.stdin.readline())
steps, limits = np.array(task["chain"]), np.array(task["limits"])
row = np.array([[0.0, 0.0, 0.0, 1.0]])
parts = []
for step, limit in zip(steps, limits):
    parts += [ET.SE3(np.vstack([step, row])), ET.Rz(qlim=limit)]
arm = ETS(parts + [ET.SE3(np.vstack([steps[-1], row]))])
targets = [np.array(T) for T in task["targets"]]
arm.ik_LM(targets[0], tol=task["tolerance"])
print("ANSWER " + json.dumps(rtb.__version__), flush=True)
for line in sys.stdin:
    seconds, angles, claimed = [], [], []
    for T in targets:
        start = time.perf_counter()
        found = arm.ik_LM(T, tol=task["tolerance"])
        seconds.append(time.perf_counter() - start)
        q, success = (found.q, found.success) if hasattr(found, "success") else found[:2]
        angles.append([float(v) for v in q])
        claimed.append(bool(success))
    print("ANSWER " + json.dumps([seconds, angles, claimed]), flush=True)
"""


class Round(NamedTuple):
    """One pass over the targets."""

    seconds: Array  # (N,) of each call
    reached: NDArray[np.bool_]  # (N,) said to have converged, within limits and both tolerances by our own measure


def targets(arm: Arm, count: int, seed: int) -> Array:
    """(count, 4, 4) poses of uniform random joint angles within the limits."""
    rng = np.random.default_rng(seed)
    return arm.forward(rng.uniform(arm.limits[:, 0], arm.limits[:, 1], (count, arm.n)))


def reached(arm: Arm, q: Array, T: Array, claimed: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which of q (N, n) are within the limits and at the targets (N, 4, 4) to the tolerances."""
    found = arm.forward(q)
    position = np.linalg.norm(found[:, :3, 3] - T[:, :3, 3], axis=1)
    chord = np.linalg.norm(found[:, :3, :3] - T[:, :3, :3], axis=(1, 2))  # 2√2 sin(angle / 2)
    orientation = 2.0 * np.arcsin(np.minimum(chord / np.sqrt(8.0), 1.0))
    close = (position <= POSITION_TOLERANCE) & (orientation <= ORIENTATION_TOLERANCE)
    return close & arm.within_limits(q, 1e-9) & claimed


def ours(arm: Arm, T: Array, solve: Callable[[Arm, Array], IKResult]) -> Round:
    """A pass of one of this project's solvers."""
    seconds, results = [], []
    for target in T:
        start = time.perf_counter()
        result = solve(arm, target)
        seconds.append(time.perf_counter() - start)
        results.append(result)
    claimed = np.array([result.converged for result in results])
    return Round(np.array(seconds), reached(arm, np.array([result.q for result in results]), T, claimed))


class Peer:
    """The Robotics Toolbox in an interpreter of its own; a context manager that ends it.

    Raises:
        OSError: the interpreter cannot be run, or has no roboticstoolbox.
    """

    def __init__(self, python: str, arm: Arm, T: Array, tolerance: float = PEER_TOLERANCE) -> None:
        self._arm, self._targets = arm, T
        self._process = subprocess.Popen(
            [python, "-c", PEER_SCRIPT],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        task = {
            "chain": arm.chain.tolist(),
            "limits": arm.limits.tolist(),
            "targets": T.tolist(),
            "tolerance": tolerance,
        }
        try:
            self.version: str = self._ask(json.dumps(task))
        except BaseException:
            self.close()
            raise

    def round(self) -> Round:
        """A pass over the targets."""
        seconds, q, claimed = self._ask("round")
        return Round(np.array(seconds), reached(self._arm, np.array(q), self._targets, np.array(claimed)))

    def _ask(self, line: str) -> Any:
        assert self._process.stdin is not None and self._process.stdout is not None
        try:
            self._process.stdin.write(line + "\n")
            self._process.stdin.flush()
        except BrokenPipeError:
            pass  # it has ended: what it said follows
        for answer in self._process.stdout:
            if answer.startswith("ANSWER "):
                return json.loads(answer.removeprefix("ANSWER "))
        _, said = self._process.communicate()
        last = said.strip().splitlines()[-1:] or [""]
        raise OSError(f"the peer's interpreter ended with status {self._process.returncode}: {last[0]}")

    def close(self) -> None:
        """End the interpreter."""
        self._process.kill()
        self._process.communicate()

    def __enter__(self) -> Peer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def measure(peer_python: str | None, count: int = 1000, rounds: int = 3, seed: int = 0) -> dict[str, Any]:
    """Milliseconds a solve and the share solved, of each solver, over `rounds` passes in turns."""
    arm = Arm.hecatonquiros_6dof()
    T = targets(arm, count, seed)
    tolerances = (POSITION_TOLERANCE, ORIENTATION_TOLERANCE)
    solvers: dict[str, Callable[[], Round]] = {
        "dls": lambda: ours(arm, T, lambda a, t: solve_ik(a, t, None, "dls", "pose", *tolerances)),
        "global": lambda: ours(arm, T, lambda a, t: solve_ik(a, t, None, "global", "pose", *tolerances)),
    }
    for method in ("dls", "global"):
        solve_ik(arm, T[0], method=method)  # compiled, or read from the cache
    if peer_python is None:
        return _summary(solvers, rounds)
    with Peer(peer_python, arm, T) as peer:
        name = f"roboticstoolbox {peer.version} ik_LM"
        return _summary(solvers | {name: peer.round}, rounds)


def _summary(solvers: dict[str, Callable[[], Round]], rounds: int) -> dict[str, Any]:
    passes: dict[str, list[Round]] = {name: [] for name in solvers}
    for _ in range(rounds):
        for name, solve in solvers.items():
            passes[name].append(solve())
    return {
        name: {
            "median_ms": 1e3 * float(np.median([r.seconds for r in done])),
            "mean_ms": 1e3 * float(np.mean([r.seconds for r in done])),
            "solved": float(np.mean([r.reached for r in done])),
        }
        for name, done in passes.items()
    }


def main(argv: list[str]) -> int:
    """Print what each solver needs."""
    parser = argparse.ArgumentParser(prog="python -m agents.ik_speed", description=__doc__)
    parser.add_argument("--peer-python", metavar="PYTHON", help="an interpreter with roboticstoolbox-python")
    parser.add_argument("--targets", type=int, default=1000)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args(argv)
    try:
        found = measure(args.peer_python, args.targets, args.rounds, args.seed)
    except OSError as error:
        print(f"--peer-python: {error}", file=sys.stderr)
        return 1
    print(f"{'':32} {'median [ms]':>12} {'mean [ms]':>12} {'solved':>9}")
    for name, row in found.items():
        print(f"{name:32} {row['median_ms']:12.3f} {row['mean_ms']:12.3f} {row['solved']:9.2%}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
