"""Speed of registration, as the ratio to small_gicp called directly with the same settings on the same clouds.

`python -m agents.registration_speed [--points 20000] [--repeats 25]`: one run, one thread, warm, medians of
processor time taken in turns (which another program's load disturbs less than wall time), and of each turn's ratio.
The direct call thins both clouds, makes normals and covariances, and aligns once from the same start; `register` also
finds its scales, starts from a coarse stage and judges the result.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any


def processor_times(calls: dict[str, Callable[[], Any]], repeats: int) -> dict[str, list[float]]:
    """Processor seconds of each call, after one call to warm up, in turns."""
    for call in calls.values():
        call()
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(repeats):
        for name, call in calls.items():
            start = time.process_time()
            call()
            times[name].append(time.process_time() - start)
    return times


def measure(points: int = 20_000, repeats: int = 25) -> dict[str, dict[str, float]]:
    """Of each method: median seconds of both, the median ratio, and both errors (angle [rad] and distance [m])."""
    import numpy as np
    import small_gicp

    from aerograsp_env.spatial import inverse, se3_exp, se3_log, transform_points
    from baselines.detection.registration import KINDS, default_scales, register

    rng = np.random.default_rng(0)

    def surface() -> np.ndarray:
        x, y = rng.uniform(-0.5, 0.5, (2, points))
        z = 0.1 * np.sin(8 * x) + 0.1 * np.cos(7 * y) + 0.05 * np.sin(13 * x * y)
        return np.stack([x, y, z], axis=1) + 0.0005 * rng.normal(size=(points, 3))

    truth = se3_exp(np.array([0.02, -0.01, 0.01, 0.05, 0.02, -0.04]))
    source, target = surface(), transform_points(truth, surface())
    scales = default_scales(source, target)

    def direct(kind: str) -> Any:
        return small_gicp.align(
            target,
            source,
            registration_type=kind,
            downsampling_resolution=scales.resolution,
            max_correspondence_distance=scales.reach,
            max_iterations=50,
            rotation_epsilon=2e-3 * scales.resolution,
            translation_epsilon=2e-3 * scales.resolution,
        ).T_target_source

    def ours(method: Any) -> Any:
        return register(source, target, method=method).T_target_source

    out = {}
    for method, kind in KINDS.items():
        calls: dict[str, Callable[[], Any]] = {
            "direct": partial(direct, kind),
            "register": partial(ours, method),
        }
        times = processor_times(calls, repeats)
        row = {name: float(np.median(seconds)) for name, seconds in times.items()}
        row["ratio"] = float(np.median(np.divide(times["register"], times["direct"])))
        for name, call in calls.items():
            twist = se3_log(inverse(truth) @ call())
            row[f"{name} distance"], row[f"{name} angle"] = np.linalg.norm(twist.reshape(2, 3), axis=1).tolist()
        out[method] = row
    return out


def main(argv: list[str]) -> int:
    """Print seconds, ratios and errors."""
    parser = argparse.ArgumentParser(prog="python -m agents.registration_speed", description=__doc__)
    parser.add_argument("--points", type=int, default=20_000)
    parser.add_argument("--repeats", type=int, default=25)
    args = parser.parse_args(argv)
    for method, row in measure(args.points, args.repeats).items():
        print(
            f"{method:5} register {1e3 * row['register']:6.1f} ms   small_gicp {1e3 * row['direct']:6.1f} ms   "
            f"ratio {row['ratio']:.2f}   errors {1e3 * row['register distance']:.2f} and "
            f"{1e3 * row['direct distance']:.2f} mm"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
