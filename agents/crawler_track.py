"""The crawler's pose while the vehicle that looks at it flies past, circles or hovers in wind (`aerograsp/Detect-v0`).

`python -m agents.crawler_track [--out FOLDER] [--level LEVEL] [--flights N] [--seed SEED] [--boxes true|detector …]`

Compared are each frame by itself, the filter behind those same poses, and filters from whose prediction the alignment
starts. Boxes are the shipped detector's, or the true ones with noise.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from aerograsp_env.metrics import count_jumps
from aerograsp_env.sim.visual import CLASSES
from aerograsp_env.sim.visual.scenes import LEVELS
from aerograsp_env.spatial import Array
from agents.arguments import positive_int, seed_int
from agents.crawler_flights import BOX_NOISE, POSITION, ROTATION, Flights, Frame, detected_boxes, fly, true_boxes
from agents.detect_onnx import OnnxDetector, shipped_detector
from agents.files import writable_folder, write_atomic, write_json
from agents.pictures import figure_grid, png
from agents.provenance import provenance
from agents.reproduction import text_table
from agents.seeds import TEST_SEED
from agents.statistics import Interval

SOURCES = ("true", "detector")
QUANTILES = (0.5, 0.95)
RESAMPLES = 2000

NOTES = """\
{frames} frames × crawlers in {tracks} tracks. Not counted: {difficult} in which a crawler is difficult (not 40 % of it
visible), {unseen} in which it has left the picture. Errors: median / 95th percentile, rotations up to the crawler's
symmetry. Jumps: of raw rotations, symmetry or not. Intervals resample flights. True boxes have {noise:g} px of noise.
"alone": each frame by itself; "alone, then ekf": those poses, filtered; others start aligning from their prediction."""


def summary(rows: Sequence[Frame]) -> dict[str, Any]:
    """Shares, medians, jumps. The interval resamples flights: frames of one flight are not independent.

    Raises:
        ValueError: no frames.
    """
    if not rows:
        raise ValueError("frames: expected at least one that shows a crawler well, got none")
    good = np.array([row.good for row in rows])
    flights = np.array([row.flight for row in rows])
    which, at = np.unique(flights, return_inverse=True)
    counts, hits = np.bincount(at), np.bincount(at, weights=good)
    drawn = np.random.default_rng(0).integers(len(which), size=(RESAMPLES, len(which)))
    low, high = np.quantile(hits[drawn].sum(axis=1) / counts[drawn].sum(axis=1), (0.025, 0.975))
    position, rotation = np.array([row.position for row in rows]), np.array([row.rotation for row in rows])
    jumps = [count_jumps(np.array(track)) for track in _tracks(rows).values()]
    return {
        "frames": len(rows),
        "tracks": len({(row.flight, row.crawler) for row in rows}),
        "boxed": float(np.mean([row.boxed for row in rows])),
        "posed": float(np.isfinite(position).mean()),
        "good": float(good.mean()),
        "interval": Interval(float(low), float(high)),
        "position": np.quantile(position, QUANTILES, method="lower").tolist(),
        "rotation": np.quantile(rotation, QUANTILES, method="lower").tolist(),
        "jumps": sum(jumps),
        "jumping_tracks": sum(jump > 0 for jump in jumps),
    }


def _tracks(rows: Sequence[Frame]) -> dict[tuple[int, int], list[Array]]:
    """T_world_object (4, 4) of each crawler in each flight, as far as there is one."""
    tracks: dict[tuple[int, int], list[Array]] = {}
    for row in rows:
        if row.T_world_object is not None:
            tracks.setdefault((row.flight, row.crawler), []).append(row.T_world_object)
    return tracks


def table(flights: Flights) -> str:
    """What `summary` says of each method, and what was left out."""
    rows = [["boxes", "method", "boxed", "posed", "1 cm, 5°", "95 %", "position [mm]", "rotation [°]", "jumps > 30°"]]
    for (source, name), frames in flights.frames.items():
        s = summary(frames)
        (middle, high), (turn, most) = s["position"], s["rotation"]
        rows.append(
            [source, name, f"{s['boxed']:.1%}", f"{s['posed']:.1%}", f"{s['good']:.1%}",
             f"{s['interval'].low:.1%} … {s['interval'].high:.1%}", f"{1e3 * middle:.1f} / {1e3 * high:.1f}",
             f"{np.degrees(turn):.1f} / {np.degrees(most):.1f}", f"{s['jumps']} in {s['jumping_tracks']} tracks"]
        )  # fmt: skip
    return text_table(rows, 2) + "\n" + NOTES.format(
        frames=s["frames"], tracks=s["tracks"], difficult=flights.left.difficult, unseen=flights.left.unseen,
        noise=BOX_NOISE,
    )  # fmt: skip


def picture(flights: Flights) -> bytes:
    """Frames with the filter's axes; the track that jumps most; errors over the distance."""
    figure, axes = figure_grid(2, 3, (13.0, 7.2))
    for axis in axes[:3]:
        axis.set_axis_off()
    for axis, image in zip(axes, flights.pictures, strict=False):
        axis.imshow(image)
    source = next(iter(flights.frames))[0]
    alone, ekf = flights.frames[source, "alone"], flights.frames[source, "ekf"]
    jumps = {key: count_jumps(np.array(track)) for key, track in _tracks(alone).items()}
    worst = max(jumps, key=lambda key: jumps[key], default=None)
    start = np.eye(3)
    for name, rows, color in (("EKF", ekf, "#1f6fb4"), ("each frame alone", alone, "#c0504d")):
        one = [row for row in rows if (row.flight, row.crawler) == worst]
        poses = [(row.time, row.T_world_object[:3, :3]) for row in one if row.T_world_object is not None]
        if name == "EKF" and poses:
            start = poses[0][1]
        turns = [np.degrees(np.arctan2(*(start.T @ R)[[1, 0], 0])) for _, R in poses]  # from the EKF's first pose
        axes[3].plot([time for time, _ in poses], turns, ".-", color=color, lw=0.8, zorder=3 if name == "EKF" else 2)
        found = [row for row in rows if np.isfinite(row.position)]
        far = [row.distance for row in found]
        axes[4].semilogy(far, [1e3 * row.position for row in found], ".", color=color, ms=2, label=name)
        axes[5].semilogy(far, np.degrees([row.rotation for row in found]), ".", color=color, ms=2)
    axes[3].set(xlabel="time [s]", ylabel="crawler's turn about its z axis [°]", title="most jumps of all")
    for axis, limit, name in (
        (axes[4], 1e3 * POSITION, "position error [mm]"), (axes[5], np.degrees(ROTATION), "rotation error [°]"),
    ):  # fmt: skip
        axis.axhline(limit, color="#888888", lw=0.8)
        axis.set(xlabel="distance [m]", ylabel=name)
    axes[4].legend(frameon=False, markerscale=4)
    return png(figure)


def main(arguments: Sequence[str]) -> int:
    """Print the table; write table, data and picture."""
    parser = argparse.ArgumentParser(prog="python -m agents.crawler_track", description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, help="folder for crawler-track.txt, .json and .png")
    parser.add_argument("--level", choices=LEVELS, default="easy")
    parser.add_argument("--flights", type=positive_int, default=24)
    parser.add_argument("--seed", type=seed_int, default=TEST_SEED)
    parser.add_argument("--boxes", choices=SOURCES, nargs="+", default=list(SOURCES))
    given = parser.parse_args(arguments)
    folder = None if given.out is None else writable_folder(given.out)
    makers = {
        "true": lambda: true_boxes(np.random.default_rng(given.seed)),
        "detector": lambda: detected_boxes(OnnxDetector(shipped_detector(), classes=CLASSES)),
    }
    flights = fly(given.level, given.flights, given.seed, {name: makers[name]() for name in given.boxes})
    text = table(flights)
    print(text)
    if folder is not None:
        data = {
            "level": given.level, "flights": given.flights, "seed": given.seed, "left": flights.left._asdict(),
            "methods": {f"{source}: {name}": summary(rows) for (source, name), rows in flights.frames.items()},
            "provenance": provenance(["python -m agents.crawler_track", *arguments]),
        }  # fmt: skip
        write_atomic(folder / "crawler-track.txt", text + "\n")
        write_json(folder / "crawler-track.json", data)
        write_atomic(folder / "crawler-track.png", picture(flights))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
