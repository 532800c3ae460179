"""A tiny data set of coloured shapes in the detectors' layout, for tests."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np

CLASSES = ("disc", "bar", "frame")


def write_shapes(
    folder: Path, images: int, seed: int, size: tuple[int, int] = (160, 128), split: str = "train"
) -> Path:
    """`images` pictures of 1 to 3 shapes each on a noisy ground, with depth, boxes and poses.

    Args:
        folder: to write into.
        images: how many.
        seed: of the drawing.
        size: (width, height) [px].
        split: the card's.
    """
    rng = np.random.default_rng(seed)
    width, height = size
    for name in ("rgb", "depth"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    intrinsics = [150.0, 150.0, width / 2 - 0.5, height / 2 - 0.5]
    card = {"classes": list(CLASSES), "size": [width, height], "intrinsics": intrinsics, "split": split}
    card |= {"seed": seed, "images": images, "command": "tests", "version": 1}
    (folder / "card.json").write_text(json.dumps(card))
    lines = []
    for number in range(images):
        rgb = np.clip(rng.normal(rng.uniform(60, 200), 12.0, (height, width, 3)), 0, 255).astype(np.uint8)
        depth = np.full((height, width), 1200, dtype=np.uint16)
        boxes: list[list[float]] = []
        labels: list[int] = []
        for _ in range(rng.integers(1, 4)):
            x, y = int(rng.integers(8, width - 60)), int(rng.integers(8, height - 60))
            w, h = map(int, rng.integers(24, 50, 2))
            label = int(rng.integers(len(CLASSES)))
            w, h = (w, w) if label == 0 else (w, max(w // 4, 6)) if label == 1 else (w, h)
            box = [float(x), float(y), float(x + w), float(y + h)]
            if any(b[0] < box[2] and box[0] < b[2] and b[1] < box[3] and box[1] < b[3] for b in boxes):
                continue
            color = tuple(int(value) for value in rng.integers(0, 256, 3))
            for image, value in ((rgb, color), (depth, 1100)):
                if label == 0:
                    cv2.ellipse(image, ((x + w / 2 - 0.5, y + h / 2 - 0.5), (float(w), float(h)), 0.0), value, -1)
                else:
                    cv2.rectangle(image, (x, y), (x + w - 1, y + h - 1), value, -1)
                if label == 2:
                    inside = (x + w // 4, y + h // 4), (x + w - w // 4, y + h - h // 4)
                    cv2.rectangle(image, *inside, 1200 if image is depth else (127, 127, 127), -1)
            boxes.append(box)
            labels.append(label)
        cv2.imwrite(str(folder / "rgb" / f"{number:06d}.jpg"), rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 95])
        cv2.imwrite(str(folder / "depth" / f"{number:06d}.png"), depth)
        pose = np.eye(4)
        pose[2, 3] = 1.1
        line = {"image": number, "boxes": boxes, "labels": labels, "visibility": [1.0] * len(boxes)}
        line |= {"difficult": [False] * len(boxes), "T_c_object": [pose.ravel().tolist()] * len(boxes)}
        line |= {"intrinsics": intrinsics, "style": "studio", "level": "easy"}
        lines.append(json.dumps(line | {"scene_seed": number}))
    (folder / "labels.jsonl").write_text("\n".join(lines) + "\n")
    return folder
