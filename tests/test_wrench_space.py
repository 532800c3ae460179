"""The largest ball and the largest task inside the wrench space, against independent hulls and known answers."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation
from wrench_references import bracketed_radius, random_grasp, reference_points, reference_radius

from baselines.grasping import (
    Contact,
    ObjectWrenches,
    force_closure,
    largest_min_resisted_wrench,
    object_wrench_quality,
    task_wrench_quality,
)

EDGES = 8
KINDS = list(itertools.product((2, 3, 4, 5), (False, True)))


def check_against_hulls(rng: np.random.Generator, fingers: int, soft: bool) -> bool:
    """Both models of one random grasp; whether it closes."""
    contacts, center, scale = random_grasp(rng, fingers, soft), 0.2 * rng.normal(size=3), rng.uniform(0.5, 2.0)
    got = largest_min_resisted_wrench(contacts, center, "sum", EDGES, scale)
    points = reference_points(contacts, center, "sum", EDGES, scale)
    assert got == pytest.approx(reference_radius(points), abs=1e-9)
    assert force_closure(contacts, edges=EDGES) == (got > 0.0)
    got_independent = largest_min_resisted_wrench(contacts, center, "independent", EDGES, scale)
    if fingers == 2 and not soft:  # no torque about the line between them: the sum is flat, and Qhull would refuse it
        assert got == got_independent == 0.0
        return False
    below, above = bracketed_radius(contacts, center, EDGES, scale)
    assert got_independent == pytest.approx(above, abs=1e-9)
    assert got_independent >= below - 1e-9 * fingers * np.linalg.norm(points, axis=1).max()  # Qhull joggles that much
    assert got_independent >= got - 1e-12  # each contact at its limit can do more than all sharing one
    return got > 0.0


@pytest.mark.parametrize(("fingers", "soft"), KINDS)
def test_radius_equals_an_independent_hull(fingers: int, soft: bool) -> None:
    rng = np.random.default_rng([fingers, soft])
    closed = sum(check_against_hulls(rng, fingers, soft) for _ in range(14))
    assert closed > 0 or (fingers == 2 and not soft)


@pytest.mark.slow
@pytest.mark.parametrize(("fingers", "soft"), KINDS)
def test_radius_equals_an_independent_hull_on_a_thousand_grasps(fingers: int, soft: bool) -> None:
    rng = np.random.default_rng([9, fingers, soft])
    for _ in range(125):
        check_against_hulls(rng, fingers, soft)


@pytest.mark.parametrize(("fingers", "soft", "edges"), [(2, True, 8), (3, False, 5), (3, True, 3), (4, False, 3)])
def test_independent_radius_equals_the_whole_minkowski_sum(fingers: int, soft: bool, edges: int) -> None:
    rng = np.random.default_rng([fingers, edges])
    for _ in range(4):
        contacts, center = random_grasp(rng, fingers, soft), 0.2 * rng.normal(size=3)
        expected = reference_radius(reference_points(contacts, center, "independent", edges, 1.0))
        got = largest_min_resisted_wrench(contacts, center, "independent", edges)
        assert got == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("model", ["sum", "independent"])
def test_symmetric_and_nearly_symmetric_grasps(model: str) -> None:
    """Wrenches that share facets exactly, to rounding, or nearly: the answer moves no more than the contacts do."""
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    rng = np.random.default_rng(3)
    for fingers, size in itertools.product((2, 4), (1.0, 0.03)):
        normals = -axes[[0, 3, 1, 4, 2, 5]][:fingers]
        exact = largest_min_resisted_wrench(
            [Contact(-size * n, n, 0.5, 0.1 * size) for n in normals], np.zeros(3), model, 8, size
        )  # type: ignore[arg-type]
        assert exact > 0.0
        for noise in 10.0 ** np.arange(-13, -5):
            moved = normals + noise * rng.normal(size=normals.shape)
            moved /= np.linalg.norm(moved, axis=1)[:, None]
            contacts = [Contact(-size * n, m, 0.5, 0.1 * size) for n, m in zip(normals, moved, strict=True)]
            radius = largest_min_resisted_wrench(contacts, np.zeros(3), model, 8, size)  # type: ignore[arg-type]
            assert radius == pytest.approx(exact, abs=100 * noise + 1e-10)


def test_radius_of_frictionless_fingers_in_closed_form() -> None:
    """Four frictionless fingers an axis, which push and turn: the wrench space is made of three squares."""
    contacts = []
    for i in range(3):
        along, arm = np.eye(3)[i], np.eye(3)[(i + 1) % 3]
        for sign, side in itertools.product((1.0, -1.0), repeat=2):
            contacts.append(Contact(side * arm - sign * along, sign * along, friction=0.0))
    # each wrench is (± e_i, ± e_k): forces and torques pair off, and the gauge is the sum over i of max(|f_i|, |t_k|)
    assert largest_min_resisted_wrench(contacts, np.zeros(3)) == pytest.approx(1.0 / np.sqrt(3.0), abs=1e-12)
    assert largest_min_resisted_wrench(contacts, np.zeros(3), "independent") == pytest.approx(np.sqrt(2.0), abs=1e-12)


def load(**changes: object) -> ObjectWrenches:
    values: dict[str, object] = {"mass": 0.2, "center_of_mass": (0.01, 0.0, 0.02), "acceleration": 2.0}
    values |= {"inertia": np.diag([1e-4, 2e-4, 3e-4]), "angular_acceleration": 10.0, "push": 0.5}
    values |= {"points": 0.05 * np.random.default_rng(0).normal(size=(30, 3))}
    return ObjectWrenches(**{**values, **changes})  # type: ignore[arg-type]


def grasp(fingers: int = 4, edges: int = 8) -> list[Contact]:
    rng = np.random.default_rng(7)
    while not force_closure(contacts := random_grasp(rng, fingers, soft=True), edges=edges):
        pass
    return [Contact(0.04 * c.position, c.normal, c.friction, 0.04 * c.torsion) for c in contacts]


@pytest.mark.parametrize("model", ["sum", "independent"])
def test_object_wrench_quality_against_the_whole_hull(model: str) -> None:
    edges = 8 if model == "sum" else 4
    contacts, task = grasp(3, edges), load()
    points = reference_points(contacts, task.center_of_mass, model, edges, 0.04)
    planes = ConvexHull(np.concatenate([points, np.zeros((1, 6))])).equations
    force, torque = planes[:, :3], planes[:, 3:6] / 0.04
    weight = 0.2 * (9.80665 + 2.0) * np.linalg.norm(force, axis=1)
    turning = 10.0 * np.linalg.norm(torque @ task.inertia, axis=1)
    pushes = [force - np.cross(p - task.center_of_mass, torque) for p in task.points]  # f·d + (r × f)·t = f·(d + t × r)
    pushing = 0.5 * np.max([np.linalg.norm(push, axis=1) for push in pushes], axis=0)
    expected = (-planes[:, 6] / (weight + turning + pushing)).min()
    got = object_wrench_quality(contacts, task, model, edges)  # type: ignore[arg-type]
    assert got == pytest.approx(expected, rel=1e-8) and got > 0.0


def test_object_wrenches_follow_the_object_and_add_up() -> None:
    contacts, task = grasp(), load()
    k = object_wrench_quality(contacts, task)
    twice = load(mass=0.4, inertia=2 * task.inertia, push=1.0)
    assert object_wrench_quality(contacts, twice) == pytest.approx(k / 2, rel=1e-9)
    for less in ({"acceleration": 0.0}, {"push": 0.0}, {"angular_acceleration": 0.0}, {"gravity": 0.0}):
        assert object_wrench_quality(contacts, load(**less)) > k
    inner = np.concatenate([task.points, 0.9 * task.points + 0.1 * task.points.mean(axis=0)])
    assert object_wrench_quality(contacts, load(points=inner)) == pytest.approx(k, rel=1e-9)
    R = Rotation.create_group("O")[5].as_matrix().round()  # the cones' edges go with the axes
    shift = np.array([0.3, -0.2, 0.1])
    moved = [Contact(R @ c.position + shift, R @ c.normal, c.friction, c.torsion) for c in contacts]
    there = load(
        center_of_mass=R @ task.center_of_mass + shift,
        inertia=R @ task.inertia @ R.T,
        points=task.points @ R.T + shift,
    )
    assert object_wrench_quality(moved, there) == pytest.approx(k, rel=1e-8)
    only_weight = ObjectWrenches(0.2, task.center_of_mass)  # the same as an ellipsoid of forces alone
    flat = np.diag([0.2 * 9.80665] * 3 + [0.0] * 3)
    ellipsoid = task_wrench_quality(contacts, task.center_of_mass, flat)
    assert object_wrench_quality(contacts, only_weight) == pytest.approx(ellipsoid, rel=1e-9)
    open_grasp = [Contact(c.position, c.normal) for c in contacts[:2]]
    assert object_wrench_quality(open_grasp, task) == 0.0


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"mass": -1.0}, "mass"),
        ({"mass": 0.0, "push": 0.0, "angular_acceleration": 0.0}, "mass"),
        ({"center_of_mass": (0.0, 0.0)}, "center_of_mass"),
        ({"acceleration": np.nan}, "acceleration"),
        ({"inertia": -np.eye(3)}, "inertia"),
        ({"inertia": np.triu(np.ones((3, 3)))}, "inertia"),
        ({"angular_acceleration": -1.0}, "angular_acceleration"),
        ({"points": np.zeros((3, 2))}, "points"),
        ({"points": np.zeros((0, 3))}, "points"),
        ({"push": -0.1}, "push"),
        ({"gravity": np.inf}, "gravity"),
    ],
)
def test_bad_object_wrenches_are_named(changes: dict[str, object], named: str) -> None:
    with pytest.raises(ValueError, match=f"^{named}"):
        load(**changes)


def test_bad_quality_arguments_are_named() -> None:
    with pytest.raises(ValueError, match=r"^wrenches: expected ObjectWrenches, got float"):
        object_wrench_quality(grasp(), 1.0)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"^contacts"):
        object_wrench_quality([], load())
