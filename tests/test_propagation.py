"""Matches of all pairs and tracks of points, by hand and against a brute-force closure."""

from __future__ import annotations

import numpy as np
import pytest

from baselines.detection.propagation import observations, propagate


def test_by_hand() -> None:
    matches = propagate([[(0, 1), (1, 0), (2, 2)], [(0, 5), (1, 3)], [(3, 0), (4, 1)]])
    assert sorted(matches) == [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    assert matches[0, 2].tolist() == [[0, 3], [1, 5]]
    assert matches[1, 3].tolist() == [[1, 0]]
    assert matches[0, 3].tolist() == [[0, 0]]


def test_chains_of_points_are_found_in_every_pair() -> None:
    rng = np.random.default_rng(0)
    frames, points = 7, 40
    names = [rng.permutation(points) for _ in range(frames)]  # feature of each point in each frame
    # Point p is seen from frame first[p] to last[p] without a gap.
    first, last = np.sort(rng.integers(0, frames, (2, points)), axis=0)
    visible = [(first <= k) & (k <= last) for k in range(frames)]
    sequential = []
    for k in range(frames - 1):
        both = np.nonzero(visible[k] & visible[k + 1])[0]
        sequential.append(rng.permutation(np.column_stack([names[k][both], names[k + 1][both]])))
    matches = propagate(sequential)
    for (i, j), rows in matches.items():
        both = np.nonzero(visible[i] & visible[j])[0]
        expected = {(int(names[i][p]), int(names[j][p])) for p in both}
        assert {(int(a), int(b)) for a, b in rows} == expected
    tracks = observations(matches, [points] * frames, min_views=3)
    assert tracks.points == ((last - first + 1) >= 3).sum()
    of_feature = {(k, int(names[k][p])): p for k in range(frames) for p in range(points)}
    for track in range(tracks.points):
        rows = tracks.point == track
        seen = {of_feature[int(f), int(r)] for f, r in zip(tracks.frame[rows], tracks.feature[rows], strict=True)}
        assert len(seen) == 1
        p = seen.pop()
        assert tracks.frame[rows].tolist() == list(range(first[p], last[p] + 1))


def test_a_point_that_is_two_features_of_a_frame_is_left_out() -> None:
    good, clash = [(0, 0)], [(1, 1)]
    matches = {(0, 1): good + clash, (1, 2): good + clash, (0, 2): [(0, 0), (1, 2)]}
    tracks = observations(matches, [3, 3, 3])
    assert tracks.points == 1 and tracks.feature.tolist() == [0, 0, 0]


def test_nothing_matched_is_no_points() -> None:
    assert observations(propagate([[], []]), [4, 4, 4]).points == 0
    assert propagate([]) == {}


def test_errors() -> None:
    with pytest.raises(ValueError, match=r"sequential\[0\]: expected every feature at most once"):
        propagate([[(0, 1), (0, 2)]])
    with pytest.raises(ValueError, match=r"sequential\[1\]: expected rows"):
        propagate([[(0, 1)], [(0, 1, 2)]])
    with pytest.raises(ValueError, match="features below 2 and 2"):
        observations({(0, 1): [(0, 2)]}, [2, 2])
    with pytest.raises(ValueError, match="frames below 2"):
        observations({(0, 2): [(0, 1)]}, [2, 2])
    with pytest.raises(ValueError, match="min_views"):
        observations({}, [2, 2], min_views=1)
