"""Data sets for detectors: whole or resumed they are the same bytes, and what is wrong with one is said."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

import agents.detect_pictures as pictures
from aerograsp_env.sim.visual import CLASSES
from aerograsp_env.sim.visual.mesh_files import object_from_mesh
from agents.detect_dataset import SEED_STEP, SEEDS, SPLITS, DetectDataset, main, write_dataset

SIZE = (64, 48)
IMAGES = pictures.BLOCK + 3  # a whole block, and a part of one


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("detect") / "whole", IMAGES, size=SIZE)


@pytest.fixture
def copy(whole: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(whole, tmp_path / "copy"))


def files(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_what_is_written_is_read_back(whole: Path) -> None:
    data = DetectDataset(whole)
    assert len(data) == IMAGES
    assert data.classes == CLASSES
    assert (data.intrinsics.width, data.intrinsics.height) == SIZE
    styles = set()
    for index in range(len(data)):
        sample = data[index]
        count = len(sample.boxes)
        assert sample.rgb.shape == (48, 64, 3)
        assert sample.rgb.dtype == np.uint8
        assert sample.depth.shape == (48, 64)
        assert sample.depth.dtype == np.float32
        assert sample.boxes.shape == (count, 4)
        assert sample.labels.shape == sample.difficult.shape == (count,)
        assert sample.T_c_object.shape == (count, 4, 4)
        assert (sample.boxes[:, :2] < sample.boxes[:, 2:]).all()
        assert (sample.boxes >= 0).all()
        assert (sample.boxes[:, [0, 2]] <= 64).all()
        assert (sample.boxes[:, [1, 3]] <= 48).all()
        seen = sample.depth[sample.depth > 0]
        assert ((seen >= 0.14) & (seen <= 6.1)).all()
        for T in sample.T_c_object:
            assert np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-7)
            assert T[2, 3] > 0.0
        styles.add(data.rows[index]["style"])
    assert styles <= {"aerial", "studio"}
    assert sum(len(row["boxes"]) for row in data.rows) > IMAGES // 2


def test_depth_is_near_the_objects_that_the_labels_name(whole: Path) -> None:
    data, checked = DetectDataset(whole), 0
    for sample, row in ((data[i], data.rows[i]) for i in range(len(data))):
        for box, T, visible in zip(sample.boxes.astype(int), sample.T_c_object, row["visibility"], strict=True):
            inside = sample.depth[box[1] : box[3], box[0] : box[2]]
            if visible > 0.9 and (inside > 0).mean() > 0.9:
                assert abs(np.median(inside[inside > 0]) - T[2, 3]) < 0.35
                checked += 1
    assert checked > 3


def test_resumed_is_the_same_as_uninterrupted(whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out, draw, calls = tmp_path / "resumed", pictures.draw_block, []

    def interrupted(*arguments):
        calls.append(arguments)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return draw(*arguments)

    monkeypatch.setattr(pictures, "draw_block", interrupted)
    command = ["--out", str(out), "--images", str(IMAGES), "--size", *map(str, SIZE)]
    assert main(command) == 130
    assert len(DetectDataset(out)) == pictures.BLOCK
    with (out / "labels.jsonl").open("a") as file:
        file.write('{"image": 12, "bo')  # as if the power had failed
    assert len(DetectDataset(out)) == pictures.BLOCK
    assert main(command) == 0
    assert len(calls) == 3  # the first block was not drawn again
    one, other = files(whole), files(out)
    assert one.keys() == other.keys()
    assert all(one[name] == other[name] for name in one if name != "card.json")


def test_a_longer_set_starts_with_the_shorter(copy: Path, whole: Path) -> None:
    rows = DetectDataset(whole).rows
    write_dataset(copy, 2 * pictures.BLOCK, size=SIZE)
    longer = DetectDataset(copy)
    assert len(longer) == 2 * pictures.BLOCK
    assert longer.rows[: len(rows)] == rows


def test_seeds_and_splits_share_no_scene() -> None:
    firsts = sorted(first + seed * SEED_STEP for first in SPLITS.values() for seed in (0, 1, SEEDS - 1))
    assert np.diff(firsts).min() >= SEED_STEP
    most = SEED_STEP // pictures.ARRANGEMENTS * pictures.BLOCK
    with pytest.raises(ValueError, match=f"images: expected 1 to {most}"):
        write_dataset("unused", most + 1)


def test_splits_differ(whole: Path, tmp_path: Path) -> None:
    other = write_dataset(tmp_path / "test", 2, split="test", size=SIZE)
    assert {row["scene_seed"] for row in DetectDataset(other).rows} == {SPLITS["test"]}
    assert DetectDataset(other).rows[0]["boxes"] != DetectDataset(whole).rows[0]["boxes"]


def test_without_randomization_colors_repeat() -> None:
    for picture in pictures.draw_block(3, SIZE, randomize=False)[:: pictures.VIEWS]:
        assert picture.frame.rgb.std() > 0.0
    one, same = (pictures.draw_block(3, SIZE, randomize=False)[0] for _ in range(2))
    assert np.array_equal(one.frame.rgb, same.frame.rgb)


def test_arguments_out_of_range(tmp_path: Path) -> None:
    for change, said in (
        ({"images": 0}, "images: expected 1"),
        ({"seed": SEEDS}, "seed: expected 0 to 99"),
        ({"split": "dev"}, "split: expected one of train"),
        ({"size": (8, 8)}, "size: expected width and height"),
        ({"workers": 0}, "workers: expected at least 1"),
    ):
        with pytest.raises(ValueError, match=said):
            write_dataset(tmp_path / "none", **{"images": 1, **change})
    assert not (tmp_path / "none").exists()


def test_another_data_set_is_not_overwritten(copy: Path) -> None:
    before = files(copy)
    with pytest.raises(ValueError, match="holds another data set: split 'train', not 'test'"):
        write_dataset(copy, 4, split="test", size=SIZE)
    with pytest.raises(ValueError, match="holds another data set: randomize True, not False"):
        write_dataset(copy, 4, size=SIZE, randomize=False)
    assert files(copy) == before


def test_damaged_pictures_name_their_file(copy: Path) -> None:
    data = DetectDataset(copy)
    depth, rgb = copy / "depth" / "000001.png", copy / "rgb" / "000002.jpg"
    depth.write_bytes(depth.read_bytes()[:200])
    with pytest.raises(ValueError, match=r"000001\.png: expected a picture of 64 × 48 px"):
        data[1]
    rgb.write_bytes(b"")
    with pytest.raises(ValueError, match=r"000002\.jpg: expected a picture"):
        data[2]
    (copy / "rgb" / "000003.jpg").unlink()
    with pytest.raises(ValueError, match=r"000003\.jpg"):
        data[3]
    Image.new("RGB", (32, 32)).save(copy / "rgb" / "000004.jpg")
    with pytest.raises(ValueError, match=r"000004\.jpg: expected \(48, 64, 3\) uint8, got \(32, 32, 3\)"):
        data[4]
    Image.new("L", SIZE).save(copy / "depth" / "000005.png")
    with pytest.raises(ValueError, match=r"000005\.png: expected \(48, 64\) uint16"):
        data[5]
    with pytest.raises(IndexError):
        data[IMAGES]


def test_damaged_labels_name_their_line(copy: Path) -> None:
    path = copy / "labels.jsonl"
    lines = path.read_text().splitlines()
    row = json.loads(lines[2])
    for change, said in (
        ("{", "line 3: expected the labels of a picture"),
        ({**row, "labels": [99] * len(row["labels"]) or [99]}, "line 3: expected"),
        ({**row, "visibility": [*row["visibility"], 1.0]}, "line 3: expected as many boxes"),
        ({name: value for name, value in row.items() if name != "boxes"}, "line 3: expected the labels"),
    ):
        text = change if isinstance(change, str) else json.dumps(change)
        path.write_text("\n".join([*lines[:2], text, *lines[3:]]) + "\n")
        with pytest.raises(ValueError, match=rf"labels\.jsonl, {said}"):
            DetectDataset(copy)
    path.unlink()
    with pytest.raises(ValueError, match="there is no such file"):
        DetectDataset(copy)


def test_damaged_cards(copy: Path, tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"card\.json"):
        DetectDataset(tmp_path)
    card = json.loads((copy / "card.json").read_text())
    for text, said in (
        ("[]", "expected a JSON object"),
        ("{", "expected JSON"),
        (json.dumps({**card, "version": 99}), "expected version"),
        (json.dumps({name: value for name, value in card.items() if name != "classes"}), "expected classes"),
        (json.dumps({**card, "intrinsics": [0, 0, 0, 0]}), "focal length"),
    ):
        (copy / "card.json").write_text(text)
        with pytest.raises(ValueError, match=rf"card\.json: .*{said}"):
            DetectDataset(copy)


def test_a_mesh_takes_the_place_of_a_class(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    block = trimesh.creation.box((0.1, 0.06, 0.2))
    block.visual.face_colors = (255, 0, 255, 255)
    block.export(tmp_path / "block.ply")
    made = {label: object_from_mesh(tmp_path / "block.ply", label) for label in CLASSES}
    for picture in pictures.draw_block(5, SIZE, meshes=made):
        for truth in picture.truths:
            corners = made[truth.label].vertices @ truth.T_c_object[:3, :3].T + truth.T_c_object[:3, 3]
            camera = picture.frame.intrinsics
            pixels = corners[:, :2] / corners[:, 2:] * (camera.fx, camera.fy) + (camera.cx + 0.5, camera.cy + 0.5)
            low, high = truth.box[:2], truth.box[2:]
            assert (pixels.min(axis=0) <= low + 1.0).all() and (pixels.max(axis=0) >= high - 1.0).all()
    out, mesh = tmp_path / "set", f"box={tmp_path / 'block.ply'}"
    assert main(["--out", str(out), "--images", "1", "--size", "64", "48", "--mesh", mesh]) == 0
    with pytest.raises(ValueError, match="holds another data set: meshes"):
        main(["--out", str(out), "--images", "1", "--size", "64", "48"])
    with pytest.raises(ValueError, match=r"--mesh: expected CLASS=FILE with one of .*, got 'cow=x.ply'"):
        main(["--out", str(out), "--mesh", "cow=x.ply"])
    capsys.readouterr()
