"""`aerograsp plan`: what it finds on known shapes, what it says of bad input, and the page."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

from aerograsp_env.interfaces import Grasp
from aerograsp_env.sim.gripper import GripperConfig
from agents import cli
from agents.plan import COLUMNS, plan_text
from agents.plan_cloud import fit_model, read_cloud
from agents.plan_page import DrawnGrasp, Scene, Surface, figure, gripper_mesh, plan_page, rank_color
from agents.plan_settings import METRICS, Settings
from agents.planning import holds_mesh, noisy_closure, plan, unlike
from baselines.grasping import grasps_on_mesh
from baselines.grasping.planning import PlannerConfig, estimate_object
from baselines.objects.point_cloud import PointCloudObject

DATA = Path(os.environ.get("AEROGRASP_DATA", Path(__file__).parents[2] / "shared" / "data"))
GRIPPER = GripperConfig()
QUICK = ("--rays", "300", "--no-cache", "--top", "5")


@pytest.fixture
def bar(tmp_path: Path) -> Path:
    """A bar of 40 × 60 × 200 mm, whose centre is not the origin."""
    mesh = trimesh.creation.box((0.04, 0.06, 0.2))
    mesh.apply_translation((0.3, 0.0, 0.0))
    mesh.export(tmp_path / "bar.obj")
    return tmp_path / "bar.obj"


def half_ball(radius: float = 0.035, count: int = 600) -> np.ndarray:
    """What is seen of a ball about (0, 0, 1) from the origin."""
    x = np.random.default_rng(3).standard_normal((count, 3))
    x *= radius / np.linalg.norm(x, axis=1, keepdims=True)
    return x[x[:, 2] < -0.1 * radius] + [0.0, 0.0, 1.0]


def run(*argv: object) -> int:
    return cli.main(["plan", *map(str, argv)])


# --- plans ----------------------------------------------------------------------------------------------------------


def test_a_bar_is_held_across_its_sides(bar: Path) -> None:
    found = plan(bar, Settings(rays=600, cache=False, top=8))
    assert found.method == "mesh" and len(found.grasps) == 8 and found.found > 8
    assert set(found.metrics) == set(METRICS)
    np.testing.assert_allclose(found.scene.center, [0.3, 0.0, 0.0], atol=1e-9)
    best = found.grasps.take([0])
    assert np.abs(best.closing_axes[0, 2]) < 1e-6  # 200 mm are too long for the jaws
    assert best.contact_widths[0] == pytest.approx(0.04, abs=1e-6) or best.contact_widths[0] == pytest.approx(0.06)
    assert (found.metrics["force_closure"] == 1.0).all()
    order = np.lexsort((-found.metrics["lmrw_sum"], -found.metrics["pfc"]))
    np.testing.assert_array_equal(order, np.arange(8))


@pytest.mark.parametrize(("metric", "sign"), [("line_distance", 1.0), ("closing_angle", 1.0), ("q_volume", -1.0)])
def test_any_metric_ranks(bar: Path, metric: str, sign: float) -> None:
    values = plan(bar, Settings(rank=metric, rays=300, cache=False)).metrics[metric]
    assert (np.diff(sign * values) >= 0.0).all()


def test_alike_grasps_are_left_out(bar: Path) -> None:
    mesh = trimesh.load_mesh(bar)
    grasps = grasps_on_mesh(mesh, GRIPPER, n_rays=400, rng=0)
    kept = grasps.take(unlike(grasps, 1000))
    assert 0 < len(kept) < len(grasps)
    gap = np.linalg.norm(kept.centers[:, None] - kept.centers, axis=2)
    turn = np.abs(kept.closing_axes @ kept.closing_axes.T)
    np.fill_diagonal(gap, np.inf)
    assert not ((gap < 0.012) & (turn > np.cos(0.35))).any()
    assert len(unlike(grasps, 3)) == 3 and len(unlike(grasps.top(0), 3)) == 0


def test_noise_lowers_the_probability_of_force_closure(bar: Path) -> None:
    grasps = grasps_on_mesh(trimesh.load_mesh(bar), GRIPPER, n_rays=100, rng=0)
    exact, noisy = (noisy_closure(grasps, Settings(noise=noise)) for noise in (0.0, 0.004))
    np.testing.assert_array_equal(exact, 1.0)  # candidates close to begin with
    assert noisy.mean() < 0.9 and (noisy >= 0.0).all()


def test_a_ball_seen_from_one_side_is_completed(tmp_path: Path) -> None:
    np.save(tmp_path / "ball.npy", half_ball())
    found = plan(tmp_path / "ball.npy", Settings(points=120, rays=400))
    assert found.method == "gpis" and len(found.grasps)
    np.testing.assert_allclose(found.scene.center, [0.0, 0.0, 1.0], atol=0.008)
    surface, shells = found.scene.surface, found.scene.shells
    assert surface is not None and surface.deviation is not None and shells is not None and set(shells) == {-1.0, 1.0}
    radius = np.linalg.norm(surface.vertices - [0.0, 0.0, 1.0], axis=1)
    seen = surface.vertices[:, 2] < 0.99
    np.testing.assert_allclose(radius[seen], 0.035, atol=0.003)
    assert surface.deviation[seen].mean() < surface.deviation[surface.vertices[:, 2] > 1.02].mean()
    inner, outer = (np.linalg.norm(shells[sigma].vertices - [0, 0, 1.0], axis=1).mean() for sigma in (-1.0, 1.0))
    assert inner < radius.mean() < outer
    again = plan(tmp_path / "ball.npy", Settings(points=120, rays=400))
    np.testing.assert_array_equal(again.grasps.centers, found.grasps.centers)


def test_seen_points_alone_need_both_sides(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(4, 0.03).vertices
    np.save(tmp_path / "whole.npy", ball)
    whole = plan(tmp_path / "whole.npy", Settings(method="cloud", all_round=True, rays=300))
    assert whole.method == "cloud" and len(whole.grasps) and whole.scene.surface is None
    np.testing.assert_allclose(np.linalg.norm(whole.grasps.positions[0], axis=1), 0.03, atol=0.004)
    np.save(tmp_path / "cap.npy", half_ball()[half_ball()[:, 2] < 0.98])
    assert len(plan(tmp_path / "cap.npy", Settings(method="cloud", rays=300)).grasps) == 0


def test_an_open_mesh_is_taken_as_points(tmp_path: Path) -> None:
    mesh = trimesh.creation.cylinder(0.025, 0.1)
    mesh.update_faces(np.arange(len(mesh.faces)) != 0)
    mesh.export(tmp_path / "open.stl")
    found = plan(tmp_path / "open.stl", Settings(points=100, rays=200))
    assert found.method == "gpis" and len(found.grasps)
    assert any(note.startswith("mesh: open") for note in found.notes)
    with pytest.raises(ValueError, match="watertight"):
        plan(tmp_path / "open.stl", Settings(method="mesh"))


def test_normals_of_a_cloud_face_where_it_was_seen_from(tmp_path: Path) -> None:
    points = half_ball()
    outward = points - [0.0, 0.0, 1.0]
    np.save(tmp_path / "a.npy", points)
    np.savez(tmp_path / "b.npz", points=points, normals=-outward / np.linalg.norm(outward, axis=1, keepdims=True))
    for name, settings in (("a.npy", Settings()), ("b.npz", Settings(viewpoint=(0.0, 0.0, 0.0)))):
        cloud, view = read_cloud(tmp_path / name, settings)
        assert view is not None and cloud.normals is not None
        assert np.einsum("ni,ni->n", cloud.normals, cloud.points - [0.0, 0.0, 1.0]).min() > 0.0
    cropped, _ = read_cloud(tmp_path / "a.npy", Settings(crop=(0.0, -1.0, 0.0, 1.0, 1.0, 2.0)))
    assert (cropped.points[:, 0] >= 0.0).all()


@pytest.mark.parametrize("prior", ["ellipsoid", "constant"])
def test_the_model_of_a_cloud_is_the_planners(prior: str) -> None:
    cloud = PointCloudObject(half_ball(), viewpoint=np.zeros(3)).estimate_normals()
    found, said = fit_model(prior, cloud, np.zeros(3), 1e-3)  # type: ignore[arg-type]
    config, noise = PlannerConfig(prior, len(cloud)), np.full(len(cloud), 1e-3)  # type: ignore[arg-type]
    expected = estimate_object(cloud.points, cloud.normals, noise, np.zeros(3), config)
    np.testing.assert_array_equal(found.center, expected.center)
    x = cloud.points + 0.01
    np.testing.assert_array_equal(found.model.predict(x).mean, expected.model.predict(x).mean)
    assert [text.split(",")[0] for text in said] == ["prior: ellipsoid"] * (prior == "ellipsoid")


def test_other_priors_take_the_ellipsoids_place() -> None:
    cloud = PointCloudObject(half_ball(), viewpoint=np.zeros(3)).estimate_normals()
    ellipsoid, _ = fit_model("ellipsoid", cloud, np.zeros(3), 1e-3)
    for name in ("cylinder", "plane"):
        found, said = fit_model(name, cloud, np.zeros(3), 1e-3)  # type: ignore[arg-type]
        assert said[0].startswith(f"prior: {name}") and found.model.kernel == ellipsoid.model.kernel
        assert type(found.model.prior) is not type(ellipsoid.model.prior)
        for got, expected in zip(found.model.observations, ellipsoid.model.observations, strict=True):
            np.testing.assert_array_equal(got, expected)


@pytest.mark.parametrize("prior", ["plane", "cylinder"])
def test_an_endless_surface_is_cut_off(tmp_path: Path, prior: str) -> None:
    cylinder = trimesh.creation.cylinder(0.03, 0.1)
    points = trimesh.sample.sample_surface(cylinder, 400, seed=0)[0]
    points = points[np.abs(points[:, 2]) < 0.049] + [0.0, 0.0, 1.0]
    np.save(tmp_path / "tube.npy", points[points[:, 0] < -0.005])
    found = plan(tmp_path / "tube.npy", Settings(prior=prior, points=60, rays=40, viewpoint=(-1.0, 0.0, 1.0)))  # type: ignore[arg-type]
    assert found.scene.surface is not None
    assert trimesh.Trimesh(found.scene.surface.vertices, found.scene.surface.faces).is_watertight


# --- the command ----------------------------------------------------------------------------------------------------


def test_table_json_and_page(bar: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    page, data = tmp_path / "out.html", tmp_path / "out.json"
    assert run(bar, *QUICK, "--html", page, "--json", data) == 0
    out, err = capsys.readouterr()
    assert err == ""  # progress is for terminals
    lines = out.splitlines()
    assert len({len(line) for line in lines[:8]}) == 1 and all(column.head in lines[0] for column in COLUMNS.values())
    assert "Ranked by PFC." in lines
    content = json.loads(data.read_text())
    assert content["provenance"]["command"].startswith("aerograsp plan ")
    assert content["method"] == "mesh" and content["settings"]["gripper"]["max_width"] == 0.1
    assert [grasp["rank"] for grasp in content["grasps"]] == [1, 2, 3, 4, 5]
    for grasp in content["grasps"]:
        Grasp(*(np.array(grasp[key]) for key in ("center", "closing_axis", "approach_axis")), grasp["width"])
        assert set(grasp["metrics"]) == set(METRICS)
    check_page(page.read_text(), 5)
    assert not list(tmp_path.glob(".out*"))
    assert run(bar, *QUICK, "--json", "-") == 0
    assert len(json.loads(capsys.readouterr().out)["grasps"]) == 5


def test_no_grasp_is_a_failure_with_its_reasons(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    trimesh.creation.box((0.3, 0.3, 0.3)).export(tmp_path / "big.ply")
    assert run(tmp_path / "big.ply", *QUICK, "--html", tmp_path / "big.html") == 1
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and re.search(r"no grasp on big.ply: \d+ opposite contacts", err)
    assert "No grasp on the mesh: " in check_page((tmp_path / "big.html").read_text(), 0)


def test_mistakes_are_one_line(bar: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    trimesh.creation.box((40, 60, 200)).export(tmp_path / "mm.stl")
    np.save(tmp_path / "close.npy", half_ball() - [0.0, 0.0, 0.95])
    np.save(tmp_path / "room.npy", np.random.default_rng(0).uniform(-1.5, 1.5, (900, 3)) * [1, 1, 0] + [0, 0, 3.0])
    (tmp_path / "broken.obj").write_text("v 0 0\nf 1 2 3\n")
    (tmp_path / "x.foo").write_text("")
    for argv, message in (
        ((tmp_path / "none.obj",), "no file"),
        ((tmp_path / "x.foo",), "expected a file of .obj"),
        ((tmp_path / "broken.obj",), "broken.obj"),
        ((tmp_path / "mm.stl",), "pass --scale 0.001"),
        ((tmp_path / "close.npy",), "pass --viewpoint X Y Z or --all-round"),
        ((tmp_path / "room.npy",), "pass --crop"),
        ((tmp_path / "room.npy", "--method", "mesh"), "method: expected gpis or cloud"),
        ((bar, "--rank", "beauty"), "invalid choice: 'beauty'"),
        ((bar, "--top", "0"), "--top"),
        ((bar, "--friction", "-1"), "expected a positive number"),
        ((bar, "--noise", "-1"), "noise: expected"),
        ((bar, "--html", tmp_path / "none" / "x.html"), "no such folder"),
        ((bar, "--all-round", "--viewpoint", "0", "0", "0"), "viewpoint: expected none"),
    ):
        assert run(*argv) == 2, argv
        out, err = capsys.readouterr()
        assert out == "" and err.count("\n") == 1 and message in err, (argv, err)
    assert run(tmp_path / "mm.stl", "--scale", "0.001", *QUICK) == 0


def test_plys_are_told_apart_by_their_faces(tmp_path: Path) -> None:
    trimesh.creation.box((0.1, 0.1, 0.1)).export(tmp_path / "mesh.ply")
    PointCloudObject(half_ball()).write_ply(tmp_path / "cloud.ply")
    assert holds_mesh(tmp_path / "mesh.ply") and not holds_mesh(tmp_path / "cloud.ply")


# --- the page -------------------------------------------------------------------------------------------------------


def check_page(page: str, grasps: int) -> str:
    """The page without plotly's script, which loads nothing and has a row and four traces for each grasp."""
    own = re.sub(r"<script[^>]*>/\*\*.*?</script>", "", page, flags=re.DOTALL)  # plotly's starts with its licence
    assert len(own) < 0.5 * len(page)
    assert not re.search(r"(src|href)\s*=|url\(|@import|https?://", own)
    assert page.count("Plotly.newPlot(") >= 1 and 'id="plan"' in own
    body = re.search(r"<tbody>(.*?)</tbody>", own, re.DOTALL)
    assert (body.group(1).count("<tr") if body else 0) == grasps
    for k in range(grasps):
        assert own.count(f'"meta":{{"grasp":{k}}}') == 4
    return own


def drawn(count: int, name: str = "1.0") -> list[DrawnGrasp]:
    grasp = Grasp(np.zeros(3), np.array([1.0, 0, 0]), np.array([0, 0, -1.0]), 0.06)
    positions, normals = np.array([[-0.02, 0, 0], [0.02, 0, 0]]), np.array([[1.0, 0, 0], [-1.0, 0, 0]])
    return [DrawnGrasp(grasp, positions, normals, (name,)) for _ in range(count)]


def test_the_gripper_is_drawn_where_its_boxes_are() -> None:
    grasp = Grasp(np.array([0.1, 0.2, 0.3]), np.array([0, 1.0, 0]), np.array([0, 0, -1.0]), 0.06)
    mesh = gripper_mesh(grasp, GRIPPER)
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert solid.is_watertight and solid.volume == pytest.approx(
        sum(8 * np.prod(box.half_size) for box in GRIPPER.boxes(0.06))
    )
    pads = mesh.vertices[np.abs(mesh.vertices[:, 2] - 0.3) <= 0.5 * GRIPPER.pad_height + 1e-9]
    assert np.abs(pads[:, 1] - 0.2).min() == pytest.approx(0.03)  # the pads' faces
    assert mesh.vertices[:, 2].max() == pytest.approx(0.3 + GRIPPER.finger_length + GRIPPER.palm_depth)


def test_every_part_of_the_scene_is_a_trace_that_plotly_accepts() -> None:
    from plotly.graph_objects import Figure

    ball = trimesh.creation.icosphere(2, 0.02)
    surface = Surface(ball.vertices, ball.faces, np.full(len(ball.vertices), 0.002))
    shells = {1.0: Surface(1.1 * ball.vertices, ball.faces), -1.0: Surface(0.9 * ball.vertices, ball.faces)}
    for view in ([0.0, 0.0, -1.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]):
        scene = Scene(surface, ball.vertices, shells, np.array(view), np.zeros(3))
        made = figure(scene, drawn(3), ["PFC"], GRIPPER)
        names = [trace["name"] for trace in Figure(made).to_dict()["data"]]
        assert names[:5] == [
            "estimated surface",
            "−1 σ shell",
            "+1 σ shell",
            "162 points seen",
            "centre of the estimate",
        ]
        assert names[5::4] == ["grasp 1", "grasp 2", "grasp 3"]
        eye, up = (np.array(list(made["layout"]["scene"]["camera"][key].values())) for key in ("eye", "up"))
        assert eye @ view > 0.0 and np.linalg.norm(np.cross(eye, up)) > 0.1
    np.testing.assert_allclose(made["data"][0]["intensity"], 2.0, rtol=1e-6)  # mm
    shown = [trace["visible"] for trace in made["data"] if "meta" in trace]
    assert shown == [True] * 4 + ["legendonly"] * 8
    assert "PFC: 1.0" in made["data"][5]["hovertemplate"]
    deviation = np.where(ball.vertices[:, 0] > 0.0, 0.01, 0.0)
    half = figure(Scene(surface, shells={1.0: Surface(ball.vertices, ball.faces, deviation)}), [], [], GRIPPER)
    assert 0 < len(half["data"][1]["i"]) < len(ball.faces)  # only where the shell is clear of the surface
    exact = figure(Scene(surface, shells={1.0: Surface(ball.vertices, ball.faces, 0.0 * deviation)}), [], [], GRIPPER)
    assert len(exact["data"]) == 1
    assert Figure(figure(Scene(None, ball.vertices), [], [], GRIPPER)).data[0].type == "scatter3d"


def test_names_cannot_break_the_page() -> None:
    evil = "</script><script>alert(1)</script><b>"
    ball = trimesh.creation.icosphere(1, 0.02)
    page = plan_page(evil, evil, Scene(Surface(ball.vertices, ball.faces)), drawn(2, evil), [evil], GRIPPER, [evil], {})
    assert "<script>alert(1)" not in check_page(page, 2)
    with pytest.raises(ValueError, match="expected 2 cells"):
        plan_page("", "", Scene(None), drawn(1), ["a", "b"], GRIPPER, [], {})


def test_colours_run_from_the_best_to_the_last() -> None:
    assert [rank_color(k, 4) for k in range(4)] == ["#0d3c8c", "#1f78b4", "#41b6c4", "#a1dab4"]
    assert rank_color(0, 1) == "#0d3c8c"


# --- real objects ---------------------------------------------------------------------------------------------------


@pytest.mark.skipif(not (DATA / "meshes_ycb").is_dir(), reason="real data not present")
def test_real_meshes_and_clouds_have_grasps() -> None:
    for path, options in (
        ("meshes_ycb/YcbMustardBottle/textured_simple_reoriented.obj", {}),
        ("meshes_grasping_tools/mesh_grasping/samples/multitool.stl", {}),
        ("clouds_gpd/krylon.pcd", {"all_round": True, "points": 150}),
        ("clouds_pcl/bun0.pcd", {"viewpoint": (0.0, 0.1, 1.0), "points": 150, "rays": 2000}),  # hardly fits the jaws
    ):
        found = plan(DATA / path, Settings(**{"rays": 800, "cache": False, **options}))
        assert len(found.grasps) == 10, path
        assert found.metrics["pfc"][0] > 0.7 and plan_text(found, "pfc").count("\n") > 12
