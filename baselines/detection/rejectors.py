"""Pairs of points that registration must not trust: too far, facing elsewhere, of another colour, or taken twice.

The four rejectors of the thesis's section 3.3, equations 3.2 to 3.4.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]


class Pairs(NamedTuple):
    """Correspondences between two clouds."""

    source: Ints  # (M,) rows of the source
    target: Ints  # (M,) rows of the target
    distances: Array  # (M,) [m]

    def keep(self, mask: Mask) -> Pairs:
        return Pairs(self.source[mask], self.target[mask], self.distances[mask])


def hsv_cone(colors: NDArray[np.uint8]) -> Array:
    """Colours (N, 3) uint8 RGB as points (N, 3) of the HSV cone: (s v cos h, s v sin h, v), v in [0, 1].

    Distances in the cone have none of hue's faults: it does not wrap, and it does not jump between greys.
    """
    rgb = np.asarray(colors, dtype=np.float64) / 255.0
    value, least = rgb.max(axis=1), rgb.min(axis=1)
    chroma = value - least  # saturation times value
    safe = np.where(chroma > 0.0, chroma, 1.0)
    r, g, b = rgb.T
    sector = np.select([value == r, value == g], [((g - b) / safe) % 6.0, (b - r) / safe + 2.0], (r - g) / safe + 4.0)
    hue = sector * (np.pi / 3.0)
    return np.stack([chroma * np.cos(hue), chroma * np.sin(hue), value], axis=1)


def reject_distance(pairs: Pairs, limit: float) -> Pairs:
    """Pairs at most `limit` [m] apart (equation 3.2)."""
    return pairs.keep(pairs.distances <= limit)


def reject_normals(pairs: Pairs, source: Array, target: Array, least_cosine: float) -> Pairs:
    """Pairs whose normals (N, 3), (M, 3) have an angle's cosine of at least that, either side out (equation 3.3)."""
    cosines = np.abs(np.einsum("ni,ni->n", source[pairs.source], target[pairs.target]))
    return pairs.keep(cosines >= least_cosine)


def reject_colors(pairs: Pairs, source: Array, target: Array, limit: float) -> Pairs:
    """Pairs whose colours, as points of the HSV cone (N, 3), (M, 3), are at most `limit` apart (equation 3.4)."""
    return pairs.keep(np.linalg.norm(source[pairs.source] - target[pairs.target], axis=1) <= limit)


def reject_shared(pairs: Pairs) -> Pairs:
    """One pair for each target point: the closest; of equal ones, the first."""
    order = np.lexsort((np.arange(len(pairs.target)), pairs.distances, pairs.target))
    first = np.unique(pairs.target[order], return_index=True)[1]
    mask = np.zeros(len(pairs.target), dtype=bool)
    mask[order[first]] = True
    return pairs.keep(mask)
