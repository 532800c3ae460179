"""Grasps of straight bars, such as handles, that belong to a known object."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from aerograsp_env.sim.gripper import GripperConfig
from baselines.grasping.candidates import THINNEST, approach_axes, note
from baselines.grasping.contacts import Array, finite
from baselines.grasping.on_model import LEVER, ModelGrasps, openings, volume_center

END = 0.15  # of a bar's length at either end that is left out


def grasps_on_bars(
    bars: Sequence[tuple[ArrayLike, ArrayLike, float]],
    points: ArrayLike,
    normals: ArrayLike,
    gripper: GripperConfig | None = None,
    support: tuple[ArrayLike, ArrayLike] | None = None,
    *,
    places: int = 9,
    approaches: int = 16,
    room: float = 0.004,
    depth: float = 0.004,
) -> ModelGrasps:
    """Grasps across round bars, in the object's frame; see `grasps_on_model`.

    Args:
        bars: start (3,), end (3,) and radius of each [m].
        points: (N, 3) of the whole object's surface [m], as densely as the fingers' width.
        normals: (N, 3) unit, outward.
        gripper: None is `GripperConfig()`.
        support: a point (3,) of the plane the object stands on and its normal (3,).
        places: along each bar.
        approaches: about each bar.
        room: around fingers and palm on the approach [m].
        depth: of the pads' middle beyond the bar's [m]: a bar that lies too deep is still between the fingers.

    Raises:
        ValueError: a bar without length, one that the jaws do not go around, or points that are no (N, 3) numbers.
    """
    gripper = GripperConfig() if gripper is None else gripper
    p, n = finite("points", points, (-1, 3)), finite("normals", normals, (-1, 3))
    middles, axes, widths = [], [], []
    for start, end, radius in bars:
        a, b = finite("bars", start, (3,)), finite("bars", end, (3,))
        length = float(np.linalg.norm(b - a))
        if length <= 0.0 or not THINNEST < 2.0 * radius < gripper.max_width:
            raise ValueError(f"bars: expected a length and a radius that the jaws go around, got {length}, {radius}")
        share = np.linspace(END, 1.0 - END, places)[:, None]
        middles.append(a + share * (b - a))
        axes.append(np.tile((b - a) / length, (places, 1)))
        widths.append(np.full(places, 2.0 * radius))
    along, approach = approach_axes(np.concatenate(axes), approaches)
    middle = np.repeat(np.concatenate(middles), approaches, axis=0)
    width = np.repeat(np.concatenate(widths), approaches)
    # y of the gripper lies along the bar, and the fingers close across it
    frames = np.stack([np.cross(along, approach), along, approach], axis=2)
    middle = middle + depth * approach
    plane = None if support is None else (finite("support", support[0], (3,)), finite("support", support[1], (3,)))
    opening, reason = openings(gripper, p, middle, frames, width, plane, room)
    reasons: Counter[str] = Counter()
    note(reasons, {"no room": (reason == 1).sum(), "support": (reason == 2).sum()})
    free = opening > 0.0
    T = np.zeros((int(free.sum()), 4, 4))
    T[:, :3, :3], T[:, :3, 3], T[:, 3, 3] = frames[free], middle[free], 1.0
    center = volume_center(p, n)
    arm = center - middle[free]
    closing = frames[free][:, :, 0]
    lever: Array = np.linalg.norm(arm - np.einsum("gi,gi->g", arm, closing)[:, None] * closing, axis=1)
    found = ModelGrasps(T, width[free], opening[free], -LEVER * lever, lever, center, dict(reasons))
    return found.take(np.argsort(lever, kind="stable"))
