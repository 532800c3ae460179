"""Meshes against closed forms, and every fault of a mesh said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from aerograsp_env import spatial as sp
from baselines.objects.convex import convex_pieces, watertight_union
from baselines.objects.mesh import MeshObject


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(5)


def box(size: tuple[float, float, float] = (0.1, 0.2, 0.3), center: tuple[float, float, float] = (0, 0, 0)):
    mesh = trimesh.creation.box(size)
    mesh.apply_translation(center)
    return mesh


def ball(subdivisions: int = 4, radius: float = 0.5) -> MeshObject:
    return MeshObject.from_trimesh(trimesh.creation.icosphere(subdivisions, radius))


# --- measures -------------------------------------------------------------------------------------------------------


def test_a_box_has_the_mass_of_a_box() -> None:
    mesh = MeshObject.from_trimesh(box((0.1, 0.2, 0.3), (0.4, -0.1, 0.2)))
    assert mesh.watertight and mesh.report.faults == ()
    assert mesh.volume == pytest.approx(0.006, rel=1e-12)
    np.testing.assert_allclose(mesh.center_of_mass, [0.4, -0.1, 0.2], atol=1e-12)
    m = 700 * 0.006
    expected = m / 12 * np.diag([0.2**2 + 0.3**2, 0.1**2 + 0.3**2, 0.1**2 + 0.2**2])
    np.testing.assert_allclose(mesh.inertia(700), expected, atol=1e-12)
    with pytest.raises(ValueError, match="density"):
        mesh.inertia(0.0)


def test_inertia_turns_with_the_mesh(rng: np.random.Generator) -> None:
    mesh = MeshObject.from_trimesh(trimesh.creation.cylinder(0.03, 0.2))
    T = sp.transform(sp.so3_exp(rng.normal(size=3)), rng.normal(size=3))
    moved = mesh.transform(T)
    np.testing.assert_allclose(moved.inertia(1.0), T[:3, :3] @ mesh.inertia(1.0) @ T[:3, :3].T, atol=1e-12)
    np.testing.assert_allclose(moved.center_of_mass, sp.transform_points(T, mesh.center_of_mass), atol=1e-12)


def test_samples_are_uniform_and_repeatable(rng: np.random.Generator) -> None:
    mesh = MeshObject.from_trimesh(box())
    sample = mesh.sample(20000, np.random.default_rng(1))
    np.testing.assert_array_equal(sample.points, mesh.sample(20000, np.random.default_rng(1)).points)
    np.testing.assert_allclose(np.abs(mesh.signed_distance(sample.points)), 0.0, atol=1e-12)
    # every point lies on the side that its normal names, and sides get their share of the area
    side = np.einsum("ni,ni->n", sample.points, sample.normals)
    np.testing.assert_allclose(side, np.abs(sample.normals) @ [0.05, 0.1, 0.15], atol=1e-12)
    top = np.abs(sample.normals[:, 2]).mean()
    share = 0.02 / (0.02 + 0.03 + 0.06)
    assert top == pytest.approx(share, abs=4 * np.sqrt(share * (1 - share) / 20000))


def test_signed_distance_of_a_box(rng: np.random.Generator) -> None:
    mesh, half = MeshObject.from_trimesh(box((0.2, 0.4, 0.6))), np.array([0.1, 0.2, 0.3])
    p = rng.uniform(-0.5, 0.5, (2000, 3))
    gap = np.abs(p) - half
    expected = np.linalg.norm(np.maximum(gap, 0.0), axis=1) + np.minimum(gap.max(axis=1), 0.0)
    np.testing.assert_allclose(mesh.signed_distance(p), expected, atol=1e-12)


def test_overlapping_parts_are_one_solid() -> None:
    parts = trimesh.util.concatenate([box((0.2, 0.2, 0.2)), box((0.2, 0.2, 0.2), (0.1, 0.05, 0.03))])
    mesh = MeshObject.from_trimesh(parts)
    assert mesh.report.bodies == 2 and mesh.report.self_intersections > 0
    assert "self-intersecting" in mesh.report.faults[0]
    assert mesh.contains([[0.05, 0.0, 0.0], [0.15, 0.05, 0.0], [0.15, -0.08, 0.0]]).tolist() == [True, True, False]


def test_parts_that_only_touch_do_not_intersect() -> None:
    for lift, crossing in ((0.0, False), (-0.02, True)):
        parts = [box((0.2, 0.2, 0.2)), box((0.06, 0.06, 0.06), (0.02, 0.014, 0.13 + lift))]
        report = MeshObject.from_trimesh(trimesh.util.concatenate(parts)).report
        assert (report.self_intersections > 0) is crossing


# --- rays -----------------------------------------------------------------------------------------------------------


def test_rays_through_a_box() -> None:
    mesh = MeshObject.from_trimesh(box((0.2, 0.4, 0.6)))
    hits = mesh.ray_hits(
        [[-1.0, 0.03, 0.02], [0.01, 0.02, 0.0], [5.0, 5.0, 5.0]], [[2.0, 0, 0], [0, 0, -1.0], [1, 0, 0]]
    )
    assert hits.rays.tolist() == [0, 0, 1]
    np.testing.assert_allclose(hits.distances, [0.9, 1.1, 0.3], atol=1e-15)
    np.testing.assert_allclose(mesh.face_normals[hits.faces], [[-1, 0, 0], [1, 0, 0], [0, 0, -1]], atol=1e-15)


def test_hits_at_edges_and_corners_are_neither_lost_nor_doubled() -> None:
    """Aimed exactly at every vertex, edge middle and axis of a sphere, from far away: always an even number."""
    mesh = ball(3)
    v = mesh.vertices
    edges = 0.5 * (v[mesh.faces[:, 0]] + v[mesh.faces[:, 1]])
    targets = np.concatenate([v, edges, np.zeros((6, 3))])
    directions = np.concatenate([np.tile([0.0, 0.0, 1.0], (len(v) + len(edges), 1)), np.eye(3), -np.eye(3)])
    hits = mesh.ray_hits(targets - 2.0 * directions, directions)
    counts = np.bincount(hits.rays, minlength=len(targets))
    assert set(counts.tolist()) <= {0, 2}  # a ray that only grazes the outline may be moved off it
    inner = np.hypot(targets[:, 0], targets[:, 1]) < 0.45
    assert (counts[inner] == 2).all()
    cube = MeshObject.from_trimesh(box((0.2, 0.2, 0.2)))
    along_a_diagonal = cube.ray_hits([[-1.0, -1, -1], [-1, 0, 0], [0, 0, -1]], [[1, 1, 1], [1, 0, 0], [0, 0, 1]])
    assert np.bincount(along_a_diagonal.rays).tolist() == [2, 2, 2]


def test_hits_equal_brute_force(rng: np.random.Generator) -> None:
    mesh = MeshObject.from_trimesh(trimesh.creation.torus(0.3, 0.1))
    o = rng.uniform(-1, 1, (300, 3))
    d = rng.normal(size=(300, 3)) * 0.2 - o
    unit = d / np.linalg.norm(d, axis=1)[:, None]
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    expected = []
    for i in range(300):  # Möller & Trumbore 1997
        e, f = b - a, c - a
        h = np.cross(unit[i], f)
        k = np.einsum("ni,ni->n", e, h)
        s = o[i] - a
        u = np.einsum("ni,ni->n", s, h) / k
        q = np.cross(s, e)
        v, t = q @ unit[i] / k, np.einsum("ni,ni->n", f, q) / k
        hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0)
        expected += [(i, x) for x in np.sort(t[hit])]
    hits = mesh.ray_hits(o, d)
    assert hits.rays.tolist() == [i for i, _ in expected]
    np.testing.assert_allclose(hits.distances, [t for _, t in expected], atol=1e-9)
    assert hits.rays.max() > 0 and np.bincount(hits.rays).max() >= 4


@pytest.mark.parametrize("thickness", [1e-2, 1e-5, 1e-7])
def test_walls_thinner_than_float32_are_crossed_twice(thickness: float, rng: np.random.Generator) -> None:
    mesh = MeshObject.from_trimesh(box((1.0, 1.0, thickness)))
    targets = np.concatenate([rng.uniform(-0.4, 0.4, (200, 2)), np.zeros((200, 1))], axis=1)
    directions = rng.normal(size=(200, 3)) * [0.3, 0.3, 0.0] + [0.0, 0.0, 1.0]
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    hits = mesh.ray_hits(targets - 2.0 * directions, directions)
    np.testing.assert_array_equal(hits.rays, np.repeat(np.arange(200), 2))
    apart = np.diff(hits.distances.reshape(-1, 2), axis=1)[:, 0]
    np.testing.assert_allclose(apart, thickness / directions[:, 2], atol=1e-14)


def test_no_ray_enters_a_watertight_mesh_more_often_than_it_leaves(rng: np.random.Generator) -> None:
    """Also not where parts overlap, from far away, or aimed at corners along the axes."""
    parts = [box((0.2, 0.2, 0.2)), box((0.2, 0.2, 0.2), (0.1, 0.05, 0.03)), trimesh.creation.torus(0.3, 0.1)]
    mesh = MeshObject.from_trimesh(trimesh.util.concatenate(parts))
    n = len(mesh.vertices)
    targets = np.concatenate([mesh.vertices, rng.uniform(-0.4, 0.4, (2000, 3))])
    directions = np.concatenate([np.eye(3)[np.arange(n) % 3], rng.normal(size=(2000, 3))])
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    hits = mesh.ray_hits(targets - 50.0 * directions, directions)
    turns = np.sign(np.einsum("hi,hi->h", mesh.face_normals[hits.faces], directions[hits.rays]))
    assert not np.bincount(hits.rays, weights=turns, minlength=len(targets)).any()
    assert not (np.bincount(hits.rays) % 2).any() and np.bincount(hits.rays).max() >= 6
    assert (np.diff(hits.rays) >= 0).all() and (np.diff(hits.distances)[np.diff(hits.rays) == 0] >= 0.0).all()


def test_rays_that_start_inside_have_only_what_lies_ahead() -> None:
    mesh = MeshObject.from_trimesh(box((0.2, 0.2, 0.2)))
    hits = mesh.ray_hits([[0.01, 0.02, 0.03], [0.01, 0.02, 0.3]], [[0, 0, 1], [0, 0, 1]])
    assert hits.rays.tolist() == [0]
    np.testing.assert_allclose(hits.distances, [0.07], atol=1e-15)
    nothing = mesh.ray_hits(np.empty((0, 3)), np.empty((0, 3)))
    assert len(nothing.rays) == len(nothing.distances) == len(nothing.faces) == 0


def test_closest_points_equal_brute_force(rng: np.random.Generator) -> None:
    mesh = ball(2)
    p = rng.uniform(-1, 1, (50, 3))
    found, faces = mesh.closest(p)
    every = np.array(
        [trimesh.triangles.closest_point(mesh.vertices[mesh.faces], np.tile(x, (len(mesh.faces), 1))) for x in p]
    )
    np.testing.assert_allclose(
        np.linalg.norm(found - p, axis=1), np.linalg.norm(every - p[:, None], axis=2).min(axis=1)
    )
    np.testing.assert_allclose(found, every[np.arange(50), faces], atol=1e-14)


# --- faults ---------------------------------------------------------------------------------------------------------


def test_millimetres_are_said_and_never_guessed(tmp_path: Path) -> None:
    path = tmp_path / "part.stl"
    box((100, 200, 300)).export(path)
    with pytest.raises(ValueError, match=r"part.stl.*looks like millimetres.*pass scale=0.001"):
        MeshObject.from_file(path)
    np.testing.assert_allclose(MeshObject.from_file(path, scale=0.001).extents, [0.1, 0.2, 0.3], rtol=1e-6)
    np.testing.assert_allclose(MeshObject.from_file(path, scale=1.0).extents, [100, 200, 300])


def test_inverted_meshes_are_turned_or_refused() -> None:
    mesh = box()
    inside_out = mesh.faces[:, ::-1]
    repaired = MeshObject.from_arrays(mesh.vertices, inside_out)
    assert repaired.volume == pytest.approx(0.006) and "inverted" in repaired.report.repairs[0]
    with pytest.raises(ValueError, match="needs repair"):
        MeshObject.from_arrays(mesh.vertices, inside_out, repair=False)


def test_one_face_that_disagrees_is_turned() -> None:
    mesh = box()
    faces = mesh.faces.copy()
    faces[3] = faces[3][::-1]
    repaired = MeshObject.from_arrays(mesh.vertices, faces)
    assert repaired.watertight and repaired.volume == pytest.approx(0.006)


def test_a_cavity_stays_a_cavity() -> None:
    inner = box((0.1, 0.1, 0.1))
    inner.invert()
    mesh = MeshObject.from_trimesh(trimesh.util.concatenate([box((0.2, 0.2, 0.2)), inner]))
    assert mesh.report.repairs == () and mesh.volume == pytest.approx(0.008 - 0.001)
    assert mesh.contains([[0, 0, 0], [0.07, 0, 0]]).tolist() == [False, True]


def test_an_open_mesh_says_so() -> None:
    mesh = box()
    opened = MeshObject.from_arrays(mesh.vertices, mesh.faces[1:])
    assert not opened.watertight and opened.report.open_edges == 3
    assert len(opened.ray_hits([[0, 0, -1]], [[0, 0, 1]]).rays) >= 1
    for question in (lambda: opened.volume, lambda: opened.signed_distance([[0, 0, 0]]), lambda: opened.inertia(1.0)):
        with pytest.raises(ValueError, match=r"watertight.*open: 3 edge"):
            question()


def test_doubled_and_degenerate_faces_are_dropped() -> None:
    mesh = box()
    faces = np.concatenate([mesh.faces, mesh.faces[:2, ::-1], [[0, 0, 1]]])
    repaired = MeshObject.from_arrays(mesh.vertices, faces)
    assert len(repaired.faces) == 12 and len(repaired.report.repairs) == 2 and repaired.watertight


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        (np.empty((0, 3)), np.empty((0, 3), int), "at least one face"),
        ([[0, 0, 0], [1, 0, np.nan], [0, 1, 0]], [[0, 1, 2]], "finite"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 3]], r"indices in \[0, 2\]"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0.0, 1.0, 2.0]], "whole numbers"),
        ([[0, 0, 0], [0, 0, 0], [0, 1, 0]], [[0, 1, 2]], "only degenerate"),
    ],
)
def test_bad_arrays_are_named(vertices: object, faces: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        MeshObject.from_arrays(vertices, faces)  # type: ignore[arg-type]


def test_bad_files_and_rays_are_named(tmp_path: Path) -> None:
    broken = tmp_path / "broken.stl"
    broken.write_bytes(b"\x00" * 90)
    with pytest.raises(ValueError, match=r"broken\.stl"):
        MeshObject.from_file(broken)
    with pytest.raises(FileNotFoundError):
        MeshObject.from_file(tmp_path / "none.stl")
    with pytest.raises(ValueError, match=r"points.*\(N, 3\)"):
        ball(1).closest([[0.0, 0.0]])
    with pytest.raises(ValueError, match=r"directions.*zero in row 1"):
        ball(1).ray_hits(np.zeros((2, 3)), [[0, 0, 1], [0, 0, 0]])


def test_a_collada_file_names_the_package_that_reads_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "part.dae"
    path.write_text("<COLLADA/>")
    monkeypatch.setattr("baselines.objects.mesh.find_spec", lambda name: None)
    with pytest.raises(ImportError, match=r"part\.dae.*pycollada"):
        MeshObject.from_file(path)


# --- convex pieces --------------------------------------------------------------------------------------------------


def test_an_l_shape_splits_into_convex_pieces_and_joins_again() -> None:
    bars = [
        MeshObject.from_trimesh(box((0.3, 0.1, 0.1))),
        MeshObject.from_trimesh(box((0.1, 0.3, 0.1), (-0.1, 0.1, 0))),
    ]
    shape = watertight_union(bars)
    assert shape.report.faults == () and shape.volume == pytest.approx(0.003 + 0.002, rel=1e-6)
    pieces = shape.convex_pieces()
    assert len(pieces) >= 2 and all(piece.watertight for piece in pieces)
    again = convex_pieces(shape, seed=0)
    assert all(np.array_equal(a.vertices, b.vertices) for a, b in zip(pieces, again, strict=True))
    assert watertight_union(pieces).volume == pytest.approx(shape.volume, rel=0.03)
    with pytest.raises(ValueError, match="threshold"):
        convex_pieces(shape, 0.0)
    with pytest.raises(ValueError, match="pieces"):
        watertight_union([])
