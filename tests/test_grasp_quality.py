"""Grasp analysis against independent hulls, linear programs and closed forms."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

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


def random_grasp(rng: np.random.Generator, fingers: int, soft: bool) -> list[Contact]:
    """Contacts on a unit ball, with normals tilted off the centre; two are roughly opposed."""
    p = rng.normal(size=(fingers, 3))
    if fingers == 2:
        p[1] = -p[0] + 0.2 * rng.normal(size=3)
    p /= np.linalg.norm(p, axis=1)[:, None]
    n = -p + 0.2 * rng.normal(size=p.shape)
    n /= np.linalg.norm(n, axis=1)[:, None]
    mu = rng.uniform(0.3, 1.0, fingers)
    torsion = rng.uniform(0.05, 0.3, fingers) if soft else np.zeros(fingers)
    return [Contact(*contact) for contact in zip(p, n, mu, torsion, strict=True)]


def reference_wrenches(contact: Contact, center: np.ndarray, edges: int, scale: float) -> list[list[float]]:
    """The documented conventions, spelled out one number at a time."""
    n = contact.normal
    e = np.zeros(3)
    e[min(range(3), key=lambda i: abs(n[i]))] = 1.0
    u = np.array([n[1] * e[2] - n[2] * e[1], n[2] * e[0] - n[0] * e[2], n[0] * e[1] - n[1] * e[0]])
    u = u / np.sqrt(u @ u)
    w = np.array([n[1] * u[2] - n[2] * u[1], n[2] * u[0] - n[0] * u[2], n[0] * u[1] - n[1] * u[0]])
    r = contact.position - center
    pairs = []
    for j in range(edges):
        phi = 2 * np.pi * j / edges
        pairs.append((n + contact.friction * (np.cos(phi) * u + np.sin(phi) * w), np.zeros(3)))
    if contact.torsion > 0:
        pairs += [(n, contact.torsion * n), (n, -contact.torsion * n)]
    rows = []
    for f, t in pairs:
        m = [r[1] * f[2] - r[2] * f[1] + t[0], r[2] * f[0] - r[0] * f[2] + t[1], r[0] * f[1] - r[1] * f[0] + t[2]]
        rows.append([*f, *(x / scale for x in m)])
    return rows


def reference_points(contacts: list[Contact], center: np.ndarray, model: str, edges: int, scale: float) -> np.ndarray:
    cones = [reference_wrenches(contact, center, edges, scale) for contact in contacts]
    if model == "sum":
        return np.array([row for cone in cones for row in cone])
    return np.array([np.sum(rows, axis=0) for rows in itertools.product(*([[0.0] * 6, *cone] for cone in cones))])


def reference_radius(points: np.ndarray) -> float:
    """The nearest facet's distance, from Qhull at its defaults; 0 where zero is not inside."""
    if np.linalg.matrix_rank(points - points.mean(axis=0), tol=1e-9) < 6:
        return 0.0
    return max(0.0, float(-ConvexHull(points).equations[:, 6].max()))


CASES = [("sum", k, soft, 8, 30) for k in (2, 3, 4, 5) for soft in (False, True)]
CASES += [("independent", 2, False, 5, 4), ("independent", 2, True, 5, 20), ("independent", 3, False, 4, 12)]
CASES += [("independent", 3, True, 3, 8)]


@pytest.mark.parametrize(("model", "fingers", "soft", "edges", "count"), CASES)
def test_lmrw_equals_an_independent_hull(model: str, fingers: int, soft: bool, edges: int, count: int) -> None:
    rng = np.random.default_rng([fingers, soft, edges])
    closed = 0
    for _ in range(count):
        contacts, center, scale = random_grasp(rng, fingers, soft), 0.2 * rng.normal(size=3), rng.uniform(0.5, 2.0)
        expected = reference_radius(reference_points(contacts, center, model, edges, scale))
        got = largest_min_resisted_wrench(contacts, center, model, edges, scale)  # type: ignore[arg-type]
        assert got == pytest.approx(expected, abs=1e-9)
        assert force_closure(contacts, edges=edges) == (got > 0.0)
        closed += got > 0.0
    assert closed > 0 or (fingers == 2 and not soft)


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


def test_closed_form_agrees_with_the_hull_but_for_the_inscribed_cones() -> None:
    rng = np.random.default_rng(1)
    edges, seen, gap = 32, set(), 0
    for i in range(400):
        p = rng.normal(size=(2, 3))
        n = np.array([p[1] - p[0], p[0] - p[1]]) * (1 if i % 4 else -1)
        n = n / np.linalg.norm(n, axis=1)[:, None] + 0.3 * rng.normal(size=(2, 3))
        n /= np.linalg.norm(n, axis=1)[:, None]
        contacts = [Contact(*pair, 0.5, 0.1) for pair in zip(p, n, strict=True)]
        hull, closed = force_closure(contacts, edges=edges), bool(soft_antipodal(p[None], n[None], 0.5)[0])
        seen.add((closed, i % 4 == 0))
        assert closed or not hull  # an inscribed cone never closes more
        if closed and not hull:  # in the gap: the cone shrunk to the polygon's inner radius does not close
            gap += 1
            assert not soft_antipodal(p[None], n[None], 0.5 * np.cos(np.pi / edges))[0]
    assert gap < 8 and seen == set(itertools.product((False, True), repeat=2))  # squeezing and spreading, both verdicts


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


@pytest.mark.parametrize("fingers", [2, 3])
def test_pfc_is_within_three_standard_errors_of_brute_force(fingers: int) -> None:
    rng, edges = np.random.default_rng(8), 16 if fingers == 2 else 8
    angle = 2 * np.pi * np.arange(fingers) / fingers
    mean = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)

    def draw(n: int) -> tuple[np.ndarray, np.ndarray]:
        p = mean + 0.1 * rng.normal(size=(n, fingers, 3))
        normals = -mean + 0.35 * rng.normal(size=p.shape)
        return p, normals / np.linalg.norm(normals, axis=-1, keepdims=True)

    estimate = probability_of_force_closure(
        *draw(1000 if fingers == 2 else 300), friction=0.5, torsion=0.1, edges=edges
    )
    brute = [
        reference_radius(
            reference_points([Contact(*c, 0.5, 0.1) for c in zip(p, n, strict=True)], 0, "sum", edges, 1.0)
        )
        > 1e-9
        for p, n in zip(*draw(300), strict=True)
    ]
    spread = np.hypot(estimate.standard_error, np.std(brute) / np.sqrt(len(brute)))
    assert 0.05 < estimate.probability < 0.99
    assert abs(estimate.probability - np.mean(brute)) < 3 * spread
    assert estimate.standard_error == pytest.approx(
        np.sqrt(estimate.probability * (1 - estimate.probability) / estimate.samples), rel=0.05
    )


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
