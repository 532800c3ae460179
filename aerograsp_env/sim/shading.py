"""Colours of the ray renderer: materials by MuJoCo's rules, lights, the sky, and sRGB.

The unit of light is such that a white face that looks up at a sun overhead is just above full scale in sun and sky.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim.ray_textures import LINEAR_OF_BYTE, decode_srgb

__all__ = ["LINEAR_OF_BYTE", "Lights", "Sky", "decode_srgb", "encode_srgb", "geom_colors", "gloss", "lights_of"]

Array = NDArray[Any]

# Linear RGB.
_SUN_COLOR = np.array([0.98, 0.90, 0.76])
_LAMP_COLOR = np.array([0.90, 0.90, 0.90])  # of spots and points: indoors the camera's white is the lamps'
_SKY_LIGHT = np.array([0.19, 0.23, 0.30])  # ambient light on a face that looks up
_GROUND_LIGHT = np.array([0.16, 0.15, 0.135])  # ... and on one that looks down
_ZENITH = np.array([0.10, 0.31, 0.66])
_HORIZON = np.array([0.78, 0.86, 0.94])
_DEFAULT_RGBA = np.array([0.5, 0.5, 0.5, 1.0], dtype=np.float32)  # MuJoCo's, of a geom without a colour
_SUN_DIRECTION = np.array([0.40, 0.28, -0.87])  # of travel, where the model has no light
_SUN_RADIUS = 0.010  # [rad] over which supersampling spreads the sun; twice the real one, for softer shadows
_SUN_DISTANCE = 5e3  # [m]; far enough for parallel rays (0.1° over 10 m), near enough for 1e-7 m in double precision
_HIGHLIGHT = 0.5  # of a material of specular 1
_FULL_DIFFUSE = 0.7  # MuJoCo's default, which shines as the colours above
_FULL_AMBIENT = 0.1  # MuJoCo's default of the headlight, which is full daylight

DIRECTIONAL, SPOT, POINT = range(3)


class Sky(NamedTuple):
    """Linear RGB (3,) each: of the sky itself, and of the light that comes from above and from below."""

    zenith: Array
    horizon: Array
    above: Array
    below: Array


class Lights(NamedTuple):
    """All lights that shine, each as one point: rays that are cast together start at one point."""

    kind: NDArray[np.int64]  # (L,) DIRECTIONAL, SPOT, POINT
    source: NDArray[np.float64]  # (L, 3) world [m]; far away for DIRECTIONAL
    travel: NDArray[np.float64]  # (L, 3) unit, along the light's axis
    color: NDArray[np.float32]  # (L, 3) linear
    attenuation: NDArray[np.float64]  # (L, 3) 1 / (a + b d + c d²) at the distance d [m]
    cutoff: NDArray[np.float64]  # (L,) cosine of a spot's half angle
    exponent: NDArray[np.float64]  # (L,) of that cosine: how a spot fades off its axis
    shadow: NDArray[np.bool_]  # (L,)


def geom_colors(model: mujoco.MjModel) -> NDArray[np.float32]:
    """Linear colour and opacity (ngeom, 4), by MuJoCo's rules, without textures."""
    rgba = model.geom_rgba.copy()
    material = model.geom_matid
    # A material colours a geom unless the geom's own colour was set, that is, differs from the default.
    plain = (material >= 0) & (rgba == _DEFAULT_RGBA).all(axis=1)
    rgba[plain] = model.mat_rgba[material[plain]]
    rgba[:, :3] = decode_srgb(rgba[:, :3])
    return rgba


def gloss(model: mujoco.MjModel) -> NDArray[np.float32]:
    """Strength and exponent of the highlight (ngeom, 2); planes have none."""
    specular = np.append(model.mat_specular, np.float32(0.5))[model.geom_matid]  # −1 is the last: MuJoCo's default
    shininess = np.append(model.mat_shininess, np.float32(0.5))[model.geom_matid]
    specular[model.geom_type == int(mujoco.mjtGeom.mjGEOM_PLANE)] = 0.0
    return np.stack([np.float32(_HIGHLIGHT) * specular, np.float32(128) * shininess.clip(0.02)], axis=1)


def sky_of(model: mujoco.MjModel) -> Sky:
    """The sky and the ambient light: of full day where the headlight's ambient is 0.1 or more, less below it.

    The ambient light of the model's own lights comes on top, from all sides alike.
    """
    head = model.vis.headlight
    day = (np.asarray(head.ambient, dtype=np.float64) / _FULL_AMBIENT).clip(0.0, 1.0) if head.active else np.zeros(3)
    lamps = model.light_ambient[np.flatnonzero(model.light_active)].sum(axis=0, dtype=np.float64)
    lamps *= _SKY_LIGHT[1] / _FULL_AMBIENT
    return Sky(day * _ZENITH, day * _HORIZON, day * _SKY_LIGHT + lamps, day * _GROUND_LIGHT + lamps)


def lights_of(model: mujoco.MjModel, data: mujoco.MjData, index: int = 0, count: int = 1) -> Lights:
    """The active lights, or one sun if the model has none; `index` of `count` points of each light's disc.

    Image lights are left out. A diffuse colour of 0.7, MuJoCo's default, is the sun's (or a lamp's) full strength.
    """
    kinds = {
        int(mujoco.mjtLightType.mjLIGHT_DIRECTIONAL): DIRECTIONAL,
        int(mujoco.mjtLightType.mjLIGHT_SPOT): SPOT,
        int(mujoco.mjtLightType.mjLIGHT_POINT): POINT,
    }
    shining = [i for i in np.flatnonzero(model.light_active) if int(model.light_type[i]) in kinds]
    if not np.any(model.light_active):
        travel = _SUN_DIRECTION / np.linalg.norm(_SUN_DIRECTION)
        source = model.stat.center - _SUN_DISTANCE * _disc(travel, index, count, _SUN_RADIUS)
        one = np.ones(1)
        return Lights(
            *(np.array([DIRECTIONAL]), source[None], travel[None], _SUN_COLOR[None].astype(np.float32)),
            *(np.array([[1.0, 0.0, 0.0]]), -one, one, np.array([True])),
        )
    kind = np.array([kinds[int(model.light_type[i])] for i in shining], np.int64)
    travel = data.light_xdir[shining]
    travel = travel / np.linalg.norm(travel, axis=1, keepdims=True)
    source = data.light_xpos[shining]
    for row, i in enumerate(shining):
        if kind[row] == DIRECTIONAL:
            source[row] = model.stat.center - _SUN_DISTANCE * _disc(travel[row], index, count, _SUN_RADIUS)
        elif count > 1:
            source[row] += _disc(travel[row], index, count, float(model.light_bulbradius[i])) - travel[row]
    color = np.where((kind == DIRECTIONAL)[:, None], _SUN_COLOR, _LAMP_COLOR)
    return Lights(
        *(kind, source, travel, (color * model.light_diffuse[shining] / _FULL_DIFFUSE).astype(np.float32)),
        model.light_attenuation[shining].astype(np.float64),
        np.cos(np.deg2rad(model.light_cutoff[shining].astype(np.float64))),
        model.light_exponent[shining].astype(np.float64),
        model.light_castshadow[shining].astype(bool),
    )


def _disc(axis: Array, index: int, count: int, radius: float) -> Array:
    """`axis` (3,) plus one of `count` points spread evenly over a disc across it (Vogel 1979); its centre if 1."""
    if count == 1:
        return axis
    side = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    side /= np.linalg.norm(side)
    r, angle = radius * np.sqrt((index + 0.5) / count), index * np.pi * (3 - np.sqrt(5))
    return axis + r * (np.cos(angle) * side + np.sin(angle) * np.cross(axis, side))


_STEPS = np.linspace(0.0, 1.0, 4096)
SRGB_OF_LINEAR: NDArray[np.uint8] = np.rint(
    255 * np.where(_STEPS <= 0.0031308, 12.92 * _STEPS, 1.055 * _STEPS ** (1 / 2.4) - 0.055)
).astype(np.uint8)
"""(4096,) sRGB byte of linear light in [0, 1]."""


def encode_srgb(linear: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Linear light, clipped to [0, 1], as sRGB bytes."""
    return SRGB_OF_LINEAR[(linear.clip(0.0, 1.0) * np.float32(4095) + np.float32(0.5)).astype(np.intp)]
