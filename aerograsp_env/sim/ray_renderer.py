"""The renderer by ray casting; `aerograsp_env.sim.rendering` says what it draws and what it leaves out."""

from __future__ import annotations

from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim import ray_kernel as kernel
from aerograsp_env.sim.cameras import Camera, Frame, View, camera_view, open_model
from aerograsp_env.sim.ray_cast import Hits, Shapes, cast, in_shadow, shapes_of
from aerograsp_env.sim.ray_mesh import meshes_of
from aerograsp_env.sim.ray_textures import Covers, lay_textures, read_corners, read_textures
from aerograsp_env.sim.shading import SRGB_OF_LINEAR, Sky, geom_colors, gloss, lights_of, sky_of

Array = NDArray[Any]


class _Scene(NamedTuple):
    """What stays the same over the passes of one picture."""

    model: mujoco.MjModel
    data: mujoco.MjData
    view: View
    rgba: NDArray[np.float32]  # (ngeom, 4), linear RGB and opacity
    gloss: NDArray[np.float32]  # (ngeom, 2)
    covers: Covers
    sky: Sky


class RayRenderer:
    """Renderer by ray casting; see `aerograsp_env.sim.rendering`."""

    backend = "ray"

    def __init__(self, model: mujoco.MjModel, width: int, height: int, samples: int, groups: NDArray[np.uint8]):
        self.width, self.height = width, height
        self._model: mujoco.MjModel | None = model
        self._samples = samples
        self._groups = groups
        self._textures = read_textures(model)
        self._corners = read_corners(model)
        self._meshes = meshes_of(model)

    def close(self) -> None:
        """Drop the model; drawing afterwards raises RuntimeError."""
        self._model = None

    def frame(self, data: mujoco.MjData, camera: Camera, *, depth_only: bool = False) -> Frame:
        """Colour, depth and geom ids of one look, from one cast of rays through the pixels' centres.

        With `samples` > 1 the colours come from samples² casts; depth and ids are those of the centres.

        Args:
            data: with its kinematics up to date.
            camera: a camera of the model, a `FreeCamera`, or any `View`.
            depth_only: leave the colours black, which saves shading and shadows.
        """
        model = open_model(self._model, data)
        view = camera_view(model, data, camera, self.width, self.height)
        shape = (self.height, self.width)
        rgba = geom_colors(model)
        rays = self._rays(view, 0.5, 0.5)
        shaded = not depth_only and self._samples == 1
        hits = cast(self._shapes(model, data, rgba), view.position, rays, normals=shaded)
        if shaded:
            rgb = self._encode(self._colors(self._scene(model, data, view, rgba), rays, hits, 0), 1)
        else:
            rgb = np.zeros((*shape, 3), np.uint8) if depth_only else self._picture(model, data, view)
        return Frame(rgb, hits.distance.astype(np.float32).reshape(shape), hits.geom.reshape(shape))

    def depth(self, data: mujoco.MjData, camera: Camera) -> NDArray[np.float32]:
        """Depth (H, W) along the optical axis [m], 0 where there is no return."""
        return self.frame(data, camera, depth_only=True).depth

    def render(self, data: mujoco.MjData, camera: Camera) -> NDArray[np.uint8]:
        """Colour picture (H, W, 3), sRGB."""
        model = open_model(self._model, data)
        return self._picture(model, data, camera_view(model, data, camera, self.width, self.height))

    def _picture(self, model: mujoco.MjModel, data: mujoco.MjData, view: View) -> NDArray[np.uint8]:
        scene, n = self._scene(model, data, view, geom_colors(model)), self._samples
        shapes = self._shapes(model, data, scene.rgba)
        picture = np.zeros((self.height * self.width, 3), dtype=np.float32)
        for i in range(n * n):
            row, column = divmod(i, n)
            rays = self._rays(view, (column + 0.5) / n, (row + 0.5) / n)
            picture += self._colors(scene, rays, cast(shapes, view.position, rays), i)
        return self._encode(picture, n * n)

    def _encode(self, linear: Array, passes: int) -> NDArray[np.uint8]:
        picture = np.empty((self.height, self.width, 3), np.uint8)
        kernel.encode(linear, 1.0 / passes, SRGB_OF_LINEAR, picture.reshape(-1, 3))
        return picture

    def _scene(self, model: mujoco.MjModel, data: mujoco.MjData, view: View, rgba: NDArray[np.float32]) -> _Scene:
        covers = lay_textures(model, data, self._textures, self._corners)
        return _Scene(model, data, view, rgba, gloss(model), covers, sky_of(model))

    def _shapes(
        self, model: mujoco.MjModel, data: mujoco.MjData, rgba: NDArray[np.float32], opaque: bool = False
    ) -> Shapes:
        """What rays meet: the groups that are drawn, without what is invisible (or, if `opaque`, translucent)."""
        seen = self._groups[model.geom_group.clip(0, mujoco.mjNGROUP - 1)] > 0
        seen &= (rgba[:, 3] >= 1.0) if opaque else (rgba[:, 3] > 0.0)
        return shapes_of(model, data, seen, self._meshes)

    def _rays(self, view: View, u: float, v: float) -> Array:
        """World directions (H·W, 3) through the point (u, v) of each pixel; ray parameters are depths."""
        return kernel.pixel_rays(self.width, self.height, view.R_w_c, view.fx, view.fy, view.cx - u, view.cy - v)

    def _colors(self, scene: _Scene, rays: Array, hits: Hits, index: int) -> NDArray[np.float32]:
        """Linear colours (N, 3) that come along the rays from the camera, in pass `index`."""
        opaque = self._shapes(scene.model, scene.data, scene.rgba, opaque=True)
        color = self._shade(scene, opaque, rays, hits, index)
        alpha = scene.rgba[:, 3]
        if ((alpha <= 0.0) | (alpha >= 1.0)).all():
            return color
        # What is translucent casts no shadow; behind it everything is cast again without it.
        through = np.flatnonzero((hits.geom >= 0) & (alpha[hits.geom] < 1.0))
        if through.size:
            behind = cast(opaque, scene.view.position, rays[through])
            back = self._shade(scene, opaque, rays[through], behind, index)
            color[through] = back + alpha[hits.geom[through], None] * (color[through] - back)
        return color

    def _shade(self, scene: _Scene, opaque: Shapes, rays: Array, hits: Hits, index: int) -> NDArray[np.float32]:
        view = scene.view
        steps = view.R_w_c[:, :2].T / (np.array([[view.fx], [view.fy]]) * self._samples)
        color, albedo, point, smooth = kernel.shade(
            *(rays, hits.geom, hits.face, hits.distance, hits.normal, view.position, steps),
            *(scene.rgba, scene.covers, self._textures, self._corners, opaque, scene.sky),
        )
        lights = lights_of(scene.model, scene.data, index, self._samples**2)
        for i in range(len(lights.kind)):
            rows, to, strength = kernel.reach(lights, i, hits.geom, point, hits.normal, smooth)
            if lights.shadow[i]:
                shadow = in_shadow(opaque, lights.source[i], to, hits.geom[rows])
            else:
                shadow = np.zeros(len(rows), np.bool_)
            kernel.add_light(
                *(color, albedo, rays, hits.geom, smooth, rows, to, strength, shadow),
                *(lights.color[i], scene.gloss),
            )
        kernel.add_haze(color, rays, hits.geom, hits.distance, scene.sky)
        return color
