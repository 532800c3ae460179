"""Clouds of known surfaces: normals, sampling, files, and bad input named."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from aerograsp_env import spatial as sp
from aerograsp_env.interfaces import Intrinsics
from baselines.objects.point_cloud import PointCloudObject

CAMERA = Intrinsics(64, 48, 60.0, 61.0, 31.5, 23.5)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(3)


def sphere(rng: np.random.Generator, n: int = 3000) -> np.ndarray:
    p = rng.normal(size=(n, 3))
    return p / np.linalg.norm(p, axis=1)[:, None]


def plane_depth() -> np.ndarray:
    """Depth of the plane n·p = 0.8 with n = (0.3, −0.2, 1), in closed form."""
    y, x = np.mgrid[:48, :64]
    ray = np.stack([(x - 31.5) / 60.0, (y - 23.5) / 61.0, np.ones_like(x)], axis=-1)
    return 0.8 / (ray @ [0.3, -0.2, 1.0])


def test_depth_becomes_points_on_the_plane() -> None:
    depth = plane_depth()
    depth[3, 5], depth[7, 7] = 0.0, np.nan
    rgb = np.arange(48 * 64 * 3, dtype=np.uint32).reshape(48, 64, 3).astype(np.uint8)
    cloud = PointCloudObject.from_depth(depth, CAMERA, rgb)
    assert len(cloud) == 48 * 64 - 2 and cloud.valid is not None and cloud.colors is not None
    np.testing.assert_allclose(cloud.points @ [0.3, -0.2, 1.0], 0.8, atol=1e-12)
    np.testing.assert_array_equal(cloud.colors, rgb[cloud.valid])
    np.testing.assert_array_equal(np.isnan(cloud.grid()[..., 2]), ~cloud.valid)


@pytest.mark.parametrize("window", [None, 5])
def test_normals_of_a_plane_look_at_the_camera(window: int | None) -> None:
    T = sp.transform(sp.so3_exp([0.3, 0.2, -1.0]), [1.0, 2.0, 3.0])
    cloud = PointCloudObject.from_depth(plane_depth(), CAMERA, T=T).estimate_normals(window=window)
    expected = T[:3, :3] @ -np.array([0.3, -0.2, 1.0]) / np.sqrt(1.13)
    assert cloud.normals is not None and cloud.curvature is not None
    np.testing.assert_allclose(cloud.normals, np.tile(expected, (len(cloud), 1)), atol=1e-6)
    np.testing.assert_allclose(cloud.curvature, 0.0, atol=1e-10)


def test_windows_across_a_jump_of_depth_have_no_normal() -> None:
    depth = np.full((48, 64), 0.5)
    depth[:, 32:] = 1.0
    cloud = PointCloudObject.from_depth(depth, CAMERA).estimate_normals(window=5)
    assert cloud.valid is not None and not cloud.valid[:, 30:34].any() and cloud.valid[:, :30].all()
    assert cloud.normals is not None
    np.testing.assert_allclose(cloud.normals, np.tile([0.0, 0, -1], (len(cloud), 1)), atol=1e-9)


def test_normals_of_a_sphere_point_to_the_viewpoint(rng: np.random.Generator) -> None:
    p = sphere(rng)
    cloud = PointCloudObject(p, viewpoint=np.array([0.0, 0.0, 9.0])).estimate_normals(neighbors=12)
    assert cloud.normals is not None
    seen = p[:, 2] > 0.3
    assert np.rad2deg(np.arccos(np.einsum("ni,ni->n", cloud.normals, p)[seen])).max() < 8.0
    by_radius = PointCloudObject(p).estimate_normals(neighbors=None, radius=0.15)
    assert by_radius.normals is not None  # seen from the inside, normals look inwards
    assert np.einsum("ni,ni->n", by_radius.normals, p).max() < -0.97


def test_lines_and_heaps_have_no_normals() -> None:
    line = np.outer(np.linspace(0, 1, 50), [1.0, 2.0, 3.0])
    for points in (line, np.zeros((30, 3)), np.eye(3)[:2]):
        with pytest.raises(ValueError, match=r"points.*collinear or coinciding"):
            PointCloudObject(points).estimate_normals()
    square = np.stack([*np.meshgrid(np.linspace(0, 1, 20), np.linspace(0, 1, 20)), np.full((20, 20), 5.0)], -1)
    mixed = PointCloudObject(np.concatenate([square.reshape(-1, 3), line - 50.0])).estimate_normals(neighbors=10)
    assert len(mixed) == 400 and np.isfinite(mixed.normals).all()  # type: ignore[arg-type]


def test_voxels_hold_means(rng: np.random.Generator) -> None:
    points = rng.uniform(-1, 1, (500, 3))
    normals = sphere(rng, 500)
    cloud = PointCloudObject(points, normals, noise=np.full(500, 0.01)).voxel_downsample(0.5)
    cells: dict[tuple, list[int]] = {}
    for i, cell in enumerate(np.floor(points / 0.5).astype(int)):
        cells.setdefault(tuple(cell), []).append(i)
    assert len(cloud) == len(cells) == 64
    for row, key in enumerate(sorted(cells)):
        np.testing.assert_allclose(cloud.points[row], points[cells[key]].mean(axis=0), atol=1e-12)
        mean = normals[cells[key]].mean(axis=0)
        np.testing.assert_allclose(cloud.normals[row], mean / np.linalg.norm(mean), atol=1e-9)  # type: ignore[index]
    with pytest.raises(ValueError, match="size"):
        PointCloudObject(points).voxel_downsample(0.0)


def test_farthest_points_equal_the_definition(rng: np.random.Generator) -> None:
    points = rng.normal(size=(200, 3))
    chosen = [0]
    for _ in range(19):
        gaps = np.linalg.norm(points[:, None] - points[chosen], axis=2).min(axis=1)
        chosen.append(int(gaps.argmax()))
    cloud = PointCloudObject(points)
    np.testing.assert_array_equal(cloud.farthest_point_sample(20).points, points[chosen])
    drawn = cloud.farthest_point_sample(20, np.random.default_rng(1)).points
    np.testing.assert_array_equal(drawn, cloud.farthest_point_sample(20, np.random.default_rng(1)).points)
    with pytest.raises(ValueError, match=r"n: expected .* \[0, 200\]"):
        cloud.farthest_point_sample(201)


def test_outliers_go_and_crops_stay(rng: np.random.Generator) -> None:
    far = np.array([[3.0, 0, 0], [0, -4.0, 0]])
    cloud = PointCloudObject(np.concatenate([sphere(rng), far]))
    kept = cloud.remove_outliers(deviations=3.0)
    assert np.linalg.norm(kept.points, axis=1).max() < 1.5 and len(kept) > 2900
    top = cloud.crop([-2, -2, 0.5], [2, 2, 2])
    assert (top.points[:, 2] >= 0.5).all() and len(top) == (cloud.points[:, 2] >= 0.5).sum()
    with pytest.raises(ValueError, match="at least one point"):
        cloud.crop([5, 5, 5], [6, 6, 6])
    with pytest.raises(ValueError, match="upper"):
        cloud.crop([0, 0, 0], [-1, 1, 1])


# --- files ----------------------------------------------------------------------------------------------------------


def compress(data: bytes) -> bytes:
    """LZF of literal runs, and of one overlapping copy for a repeated byte."""
    out = bytearray()
    i = 0
    while i < len(data):
        run = 1
        while i + run < len(data) and run < 200 and data[i + run] == data[i]:
            run += 1
        if run >= 12:
            out += bytes([0, data[i]]) + bytes([7 << 5, run - 1 - 9, 0])
            i += run
        else:
            piece = data[i : i + 1]
            out += bytes([0]) + piece
            i += 1
    return bytes(out)


def pcd(path: Path, points: np.ndarray, mode: str) -> Path:
    table = points.astype("<f4")
    head = f"# .PCD\nVERSION 0.7\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F U\nCOUNT 1 1 1 1\nWIDTH {len(points)}\n"
    head += f"HEIGHT 1\nVIEWPOINT 0 0 1 1 0 0 0\nPOINTS {len(points)}\nDATA {mode}\n"
    color = np.full(len(points), 0x0A141E, dtype="<u4")
    if mode == "ascii":
        body = "".join(
            f"{float(x)!r} {float(y)!r} {float(z)!r} {c}\n" for (x, y, z), c in zip(table, color, strict=True)
        ).encode()
    elif mode == "binary":
        body = b"".join(row.tobytes() + c.tobytes() for row, c in zip(table, color, strict=True))
    else:
        raw = table.T.tobytes() + color.tobytes()
        packed = compress(raw)
        body = struct.pack("<II", len(packed), len(raw)) + packed
    path.write_bytes(head.encode() + body)
    return path


@pytest.mark.parametrize("mode", ["ascii", "binary", "binary_compressed"])
def test_pcd_in_every_form(mode: str, tmp_path: Path, rng: np.random.Generator) -> None:
    points = np.concatenate([rng.normal(size=(40, 3)), np.zeros((20, 3)), [[np.nan] * 3]])
    cloud = PointCloudObject.from_file(pcd(tmp_path / "a.pcd", points, mode))
    np.testing.assert_array_equal(cloud.points, points[:60].astype(np.float32))
    assert cloud.colors is not None and cloud.viewpoint is not None
    assert cloud.colors[0].tolist() == [10, 20, 30] and cloud.viewpoint.tolist() == [0, 0, 1]


def test_ply_goes_round_and_replaces_at_once(tmp_path: Path, rng: np.random.Generator) -> None:
    colors = rng.integers(0, 255, (50, 3)).astype(np.uint8)
    cloud = PointCloudObject(rng.normal(size=(50, 3)), sphere(rng, 50), colors)
    path = tmp_path / "a.ply"
    path.write_text("old")
    cloud.write_ply(path)
    back = PointCloudObject.from_file(path)
    np.testing.assert_array_equal(back.points, cloud.points)
    np.testing.assert_allclose(back.normals, cloud.normals, atol=1e-15)  # type: ignore[arg-type]
    np.testing.assert_array_equal(back.colors, colors)  # type: ignore[arg-type]
    assert [p.name for p in tmp_path.iterdir()] == ["a.ply"]


def test_arrays_and_columns(tmp_path: Path, rng: np.random.Generator) -> None:
    points, normals = rng.normal(size=(9, 3)), sphere(rng, 9)
    np.save(tmp_path / "a.npy", points)
    np.savez(tmp_path / "a.npz", points=points, normals=normals)
    np.savetxt(tmp_path / "a.xyz", np.hstack([points, normals]), fmt="%.17g")
    for name in ("a.npy", "a.npz", "a.xyz"):
        cloud = PointCloudObject.from_file(tmp_path / name)
        np.testing.assert_array_equal(cloud.points, points)
        assert (cloud.normals is None) == (name == "a.npy")
    np.save(tmp_path / "evil.npy", np.array([{}], dtype=object), allow_pickle=True)
    with pytest.raises(ValueError, match=r"evil\.npy"):
        PointCloudObject.from_file(tmp_path / "evil.npy")


def test_bad_files_are_named(tmp_path: Path, rng: np.random.Generator) -> None:
    whole = pcd(tmp_path / "whole.pcd", rng.normal(size=(40, 3)), "binary_compressed").read_bytes()
    for cut in (10, 150, len(whole) - 7):
        (tmp_path / "cut.pcd").write_bytes(whole[:cut])
        with pytest.raises(ValueError, match=r"cut\.pcd"):
            PointCloudObject.from_file(tmp_path / "cut.pcd")
    with pytest.raises(ValueError, match="ending"):
        PointCloudObject.from_file(tmp_path / "a.doc")
    with pytest.raises(FileNotFoundError):
        PointCloudObject.from_file(tmp_path / "a.pcd")
    np.save(tmp_path / "mm.npy", 1000.0 * sphere(rng))
    with pytest.raises(ValueError, match="looks like millimetres"):
        PointCloudObject.from_file(tmp_path / "mm.npy")
    assert PointCloudObject.from_file(tmp_path / "mm.npy", scale=0.001).extents.max() < 2.1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"points": np.empty((0, 3))}, "points: expected at least one"),
        ({"points": [[0, 0, np.nan]]}, "points: expected finite"),
        ({"points": [[0, 0]]}, "points: expected shape"),
        ({"points": [[0, 0, 0]], "normals": [[0, 0, 0]]}, "normals: expected unit length.*got 0 in row 0"),
        ({"points": [[0, 0, 0]], "normals": [[0, 0, 2]]}, "normals: expected unit length.*got 2 in row 0"),
        ({"points": [[0, 0, 0]], "normals": [[0, 0, 1], [0, 0, 1]]}, "normals: expected shape"),
        ({"points": [[0, 0, 0]], "noise": [-1.0]}, "noise: expected standard deviations"),
        ({"points": [[0, 0, 0]], "colors": [[0.0, 0.0, 0.0]]}, "colors: expected uint8"),
        ({"points": [[0, 0, 0]], "valid": np.ones((2, 2), bool)}, "valid: expected booleans"),
    ],
)
def test_bad_clouds_are_named(arguments: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        PointCloudObject(**arguments)


def test_bad_depth_is_named() -> None:
    for depth, message in (
        (np.zeros((48, 64)), "at least one return"),
        (np.ones((4, 4)), "expected shape"),
        (-np.ones((48, 64)), "≥ 0"),
        (np.full((48, 64), 800.0), "looks like millimetres"),
    ):
        with pytest.raises(ValueError, match=f"depth: .*{message}"):
            PointCloudObject.from_depth(depth, CAMERA)
