"""Find objects in images: boxes, labels and, where there is depth, poses.

aerograsp detect tools.jpg --out found.png
aerograsp detect color.png --depth depth.png --intrinsics 525 525 319.5 239.5 --out found.png --json found.json
aerograsp detect rgbd_dataset_freiburg1_desk --out found/
aerograsp detect camera.toml --frames 100 --out found/

SOURCE is one picture; a folder of pictures, taken in the order of their names; a data set with depth (TUM, 7-Scenes and
others, recognised by themselves); or the configuration of a camera (`aerograsp_env.cameras`). Of all but one picture,
--out is a folder, and what cannot be read is counted and named. Exit status: 0 done, objects or none; 1 nothing could
be read; 2 misused.
"""

from __future__ import annotations

import argparse
import itertools
import math
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.cameras import open_camera
from aerograsp_env.cameras.image_files import ImageFileError, read_color, read_depth
from aerograsp_env.cameras.layouts import recognise
from aerograsp_env.interfaces import RGBD, Detection, Detector, Intrinsics
from agents.arguments import FAILED, Parser, add_json, guarded, positive_int
from agents.files import write_json
from agents.provenance import provenance
from agents.table import aligned

SUFFIXES = (".png", ".jpg", ".jpeg")
MAX_GAP = 0.02  # [s] between a picture and its depth
FOVY = math.radians(50.0)  # of a photograph whose camera is not known; only poses would depend on it


def frame_of(rgb: NDArray[np.uint8], depth: NDArray[np.float32] | None, intrinsics: Sequence[float] | None) -> RGBD:
    """A frame of an image (H, W, 3), its depth (H, W) [m] or None, and fx, fy, cx, cy [px] or None.

    Raises:
        ValueError: depth of another size, depth without intrinsics, or intrinsics that are none.
    """
    height, width = rgb.shape[:2]
    if depth is not None and depth.shape != (height, width):
        raise ValueError(
            f"--depth: expected an image of the colour image's {width} × {height} px, "
            f"got {depth.shape[1]} × {depth.shape[0]}"
        )
    if depth is not None and intrinsics is None:
        raise ValueError("--intrinsics: expected FX FY CX CY with --depth, got none: poses need the camera")
    if intrinsics is None:
        focal = 0.5 * height / math.tan(0.5 * FOVY)
        intrinsics = (focal, focal, 0.5 * (width - 1), 0.5 * (height - 1))
    camera = Intrinsics(width, height, *intrinsics)
    return RGBD(rgb, np.zeros((height, width), dtype=np.float32) if depth is None else depth, camera)


def detect(frame: RGBD, detector: Detector) -> list[Detection]:
    """What the detector finds, with poses where the frame has depth."""
    found = detector.detect(frame)
    if not frame.depth.any():
        return found
    from agents.detect_posed import posed

    return posed(found, frame)


class Shot(NamedTuple):
    """A frame and the name that it goes by."""

    name: str
    frame: RGBD


class Source:
    """Frames one after another, and what could not be read.

    Args:
        path: a picture, a folder of pictures, a data set's folder or a camera's configuration.
        depth, unit: depth of a single picture, and its steps a metre.
        intrinsics: fx, fy, cx, cy [px] of pictures; data sets and cameras know their own.

    Raises:
        FileNotFoundError: there is no such file or folder, or nothing in it.
        ValueError: options that do not fit the kind of source.
    """

    def __init__(
        self,
        path: Path,
        depth: Path | None = None,
        unit: float = 1000.0,
        intrinsics: Sequence[float] | None = None,
    ) -> None:
        self.bad: list[str] = []
        self.report = ""
        self._path, self._intrinsics = path, intrinsics
        self.pictures = [path] if path.is_file() and path.suffix.lower() in SUFFIXES else _pictures_in(path)
        self.single = path.is_file() and bool(self.pictures)
        if depth is not None and not self.single:
            raise ValueError("--depth: expected a single picture as SOURCE")
        if intrinsics is not None and not self.pictures:
            raise ValueError("--intrinsics: expected pictures as SOURCE; data sets and cameras know their own")
        self._depth = None if depth is None else read_depth(depth, unit)

    def __iter__(self) -> Iterator[Shot]:
        if self.pictures:
            yield from self._of_pictures()
            return
        with open_camera(self._path) as camera:
            for number, frame in enumerate(camera):
                yield Shot(f"{number:06d}", frame)
            self.bad += [f"{name}: {why}" for name, why in camera.report.bad]
            self.report = str(camera.report)

    def _of_pictures(self) -> Iterator[Shot]:
        for path in self.pictures:
            try:
                rgb = read_color(path)
            except ImageFileError as error:
                if self.single:
                    raise
                self.bad.append(str(error))
                continue
            yield Shot(path.stem, frame_of(rgb, self._depth, self._intrinsics))


def _pictures_in(path: Path) -> list[Path]:
    """The pictures of a folder that is no data set; none of a data set or a configuration."""
    if not path.exists():
        raise FileNotFoundError(f"SOURCE: no such file or folder: {path}")
    if path.is_file():
        return []
    found = sorted(file for file in path.iterdir() if file.suffix.lower() in SUFFIXES)
    try:
        recognise(path, MAX_GAP)
    except ValueError:
        if not found:
            raise
        return found
    return []


def _row(name: str, found: Detection) -> list[str]:
    position = "–" if found.T_c_object is None else " ".join(f"{value:.3f}" for value in found.T_c_object[:3, 3])
    return [name, found.label, f"{found.score:.2f}", " ".join(f"{edge:.0f}" for edge in found.box), position]


def _data(shot: Shot, found: Iterable[Detection]) -> dict[str, Any]:
    rows = [
        {"label": d.label, "score": d.score, "box": d.box, "T_c_object": d.T_c_object, "covariance": d.covariance}
        for d in found
    ]
    return {"image": shot.name, "stamp": shot.frame.stamp, "detections": rows}


def _parser() -> Parser:
    parser = Parser(prog="aerograsp detect", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source", metavar="SOURCE", type=Path, help="picture, folder, data set or camera configuration")
    parser.add_argument("--out", metavar="FILE.png|FOLDER", type=Path, help="write the picture(s) with what was found")
    parser.add_argument("--depth", metavar="FILE", type=Path, help="depth of one picture, registered to it (16 bits)")
    parser.add_argument(
        "--depth-unit", metavar="STEPS", type=float, default=1000.0, help="depth steps a metre (default: 1000)"
    )
    parser.add_argument("--intrinsics", metavar=("FX", "FY", "CX", "CY"), type=float, nargs=4, help="camera [px]")
    parser.add_argument("--frames", metavar="N", type=positive_int, help="at most so many (default: all)")
    parser.add_argument("--detector", metavar="FILE.onnx", type=Path, help="default: the one that was shipped")
    parser.add_argument("--threshold", metavar="SCORE", type=float, help="least score (default: the detector's own)")
    add_json(parser)
    return parser


def _run(argv: list[str]) -> int:
    from tqdm import tqdm

    from aerograsp_env.envs.detect_view import draw_detections
    from aerograsp_env.sim.video import write_png
    from agents.detect_onnx import OnnxDetector, shipped_detector

    args = _parser().parse_args(argv)
    source = Source(args.source, args.depth, args.depth_unit, args.intrinsics)
    if args.out is not None and source.single and args.out.suffix.lower() != ".png":
        raise ValueError(f"--out: expected a name that ends in .png, got {args.out.name!r}")
    detector = OnnxDetector(args.detector or shipped_detector(), args.threshold)
    if args.out is not None and not source.single:
        args.out.mkdir(parents=True, exist_ok=True)
    rows: list[list[str]] = []
    results: list[dict[str, Any]] = []
    shots = itertools.islice(source, args.frames)
    for shot in tqdm(shots, desc="frames", unit="frame", total=args.frames, disable=True if source.single else None):
        found = detect(shot.frame, detector)
        rows += [_row(shot.name, detection) for detection in found]
        results.append(_data(shot, found))
        if args.out is not None:
            target = args.out if source.single else args.out / f"{shot.name}.png"
            write_png(target, draw_detections(shot.frame.rgb, found, shot.frame.intrinsics))
    if args.json != "-":
        notes = [f"{len(rows)} objects in {len(results)} frames.", *source.bad]
        print(aligned([["frame", "class", "score", "box [px]", "position [m]"], *rows], notes))
    if args.json is not None:
        origin = provenance(["aerograsp", "detect", *argv])
        write_json(args.json, {"frames": results, "unread": source.bad, "report": source.report, "provenance": origin})
    return 0 if results else FAILED


def main(argv: list[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    return guarded("aerograsp detect", _run, sys.argv[1:] if argv is None else argv)


if __name__ == "__main__":
    sys.exit(main())
