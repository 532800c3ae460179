"""Pictures of scenes in which nothing moves, cast by Embree instead of MuJoCo: the same light, three to eight times faster.

Rays meet the triangles of the objects, the grounds' boxes and cylinders as triangles too, and planes as large squares.
Shading is the ray renderer's own; depth differs from its by less than 0.1 mm at 2 m (Embree computes in single
precision).
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from aerograsp_env.interfaces import Intrinsics
from aerograsp_env.sim import ray_renderer
from aerograsp_env.sim.cameras import Frame, pose_view
from aerograsp_env.sim.visual.scene_mjcf import SceneModel
from aerograsp_env.sim.visual.solids import Solid, box, lathe

Array = NDArray[Any]

_FAR = 60.0  # [m] half-side of the square that stands for a plane
_LIFT = 2e-5  # [m] by which shadow rays start off their surface, plus a millionth of its distance


class SceneRenderer(ray_renderer.RayRenderer):
    """Draws one scene model; its lights may change, its things may not."""

    def __init__(self, scene_model: SceneModel, width: int, height: int):
        model = scene_model.model
        super().__init__(model, width, height, 1, np.ones(mujoco.mjNGROUP, np.uint8))
        from embreex import rtcore_scene
        from embreex.mesh_construction import TriangleMesh

        self._embree = rtcore_scene.EmbreeScene()
        self._keep = []
        for triangles in _triangles(scene_model):
            self._keep.append(TriangleMesh(self._embree, np.ascontiguousarray(triangles, dtype=np.float32)))

    def frame_at(self, data: mujoco.MjData, T_world_camera: Array, intrinsics: Intrinsics) -> Frame:
        """Colour, depth and geom ids from a pose (4, 4)."""
        return self.frame(data, pose_view(T_world_camera, intrinsics))

    def _cast(
        self, model: mujoco.MjModel, data: mujoco.MjData, origin: Array, rays: Array, normals: bool = True
    ) -> ray_renderer._Hits:
        count = len(rays)
        if not count:
            return ray_renderer._Hits(np.empty(0, np.int32), np.empty(0), np.empty((0, 3)))
        if not normals:
            return self._shadows(np.asarray(origin), rays)
        start = np.broadcast_to(np.asarray(origin, np.float32), (count, 3)).copy()
        found = self._embree.run(start, rays.astype(np.float32), output=True)
        geom = np.where(found["primID"] >= 0, found["geomID"], -1).astype(np.int32)
        normal = found["Ng"].astype(np.float64)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
        return ray_renderer._Hits(geom, found["tfar"].astype(np.float64), np.ascontiguousarray(normal))

    def _shadows(self, source: Array, rays: Array) -> ray_renderer._Hits:
        """Rays from a light, cast the other way round: the light may be too far off for single precision."""
        length = np.sqrt(np.einsum("ij,ij->i", rays, rays))[:, None]
        back = -rays / length
        start = source + rays + (_LIFT + 1e-6 * np.minimum(length, 10.0)) * back
        reach = np.minimum(length[:, 0], 4.0 * _FAR).astype(np.float32)
        free = self._embree.run(start.astype(np.float32), back.astype(np.float32), dists=reach, query="OCCLUDED")
        return ray_renderer._Hits(np.where(free < 0, -1, 0).astype(np.int32), np.zeros(len(rays)), np.empty((0, 3)))


def _triangles(scene_model: SceneModel) -> list[Array]:
    """(F, 3, 3) [m] world triangles of every geom of the model, in its order."""
    scene, found = scene_model.scene, []
    for ground in scene.grounds:
        solid = _ground_solid(ground.shape, ground.size)
        T = ground.T_world_ground
        found.append((solid.vertices @ T[:3, :3].T + T[:3, 3])[solid.faces])
    for placed in (*scene.objects, *scene.distractors):
        T = placed.T_world_object
        for part in placed.object.parts:
            found.append((part.vertices @ T[:3, :3].T + T[:3, 3])[part.faces])
    return found


def _ground_solid(shape: str, size: tuple[float, float, float]) -> Solid:
    if shape == "plane":
        corners = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]) * _FAR
        return Solid(np.column_stack([corners, np.zeros(4)]), np.array([[0, 1, 2], [0, 2, 3]], np.int32))
    if shape == "box":
        return box([2.0 * side for side in size])
    return lathe([(-size[1], size[0]), (size[1], size[0])], axis=2, sides=96)
