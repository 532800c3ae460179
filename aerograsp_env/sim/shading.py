"""Colours of the ray renderer: materials and textures by MuJoCo's rules, the sun, the sky, and sRGB."""

from __future__ import annotations

from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

# Linear RGB. A white face that looks up at a sun overhead gets sun + sky light, just above full scale.
_SUN_COLOR = np.array([[0.98, 0.90, 0.76]], dtype=np.float32).T
SKY_LIGHT = np.array([[0.19, 0.23, 0.30]], dtype=np.float32).T  # ambient light on a face that looks up
GROUND_LIGHT = np.array([[0.16, 0.15, 0.135]], dtype=np.float32).T  # ... and on one that looks down
_ZENITH = np.array([[0.10, 0.31, 0.66]], dtype=np.float32).T
_HORIZON = np.array([[0.78, 0.86, 0.94]], dtype=np.float32).T
_DEFAULT_RGBA = np.array([0.5, 0.5, 0.5, 1.0], dtype=np.float32)  # MuJoCo's, of a geom without a colour
_SUN_DIRECTION = np.array([0.40, 0.28, -0.87])  # of travel, where the model has no light
_SUN_RADIUS = 0.010  # [rad] over which supersampling spreads the sun; twice the real one, for softer shadows
_SKY_FALLOFF = 8  # how fast the sky darkens from the horizon up
_HIGHLIGHT = 0.5  # of a material of specular 1


class Texture(NamedTuple):
    """What is used of a texture."""

    mean: Array  # (3,) linear RGB
    contrast: Array | None  # (3, 1) of a 2×2 checker: its colours are mean · (1 ± contrast)


def read_texture(model: mujoco.MjModel, index: int) -> Texture:
    """Mean colour of the model's texture `index`, and its contrast if it is a checker."""
    height, width, channels = (int(x[index]) for x in (model.tex_height, model.tex_width, model.tex_nchannel))
    start = int(model.tex_adr[index])
    pixels = model.tex_data[start : start + height * width * channels].reshape(height, width, channels)
    image = decode_srgb(np.broadcast_to(pixels[..., :3], (height, width, 3)) / 255.0)
    mean = image.mean(axis=(0, 1))
    if int(model.tex_type[index]) != int(mujoco.mjtTexture.mjTEXTURE_2D):
        return Texture(mean, None)
    rows, columns = height // 2, width // 2
    first, second = image[:rows, :columns], image[:rows, columns:]
    a, b = np.median(first, axis=(0, 1)), np.median(second, axis=(0, 1))
    # Marks along the edges may differ; nearly all else must be the two colours, crosswise.
    pattern = np.where((np.arange(height) < rows)[:, None, None] == (np.arange(width) < columns)[None, :, None], a, b)
    if np.isclose(image, pattern, atol=0.02).all(axis=2).mean() < 0.9 or np.allclose(a, b):
        return Texture(mean, None)
    mean = 0.5 * (a + b)
    return Texture(mean, (0.5 * (a - b) / np.maximum(mean, 1e-6))[:, None])


def geom_colors(model: mujoco.MjModel, textures: list[Texture]) -> tuple[NDArray[np.float32], NDArray[np.intp]]:
    """Linear colour and opacity (ngeom, 4) and index of the texture (ngeom,), by MuJoCo's rules."""
    rgba = model.geom_rgba.copy()
    material = model.geom_matid
    # A material colours a geom unless the geom's own colour was set, that is, differs from the default.
    plain = (material >= 0) & (rgba == _DEFAULT_RGBA).all(axis=1)
    rgba[plain] = model.mat_rgba[material[plain]]
    rgba[:, :3] = decode_srgb(rgba[:, :3])
    texture = np.full(model.ngeom, -1, dtype=np.intp)
    used = material >= 0
    texture[used] = model.mat_texid[material[used], int(mujoco.mjtTextureRole.mjTEXROLE_RGB)]
    for geom in np.flatnonzero(texture >= 0):
        rgba[geom, :3] *= textures[texture[geom]].mean
    return rgba, texture


def texture_repeat(model: mujoco.MjModel, plane: int) -> tuple[Array, Array]:
    """Periods of a plane's texture per metre along its x and y (2,), and where they start (2,) [m], as in MuJoCo."""
    material = model.geom_matid[plane]
    size = model.geom_size[plane, :2].clip(0.0)
    spread = (size == 0) | bool(model.mat_texuniform[material])
    # A texture starts at its upper left corner: its rows run against y.
    return np.array([0.5, -0.5]) * model.mat_texrepeat[material] / np.where(spread, 1.0, size), size * [-1.0, 1.0]


def gloss(model: mujoco.MjModel) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Strength and exponent of the highlight, (ngeom,) each; planes have none."""
    specular = np.append(model.mat_specular, np.float32(0.5))[model.geom_matid]  # −1 is the last: MuJoCo's default
    shininess = np.append(model.mat_shininess, np.float32(0.5))[model.geom_matid]
    specular[model.geom_type == int(mujoco.mjtGeom.mjGEOM_PLANE)] = 0.0
    return np.float32(_HIGHLIGHT) * specular, np.float32(128) * shininess.clip(0.02)


def sunlight_of(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[Array, Array]:
    """Unit direction towards the sun (3,) and its linear colour (3, 1)."""
    travel, color = _SUN_DIRECTION, _SUN_COLOR
    active = np.flatnonzero(model.light_active)
    if active.size:
        travel = data.light_xdir[active[0]]
        color = _SUN_COLOR * (model.light_diffuse[active[0], :, None] / np.float32(0.7))  # 0.7 is MuJoCo's default
    return -travel / np.linalg.norm(travel), color


def point_of_sun(sun: NDArray[np.float64], index: int, count: int) -> NDArray[np.float64]:
    """Direction (3,) of one of `count` points spread evenly over the sun's disc (Vogel 1979); its centre if 1."""
    if count == 1:
        return sun
    side = np.cross(sun, np.eye(3)[np.argmin(np.abs(sun))])
    side /= np.linalg.norm(side)
    radius, angle = _SUN_RADIUS * np.sqrt((index + 0.5) / count), index * np.pi * (3 - np.sqrt(5))
    point = sun + radius * (np.cos(angle) * side + np.sin(angle) * np.cross(sun, side))
    return point / np.linalg.norm(point)


def sky(sine: Array) -> Array:
    """Linear colour (3, N) of the sky by the sine of the elevation (N,)."""
    low = 1.0 - sine.astype(np.float32).clip(0.0, 1.0)
    return _ZENITH + low**_SKY_FALLOFF * (_HORIZON - _ZENITH)


def decode_srgb(value: Array) -> NDArray[np.float32]:
    """sRGB in [0, 1] as linear light."""
    value = np.asarray(value, dtype=np.float32)
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4).astype(np.float32)


_LEVELS = np.linspace(0.0, 1.0, 4096)
_SRGB = np.rint(255 * np.where(_LEVELS <= 0.0031308, 12.92 * _LEVELS, 1.055 * _LEVELS ** (1 / 2.4) - 0.055)).astype(
    np.uint8
)


def encode_srgb(linear: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Linear light, clipped to [0, 1], as sRGB bytes."""
    return _SRGB[(linear.clip(0.0, 1.0) * np.float32(4095) + np.float32(0.5)).astype(np.intp)]
