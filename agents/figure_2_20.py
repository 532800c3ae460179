"""Thesis figure 2.20: an object too wide for the jaws, which has grasps once a ray's inner folds count."""

from __future__ import annotations

from typing import Any

import numpy as np
import trimesh

from aerograsp_env.sim.gripper import GripperConfig
from agents.pictures import figure_grid, png
from agents.reproduction import Reproduction, Request, text_table
from baselines.grasping import GraspCandidates, grasps_on_mesh
from baselines.objects.mesh import MeshObject

RAYS = 600
ARM, GAP, BASE, HEIGHT, DEPTH = 0.03, 0.07, 0.11, 0.08, 0.12  # [m]

NOTES = """\
A U of {width:.0f} mm outside, its arms {arm:.0f} mm thick and {gap:.0f} mm apart; jaws that open {opening:.0f} mm;
{rays} rays straight through its bounding box. A ray with k folds has k(k + 1)/2 opposed pairs; without folds there is
the outermost one alone. The thesis shows the figure without numbers, dimensions or gripper: these are ours."""


def u_shape() -> MeshObject:
    """The U, open upwards."""
    half, inner = 0.5 * GAP + ARM, 0.5 * GAP
    outline = np.array(
        [[-half, -BASE], [half, -BASE], [half, HEIGHT], [inner, HEIGHT], [inner, 0], [-inner, 0], [-inner, HEIGHT]]
        + [[-half, HEIGHT]]
    )
    count = len(outline)
    front = np.column_stack([outline[:, 0], np.full(count, -0.5 * DEPTH), outline[:, 1]])
    corners = np.concatenate([front, front + [0.0, DEPTH, 0.0]])
    caps = np.array([[0, 1, 4], [0, 4, 5], [1, 2, 3], [1, 3, 4], [0, 5, 6], [0, 6, 7]])
    following = np.roll(np.arange(count), -1)
    sides = [[i, j + count, j] for i, j in enumerate(following)]
    sides += [[i, i + count, j + count] for i, j in enumerate(following)]
    faces = np.concatenate([caps, caps[:, ::-1] + count, sides])
    return MeshObject.from_trimesh(trimesh.Trimesh(corners, faces, process=False))


def run(request: Request, rays: int = RAYS) -> Reproduction:
    """Grasps with and without the inner folds, as numbers and, where asked for, as a picture."""
    mesh, gripper = u_shape(), GripperConfig()
    found = {
        inner: grasps_on_mesh(mesh, gripper, n_rays=rays, inner=inner, pattern="straight", rng=request.seed)
        for inner in (False, True)
    }
    without, with_folds = found[False], found[True]
    reasons = sorted(set(without.reasons) | set(with_folds.reasons))
    rows = [["", "outermost hits", "all folds"]]
    rows += [[name, str(without.counts[name]), str(with_folds.counts[name])] for name in ("rays", "folds", "pairs")]
    rows += [[f"  {name}", str(without.reasons.get(name, 0)), str(with_folds.reasons.get(name, 0))] for name in reasons]
    rows += [["grasps", str(len(without)), str(len(with_folds))]]
    data: dict[str, Any] = {
        "outer_width": GAP + 2.0 * ARM,
        "max_opening": gripper.max_width,
        "rays": rays,
        "outermost": {"grasps": len(without), "counts": dict(without.counts), "reasons": dict(without.reasons)},
        "all_folds": {
            "grasps": len(with_folds),
            "counts": dict(with_folds.counts),
            "reasons": dict(with_folds.reasons),
        },
    }
    notes = NOTES.format(
        width=1e3 * (GAP + 2.0 * ARM), arm=1e3 * ARM, gap=1e3 * GAP, opening=1e3 * gripper.max_width, rays=rays
    )
    text = text_table(rows, 1) + "\n" + notes
    return Reproduction(text, data, _picture(without, with_folds) if request.picture else None)


def _picture(without: GraspCandidates, with_folds: GraspCandidates) -> bytes:
    figure, axes = figure_grid(1, 2, (9.0, 4.8))
    half, inner = 0.5 * GAP + ARM, 0.5 * GAP
    x = [-half, half, half, inner, inner, -inner, -inner, -half]
    z = [-BASE, -BASE, HEIGHT, HEIGHT, 0.0, 0.0, HEIGHT, HEIGHT]
    for axis, found, title in zip(axes, (without, with_folds), ("outermost hits only", "all folds"), strict=True):
        axis.fill(x, z, color="#d8d8d8", ec="#606060")
        for height in np.linspace(-0.9 * BASE, 0.9 * HEIGHT, 8):
            axis.plot([-0.1, 0.1], [height, height], color="red", lw=0.6, alpha=0.6)
        pairs = np.unique(found.positions.reshape(-1, 6), axis=0).reshape(-1, 2, 3)
        for pair in pairs:
            axis.plot(pair[:, 0], pair[:, 2], color="#1f77b4", lw=0.8, marker=".", ms=3)
        axis.set(title=f"{title}: {len(found)} grasps", xlabel="x [m]", ylabel="z [m]", aspect="equal")
        axis.set(xlim=(-0.1, 0.1), xticks=[-0.1, -0.05, 0.0, 0.05, 0.1])
    return png(figure)
