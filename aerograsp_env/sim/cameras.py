"""Pinhole cameras of a MuJoCo model: its own, one that orbits a point, and any other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.interfaces import Intrinsics
from aerograsp_env.spatial import CAMERA_FROM_MUJOCO, as_array, check_transform, transform


@dataclass(frozen=True)
class FreeCamera:
    """A camera that orbits a point, with MuJoCo's free-camera angles but in radians.

    Attributes:
        lookat: the point in the middle of the picture, (3,) world [m].
        distance: from the camera to `lookat` [m].
        azimuth: heading of the line of sight about world z [rad]; 0 looks along +x.
        elevation: of the line of sight over the horizon [rad]; negative looks down.
        fovy: vertical field of view [rad].

    Raises:
        ValueError: a value is not finite or out of range (angles in degrees are caught here).
    """

    lookat: Sequence[float] = (0.0, 0.0, 0.0)
    distance: float = 3.0
    azimuth: float = np.pi / 2
    elevation: float = -np.pi / 6
    fovy: float = np.pi / 4

    def __post_init__(self) -> None:
        lookat = np.asarray(self.lookat, dtype=np.float64)
        if lookat.shape != (3,) or not np.isfinite(lookat).all():
            raise ValueError(f"lookat must be three finite numbers [m], got {self.lookat!r}")
        object.__setattr__(self, "lookat", tuple(lookat.tolist()))
        for name, fits, expected in (
            ("distance", 0 < self.distance < np.inf, "positive [m]"),
            ("azimuth", abs(self.azimuth) <= 4 * np.pi, "within ±4π rad"),
            ("elevation", abs(self.elevation) <= np.pi / 2, "within ±π/2 rad"),
            ("fovy", 0 < self.fovy < np.pi, "between 0 and π rad"),
        ):
            if not fits:
                raise ValueError(f"{name} must be {expected}, got {getattr(self, name)!r}")


class View(NamedTuple):
    """A placed pinhole. Camera axes are MuJoCo's: x right, y up, looking along −z."""

    position: NDArray[np.float64]  # (3,) world [m]
    R_w_c: NDArray[np.float64]  # (3, 3)
    fx: float  # [px]
    fy: float  # [px]
    cx: float  # [px], from the left edge of the image
    cy: float  # [px], from its top edge


Camera = str | int | FreeCamera | View


class Frame(NamedTuple):
    """What one look shows."""

    rgb: NDArray[np.uint8]  # (H, W, 3) sRGB
    depth: NDArray[np.float32]  # (H, W) [m] along the optical axis, 0 where there is no return
    geom: NDArray[np.int32]  # (H, W) id of the geom, −1 where there is none


def pose_view(T_world_camera: ArrayLike, intrinsics: Intrinsics) -> View:
    """The view of a camera at any pose.

    Args:
        T_world_camera: (4, 4), with OpenCV's camera frame: x right, y down, z forward.
        intrinsics: without distortion; the centre of the top left pixel is (0, 0).

    Raises:
        ValueError: a matrix that is not rigid, or intrinsics with distortion, which is not drawn.
    """
    T = check_transform(as_array(T_world_camera, (4, 4), "T_world_camera"), "T_world_camera")
    if T.ndim != 2:
        raise ValueError(f"T_world_camera: expected shape (4, 4), got {T.shape}")
    if intrinsics.distortion is not None and np.any(intrinsics.distortion):
        raise ValueError("intrinsics: expected a camera without distortion, which is not drawn")
    R_w_c = T[:3, :3] @ CAMERA_FROM_MUJOCO[:3, :3]
    f = (intrinsics.fx, intrinsics.fy, intrinsics.cx + 0.5, intrinsics.cy + 0.5)
    return View(T[:3, 3].copy(), R_w_c, *f)


def view_pose(view: View) -> NDArray[np.float64]:
    """T_world_camera (4, 4) of a view, with OpenCV's camera frame."""
    return transform(view.R_w_c @ CAMERA_FROM_MUJOCO[:3, :3], view.position)


def camera_id(model: mujoco.MjModel, camera: Any) -> int:
    names = [model.camera(i).name for i in range(model.ncam)]
    if isinstance(camera, str):
        if camera not in names:
            raise ValueError(f"camera {camera!r} is not in the model; it has {names or 'none'}")
        return names.index(camera)
    if isinstance(camera, bool) or not isinstance(camera, int | np.integer):
        raise ValueError(f"camera must be a name, an id, a FreeCamera or a View, got {camera!r}")
    if not 0 <= camera < model.ncam:
        raise ValueError(f"camera id must lie in [0, {model.ncam}), got {camera}; names: {names}")
    return int(camera)


def camera_view(model: mujoco.MjModel, data: mujoco.MjData, camera: Camera, width: int, height: int) -> View:
    if isinstance(camera, View):
        return camera
    if isinstance(camera, FreeCamera):
        ca, sa = np.cos(camera.azimuth), np.sin(camera.azimuth)
        ce, se = np.cos(camera.elevation), np.sin(camera.elevation)
        forward = np.array([ce * ca, ce * sa, se])
        R_w_c = np.column_stack([[sa, -ca, 0.0], [-se * ca, -se * sa, ce], -forward])
        f = 0.5 * height / np.tan(0.5 * camera.fovy)
        position = np.asarray(camera.lookat) - camera.distance * forward
        return View(position, R_w_c, f, f, 0.5 * width, 0.5 * height)
    cam = camera_id(model, camera)
    if int(model.cam_projection[cam]) != int(mujoco.mjtProjection.mjPROJ_PERSPECTIVE):
        raise ValueError(f"camera {camera!r} is orthographic; only perspective cameras are drawn")
    position, R_w_c = data.cam_xpos[cam].copy(), data.cam_xmat[cam].reshape(3, 3).copy()
    sensor = model.cam_sensorsize[cam].astype(np.float64)  # (2,) [m]
    if (sensor > 0).all():
        focal_x, focal_y, center_x, center_y = model.cam_intrinsic[cam].astype(np.float64)  # [m]
        scale_x, scale_y = width / sensor[0], height / sensor[1]
        cx, cy = 0.5 * width - center_x * scale_x, 0.5 * height - center_y * scale_y
        return View(position, R_w_c, focal_x * scale_x, focal_y * scale_y, cx, cy)
    f = 0.5 * height / np.tan(0.5 * np.deg2rad(model.cam_fovy[cam]))
    return View(position, R_w_c, f, f, 0.5 * width, 0.5 * height)


def open_model(model: mujoco.MjModel | None, data: mujoco.MjData) -> mujoco.MjModel:
    if model is None:
        raise RuntimeError("the renderer is closed")
    if data.geom_xpos.shape[0] != model.ngeom or data.cam_xpos.shape[0] != model.ncam:
        raise ValueError(
            f"data must belong to the renderer's model ({model.ngeom} geoms, {model.ncam} cameras), "
            f"got {data.geom_xpos.shape[0]} and {data.cam_xpos.shape[0]}"
        )
    return model
