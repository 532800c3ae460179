"""Sections through single views of real objects, and how far their reconstructions are from the truth."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import trimesh

from agents.pictures import figure_grid, png
from agents.real_views import PRIORS, Distances, Prior, reconstruct, view
from agents.statistics import bootstrap_interval, mean
from baselines.objects.mesh import MeshObject

DRAWN = 4  # objects
COLORS = {"truth": "#222222", "ellipsoid": "#1f77b4", "constant": "#d98a1f"}
LIKED = ("CrackerBox", "Mustard", "PowerDrill", "crawler")  # drawn where they are there


def picture(
    meshes: list[tuple[str, MeshObject]], distances: Mapping[str, Mapping[Prior, list[Distances]]], seed: int
) -> bytes | None:
    """PNG; None where there is nothing to draw.

    Args:
        meshes: names and meshes.
        distances: of each of them, by prior.
        seed: of the view that is drawn.
    """
    if not meshes:
        return None
    first = [item for part in LIKED for item in meshes if part in item[0]]
    chosen = [*first, *(item for item in meshes if all(item[0] != f[0] for f in first))][:DRAWN]
    figure, axes = figure_grid(1, DRAWN + 1, (16.0, 4.2))
    for axis in axes[len(chosen) : DRAWN]:
        axis.axis("off")
    for axis, (name, mesh) in zip(axes, chosen, strict=False):
        seen = view(mesh, seed)
        middle = 0.5 * (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0))
        to_eye = (seen.eye - middle) / np.linalg.norm(seen.eye - middle)
        aside = np.cross(to_eye, np.eye(3)[np.abs(to_eye).argmin()])
        aside /= np.linalg.norm(aside)
        plane = np.stack([to_eye, np.cross(aside, to_eye)])  # the camera is to the right
        surfaces: dict[str, trimesh.Trimesh | None] = {"truth": mesh.trimesh}
        surfaces |= {prior: reconstruct(*seen, prior) for prior in PRIORS}
        for label, surface in surfaces.items():
            if surface is None:
                continue
            lines = 1e3 * (trimesh.intersections.mesh_plane(surface, aside, middle) - middle) @ plane.T
            broken = np.concatenate([lines, np.full_like(lines[:, :1], np.nan)], axis=1).reshape(-1, 2)
            axis.plot(*broken.T, color=COLORS[label], lw=2.0 if label == "truth" else 1.3)
        near = np.abs((seen.points - middle) @ aside) < 4e-3
        axis.plot(*(1e3 * (seen.points[near] - middle) @ plane.T).T, ".", color="#c03020", ms=4)
        axis.set(title=name, aspect="equal", xlabel="towards the camera [mm]")
    _bars(axes[DRAWN], distances)
    handles = [axes[0].plot([], [], color=color, label=name)[0] for name, color in COLORS.items()]
    handles += axes[0].plot([], [], ".", color="#c03020", label="seen within 4 mm of the section")
    figure.legend(handles=handles, ncols=4, loc="outside lower center", frameon=False)
    return png(figure)


def _bars(axis: Any, distances: Mapping[str, Mapping[Prior, list[Distances]]]) -> None:
    rows = np.arange(len(distances))[::-1]
    for prior, shift in zip(PRIORS, (0.18, -0.18), strict=True):
        for row, by_prior in zip(rows, distances.values(), strict=True):
            known = np.array([1e3 * d.chamfer for d in by_prior[prior] if np.isfinite(d.chamfer)])
            if len(known):
                axis.plot(bootstrap_interval(known, statistic=mean), [row + shift] * 2, color=COLORS[prior], lw=1.5)
                axis.plot(known.mean(), row + shift, "o", color=COLORS[prior], ms=4)
    axis.set_yticks(rows, [name if len(name) < 20 else name[:19] + "…" for name in distances], fontsize=7)
    axis.set(title="Chamfer distance, 95 %", xlabel="[mm]", xlim=(0.0, None))
