"""What is true of a picture: which objects it shows, where, and how much of each."""

from __future__ import annotations

import math
from typing import Any, NamedTuple, Protocol

import numba
import numpy as np
from numpy.typing import NDArray

from aerograsp_env.interfaces import Intrinsics
from aerograsp_env.sim.visual.objects import VisualObject
from aerograsp_env.spatial import inverse

Array = NDArray[np.float64]

HIDDEN = 0.4  # share of an object that must be visible, or it is "difficult"
SMALL = 12.0  # [px] that the longer side of its box must have, likewise
NEAR = 0.01  # [m] in front of the camera, where triangles are left out


class _Frame(Protocol):
    @property
    def intrinsics(self) -> Intrinsics: ...

    @property
    def T_world_camera(self) -> Array | None: ...


class _Capture(Protocol):
    @property
    def frame(self) -> Any: ...

    @property
    def segmentation(self) -> NDArray[np.int32]: ...


class Truth(NamedTuple):
    """One object that a picture shows."""

    label: str
    box: Array  # (4,) x1, y1, x2, y2 [px] edges of its visible pixels; the first pixel reaches from 0 to 1
    visibility: float  # share of its silhouette that is in the picture and not behind something else
    T_c_object: Array  # (4, 4)
    index: int  # type: ignore[assignment]  # into the scene's objects; tuple's own `index` is of no use here

    @property
    def difficult(self) -> bool:
        """Whether it is too small or too well hidden to be asked for: neither a merit nor a fault if found."""
        return self.visibility < HIDDEN or max(self.box[2] - self.box[0], self.box[3] - self.box[1]) < SMALL


def truths(capture: _Capture, scene_model: Any) -> list[Truth]:
    """The objects with at least one visible pixel.

    Args:
        capture: with `segmentation` (H, W) of geom ids, and `frame.intrinsics` and `frame.T_world_camera`.
        scene_model: the `SceneModel` it was taken of.

    Raises:
        ValueError: a capture that does not say where its camera was.
    """
    T_w_c = capture.frame.T_world_camera
    if T_w_c is None:
        raise ValueError("capture: expected a frame that knows T_world_camera")
    objects = [placed.object for placed in scene_model.scene.objects]
    poses = [placed.T_world_object for placed in scene_model.scene.objects]
    owner = owners(capture.segmentation, scene_model.geom_object)
    return truths_of(owner, objects, poses, T_w_c, capture.frame.intrinsics)


def owners(segmentation: NDArray[np.integer], geom_object: NDArray[np.integer]) -> NDArray[np.int32]:
    """(H, W) the object that each pixel shows, or −1."""
    table = np.append(geom_object, -1).astype(np.int32)  # geom −1 reads the last
    return table[segmentation]


def truths_of(
    owner: NDArray[np.int32], objects: list[VisualObject], poses: list[Array], T_w_c: Array, intrinsics: Intrinsics
) -> list[Truth]:
    """As `truths`, from the object of every pixel (H, W) and the objects' T_world_object (4, 4)."""
    T_c_w = inverse(T_w_c)
    found = []
    for index, (item, T_w_o) in enumerate(zip(objects, poses, strict=True)):
        mask = owner == index
        rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
        if not rows.size:
            continue
        box = np.array([columns[0], rows[0], columns[-1] + 1, rows[-1] + 1], dtype=np.float64)
        T = T_c_w @ T_w_o
        whole = max(silhouette(item, T, intrinsics), int(mask.sum()))
        found.append(Truth(item.label, box, float(mask.sum()) / whole, T, index))
    return found


def silhouette(item: VisualObject, T_c_object: Array, intrinsics: Intrinsics) -> int:
    """How many pixels the object would fill alone, in a picture twice as wide and high around the same centre."""
    points = item.vertices @ T_c_object[:3, :3].T + T_c_object[:3, 3]
    width, height = 2 * intrinsics.width, 2 * intrinsics.height
    z = np.maximum(points[:, 2], NEAR)
    pixels = points[:, :2] / z[:, None] * (intrinsics.fx, intrinsics.fy)
    pixels += (intrinsics.cx + 0.5 * intrinsics.width, intrinsics.cy + 0.5 * intrinsics.height)
    triangles = pixels[item.faces]
    sound = (points[item.faces, 2] > NEAR).all(axis=1)
    a, b = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    sound &= a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0] < 0.0  # those that face the camera cover what the others do
    return int(_count_pixels(np.ascontiguousarray(triangles[sound]), width, height))


@numba.njit(cache=True)
def _count_pixels(triangles, width, height):
    """How many pixels have their centres in one of the triangles (N, 3, 2) [px] or more."""
    canvas = np.zeros((height, width), np.uint8)
    for i in range(len(triangles)):
        x0, y0 = triangles[i, 0]
        x1, y1 = triangles[i, 1]
        x2, y2 = triangles[i, 2]
        top, low = max(math.ceil(min(y0, y1, y2)), 0), min(math.floor(max(y0, y1, y2)), height - 1)
        left, right = max(math.ceil(min(x0, x1, x2)), 0), min(math.floor(max(x0, x1, x2)), width - 1)
        for y in range(top, low + 1):
            for x in range(left, right + 1):
                if (
                    (x1 - x0) * (y - y0) - (y1 - y0) * (x - x0) <= 0.0
                    and (x2 - x1) * (y - y1) - (y2 - y1) * (x - x1) <= 0.0
                    and (x0 - x2) * (y - y2) - (y0 - y2) * (x - x2) <= 0.0
                ):
                    canvas[y, x] = 1
    return canvas.sum()
