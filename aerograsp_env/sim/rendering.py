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
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

BACKENDS = ("ray", "gl")

# Linear RGB. A white face that looks up at a sun overhead gets sun + sky light, just above full scale.
_SUN_COLOR = np.array([[0.98, 0.90, 0.76]], dtype=np.float32).T
_SKY_LIGHT = np.array([[0.19, 0.23, 0.30]], dtype=np.float32).T  # ambient light on a face that looks up
_GROUND_LIGHT = np.array([[0.16, 0.15, 0.135]], dtype=np.float32).T  # ... and on one that looks down
_ZENITH = np.array([[0.10, 0.31, 0.66]], dtype=np.float32).T
_HORIZON = np.array([[0.78, 0.86, 0.94]], dtype=np.float32).T
_DEFAULT_RGBA = np.array([0.5, 0.5, 0.5, 1.0], dtype=np.float32)  # MuJoCo's, of a geom without a colour
_SUN_DIRECTION = np.array([0.40, 0.28, -0.87])  # of travel, where the model has no light
_SUN_DISTANCE = 5e3  # [m]; far enough for parallel rays (0.1° over 10 m), near enough for 1e-7 m in double precision
_SUN_RADIUS = 0.010  # [rad] over which supersampling spreads the sun; twice the real one, for softer shadows
_SHADOW_BIAS = 1e-5  # [m]
_SKY_FALLOFF = 8  # how fast the sky darkens from the horizon up
_HIGHLIGHT = 0.5  # of a material of specular 1
_HAZE_LENGTH = 40.0  # [m] at which a surface has lost 63 % of its contrast


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


Camera = str | int | FreeCamera


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
    for name, value, high in (("width", width, 16384), ("height", height, 16384), ("samples", samples, 16)):
        if isinstance(value, bool) or not isinstance(value, int | np.integer) or not 1 <= value <= high:
            raise ValueError(f"{name} must be an integer from 1 to {high}, got {value!r}")
    if not all(group in range(mujoco.mjNGROUP) for group in groups):
        raise ValueError(f"groups must be integers from 0 to {mujoco.mjNGROUP - 1}, got {groups!r}")
    mask = np.isin(np.arange(mujoco.mjNGROUP), list(groups)).astype(np.uint8)
    if backend == "ray":
        return RayRenderer(model, int(width), int(height), int(samples), mask)
    if backend == "gl":
        return GLRenderer(model, int(width), int(height), mask)
    near = difflib.get_close_matches(str(backend), BACKENDS, 1, 0.0)[0]
    raise ValueError(f"backend must be one of {', '.join(BACKENDS)} (did you mean {near!r}?), got {backend!r}")


class _View(NamedTuple):
    """A placed pinhole. Camera axes are MuJoCo's: x right, y up, looking along −z."""

    position: NDArray[np.float64]  # (3,) world [m]
    R_w_c: NDArray[np.float64]  # (3, 3)
    fx: float  # [px]
    fy: float  # [px]
    cx: float  # [px], from the left edge of the image
    cy: float  # [px], from its top edge


def _camera_id(model: mujoco.MjModel, camera: Any) -> int:
    names = [model.camera(i).name for i in range(model.ncam)]
    if isinstance(camera, str):
        if camera not in names:
            raise ValueError(f"camera {camera!r} is not in the model; it has {names or 'none'}")
        return names.index(camera)
    if isinstance(camera, bool) or not isinstance(camera, int | np.integer):
        raise ValueError(f"camera must be a name, an id or a FreeCamera, got {camera!r}")
    if not 0 <= camera < model.ncam:
        raise ValueError(f"camera id must lie in [0, {model.ncam}), got {camera}; names: {names}")
    return int(camera)


def _view(model: mujoco.MjModel, data: mujoco.MjData, camera: Camera, width: int, height: int) -> _View:
    if isinstance(camera, FreeCamera):
        ca, sa = np.cos(camera.azimuth), np.sin(camera.azimuth)
        ce, se = np.cos(camera.elevation), np.sin(camera.elevation)
        forward = np.array([ce * ca, ce * sa, se])
        R_w_c = np.column_stack([[sa, -ca, 0.0], [-se * ca, -se * sa, ce], -forward])
        f = 0.5 * height / np.tan(0.5 * camera.fovy)
        position = np.asarray(camera.lookat) - camera.distance * forward
        return _View(position, R_w_c, f, f, 0.5 * width, 0.5 * height)
    cam = _camera_id(model, camera)
    if int(model.cam_projection[cam]) != int(mujoco.mjtProjection.mjPROJ_PERSPECTIVE):
        raise ValueError(f"camera {camera!r} is orthographic; only perspective cameras are drawn")
    position, R_w_c = data.cam_xpos[cam].copy(), data.cam_xmat[cam].reshape(3, 3).copy()
    sensor = model.cam_sensorsize[cam].astype(np.float64)  # (2,) [m]
    if (sensor > 0).all():
        focal_x, focal_y, center_x, center_y = model.cam_intrinsic[cam].astype(np.float64)  # [m]
        scale_x, scale_y = width / sensor[0], height / sensor[1]
        cx, cy = 0.5 * width - center_x * scale_x, 0.5 * height - center_y * scale_y
        return _View(position, R_w_c, focal_x * scale_x, focal_y * scale_y, cx, cy)
    f = 0.5 * height / np.tan(0.5 * np.deg2rad(model.cam_fovy[cam]))
    return _View(position, R_w_c, f, f, 0.5 * width, 0.5 * height)


def _open_model(model: mujoco.MjModel | None, data: mujoco.MjData) -> mujoco.MjModel:
    if model is None:
        raise RuntimeError("the renderer is closed")
    if data.geom_xpos.shape[0] != model.ngeom or data.cam_xpos.shape[0] != model.ncam:
        raise ValueError(
            f"data must belong to the renderer's model ({model.ngeom} geoms, {model.ncam} cameras), "
            f"got {data.geom_xpos.shape[0]} and {data.cam_xpos.shape[0]}"
        )
    return model


class _Hits(NamedTuple):
    geom: NDArray[np.int32]  # (N,), −1 for a miss
    distance: NDArray[np.float64]  # (N,) in lengths of the ray's direction
    normal: NDArray[np.float64]  # (3, N) world, unit; (3, 0) if not asked for


class _Frame(NamedTuple):
    """What stays the same over the passes of one picture."""

    model: mujoco.MjModel
    data: mujoco.MjData
    view: _View
    rgba: NDArray[np.float32]  # (ngeom, 4), linear RGB and opacity
    texture: NDArray[np.intp]  # (ngeom,) index of the 2-D texture, or −1


class RayRenderer:
    """Renderer by ray casting; see the module's docstring.

    A 480×360 picture of a checkered floor and ten primitives, one of them translucent, takes about 75 ms on one
    core of a 2020s server CPU (320 ms with `samples` = 2), its depth image 16 ms, and a 64×64 picture 2.2 ms.

    While a picture with translucent geoms is drawn, those geoms are hidden in the model, and shown again after:
    threads that share one model must not draw it or cast rays in it at the same time.
    """

    def __init__(self, model: mujoco.MjModel, width: int, height: int, samples: int, groups: NDArray[np.uint8]):
        self.width, self.height = width, height
        self._model: mujoco.MjModel | None = model
        self._samples = samples
        self._groups = groups
        self._textures = [_read_texture(model, i) for i in range(model.ntex)]

    def close(self) -> None:
        """Drop the model; drawing afterwards raises RuntimeError."""
        self._model = None

    def depth(self, data: mujoco.MjData, camera: Camera) -> NDArray[np.float32]:
        """Depth (H, W) along the optical axis [m], 0 where there is no return."""
        model = _open_model(self._model, data)
        view = _view(model, data, camera, self.width, self.height)
        # Every direction has length 1 along the optical axis, so ray parameters are depths.
        hits = self._cast(model, data, view.position, self._directions(view, 0.5, 0.5), normals=False)
        return np.where(hits.geom >= 0, hits.distance, 0.0).astype(np.float32).reshape(self.height, self.width)

    def render(self, data: mujoco.MjData, camera: Camera) -> NDArray[np.uint8]:
        """Colour picture (H, W, 3), sRGB."""
        model = _open_model(self._model, data)
        view = _view(model, data, camera, self.width, self.height)
        frame = _Frame(model, data, view, *_geom_colors(model, self._textures))
        sun, sunlight = _sun(model, data)
        picture = np.zeros((3, self.height * self.width), dtype=np.float32)
        passes = self._samples**2
        for i in range(passes):
            row, column = divmod(i, self._samples)
            rays = self._directions(view, (column + 0.5) / self._samples, (row + 0.5) / self._samples)
            picture += self._colors(frame, rays, _point_of_sun(sun, i, passes), sunlight)
        return _encode_srgb(picture / np.float32(passes)).T.reshape(self.height, self.width, 3)

    # From here to the end of the class vectors are (3, N): numpy is several times faster on long rows.

    def _directions(self, view: _View, u: float, v: float) -> Array:
        """World directions (3, H·W) through the point (u, v) of each pixel."""
        x = (np.arange(self.width) + (u - view.cx)) / view.fx
        y = (view.cy - v - np.arange(self.height)) / view.fy
        x_axis, y_axis, z_axis = view.R_w_c.T[:, :, None, None]
        return (y[:, None] * y_axis + (x * x_axis - z_axis)).reshape(3, -1)

    def _cast(
        self, model: mujoco.MjModel, data: mujoco.MjData, origin: Array, rays: Array, normals: bool = True
    ) -> _Hits:
        count = rays.shape[1]
        geom, distance, normal = np.empty(count, np.int32), np.empty(count), np.empty((count if normals else 0, 3))
        if count:
            mujoco.mj_multiRay(
                *(model, data, origin, rays.T.ravel(), self._groups, True, -1),
                *(geom, distance, normal.ravel() if normals else None, count, mujoco.mjMAXVAL),
            )
        return _Hits(geom, distance, normal.T)

    def _colors(self, frame: _Frame, rays: Array, sun: Array, sunlight: Array) -> Array:
        """Linear colours (3, N) that come along the rays from the camera."""
        hits = self._cast(frame.model, frame.data, frame.view.position, rays)
        alpha = frame.rgba[:, 3]
        clear = np.flatnonzero((alpha > 0.0) & (alpha < 1.0))
        if not clear.size:
            return self._shade(frame, rays, hits, sun, sunlight)
        # What is translucent casts no shadow; behind it everything is cast again without it.
        through = np.flatnonzero(np.isin(hits.geom, clear))
        with _hidden(frame.model, clear):
            color = self._shade(frame, rays, hits, sun, sunlight)
            behind = self._cast(frame.model, frame.data, frame.view.position, rays[:, through])
            back = self._shade(frame, rays[:, through], behind, sun, sunlight)
        color[:, through] = back + alpha[hits.geom[through]] * (color[:, through] - back)
        return color

    def _shade(self, frame: _Frame, rays: Array, hits: _Hits, sun: Array, sunlight: Array) -> Array:
        model = frame.model
        length = np.sqrt(_dot(rays, rays))
        color = _sky(rays[2] / length)
        seen = np.flatnonzero(hits.geom >= 0)
        rays, length, geom, distance = rays[:, seen], length[seen], hits.geom[seen], hits.distance[seen]
        point = frame.view.position[:, None] + distance * rays
        albedo = frame.rgba.T[:3].take(geom, axis=1)
        self._paint_checkers(frame, geom, rays, distance, albedo)

        to_camera = (rays / -length).astype(np.float32)
        normal = hits.normal[:, seen].astype(np.float32)
        normal = np.ascontiguousarray(normal) * np.sign(_dot(normal, to_camera))
        sun_direction = sun[:, None].astype(np.float32)
        cosine = _dot(normal, sun_direction)
        lit = np.flatnonzero(cosine > 0)
        # The sun is a far point, because rays cast together start at one point. A lit surface is the first thing met.
        source = model.stat.center + _SUN_DISTANCE * sun
        first = self._cast(model, frame.data, source, point[:, lit] - source[:, None], normals=False)
        lit = lit[(first.geom < 0) | (first.distance > 1.0 - _SHADOW_BIAS / _SUN_DISTANCE)]

        light = _GROUND_LIGHT + (0.5 + 0.5 * normal[2]) * (_SKY_LIGHT - _GROUND_LIGHT)
        direct = np.zeros(len(seen), dtype=np.float32)
        direct[lit] = cosine[lit]
        surface = albedo * (light + direct * sunlight)
        strength, exponent = _gloss(model)
        lit = lit[strength[geom[lit]] > 0]
        halfway = to_camera[:, lit] + sun_direction  # Blinn 1977
        spread = _dot(normal[:, lit], halfway) / np.sqrt(_dot(halfway, halfway))
        surface[:, lit] += strength[geom[lit]] * spread.clip(0.0) ** exponent[geom[lit]] * sunlight
        haze = -np.expm1(-((distance * length / _HAZE_LENGTH).astype(np.float32) ** 2))
        color[:, seen] = surface + haze * (color[:, seen] - surface)
        return color

    def _paint_checkers(self, frame: _Frame, geom: Array, rays: Array, distance: Array, albedo: Array) -> None:
        """Multiply the checker pattern into the `albedo` (3, N) of planes, averaged over each ray's footprint."""
        model, data, view = frame.model, frame.data, frame.view
        for plane in np.flatnonzero((frame.texture >= 0) & (model.geom_type == int(mujoco.mjtGeom.mjGEOM_PLANE))):
            contrast = self._textures[frame.texture[plane]].contrast
            on = np.flatnonzero(geom == plane)
            if contrast is None or not on.size:
                continue
            R_p_w = data.geom_xmat[plane].reshape(3, 3).T
            ray, depth = _rotate(R_p_w, rays[:, on]), distance[on]  # in the plane's frame
            eye = R_p_w @ (view.position - data.geom_xpos[plane])
            steps = R_p_w @ view.R_w_c[:, :2] / (np.array([view.fx, view.fy]) * self._samples)  # to the next rays
            wave = np.ones(len(on))
            repeat, start = _repeat(model, int(plane))
            for axis in (0, 1):
                u = (eye[axis] + depth * ray[axis] - start[axis]) * repeat[axis]  # the texture's period is 1
                slope = ray[axis] / ray[2]
                width = sum(np.abs(step[axis] - slope * step[2]) for step in steps.T) * depth * abs(repeat[axis])
                # A square wave's integral is a triangle wave, so its mean over a box is a difference of two of them.
                wave *= (_triangle(u + 0.5 * width) - _triangle(u - 0.5 * width)) / np.maximum(width, 1e-9)
            albedo[:, on] *= (1.0 + wave * contrast).astype(np.float32)


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
        model = _open_model(self._model, data)
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
                view = _camera_id(model, camera)
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


def _dot(a: Array, b: Array) -> Array:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _rotate(R: Array, v: Array) -> Array:
    """R @ v for v (3, N); BLAS would wake all its threads for it and gain nothing."""
    return R[:, :1] * v[0] + R[:, 1:2] * v[1] + R[:, 2:] * v[2]


def _triangle(u: Array) -> Array:
    """Integral of the square wave that is +1 on the first half of each period of 1 and −1 on the second."""
    return 0.5 - np.abs(u - np.floor(u) - 0.5)


@contextmanager
def _hidden(model: mujoco.MjModel, geoms: NDArray[np.intp]) -> Iterator[None]:
    """Make rays pass through `geoms`. A ray skips geoms without material whose opacity is 0."""
    alpha, material = model.geom_rgba[geoms, 3].copy(), model.geom_matid[geoms].copy()
    try:
        model.geom_rgba[geoms, 3], model.geom_matid[geoms] = 0.0, -1
        yield
    finally:
        model.geom_rgba[geoms, 3], model.geom_matid[geoms] = alpha, material


class _Texture(NamedTuple):
    mean: Array  # (3,) linear RGB
    contrast: Array | None  # (3, 1) of a 2×2 checker: its colours are mean · (1 ± contrast)


def _read_texture(model: mujoco.MjModel, index: int) -> _Texture:
    height, width, channels = (int(x[index]) for x in (model.tex_height, model.tex_width, model.tex_nchannel))
    start = int(model.tex_adr[index])
    pixels = model.tex_data[start : start + height * width * channels].reshape(height, width, channels)
    image = _decode_srgb(np.broadcast_to(pixels[..., :3], (height, width, 3)) / 255.0)
    mean = image.mean(axis=(0, 1))
    if int(model.tex_type[index]) != int(mujoco.mjtTexture.mjTEXTURE_2D):
        return _Texture(mean, None)
    rows, columns = height // 2, width // 2
    first, second = image[:rows, :columns], image[:rows, columns:]
    a, b = np.median(first, axis=(0, 1)), np.median(second, axis=(0, 1))
    # Marks along the edges may differ; nearly all else must be the two colours, crosswise.
    pattern = np.where((np.arange(height) < rows)[:, None, None] == (np.arange(width) < columns)[None, :, None], a, b)
    if np.isclose(image, pattern, atol=0.02).all(axis=2).mean() < 0.9 or np.allclose(a, b):
        return _Texture(mean, None)
    mean = 0.5 * (a + b)
    return _Texture(mean, (0.5 * (a - b) / np.maximum(mean, 1e-6))[:, None])


def _geom_colors(model: mujoco.MjModel, textures: list[_Texture]) -> tuple[NDArray[np.float32], NDArray[np.intp]]:
    """Linear colour and opacity (ngeom, 4) and index of the texture (ngeom,), by MuJoCo's rules."""
    rgba = model.geom_rgba.copy()
    material = model.geom_matid
    # A material colours a geom unless the geom's own colour was set, that is, differs from the default.
    plain = (material >= 0) & (rgba == _DEFAULT_RGBA).all(axis=1)
    rgba[plain] = model.mat_rgba[material[plain]]
    rgba[:, :3] = _decode_srgb(rgba[:, :3])
    texture = np.full(model.ngeom, -1, dtype=np.intp)
    used = material >= 0
    texture[used] = model.mat_texid[material[used], int(mujoco.mjtTextureRole.mjTEXROLE_RGB)]
    for geom in np.flatnonzero(texture >= 0):
        rgba[geom, :3] *= textures[texture[geom]].mean
    return rgba, texture


def _repeat(model: mujoco.MjModel, plane: int) -> tuple[Array, Array]:
    """Periods of a plane's texture per metre along its x and y (2,), and where they start (2,) [m], as in MuJoCo."""
    material = model.geom_matid[plane]
    size = model.geom_size[plane, :2].clip(0.0)
    spread = (size == 0) | bool(model.mat_texuniform[material])
    # A texture starts at its upper left corner: its rows run against y.
    return np.array([0.5, -0.5]) * model.mat_texrepeat[material] / np.where(spread, 1.0, size), size * [-1.0, 1.0]


def _gloss(model: mujoco.MjModel) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Strength and exponent of the highlight, (ngeom,) each; planes have none."""
    specular = np.append(model.mat_specular, np.float32(0.5))[model.geom_matid]  # −1 is the last: MuJoCo's default
    shininess = np.append(model.mat_shininess, np.float32(0.5))[model.geom_matid]
    specular[model.geom_type == int(mujoco.mjtGeom.mjGEOM_PLANE)] = 0.0
    return np.float32(_HIGHLIGHT) * specular, np.float32(128) * shininess.clip(0.02)


def _sun(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[Array, Array]:
    """Unit direction towards the sun (3,) and its linear colour (3, 1)."""
    travel, color = _SUN_DIRECTION, _SUN_COLOR
    active = np.flatnonzero(model.light_active)
    if active.size:
        travel = data.light_xdir[active[0]]
        color = _SUN_COLOR * (model.light_diffuse[active[0], :, None] / np.float32(0.7))  # 0.7 is MuJoCo's default
    return -travel / np.linalg.norm(travel), color


def _point_of_sun(sun: NDArray[np.float64], index: int, count: int) -> NDArray[np.float64]:
    """Direction (3,) of one of `count` points spread evenly over the sun's disc (Vogel 1979); its centre if 1."""
    if count == 1:
        return sun
    side = np.cross(sun, np.eye(3)[np.argmin(np.abs(sun))])
    side /= np.linalg.norm(side)
    radius, angle = _SUN_RADIUS * np.sqrt((index + 0.5) / count), index * np.pi * (3 - np.sqrt(5))
    point = sun + radius * (np.cos(angle) * side + np.sin(angle) * np.cross(sun, side))
    return point / np.linalg.norm(point)


def _sky(sine: Array) -> Array:
    """Linear colour (3, N) of the sky by the sine of the elevation (N,)."""
    low = 1.0 - sine.astype(np.float32).clip(0.0, 1.0)
    return _ZENITH + low**_SKY_FALLOFF * (_HORIZON - _ZENITH)


def _decode_srgb(value: Array) -> NDArray[np.float32]:
    value = np.asarray(value, dtype=np.float32)
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4).astype(np.float32)


_LEVELS = np.linspace(0.0, 1.0, 4096)
_SRGB = np.rint(255 * np.where(_LEVELS <= 0.0031308, 12.92 * _LEVELS, 1.055 * _LEVELS ** (1 / 2.4) - 0.055)).astype(
    np.uint8
)


def _encode_srgb(linear: NDArray[np.float32]) -> NDArray[np.uint8]:
    return _SRGB[(linear.clip(0.0, 1.0) * np.float32(4095) + np.float32(0.5)).astype(np.intp)]
