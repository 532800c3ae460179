"""Checkpoints round-trip exactly, survive interruption, and refuse everything else in one line."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import save_file

from agents import checkpoint as module
from agents.checkpoint import CheckpointError, NetworkLayout, load_checkpoint, save_checkpoint

CARD = {
    "env_id": "toy/Point-v0",
    "kind": "policy",
    "base": None,
    "network": {
        "keys": ["error", "velocity"],
        "sizes": [2, 2],
        "hidden": [8, 3],
        "activation": "tanh",
        "actions": 2,
        "clip": 10.0,
        "epsilon": 1e-8,
    },
}


def tensors(seed: int = 0) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    shapes = NetworkLayout.from_card(CARD).shapes()
    return {name: rng.uniform(0.1, 1.0, shape).astype(np.float32) for name, shape in shapes.items()}


def refused(path: Path, *words: str, env_id: str | None = None) -> None:
    with pytest.raises(CheckpointError) as error:
        load_checkpoint(path, env_id)
    message = str(error.value)
    assert "\n" not in message and str(path) in message and "expected" in message
    for word in words:
        assert word in message


def test_round_trip_is_exact_for_every_type(tmp_path):
    extra = {
        "bytes": np.arange(7, dtype=np.uint8),
        "key": np.arange(5, dtype=np.uint32),
        "count": np.array(3.25),
        "steps": np.array([1, 2**40]),
        "column": np.arange(6.0).reshape(2, 3).T,  # not contiguous
    }
    saved = tensors() | extra
    path = save_checkpoint(tmp_path / "new" / "a.safetensors", saved, CARD)
    found = load_checkpoint(path, "toy/Point-v0")
    assert found.tensors.keys() == saved.keys()
    for name, value in saved.items():
        assert (found.tensors[name].dtype, found.tensors[name].shape) == (value.dtype, value.shape)
        np.testing.assert_array_equal(found.tensors[name], value)
    assert found.card == {"schema": module.SCHEMA, "version": 1, **CARD}
    assert json.loads(path.with_suffix(".json").read_text()) == found.card
    assert found.network.shapes()["actor.1.weight"] == (3, 8)


@pytest.mark.parametrize("moment", ["write", "rename"])
def test_an_interrupt_while_writing_leaves_the_last_checkpoint_whole(tmp_path, monkeypatch, moment):
    path = save_checkpoint(tmp_path / "a.safetensors", tensors(0), CARD)
    replace = Path.replace

    def interrupted(self, target):
        if moment == "write":
            self.write_bytes(self.read_bytes()[:100])
        elif Path(target).suffix == ".json":
            return replace(self, target)
        raise KeyboardInterrupt

    monkeypatch.setattr(Path, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        save_checkpoint(path, tensors(1), CARD)
    np.testing.assert_array_equal(load_checkpoint(path).tensors["log_std"], tensors(0)["log_std"])
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a.json", "a.safetensors"]


@pytest.mark.parametrize("keep", [0, 4, 100, 0.5, -1])
def test_truncated(tmp_path, keep):
    path = save_checkpoint(tmp_path / "a.safetensors", tensors(), CARD)
    content = path.read_bytes()
    path.write_bytes(content[: int(len(content) * keep) if isinstance(keep, float) else keep])
    refused(path, "safetensors", "corrupt")


def test_random_bytes_a_pickle_and_a_folder(tmp_path):
    import torch

    noise = tmp_path / "noise.safetensors"
    noise.write_bytes(np.random.default_rng(0).bytes(4096))
    refused(noise, "safetensors", "corrupt")
    pickled = tmp_path / "torch.safetensors"
    torch.save({"weight": torch.zeros(3)}, pickled)
    refused(pickled, "safetensors", "corrupt")
    refused(tmp_path / "none.safetensors", "no such file")
    refused(tmp_path, "no such file")


def test_foreign_safetensors(tmp_path):
    path = tmp_path / "foreign.safetensors"
    save_file({"weight": np.zeros(3, np.float32)}, path)
    refused(path, "no card")
    save_file({"weight": np.zeros(3, np.float32)}, path, metadata={"card": "{"})
    refused(path, "not JSON")
    save_file({"weight": np.zeros(3, np.float32)}, path, metadata={"card": json.dumps({"schema": "other"})})
    refused(path, "schema")


def test_card_and_tensors_must_agree(tmp_path):
    path = tmp_path / "a.safetensors"

    def written(card=None, **arrays):
        merged = {name: value for name, value in (tensors() | arrays).items() if value is not None}
        save_checkpoint(path, merged, CARD | (card or {}))

    written({"version": 2})
    refused(path, "version is 2")
    written()
    refused(path, "toy/Point-v0", "not toy/Points-v0", env_id="toy/Points-v0")
    written(log_std=None)
    refused(path, "'log_std'", "missing")
    written(**{"actor.1.weight": np.zeros((8, 3), np.float32)})
    refused(path, "(8, 3)", "(3, 8)")
    written(**{"actor.0.bias": np.full(8, np.nan, np.float32)})
    refused(path, "not finite")
    written(**{"observation.var": np.full(4, -1.0, np.float32)})
    refused(path, "negative")
    for change in ({"sizes": [2]}, {"activation": "gelu"}, {"hidden": "wide"}, {"actions": 0}):
        written({"network": CARD["network"] | change})
        refused(path, "network")
    written({"network": None})
    refused(path, "network")
    written({"base": {"env_id": "toy/Point-v0", "name": "pi", "scale": 0.3}})  # without the input it implies
    refused(path, "base")
    written({"env_id": None})
    refused(path, "env_id")


def test_what_cannot_be_written(tmp_path):
    with pytest.raises(ValueError, match=r"\.safetensors"):
        save_checkpoint(tmp_path / "a.pt", tensors(), CARD)
    with pytest.raises(ValueError, match="card"):
        save_checkpoint(tmp_path / "a.safetensors", tensors(), CARD | {"x": float("nan")})
    with pytest.raises(ValueError, match="card"):
        save_checkpoint(tmp_path / "a.safetensors", tensors(), CARD | {"x": object()})
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="file"):
        save_checkpoint(tmp_path / "file" / "a.safetensors", tensors(), CARD)
    assert [file.name for file in tmp_path.iterdir()] == ["file"]


def test_loading_and_inference_import_no_torch():
    code = "import agents.checkpoint, agents.network_policy, agents.train, sys; assert 'torch' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
