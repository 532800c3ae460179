"""Wrench spaces worked out independently of the package, one number at a time or by Qhull, for tests."""

from __future__ import annotations

import itertools

import numpy as np
from scipy.spatial import ConvexHull

from baselines.grasping import Contact


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
    """All points of the wrench space's hull but, for "sum", zero."""
    cones = [reference_wrenches(contact, center, edges, scale) for contact in contacts]
    if model == "sum":
        return np.array([row for cone in cones for row in cone])
    return np.array([np.sum(rows, axis=0) for rows in itertools.product(*([[0.0] * 6, *cone] for cone in cones))])


def reference_radius(points: np.ndarray) -> float:
    """The nearest facet's distance, from Qhull at its defaults; 0 where zero is not inside."""
    if np.linalg.matrix_rank(points - points.mean(axis=0), tol=1e-9) < 6:
        return 0.0
    return max(0.0, float(-ConvexHull(points).equations[:, 6].max()))


def joggled_hull(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Qhull's facets, as simplices and planes; in another frame where it had to joggle the points by more than 1e-9."""
    best: tuple[float, np.ndarray, np.ndarray] | None = None
    for seed in range(8):
        R = np.linalg.qr(np.random.default_rng(seed).normal(size=(6, 6)))[0]
        hull = ConvexHull(points @ R.T, qhull_options="QJ")
        planes = np.column_stack([hull.equations[:, :6] @ R, hull.equations[:, 6]])
        nearest = planes[planes[:, 6].argsort()[-60:]]
        error = float(np.abs((nearest[:, :6] @ points.T).max(axis=1) + nearest[:, 6]).max())
        if best is None or error < best[0]:
            best = error, hull.simplices, planes
        if error < 1e-9 * np.abs(points).max():
            break
    assert best is not None
    return best[1], best[2]


def bracketed_radius(contacts: list[Contact], center: np.ndarray, edges: int, scale: float) -> tuple[float, float]:
    """Bounds on the radius in the "independent" model, where the Minkowski sum has too many points to list.

    Below: the ball inside Qhull's hull of some of its points. Above: the support function along some unit directions.
    Points are added along Qhull's nearest facets until the two meet to 5e-10; both bounds hold at any time, the lower
    one to the 1e-10 by which Qhull joggles points (its merged hulls fail where so many points share facets).
    """
    cones = [np.array([[0.0] * 6, *reference_wrenches(contact, center, edges, scale)]) for contact in contacts]

    def farthest(directions: np.ndarray) -> np.ndarray:
        return sum(cone[(directions @ cone.T).argmax(axis=1)] for cone in cones)  # type: ignore[return-value]

    directions = np.random.default_rng(0).normal(size=(60, 6))
    points, above = np.unique(farthest(np.concatenate([directions, -directions])), axis=0), np.inf
    for _ in range(100):
        simplices, planes = joggled_hull(points)
        order = planes[:, 6].argsort()[::-1]
        below = -planes[order[0], 6]
        order = order[-planes[order, 6] < above + 1e-9][:60]
        if not len(order):
            break
        corners = points[simplices[order]]  # of which the planes are tilted by the joggling: take them anew
        exact = np.linalg.svd(corners[:, 1:] - corners[:, :1])[2][:, -1]
        exact *= np.sign(np.einsum("ij,ij->i", exact, planes[order, :6]))[:, None]
        nearest = np.concatenate([planes[order, :6], exact])
        new = farthest(nearest)
        above = min(above, float(np.einsum("ij,ij->i", new, nearest).min()))
        if above - below < 5e-10 or above < 1e-9:
            break
        points = np.unique(np.concatenate([points, new]).round(13), axis=0)
    return max(0.0, float(below)), max(0.0, above)
