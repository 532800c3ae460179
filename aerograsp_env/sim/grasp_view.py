"""Pictures of a grasp: the object and what was seen of it, and the gripper in the judgement, in the cloud's frame."""

from __future__ import annotations

import math
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim.cameras import FreeCamera, camera_view
from aerograsp_env.sim.depth_view import PartialView, look_at, middle_and_radius
from aerograsp_env.sim.grasp_judge import Recording
from aerograsp_env.sim.gripper import GripperConfig
from aerograsp_env.sim.objects import GraspObject
from aerograsp_env.sim.rendering import make_renderer
from aerograsp_env.spatial import quat_wxyz_from_matrix, transform_points

Array = NDArray[np.float64]

CAMERAS: dict[str, tuple[float, float, float]] = {  # azimuth from the depth camera's, elevation [rad], distance [m]
    "side": (math.radians(40.0), math.radians(-22.0), 0.75),
    "front": (math.radians(-50.0), math.radians(-12.0), 0.75),
    "view": (0.0, math.nan, 0.5),  # where the depth camera stands, at its elevation
}
_FOVY = math.radians(36.0)
_FLOOR = 0.40  # [m] below the object
_BORDER = 1.06  # of a picture around all that moves in it
_LOOKS = 30  # moments of a judgement at which it is seen to that all is in the picture
_POINT_COLOR = np.array([20, 200, 230], dtype=np.uint8)
_CORNERS = np.array([[i, j, k] for i in (-1.0, 1.0) for j in (-1.0, 1.0) for k in (-1.0, 1.0)])
_HIDDEN = (0.0, 0.0, -100.0)  # where what is not in the picture goes [m]


class GraspView:
    """Draws one object, and one gripper where there is one.

    Args:
        item, gripper: what is drawn.
        seen: the view that the episode began with; its camera's azimuth is where azimuths count from.
        width, height: of the pictures [px].
        camera: a name of `CAMERAS`.
        backend, samples: as for `make_renderer`.
    """

    def __init__(
        self,
        item: GraspObject,
        gripper: GripperConfig,
        seen: PartialView,
        width: int,
        height: int,
        camera: str,
        backend: str = "ray",
        samples: int = 1,
    ) -> None:
        self._gripper, self._seen, self._size = gripper, seen, (width, height)
        self._vertices = item.vertices
        self._model = _look_model(item, gripper, seen, width, height)
        self._data = mujoco.MjData(self._model)
        self._renderer = make_renderer(self._model, width, height, backend, samples)
        middle, _ = middle_and_radius(item)
        self._middle = transform_points(seen.T_cloud_object, middle)
        line = self._middle - seen.viewpoint
        turn, elevation, distance = CAMERAS[camera]
        if math.isnan(elevation):
            elevation = math.atan2(line[2], math.hypot(line[0], line[1]))
        azimuth = math.remainder(math.atan2(line[1], line[0]) + turn, 2.0 * math.pi)
        self._angles = distance, azimuth, elevation

    def before(self, mode: str) -> NDArray[Any]:
        """The object with the points that were seen: (H, W, 3) uint8, or (H, W) float32 depth [m]."""
        self._place(self._seen.T_cloud_object, None, 0.0)
        distance, azimuth, elevation = self._angles
        camera = FreeCamera(tuple(self._middle.tolist()), distance, azimuth, elevation, _FOVY)
        if mode == "depth_array":
            return self._renderer.depth(self._data, camera)
        picture = self._renderer.render(self._data, camera)
        self._paint_points(picture, camera)
        return picture

    def during(self, recording: Recording, index: int, mode: str) -> NDArray[Any]:
        """A moment of a judgement, from where all of it is seen: (H, W, 3) uint8, or (H, W) float32 depth [m]."""
        return self._moment(recording, index, mode, self.framing(recording))

    def film(self, recording: Recording, fps: float) -> list[NDArray[np.uint8]]:
        """All of a judgement, `fps` pictures (H, W, 3) a second."""
        times = np.arange(recording.times[0], recording.times[-1] + 0.5 / fps, 1.0 / fps)
        rows = np.minimum(np.searchsorted(recording.times, times), len(recording.times) - 1)
        camera = self.framing(recording)
        return [self._moment(recording, int(row), "rgb_array", camera) for row in rows]

    def framing(self, recording: Recording) -> FreeCamera:
        """The camera in whose picture object and gripper stay from the approach to the end.

        It looks along the same line as `before`, from no nearer.
        """
        nearest, azimuth, elevation = self._angles
        level = math.cos(elevation)
        R = look_at(np.array([level * math.cos(azimuth), level * math.sin(azimuth), math.sin(elevation)]))
        boxes = self._gripper.boxes(self._gripper.max_width)
        corners = np.concatenate([box.center + _CORNERS * box.half_size for box in boxes])
        looks = np.linspace(0, len(recording.times) - 1, _LOOKS).astype(np.intp)
        local = np.concatenate(
            [
                (points @ T[:3, :3].T + T[:3, 3]) @ R
                for points, poses in ((self._vertices, recording.T_object), (corners, recording.T_gripper))
                for T in poses[looks]
            ]
        )
        middle = 0.5 * (local.min(axis=0) + local.max(axis=0))
        right, down, ahead = np.abs(local[:, 0] - middle[0]), np.abs(local[:, 1] - middle[1]), local[:, 2] - middle[2]
        width, height = self._size
        slope = math.tan(0.5 * _FOVY)
        needed = _BORDER * np.maximum(right * height / width, down) / slope - ahead
        return FreeCamera(tuple((R @ middle).tolist()), max(nearest, float(needed.max())), azimuth, elevation, _FOVY)

    def close(self) -> None:
        """Free the renderer."""
        self._renderer.close()

    def _moment(self, recording: Recording, index: int, mode: str, camera: FreeCamera) -> NDArray[Any]:
        self._place(recording.T_object[index], recording.T_gripper[index], float(recording.width[index]))
        if mode == "depth_array":
            return self._renderer.depth(self._data, camera)
        return self._renderer.render(self._data, camera)

    def _place(self, T_object: Array, T_gripper: Array | None, width: float) -> None:
        data, half = self._data, 0.5 * (self._gripper.max_width - width)
        for name, T, inward in (
            ("object", T_object, 0.0),
            ("palm", T_gripper, 0.0),
            ("left", T_gripper, half),
            ("right", T_gripper, -half),
        ):
            row = self._model.body(name).mocapid[0]
            if T is None:
                data.mocap_pos[row] = _HIDDEN
            else:
                data.mocap_pos[row] = T[:3, 3] + inward * T[:3, 0]
                data.mocap_quat[row] = quat_wxyz_from_matrix(T[:3, :3])
        mujoco.mj_kinematics(self._model, data)
        mujoco.mj_camlight(self._model, data)

    def _paint_points(self, picture: NDArray[np.uint8], camera: FreeCamera) -> None:
        """Dots where the seen points are, unless the object hides them."""
        width, height = self._size
        view = camera_view(self._model, self._data, camera, width, height)
        local = (self._seen.points - view.position) @ view.R_w_c
        depth = -local[:, 2]
        column = np.floor(view.fx * local[:, 0] / depth + view.cx).astype(np.intp)
        row = np.floor(view.cy - view.fy * local[:, 1] / depth).astype(np.intp)
        inside = (row >= 0) & (row < height - 1) & (column >= 0) & (column < width - 1) & (depth > 0.0)
        row, column, depth = row[inside], column[inside], depth[inside]
        surface = self._renderer.depth(self._data, camera)[row, column]
        shown = (surface == 0.0) | (depth < surface + 0.008)
        for down in (0, 1):
            for right in (0, 1):
                picture[row[shown] + down, column[shown] + right] = _POINT_COLOR


def _look_model(
    item: GraspObject, gripper: GripperConfig, seen: PartialView, width: int, height: int
) -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    spec.visual.global_.offwidth, spec.visual.global_.offheight = max(width, 640), max(height, 480)
    floor = spec.add_texture(
        name="floor",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=[0.60, 0.62, 0.64],
        rgb2=[0.52, 0.54, 0.56],
        width=128,
        height=128,
    )
    material = spec.add_material(name="floor", texuniform=True, texrepeat=[4.0, 4.0])
    material.textures[int(mujoco.mjtTextureRole.mjTEXROLE_RGB)] = floor.name
    for name, rgba, specular in (
        ("object", (0.90, 0.55, 0.20, 1.0), 0.3),
        ("palm", (0.20, 0.22, 0.25, 1.0), 0.5),
        ("finger", (0.42, 0.50, 0.62, 1.0), 0.8),
        ("pad", (0.10, 0.10, 0.11, 1.0), 0.1),
    ):
        spec.add_material(name=name, rgba=rgba, specular=specular)
    world = spec.worldbody
    world.add_light(name="sun", type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, pos=[0, 0, 3], dir=[-0.4, -0.3, -0.85])
    low = float(transform_points(seen.T_cloud_object, item.vertices)[:, 2].min()) - _FLOOR
    seen_only = {"contype": 0, "conaffinity": 0}
    world.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0, 0, 0.1],
        pos=[0, 0, low],
        material="floor",
        **seen_only,
    )
    for name in ("object", "palm", "left", "right"):
        world.add_body(name=name, mocap=True)
    for box in gripper.boxes(gripper.max_width):
        body, _, part = box.name.partition("_")
        spec.body(body).add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX, pos=box.center, size=box.half_size, material=part or "palm", **seen_only
        )
    for i, piece in enumerate(item.pieces):
        spec.add_mesh(
            name=f"piece_{i}",
            uservert=np.asarray(piece.vertices, dtype=np.float64).ravel(),
            userface=np.asarray(piece.faces, dtype=np.int32).ravel(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX,
        )
        spec.body("object").add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"piece_{i}", material="object", **seen_only
        )
    return spec.compile()
