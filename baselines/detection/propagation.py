"""From matches of consecutive frames to what every pair of frames has in common, and to tracks of single points."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

Ints = NDArray[np.int64]


class Observations(NamedTuple):
    """Which point is seen as which feature of which frame; sorted by point, then frame."""

    point: Ints  # (M,) 0 … points − 1
    frame: Ints  # (M,)
    feature: Ints  # (M,) row among the frame's features
    points: int  # how many there are


def _pairs(value: ArrayLike, name: str) -> Ints:
    array = np.asarray(value, dtype=np.int64)
    if array.size == 0:
        return np.empty((0, 2), dtype=np.int64)
    if array.ndim != 2 or array.shape[1] != 2 or array.min() < 0:
        raise ValueError(f"{name}: expected rows (feature, feature) ≥ 0, got shape {array.shape}")
    for side in range(2):
        if len(np.unique(array[:, side])) != len(array):
            raise ValueError(f"{name}: expected every feature at most once, got one twice")
    return array


def propagate(sequential: Sequence[ArrayLike]) -> dict[tuple[int, int], Ints]:
    """Matches of every two frames, from those of neighbours: a match (i, j − 1) that continues in (j − 1, j) is (i, j).

    Ramon Soria 2018, algorithm 3, with its outer loop running over the offsets of all pairs and matches chained.

    Args:
        sequential: K − 1 arrays (M, 2): rows of features of frames i and i + 1, each feature at most once.

    Returns:
        (M, 2) rows of features of frames i and j, in the order of i's, for every i < j.

    Raises:
        ValueError: arrays of another shape, or a feature matched twice.
    """
    matches: dict[tuple[int, int], Ints] = {}
    for i, pairs in enumerate(sequential):
        array = _pairs(pairs, f"sequential[{i}]")
        matches[i, i + 1] = array[np.argsort(array[:, 0], kind="stable")]
    frames = len(sequential) + 1
    for offset in range(2, frames):
        for i in range(frames - offset):
            j = i + offset
            before, step = matches[i, j - 1], matches[j - 1, j]
            place = np.searchsorted(step[:, 0], before[:, 1])
            continues = place < len(step)
            continues[continues] = step[place[continues], 0] == before[continues, 1]
            matches[i, j] = np.column_stack([before[continues, 0], step[place[continues], 1]])
    return matches


def observations(
    matches: Mapping[tuple[int, int], ArrayLike], sizes: Sequence[int], min_views: int = 3
) -> Observations:
    """Points seen in at least `min_views` frames: the features that matches join, directly or by others.

    A point that would be two features of one frame is left out: at least one of its matches is wrong.

    Args:
        matches: rows of features (M, 2) for frames (i, j).
        sizes: number of features of each frame.
        min_views: 2 at least, to triangulate.

    Raises:
        ValueError: frames or features that do not exist, or min_views < 2.
    """
    if min_views < 2:
        raise ValueError(f"min_views: expected 2 or more, got {min_views}")
    starts = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    total = int(starts[-1])
    edges = []
    for (i, j), rows in matches.items():
        if not (0 <= i < len(sizes) and 0 <= j < len(sizes)):
            raise ValueError(f"matches: expected frames below {len(sizes)}, got {(i, j)}")
        array = _pairs(rows, f"matches[{i}, {j}]")
        if (array >= [sizes[i], sizes[j]]).any():
            raise ValueError(f"matches[{i}, {j}]: expected features below {sizes[i]} and {sizes[j]}")
        edges.append(array + [starts[i], starts[j]])
    joined = np.concatenate([*edges, np.empty((0, 2), dtype=np.int64)])
    graph = coo_matrix((np.ones(len(joined), dtype=np.int8), (joined[:, 0], joined[:, 1])), shape=(total, total))
    _, point = connected_components(graph, directed=False)
    frame = np.repeat(np.arange(len(sizes)), sizes)
    feature = np.arange(total) - starts[frame]
    order = np.lexsort((frame, point))
    point, frame, feature = point[order], frame[order], feature[order]
    twice = np.zeros(point.max(initial=-1) + 1, dtype=bool)
    twice[point[1:][(point[1:] == point[:-1]) & (frame[1:] == frame[:-1])]] = True
    kept = ((np.bincount(point, minlength=len(twice)) >= min_views) & ~twice)[point]
    names, point = np.unique(point[kept], return_inverse=True)
    return Observations(point.astype(np.int64), frame[kept], feature[kept], len(names))
