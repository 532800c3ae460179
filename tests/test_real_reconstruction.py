"""Single views made whole and compared with the truth: on solids that are known, and on what others scanned."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from agents import cli
from agents.grasp_strip import strip
from agents.plan_settings import Settings
from agents.real_objects import files, grasps, half_cloud, scanned_bunny, single_views, solids
from agents.real_views import NOISE, PRIORS, compare, off_surface, open_share, outer, reconstruct, view
from agents.reproduction import data_folder
from baselines.objects import MeshObject, PointCloudObject

DATA = data_folder()
needs_data = pytest.mark.skipif(not (DATA / "meshes_ycb").is_dir(), reason="real data not present")
RADIUS = 0.05


@pytest.fixture(scope="module")
def ball() -> MeshObject:
    return MeshObject.from_trimesh(trimesh.creation.icosphere(4, RADIUS))


def test_a_view_shows_the_near_side_with_the_stated_noise(ball: MeshObject) -> None:
    seen = view(ball, 3)
    off = np.linalg.norm(seen.points, axis=1) - RADIUS
    direction = seen.eye / np.linalg.norm(seen.eye)
    assert np.linalg.norm(seen.eye) == pytest.approx(0.5)
    facing = seen.points @ direction > 0.6 * RADIUS  # there rays meet the surface steeply
    assert 0.6 * NOISE < off[facing].std() < 1.2 * NOISE
    assert (seen.points @ direction > 0.0).mean() > 0.97
    ray = seen.eye - seen.points
    assert (np.einsum("ni,ni->n", seen.normals, ray) >= 0.0).all()
    np.testing.assert_array_equal(view(ball, 3).points, seen.points)
    assert not np.allclose(view(ball, 4).eye, seen.eye)


def test_distances_of_concentric_balls_are_the_difference_of_their_radii(ball: MeshObject) -> None:
    seen = ball.sample(50, np.random.default_rng(0)).points
    larger = trimesh.creation.icosphere(4, RADIUS + 0.01)
    found = compare(ball, larger, seen[seen[:, 2] > 0.0])
    assert found.chamfer == pytest.approx(0.01, rel=0.01) and found.far == pytest.approx(0.01, rel=0.01)
    same = compare(ball, ball.trimesh, seen)
    assert same.chamfer == pytest.approx(0.0, abs=1e-12)
    assert np.isnan(compare(ball, None, seen)).all()
    np.testing.assert_allclose(off_surface(np.array([[0.0, 0.0, 0.2]]), ball), 0.2 - RADIUS, atol=1e-9)


def test_what_is_inside_is_not_part_of_the_outer_surface() -> None:
    shell, core = trimesh.creation.box((0.1, 0.1, 0.1)), trimesh.creation.box((0.04, 0.04, 0.04))
    both = MeshObject.from_trimesh(trimesh.util.concatenate([shell, core]))
    assert outer(both).face_areas.sum() == pytest.approx(6 * 0.1**2)
    cup = shell.copy()
    cup.update_faces(cup.face_normals[:, 2] < 0.5)
    opened = MeshObject.from_trimesh(cup)
    assert len(outer(opened).faces) == len(opened.faces) == 10
    assert open_share(both) == 0.0 and open_share(opened) == pytest.approx(4 / 17)  # 10 faces, 13 inner edges


def test_an_ellipsoid_completes_a_ball_better_than_a_constant(ball: MeshObject) -> None:
    found = single_views("ball", ball, 0, 3)
    mean = {prior: np.mean([d.far for d in found.distances[prior]]) for prior in PRIORS}
    assert found.size == pytest.approx(2.0 * np.sqrt(3.0) * RADIUS, rel=0.01)
    assert mean["ellipsoid"] < mean["constant"] and mean["ellipsoid"] < 0.2 * RADIUS


def test_half_of_a_cloud_tells_where_the_other_half_is(ball: MeshObject) -> None:
    sample = ball.sample(400, np.random.default_rng(0))
    cloud = PointCloudObject(sample.points, sample.normals)
    found = half_cloud("ball", cloud, None, 0, 2)
    assert all(len(found.distances[p]) == 2 and max(found.distances[p]) < 1e-3 for p in PRIORS)
    assert reconstruct(sample.points, sample.normals, None, "ellipsoid") is not None


def test_a_folder_of_ones_own(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    trimesh.creation.box((0.05, 0.06, 0.12)).export(tmp_path / "bar.stl")
    trimesh.creation.box((0.3, 0.3, 0.3)).export(tmp_path / "block.stl")
    (tmp_path / "SOURCE.txt").write_text("where it is from")
    picture, record = tmp_path / "a.png", tmp_path / "a.json"
    arguments = ["--data", str(tmp_path), "--episodes", "2", "--out", str(picture), "--json", str(record)]
    assert cli.main(["reproduce", "real-objects", *arguments]) == 0
    out = capsys.readouterr().out
    assert "2 files: grasps on 1" in out and "block.stl: " in out and "jaws" in out
    data = json.loads(record.read_text())
    held = {row["name"].split("/")[-1]: row for row in data["grasps"]}
    assert held["bar.stl"]["found"] > 0 and not held["bar.stl"]["reason"]
    assert held["block.stl"]["found"] == 0 and held["block.stl"]["reason"]
    assert [row["name"] for row in data["views"]] == ["bar", "block"]
    assert all(len(row["distances"]["ellipsoid"]) == 2 for row in data["views"])
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_data_that_is_not_there_is_said_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for arguments, words in (
        (["real-objects", "--data", str(tmp_path)], "no meshes or clouds"),
        (["real-objects", "--data", str(tmp_path / "none")], "no folder"),
        (["table-5.3", "--data", str(tmp_path)], "reads none"),
    ):
        assert cli.main(["reproduce", *arguments]) in (1, 2)
        error = capsys.readouterr().err
        assert words in error and error.count("\n") == 1


def test_the_strip_of_the_readme_is_a_picture() -> None:
    assert strip("apple", 2).startswith(b"\x89PNG")


# what others scanned ----------------------------------------------------------------------------------------------


@needs_data
def test_one_scan_and_one_mesh() -> None:
    paths = files(DATA)
    mustard = next(item for item in solids(paths) if item[0] == "YcbMustardBottle")
    found = single_views(*mustard, 0, 3)
    for prior in PRIORS:
        assert 1e-3 < np.mean([d.chamfer for d in found.distances[prior]]) < 0.06 * found.size
    aligned = scanned_bunny(paths)
    assert aligned is not None and aligned[0] < 3e-4
    assert max(d.chamfer for d in aligned[1].values()) < 0.02


@needs_data
def test_scans_get_grasps_or_a_reason() -> None:
    settings = Settings(cache=False, rays=400, points=150)
    by_name = {path.name: path for path in files(DATA)}
    refused, told = grasps(by_name["krylon.pcd"], settings)
    assert "viewpoint" in refused.reason and told.found > 0 and told.told == "seen from all round"
    (milk,) = grasps(by_name["milk.pcd"], settings)
    assert milk.found == 0 and milk.reason
    refused, told = grasps(by_name["hammer.obj"], settings)
    assert "scale" in refused.reason and told.found > 0
