"""Two-finger closure in closed form, its probability, and the closing line's margins, against hulls of every sample."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from wrench_references import reference_points, reference_radius

from agents.grasp_speed import measure
from baselines.grasping import (
    Contact,
    antipodal_probability,
    closing_angles,
    force_closure,
    line_distance,
    probability_of_force_closure,
    soft_antipodal,
)

FRICTION, TORSION = 0.5, 0.1


def draw(rng: np.random.Generator, samples: int, fingers: int, spread: float) -> tuple[np.ndarray, np.ndarray]:
    """Samples (n, k, 3) of contacts around a circle."""
    angle = 2 * np.pi * np.arange(fingers) / fingers
    mean = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    p = mean + 0.1 * rng.normal(size=(samples, fingers, 3))
    n = -mean + spread * rng.normal(size=p.shape)
    return p, n / np.linalg.norm(n, axis=-1, keepdims=True)


def test_closed_form_agrees_with_the_hull_but_for_the_inscribed_cones() -> None:
    """On 1000 pairs. The polyhedral cone lies inside the round one, so only closed pairs near its border differ."""
    rng = np.random.default_rng(1)
    seen, apart = set(), 0
    for i in range(1000):
        p = rng.normal(size=(2, 3))
        n = np.array([p[1] - p[0], p[0] - p[1]]) * (1 if i % 4 else -1)
        n = n / np.linalg.norm(n, axis=1)[:, None] + 0.3 * rng.normal(size=(2, 3))
        n /= np.linalg.norm(n, axis=1)[:, None]
        contacts = [Contact(*pair, FRICTION, TORSION) for pair in zip(p, n, strict=True)]
        hull, closed = force_closure(contacts), bool(soft_antipodal(p, n, FRICTION))
        seen.add((closed, i % 4 == 0))
        if hull == closed:
            continue
        apart += 1
        assert closed  # an inscribed cone never closes more
        assert not soft_antipodal(p, n, FRICTION * np.cos(np.pi / 8))  # it is at the border: outside the inner circle
        assert any(force_closure(contacts, edges=edges) for edges in (16, 64, 256, 1024))  # gone with more edges
    assert 0 < apart < 60 and seen == set(itertools.product((False, True), repeat=2))


@pytest.mark.parametrize(("fingers", "spread", "seed"), [(2, 0.15, 1), (2, 0.25, 2), (2, 0.4, 3), (3, 0.35, 4)])
def test_pfc_is_within_three_standard_errors_of_brute_force(fingers: int, spread: float, seed: int) -> None:
    """Brute force: Qhull on the cones of every sample, from other random numbers."""
    edges = 16 if fingers == 2 else 8
    p, n = draw(np.random.default_rng([seed, 0]), 2000 if fingers == 2 else 300, fingers, spread)
    estimate = probability_of_force_closure(p, n, FRICTION, TORSION, edges)
    brute = [
        reference_radius(
            reference_points(
                [Contact(*c, FRICTION, TORSION) for c in zip(p, n, strict=True)], np.zeros(3), "sum", edges, 1
            )
        )
        > 1e-9
        for p, n in zip(*draw(np.random.default_rng([seed, 1]), 200, fingers, spread), strict=True)
    ]
    error = np.hypot(estimate.standard_error, np.std(brute) / np.sqrt(len(brute)))
    assert 0.05 < estimate.probability < 0.999
    assert abs(estimate.probability - np.mean(brute)) < 3 * error
    fraction = estimate.probability
    assert estimate.standard_error == pytest.approx(np.sqrt(fraction * (1 - fraction) / estimate.samples), rel=0.1)


def test_many_grasps_at_once_are_the_grasps_one_by_one() -> None:
    rng = np.random.default_rng(5)
    samples = [draw(rng, 150, 2, spread) for spread in (0.02, 0.2, 0.3, 0.6)]
    p, n = np.stack([s[0] for s in samples], axis=1), np.stack([s[1] for s in samples], axis=1)
    probability, error = antipodal_probability(p, n, FRICTION)
    for g in range(4):
        alone = probability_of_force_closure(p[:, g], n[:, g], FRICTION, TORSION)
        assert (probability[g], error[g]) == (alone.probability, alone.standard_error)
    assert np.all(np.diff(probability) < 0.0) and np.all(error > 0.0)
    mu = rng.uniform(0.3, 0.7, size=(150, 1, 1))  # friction in doubt, the same for all grasps of a sample
    in_doubt, _ = antipodal_probability(p, n, mu)
    each = np.mean([soft_antipodal(p[s], n[s], mu[s, 0, 0]) for s in range(150)], axis=0)
    assert np.array_equal(in_doubt, each)
    assert np.array_equal(antipodal_probability(p, n, (0.0, FRICTION))[0], np.zeros(4))


def test_standard_error_is_the_spread_of_estimates() -> None:
    p, n = draw(np.random.default_rng(6), 200 * 400, 2, 0.25)
    probability, error = antipodal_probability(p.reshape(200, 400, 2, 3), n.reshape(200, 400, 2, 3), FRICTION)
    assert error.mean() == pytest.approx(probability.std(), rel=0.1)


def test_margins_of_the_closing_line() -> None:
    rng = np.random.default_rng(7)
    p, n = draw(rng, 500, 2, 0.4)
    angles = closing_angles(p, n)
    assert np.array_equal(angles < np.arctan(FRICTION), soft_antipodal(p, n, FRICTION))  # none of them pushes apart
    line = (p[:, 1] - p[:, 0]) / np.linalg.norm(p[:, 1] - p[:, 0], axis=1)[:, None]
    cosines = np.minimum(np.einsum("ni,ni->n", line, n[:, 0]), -np.einsum("ni,ni->n", line, n[:, 1]))
    assert np.allclose(angles, np.arccos(cosines), atol=1e-7)
    assert np.allclose(closing_angles(p, -n), np.pi - np.minimum(*np.arccos(np.clip(_cosines(p, n), -1, 1)).T))
    center = rng.normal(size=3)
    t = np.einsum("ni,ni->n", center - p[:, 0], line)
    foot = p[:, 0] + t[:, None] * line
    assert np.allclose(line_distance(p, center), np.linalg.norm(foot - center, axis=1))
    assert line_distance([[1, 0, 0], [-1, 0, 0]], [0.3, 3.0, 4.0]) == pytest.approx(5.0)
    assert closing_angles(p.reshape(50, 10, 2, 3), n.reshape(50, 10, 2, 3)).shape == (50, 10)
    assert line_distance(p.reshape(50, 10, 2, 3), np.zeros((10, 3))).shape == (50, 10)
    same = np.zeros((1, 2, 3))
    assert np.isnan(closing_angles(same, n[:1])).all() and np.isnan(line_distance(same, center)).all()
    assert not soft_antipodal(same, n[:1]).any()


def _cosines(p: np.ndarray, n: np.ndarray) -> np.ndarray:
    line = (p[:, 1] - p[:, 0]) / np.linalg.norm(p[:, 1] - p[:, 0], axis=1)[:, None]
    return np.stack([np.einsum("ni,ni->n", line, n[:, 0]), -np.einsum("ni,ni->n", line, n[:, 1])], axis=1)


P, N = np.array([[1.0, 0, 0], [-1, 0, 0]]), np.array([[-1.0, 0, 0], [1, 0, 0]])


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: antipodal_probability(P[None], N[None]), "positions"),
        (lambda: antipodal_probability(np.zeros((0, 1, 2, 3)), np.zeros((0, 1, 2, 3))), "positions"),
        (lambda: antipodal_probability(P[None, None], 2 * N[None, None]), "normals"),
        (lambda: antipodal_probability(P[None, None], N[None, None], -0.1), "friction"),
        (lambda: antipodal_probability(P[None, None], N[None, None], (0.1, 0.2, 0.3)), "friction"),
        (lambda: soft_antipodal(P, N, np.nan), "friction"),
        (lambda: closing_angles(np.full((2, 3), np.inf), N), "positions"),
        (lambda: closing_angles(P[0], N[0]), "positions"),
        (lambda: closing_angles("here", N), "positions"),
        (lambda: closing_angles(P, N[None]), "normals"),
        (lambda: line_distance(P, (0.0, 0.0)), "center"),
        (lambda: line_distance(P[None], np.zeros((3, 3))), "center"),
    ],
)
def test_bad_input_is_named(call, named: str) -> None:
    with pytest.raises(ValueError, match=f"^{named}"):
        call()


def test_speed_is_measured() -> None:
    rows = measure(repeats=1, samples=20, grasps=2)
    assert all(row.seconds > 0.0 and row.ratio == pytest.approx(row.bound_seconds / row.seconds) for row in rows)
    assert [row.target for row in rows] == [30.0, 0.0, 0.0, 2.0]
