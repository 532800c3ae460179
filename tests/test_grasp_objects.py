"""Procedural objects: valid solids with the right mass properties, reproducible, and of disjoint families."""

from __future__ import annotations

import sys
from collections import Counter

import numpy as np
import pytest
import trimesh

from aerograsp_env.sim.objects import (
    TEST_FAMILIES,
    TRAIN_FAMILIES,
    VALIDATION_FAMILIES,
    GraspObject,
    build_object,
    from_mesh,
    mass_properties,
    shapes,
)
from aerograsp_env.sim.objects import test_objects as fixed_objects
from aerograsp_env.sim.objects.build import is_watertight

FAMILIES = {**TRAIN_FAMILIES, **VALIDATION_FAMILIES, **TEST_FAMILIES}
OBJECTS = {item.name: item for item in fixed_objects()}


def planes(vertices, faces):
    """(F, 3) unit normals, (F,) offsets and (F,) areas; those of sliver faces are dropped."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    double = np.linalg.norm(normals, axis=1)
    keep = double > 1e-8  # [m²]
    normals = normals[keep] / double[keep, None]
    return normals, np.einsum("ij,ij->i", normals, a[keep]), ((a + b + c) / 3.0)[keep]


def depths(piece, points):
    """How deep points lie inside a convex piece; negative outside."""
    normals, offsets, _ = planes(piece.vertices, piece.faces)
    return (offsets - points @ normals.T).min(axis=1)


def check_valid(item: GraspObject) -> None:
    assert is_watertight(item.faces)
    assert np.isfinite(item.vertices).all()
    volume = mass_properties(item.vertices, item.faces).mass
    volumes = [mass_properties(*piece).mass for piece in item.pieces]
    assert 0.0 < max(volumes) <= volume * (1 + 1e-9)
    assert volume <= sum(volumes) * (1 + 1e-9)
    for piece in item.pieces:
        assert is_watertight(piece.faces)
        assert depths(piece, piece.vertices).min() > -1e-8  # every vertex behind every face: convex, outward
    assert len(item.pieces) <= 40
    assert len(item.faces) <= 3000
    assert 0.08 <= np.ptp(item.vertices, axis=0).max() <= 0.30
    assert 0.6 <= item.mass <= 0.9
    box = item.vertices.min(axis=0), item.vertices.max(axis=0)
    assert np.all(item.center_of_mass > box[0])
    assert np.all(item.center_of_mass < box[1])


def same(one: GraspObject, other: GraspObject) -> bool:
    arrays = ("vertices", "faces", "center_of_mass", "inertia")
    return one.mass == other.mass and all(np.array_equal(getattr(one, key), getattr(other, key)) for key in arrays)


@pytest.mark.parametrize("name", OBJECTS)
def test_fixed_objects_are_valid(name):
    check_valid(OBJECTS[name])


@pytest.mark.parametrize("name", OBJECTS)
def test_the_surface_is_the_boundary_of_the_pieces(name):
    item = OBJECTS[name]
    normals, _, centers = planes(item.vertices, item.faces)
    outside = np.max([depths(piece, centers + 1e-6 * normals) for piece in item.pieces], axis=0)
    inside = np.max([depths(piece, centers - 1e-6 * normals) for piece in item.pieces], axis=0)
    assert outside.max() < 0.0
    assert inside.min() > 0.0


def test_the_fixed_set_is_hard_in_every_way():
    tags = Counter(tag for item in OBJECTS.values() for tag in item.tags)
    assert len(OBJECTS) == 15
    assert tags["concave"] >= 4
    assert tags["elongated"] >= 3
    assert tags["off-balance"] >= 3
    assert sum(not item.tags for item in OBJECTS.values()) >= 3
    assert fixed_objects() is fixed_objects()


def test_families_are_disjoint_and_say_who_they_are():
    sets = [set(TEST_FAMILIES), set(TRAIN_FAMILIES), set(VALIDATION_FAMILIES)]
    assert len(set.union(*sets)) == sum(len(names) for names in sets)
    assert len(TRAIN_FAMILIES) >= 12
    assert len(VALIDATION_FAMILIES) >= 4
    assert {item.family for item in OBJECTS.values()} <= set(TEST_FAMILIES)
    for name, family in FAMILIES.items():
        assert family(np.random.default_rng(0)).family == name


@pytest.mark.parametrize("name", FAMILIES)
def test_every_random_member_is_valid(name):
    count = 100 if name in TRAIN_FAMILIES else 30
    for seed in range(count):
        check_valid(FAMILIES[name](np.random.default_rng(seed)))


@pytest.mark.parametrize("name", FAMILIES)
def test_members_repeat_with_their_seed_and_differ_otherwise(name):
    one, again, other = (FAMILIES[name](np.random.default_rng(seed)) for seed in (5, 5, 6))
    assert same(one, again)
    assert not same(one, other)


def test_some_training_members_have_parts_of_unlike_density():
    def centroid_offset(seed):
        item = TRAIN_FAMILIES["dumbbell"](np.random.default_rng(seed))
        return np.linalg.norm(mass_properties(item.vertices, item.faces).center - item.center_of_mass)

    offsets = np.array([centroid_offset(seed) for seed in range(100)])
    assert 0.15 < (offsets > 1e-6).mean() < 0.45


def test_a_box_has_its_textbook_mass_properties():
    size, middle = np.array([0.05, 0.08, 0.12]), np.array([0.3, -0.2, 0.1])
    item = build_object("box", "box", [shapes.box(size, middle)], mass=0.8)
    squares = size**2
    np.testing.assert_allclose(item.center_of_mass, middle, atol=1e-12)
    np.testing.assert_allclose(item.inertia, np.diag(0.8 / 12.0 * (squares.sum() - squares)), atol=1e-12)


def test_a_cylinder_tends_to_its_textbook_mass_properties():
    radius, height, sides = 0.03, 0.1, 200
    item = build_object("cylinder", "cylinder", [shapes.cylinder(radius, height, sides)], mass=0.8)
    # a regular polygon's area and second moment against its circle's: 1 − 2π²/3n² and its square, to second order
    shrink = 1.0 - 2.0 * np.pi**2 / (3.0 * sides**2)
    assert mass_properties(item.vertices, item.faces).mass == pytest.approx(
        np.pi * radius**2 * height * shrink, rel=1e-6
    )
    across = 0.8 * (3.0 * radius**2 * shrink + height**2) / 12.0
    np.testing.assert_allclose(np.diag(item.inertia), [across, across, 0.4 * radius**2 * shrink], rtol=1e-6)


def test_a_dumbbell_of_two_densities_balances_where_it_should():
    blocks = [shapes.box((0.04, 0.04, 0.04), (x, 0.0, 0.0)) for x in (-0.02, 0.02)]
    item = build_object("pair", "pair", blocks, mass=0.8, densities=(3.0, 1.0))
    np.testing.assert_allclose(item.center_of_mass, [-0.01, 0.0, 0.0], atol=1e-12)
    cube = 0.8 * 0.04**2 / 6.0
    apart = 0.6 * 0.01**2 + 0.2 * 0.03**2
    np.testing.assert_allclose(item.inertia, np.diag([cube, cube + apart, cube + apart]), atol=1e-12)


def test_overlap_belongs_to_the_first_piece():
    long, short = shapes.box((0.08, 0.04, 0.04)), shapes.box((0.04, 0.04, 0.04), (0.04, 0.0, 0.0))
    item = build_object("pair", "pair", [long, short], mass=1.0, densities=(1.0, 4.0))
    # 0.08 m of density 1 around 0, and the 0.02 m of density 4 that stick out, around 0.05
    np.testing.assert_allclose(item.center_of_mass, [0.025, 0.0, 0.0], atol=1e-12)
    reverse = build_object("pair", "pair", [short, long], mass=1.0, densities=(4.0, 1.0))
    # 0.04 m of density 4 around 0.04, and 0.06 m of density 1 around −0.01
    np.testing.assert_allclose(reverse.center_of_mass, [(0.16 * 0.04 - 0.06 * 0.01) / 0.22, 0.0, 0.0], atol=1e-12)


def test_mass_properties_agree_with_trimesh():
    for item in OBJECTS.values():
        volume, center, inertia = mass_properties(item.vertices, item.faces)
        reference = trimesh.Trimesh(item.vertices, item.faces, process=False)
        assert volume == pytest.approx(reference.volume, rel=1e-9)
        np.testing.assert_allclose(center, reference.center_mass, atol=1e-9)
        np.testing.assert_allclose(inertia, reference.moment_inertia, atol=1e-6 * np.abs(inertia).max())


def test_a_closed_sweep_is_a_ring():
    count, radius, tube = 16, 0.05, 0.01
    path = shapes.arc(radius, 0.0, 2.0 * np.pi * (count - 1) / count, count)
    ring = build_object("ring", "ring", shapes.sweep(path, shapes.circle(tube, 8), closed=True))
    section = 4.0 * tube**2 * np.sin(np.pi / 4.0)  # octagon
    length = count * 2.0 * radius * np.sin(np.pi / count)
    assert mass_properties(ring.vertices, ring.faces).mass == pytest.approx(section * length, rel=1e-6)
    assert trimesh.Trimesh(ring.vertices, ring.faces, process=False).euler_number == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"densities": (1.0,)}, "densities"),
        ({"densities": (1.0, -1.0)}, "densities"),
        ({"densities": (1.0, np.nan)}, "densities"),
        ({"mass": 0.0}, "mass"),
        ({"friction": -0.1}, "friction"),
    ],
)
def test_build_refuses_bad_arguments(arguments, message):
    pieces = [shapes.box((0.04, 0.04, 0.04)), shapes.box((0.02, 0.02, 0.09))]
    with pytest.raises(ValueError, match=message):
        build_object("a", "a", pieces, **arguments)


def test_build_refuses_pieces_that_are_not_one_solid():
    with pytest.raises(ValueError, match="pieces: expected one connected solid"):
        build_object("a", "a", [shapes.box((0.04,) * 3), shapes.box((0.04,) * 3, (0.1, 0.0, 0.0))])
    with pytest.raises(ValueError, match="pieces"):
        build_object("a", "a", [])


def test_shapes_refuse_what_is_not_a_convex_solid():
    with pytest.raises(ValueError, match="span a volume"):
        shapes.hull([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)])
    with pytest.raises(ValueError, match="finite"):
        shapes.hull([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, np.nan)])
    with pytest.raises(ValueError, match="roundness"):
        shapes.ellipsoid((0.1, 0.1, 0.1), (2.5, 1.0))
    with pytest.raises(ValueError, match="inner"):
        shapes.shell([(0.1, 0.0), (0.1, 0.1)], [(0.2, 0.0)])


def a_box(**changes):
    return trimesh.creation.box((0.05, 0.08, 0.12), **changes)


def test_a_convex_mesh_comes_back_as_itself(tmp_path):
    path = tmp_path / "brick.stl"
    a_box().export(path)
    result = from_mesh(path)
    assert result.object.name == "brick"
    assert result.max_error < 1e-4
    np.testing.assert_allclose(np.ptp(result.object.vertices, axis=0), (0.05, 0.08, 0.12), atol=2e-4)
    assert result.object.mass == 0.7
    assert same(from_mesh(path).object, result.object)


def test_a_concave_mesh_stays_concave():
    staple = OBJECTS["staple"]
    mesh = trimesh.Trimesh(staple.vertices, staple.faces, process=False)
    result = from_mesh(mesh, name="u", mass=staple.mass)
    assert len(result.object.pieces) >= 3
    assert result.mean_error < 5e-4
    assert "concave" in result.object.tags
    np.testing.assert_allclose(result.object.center_of_mass, staple.center_of_mass, atol=1e-3)
    assert result.mean_error <= result.max_error


def test_from_mesh_says_what_is_wrong_with_a_mesh(tmp_path):
    box = a_box()
    nan = box.vertices.copy()
    nan[0, 0] = np.nan
    inverted = box.copy()
    inverted.invert()
    for mesh, message in [
        (trimesh.Trimesh(box.vertices, box.faces[1:], process=False), "3 open edges"),
        (inverted, "inwards"),
        (trimesh.Trimesh(), "expected triangles"),
        (trimesh.Trimesh(nan, box.faces, process=False), "1 vertices are not finite"),
        (box.copy().apply_scale(1000.0), r"millimetres, pass scale=0\.001"),
    ]:
        with pytest.raises(ValueError, match=message):
            from_mesh(mesh)
    with pytest.raises(ValueError, match="scale"):
        from_mesh(box, scale=0.0)
    with pytest.raises(FileNotFoundError, match="none"):
        from_mesh(tmp_path / "none.stl")
    (tmp_path / "bad.stl").write_bytes(b"not a mesh")
    with pytest.raises(ValueError, match="mesh"):
        from_mesh(tmp_path / "bad.stl")


def test_scale_turns_millimetres_into_metres():
    result = from_mesh(a_box().apply_scale(1000.0), scale=0.001)
    np.testing.assert_allclose(np.ptp(result.object.vertices, axis=0), (0.05, 0.08, 0.12), atol=2e-4)


def test_without_coacd_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "coacd", None)
    with pytest.raises(ImportError, match="coacd"):
        from_mesh(a_box())
