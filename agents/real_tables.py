"""What is found of real objects, and the lines that say so."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from agents.real_views import PRIORS, Array, Distances, Prior
from agents.statistics import bootstrap_interval, mean, paired_difference


class Grasps(NamedTuple):
    """What `aerograsp plan` says of a file."""

    name: str
    told: str  # what it was told beside the file
    method: str
    found: int
    best: tuple[float, float]  # probability of force closure, largest minimum resisted wrench; NaN where there is none
    reason: str  # why there is none, or "" where there are


class Reconstruction(NamedTuple):
    """Single views of a mesh, by prior."""

    name: str
    size: float  # [m]
    distances: dict[Prior, list[Distances]]


class HalfCloud(NamedTuple):
    """Distances [m] of held-out points to what the others gave, by prior, one mean a split; NaN without a surface."""

    name: str
    points: int
    distances: dict[Prior, list[float]]


def grasp_row(row: Grasps) -> list[str]:
    """Name, what was told, method, number of grasps, the best one's two metrics."""
    pfc, lmrw = ("" if np.isnan(value) else f"{value:.3f}" for value in row.best)
    return [row.name, row.told, row.method, str(row.found), pfc, lmrw]


def _interval(values: Array) -> str:
    """Mean and its interval [mm], of what is a number."""
    known = values[np.isfinite(values)]
    if not len(known):
        return "–"
    low, high = bootstrap_interval(known, statistic=mean)
    return f"{1e3 * known.mean():.1f} [{1e3 * low:.1f}, {1e3 * high:.1f}]"


def view_row(row: Reconstruction) -> list[str]:
    """Name, size, then for each prior Chamfer, far half and lost views, and the paired difference [mm]."""
    cells = [row.name, f"{1e3 * row.size:.0f}"]
    values = {prior: np.array(row.distances[prior]) for prior in PRIORS}  # (views, 2)
    for prior in PRIORS:
        chamfer, far = values[prior].T
        known = np.isfinite(chamfer)
        cells.append(_interval(chamfer))
        if prior == "ellipsoid":
            cells.append(f"{100.0 * chamfer[known].mean() / row.size:.1f}" if known.any() else "–")
        cells += [f"{1e3 * far[known].mean():.1f}" if known.any() else "–", str(int((~known).sum()))]
    return [*cells, _difference(values["ellipsoid"][:, 0], values["constant"][:, 0])]


def all_row(seen: list[Reconstruction]) -> list[str]:
    """The same of the objects' means: objects are resampled, not views."""
    means = {p: np.array([np.nanmean([d.chamfer for d in row.distances[p]]) for row in seen]) for p in PRIORS}
    far = {p: np.nanmean([d.far for row in seen for d in row.distances[p]]) for p in PRIORS}
    lost = {p: sum(bool(np.isnan(d.chamfer)) for row in seen for d in row.distances[p]) for p in PRIORS}
    sizes = np.array([row.size for row in seen])
    cells = [f"all {len(seen)} objects", f"{1e3 * sizes.mean():.0f}"]
    for prior in PRIORS:
        cells.append(_interval(means[prior]))
        if prior == "ellipsoid":
            cells.append(f"{100.0 * np.nanmean(means[prior] / sizes):.1f}")
        cells += [f"{1e3 * far[prior]:.1f}", str(lost[prior])]
    return [*cells, _difference(means["ellipsoid"], means["constant"])]


def _difference(a: Array, b: Array) -> str:
    both = np.isfinite(a) & np.isfinite(b)
    if not both.any():
        return "–"
    found = paired_difference(a[both], b[both])
    low, high = found.interval
    return f"{1e3 * found.estimate:+.1f} [{1e3 * low:+.1f}, {1e3 * high:+.1f}]"


def half_row(row: HalfCloud) -> list[str]:
    """Name, points, and for each prior the mean distance and its range [mm]."""
    cells = [row.name, str(row.points)]
    for prior in PRIORS:
        known = np.array([d for d in row.distances[prior] if np.isfinite(d)])
        lost = len(row.distances[prior]) - len(known)
        shown = f"{1e3 * known.mean():.2f} ({1e3 * known.min():.2f} … {1e3 * known.max():.2f})" if len(known) else "–"
        cells.append(shown + (f", {lost} lost" if lost else ""))
    return cells
