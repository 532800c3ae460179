"""Find objects in images: boxes, labels and, where there is depth, poses.

aerograsp detect tools.jpg --out found.png
aerograsp detect color.png --depth depth.png --intrinsics 525 525 319.5 239.5 --out found.png --json found.json

IMAGE is one file, or a folder whose PNG and JPEG files are taken in the order of their names; --out is then a folder.
Images of a folder that cannot be read are counted and named. Exit status: 0 done, objects or none; 1 no image could be
read; 2 misused.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.cameras.image_files import ImageFileError, read_color, read_depth
from aerograsp_env.interfaces import RGBD, Detection, Detector, Intrinsics
from agents.arguments import FAILED, Parser, add_json, guarded
from agents.files import write_json
from agents.provenance import provenance
from agents.table import aligned

SUFFIXES = (".png", ".jpg", ".jpeg")
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


def images_in(path: Path) -> list[Path]:
    """The image, or the images of a folder in the order of their names.

    Raises:
        FileNotFoundError: neither, or a folder without any.
    """
    if path.is_file():
        return [path]
    if not path.is_dir():
        raise FileNotFoundError(f"IMAGE: no such file or folder: {path}")
    found = sorted(file for file in path.iterdir() if file.suffix.lower() in SUFFIXES)
    if not found:
        raise FileNotFoundError(f"IMAGE: no {', '.join(SUFFIXES)} files in {path}")
    return found


def _target(out: Path, image: Path, folder: bool) -> Path:
    return out / f"{image.stem}.png" if folder else out


def _rows(image: Path, found: Iterable[Detection]) -> list[list[str]]:
    return [
        [image.name, d.label, f"{d.score:.2f}", " ".join(f"{edge:.0f}" for edge in d.box), _position(d)] for d in found
    ]


def _position(detection: Detection) -> str:
    if detection.T_c_object is None:
        return "–"
    return " ".join(f"{value:.3f}" for value in detection.T_c_object[:3, 3])


def _data(image: Path, found: Iterable[Detection]) -> dict[str, Any]:
    rows = [
        {"label": d.label, "score": d.score, "box": d.box, "T_c_object": d.T_c_object, "covariance": d.covariance}
        for d in found
    ]
    return {"image": image.name, "detections": rows}


def _parser() -> Parser:
    parser = Parser(prog="aerograsp detect", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("image", metavar="IMAGE", type=Path, help="a PNG or JPEG file, or a folder of them")
    parser.add_argument("--out", metavar="FILE.png|FOLDER", type=Path, help="write the picture(s) with what was found")
    parser.add_argument("--depth", metavar="FILE", type=Path, help="depth of one IMAGE, registered to it (16-bit PNG)")
    parser.add_argument(
        "--depth-scale", metavar="UNITS", type=float, default=1000.0, help="depth units a metre (default: 1000)"
    )
    parser.add_argument("--intrinsics", metavar=("FX", "FY", "CX", "CY"), type=float, nargs=4, help="camera [px]")
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
    images = images_in(args.image)
    folder = args.image.is_dir()
    if args.depth is not None and folder:
        raise ValueError("--depth: expected one IMAGE, got a folder")
    if args.out is not None and not folder and args.out.suffix.lower() != ".png":
        raise ValueError(f"--out: expected a name that ends in .png, got {args.out.name!r}")
    detector = OnnxDetector(args.detector or shipped_detector(), args.threshold)
    if args.out is not None and folder:
        args.out.mkdir(parents=True, exist_ok=True)
    depth = None if args.depth is None else read_depth(args.depth, args.depth_scale)
    rows: list[list[str]] = []
    results: list[dict[str, Any]] = []
    bad: list[str] = []
    for image in tqdm(images, desc="images", unit="image", disable=None if folder else True):
        try:
            rgb = read_color(image)
        except ImageFileError as error:
            if not folder:
                raise
            bad.append(str(error))
            continue
        frame = frame_of(rgb, depth, args.intrinsics)
        found = detect(frame, detector)
        rows += _rows(image, found)
        results.append(_data(image, found))
        if args.out is not None:
            write_png(_target(args.out, image, folder), draw_detections(rgb, found, frame.intrinsics))
    if args.json != "-":
        notes = [f"{len(rows)} objects in {len(results)} of {len(images)} images.", *bad]
        print(aligned([["image", "class", "score", "box [px]", "position [m]"], *rows], notes))
    if args.json is not None:
        write_json(args.json, {"images": results, "unread": bad, "provenance": provenance(["aerograsp", "detect", *argv])})
    return 0 if results else FAILED


def main(argv: list[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    return guarded("aerograsp detect", _run, sys.argv[1:] if argv is None else argv)


if __name__ == "__main__":
    sys.exit(main())
