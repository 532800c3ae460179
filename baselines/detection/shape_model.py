"""An object's surface, prepared for fast alignment: what lies nearest to any place is looked up, not searched."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from aerograsp_env.spatial import as_array, check_rotation
from baselines.detection.checks import check_points
from baselines.objects.normals import estimate_normals

Array = NDArray[np.float64]

LEAST = 10
"""Fewest points of a model."""
CELLS = 56
"""Cells along the longest side of the look-up grid."""
MARGIN = 0.3
"""How far the grid goes beyond the model on each side, as a fraction of the diameter."""
UNIT_TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False)
class ShapeModel:
    """Points of a whole surface with outward normals, and the turns that leave it as it is.

    Raises:
        ValueError: fewer than ten points, shapes that do not match, values that are not finite, normals that are not
            of unit length (to 1e-6), symmetries that are not rotations, or
            a stretch below 1.
    """

    points: Array  # (N, 3) [m] in the object's frame
    normals: Array  # (N, 3) unit, outward
    symmetries: Array | None = None  # (K, 3, 3) rotations about the origin, the identity among them; None: no symmetry
    stretch: float = 1.0  # an instance's size along each axis is up to this many times the model's, or its inverse
    diameter: float = field(init=False, repr=False)  # [m] of the bounding box
    origin: Array = field(init=False, repr=False)  # (3,) [m] the grid's first corner
    cell: float = field(init=False, repr=False)  # [m]
    nearest: NDArray[np.int32] = field(init=False, repr=False)  # (X, Y, Z) the point nearest to each cell's middle

    def __post_init__(self) -> None:
        points = check_points(self.points, "points", LEAST)
        normals = as_array(self.normals, (3,), "normals")
        if normals.shape != points.shape:
            raise ValueError(f"normals: expected shape {points.shape} like the points, got {normals.shape}")
        off = np.abs(np.linalg.norm(normals, axis=1) - 1.0).max()
        if off > UNIT_TOLERANCE:
            raise ValueError(f"normals: expected unit length (to {UNIT_TOLERANCE:g}), got one off by {off:.3g}")
        symmetries = np.eye(3)[None] if self.symmetries is None else check_rotation(self.symmetries, "symmetries")
        if symmetries.ndim != 3 or not len(symmetries):
            raise ValueError(f"symmetries: expected shape (K, 3, 3), got {symmetries.shape}")
        if not 1.0 <= self.stretch < np.inf:
            raise ValueError(f"stretch: expected a ratio of at least 1, got {self.stretch}")
        extents = np.ptp(points, axis=0)
        diameter = float(np.linalg.norm(extents))
        if diameter <= 0.0:
            raise ValueError("points: expected some that span an object, got all at one place")
        origin = points.min(axis=0) - MARGIN * diameter
        cell = float(extents.max() + 2.0 * MARGIN * diameter) / CELLS
        shape = np.ceil((extents + 2.0 * MARGIN * diameter) / cell).astype(int)
        middles = np.stack(np.meshgrid(*(cell * (np.arange(n) + 0.5) for n in shape), indexing="ij"), axis=-1)
        nearest = cKDTree(points).query(origin + middles)[1].astype(np.int32)
        values: dict[str, Any] = {"points": points, "normals": np.ascontiguousarray(normals), "symmetries": symmetries}
        values |= {"diameter": diameter, "origin": origin, "cell": cell, "nearest": nearest}
        for name, value in values.items():
            if isinstance(value, np.ndarray):
                value = value.view()
                value.setflags(write=False)
            object.__setattr__(self, name, value)


def shape_model(model: Any) -> ShapeModel:
    """A model from what callers have: a `ShapeModel`, points with normals as a pair, or points alone.

    Points alone get normals from their neighbours, away from the middle: right for shapes that are roughly convex.

    Raises:
        ValueError: as `ShapeModel`.
    """
    if isinstance(model, ShapeModel):
        return model
    if isinstance(model, tuple) and len(model) == 2:
        return ShapeModel(*model)
    points = check_points(model, "model", LEAST)
    found = estimate_normals(points, points.mean(axis=0), min(20, len(points)))
    if not found.valid.any():
        raise ValueError("model: expected points that span a surface, got none with a normal")
    return ShapeModel(points[found.valid], -found.normals[found.valid])
