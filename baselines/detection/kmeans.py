"""Clusters about centres: k-means from spread-out starts, and X-means, which finds their number."""

from __future__ import annotations

import warnings
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.detection.checks import check_points

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


class Centers(NamedTuple):
    """Points parted among centres."""

    labels: Ints  # (N,) row of the centre that each point belongs to
    centers: Array  # (k, 3) [m]


def kmeans_pp(points: Any, k: int, rng: np.random.Generator | None = None) -> Centers:
    """k-means (Lloyd 1982) from starts by k-means++ (Arthur & Vassilvitskii 2007), by scikit-learn.

    Args:
        points: (N, 3) [m], at least k different ones.
        k: number of clusters.
        rng: None: the same starts at every call.

    Raises:
        ValueError: fewer different points than clusters, or values that are not finite.
    """
    from sklearn.cluster import KMeans  # takes a second to import

    cloud = check_points(points, least=1)
    if not 1 <= k <= len(cloud) or (k > 1 and len(np.unique(cloud, axis=0)) < k):
        raise ValueError(f"k: expected a number of clusters in [1, {len(np.unique(cloud, axis=0))}], got {k}")
    rng = np.random.default_rng(0) if rng is None else rng
    found = KMeans(k, n_init=4, random_state=int(rng.integers(2**31))).fit(cloud)
    return Centers(found.labels_.astype(np.int64), np.asarray(found.cluster_centers_, dtype=np.float64))


def x_means(points: Any, kmin: int = 1, kmax: int = 16, rng: np.random.Generator | None = None) -> Centers:
    """k-means whose number of clusters is found: each is halved while the Bayesian information criterion gains.

    Pelleg & Moore 2000, "X-means: extending k-means with efficient estimation of the number of clusters".

    Args:
        points: (N, 3) [m].
        kmin, kmax: fewest and most clusters.
        rng: None: the same starts at every call.

    Raises:
        ValueError: no points, values that are not finite, or numbers that are out of order.
    """
    cloud = check_points(points)
    if not 1 <= kmin <= kmax:
        raise ValueError(f"kmin, kmax: expected 1 ≤ kmin ≤ kmax, got {kmin} and {kmax}")
    rng = np.random.default_rng(0) if rng is None else rng
    found = kmeans_pp(cloud, kmin, rng)
    while len(found.centers) < kmax:
        halves, gains = [], []
        for i in range(len(found.centers)):
            part = cloud[found.labels == i]
            if len(part) < 4 or len(np.unique(part, axis=0)) < 2:
                continue
            split = kmeans_pp(part, 2, rng)
            gain = _information(part, split) - _information(
                part, Centers(np.zeros(len(part), dtype=np.int64), part.mean(axis=0)[None])
            )
            if gain > 0.0:
                halves.append((i, split.centers))
                gains.append(gain)
        if not halves:
            break
        best = [halves[i] for i in np.argsort(gains)[::-1][: kmax - len(found.centers)]]
        replaced = {i for i, _ in best}
        kept = [center[None] for i, center in enumerate(found.centers) if i not in replaced]
        found = _lloyd(cloud, np.concatenate(kept + [centers for _, centers in best]))
    return found


def _lloyd(points: Array, centers: Array) -> Centers:
    from sklearn.cluster import KMeans
    from sklearn.exceptions import ConvergenceWarning

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # centres that coincide stay as they are
        found = KMeans(len(centers), init=centers, n_init=1).fit(points)
    return Centers(found.labels_.astype(np.int64), np.asarray(found.cluster_centers_, dtype=np.float64))


def _information(points: Array, parts: Centers) -> float:
    """Bayesian information criterion of equal round Gaussians about the centres (the paper's section 3.2)."""
    n, size = points.shape
    k = len(parts.centers)
    squares = float(np.sum((points - parts.centers[parts.labels]) ** 2))
    variance = max(squares / (size * max(n - k, 1)), np.finfo(float).tiny)
    counts = np.bincount(parts.labels, minlength=k)
    counts = counts[counts > 0]
    likelihood = float(counts @ np.log(counts / n)) - 0.5 * n * size * np.log(2.0 * np.pi * variance)
    likelihood -= 0.5 * squares / variance
    return likelihood - 0.5 * (k * size + k) * np.log(n)  # k − 1 shares, k centres and one variance
