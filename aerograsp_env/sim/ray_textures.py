"""Image textures of the ray renderer: pyramids in linear light, and how each geom is covered by its material's texture.

A plane takes its texture as in MuJoCo. Every other geom takes a two-dimensional texture by box projection: each point
of the surface reads the image as if projected along the axis of the geom's frame that its normal is closest to, upright
and not mirrored when seen from outside (MuJoCo's rasteriser lays it differently on each kind of geom). The frame of a
mesh is that of its file, not the one that MuJoCo moves into its inertia's axes. `texrepeat` counts repeats over the
geom's extent, or with `texuniform` over 2 m, as on MuJoCo's planes. A cube texture is read in the direction from the
geom's middle, after scaling to its extent unless `texuniform` is set.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

PLAIN, CHECKER, PLANE, BOX, CUBE = range(5)
"""How a geom is covered: not at all; by an analytic checker; as MuJoCo's planes; by box projection; by a cube."""

_LEVELS = 15  # enough for 16384 px


def decode_srgb(value: Array) -> NDArray[np.float32]:
    """sRGB in [0, 1] as linear light."""
    value = np.asarray(value, dtype=np.float32)
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4).astype(np.float32)


LINEAR_OF_BYTE: NDArray[np.float32] = decode_srgb(np.arange(256) / 255.0)
"""(256,) linear light of each sRGB byte."""


class Pyramids(NamedTuple):
    """The images of all textures, each followed by its halved copies. A cube texture has one image or six."""

    texels: NDArray[np.float32]  # (P, 3) linear RGB, images one after another, row by row from the top
    levels: NDArray[np.int64]  # (images, levels, 3): first texel, height, width
    depths: NDArray[np.int64]  # (images,) how many levels each has
    first: NDArray[np.int64]  # (textures,) first image
    faces: NDArray[np.int64]  # (textures,) images: 1 or 6
    cube: NDArray[np.bool_]  # (textures,)
    contrast: NDArray[np.float32]  # (textures, 3) of a 2×2 checker, whose colours are mean · (1 ± contrast); else 0
    mean: NDArray[np.float32]  # (textures, 3) linear RGB


class Covers(NamedTuple):
    """How textures lie on geoms, in the texture's frame: that of the geom or of the mesh's file."""

    kind: NDArray[np.int64]  # (ngeom,) PLAIN … CUBE
    texture: NDArray[np.int64]  # (ngeom,) index, or −1
    rotation: NDArray[np.float64]  # (ngeom, 3, 3) world from texture's frame
    origin: NDArray[np.float64]  # (ngeom, 3) world [m]
    low: NDArray[np.float64]  # (ngeom, 3) [m] where the image's left edge lies along each axis
    high: NDArray[np.float64]  # (ngeom, 3) [m] where its upper edge lies
    across: NDArray[np.float64]  # (ngeom, 3) [1/m] periods of the image's columns along each axis
    down: NDArray[np.float64]  # (ngeom, 3) [1/m] of its rows


def read_textures(model: mujoco.MjModel) -> Pyramids:
    """All textures of a model."""
    texels: list[Array] = []
    levels: list[Array] = []
    depths: list[int] = []
    first, faces, cube = [], [], []
    contrast, mean = np.zeros((model.ntex, 3), np.float32), np.zeros((model.ntex, 3), np.float32)
    total = 0
    for index in range(model.ntex):
        height, width, channels = (int(x[index]) for x in (model.tex_height, model.tex_width, model.tex_nchannel))
        start = int(model.tex_adr[index])
        data = model.tex_data[start : start + height * width * channels].reshape(height, width, channels)
        image = LINEAR_OF_BYTE[np.broadcast_to(data[..., :3] if channels >= 3 else data[..., :1], (height, width, 3))]
        kind = int(model.tex_type[index])
        cube.append(kind == int(mujoco.mjtTexture.mjTEXTURE_CUBE))
        mean[index] = image.mean(axis=(0, 1))
        if kind == int(mujoco.mjtTexture.mjTEXTURE_2D):
            mean[index], contrast[index] = _checker(image, mean[index])
        first.append(len(depths))
        faces.append(6 if cube[-1] and height == 6 * width else 1)
        for face in image.reshape(faces[-1], -1, width, 3):
            pyramid = _halve(face)
            row = np.zeros((_LEVELS, 3), np.int64)
            for level, part in enumerate(pyramid):
                row[level] = total, *part.shape[:2]
                texels.append(part.reshape(-1, 3))
                total += len(texels[-1])
            levels.append(row)
            depths.append(len(pyramid))
    return Pyramids(
        np.concatenate(texels) if texels else np.zeros((1, 3), np.float32),
        np.array(levels, np.int64).reshape(-1, _LEVELS, 3),
        np.array(depths, np.int64),
        np.array(first, np.int64),
        np.array(faces, np.int64),
        np.array(cube, np.bool_),
        contrast,
        mean,
    )


def mesh_frames(model: mujoco.MjModel) -> tuple[Array, Array, Array]:
    """Rotation (nmesh, 3, 3), translation (nmesh, 3) and extent (nmesh, 2, 3) of meshes in the frames of their files.

    MuJoCo keeps vertices in the axes of inertia; a file's coordinates are rotation @ vertex + translation.
    """
    rotation, extent = np.zeros((model.nmesh, 9)), np.zeros((model.nmesh, 2, 3))
    for mesh in range(model.nmesh):
        mujoco.mju_quat2Mat(rotation[mesh], model.mesh_quat[mesh])
        start = int(model.mesh_vertadr[mesh])
        vertices = model.mesh_vert[start : start + int(model.mesh_vertnum[mesh])]
        points = vertices @ rotation[mesh].reshape(3, 3).T + model.mesh_pos[mesh]
        extent[mesh] = points.min(axis=0), points.max(axis=0)
    return rotation.reshape(-1, 3, 3), model.mesh_pos.copy(), extent


def lay_textures(
    model: mujoco.MjModel, data: mujoco.MjData, pyramids: Pyramids, meshes: tuple[Array, Array, Array]
) -> Covers:
    """Where textures lie on the geoms now."""
    n = model.ngeom
    texture = np.full(n, -1, np.int64)
    rotation, origin = data.geom_xmat.reshape(n, 3, 3), data.geom_xpos
    material = model.geom_matid
    if model.ntex and model.nmat:
        used = material >= 0
        texture[used] = model.mat_texid[material[used], int(mujoco.mjtTextureRole.mjTEXROLE_RGB)]
    on = np.flatnonzero(texture >= 0)
    kind = np.zeros(n, np.int64)
    low, high, across, down = np.zeros((4, n, 3))
    if not on.size:
        return Covers(kind, texture, rotation, origin, low, high, across, down)
    plane = model.geom_type[on] == int(mujoco.mjtGeom.mjGEOM_PLANE)
    cube = pyramids.cube[texture[on]]
    kind[on] = np.where(cube, CUBE, np.where(plane, PLANE, BOX))
    checker = plane & ~cube & pyramids.contrast[texture[on]].any(axis=1)
    kind[on[checker]] = CHECKER

    middle, half = model.geom_aabb[on, :3], model.geom_aabb[on, 3:].copy()
    lower, upper = middle - half, middle + half
    mesh = np.flatnonzero((model.geom_type[on] == int(mujoco.mjtGeom.mjGEOM_MESH)) & (model.geom_dataid[on] >= 0))
    if mesh.size:
        rotation, origin = rotation.copy(), origin.copy()
        R, t, extent = (part[model.geom_dataid[on[mesh]]] for part in meshes)
        rotation[on[mesh]] = rotation[on[mesh]] @ R.swapaxes(1, 2)
        origin[on[mesh]] -= np.einsum("nij,nj->ni", rotation[on[mesh]], t)
        lower[mesh], upper[mesh] = extent[:, 0], extent[:, 1]
    size = model.geom_size[on].clip(0.0)
    size[:, 2] = 0.0
    lower[plane], upper[plane] = -size[plane], size[plane]
    half = 0.5 * (upper - lower)
    uniform = model.mat_texuniform[material[on]].astype(bool)
    scale = np.where(uniform[:, None] | (half <= 0.0), 1.0, half)
    low[on], high[on] = lower, upper
    across[on] = 0.5 * model.mat_texrepeat[material[on], :1] / scale
    down[on] = 0.5 * model.mat_texrepeat[material[on], 1:] / scale
    return Covers(kind, texture, rotation, origin, low, high, across, down)


def _checker(image: Array, mean: Array) -> tuple[Array, Array]:
    """Mean (3,) and contrast (3,) of a 2×2 checker; the given mean and 0 if it is none."""
    height, width = image.shape[:2]
    rows, columns = height // 2, width // 2
    if not (rows and columns):
        return mean, np.zeros(3, np.float32)
    first, second = image[:rows, :columns], image[:rows, columns:]
    a, b = np.median(first, axis=(0, 1)), np.median(second, axis=(0, 1))
    # Marks along the edges may differ; nearly all else must be the two colours, crosswise.
    pattern = np.where((np.arange(height) < rows)[:, None, None] == (np.arange(width) < columns)[None, :, None], a, b)
    if np.allclose(a, b) or np.isclose(image, pattern, atol=0.02).all(axis=2).mean() < 0.9:
        return mean, np.zeros(3, np.float32)
    mean = 0.5 * (a + b)
    return mean, 0.5 * (a - b) / np.maximum(mean, 1e-6)


def _halve(image: Array) -> list[NDArray[np.float32]]:
    """The image and its halved copies down to one texel; an odd last row or column is left out of the next."""
    levels = [np.ascontiguousarray(image, dtype=np.float32)]
    while max(levels[-1].shape[:2]) > 1:
        last = levels[-1]
        for axis in (0, 1):
            n = last.shape[axis] // 2
            if n:
                even = last[: 2 * n : 2] if axis == 0 else last[:, : 2 * n : 2]
                odd = last[1 : 2 * n : 2] if axis == 0 else last[:, 1 : 2 * n : 2]
                last = 0.5 * (even + odd)
        levels.append(np.ascontiguousarray(last, dtype=np.float32))
    return levels
