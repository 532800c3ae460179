"""Grasp analysis against independent hulls, linear programs and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation
from wrench_references import random_grasp, reference_points

from baselines.grasping import (
    Contact,
    force_closure,
    friction_cone,
    grasp_matrix,
    largest_min_resisted_wrench,
    probability_of_force_closure,
    q_isotropy,
    q_min,
    q_volume,
    soft_antipodal,
    task_wrench_quality,
    wrench_volume,
)


@pytest.mark.parametrize("model", ["sum", "independent"])
def test_the_ball_is_inside_the_wrench_space_and_touches_it(model: str) -> None:
    rng = np.random.default_rng(4)
    contacts = [Contact(p, [-x for x in p], 0.8, 0.2) for p in np.linalg.qr(rng.normal(size=(3, 3)))[0]]
    contacts = [contacts[0], contacts[1], Contact(-contacts[0].position, contacts[0].position, 0.8, 0.2)]
    points = reference_points(contacts, np.zeros(3), model, 3, 1.0)
    radius = largest_min_resisted_wrench(contacts, np.zeros(3), model, 3)  # type: ignore[arg-type]
    assert radius > 0.0
    for u in rng.normal(size=(200, 6)):
        u /= np.linalg.norm(u)  # the farthest t u that is a convex combination of the points
        program = linprog(
            np.r_[np.zeros(len(points)), -1.0],
            A_eq=np.block([[points.T, -u[:, None]], [np.ones(len(points)), 0.0]]),
            b_eq=np.r_[np.zeros(6), 1.0],
        )
        assert program.status == 0 and -program.fun >= radius - 1e-9
    nearest = max(ConvexHull(points).equations, key=lambda facet: facet[6])[:6]
    assert (points @ nearest).max() == pytest.approx(radius, abs=1e-9)


def test_two_contacts_need_one_soft_finger() -> None:
    rng = np.random.default_rng(2)
    for _ in range(20):
        a, b = random_grasp(rng, 2, soft=False)
        assert not force_closure([a, b])
        assert largest_min_resisted_wrench([a, b], np.zeros(3)) == wrench_volume([a, b], np.zeros(3)) == 0.0
    opposed = [Contact((1, 0, 0), (-1, 0, 0), 0.5, 0.1), Contact((-1, 0, 0), (1, 0, 0))]
    assert force_closure(opposed)
    p, n = np.array([[c.position for c in opposed]]), np.array([[c.normal for c in opposed]])
    assert probability_of_force_closure(p, n, torsion=(0.1, 0.0)).probability == 1.0
    assert probability_of_force_closure(p, n, torsion=0.0).probability == 0.0


def test_more_friction_never_holds_less() -> None:
    rng = np.random.default_rng(3)
    for fingers in (2, 3, 4):
        grasp = random_grasp(rng, fingers, soft=True)
        values = [
            largest_min_resisted_wrench([Contact(c.position, c.normal, mu, c.torsion) for c in grasp], np.zeros(3))
            for mu in (0.1, 0.3, 0.5, 0.8, 1.2)
        ]
        assert np.all(np.diff(values) >= -1e-9) and values[-1] > 0.0


def test_metrics_do_not_depend_on_the_frame() -> None:
    rng = np.random.default_rng(5)
    grasp, center, shift = random_grasp(rng, 3, soft=True), rng.normal(size=3), rng.normal(size=3)
    moved = [Contact(c.position + shift, c.normal, c.friction, c.torsion) for c in grasp]
    radius = largest_min_resisted_wrench(grasp, center)
    assert radius > 0.0 and largest_min_resisted_wrench(moved, center + shift) == pytest.approx(radius, abs=1e-9)
    G = grasp_matrix(grasp, center)
    for turn in Rotation.create_group("O"):  # the cone's edges go with the axes, so these turns change nothing
        R = turn.as_matrix().round()
        turned = [Contact(R @ c.position, R @ c.normal, c.friction, c.torsion) for c in grasp]
        assert largest_min_resisted_wrench(turned, R @ center) == pytest.approx(radius, abs=1e-9)
    R = Rotation.random(rng=rng).as_matrix()
    turned = [Contact(R @ c.position, R @ c.normal, c.friction, c.torsion) for c in grasp]
    for metric in (q_min, q_volume, q_isotropy):
        assert metric(grasp_matrix(turned, R @ center)) == pytest.approx(metric(G), rel=1e-9)


def test_grasp_matrix_maps_the_cone_and_keeps_what_a_contact_transmits() -> None:
    rng = np.random.default_rng(6)
    contact = random_grasp(rng, 1, soft=True)[0]
    G = grasp_matrix([contact], np.zeros(3))
    assert G.shape == (6, 4) and q_min(G) == q_volume(G) == q_isotropy(G) == 0.0
    f = rng.normal(size=3)
    u, w, n = G[:3, :3].T
    assert np.allclose(np.cross(u, w), n) and np.allclose(n, contact.normal)
    assert np.allclose((G @ [*f, 0.0])[3:], np.cross(contact.position, G[:3, :3] @ f))
    for friction, torsion, columns in ((0.0, 0.0, 1), (0.0, 0.1, 2), (0.5, 0.0, 3)):
        c = Contact(contact.position, contact.normal, friction, torsion)
        assert grasp_matrix([c], np.zeros(3)).shape == (6, columns)
    both = grasp_matrix(random_grasp(rng, 3, soft=False), np.zeros(3))
    assert q_volume(both) == pytest.approx(np.sqrt(np.linalg.det(both @ both.T)))
    assert friction_cone(contact, 12).shape == (14, 6)
    tangential = friction_cone(contact)[:8, :3] - contact.normal
    assert np.allclose(np.linalg.norm(tangential, axis=1), contact.friction)


def test_task_quality_and_volume() -> None:
    grasp = [
        Contact(p, -p, 0.8, 0.2) for p in np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)
    ]
    radius = largest_min_resisted_wrench(grasp, np.zeros(3))
    assert radius > 0.0
    assert task_wrench_quality(grasp, np.zeros(3), np.ones(6)) == pytest.approx(radius, abs=1e-9)
    assert task_wrench_quality(grasp, np.zeros(3), 2 * np.eye(6)) == pytest.approx(radius / 2, abs=1e-9)
    one = np.array([0.0, 0.0, -2.0, 0.0, 0.0, 0.0])  # a single wrench: how far along it the hull reaches
    points = reference_points(grasp, np.zeros(3), "sum", 8, 1.0)
    facets = ConvexHull(points).equations
    reach = facets[:, :6] @ one
    expected = (-facets[reach > 0, 6] / reach[reach > 0]).min()
    assert task_wrench_quality(grasp, np.zeros(3), np.zeros(6), mean=one) == pytest.approx(expected, rel=1e-7)
    volume = ConvexHull(points).volume
    assert wrench_volume(grasp, np.zeros(3)) == pytest.approx(volume, rel=1e-7)
    assert wrench_volume(grasp, np.zeros(3), torque_scale=2.0) == pytest.approx(volume / 8, rel=1e-7)


GOOD = Contact((1, 0, 0), (-1, 0, 0))


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: Contact((0, 0), (1, 0, 0)), "position"),
        (lambda: Contact((0, 0, np.nan), (1, 0, 0)), "position"),
        (lambda: Contact((0, 0, 0), (0, 0, 0)), "normal"),
        (lambda: Contact((0, 0, 0), (1, 1e-2, 0)), "normal"),
        (lambda: Contact((0, 0, 0), (1, 0, 0), friction=-0.1), "friction"),
        (lambda: Contact((0, 0, 0), (1, 0, 0), torsion=np.inf), "torsion"),
        (lambda: friction_cone(GOOD, 2), "edges"),
        (lambda: force_closure([]), "contacts"),
        (lambda: force_closure([GOOD, (1, 2)]), "contacts"),
        (lambda: grasp_matrix([GOOD], (0, 0)), "center"),
        (lambda: q_min(np.eye(3)), "G"),
        (lambda: largest_min_resisted_wrench([GOOD], (0, 0, 0), model="both"), "model"),
        (lambda: largest_min_resisted_wrench([GOOD], (0, 0, 0), torque_scale=0.0), "torque_scale"),
        (lambda: task_wrench_quality([GOOD], (0, 0, 0), np.zeros(6)), "ellipsoid"),
        (lambda: soft_antipodal(np.zeros((1, 3, 3)), np.zeros((1, 3, 3))), "positions"),
        (lambda: soft_antipodal(np.zeros((1, 2, 3)), np.zeros((1, 2, 3))), "normals"),
        (lambda: probability_of_force_closure(np.zeros((0, 2, 3)), np.zeros((0, 2, 3))), "positions"),
        (lambda: probability_of_force_closure(np.zeros((1, 2, 3)), np.ones((1, 3, 3))), "normals"),
    ],
)
def test_bad_input_is_named(call, named: str) -> None:
    with pytest.raises(ValueError, match=f"^{named}"):
        call()


def test_contacts_are_values() -> None:
    position = np.array([1.0, 0.0, 0.0])
    contact = Contact(position, (-1, 0, 0))
    position[0] = 5.0
    assert contact.position[0] == 1.0
    with pytest.raises(ValueError):
        contact.position[0] = 2.0
