"""An aligned model as virtual data: its points complete an observed cloud, trusted the less the farther from it.

A model that registration has placed is right near what was seen, and off by the alignment's error elsewhere. So its
points enter the process with the standard deviation

    σ(x_i) = min(σ_align · exp(min_j ‖x_i − x_j^observed‖ / l), σ_max).

Source: thesis eq. 2.12 and figures 2.10 to 2.12. The text leaves out the length l; and without a bound σ would soon
exceed every length of the object, and far points would count for nothing.
"""

from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from baselines.objects.downsampling import voxel_downsample
from baselines.objects.gpis import GPIS
from baselines.objects.linear_algebra import Array
from baselines.objects.observations import check_normals, check_points

Model = TypeVar("Model", bound=GPIS)

LARGEST_FACTOR = 20.0
"""σ_max over σ_align, and the largest factor on the noise of normals, unless told otherwise."""


class MergedData(NamedTuple):
    """Observed points, then the model's, as `GPIS.fit` takes them."""

    points: Array  # (N, 3) [m]
    normals: Array  # (N, 3) unit, outward
    noise: Array  # (N,) standard deviation of the values [m]
    normal_noise: Array  # (N,) standard deviation of a normal's components
    observed: int  # of the points, which come first; the rest are virtual


def aligned_noise(
    model_points: ArrayLike,
    observed_points: ArrayLike,
    alignment_noise: float,
    decay_length: float,
    largest: float | None = None,
) -> Array:
    """σ (M,) [m] of an aligned model's points (M, 3), as above.

    Args:
        model_points: (M, 3) [m], in the frame of the observed ones.
        observed_points: (N, 3) [m], N ≥ 1.
        alignment_noise: σ_align [m], > 0: near what was observed.
        decay_length: l [m], > 0; infinite makes the noise the same everywhere.
        largest: σ_max [m], no less than σ_align; None is twenty times σ_align.

    Raises:
        ValueError: bad points, or a parameter out of its range.
    """
    largest = LARGEST_FACTOR * alignment_noise if largest is None else largest
    if not 0.0 < alignment_noise < np.inf:
        raise ValueError(f"alignment_noise: expected a positive length [m], got {alignment_noise}")
    if not decay_length > 0.0:
        raise ValueError(f"decay_length: expected a positive length [m], got {decay_length}")
    if not alignment_noise <= largest < np.inf:
        raise ValueError(f"largest: expected a length ≥ alignment_noise = {alignment_noise:g} m, got {largest}")
    x, seen = check_points(model_points, "model_points"), check_points(observed_points, "observed_points")
    if len(seen) == 0 or x.shape[1] != seen.shape[1]:
        raise ValueError(f"observed_points: expected shape (N, {x.shape[1]}) with N ≥ 1, got {seen.shape}")
    distance, _ = cKDTree(seen).query(x)
    exponent = np.minimum(distance / decay_length, np.log(largest / alignment_noise))  # never overflows
    return alignment_noise * np.exp(exponent)


def merge_model(
    points: ArrayLike,
    normals: ArrayLike,
    model_points: ArrayLike,
    model_normals: ArrayLike,
    *,
    voxel: float,
    alignment_noise: float,
    decay_length: float,
    noise: float = 1e-3,
    normal_noise: float = 5e-2,
    largest: float | None = None,
) -> MergedData:
    """Observed and virtual data in one set, both thinned to one point per voxel.

    Distances are taken to the whole observed cloud, before thinning. A virtual normal is trusted like its point: its
    noise is `normal_noise` times σ(x_i)/σ_align.

    Args:
        points, normals: (N, 3) [m] and unit, observed.
        model_points, model_normals: (M, 3) [m] and unit, aligned with them.
        voxel: edge of the voxels [m].
        alignment_noise, decay_length, largest: see `aligned_noise`.
        noise: standard deviation of observed points [m].
        normal_noise: of their normals' components.

    Raises:
        ValueError: bad points, normals or parameters, and what `voxel_downsample` refuses.
    """
    x = check_points(points, "points")
    y = check_points(model_points, "model_points")
    seen, seen_normals = voxel_downsample(x, voxel, check_normals(normals, x))
    virtual, virtual_normals = voxel_downsample(y, voxel, check_normals(model_normals, y))
    sigma = aligned_noise(virtual, x, alignment_noise, decay_length, largest)
    return MergedData(
        np.vstack([seen, virtual]),
        np.vstack([seen_normals, virtual_normals]),
        np.concatenate([np.full(len(seen), float(noise)), sigma]),
        np.concatenate([np.full(len(seen), float(normal_noise)), normal_noise * sigma / alignment_noise]),
        len(seen),
    )


def fit_with_model(gp: Model, data: MergedData) -> Model:
    """`gp` fitted to merged data; raises what `GPIS.fit` does."""
    return gp.fit(data.points, data.normals, data.noise, data.normal_noise)
