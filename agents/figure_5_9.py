"""Thesis figure 5.9: where the two arms of the aerial manipulator reach, and from how many sides."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim.arms.vehicles import BELEROFONTE_ARMS
from agents.pictures import figure_grid, png
from agents.reproduction import Reproduction, Request, text_table
from baselines.kinematics import Arm, approach_directions, reachability

Array = NDArray[np.float64]

RESOLUTION, FINE = 0.05, 0.02  # [m] of the volumes, of the picture
DIRECTIONS = 32
SECTION_Z = -0.35  # [m] of the level section: where grasps are
DOWN, FORWARD = [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]

NOTES = """\
Two six-joint arms under {vehicle}, body frame (x forward, y left, z up), bases at y = {right:+.2f} and {left:+.2f} m.
Served is a direction in which some configuration within the joint limits holds the tool, by the closed form, with any
of eight rolls; of {directions} over the whole sphere. Volumes on a grid of {grid:.0f} mm. Kinematics alone: the
airframe and the other arm are not in the way. The thesis shows the figure without scale or numbers."""


def run(request: Request, resolution: float = RESOLUTION, fine: float = FINE) -> Reproduction:
    """Volumes of each arm and of both, and three sections as a picture."""
    arms = {m.side: Arm.from_config(m.arm, m.T_body_base) for m in BELEROFONTE_ARMS.mounts}
    bases = {side: arm.T_base[:3, 3] for side, arm in arms.items()}
    grid = _grid(arms, resolution)
    around, single = approach_directions(DIRECTIONS), np.array([DOWN, FORWARD])
    maps = {side: reachability(arm, *grid, np.concatenate([around, single])) for side, arm in arms.items()}
    data: dict[str, Any] = {"resolution": resolution, "directions": DIRECTIONS, "bases": bases, "volumes": {}}
    rows = [["volume [l]", *arms, "both"]]
    for name, test in (
        ("any direction served", lambda m: m.served[..., :DIRECTIONS].any(axis=-1)),
        ("a quarter of them", lambda m: m.served[..., :DIRECTIONS].mean(axis=-1) >= 0.25),
        ("straight down", lambda m: m.served[..., DIRECTIONS]),
        ("straight ahead", lambda m: m.served[..., DIRECTIONS + 1]),
    ):
        inside: dict[str, Any] = {side: test(found) for side, found in maps.items()}
        inside["both"] = np.logical_and.reduce(list(inside.values()))
        volumes = {side: 1e3 * resolution**3 * float(np.sum(cells)) for side, cells in inside.items()}
        data["volumes"][name] = volumes
        rows.append([name, *(f"{volume:.0f}" for volume in volumes.values())])
    notes = NOTES.format(
        vehicle=BELEROFONTE_ARMS.name,
        right=bases["right"][1],
        left=bases["left"][1],
        directions=DIRECTIONS,
        grid=1e3 * resolution,
    )
    return Reproduction(text_table(rows, 1) + "\n" + notes, data, _picture(arms, fine) if request.picture else None)


def _grid(arms: dict[Any, Arm], step: float) -> tuple[Array, Array, Array]:
    """Multiples of the step, along each axis, that hold all that the arms reach."""
    shoulders = np.array([arm.T_base[:3, 3] for arm in arms.values()])
    reach = max(arm.length for arm in arms.values()) + 0.1  # the first joint is not in the base
    low, high = np.floor((shoulders.min(axis=0) - reach) / step), np.ceil((shoulders.max(axis=0) + reach) / step)
    x, y, z = (step * np.arange(a, b + 1) for a, b in zip(low, high, strict=True))
    return x, y, z


def _picture(arms: dict[Any, Arm], step: float) -> bytes:
    figure, panels = figure_grid(1, 3, (13.0, 4.6))
    x, y, z = _grid(arms, step)
    right = arms["right"].T_base[:3, 3]
    sections = (
        ("xz", (x, right[1:2], z), ["right"], f"beside the right arm's base, y = {right[1]:+.2f} m"),
        ("yz", (right[:1], y, z), list(arms), f"across, x = {right[0]:+.2f} m"),
        ("xy", (x, y, np.array([SECTION_Z])), list(arms), f"level, z = {SECTION_Z:+.2f} m"),
    )
    image = None
    for panel, (plane, axes, sides, title) in zip(panels, sections, strict=True):
        maps = {side: reachability(arms[side], *axes, approach_directions(DIRECTIONS)) for side in sides}
        u, v = (axes["xyz".index(letter)] for letter in plane)
        shares = [np.squeeze(found.share).T for found in maps.values()]
        best = np.maximum.reduce(shares)
        image = panel.pcolormesh(
            u, v, np.where(best > 0.0, best, np.nan), cmap="viridis", vmin=0.0, vmax=0.5, shading="nearest"
        )
        if len(shares) > 1:
            both = np.minimum.reduce(shares) > 0.0
            panel.contour(u, v, both.astype(float), levels=[0.5], colors="red", linewidths=1.2)

        for side in sides:
            base = arms[side].T_base[:3, 3]
            panel.plot(*(base["xyz".index(letter)] for letter in plane), "s", color="black", ms=5)
        panel.plot(0.0, 0.0, "+", color="black", ms=9)
        panel.set(title=title, xlabel=f"{plane[0]} [m]", ylabel=f"{plane[1]} [m]", aspect="equal")
        seen = np.argwhere(best.T > 0.0)
        (left, low), (right_end, high) = seen.min(axis=0), seen.max(axis=0)
        panel.set(xlim=(u[left] - 0.05, u[right_end] + 0.05), ylim=(v[low] - 0.05, v[high] + 0.05))
    panels[0].plot([], [], color="red", lw=1.2, label="both arms reach")
    panels[0].plot([], [], "s", ls="", color="black", ms=5, label="base of an arm")
    panels[0].plot([], [], "+", ls="", color="black", ms=9, label="body frame")
    figure.legend(frameon=False, loc="outside lower center", ncols=3)
    figure.colorbar(image, ax=panels, label="share of directions served", extend="max", shrink=0.85)
    return png(figure)
