"""Matching descriptors: the nearest in another set, by ratio and by agreement both ways."""

from __future__ import annotations

from typing import Literal, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.int64]


class Matches(NamedTuple):
    """Pairs of descriptors, the closest first."""

    query: Ints  # (M,) rows of the first set
    train: Ints  # (M,) rows of the second set
    distances: NDArray[np.float64]  # (M,) Hamming for bits (uint8), Euclidean for numbers


def match_descriptors(
    query: NDArray,
    train: NDArray,
    method: Literal["bf", "flann"] = "bf",
    ratio: float | None = 0.8,
    cross_check: bool = True,
    max_distance: float = np.inf,
) -> Matches:
    """Nearest neighbours of descriptors (N, D) among others (M, D).

    Args:
        query, train: uint8 for strings of bits (ORB), float for vectors (SIFT, FPFH).
        method: "bf" compares all; "flann" searches approximately (k-d trees, or locality-sensitive hashing for bits).
        ratio: the nearest must be closer than this times the second nearest (Lowe 2004, section 7.1); None: no test.
            It needs at least two candidates, and is left out when `train` has one.
        cross_check: a match must be the nearest in both directions.
        max_distance: matches farther apart than this are left out.

    Raises:
        ValueError: shapes or types that do not match, values that are not finite, or a ratio outside (0, 1].
    """
    a, b = np.asarray(query), np.asarray(train)
    for name, array in (("query", a), ("train", b)):
        if array.ndim != 2 or array.shape[1] != a.shape[-1]:
            raise ValueError(f"{name}: expected shape (N, {a.shape[-1] if a.ndim else 'D'}), got {array.shape}")
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            raise ValueError(f"{name}: expected finite descriptors")
    if (a.dtype == np.uint8) != (b.dtype == np.uint8):
        raise ValueError(f"train: expected descriptors of one kind, got {a.dtype} and {b.dtype}")
    if method not in ("bf", "flann"):
        raise ValueError(f'method: expected "bf" or "flann", got {method!r}')
    if ratio is not None and not 0.0 < ratio <= 1.0:
        raise ValueError(f"ratio: expected a number in (0, 1], got {ratio}")
    if len(a) == 0 or len(b) == 0:
        return Matches(np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64), np.empty(0))
    nearest, distance, second = _two_nearest(a, b, method)
    kept = (nearest >= 0) & (distance <= max_distance)
    if ratio is not None and len(b) > 1:
        kept &= distance < ratio * second
    if cross_check:
        back = _two_nearest(b, a, method)[0]
        kept &= back[nearest] == np.arange(len(a))
    rows = np.nonzero(kept)[0]
    rows = rows[np.argsort(distance[rows], kind="stable")]
    return Matches(rows, nearest[rows], distance[rows])


def _two_nearest(a: NDArray, b: NDArray, method: str) -> tuple[Ints, NDArray[np.float64], NDArray[np.float64]]:
    """Row of b nearest to each of a (−1: none found), its distance, and the second nearest's."""
    bits = a.dtype == np.uint8
    matcher: cv2.DescriptorMatcher
    if method == "bf":
        matcher = cv2.BFMatcher(cv2.NORM_HAMMING if bits else cv2.NORM_L2)
    else:  # algorithm 6: locality-sensitive hashing; 1: k-d trees
        index: dict[str, bool | int | float | str] = {"algorithm": 1, "trees": 5}
        if bits:
            index = {"algorithm": 6, "table_number": 12, "key_size": 20, "multi_probe_level": 2}
        matcher = cv2.FlannBasedMatcher(index, {"checks": 64})
        cv2.setRNGSeed(0)  # FLANN's trees are random: equal calls shall give equal matches
    kind = np.uint8 if bits else np.float32
    found = matcher.knnMatch(np.ascontiguousarray(a, kind), np.ascontiguousarray(b, kind), k=min(2, len(b)))
    nearest, distances = np.full(len(a), -1, dtype=np.int64), np.full((len(a), 2), np.inf)
    for i, pair in enumerate(found):
        for k, match in enumerate(pair):
            distances[i, k] = match.distance
            if k == 0:
                nearest[i] = match.trainIdx
    return nearest, distances[:, 0], distances[:, 1]
