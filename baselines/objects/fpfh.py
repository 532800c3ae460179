"""Keypoints and descriptors of a cloud's shape: intrinsic shape signatures and fast point feature histograms."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from baselines.objects.normals import neighborhoods

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

BINS = 11
"""Bins of each of the three angles, as in the paper."""

compiled = njit(cache=True, nogil=True, error_model="numpy")


@compiled
def pair_features(p, n, q, m):
    """(α, φ, θ) of a pair of points p, q with normals n, m, all (3,). Rusu, Blodow & Beetz 2009, "Fast point feature
    histograms (FPFH) for 3D registration", eq. 1: α = v·m, φ = u·d/‖d‖, θ = atan2(w·m, u·m).

    u is the normal with the smaller angle to the line between the points, v = d × u / ‖d × u‖, w = u × v. Points that
    coincide, or lie along u, give (0, φ, 0).
    """
    dx, dy, dz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    length = np.sqrt(dx * dx + dy * dy + dz * dz)
    if length == 0.0:
        return 0.0, 0.0, 0.0
    dx, dy, dz = dx / length, dy / length, dz / length
    first, second = n[0] * dx + n[1] * dy + n[2] * dz, m[0] * dx + m[1] * dy + m[2] * dz
    ux, uy, uz, mx, my, mz, phi = n[0], n[1], n[2], m[0], m[1], m[2], first
    if abs(first) < abs(second):  # the other point is the source
        ux, uy, uz, mx, my, mz, phi = m[0], m[1], m[2], n[0], n[1], n[2], -second
        dx, dy, dz = -dx, -dy, -dz
    vx, vy, vz = dy * uz - dz * uy, dz * ux - dx * uz, dx * uy - dy * ux
    size = np.sqrt(vx * vx + vy * vy + vz * vz)
    if size < 1e-12:
        return 0.0, phi, 0.0
    vx, vy, vz = vx / size, vy / size, vz / size
    wx, wy, wz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    alpha = vx * mx + vy * my + vz * mz
    theta = np.arctan2(wx * mx + wy * my + wz * mz, ux * mx + uy * my + uz * mz)
    return alpha, phi, theta


@compiled
def _bin(value, low, high):
    return min(BINS - 1, max(0, int(np.floor(BINS * (value - low) / (high - low)))))


@compiled
def _spfh(points, normals, starts, neighbors):
    """(N, 33) simplified histograms: for each angle, the percentage of the neighbours in each bin."""
    out = np.zeros((len(starts) - 1, 3 * BINS))
    for i in range(len(starts) - 1):
        count = 0
        for k in range(starts[i], starts[i + 1]):
            j = neighbors[k]
            if j == i:
                continue
            alpha, phi, theta = pair_features(points[i], normals[i], points[j], normals[j])
            out[i, _bin(alpha, -1.0, 1.0)] += 1.0
            out[i, BINS + _bin(phi, -1.0, 1.0)] += 1.0
            out[i, 2 * BINS + _bin(theta, -np.pi, np.pi)] += 1.0
            count += 1
        if count:
            out[i] *= 100.0 / count
    return out


@compiled
def _fpfh(points, spfh, rows, starts, neighbors):
    """(K, 33): own histogram plus the neighbours', weighted by one over their distance; eq. 2, each angle to 100."""
    out = np.zeros((len(rows), 3 * BINS))
    for r in range(len(rows)):
        i = rows[r]
        total = 0.0
        for k in range(starts[i], starts[i + 1]):
            j = neighbors[k]
            gap = np.sqrt(((points[j] - points[i]) ** 2).sum())
            if gap > 0.0:
                out[r] += spfh[j] / gap
                total += 1.0 / gap
        if total > 0.0:
            out[r] /= total
        out[r] += spfh[i]
        for a in range(3):
            part = out[r, a * BINS : (a + 1) * BINS]
            whole = part.sum()
            if whole > 0.0:
                part *= 100.0 / whole
    return out


def fpfh(points: Array, normals: Array, radius: float, rows: Ints | None = None) -> Array:
    """Fast point feature histograms (K, 33) of the points `rows` (all of them when None).

    They do not change when the cloud and its normals are moved rigidly. The neighbours' weights are normalised (a mean,
    not a sum), so that the result does not depend on the unit of length.

    Args:
        points: (N, 3) [m].
        normals: (N, 3) unit.
        radius: [m] of the neighbourhoods; a few times the points' spacing, and more than normals were made from.
        rows: (K,) indices.

    Returns:
        (K, 33) α, φ and θ, 11 bins each, every angle's bins adding up to 100 (to 0 for a point without neighbours).
    """
    starts, neighbors = neighborhoods(points, None, radius)
    which = np.arange(len(points)) if rows is None else np.asarray(rows, dtype=np.int64)
    spfh = _spfh(np.ascontiguousarray(points), np.ascontiguousarray(normals), starts, neighbors)
    return _fpfh(np.ascontiguousarray(points), spfh, which, starts, neighbors)


@compiled
def _saliency(points, weights, starts, neighbors, gamma, least):
    """Smallest eigenvalue (N,) of each weighted scatter matrix, −1 where the point cannot be a keypoint."""
    out = np.full(len(points), -1.0)
    scatter = np.empty((3, 3))
    for i in range(len(points)):
        if starts[i + 1] - starts[i] - 1 < least:
            continue
        scatter[:] = 0.0
        total = 0.0
        for k in range(starts[i], starts[i + 1]):
            j = neighbors[k]
            for a in range(3):
                for b in range(3):
                    scatter[a, b] += weights[j] * (points[j, a] - points[i, a]) * (points[j, b] - points[i, b])
            total += weights[j]
        values = np.linalg.eigvalsh(scatter / total)
        if values[1] < gamma * values[2] and values[0] < gamma * values[1]:
            out[i] = values[0]
    return out


def iss_keypoints(
    points: Array, radius: float, suppression: float | None = None, gamma: float = 0.975, least: int = 5
) -> Ints:
    """Indices of intrinsic shape signature keypoints. Zhong 2009, "Intrinsic shape signatures", section 3.

    A keypoint's neighbours spread differently in three directions (each eigenvalue below gamma times the next), and its
    smallest spread is the largest within the suppression radius.

    Args:
        points: (N, 3) [m].
        radius: [m] of the neighbourhoods.
        suppression: [m] least distance between keypoints; None: two thirds of `radius`.
        gamma: largest ratio of neighbouring eigenvalues, in (0, 1].
        least: fewest neighbours of a keypoint.

    Raises:
        ValueError: a radius that is not positive, or gamma outside (0, 1].
    """
    if not 0.0 < gamma <= 1.0:
        raise ValueError(f"gamma: expected a ratio in (0, 1], got {gamma}")
    starts, neighbors = neighborhoods(points, None, radius)
    weights = 1.0 / np.diff(starts)
    saliency = _saliency(np.ascontiguousarray(points), weights, starts, neighbors, gamma, least)
    reach = 2.0 * radius / 3.0 if suppression is None else suppression
    if not 0.0 < reach < np.inf:
        raise ValueError(f"suppression: expected a positive length [m], got {suppression}")
    candidates = np.nonzero(saliency > 0.0)[0]
    if len(candidates) == 0:
        return candidates
    ranked = candidates[np.argsort(-saliency[candidates], kind="stable")]
    around = cKDTree(points[ranked]).query_ball_point(points[ranked], reach)
    free = np.ones(len(ranked), dtype=bool)
    chosen = []
    for i, near in enumerate(around):
        if free[i]:
            chosen.append(ranked[i])
            free[near] = False
    return np.sort(np.array(chosen, dtype=np.int64))
