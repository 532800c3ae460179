"""Candidate grasps on meshes, clouds and implicit surfaces, where the right ones are known."""

import time

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from aerograsp_env.sim.grasp_judge import judge_grasp
from aerograsp_env.sim.gripper import GripperConfig
from aerograsp_env.sim.objects.families import test_objects as everyday_objects
from baselines.grasping import (
    GraspCandidates,
    closing_angles,
    evaluate_candidates,
    grasps_on_cloud,
    grasps_on_gpis,
    grasps_on_mesh,
    line_distance,
    probability_of_force_closure,
)
from baselines.grasping.candidates import Pairs
from baselines.grasping.clearance import mesh_collisions, swept_boxes
from baselines.grasping.gpis_contacts import closing_probability, descend
from baselines.grasping.on_mesh import opposed_pairs
from baselines.objects import GPIS, Constant, Ellipsoid, Sphere, SquaredExponential
from baselines.objects.mesh import MeshObject

GRIPPER = GripperConfig()
BOX = trimesh.creation.box((0.04, 0.2, 0.06))


def solid(*boxes):
    """The union of boxes (lower, upper)."""
    parts = [trimesh.creation.box(bounds=bounds) for bounds in boxes]
    return trimesh.boolean.union(parts, engine="manifold") if len(parts) > 1 else parts[0]


def u_shape():
    """A U, 130 mm across: arms of 30 mm, 70 mm apart, on a base too thick to hold."""
    return solid(
        ((-0.065, -0.06, -0.11), (0.065, 0.06, 0.0)),
        ((-0.065, -0.06, -0.01), (-0.035, 0.06, 0.08)),
        ((0.035, -0.06, -0.01), (0.065, 0.06, 0.08)),
    )


def comb(teeth):
    """Teeth of 10 mm at 30 mm, standing on a base."""
    base = ((0.0, 0.0, -0.03), (0.03 * teeth, 0.02, 0.0))
    return solid(base, *(((0.03 * i, 0.0, -0.01), (0.03 * i + 0.01, 0.02, 0.05)) for i in range(teeth)))


def sphere_points(count, radius=0.03, seed=0):
    normals = np.random.default_rng(seed).standard_normal((count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return radius * normals, normals


def sphere_process(count=150, radius=0.03, prior=None, **kwargs):
    points, normals = sphere_points(count, radius, **kwargs)
    model = GPIS(SquaredExponential(0.03, 1e-4), prior or Sphere(radius), noise=5e-4, normal_noise=0.05)
    return model.fit(points, normals)


def check(candidates, friction=0.7):
    """What holds of all candidates."""
    g = candidates
    assert np.allclose(np.linalg.norm(g.closing_axes, axis=1), 1.0) and np.allclose(
        np.linalg.norm(g.approach_axes, axis=1), 1.0
    )
    assert np.abs(np.einsum("gi,gi->g", g.closing_axes, g.approach_axes)).max(initial=0.0) < 1e-9
    line = g.positions[:, 1] - g.positions[:, 0]
    assert np.allclose(g.centers, g.positions.mean(axis=1))
    assert np.allclose(line, g.contact_widths[:, None] * g.closing_axes)
    assert (g.widths >= g.contact_widths + 0.004 - 1e-12).all() and (g.widths <= GRIPPER.max_width).all()
    assert (closing_angles(g.positions, g.normals) < np.arctan(friction)).all()
    assert (np.diff(g.score) <= 1e-9).all()
    assert len(g.grasps()) == len(g)


# --- mesh -------------------------------------------------------------------------------------------------------------


def test_a_box_is_held_across_its_narrow_sides():
    found = grasps_on_mesh(BOX, pattern="straight", n_rays=300)
    check(found)
    axes = np.abs(found.closing_axes)
    assert np.allclose(axes.max(axis=1), 1.0)
    assert set(axes.argmax(axis=1).tolist()) == {0, 2} and found.reasons["too wide"] == 100
    assert np.allclose(found.score, np.arctan(0.7))
    assert np.allclose(found.widths[axes.argmax(axis=1) == 0], 0.04 + 0.016)
    arms = line_distance(found.positions, (0.0, 0.0, 0.0))
    assert (np.diff(arms) > -1e-8).all()  # equal scores: nearest to the centre of mass first
    oblique = grasps_on_mesh(BOX, pattern="oblique")
    check(oblique)
    assert (np.abs(oblique.closing_axes[:, 1]) < np.sin(np.arctan(0.7))).all()


def test_a_sphere_is_held_through_its_centre():
    found = grasps_on_mesh(trimesh.creation.icosphere(subdivisions=5, radius=0.03), friction=0.3, n_rays=2000)
    check(found, 0.3)
    # A line through both cones passes the centre by no more than r sin(atan μ).
    arms = line_distance(found.positions, (0.0, 0.0, 0.0))
    assert len(found) > 300 and arms.max() < 1.02 * 0.03 * np.sin(np.arctan(0.3))
    margin = np.arctan(0.3) - np.arcsin(arms / 0.03)
    assert np.abs(margin - found.score).max() < 0.03  # faceted
    assert arms[:20].max() < 0.003


def test_folds_of_a_torus():
    mesh = MeshObject.from_trimesh(trimesh.creation.torus(0.04, 0.01))
    origins = np.array([[-1.0, 0.001, 0.002], [0.0407, -1.0, 0.002], [0.0401, 0.003, -1.0]])
    directions = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    for row, folds in enumerate((2, 1, 1)):
        pairs, crossed = opposed_pairs(mesh, origins[row : row + 1], directions[row : row + 1])
        assert crossed == folds and len(pairs.positions) == folds * (folds + 1) // 2
    outer, _ = opposed_pairs(mesh, origins[:1], directions[:1], inner=False)
    assert np.allclose(np.linalg.norm(outer.positions[0, 1] - outer.positions[0, 0]), 0.1, atol=1e-3)
    assert (outer.normals[0, :, 0] * [1, -1] > 0.95).all()


@pytest.mark.parametrize("teeth", [1, 2, 3, 5])
def test_a_comb_of_k_teeth_has_k_times_k_plus_one_halves_pairs(teeth):
    mesh = MeshObject.from_trimesh(comb(teeth))
    origin, along = np.array([[-1.0, 0.011, 0.031]]), np.array([[2.0, 0.0, 0.0]])  # directions need not be unit
    pairs, folds = opposed_pairs(mesh, origin, along)
    assert folds == teeth and len(pairs.positions) == teeth * (teeth + 1) // 2
    expected = sorted((0.03 * i, 0.03 * j + 0.01) for i in range(teeth) for j in range(i, teeth))
    assert np.allclose(sorted(map(tuple, pairs.positions[:, :, 0])), expected)
    assert np.allclose(pairs.normals, [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
    outer, _ = opposed_pairs(mesh, origin, along, inner=False)
    assert np.allclose(outer.positions[:, :, 0], [[0.0, 0.03 * teeth - 0.02]])
    counted = grasps_on_mesh(mesh, n_rays=90, pattern="straight").counts
    assert counted["pairs"] >= counted["folds"]


def test_surfaces_inside_of_another_part_are_no_contacts():
    first, second = (
        trimesh.creation.box((0.04, 0.04, 0.04), trimesh.transformations.translation_matrix((x, 0, 0)))
        for x in (0, 0.03)
    )
    mesh = MeshObject.from_trimesh(trimesh.util.concatenate([first, second]))
    pairs, folds = opposed_pairs(mesh, np.array([[-1.0, 0.003, 0.005]]), np.array([[1.0, 0.0, 0.0]]))
    assert folds == 1 and np.allclose(pairs.positions[0, :, 0], (-0.02, 0.05))


def test_a_wide_u_is_held_by_its_arms_only():
    mesh = u_shape()
    outer = grasps_on_mesh(mesh, inner=False, pattern="straight", n_rays=600)
    inner = grasps_on_mesh(mesh, pattern="straight", n_rays=600)
    check(inner)
    assert len(outer) == 0 and outer.reasons["too wide"] == outer.counts["pairs"] > 500
    assert len(inner) > 50
    assert np.allclose(inner.contact_widths, 0.03) and np.allclose(np.abs(inner.closing_axes[:, 0]), 1.0)
    assert (np.abs(np.abs(inner.centers[:, 0]) - 0.05) < 1e-6).all() and (inner.centers[:, 2] > 0.0).all()
    # The inner finger, 11 mm with its pad and 4 mm of room at the least, has to fit between the arms.
    narrow = solid(
        ((-0.065, -0.06, -0.11), (0.065, 0.06, 0.0)),
        ((-0.065, -0.06, -0.01), (-0.006, 0.06, 0.08)),
        ((0.006, -0.06, -0.01), (0.065, 0.06, 0.08)),
    )
    none = grasps_on_mesh(narrow, pattern="straight", n_rays=600)
    assert len(none) == 0 and none.reasons["no clearance"] > 0


def test_an_object_wider_than_the_jaws_says_so():
    found = grasps_on_mesh(trimesh.creation.box((0.2, 0.2, 0.2)), n_rays=100, pattern="straight")
    assert len(found) == 0 and dict(found.reasons) == {"too wide": 100} and "100 too wide" in repr(found)
    assert found.grasps() == [] and len(found.top(3)) == 0
    thin = grasps_on_mesh(trimesh.creation.box((0.2, 0.2, 0.0005)), n_rays=99, pattern="straight")
    assert thin.reasons["too thin"] == 33


def test_the_palm_keeps_its_distance():
    # A plate 150 mm square: the palm, 60 mm behind the pads, can only come from its rim.
    found = grasps_on_mesh(trimesh.creation.box((0.15, 0.15, 0.02)), n_rays=900, pattern="straight")
    check(found)
    assert found.reasons["palm collision"] > 0
    assert (np.abs(found.centers[:, :2]).max(axis=1) > 0.075 - 0.0606).all()


def test_pairs_move_with_the_mesh():
    mesh = MeshObject.from_trimesh(trimesh.creation.torus(0.04, 0.012))
    rng = np.random.default_rng(3)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.random(rng=rng).as_matrix(), (0.3, 0.2, -0.1)
    directions = rng.standard_normal((200, 3))
    origins = rng.uniform(-0.05, 0.05, (200, 3)) - directions
    here, folds = opposed_pairs(mesh, origins, directions)
    there, again = opposed_pairs(mesh.transform(T), origins @ T[:3, :3].T + T[:3, 3], directions @ T[:3, :3].T)
    assert folds == again
    assert np.allclose(here.positions @ T[:3, :3].T + T[:3, 3], there.positions, atol=1e-9)
    assert np.allclose(here.normals @ T[:3, :3].T, there.normals, atol=1e-9)


def test_inputs_of_every_kind_give_the_same():
    kinds = (BOX, MeshObject.from_trimesh(BOX), (BOX.vertices, BOX.faces))
    first, *others = (grasps_on_mesh(kind, n_rays=60) for kind in kinds)
    assert all(np.allclose(first.centers, other.centers) for other in others)
    assert np.array_equal(grasps_on_mesh(BOX, n_rays=60, rng=np.random.default_rng(0)).centers, first.centers)


@pytest.mark.parametrize(
    ("mesh", "message"),
    [
        (trimesh.Trimesh(BOX.vertices, BOX.faces[1:], process=False), "watertight"),
        (trimesh.Trimesh(BOX.vertices, BOX.faces[:, ::-1], process=False), "inverted"),
        (trimesh.Trimesh(1000 * BOX.vertices, BOX.faces, process=False), "millimetres"),
        (([], []), "at least one face"),
        ("cup.obj", "got str"),
    ],
)
def test_meshes_that_cannot_be_held_are_refused(mesh, message):
    with pytest.raises(ValueError, match=message):
        grasps_on_mesh(mesh)


@pytest.mark.parametrize(
    ("argument", "value"),
    [
        ("n_rays", 0),
        ("friction", 0.0),
        ("friction", np.nan),
        ("approaches", 0),
        ("clearance", 0.0),
        ("pattern", "round"),
        ("gripper", 0.1),
    ],
)
def test_arguments_out_of_range_are_named(argument, value):
    with pytest.raises(ValueError, match=argument):
        grasps_on_mesh(BOX, **{argument: value})


def test_physics_agrees_that_there_is_room():
    item = next(item for item in everyday_objects() if item.name == "drill")
    found = grasps_on_mesh(item, n_rays=200)
    near = found.order(-line_distance(found.positions, item.center_of_mass))
    trials = [*near.top(2).grasps(), *found.take(np.linspace(0, len(found) - 1, 6).astype(int)).grasps()]
    outcomes = [judge_grasp(item, grasp, np.eye(4)).outcome for grasp in trials]
    assert outcomes[:2] == ["held", "held"] and not {"collision", "missed", "too wide"} & set(outcomes)


# --- the result -------------------------------------------------------------------------------------------------------


def test_candidates_are_checked_and_ordered():
    found = grasps_on_mesh(BOX, n_rays=100)
    arms = -line_distance(found.positions, (0.0, 0.05, 0.0))
    ordered = found.order(arms)
    assert np.allclose(ordered.score, np.sort(arms)[::-1]) and len(ordered.top(5)) == 5
    assert np.allclose(ordered.grasps()[0].center, found.centers[arms.argmax()])
    assert ordered.reasons == found.reasons
    with pytest.raises(ValueError, match="score"):
        found.order(arms[:-1])
    with pytest.raises(ValueError, match="n: expected"):
        found.top(-1)
    fields = {
        name: getattr(found, name)
        for name in ("centers", "closing_axes", "approach_axes", "positions", "normals", "score")
    }
    with pytest.raises(ValueError, match="widths"):
        GraspCandidates(**fields, widths=found.widths[1:], score_error=found.score_error)
    with pytest.raises(ValueError, match="read-only"):
        found.widths[0] = 0.0


def test_the_table_of_metrics():
    found = grasps_on_mesh(BOX, n_rays=40).top(60)
    table = evaluate_candidates(found, (0.0, 0.0, 0.0), friction=0.7, torsion=0.003)
    assert all(column.shape == (len(found),) and np.isfinite(column).all() for column in table.values())
    assert (table["force_closure"] == 1.0).all() and (table["lmrw_sum"] > 0.0).all()
    # Each contact up to one, against both together up to one: twice the wrench at the most.
    assert (table["lmrw_independent"] >= table["lmrw_sum"] - 1e-12).all()
    assert (table["lmrw_independent"] <= 2.0 * table["lmrw_sum"] + 1e-9).all()
    assert np.allclose(table["antipodal_margin"], found.score)
    assert np.allclose(table["line_distance"], line_distance(found.positions, (0.0, 0.0, 0.0)))
    alone = evaluate_candidates(found.take([7]), (0.0, 0.0, 0.0), friction=0.7, torsion=0.003)
    assert all(alone[name][0] == column[7] for name, column in table.items())
    hard = evaluate_candidates(found.top(3), (0.0, 0.0, 0.0), friction=0.7, torsion=0.0)
    assert not hard["force_closure"].any() and not hard["lmrw_sum"].any()
    empty = evaluate_candidates(found.top(0), (0.0, 0.0, 0.0))
    assert set(empty) == set(table) and all(column.shape == (0,) for column in empty.values())


# --- cloud ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("known", [True, False], ids=["normals", "no normals"])
def test_a_complete_cloud_gives_what_the_mesh_gives(known):
    mesh = MeshObject.from_trimesh(BOX)
    seen = mesh.sample(3000, np.random.default_rng(0))
    found = grasps_on_cloud(seen.points, seen.normals if known else None, pattern="straight", n_rays=600)
    check(found)
    assert len(found) > 300
    off = np.abs(mesh.signed_distance(found.positions.reshape(-1, 3)))
    assert np.median(off) < 1e-6 and (np.abs(found.closing_axes[:, 1]) < 1e-9).all()
    assert found.counts["pairs"] > 300 and found.reasons["too wide"] > 50


def test_a_cloud_of_a_sphere():
    points, normals = sphere_points(2000)
    found = grasps_on_cloud(points, normals, friction=0.3)
    check(found, 0.3)
    assert len(found) > 200
    assert np.abs(np.linalg.norm(found.positions, axis=2) - 0.03).max() < 5e-4
    cosine = np.einsum("gki,gki->gk", found.normals, -found.positions / 0.03)
    assert np.quantile(cosine, 0.05) > np.cos(0.1)


def test_a_cloud_whose_points_are_all_repeated_is_spaced_like_its_places():
    points, normals = sphere_points(800)
    once, twice = (
        grasps_on_cloud(np.tile(points, (n, 1)), np.tile(normals, (n, 1)), n_rays=200, approaches=2) for n in (1, 2)
    )
    assert len(once) > 20
    np.testing.assert_allclose(twice.positions, once.positions, atol=1e-9)


def test_a_plate_thinner_than_a_voxel_has_two_sides():
    mesh = MeshObject.from_trimesh(trimesh.creation.box((0.06, 0.06, 0.004)))
    seen = mesh.sample(2000, np.random.default_rng(0))
    found = grasps_on_cloud(seen.points, seen.normals, voxel=0.01, pattern="straight", n_rays=300)
    check(found)
    across = found.take(np.abs(found.closing_axes[:, 2]) > 0.99)
    assert len(across) > 20 and np.median(across.contact_widths) == pytest.approx(0.004, abs=1e-9)


def test_one_view_of_a_box_has_no_opposite_side():
    mesh = MeshObject.from_trimesh(BOX)
    seen = mesh.sample(3000, np.random.default_rng(0))
    front = seen.points[seen.normals[:, 0] > 0.5]
    found = grasps_on_cloud(front, viewpoint=(0.5, 0.0, 0.0))
    assert len(found) == 0 and found.reasons["ray saw no opposite side"] > 100


def test_the_cloud_is_in_the_grippers_way():
    points, normals = sphere_points(1500, 0.02)
    wall = np.random.default_rng(1).uniform((-0.1, -0.1, -0.03), (0.1, 0.1, -0.028), (3000, 3))
    alone = grasps_on_cloud(points, normals, voxel=0.004)
    beside = grasps_on_cloud(
        np.concatenate([points, wall]), np.concatenate([normals, np.tile((0.0, 0.0, 1.0), (3000, 1))]), voxel=0.004
    )
    assert (alone.approach_axes[:, 2] > 0.5).any() and not (
        beside.approach_axes[:, 2] > 0.5
    ).any()  # from below, through it
    assert (beside.approach_axes[:, 2] < -0.5).any()


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.empty((0, 3)), "points: expected at least 10 distinct ones, got 0"),
        (np.tile(sphere_points(9)[0], (50, 1)), "expected at least 10 distinct ones, got 9 among 450"),
        (np.tile(sphere_points(100)[0], (30, 1)), "a surface to estimate normals on, got one at 0 points only"),
        (np.full((20, 3), np.nan), "points: expected finite"),
        (np.outer(np.linspace(0, 1, 30), (1.0, 2.0, 3.0)), "points: expected points that spread"),
        (np.zeros((20, 3)), "at least 10 distinct ones, got 1 among 20"),
        (np.zeros((20, 2)), r"points: expected shape \(N, 3\)"),
    ],
)
def test_clouds_without_a_surface_are_refused(points, message):
    with pytest.raises(ValueError, match=message):
        grasps_on_cloud(points)


def test_normals_of_clouds_are_checked():
    points, normals = sphere_points(100)
    for wrong in (0.0 * normals, 2.0 * normals, normals[:-1], np.nan * normals):
        with pytest.raises(ValueError, match="normals"):
            grasps_on_cloud(points, wrong)
    with pytest.raises(ValueError, match="voxel"):
        grasps_on_cloud(points, normals, voxel=1e-6)
    with pytest.raises(ValueError, match="viewpoint"):
        grasps_on_cloud(points, viewpoint=(0.0, 1.0))


# --- implicit surface -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("prior", [Sphere(0.028), Constant(0.03)], ids=["sphere", "constant"])
def test_contacts_on_an_implicit_sphere(prior):
    found = grasps_on_gpis(sphere_process(prior=prior))
    check(found)
    assert len(found) > 1000 and found.counts["converged"] > 190
    assert np.abs(np.linalg.norm(found.positions, axis=2) - 0.03).max() < 1e-3
    across = np.einsum("gi,gi->g", found.normals[:, 0], found.normals[:, 1])
    assert across.max() < -np.cos(0.1)
    assert np.abs(np.einsum("gi,gi->g", found.normals[:, 0], found.closing_axes) - 1.0).max() < 1e-9
    assert (found.score >= 0.0).all() and (found.score <= 1.0).all() and (found.score_error > 0.0).all()


def test_what_was_seen_is_surer_than_what_was_not():
    points, normals = sphere_points(400)
    front = points[:, 0] > 0.0
    model = GPIS(SquaredExponential(0.015, 1e-4), Sphere(0.03), noise=5e-4, normal_noise=0.05)
    found = grasps_on_gpis(model.fit(points[front], normals[front]), friction=0.4, samples=400)
    back = found.positions[..., 0].min(axis=1)
    assert found.score[back > -0.005].mean() > found.score[back < -0.02].mean() + 0.1
    assert found.score[0] > 0.95


def test_the_probability_is_that_of_the_samples():
    model = sphere_process(30)
    u = sphere_points(5, 1.0, seed=3)[1]
    pairs = Pairs(0.03 * np.stack([u, -u], axis=1), np.stack([-u, u], axis=1))
    gradients = model.predict(pairs.positions.reshape(-1, 3), gradient=True).gradient.reshape(-1, 2, 3)
    for friction in (0.1, 0.4):
        p, error = closing_probability(model, pairs, gradients, friction, 4000, np.random.default_rng(0))
        covariance = model.covariance(pairs.positions, gradients=True)
        for k in range(5):  # written again, one pair at a time
            drawn = np.random.default_rng(1 + k).multivariate_normal(np.zeros(8), covariance[k], 4000)
            slope = gradients[k] + drawn[:, 2:].reshape(-1, 2, 3)
            steep = np.linalg.norm(gradients[k], axis=1)
            at = pairs.positions[k] - (drawn[:, :2] / steep)[..., None] * gradients[k] / steep[:, None]
            normals = -slope / np.linalg.norm(slope, axis=2, keepdims=True)
            alone = probability_of_force_closure(at, normals, friction, torsion=0.003)
            assert abs(alone.probability - p[k]) < 5.0 * (error[k] + alone.standard_error)
    assert (p > 0.5).all()


def test_probability_grows_with_friction_and_with_data():
    few, many = sphere_process(25, seed=1), sphere_process(200, seed=1)
    mean = [grasps_on_gpis(model, friction=mu).score.mean() for model, mu in ((few, 0.2), (few, 0.5), (many, 0.2))]
    assert mean[0] < mean[1] and mean[0] < mean[2]


def test_points_without_normals_will_do():
    points, _ = sphere_points(80)
    model = GPIS(SquaredExponential(0.03, 1e-4), Sphere(0.027), noise=5e-4).fit(points)
    found = grasps_on_gpis(model, n_starts=50)
    check(found)
    assert len(found) > 200 and np.abs(np.linalg.norm(found.positions, axis=2) - 0.03).max() < 1e-3


def test_equal_seeds_give_equal_grasps():
    model = sphere_process(60)
    first, again, other = (grasps_on_gpis(model, n_starts=30, rng=seed) for seed in (3, np.random.default_rng(3), 4))
    assert np.array_equal(first.positions, again.positions) and np.array_equal(first.score, again.score)
    assert not np.array_equal(first.positions, other.positions)


def test_the_mean_surface_is_in_the_grippers_way():
    # Seen from above only, an upright rod: the gripper must not come through what the model fills in below.
    points, normals = sphere_points(600, 0.02)
    points[:, 2] *= 3.0
    normals[:, 2] /= 3.0
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    top = points[:, 2] > 0.0
    model = GPIS(SquaredExponential(0.03, 1e-4), Ellipsoid((0.02, 0.02, 0.06)), noise=5e-4, normal_noise=0.05)
    found = grasps_on_gpis(model.fit(points[top], normals[top]))
    check(found)
    rod = trimesh.creation.icosphere(subdivisions=4, radius=0.02)
    rod.apply_scale((1.0, 1.0, 3.0))
    rotations = np.stack(
        [found.closing_axes, np.cross(found.approach_axes, found.closing_axes), found.approach_axes], axis=2
    )
    boxes = swept_boxes(GRIPPER, found.widths, found.contact_widths)
    inside = mesh_collisions(MeshObject.from_trimesh(rod), rotations, found.centers, boxes) >= 0
    assert len(found) > 100 and inside.mean() < 0.02 and found.reasons["palm collision"] > 0


def test_descents_report_what_did_not_arrive():
    flat = GPIS(SquaredExponential(0.005, 1e-4), Constant(1.0)).fit(sphere_points(30)[0])  # the mean is far above 0
    found = grasps_on_gpis(flat, n_starts=40)
    assert len(found) == 0 and found.counts["converged"] == 0 and found.reasons["did not converge"] == 40
    model = sphere_process()
    starts = sphere_points(50, 0.06, seed=5)[0]
    ended = descend(model, starts, 0.01)
    assert ended.converged.all() and np.abs(model.predict(ended.points).mean).max() < 1.1e-4
    assert not descend(model, starts, 0.01, iterations=1).converged.any()


def test_grasps_move_with_the_process():
    points, normals = sphere_points(100)
    R, t = Rotation.random(rng=np.random.default_rng(6)).as_matrix(), np.array([0.2, -0.3, 0.5])
    points[:, 0] *= 1.2
    normals /= [1.2, 1.0, 1.0]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)

    def process(p, n):
        return GPIS(SquaredExponential(0.03, 1e-4), Constant(0.02), noise=5e-4, normal_noise=0.05).fit(p, n)

    starts = sphere_points(40, 0.06, seed=7)[0]
    here = descend(process(points, normals), starts, 0.01)
    there = descend(process(points @ R.T + t, normals @ R.T), starts @ R.T + t, 0.01)
    assert np.allclose(here.points @ R.T + t, there.points, atol=1e-8)


def test_an_implicit_object_too_wide_says_so():
    model = sphere_process(radius=0.08)
    found = grasps_on_gpis(model, n_starts=50)
    assert len(found) == 0 and dict(found.reasons) == {"too wide": 50}


def test_models_that_cannot_be_held_are_refused():
    model = sphere_process(30)
    with pytest.raises(ValueError, match="gp: expected a GPIS"):
        grasps_on_gpis("model")
    with pytest.raises(RuntimeError, match="fit"):
        grasps_on_gpis(GPIS(SquaredExponential(0.03, 1e-4)))
    with pytest.raises(ValueError, match="gp: expected a model of points in space"):
        grasps_on_gpis(GPIS(SquaredExponential(0.03, 1e-4)).fit(sphere_points(20)[0][:, :2]))
    for argument, value in (("n_starts", 0), ("samples", 0), ("center", (0.0, 1.0)), ("friction", -1.0)):
        with pytest.raises(ValueError, match=argument):
            grasps_on_gpis(model, **{argument: value})


def test_a_call_is_quick():
    model = sphere_process(150)
    grasps_on_gpis(model)
    times = []
    for _ in range(5):
        start = time.perf_counter()
        grasps_on_gpis(model)
        times.append(time.perf_counter() - start)
    assert min(times) < 0.6  # 0.09 s on one free core


# --- thesis figure 2.20 -----------------------------------------------------------------------------------------------


def test_the_figure_of_the_u():
    from agents.figure_2_20 import u_shape as drawn
    from agents.reproduce import reproduce
    from agents.reproduction import Request

    assert drawn().volume == pytest.approx((0.13 * 0.11 + 2 * 0.03 * 0.08) * 0.12)
    assert drawn().volume == pytest.approx(MeshObject.from_trimesh(u_shape()).volume)
    result = reproduce("figure-2.20", Request(picture=True))
    assert result.picture is not None and result.picture.startswith(b"\x89PNG")
    outermost, folds = result.data["outermost"], result.data["all_folds"]
    assert outermost["grasps"] == 0 and set(outermost["reasons"]) == {"too wide"}
    assert folds["grasps"] > 50
    # Rays cross one fold or two: k(k + 1)/2 pairs beside one for each ray that hit.
    hit = outermost["counts"]["pairs"]
    assert folds["counts"]["pairs"] - hit == 2 * (folds["counts"]["folds"] - hit)
    assert "outermost hits" in result.text
