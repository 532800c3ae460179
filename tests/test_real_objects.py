"""Scanned and downloaded meshes and clouds: each loads, or gives the stated reason."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from baselines.objects import FeatureCloud, MeshObject, PointCloudObject

DATA = Path(os.environ.get("AEROGRASP_DATA", Path(__file__).parents[2] / "shared" / "data"))
needs_data = pytest.mark.skipif(not (DATA / "meshes_ycb").is_dir(), reason="real data not present")

TOOLS, VALVES = "meshes_grasping_tools", "meshes_tools_valves"
WATERTIGHT = {  # file: whether it is one, and what is said of it
    "meshes_ycb/YcbCrackerBox/textured_simple_reoriented.obj": (True, ""),
    "meshes_ycb/YcbCrackerBox/collision_vhacd.obj": (True, ""),
    "meshes_ycb/YcbMustardBottle/textured_simple_reoriented.obj": (True, "self-intersecting: 2 pair"),
    "meshes_ycb/YcbMustardBottle/collision_vhacd.obj": (True, "self-intersecting"),
    "meshes_ycb/YcbPowerDrill/textured_simple_reoriented.obj": (True, ""),
    "meshes_ycb/YcbPowerDrill/collision_vhacd.obj": (True, "self-intersecting"),
    f"{TOOLS}/gpis_grasping/samples/bun_zipper.ply": (False, "open: 158 edge"),
    f"{TOOLS}/mesh_grasping/hand_model/base.stl": (False, "open: 2 edge"),
    f"{TOOLS}/mesh_grasping/hand_model/leftGripper.stl": (True, ""),
    f"{TOOLS}/mesh_grasping/hand_model/rightGripper.stl": (True, ""),
    f"{TOOLS}/mesh_grasping/samples/crawler_no_antenas_handle.stl": (True, "self-intersecting: 1000+"),
    f"{TOOLS}/mesh_grasping/samples/mug.stl": (False, "open: 71 edge"),
    f"{TOOLS}/mesh_grasping/samples/multitool.stl": (True, "not manifold: 24 edge"),
    f"{TOOLS}/mesh_grasping/samples/torus.obj": (True, ""),
    f"{VALVES}/cordless_drill.stl": (True, "1 face(s) without area; self-intersecting"),
}
REFUSED = {
    f"{TOOLS}/gpis_grasping/samples/crawler_smooth_normals.ply": "at least one face",
    f"{TOOLS}/gpis_grasping/samples/crawler_smooth_normals_2.ply": "at least one face",
    f"{VALVES}/hammer.obj": "looks like millimetres .* or inches",
    f"{VALVES}/valve_wheel.obj": "looks like millimetres .* or inches",
}


@needs_data
def test_every_mesh_is_listed() -> None:
    found = {
        str(path.relative_to(DATA))
        for folder in ("meshes_ycb", TOOLS, VALVES)
        for path in (DATA / folder).rglob("*")
        if path.suffix in (".obj", ".stl", ".ply")
    }
    assert found == set(WATERTIGHT) | set(REFUSED)


@needs_data
@pytest.mark.parametrize("name", WATERTIGHT)
def test_meshes_load(name: str) -> None:
    mesh = MeshObject.from_file(DATA / name)
    watertight, said = WATERTIGHT[name]
    assert mesh.watertight == watertight and "; ".join(mesh.report.faults).startswith(said)
    assert said or not mesh.report.faults
    rng = np.random.default_rng(0)
    center = mesh.vertices.mean(axis=0)
    d = rng.normal(size=(500, 3))
    d /= np.linalg.norm(d, axis=1)[:, None]
    hits = mesh.ray_hits(center - d + 0.02 * rng.normal(size=(500, 3)), d)
    assert len(hits.rays) > 0
    if watertight:
        assert 0 < mesh.volume < 0.005
        assert (np.bincount(hits.rays, minlength=500) % 2 == 0).all()
    else:
        with pytest.raises(ValueError, match="watertight"):
            assert mesh.volume


@needs_data
@pytest.mark.parametrize("name", REFUSED)
def test_meshes_are_refused_for_a_reason(name: str) -> None:
    with pytest.raises(ValueError, match=REFUSED[name]):
        MeshObject.from_file(DATA / name)


@needs_data
def test_meshes_in_inches_load_when_told() -> None:
    for name, size in (("hammer", 0.335), ("valve_wheel", 0.25)):
        mesh = MeshObject.from_file(DATA / VALVES / f"{name}.obj", scale=0.0254)
        assert mesh.extents.max() == pytest.approx(size, abs=0.001) and "doubled" in mesh.report.repairs[0]


@needs_data
@pytest.mark.parametrize(
    "name",
    [
        *(f"clouds_pcl/{n}.pcd" for n in ("bun0", "bun01", "bun02", "bun03", "bun4", "bunny", "milk", "milk_color")),
        *(f"clouds_pcl/{n}.pcd" for n in ("milk_cartoon_all_small_clorox", "noisy_slice_displaced", "sac_plane_test")),
        "clouds_gpd/krylon.pcd",
        f"{TOOLS}/gpis_grasping/samples/crawler_smooth_normals.ply",
        f"{TOOLS}/gpis_grasping/samples/crawler_smooth_normals_2.ply",
    ],
)
def test_clouds_load_and_have_normals(name: str) -> None:
    cloud = PointCloudObject.from_file(DATA / name)
    assert 0.05 < cloud.extents.max() < 2.5
    if cloud.valid is not None:
        assert cloud.valid.shape == (480, 640)
        by_window = cloud.estimate_normals(window=5)
        assert len(by_window) > 0.9 * len(cloud)
    thin = cloud.voxel_downsample(0.01).estimate_normals(neighbors=10)
    assert thin.normals is not None
    np.testing.assert_allclose(np.linalg.norm(thin.normals, axis=1), 1.0, atol=1e-9)


@needs_data
def test_two_views_of_the_milk_carton_share_features() -> None:
    milk = PointCloudObject.from_file(DATA / "clouds_pcl/milk.pcd").voxel_downsample(0.005).estimate_normals()
    features = FeatureCloud.from_cloud(milk, 0.03, "uniform", 0.02)
    assert len(features) > 50 and len(features.match(features, ratio=None).query) == len(features)
