"""Objects to look at: closed surfaces, frames, symmetries that are true, and errors that say what was expected."""

from __future__ import annotations

import igl
import numpy as np
import pytest
from scipy.spatial.distance import pdist

from aerograsp_env.sim.objects.build import is_watertight
from aerograsp_env.sim.visual import CLASSES, looks, solids
from aerograsp_env.sim.visual.distractors import distractor
from aerograsp_env.sim.visual.mesh_files import object_from_mesh
from aerograsp_env.sim.visual.objects import (
    Part,
    VisualObject,
    nominal_object,
    only,
    random_object,
    recolored,
    times,
    turns,
)
from aerograsp_env.sim.visual.textures import GROUNDS, TEXTURES, texture_image

TOLERANCE = {"screwdriver": 5e-3}  # [m] flutes and blade; others: quads that are not flat


def samples(label: str, count: int = 3) -> list[VisualObject]:
    rng = np.random.default_rng(CLASSES.index(label))
    return [nominal_object(label), *(random_object(label, rng) for _ in range(count))]


def distance(points: np.ndarray, item: VisualObject) -> np.ndarray:
    squared, *_ = igl.point_mesh_squared_distance(points, item.vertices, item.faces.astype(np.int64))
    return np.sqrt(squared)


@pytest.mark.parametrize("label", CLASSES)
def test_parts_are_watertight_and_outward(label: str) -> None:
    for item in samples(label, 6):
        assert item.label == label
        for part in item.parts:
            assert is_watertight(part.faces)
            assert solids.signed_volume(part.vertices, part.faces) > 0.0
        assert len(item.faces) < 3000


def test_distractors_are_watertight_too() -> None:
    rng = np.random.default_rng(0)
    for _ in range(80):
        for part in distractor(rng).parts:
            assert is_watertight(part.faces)
            assert solids.signed_volume(part.vertices, part.faces) > 0.0


@pytest.mark.parametrize("label", CLASSES)
def test_symmetries_map_the_surface_onto_itself(label: str) -> None:
    rng = np.random.default_rng(1)
    for item in samples(label, 4):
        points, _, _ = item.surface(300, rng)
        for R in item.symmetries:
            assert distance(points @ R.T, item).max() < TOLERANCE.get(label, 3e-4)


@pytest.mark.parametrize("label", CLASSES)
def test_symmetries_are_a_group(label: str) -> None:
    R = nominal_object(label).symmetries
    products = (R[:, None] @ R[None]).reshape(-1, 9)
    gap = np.abs(products[:, None] - R.reshape(1, -1, 9)).max(axis=2).min(axis=1)
    assert gap.max() < 1e-9


def test_counts_of_symmetries() -> None:
    expected = {"screwdriver": 36, "pliers": 2, "hammer": 1, "can": 72, "box": 4, "crawler": 3, "juice_box": 1}
    assert {label: len(nominal_object(label).symmetries) for label in expected} == expected
    assert len(times(turns(2, 4), turns(0, 2))) == 8


@pytest.mark.parametrize("label", [name for name in CLASSES if name != "crawler"])
def test_origin_is_the_middle_of_the_bounding_box(label: str) -> None:
    for item in samples(label):
        middle = 0.5 * (item.vertices.min(axis=0) + item.vertices.max(axis=0))
        assert np.abs(middle).max() < TOLERANCE.get(label, 1e-6)


def test_axes_of_the_tools() -> None:
    for item in samples("screwdriver"):
        assert item.extent.argmax() == 0
        radius = np.linalg.norm(item.vertices[:, 1:], axis=1)
        x, half = item.vertices[:, 0], 0.5 * item.extent[0]
        assert radius[x > 0.95 * half].max() < 0.6 * radius[x < 0.0].max()  # the tip, and the grip
    for item in samples("hammer"):
        x, y = item.vertices[:, 0], item.vertices[:, 1]
        assert item.extent.argmax() == 0
        assert np.ptp(y[x > x.max() - 0.04]) > 2.0 * np.ptp(y[x < 0.0])  # the head
    claw = nominal_object("hammer").vertices
    assert claw[claw[:, 1].argmax(), 0] > claw[claw[:, 1].argmin(), 0] + 0.01  # claws bend back to the handle, at −y
    for label in ("wrench", "pliers"):
        for item in samples(label):
            assert item.extent.argmax() == 0
            assert item.extent.argmin() == 2
    jaws = nominal_object("pliers").vertices
    assert np.ptp(jaws[jaws[:, 0] > 0.06, 1]) < np.ptp(jaws[jaws[:, 0] < -0.06, 1])


def test_boxes_are_ordered_by_their_sides() -> None:
    for item in samples("box", 10):
        x, y, z = item.extent
        assert x > y > z


def test_diameter_is_the_largest_distance() -> None:
    for label in ("box", "juice_box"):
        item = nominal_object(label)
        assert item.diameter == pytest.approx(pdist(item.vertices).max(), abs=1e-9)


@pytest.mark.parametrize("label", ["screwdriver", "hammer", "crawler"])
def test_surface_points_lie_outside_on_the_surface(label: str) -> None:
    item = nominal_object(label)
    points, normals, colors = item.surface(500, np.random.default_rng(2))
    assert points.shape == normals.shape == colors.shape == (500, 3)
    assert colors.dtype == np.uint8
    assert np.abs(np.linalg.norm(normals, axis=1) - 1.0).max() < 1e-9
    assert distance(points, item).max() < 1e-9
    winding = np.max(
        [igl.fast_winding_number(p.vertices, p.faces.astype(np.int64), points + 1e-4 * normals) for p in item.parts],
        axis=0,
    )
    assert (winding < 0.5).mean() > 0.97  # but for points closer than 0.1 mm to an inner corner


def test_shading_keeps_sharp_edges_and_smooths_round_ones() -> None:
    cube = solids.box((0.1, 0.1, 0.1))
    drawn = solids.shaded(cube.vertices, cube.faces)
    assert np.allclose(drawn.vertices[drawn.faces], cube.vertices[cube.faces])
    assert np.allclose(np.abs(drawn.normals).max(axis=1), 1.0)  # each along an axis: faces are flat
    ball = solids.lathe([(-np.cos(a), np.sin(a)) for a in np.linspace(0.0, np.pi, 25)], sides=36)
    drawn = solids.shaded(ball.vertices, ball.faces)
    assert np.einsum("ij,ij->i", drawn.normals, drawn.vertices).min() > 0.995
    tin = solids.lathe([(-0.1, 0.05), (0.1, 0.05)], sides=36)
    drawn = solids.shaded(tin.vertices, tin.faces)
    along = np.abs(drawn.normals[:, 0])
    assert ((along < 1e-6) | (along > 1.0 - 1e-6)).all()  # wall or lid, never between


def test_nominal_is_one_object_and_random_follows_the_generator() -> None:
    assert nominal_object("hammer") is nominal_object("hammer")
    one, same = (random_object("pliers", np.random.default_rng(5)) for _ in range(2))
    assert np.array_equal(one.vertices, same.vertices)
    assert one.parts[0].look == same.parts[0].look
    other = random_object("pliers", np.random.default_rng(6))
    assert other.vertices.shape != one.vertices.shape or not np.allclose(other.vertices, one.vertices)


def test_the_crawler_has_one_shape() -> None:
    one, other = nominal_object("crawler"), random_object("crawler", np.random.default_rng(0))
    assert np.array_equal(one.vertices, other.vertices)
    assert one.parts[2].look.rgb != other.parts[2].look.rgb


def test_without_colors_looks_are_nominal() -> None:
    item = random_object("screwdriver", np.random.default_rng(3), colors=False)
    known = {looks.STEEL, looks.BLACK, looks.RUBBER, looks.WOOD, nominal_object("screwdriver").parts[0].look}
    assert {part.look for part in item.parts} <= known


def test_another_look_keeps_the_shape_and_what_looked_alike() -> None:
    item = nominal_object("pliers")
    steady = item.steady
    new = recolored(item, np.random.default_rng(0))
    assert new.vertices is item.vertices
    assert new.steady is steady
    pairs = {(old.look, part.look) for old, part in zip(item.parts, new.parts, strict=True)}
    assert len(pairs) == len({old for old, _ in pairs})
    assert all(old.material == look.material for old, look in pairs)


def test_steady_facets_of_a_box() -> None:
    normals, weights = nominal_object("box").steady
    assert np.allclose(np.abs(normals).max(axis=1), 1.0)
    assert weights.sum() == pytest.approx(1.0)
    share = [weights[np.abs(normals[:, axis]) > 0.5].sum() for axis in range(3)]
    x, y, z = nominal_object("box").extent
    faces = np.array([y * z, x * z, x * y])
    assert np.allclose(share, faces / faces.sum(), rtol=0.05)


@pytest.mark.parametrize("name", TEXTURES)
def test_textures(name: str) -> None:
    image = texture_image(name, (0.5, 0.3, 0.2), 7, 32)
    assert image.shape == (32, 32, 3)
    assert image.dtype == np.uint8
    assert np.array_equal(image, texture_image(name, (0.5, 0.3, 0.2), 7, 32))
    assert any(not np.array_equal(image, texture_image(name, (0.5, 0.3, 0.2), seed, 32)) for seed in (8, 9, 10))


def test_bad_input() -> None:
    assert set(GROUNDS) <= set(TEXTURES)
    with pytest.raises(ValueError, match="label: expected one of screwdriver"):
        nominal_object("drill")
    with pytest.raises(ValueError, match="label: expected one of"):
        random_object("", np.random.default_rng(0))
    with pytest.raises(ValueError, match="texture: expected one of cloud"):
        texture_image("marble", (1.0, 1.0, 1.0), 0)
    with pytest.raises(ValueError, match="count: expected at least 1"):
        nominal_object("box").surface(0, np.random.default_rng(0))
    with pytest.raises(ValueError, match="at least one face"):
        solids.outward(np.zeros((3, 3)), np.empty((0, 3), int))
    with pytest.raises(ValueError, match="encloses none"):
        solids.outward(np.zeros((3, 3)), np.array([[0, 1, 2]]))
    part = nominal_object("box").parts[0]
    with pytest.raises(ValueError, match="parts"):
        VisualObject("box", (), only())
    with pytest.raises(ValueError, match="some empty"):
        VisualObject("box", (Part(part.vertices, part.faces[:0], part.look),), only())
    with pytest.raises(ValueError, match="finite"):
        VisualObject("box", (part._replace(vertices=part.vertices * np.nan),), only())
    with pytest.raises(ValueError, match="identity first"):
        VisualObject("box", (part,), -only())
    with pytest.raises(ValueError, match="proper rotations"):
        VisualObject("box", (part,), np.stack([np.eye(3), np.diag([1.0, 1.0, -1.0])]))


def test_mesh_files(tmp_path) -> None:
    solid = solids.box((0.1, 0.2, 0.3), (1.0, 0.0, 0.0))
    text = "".join("v {:.6f} {:.6f} {:.6f}\n".format(*v) for v in solid.vertices)
    text += "".join("f {} {} {}\n".format(*(f[::-1] + 1)) for f in solid.faces)  # inside out
    folder = tmp_path / "003_cracker_box"
    (folder / "google_16k").mkdir(parents=True)
    (folder / "google_16k" / "textured.obj").write_text(text)
    for path in (folder, folder / "google_16k" / "textured.obj"):
        item = object_from_mesh(path, "box")
        assert np.allclose(item.extent, (0.1, 0.2, 0.3))
        assert np.allclose(item.vertices.max(axis=0), 0.5 * item.extent)
        assert solids.signed_volume(item.vertices, item.faces) == pytest.approx(0.006)
    assert np.allclose(object_from_mesh(folder, "box", scale=0.5).extent, (0.05, 0.1, 0.15))

    with pytest.raises(ValueError, match="label: expected one of"):
        object_from_mesh(folder, "cracker")
    with pytest.raises(FileNotFoundError, match="no file or folder"):
        object_from_mesh(tmp_path / "none.obj", "box")
    with pytest.raises(FileNotFoundError, match="google_16k"):
        object_from_mesh(tmp_path, "box")
    bad = tmp_path / "bad.obj"
    for content, said in (
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\n", r"bad\.obj"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", r"bad\.obj: expected a body"),
        ("v 0 0 0\nv 1000 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n", r"bad\.obj: 1000 m across"),
    ):
        bad.write_text(content)
        with pytest.raises(ValueError, match=said):
            object_from_mesh(bad, "box")
    with pytest.raises(ValueError, match="scale: expected a positive factor"):
        object_from_mesh(folder, "box", scale=0.0)
