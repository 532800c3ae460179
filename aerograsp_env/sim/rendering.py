"""Pictures and depth images of a MuJoCo model, without OpenGL by default.

Two backends stand behind one small interface (`Renderer`), made by `make_renderer`:

- ``"ray"`` casts one ray a pixel with ``mujoco.mj_multiRay``. It runs on any machine and never touches OpenGL.
- ``"gl"`` is MuJoCo's rasteriser, created when the first picture is asked for.

Both put the same pinhole camera at the same place: pixel (u, v) looks through its centre (u + ½, v + ½), the optical
axis is the camera's −z (MuJoCo's convention: x right, y up), square pixels of focal length
f = (H / 2) / tan(fovy / 2) px, unless the camera has a sensor size, when its own intrinsics are used.

The ray backend's light is one sun (the model's first active light, or a default one) with exact shadows, a sky that
is brighter than the ground, a faint highlight and haze. Shading is done in linear light and encoded as sRGB. It
follows MuJoCo's rules for colour (a material's, unless the geom has its own), groups and visibility, and reads the
model at each call, so a change of ``model.geom_rgba`` or of a mocap pose shows in the next picture.
It leaves out: sites, tendons, flexes, skins; textures, of which only the mean colour is used except for a checker on
a plane; more than one translucent layer.
"""

from __future__ import annotations

import difflib
import os
from collections.abc import Sequence
from typing import Any, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim.cameras import Camera, FreeCamera, camera_id, open_model
from aerograsp_env.sim.ray_renderer import RayRenderer

__all__ = [
    "BACKENDS",
    "Camera",
    "FreeCamera",
    "GLRenderer",
    "RayRenderer",
    "Renderer",
    "check_picture",
    "make_renderer",
]

BACKENDS = ("ray", "gl")


class Renderer(Protocol):
    """Draws one model at one image size; `data` must have its kinematics up to date (``mujoco.mj_forward``)."""

    width: int
    height: int

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

    def depth(self, data: mujoco.MjData, camera: Camera) -> NDArray[np.float32]:
        """Depth (H, W) along the optical axis [m], 0 where there is no return (or it is beyond MuJoCo's far plane)."""
        depth = self._draw(data, camera, depth=True)
        far = np.float32(self._renderer.model.vis.map.zfar * self._renderer.model.stat.extent)
        depth[depth >= far * np.float32(1 - 1e-4)] = 0.0
        return depth

    def render(self, data: mujoco.MjData, camera: Camera) -> NDArray[np.uint8]:
        """Colour picture (H, W, 3), sRGB."""
        return self._draw(data, camera, depth=False)

    def _draw(self, data: mujoco.MjData, camera: Camera, depth: bool) -> NDArray[Any]:
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
            else:
                view = camera_id(model, camera)
            renderer.update_scene(data, view, self._option)
        finally:
            model.vis.global_.fovy = fovy
        if not depth:
            return renderer.render()
        renderer.enable_depth_rendering()
        try:
            return renderer.render()
        finally:
            renderer.disable_depth_rendering()

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
