"""Fewer points of a surface, evenly spread: what a process that costs n³ needs."""

import numpy as np

from baselines.objects.linear_algebra import Array


def voxel_downsample(points: Array, voxel: float, normals: Array | None = None) -> tuple[Array, Array]:
    """One point for each occupied cube: the mean of its points, with the mean direction of their normals.

    The two sides of a thin wall may share a cube: points whose normals are more than 90° from that of the cube's first
    point are left out of its mean.

    Args:
        points: (N, D) [m].
        voxel: edge of the cubes [m], > 0.
        normals: (N, D) unit, or None.

    Returns:
        Points (K, D) and normals (K, D); the latter (0, D) without normals.

    Raises:
        ValueError: an edge that is not positive.
    """
    if not 0.0 < voxel < np.inf:
        raise ValueError(f"voxel: expected a positive length [m], got {voxel}")
    cells = np.floor(points / voxel).astype(np.int64)
    _, first, index = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    index = index.ravel()
    if normals is not None:
        alike = np.einsum("nd,nd->n", normals, normals[first][index]) > 0.0
        points, normals, index = points[alike], normals[alike], index[alike]
    counts = np.bincount(index, minlength=len(first))[:, None]

    def mean(values: Array) -> Array:
        return np.column_stack([np.bincount(index, column, len(first)) for column in values.T]) / counts

    if normals is None:
        return mean(points), np.empty((0, points.shape[1]))
    direction = mean(normals)
    return mean(points), direction / np.linalg.norm(direction, axis=1, keepdims=True)
