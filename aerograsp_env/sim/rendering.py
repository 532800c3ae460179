"""Pictures and depth images of a MuJoCo model, without OpenGL by default.

Two backends stand behind one small interface (`Renderer`), made by `make_renderer`:

- ``"ray"`` casts one ray a pixel and light, on the processor. It runs on any machine and never touches OpenGL.
- ``"gl"`` is MuJoCo's rasteriser, created when the first picture is asked for.

Both put the same pinhole camera at the same place: pixel (u, v) looks through its centre (u + ½, v + ½), the optical
axis is the camera's −z (MuJoCo's convention: x right, y up), square pixels of focal length
f = (H / 2) / tan(fovy / 2) px, unless the camera has a sensor size, when its own intrinsics are used.

The ray backend draws materials, image textures on any geom (`aerograsp_env.sim.ray_textures` says how they lie), all
active lights (directional, spot, point, with MuJoCo's attenuation, cut-off and exponent) with exact shadows, a sky that
is brighter than the ground, a faint highlight and haze. A model without active lights gets a sun. The headlight's
ambient scales the light of the sky, from none at 0 to full day at 0.1 (MuJoCo's default) and above; its diffuse and
specular parts are left out. Meshes are shaded smoothly, as in MuJoCo. Shading is done in linear light and encoded as
sRGB. It follows MuJoCo's rules for colour (a material's, unless the geom has its own), groups and visibility, and reads
the model at each call, so a change of ``model.geom_rgba``, of a light or of a mocap pose shows in the next picture;
textures and meshes are read once.
It leaves out: sites, tendons, flexes, skins, signed distance fields; more than one translucent layer.
"""

from __future__ import annotations

import difflib
import os
from collections.abc import Sequence
from typing import Any, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim.cameras import Camera, Frame, FreeCamera, View, camera_id, camera_view, open_model
from aerograsp_env.sim.ray_renderer import RayRenderer

__all__ = [
    "BACKENDS",
    "Camera",
    "Frame",
    "FreeCamera",
    "GLRenderer",
    "RayRenderer",
    "Renderer",
    "View",
    "check_picture",
    "make_renderer",
]

BACKENDS = ("ray", "gl")


class Renderer(Protocol):
    """Draws one model at one image size; `data` must have its kinematics up to date (``mujoco.mj_forward``)."""

    width: int
    height: int
    backend: str  # one of BACKENDS

    def frame(self, data: mujoco.MjData, camera: Camera, *, depth_only: bool = False) -> Frame:
        """Colour, depth and geom ids of one look; colours are black if `depth_only`."""

    def render(self, data: mujoco.MjData, camera: Camera) -> NDArray[np.uint8]:
        """Colour picture (H, W, 3), sRGB."""

    def depth(self, data: mujoco.MjData, camera: Camera) -> NDArray[np.float32]:
        """Depth (H, W) along the optical axis [m], 0 where there is no return."""

    def close(self) -> None:
        """Free what the renderer holds; a second call does nothing."""


def check_picture(width: int, height: int, backend: str = "ray", samples: int = 1, prefix: str = "") -> None:
    """Raise ValueError if an argument of `make_renderer` is out of range; `prefix` goes before "backend", "samples"."""
    for name, value, high in (("width", width, 16384), ("height", height, 16384), (f"{prefix}samples", samples, 16)):
        if isinstance(value, bool) or not isinstance(value, int | np.integer) or not 1 <= value <= high:
            raise ValueError(f"{name} must be an integer from 1 to {high}, got {value!r}")
    if backend not in BACKENDS:
        near = difflib.get_close_matches(str(backend), BACKENDS, 1, 0.0)[0]
        expected = f"one of {', '.join(BACKENDS)} (did you mean {near!r}?)"
        raise ValueError(f"{prefix}backend must be {expected}, got {backend!r}")


def make_renderer(
    model: mujoco.MjModel,
    width: int = 480,
    height: int = 360,
    backend: str = "ray",
    samples: int = 1,
    groups: Sequence[int] = (0, 1, 2),
) -> Renderer:
    """Make a renderer for `model`.

    Args:
        model: what is drawn; it is read again at each picture.
        width, height: image size [px].
        backend: ``"ray"`` or ``"gl"``.
        samples: the ray backend casts samples² rays a pixel, which smooths edges and softens shadows (each of the
            samples² passes sees another point of the sun). The GL backend has multisampling of its own.
        groups: geom groups (0 to 5) that are drawn; the default is MuJoCo's.

    Raises:
        ValueError: an argument is out of range.
    """
    check_picture(width, height, backend, samples)
    if not all(group in range(mujoco.mjNGROUP) for group in groups):
        raise ValueError(f"groups must be integers from 0 to {mujoco.mjNGROUP - 1}, got {groups!r}")
    mask = np.isin(np.arange(mujoco.mjNGROUP), list(groups)).astype(np.uint8)
    if backend == "ray":
        return RayRenderer(model, int(width), int(height), int(samples), mask)
    return GLRenderer(model, int(width), int(height), mask)


class GLRenderer:
    """Renderer by ``mujoco.Renderer``, created by the first picture.

    Raises (when drawing):
        RuntimeError: OpenGL does not work here; the message says what to install or set.
    """

    backend = "gl"

    def __init__(self, model: mujoco.MjModel, width: int, height: int, groups: NDArray[np.uint8]):
        self.width, self.height = width, height
        self._model: mujoco.MjModel | None = model
        self._option = mujoco.MjvOption()
        self._option.geomgroup[:] = groups
        self._renderer: Any = None

    def close(self) -> None:
        """Free the OpenGL context; drawing afterwards raises RuntimeError."""
        if self._renderer is not None:
            self._renderer.close()
        self._renderer, self._model = None, None

    def frame(self, data: mujoco.MjData, camera: Camera, *, depth_only: bool = False) -> Frame:
        """Colour, depth and geom ids of one look, from three renderings (two if `depth_only`)."""
        kinds = ("depth", "segmentation") if depth_only else ("depth", "segmentation", "rgb")
        images = dict(zip(kinds, self._draw(data, camera, kinds), strict=True))
        ids, types = np.moveaxis(images["segmentation"], -1, 0)
        geom = np.where(types == int(mujoco.mjtObj.mjOBJ_GEOM), ids, -1).astype(np.int32)
        rgb = np.zeros((self.height, self.width, 3), np.uint8) if depth_only else images["rgb"]
        return Frame(rgb, self._with_misses(images["depth"]), geom)

    def depth(self, data: mujoco.MjData, camera: Camera) -> NDArray[np.float32]:
        """Depth (H, W) along the optical axis [m], 0 where there is no return (or it is beyond MuJoCo's far plane)."""
        return self._with_misses(self._draw(data, camera, ("depth",))[0])

    def render(self, data: mujoco.MjData, camera: Camera) -> NDArray[np.uint8]:
        """Colour picture (H, W, 3), sRGB."""
        return self._draw(data, camera, ("rgb",))[0]

    def _with_misses(self, depth: NDArray[np.float32]) -> NDArray[np.float32]:
        far = np.float32(self._renderer.model.vis.map.zfar * self._renderer.model.stat.extent)
        return np.where(depth >= far * np.float32(1 - 1e-4), np.float32(0.0), depth)

    def _draw(self, data: mujoco.MjData, camera: Camera, kinds: Sequence[str]) -> list[NDArray[Any]]:
        model = open_model(self._model, data)
        renderer = self._start(model)
        fovy = model.vis.global_.fovy
        try:
            view: int | mujoco.MjvCamera
            if isinstance(camera, FreeCamera):
                view = mujoco.MjvCamera()
                view.lookat[:] = camera.lookat
                view.distance = camera.distance
                view.azimuth, view.elevation = np.rad2deg([camera.azimuth, camera.elevation])
                model.vis.global_.fovy = np.rad2deg(camera.fovy)  # the only place MuJoCo takes a free camera's from
            elif isinstance(camera, View):
                view = mujoco.MjvCamera()
            else:
                view = camera_id(model, camera)
            renderer.update_scene(data, view, self._option)
            if isinstance(camera, View):
                self._place(renderer.scene, camera_view(model, data, camera, self.width, self.height))
        finally:
            model.vis.global_.fovy = fovy
        images = []
        for kind in kinds:
            try:
                if kind == "depth":
                    renderer.enable_depth_rendering()
                elif kind == "segmentation":
                    renderer.enable_segmentation_rendering()
                images.append(renderer.render())
            finally:
                renderer.disable_depth_rendering()
                renderer.disable_segmentation_rendering()
        return images

    def _place(self, scene: mujoco.MjvScene, view: View) -> None:
        """Put the scene's cameras (one an eye; the picture is their mean) at any pose, with any intrinsics."""
        for eye in scene.camera:
            eye.pos, eye.forward, eye.up = view.position, -view.R_w_c[:, 2], view.R_w_c[:, 1]
            near = eye.frustum_near
            eye.frustum_top, eye.frustum_bottom = near * view.cy / view.fy, -near * (self.height - view.cy) / view.fy
            eye.frustum_center = near * (0.5 * self.width - view.cx) / view.fx
            eye.frustum_width = near * 0.5 * self.width / view.fx

    def _start(self, model: mujoco.MjModel) -> Any:
        if self._renderer is None:
            buffer = model.vis.global_
            buffer.offwidth, buffer.offheight = max(buffer.offwidth, self.width), max(buffer.offheight, self.height)
            try:
                self._renderer = mujoco.Renderer(model, self.height, self.width)
            except Exception as error:  # each OpenGL platform fails with a type of its own
                setting = os.environ.get("MUJOCO_GL", "")
                raise RuntimeError(
                    f"OpenGL does not start with MUJOCO_GL={setting!r} ({type(error).__name__}: {error}). On a machine "
                    "without a display install libegl1 and libgl1 and set MUJOCO_GL=egl before Python starts (or "
                    "libosmesa6 and MUJOCO_GL=osmesa), or use backend='ray', which needs no OpenGL"
                ) from error
        return self._renderer
