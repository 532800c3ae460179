"""Thesis figure 5.15: the quality of the docking tool's reading over its workspace."""

from __future__ import annotations

from typing import Any

import numpy as np

from aerograsp_env.sim.docking_tool import DockingToolConfig
from agents.pictures import figure_grid, png
from agents.reproduction import Reproduction, Request, text_table
from baselines.kinematics import DockingTool

RESOLUTION = 0.01  # [m]

NOTES = """\
Quality: the product over the joints of 1 − |θ − centre| / 75°, which is 0 where a reading saturates; vehicle level,
heading across the pipe; tip positions in the base's frame, the base on top of the pipe. The thesis does not print the
joints' zeros: the centres are the simulator's, {centers}°."""


def run(request: Request, resolution: float = RESOLUTION) -> Reproduction:
    """The map over the whole workspace, its summary, and two sections through the docked pose as a picture."""
    config = DockingToolConfig()
    tool = DockingTool(joint_centers=config.centers, lengths=config.lengths)
    grid = tool.workspace(resolution)
    nominal = np.asarray(config.nominal_tip)
    best = np.unravel_index(int(np.argmax(grid.quality)), grid.quality.shape)
    best_tip = [float(axis[i]) for axis, i in zip(grid[:3], best, strict=True)]
    docked = float(tool.workspace(resolution, bounds=np.stack([nominal, nominal], axis=1)).quality[0, 0, 0])
    reachable = grid.quality > 0.0
    volume = float(reachable.sum()) * resolution**3
    data: dict[str, Any] = {
        "joint_centers": config.centers,
        "resolution": resolution,
        "reachable_volume": volume,
        "best_tip": best_tip,
        "best_quality": float(grid.quality.max()),
        "docked_tip": nominal,
        "docked_quality": docked,
        "mean_quality_where_reachable": float(grid.quality[reachable].mean()),
    }

    def place(tip) -> str:
        return ", ".join(f"{v:+.3f}" for v in tip)

    rows = [
        ["", "value"],
        ["reachable volume [l]", f"{1e3 * volume:.1f}"],
        ["mean quality there", f"{data['mean_quality_where_reachable']:.3f}"],
        ["best quality", f"{data['best_quality']:.3f}"],
        ["  at tip [m]", place(best_tip)],
        ["quality at the docked tip", f"{docked:.3f}"],
        ["  at tip [m]", place(nominal)],
    ]
    centers = ", ".join(f"{v:.0f}" for v in np.degrees(config.centers))
    text = text_table(rows, 1) + "\n" + NOTES.format(centers=centers)
    return Reproduction(text, data, _picture(grid, nominal, best_tip) if request.picture else None)


def _picture(grid: Any, nominal: np.ndarray, best_tip: list[float]) -> bytes:
    figure, (side, top) = figure_grid(1, 2, (10.0, 4.6))
    ix, iz = int(np.argmin(np.abs(grid.x - nominal[0]))), int(np.argmin(np.abs(grid.z - nominal[2])))
    sections = (
        (
            side,
            grid.y,
            grid.z,
            grid.quality[ix].T,
            (1, 2),
            f"across the pipe, x = {grid.x[ix]:.2f} m",
            "y [m]",
            "z [m]",
        ),
        (top, grid.x, grid.y, grid.quality[:, :, iz].T, (0, 1), f"level, z = {grid.z[iz]:.2f} m", "x [m]", "y [m]"),
    )
    image = None
    for axis, u, v, quality, picked, title, across, up in sections:
        shown = np.where(quality > 0.0, quality, np.nan)
        image = axis.pcolormesh(
            u, v, shown, cmap="viridis", vmin=0.0, vmax=float(grid.quality.max()), shading="nearest"
        )
        axis.plot(*(nominal[i] for i in picked), "o", mfc="none", mec="red", ms=9, mew=1.6, label="docked")
        axis.plot(*(best_tip[i] for i in picked), "x", color="black", ms=8, mew=1.6, label="best")
        axis.plot(0.0, 0.0, "s", color="#444444", ms=6, label="base")
        axis.set(title=title, xlabel=across, ylabel=up, aspect="equal")
    side.legend(frameon=False, loc="upper right")
    figure.colorbar(image, ax=[side, top], label="quality", shrink=0.9)
    return png(figure)
