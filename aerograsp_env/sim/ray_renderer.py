"""The renderer by ray casting; `aerograsp_env.sim.rendering` says what it draws and what it leaves out."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim.cameras import Camera, View, camera_view, open_model
from aerograsp_env.sim.shading import (
    GROUND_LIGHT,
    SKY_LIGHT,
    encode_srgb,
    geom_colors,
    gloss,
    point_of_sun,
    read_texture,
    sky,
    sunlight_of,
    texture_repeat,
)

Array = NDArray[Any]

_SUN_DISTANCE = 5e3  # [m]; far enough for parallel rays (0.1° over 10 m), near enough for 1e-7 m in double precision
_SHADOW_BIAS = 1e-5  # [m]
_HAZE_LENGTH = 40.0  # [m] at which a surface has lost 63 % of its contrast


class _Hits(NamedTuple):
    geom: NDArray[np.int32]  # (N,), −1 for a miss
    distance: NDArray[np.float64]  # (N,) in lengths of the ray's direction
    normal: NDArray[np.float64]  # (3, N) world, unit; (3, 0) if not asked for


class _Frame(NamedTuple):
    """What stays the same over the passes of one picture."""

    model: mujoco.MjModel
    data: mujoco.MjData
    view: View
    rgba: NDArray[np.float32]  # (ngeom, 4), linear RGB and opacity
    texture: NDArray[np.intp]  # (ngeom,) index of the 2-D texture, or −1


class RayRenderer:
    """Renderer by ray casting; see `aerograsp_env.sim.rendering`.

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
        self._textures = [read_texture(model, i) for i in range(model.ntex)]

    def close(self) -> None:
        """Drop the model; drawing afterwards raises RuntimeError."""
        self._model = None

    def depth(self, data: mujoco.MjData, camera: Camera) -> NDArray[np.float32]:
        """Depth (H, W) along the optical axis [m], 0 where there is no return."""
        model = open_model(self._model, data)
        view = camera_view(model, data, camera, self.width, self.height)
        # Every direction has length 1 along the optical axis, so ray parameters are depths.
        hits = self._cast(model, data, view.position, self._directions(view, 0.5, 0.5), normals=False)
        return np.where(hits.geom >= 0, hits.distance, 0.0).astype(np.float32).reshape(self.height, self.width)

    def render(self, data: mujoco.MjData, camera: Camera) -> NDArray[np.uint8]:
        """Colour picture (H, W, 3), sRGB."""
        model = open_model(self._model, data)
        view = camera_view(model, data, camera, self.width, self.height)
        frame = _Frame(model, data, view, *geom_colors(model, self._textures))
        sun, sunlight = sunlight_of(model, data)
        picture = np.zeros((3, self.height * self.width), dtype=np.float32)
        passes = self._samples**2
        for i in range(passes):
            row, column = divmod(i, self._samples)
            rays = self._directions(view, (column + 0.5) / self._samples, (row + 0.5) / self._samples)
            picture += self._colors(frame, rays, point_of_sun(sun, i, passes), sunlight)
        return encode_srgb(picture / np.float32(passes)).T.reshape(self.height, self.width, 3)

    # From here to the end of the class vectors are (3, N): numpy is several times faster on long rows.

    def _directions(self, view: View, u: float, v: float) -> Array:
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
        color = sky(rays[2] / length)
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

        light = GROUND_LIGHT + (0.5 + 0.5 * normal[2]) * (SKY_LIGHT - GROUND_LIGHT)
        direct = np.zeros(len(seen), dtype=np.float32)
        direct[lit] = cosine[lit]
        surface = albedo * (light + direct * sunlight)
        strength, exponent = gloss(model)
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
            repeat, start = texture_repeat(model, int(plane))
            for axis in (0, 1):
                u = (eye[axis] + depth * ray[axis] - start[axis]) * repeat[axis]  # the texture's period is 1
                slope = ray[axis] / ray[2]
                width = sum(np.abs(step[axis] - slope * step[2]) for step in steps.T) * depth * abs(repeat[axis])
                # A square wave's integral is a triangle wave, so its mean over a box is a difference of two of them.
                wave *= (_triangle(u + 0.5 * width) - _triangle(u - 0.5 * width)) / np.maximum(width, 1e-9)
            albedo[:, on] *= (1.0 + wave * contrast).astype(np.float32)


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
