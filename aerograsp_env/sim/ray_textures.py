"""Image textures of the ray renderer: pyramids in linear light, and how each geom is covered by its material's texture.

A plane takes its texture as in MuJoCo, and so does a mesh with texture coordinates. Every other geom takes a
two-dimensional texture by box projection: each point of the surface reads the image as if projected along the axis of
the geom's frame that its normal is closest to, upright and not mirrored when seen from outside (MuJoCo's rasteriser
lays it differently on each kind of geom). The frame of a mesh is that of its file, not the one that MuJoCo moves into
its inertia's axes. `texrepeat` counts repeats over the geom's extent, or with `texuniform` over 2 m, as on MuJoCo's
planes. A cube texture is read in the direction from the geom's middle, after scaling to its extent unless `texuniform`
is set.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim.kernel_math import compiled

Array = NDArray[Any]

PLAIN, CHECKER, PLANE, BOX, CUBE, CORNERS = range(6)
"""How a geom is covered: not; by an analytic checker; like MuJoCo's planes; by boxes; by a cube; by its corners."""

_GEOM_PLANE, _GEOM_MESH = int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_MESH)
_RGB = int(mujoco.mjtTextureRole.mjTEXROLE_RGB)
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


class Corners(NamedTuple):
    """What meshes keep of each face's corners, and the frames of their files.

    MuJoCo moves vertices into the axes of inertia: a file's coordinates are rotation @ vertex + translation.
    """

    normal: NDArray[np.float32]  # (faces, 3, 3) in MuJoCo's frame
    texture: NDArray[np.float32]  # (faces, 3, 2) coordinates in periods, v upwards; 0 if the mesh has none
    density: NDArray[np.float32]  # (faces,) [1/m] periods a metre
    mapped: NDArray[np.bool_]  # (meshes,) which have texture coordinates
    rotation: NDArray[np.float64]  # (meshes, 3, 3)
    translation: NDArray[np.float64]  # (meshes, 3)
    extent: NDArray[np.float64]  # (meshes, 2, 3) [m] in the file's frame


class Covers(NamedTuple):
    """How textures lie on geoms: rows of `layout` numbers, for the compiled loops."""

    kind: NDArray[np.int64]  # (ngeom, 5): PLAIN … CORNERS, first image, images, height and width of the image
    layout: NDArray[np.float64]  # (ngeom, 30) see `_lay`


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


def read_corners(model: mujoco.MjModel) -> Corners:
    """The corners of all faces of a model's meshes."""
    count = model.nmeshface
    normal, texture = np.zeros((count, 3, 3), np.float32), np.zeros((count, 3, 2), np.float32)
    density, mapped = np.zeros(count, np.float32), np.zeros(model.nmesh, np.bool_)
    rotation, extent = np.zeros((model.nmesh, 9)), np.zeros((model.nmesh, 2, 3))
    for mesh in range(model.nmesh):
        mujoco.mju_quat2Mat(rotation[mesh], model.mesh_quat[mesh])
        vertices = _part(model.mesh_vert, model.mesh_vertadr[mesh], model.mesh_vertnum[mesh])
        points = vertices @ rotation[mesh].reshape(3, 3).T + model.mesh_pos[mesh]
        extent[mesh] = points.min(axis=0), points.max(axis=0)
        faces = slice(int(model.mesh_faceadr[mesh]), int(model.mesh_faceadr[mesh] + model.mesh_facenum[mesh]))
        normals = _part(model.mesh_normal, model.mesh_normaladr[mesh], model.mesh_normalnum[mesh])
        normal[faces] = normals[model.mesh_facenormal[faces]]
        if model.mesh_texcoordadr[mesh] < 0:
            continue
        mapped[mesh] = True
        coordinates = _part(model.mesh_texcoord, model.mesh_texcoordadr[mesh], model.mesh_texcoordnum[mesh])
        texture[faces] = coordinates[model.mesh_facetexcoord[faces]]
        a, b = np.diff(vertices[model.mesh_face[faces]], axis=1).swapaxes(0, 1)
        u, v = np.diff(texture[faces], axis=1).swapaxes(0, 1)
        area = np.linalg.norm(np.cross(a, b), axis=1).clip(1e-12)
        density[faces] = np.sqrt(np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]) / area)
    return Corners(normal, texture, density, mapped, rotation.reshape(-1, 3, 3), model.mesh_pos.copy(), extent)


def _part(array: Array, start: int, count: int) -> Array:
    return array[int(start) : int(start) + int(count)]


def lay_textures(model: mujoco.MjModel, data: mujoco.MjData, pyramids: Pyramids, corners: Corners) -> Covers:
    """Where textures lie on the geoms now."""
    kind, layout = np.zeros((model.ngeom, 5), np.int64), np.empty((model.ngeom, 30))
    if model.ntex and model.nmat:
        _lay(
            *(kind, layout, pyramids, corners, model.geom_type, model.geom_dataid, model.geom_size, model.geom_aabb),
            *(data.geom_xpos, data.geom_xmat, model.geom_matid, model.mat_texid, model.mat_texuniform),
            model.mat_texrepeat,
        )
    return Covers(kind, layout)


@compiled
def _lay(kind, layout, pyramids, corners, shape, mesh, size, box, position, rotation, material, image, uniform, repeat):
    """Fill `kind` and `layout` of textured geoms. `layout` is, in the texture's frame (the geom's, or the mesh file's):

    rotation to the world (0–8), origin in the world (9–11), where the image's left edge lies along each axis (12–14)
    and where its upper edge lies (15–17) [m], periods of its columns (18–20) and of its rows (21–23) [1/m] along each
    axis (of faces' own coordinates the factors), and a checker's mean (24–26) and contrast (27–29).
    """
    for g in range(len(kind)):
        texture = image[material[g], _RGB] if material[g] >= 0 else -1
        if texture < 0:
            continue
        is_plane, m = shape[g] == _GEOM_PLANE, mesh[g] if shape[g] == _GEOM_MESH else -1
        if pyramids.cube[texture]:
            kind[g, 0] = CUBE
        elif is_plane:
            kind[g, 0] = PLANE
            for k in range(3):
                if pyramids.contrast[texture, k] != 0.0:
                    kind[g, 0] = CHECKER
        else:
            kind[g, 0] = CORNERS if m >= 0 and corners.mapped[m] else BOX
        first = pyramids.first[texture]
        kind[g, 1], kind[g, 2] = first, pyramids.faces[texture]
        kind[g, 3], kind[g, 4] = pyramids.levels[first, 0, 1], pyramids.levels[first, 0, 2]
        for k in range(3):
            layout[g, 9 + k] = position[g, k]
            low, high = box[g, k] - box[g, 3 + k], box[g, k] + box[g, 3 + k]
            for j in range(3):
                layout[g, 3 * k + j] = rotation[g, 3 * k + j]
            if is_plane:
                high = max(size[g, k], 0.0) if k < 2 else 0.0
                low = -high
            if m >= 0:
                low, high = corners.extent[m, 0, k], corners.extent[m, 1, k]
                for j in range(3):
                    layout[g, 3 * k + j] = 0.0
                    for i in range(3):
                        layout[g, 3 * k + j] += rotation[g, 3 * k + i] * corners.rotation[m, j, i]
                for j in range(3):
                    layout[g, 9 + k] -= layout[g, 3 * k + j] * corners.translation[m, j]
            half = 0.5 * (high - low)
            scale = 1.0 if uniform[material[g]] or half <= 0.0 else half
            if kind[g, 0] == CORNERS:  # the faces' own coordinates are multiplied
                scale = 0.5
            layout[g, 12 + k], layout[g, 15 + k] = low, high
            layout[g, 18 + k], layout[g, 21 + k] = (
                0.5 * repeat[material[g], 0] / scale,
                0.5 * repeat[material[g], 1] / scale,
            )
            layout[g, 24 + k], layout[g, 27 + k] = pyramids.mean[texture, k], pyramids.contrast[texture, k]


def _checker(image: Array, mean: Array) -> tuple[Array, Array]:
    """Mean (3,) and contrast (3,) of a 2×2 checker; the given mean and 0 if it is none."""
    height, width = image.shape[:2]
    rows, columns = height // 2, width // 2
    a, b, c, d = (image[i * height // 4, j * width // 4] for i, j in ((1, 1), (1, 3), (3, 3), (3, 1)))
    if not (rows and columns) or max(np.abs(a - c).max(), np.abs(b - d).max()) > 0.02:  # most images end here
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
