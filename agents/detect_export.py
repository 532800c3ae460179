"""A trained detector as one ONNX file, with the card in its metadata and beside it as JSON.

aerograsp detector export runs/detect-yolo/best.safetensors detector.onnx
"""

from __future__ import annotations

import argparse
import json
import logging
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from agents.arguments import Parser
from agents.detect_onnx import SCHEMA, OnnxDetector
from agents.files import dumps, writable_folder, write_atomic

SIZE = (256, 320)
"""(height, width) [px] of the input: pictures of 320 × 240, letterboxed to multiples of 32."""
AGREEMENT = 1e-3
"""How far scores in ONNX Runtime may be from torch's."""


def export_onnx(
    checkpoint: str | Path, out: str | Path, size: tuple[int, int] = SIZE, figures: dict[str, Any] | None = None
) -> Path:
    """Export weights, check that ONNX Runtime computes what torch does, and write the file and its card.

    Args:
        checkpoint: a training's best.safetensors.
        out: the .onnx file; its card goes beside it as .json.
        size: (height, width) of the input [px], multiples of 64.
        figures: results to record in the card.

    Raises:
        ValueError: a wrong name or size, or a checkpoint that is none.
        RuntimeError: the exported network does not agree with torch.
    """
    import onnx
    import torch

    from agents.detect_torch import load_detector
    from agents.networks.detector import INPUTS, build

    out = Path(out)
    if out.suffix != ".onnx":
        raise ValueError(f"out: expected a name that ends in .onnx, got {out.name!r}")
    if any(side < 64 or side % 64 for side in size):
        raise ValueError(f"size: expected multiples of 64 pixels, got {size[0]} × {size[1]}")
    layout, tensors, trained = load_detector(checkpoint)
    network = build(layout)
    network.load_state_dict(tensors)
    network.eval()
    writable_folder(out.absolute().parent)
    generator = torch.Generator().manual_seed(0)
    images = torch.rand((1, INPUTS[layout.input], *size), generator=generator)
    logging.getLogger("torch.onnx._internal.exporter._registration").setLevel(logging.ERROR)  # names torchvision's
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            network,
            (images,),
            dynamo=True,
            optimize=True,
            verbose=False,
            input_names=["images"],
            output_names=["boxes", "scores"],
        )
    assert program is not None  # it is with dynamo
    model = program.model_proto
    card = {
        "schema": SCHEMA,
        "classes": list(layout.classes),
        "family": layout.family,
        "input": layout.input,
        "size": list(size),
        "threshold": trained["threshold"],
        "parameters": sum(value.numel() for value in network.parameters()),
        "training": trained["training"],
        "pictures": trained["pictures"],
        "step": trained["step"],
        "curve": trained["curve"],
        "provenance": trained["provenance"],
        "initial": trained.get("initial"),  # what the weights that the training began with came from
        "figures": figures or {},
    }
    onnx.helper.set_model_props(model, {"card": json.dumps(card)})
    for node in model.graph.node:  # where each node stood in the source is of no use, and names this machine's folders
        del node.metadata_props[:]
        node.doc_string = ""
    for value in (*model.graph.value_info, *model.graph.input, *model.graph.output, *model.graph.initializer):
        del value.metadata_props[:]
    onnx.checker.check_model(model)
    write_atomic(out, model.SerializeToString())
    write_atomic(out.with_suffix(".json"), dumps(card))
    _check(out, network, images)
    return out


def _check(path: Path, network: Any, images: Any) -> None:
    """Scores in ONNX Runtime against torch's."""
    import torch

    detector = OnnxDetector(path)
    outputs: list[Any] = detector._session.run(None, {"images": images.numpy()})
    with torch.no_grad():
        boxes, scores = network(images)
    difference = float(np.abs(outputs[1] - scores.numpy()).max())
    if outputs[0].shape != tuple(boxes.shape) or not difference <= AGREEMENT:
        raise RuntimeError(f"{path}: expected scores within {AGREEMENT} of torch's, they differ by {difference:.3g}")


def main(argv: list[str]) -> int:
    """`aerograsp detector export`."""
    parser = Parser(
        prog="aerograsp detector export",
        description="Export a trained detector as one ONNX file.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument("checkpoint", metavar="CHECKPOINT", help="a training's best.safetensors")
    parser.add_argument("out", metavar="FILE", help="to write (.onnx)")
    parser.add_argument("--size", metavar="N", type=int, nargs=2, default=SIZE, help="height and width of the input")
    args = parser.parse_args(argv)
    path = export_onnx(args.checkpoint, args.out, (args.size[0], args.size[1]))
    print(f"{path}: {path.stat().st_size / 1e6:.1f} MB")
    return 0


if __name__ == "__main__":
    from agents.arguments import guarded

    sys.exit(guarded("aerograsp detector export", main, sys.argv[1:]))
