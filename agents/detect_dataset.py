"""Data sets for detectors: rendered pictures with boxes and poses, in a folder that grows as they are drawn.

Layout: `card.json` (classes, size, intrinsics, split, seed, command, version), `rgb/000000.jpg`, `depth/000000.png`
(uint16, millimetres, 0 where there is none) and `labels.jsonl`, one line a picture:

    {"image": 0, "boxes": [[x1, y1, x2, y2]], "labels": [int], "visibility": [..], "difficult": [..],
     "T_c_object": [[16 numbers, row by row]], "intrinsics": [fx, fy, cx, cy], "style": "aerial" | "studio",
     "level": "easy", "scene_seed": 0}

A line is written after its picture, so that what has a line is whole. Writing again goes on where it was interrupted
and ends with the same bytes; a folder can be read while it grows.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import io
import json
import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from PIL import Image

from aerograsp_env.sim.visual import CLASSES
from aerograsp_env.sim.visual.mesh_files import mesh_file, object_from_mesh
from aerograsp_env.sim.visual.objects import VisualObject
from agents.detect_samples import VERSION, DetectDataset, Sample, read_json
from agents.files import dumps, to_json, writable_folder, write_atomic
from agents.workers import run_jobs

__all__ = ["SPLITS", "DetectDataset", "Sample", "main", "write_dataset"]

SPLITS = {"train": 0, "validation": 10_000_000, "test": 20_000_000}
"""First scene seed of each split."""

SEEDS, SEED_STEP = 100, 100_000  # how many seeds a split has, and scenes each
NOMINAL_FOVY = np.radians(50.0)  # of the card's intrinsics; every picture has its own
QUALITY = 95  # of JPEG


def write_dataset(
    out: str | Path,
    images: int,
    seed: int = 0,
    split: str = "train",
    size: tuple[int, int] = (320, 240),
    randomize: bool = True,
    workers: int = 1,
    progress: bool = False,
    command: str | None = None,
    meshes: Mapping[str, str | Path] = MappingProxyType({}),
) -> Path:
    """Render `images` pictures into the folder `out`, or those that are missing; returns the folder.

    Args:
        seed: 0–99; splits and seeds share no scene.
        size: width and height [px].
        randomize: off for nominal shapes, fixed looks, one light and plain grounds: what domain randomisation is
            compared with.
        workers: processes.
        progress: a bar, if standard error is a terminal.
        command: kept in the card.
        meshes: class → a mesh file or a YCB object's folder: what the class's objects are instead of random ones.

    Raises:
        FileNotFoundError: no such mesh.
        ValueError: a number out of range, an unknown split, or a folder that holds another data set.
        OSError: the folder cannot be written.
    """
    from tqdm import tqdm

    from agents.detect_pictures import ARRANGEMENTS, BLOCK

    _check(images, seed, split, size, workers, SEED_STEP // ARRANGEMENTS * BLOCK)
    folder = writable_folder(out)
    card = {
        "version": VERSION,
        "classes": list(CLASSES),
        "size": list(size),
        "split": split,
        "seed": seed,
        "randomize": randomize,
        "intrinsics": _intrinsics(size),
        "meshes": {label: hashlib.sha256(mesh_file(path).read_bytes()).hexdigest() for label, path in meshes.items()},
        "images": images,
        "command": command,
    }
    objects = {label: object_from_mesh(path, label) for label, path in meshes.items()}
    done = _resume(folder, card, BLOCK)
    for name in ("rgb", "depth"):
        (folder / name).mkdir(exist_ok=True)
    write_atomic(folder / "card.json", dumps(card))
    first = SPLITS[split] + seed * SEED_STEP
    jobs = [
        (folder, block * BLOCK, min(images - block * BLOCK, BLOCK), first + block * ARRANGEMENTS)
        + (size, randomize, objects)
        for block in range(done // BLOCK, -(-images // BLOCK))
    ]
    bar = tqdm(total=images, initial=min(done, images), desc=f"{split} pictures", unit="image")
    bar.disable = bar.disable or not progress
    with bar, (folder / "labels.jsonl").open("a", encoding="utf-8") as lines:
        for rows in run_jobs(draw_rows, jobs, workers):
            lines.write("".join(json.dumps(row, separators=(",", ":")) + "\n" for row in rows))
            lines.flush()
            bar.update(len(rows))
    return folder


def _check(images: int, seed: int, split: str, size: tuple[int, int], workers: int, most: int) -> None:
    if not 1 <= images <= most:
        raise ValueError(f"images: expected 1 to {most}, got {images}")
    if not 0 <= seed < SEEDS:
        raise ValueError(f"seed: expected 0 to {SEEDS - 1}, got {seed}")
    if split not in SPLITS:
        raise ValueError(f"split: expected one of {', '.join(SPLITS)}, got {split!r}")
    if len(size) != 2 or not all(32 <= side <= 4096 for side in size):
        raise ValueError(f"size: expected width and height of 32 to 4096 px, got {size}")
    if workers < 1:
        raise ValueError(f"workers: expected at least 1, got {workers}")


def _intrinsics(size: tuple[int, int]) -> list[float]:
    from agents.detect_pictures import intrinsics_of

    camera = intrinsics_of(size, float(NOMINAL_FOVY))
    return [camera.fx, camera.fy, camera.cx, camera.cy]


def _resume(folder: Path, card: dict[str, Any], block: int) -> int:
    """How many pictures are there, in whole blocks; what was left of an unfinished block is dropped."""
    path = folder / "card.json"
    if path.exists():
        old = read_json(path)
        for name in ("version", "classes", "size", "split", "seed", "randomize", "meshes"):
            if old.get(name, {}) != card[name]:
                raise ValueError(f"out: {folder} holds another data set: {name} {old.get(name)!r}, not {card[name]!r}")
    labels = folder / "labels.jsonl"
    if not labels.exists():
        return 0
    rows = [line for line in labels.read_text(encoding="utf-8").split("\n")[:-1] if line]
    whole = len(rows) // block * block
    write_atomic(labels, "".join(row + "\n" for row in rows[:whole]))
    return whole


def draw_rows(
    folder: Path,
    start: int,
    count: int,
    scene_seed: int,
    size: tuple[int, int],
    randomize: bool,
    meshes: Mapping[str, VisualObject],
) -> list[dict[str, Any]]:
    """Draw a block, write its first `count` pictures as number `start` and on, and return their labels' rows."""
    from agents.detect_pictures import draw_block

    rows = []
    for number, picture in enumerate(draw_block(scene_seed, size, randomize, meshes)[:count], start):
        frame, truths = picture.frame, picture.truths
        buffer = io.BytesIO()
        Image.fromarray(frame.rgb).save(buffer, "JPEG", quality=QUALITY)
        write_atomic(folder / "rgb" / f"{number:06d}.jpg", buffer.getvalue())
        buffer = io.BytesIO()
        Image.fromarray(np.rint(frame.depth * 1e3).astype(np.uint16)).save(buffer, "PNG", compress_level=2)
        write_atomic(folder / "depth" / f"{number:06d}.png", buffer.getvalue())
        camera = frame.intrinsics
        rows.append(
            to_json(
                {
                    "image": number,
                    "boxes": [truth.box.tolist() for truth in truths],
                    "labels": [CLASSES.index(truth.label) for truth in truths],
                    "visibility": [round(truth.visibility, 4) for truth in truths],
                    "difficult": [bool(truth.difficult) for truth in truths],
                    "T_c_object": [np.round(truth.T_c_object, 9).ravel().tolist() for truth in truths],
                    "intrinsics": [camera.fx, camera.fy, camera.cx, camera.cy],
                    "style": picture.style,
                    "level": picture.level,
                    "scene_seed": picture.scene_seed,
                }
            )
        )
    return rows


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `aerograsp dataset detect`."""
    parser.add_argument("--out", required=True, type=Path, help="folder of the data set; goes on with one begun there")
    parser.add_argument("--images", type=int, default=12000, help="how many pictures (default %(default)s)")
    parser.add_argument("--split", choices=tuple(SPLITS), default="train", help="whose scenes (default %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help=f"0–{SEEDS - 1} (default %(default)s)")
    parser.add_argument("--size", type=int, nargs=2, default=(320, 240), metavar=("W", "H"), help="pixels (320 240)")
    parser.add_argument(
        "--no-randomize", action="store_true", help="nominal shapes, fixed looks, one light, plain grounds"
    )
    parser.add_argument(
        "--mesh",
        action="append",
        default=[],
        metavar="CLASS=FILE",
        help="draw this mesh (or YCB object's folder) where the class is drawn, in its own colours; repeatable",
    )
    parser.add_argument("--workers", type=int, default=1, help="processes (default %(default)s)")


def _meshes(given: Sequence[str]) -> dict[str, str]:
    pairs = [text.partition("=") for text in given]
    if wrong := [label + sign + path for label, sign, path in pairs if label not in CLASSES or not path]:
        raise ValueError(f"--mesh: expected CLASS=FILE with one of {', '.join(CLASSES)}, got {wrong[0]!r}")
    return {label: path for label, _, path in pairs}


def run(args: argparse.Namespace, command: str | None = None) -> int:
    """Write a data set; 130 if interrupted, which loses at most the block in work."""
    try:
        folder = write_dataset(
            *(args.out, args.images, args.seed, args.split, (args.size[0], args.size[1]), not args.no_randomize),
            *(args.workers, True, command, _meshes(args.mesh)),
        )
    except KeyboardInterrupt:
        with contextlib.suppress(OSError, ValueError):
            print(f"interrupted; {args.out} keeps its pictures, the same command goes on", file=sys.stderr)
        return 130
    print(f"{folder}: {len(DetectDataset(folder))} pictures")
    return 0


def main(argv: list[str] | None = None) -> int:
    """`python -m agents.detect_dataset`, the same as `aerograsp dataset detect`."""
    parser = argparse.ArgumentParser(prog="aerograsp dataset detect", description=__doc__.split("\n")[0])
    add_arguments(parser)
    arguments = sys.argv[1:] if argv is None else argv
    return run(parser.parse_args(arguments), shlex.join(["aerograsp", "dataset", "detect", *arguments]))


if __name__ == "__main__":
    raise SystemExit(main())
