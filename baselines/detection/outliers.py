"""Statistical removal of stray points."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.detection.checks import check_points
from baselines.objects.sampling import inliers


def remove_outliers(points: Any, neighbors: int = 16, ratio: float = 2.0) -> NDArray[np.bool_]:
    """Which points to keep: those no farther from their neighbours than is usual in the cloud. Thesis, section 3.2.

    A point stays when its mean distance to its nearest `neighbors` is within `ratio` standard deviations of the mean
    over the cloud (Rusu et al. 2008, "Towards 3D point cloud based object maps", section 4.1).

    Args:
        points: (N, 3) [m], more than `neighbors` of them.
        neighbors: how many nearest points count.
        ratio: standard deviations above the mean that are still allowed.

    Returns:
        (N,) mask, true for the points to keep.

    Raises:
        ValueError: too few points, values that are not finite, or arguments out of range.
    """
    if neighbors < 1:
        raise ValueError(f"neighbors: expected at least 1, got {neighbors}")
    return inliers(check_points(points, least=neighbors + 1), neighbors, ratio)
