"""Training of detectors: goes on to the bit, learns, exports; evaluation against hand-worked cases; bad input."""

from __future__ import annotations

import json
import multiprocessing
from collections import Counter
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch
from detect_shapes import CLASSES, write_shapes

from aerograsp_env.interfaces import RGBD, Detector, Intrinsics
from agents.checkpoint import CheckpointError, load_checkpoint
from agents.detect_dataset import DetectDataset
from agents.detect_evaluate import evaluate
from agents.detect_evaluate import main as evaluate_main
from agents.detect_evaluate_scores import SIZES, Labelled, score, score_by_size, without_difficult
from agents.detect_export import export_onnx
from agents.detect_frames import FrameCache, Repeated, repeats
from agents.detect_onnx import DetectorFileError, OnnxDetector
from agents.detect_train import BEST, LATEST, DetectTrainConfig, main, train_detector
from agents.detect_train_loop import Training
from agents.detect_train_parallel import Shard, share_gradients
from agents.networks.detector import DetectorLayout

QUICK = DetectTrainConfig(steps=6, batch=4, sizes="64:1", warmup=2, validate_every=3, validation_images=4, seed=3)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("shapes")
    return write_shapes(folder / "train", 24, 0), write_shapes(folder / "validation", 8, 1, split="validation")


@pytest.fixture(scope="module")
def trained(data: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("run")
    train_detector(QUICK, [data[0]], data[1], out)
    return out


@pytest.fixture(scope="module")
def exported(trained: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_onnx(trained / BEST, tmp_path_factory.mktemp("onnx") / "shapes.onnx", (128, 192))


def test_an_interrupted_training_ends_with_the_same_bits(
    data: tuple[Path, Path], trained: Path, tmp_path: Path
) -> None:
    pictures, held_out = DetectDataset(data[0]), DetectDataset(data[1])
    layout = DetectorLayout(tuple(held_out.classes), QUICK.family, QUICK.input)
    first = Training(QUICK, layout, FrameCache([pictures]), held_out, tmp_path, [])
    for _ in range(2):
        first.advance()
    first.save()
    train_detector(QUICK, [data[0]], data[1], tmp_path, resume=True)
    whole, parts = load_checkpoint(trained / LATEST), load_checkpoint(tmp_path / LATEST)
    assert whole.card["step"] == parts.card["step"] == 6
    for name, array in whole.tensors.items():
        np.testing.assert_array_equal(array, parts.tensors[name], err_msg=name)


def test_gradients_are_the_mean_over_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = torch.nn.Parameter(torch.zeros(2, 3)), torch.nn.Parameter(torch.zeros(4))
    first.grad, second.grad = torch.full((2, 3), 3.0), torch.arange(4.0)
    others = torch.cat([torch.full((6,), 1.0), torch.zeros(4)])
    monkeypatch.setattr(torch.distributed, "all_reduce", lambda flat: flat.add_(others))
    share_gradients([first, second], Shard(0, 2))
    assert first.grad.tolist() == [[2.0] * 3] * 2 and second.grad.tolist() == [0.0, 0.5, 1.0, 1.5]


def test_processes_share_a_batch_and_end_together(data: tuple[Path, Path], tmp_path: Path) -> None:
    config = DetectTrainConfig(**{**QUICK.__dict__, "steps": 2, "workers": 2})
    train_detector(config, [data[0]], data[1], tmp_path)
    assert load_checkpoint(tmp_path / LATEST).card["step"] == 2
    assert not multiprocessing.active_children() and not list(tmp_path.glob(".workers-*"))


def test_a_run_says_what_it_did(trained: Path) -> None:
    card = load_checkpoint(trained / BEST).card
    assert card["kind"] == "detector" and card["layout"]["classes"] == list(CLASSES) and card["pictures"] == 24
    assert [point["step"] for point in json.loads((trained / LATEST).with_suffix(".json").read_text())["curve"]] == [
        3,
        6,
    ]
    assert 0.0 <= card["threshold"] <= 1.0


def test_the_exported_network_is_a_detector(exported: Path, data: tuple[Path, Path]) -> None:
    detector = OnnxDetector(exported, threshold=0.001)
    assert isinstance(detector, Detector) and detector.card.classes == CLASSES
    sample = DetectDataset(data[1])[0]
    found = detector.detect(RGBD(sample.rgb, sample.depth, sample.intrinsics))
    scores = [detection.score for detection in found]
    assert found and scores == sorted(scores, reverse=True)
    for detection in found:
        assert (detection.box[:2] >= 0).all() and detection.box[2] <= 160 and detection.box[3] <= 128
    plain = Intrinsics(64, 48, 60.0, 60.0, 32.0, 24.0)
    black = RGBD(np.zeros((48, 64, 3), dtype=np.uint8), np.zeros((48, 64), dtype=np.float32), plain)
    assert isinstance(detector.detect(black), list)  # any size, and no depth at all


def test_the_file_names_no_folder_of_this_machine(exported: Path) -> None:
    model = onnx.load(exported)
    text = str(model.graph.node) + str(model.metadata_props) + exported.with_suffix(".json").read_text()
    assert str(Path(__file__).parents[1]) not in text and "site-packages" not in text
    assert json.loads(exported.with_suffix(".json").read_text())["classes"] == list(CLASSES)


def test_evaluation_writes_its_tables(exported: Path, data: tuple[Path, Path], tmp_path: Path) -> None:
    page, figures = tmp_path / "page.html", tmp_path / "figures.json"
    assert evaluate_main([str(exported), str(data[1]), "--page", str(page), "--json", str(figures)]) == 0
    result = json.loads(figures.read_text())["results"][0]
    assert result["images"] == 8 and set(result["per_class"]) <= set(CLASSES) and result["milliseconds"] > 0
    assert "SSD-MobileNet (thesis)" in page.read_text() and "0.692" in page.read_text()
    dataset = DetectDataset(data[1])
    assert evaluate(exported, dataset, depth=False, images=2).name.endswith("without depth")


def test_scores_of_a_hand_worked_case() -> None:
    """Two objects, one found well (IoU 0.9), one roughly (IoU 0.6), and one detection of nothing between them."""
    truth = Labelled(
        np.array([[0.0, 0.0, 10.0, 10.0], [50.0, 50.0, 60.0, 60.0]]), np.array([0, 0]), np.zeros(2, dtype=bool)
    )
    boxes = np.array([[0.0, 0.0, 10.0, 9.0], [80.0, 80.0, 90.0, 90.0], [50.0, 50.0, 60.0, 56.0]])
    found = (boxes, np.array([0.9, 0.8, 0.7]), np.zeros(3, dtype=np.int64))
    scores = score([found], [truth], ("a", "b"))
    assert scores.overall.map50 == pytest.approx(0.5 + 0.5 * 2 / 3)
    assert scores.overall.map75 == pytest.approx(0.5)
    assert scores.overall.recall == 1.0 and scores.overall.objects == 2 and list(scores.per_class) == ["a"]
    assert scores.threshold == 0.7 and scores.overall.precision == pytest.approx(2 / 3)
    assert score([found], [truth], ("a", "b"), 0.85).overall.operating_recall == 0.5


def test_difficult_objects_are_neither_right_nor_wrong() -> None:
    truth = Labelled(
        np.array([[0.0, 0.0, 10.0, 10.0], [50.0, 50.0, 60.0, 60.0]]), np.array([0, 0]), np.array([False, True])
    )
    both = (truth.boxes, np.array([0.5, 0.9]), np.zeros(2, dtype=np.int64))
    one = (truth.boxes[:1], np.array([0.5]), np.zeros(1, dtype=np.int64))
    assert score([both], [truth], ("a",)).overall == score([one], [truth], ("a",)).overall
    assert score([both], [truth], ("a",)).overall.map50 == 1.0
    other = (truth.boxes[1:], np.array([0.9]), np.ones(1, dtype=np.int64))
    assert len(without_difficult(other, truth, 0.5)[0]) == 1  # of another class: a fault


def test_training_refuses_what_does_not_fit(data: tuple[Path, Path], trained: Path, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="already holds a run"):
        train_detector(QUICK, [data[0]], data[1], trained)
    other = write_shapes(tmp_path / "other", 2, 0)
    card = json.loads((other / "card.json").read_text())
    (other / "card.json").write_text(json.dumps({**card, "classes": ["x", "y", "z"]}))
    with pytest.raises(ValueError, match="expected the classes of the validation pictures, disc, bar, frame; got x"):
        train_detector(QUICK, [other], data[1], tmp_path / "run")
    with pytest.raises(CheckpointError, match="another steps"):
        changed = DetectTrainConfig(**{**QUICK.__dict__, "steps": 7})
        train_detector(changed, [data[0]], data[1], trained, resume=True)
    with pytest.raises(CheckpointError, match="expected the layout"):
        changed = DetectTrainConfig(**{**QUICK.__dict__, "input": "rgb"})
        train_detector(changed, [data[0]], data[1], tmp_path / "run", initial=trained / BEST)


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("--steps", "0", "steps: expected a number from 1"),
        ("--sizes", "100:1", "sizes: expected SIDE:SHARE"),
        ("--sizes", "160", "sizes: expected SIDE:SHARE"),
        ("--workers", "5", "workers: expected a divisor of the batch of 32"),
        ("--depth-dropout", "1.5", "depth_dropout: expected a number from 0 to 1"),
    ],
)
def test_options_out_of_range(option: str, value: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        main(["nowhere", "--validation", "nowhere", option, value])


def test_sizes_change_as_the_steps_go() -> None:
    config = DetectTrainConfig(steps=10, sizes="160:3,224:1")
    assert [config.size(step) for step in range(10)] == [160] * 8 + [224] * 2 or [
        config.size(step) for step in range(10)
    ] == [160] * 7 + [224] * 3
    assert config.augmentation(9).mosaic == 0.0 < config.augmentation(0).mosaic


def test_files_that_are_no_detectors(exported: Path, tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="no such file"):
        OnnxDetector(tmp_path / "absent.onnx")
    cut = tmp_path / "cut.onnx"
    cut.write_bytes(exported.read_bytes()[:1000])
    with pytest.raises(DetectorFileError, match=r"cut\.onnx: expected an ONNX file"):
        OnnxDetector(cut)
    model = onnx.load(exported)
    del model.metadata_props[:]
    onnx.save(model, tmp_path / "foreign.onnx")
    with pytest.raises(DetectorFileError, match="another program's"):
        OnnxDetector(tmp_path / "foreign.onnx")
    with pytest.raises(DetectorFileError, match="it was trained on disc, bar, frame"):
        OnnxDetector(exported, classes=("cup",))
    with pytest.raises(ValueError, match="threshold: expected a score"):
        OnnxDetector(exported, threshold=2.0)


def test_export_refuses_odd_sizes_and_names(trained: Path, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"ends in \.onnx"):
        export_onnx(trained / BEST, tmp_path / "x.bin")
    with pytest.raises(ValueError, match="multiples of 64"):
        export_onnx(trained / BEST, tmp_path / "x.onnx", (240, 320))
    with pytest.raises(CheckpointError, match="expected a detector, got 'detector-training'"):
        export_onnx(trained / LATEST, tmp_path / "x.onnx")


def test_pictures_of_rare_classes_are_shown_more_often() -> None:
    presence = np.array([[True, False]] * 15 + [[True, True], [False, False]] + [[True, False]] * 3)
    times = repeats(presence, 0.5)
    share = presence.mean(axis=0)
    assert times[15] == pytest.approx(np.sqrt(share[0] / share[1]))
    assert (np.delete(times, 15) == 1.0).all() and (repeats(presence, 0.0) == 1.0).all()
    shown = Repeated([f"frame {i}" for i in range(20)], times)  # type: ignore[arg-type]
    counts = Counter(shown[i] for i in range(len(shown)))
    assert abs(counts["frame 15"] - times[15]) < 1.0 and len(shown) == round(times.sum()) and len(counts) == 20


def test_every_size_has_its_own_scores() -> None:
    boxes = np.array([[0, 0, 10, 10], [100, 0, 130, 30], [0, 100, 20, 120]], dtype=float)
    truth = Labelled(boxes[:2], np.zeros(2, dtype=np.int64), np.zeros(2, dtype=np.bool_))
    # The small object is found second, after a false one of its size; the middle one at once.
    found = boxes[[2, 1, 0]], np.array([0.9, 0.8, 0.7]), np.zeros(3, dtype=np.int64)
    small, middle, _ = SIZES
    rows = score_by_size([found], [truth], ["thing"], 0.5)
    assert list(rows) == [small, middle]
    assert rows[small].map50 == pytest.approx(0.5) and rows[small].objects == 1 and rows[small].precision == 0.5
    assert rows[middle].map50 == 1.0 and rows[middle].precision == 1.0
