"""How a partial cloud and a grasp are written as flat observation and action."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from aerograsp_env.envs.dock_task import ActionDimension
from aerograsp_env.interfaces import Grasp
from aerograsp_env.sim.depth_view import PartialView
from aerograsp_env.sim.gripper import GripperConfig

Array = NDArray[np.float64]
Observation = dict[str, NDArray[np.float32]]

ACTION_SIZE = 10
REACH = 0.25  # [m] of a full action along each axis of the centre
POINT_BOUND, VIEW_BOUND, NOISE_BOUND = 0.5, 1.0, 0.05  # [m]
MIN_AXIS = 1e-3  # length below which an axis says nothing
MIN_WIDTH = 1e-3  # [m] of the narrowest opening


class Cloud(NamedTuple):
    """An observation with its shapes back, float64. A batch of observations adds leading axes."""

    points: Array  # (…, N, 3) [m]
    normals: Array  # (…, N, 3) unit, towards the camera, estimated
    noise: Array  # (…, N) [m] standard deviation of each point along its viewing ray
    viewpoint: Array  # (…, 3) [m] where the camera stands
    count: Any  # (…) int, how many of the points are distinct


def unpack_cloud(observation: Mapping[str, NDArray[Any]]) -> Cloud:
    """The cloud in an observation of `aerograsp/GraspPlan-v0`.

    Raises:
        ValueError: a part that is missing or has another size.
    """
    parts = {}
    for name in ("points", "normals", "noise", "viewpoint", "count"):
        if name not in observation:
            raise ValueError(f"observation: expected points, normals, noise, viewpoint and count, got no {name!r}")
        parts[name] = np.asarray(observation[name], dtype=np.float64)
    size = parts["noise"].shape[-1] if parts["noise"].ndim else 0
    for name, expected in (("points", 3 * size), ("normals", 3 * size), ("viewpoint", 3), ("count", 1)):
        if parts[name].ndim == 0 or parts[name].shape[-1] != expected:
            raise ValueError(f"observation: expected {expected} values of {name!r}, got shape {parts[name].shape}")
    shape = (*parts["noise"].shape, 3)
    count = parts["count"][..., 0].astype(np.int64)
    return Cloud(
        parts["points"].reshape(shape),
        parts["normals"].reshape(shape),
        parts["noise"],
        parts["viewpoint"],
        int(count) if count.ndim == 0 else count,
    )


def pack_cloud(view: PartialView) -> Observation:
    """The observation of what was seen."""
    bounds = (POINT_BOUND, 1.0, VIEW_BOUND)
    points, normals, viewpoint = (
        np.clip(value.ravel(), -bound, bound).astype(np.float32)
        for value, bound in zip((view.points, view.normals, view.viewpoint), bounds, strict=True)
    )
    noise = np.clip(view.noise, 0.0, NOISE_BOUND).astype(np.float32)
    count = np.array([view.distinct], dtype=np.float32)
    return {"points": points, "normals": normals, "noise": noise, "viewpoint": viewpoint, "count": count}


def observation_space(points: int) -> spaces.Dict:
    """Bounded one-dimensional float32 Boxes."""

    def box(low: float, high: float, size: int) -> spaces.Box:
        return spaces.Box(low, high, (size,), np.float32)

    return spaces.Dict(
        points=box(-POINT_BOUND, POINT_BOUND, 3 * points),
        normals=box(-1.0, 1.0, 3 * points),
        noise=box(0.0, NOISE_BOUND, points),
        viewpoint=box(-VIEW_BOUND, VIEW_BOUND, 3),
        count=box(0.0, points, 1),
    )


def action_layout(gripper: GripperConfig) -> tuple[ActionDimension, ...]:
    """The action's dimensions, in order; the width's scale is that of (a + 1) / 2."""
    vectors = (("centre", REACH, "m"), ("closing", 1.0, "direction"), ("approach", 1.0, "direction"))
    axes = tuple(ActionDimension(f"{name}_{axis}", s, unit, "cloud") for name, s, unit in vectors for axis in "xyz")
    return (*axes, ActionDimension("width", gripper.max_width, "m, times (a + 1) / 2", "gripper"))


def decode_action(action: Any, gripper: GripperConfig) -> Grasp | None:
    """The grasp that an action (10,) means, in the cloud's frame; None where its axes are too short or parallel.

    The closing axis is normalised; the approach axis is made orthogonal to it and normalised. Values beyond ±1 count
    as ±1, and an opening below 1 mm as 1 mm.

    Raises:
        ValueError: another shape, or values that are not finite.
    """
    values = np.asarray(action, dtype=np.float64)
    if values.shape != (ACTION_SIZE,):
        raise ValueError(f"action must have shape {(ACTION_SIZE,)}, got {values.shape}")
    if not np.isfinite(values).all():
        raise ValueError(f"action must be finite, got {values.tolist()}")
    values = np.clip(values, -1.0, 1.0)
    closing, length = values[3:6], float(np.linalg.norm(values[3:6]))
    if length <= MIN_AXIS:
        return None
    closing = closing / length
    approach = values[6:9] - closing * (closing @ values[6:9])
    if (length := float(np.linalg.norm(approach))) <= MIN_AXIS:
        return None
    approach = approach / length
    approach -= closing * (closing @ approach)  # once more: a short remainder has lost digits
    width = 0.5 * (values[9] + 1.0) * gripper.max_width
    return Grasp(REACH * values[:3], closing, approach / np.linalg.norm(approach), max(float(width), MIN_WIDTH))


def encode_grasp(grasp: Grasp, gripper: GripperConfig) -> NDArray[np.float32]:
    """The action (10,) that means a grasp in the cloud's frame, to the precision of float32.

    Raises:
        ValueError: a centre or a width that no action can say.
    """
    if np.abs(grasp.center).max() > REACH:
        raise ValueError(f"grasp: expected a centre within ±{REACH} m on every axis, got {grasp.center.tolist()}")
    if not MIN_WIDTH <= grasp.width <= gripper.max_width * (1.0 + 1e-9):
        raise ValueError(f"grasp: expected a width in [{MIN_WIDTH}, {gripper.max_width}] m, got {grasp.width}")
    width = [min(1.0, 2.0 * grasp.width / gripper.max_width - 1.0)]
    return np.concatenate([grasp.center / REACH, grasp.closing_axis, grasp.approach_axis, width]).astype(np.float32)
