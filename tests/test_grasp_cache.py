"""Grasps on disk: what the key depends on, and files that are damaged."""

import numpy as np
import pytest
import trimesh

from aerograsp_env.sim.gripper import GripperConfig
from baselines.grasping import GraspCache, grasps_on_mesh
from baselines.grasping.cache import VARIABLE, default_folder
from baselines.grasping.candidates import SHAPES

BOX = trimesh.creation.box((0.04, 0.05, 0.2))


def make(cache, **kwargs):
    return grasps_on_mesh(BOX, n_rays=60, cache=cache, **kwargs)


def same(a, b):
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in SHAPES) and (
        dict(a.reasons) == dict(b.reasons) and dict(a.counts) == dict(b.counts)
    )


def files(cache):
    return sorted(path.name for path in cache.folder.iterdir())


def test_stored_once_and_read_back(tmp_path, monkeypatch):
    cache = GraspCache(tmp_path / "new" / "folder")
    made = make(cache)
    assert len(made) and len(files(cache)) == 1
    monkeypatch.setattr("baselines.grasping.on_mesh.opposed_pairs", lambda *_: pytest.fail("was computed again"))
    assert same(make(cache), made)
    assert not make(cache).widths.flags.writeable


def test_the_key_is_the_content(tmp_path):
    cache = GraspCache(tmp_path)
    make(cache)
    make(cache)
    changes = (
        {"rng": 1},
        {"inner": False},
        {"friction": 0.4},
        {"approaches": 4},
        {"clearance": 0.006},
        {"pattern": "straight"},
        {"gripper": GripperConfig(finger_length=0.05)},
    )
    for count, change in enumerate(changes, start=2):
        made = make(cache, **change)
        assert len(files(cache)) == count
        assert same(made, grasps_on_mesh(BOX, n_rays=60, **change))
    moved = BOX.copy()
    moved.apply_translation((1e-5, 0.0, 0.0))
    grasps_on_mesh(moved, n_rays=60, cache=cache)
    assert len(files(cache)) == len(changes) + 2


def test_no_grasps_are_kept_too(tmp_path):
    cache = GraspCache(tmp_path)
    wide = trimesh.creation.box((0.2, 0.2, 0.2))
    first = grasps_on_mesh(wide, n_rays=30, cache=cache)
    again = grasps_on_mesh(wide, n_rays=30, cache=cache)
    assert len(again) == 0 and same(first, again) and again.reasons["too wide"] > 0


def damage(path, how):
    content = path.read_bytes()
    if how == "truncated":
        path.write_bytes(content[: len(content) // 2])
    elif how == "empty":
        path.write_bytes(b"")
    elif how == "garbage":
        path.write_bytes(b"\x00\x01 nothing of the kind")
    elif how == "flipped":
        spot = len(content) // 2
        path.write_bytes(
            content[:spot] + bytes(byte ^ 0xFF for byte in content[spot : spot + 64]) + content[spot + 64 :]
        )
    else:
        with np.load(path) as archive:
            arrays = dict(archive)
        if how == "missing":
            del arrays["widths"]
        elif how == "shape":
            arrays["widths"] = arrays["widths"][:-1]
        elif how == "nan":
            arrays["widths"] = np.full_like(arrays["widths"], np.nan)
        elif how == "pickle":
            arrays["widths"] = np.array([None] * len(arrays["widths"]), dtype=object)
        elif how == "other":
            arrays["key"] = np.array("0" * 64)
        np.savez(path, **arrays)


@pytest.mark.parametrize(
    "how", ["truncated", "empty", "garbage", "flipped", "missing", "shape", "nan", "pickle", "other"]
)
def test_damaged_files_are_made_anew(tmp_path, how):
    cache = GraspCache(tmp_path)
    made = make(cache)
    (name,) = files(cache)
    damage(tmp_path / name, how)
    with pytest.warns(RuntimeWarning, match="made anew"):
        again = make(cache)
    assert same(made, again) and files(cache) == [name]
    assert same(made, make(cache))  # and without a warning: it was stored again


def test_a_folder_that_cannot_be_made_is_warned_of(tmp_path):
    (tmp_path / "file").write_text("not a folder")
    with pytest.warns(RuntimeWarning, match="could not write"):
        made = make(GraspCache(tmp_path / "file" / "cache"))
    assert len(made)


def test_a_generator_cannot_be_a_key(tmp_path):
    with pytest.raises(ValueError, match="rng: expected a seed"):
        make(GraspCache(tmp_path), rng=np.random.default_rng(0))


def test_the_folder(tmp_path, monkeypatch):
    monkeypatch.setenv(VARIABLE, str(tmp_path / "here"))
    assert default_folder() == tmp_path / "here" == GraspCache().folder
    monkeypatch.delenv(VARIABLE)
    assert default_folder().name == "aerograsp"
    assert GraspCache(tmp_path).folder == tmp_path
