"""The compiled loops of the ray renderer: rays, surfaces, light. Vectors are rows; colours are linear RGB."""

from __future__ import annotations

import math

import numpy as np

from aerograsp_env.sim.kernel_math import compiled
from aerograsp_env.sim.ray_mesh import weights
from aerograsp_env.sim.ray_paint import paint

_HAZE_LENGTH = 40.0  # [m] at which a surface has lost 63 % of its contrast
_LEAST_HAZE = 1e-3  # below it, at 1.3 m, no byte changes
_SKY_FALLOFF = 8  # how fast the sky darkens from the horizon up
_DIRECTIONAL, _SPOT = 0, 1  # shading.DIRECTIONAL, SPOT


@compiled
def pixel_rays(width, height, R, fx, fy, cx, cy):
    """World directions (H·W, 3) through each pixel's point, of length 1 along the optical axis (MuJoCo's −z).

    cx, cy: the principal point as seen from that point of the first pixel [px].
    """
    rays = np.empty((height * width, 3))
    for row in range(height):
        y = (cy - row) / fy
        for column in range(width):
            x = (column - cx) / fx
            for k in range(3):
                rays[row * width + column, k] = x * R[k, 0] + y * R[k, 1] - R[k, 2]
    return rays


@compiled
def shade(rays, geom, face, distance, normal, view, steps, rgba, covers, pyramids, corners, shapes, sky):
    """What the rays meet, lit by the sky alone.

    Args:
        rays, geom, face, distance, normal: (N, 3), (N,), (N,), (N,), (N, 3): the cast; normals are turned towards the
            camera.
        view: (3,) the camera's position; steps: (2, 3) to the neighbouring rays.
        rgba: (ngeom, 4); covers, pyramids, corners: textures; shapes: what was cast at.

    Returns:
        Colours (N, 3) of the sky and of surfaces in ambient light; surfaces' own colours (N, 3); points (N, 3); smooth
        normals (N, 3).
    """
    count = len(geom)
    color, albedo, point = np.empty((count, 3), np.float32), np.empty((count, 3), np.float32), np.empty((count, 3))
    smooth = np.empty((count, 3))
    # Arrays by themselves: tuples of them, passed on for each pixel, cost more than the work.
    kind, layout, mesh, matrix, position = covers.kind, covers.layout, shapes.mesh, shapes.rotation, shapes.position
    texels, levels, depths = pyramids.texels, pyramids.levels, pyramids.depths
    texture, density, corner = corners.texture, corners.density, corners.normal
    vertices, faces, begin = shapes.meshes.vertex, shapes.meshes.face, shapes.meshes.start
    zenith, horizon, above, below = sky.zenith, sky.horizon, sky.above, sky.below
    for i in range(count):
        g, dx, dy, dz = geom[i], rays[i, 0], rays[i, 1], rays[i, 2]
        if g < 0:
            color[i, 0], color[i, 1], color[i, 2] = _sky(dx, dy, dz, zenith, horizon)
            continue
        side = -1.0 if dx * normal[i, 0] + dy * normal[i, 1] + dz * normal[i, 2] > 0.0 else 1.0
        x, y, z = view[0] + distance[i] * dx, view[1] + distance[i] * dy, view[2] + distance[i] * dz
        nx, ny, nz = side * normal[i, 0], side * normal[i, 1], side * normal[i, 2]
        normal[i, 0], normal[i, 1], normal[i, 2] = nx, ny, nz
        point[i, 0], point[i, 1], point[i, 2] = x, y, z
        b1 = b2 = 0.0
        sx, sy, sz = nx, ny, nz
        if face[i] >= 0:
            b1, b2 = weights(vertices, faces, begin[mesh[g], 0], face[i], x, y, z, matrix, position, g)
            sx, sy, sz = _smooth(corner, face[i], b1, b2, matrix, g, side)
            if (sx * nx + sy * ny + sz * nz) < 0.0:  # a corner turned inside out
                sx, sy, sz = nx, ny, nz
        smooth[i, 0], smooth[i, 1], smooth[i, 2] = sx, sy, sz
        r, q, b = rgba[g, 0], rgba[g, 1], rgba[g, 2]
        if kind[g, 0] != 0:
            own = paint(
                kind, layout, texels, levels, depths, texture, density,
                g, face[i], b1, b2, x, y, z, nx, ny, nz, dx, dy, dz, distance[i], steps,
            )  # fmt: skip
            r, q, b = r * own[0], q * own[1], b * own[2]
        albedo[i, 0], albedo[i, 1], albedo[i, 2] = r, q, b
        up = 0.5 + 0.5 * sz
        for k in range(3):
            color[i, k] = albedo[i, k] * (below[k] + up * (above[k] - below[k]))
    return color, albedo, point, smooth


@compiled
def _smooth(normals, face, b1, b2, matrix, g, side):
    """Unit normal in the world between the normals (F, 3, 3) of a face's corners."""
    b0, n = 1.0 - b1 - b2, normals
    x = b0 * n[face, 0, 0] + b1 * n[face, 1, 0] + b2 * n[face, 2, 0]
    y = b0 * n[face, 0, 1] + b1 * n[face, 1, 1] + b2 * n[face, 2, 1]
    z = b0 * n[face, 0, 2] + b1 * n[face, 1, 2] + b2 * n[face, 2, 2]
    s = side / max(math.sqrt(x * x + y * y + z * z), 1e-12)
    x, y, z = s * x, s * y, s * z
    return (
        matrix[g, 0] * x + matrix[g, 1] * y + matrix[g, 2] * z,
        matrix[g, 3] * x + matrix[g, 4] * y + matrix[g, 5] * z,
        matrix[g, 6] * x + matrix[g, 7] * y + matrix[g, 8] * z,
    )


@compiled
def reach(lights, index, geom, point, normal, smooth):
    """Which points light `index` shines on, were nothing in the way: rows (M,), rays (M, 3) to them, strengths (M,)."""
    rows, rays, strength = np.empty(len(geom), np.int64), np.empty((len(geom), 3)), np.empty(len(geom))
    source, axis = lights.source[index], lights.travel[index]
    kind, attenuation = lights.kind[index], lights.attenuation[index]
    count = 0
    for i in range(len(geom)):
        if geom[i] < 0:
            continue
        x, y, z = point[i, 0] - source[0], point[i, 1] - source[1], point[i, 2] - source[2]
        cosine = -(x * smooth[i, 0] + y * smooth[i, 1] + z * smooth[i, 2])
        if cosine <= 0.0 or x * normal[i, 0] + y * normal[i, 1] + z * normal[i, 2] >= 0.0:
            continue
        length = math.sqrt(x * x + y * y + z * z)
        value = cosine / length
        if kind != _DIRECTIONAL:
            value /= max(attenuation[0] + length * (attenuation[1] + length * attenuation[2]), 1e-9)
            if kind == _SPOT:
                along = (x * axis[0] + y * axis[1] + z * axis[2]) / length
                if along <= max(lights.cutoff[index], 0.0):
                    continue
                value *= along ** lights.exponent[index]
        rows[count], strength[count] = i, value
        rays[count, 0], rays[count, 1], rays[count, 2] = x, y, z
        count += 1
    return rows[:count], rays[:count], strength[:count]


@compiled
def add_light(color, albedo, rays, geom, smooth, rows, to, strength, shadow, light, gloss):
    """Add one light (3,) to `color` where it is not in the `shadow` (M,). rows, to, strength: what `reach` returned."""
    for j in range(len(rows)):
        if shadow[j]:
            continue
        i = rows[j]
        length = math.sqrt(to[j, 0] ** 2 + to[j, 1] ** 2 + to[j, 2] ** 2)
        shine = gloss[geom[i], 0]
        if shine > 0.0:  # Blinn 1977
            d = math.sqrt(rays[i, 0] ** 2 + rays[i, 1] ** 2 + rays[i, 2] ** 2)
            square = cosine = facing = 0.0
            for k in range(3):
                halfway = -rays[i, k] / d - to[j, k] / length
                square += halfway * halfway
                cosine += halfway * smooth[i, k]
                facing -= to[j, k] * smooth[i, k]
            spread = max(cosine, 0.0) / math.sqrt(max(square, 1e-12))
            shine *= spread ** gloss[geom[i], 1] * strength[j] * length / facing
        for k in range(3):
            color[i, k] += light[k] * (albedo[i, k] * strength[j] + shine)


@compiled
def add_haze(color, rays, geom, distance, sky):
    """Blend surfaces into the sky behind them with distance."""
    for i in range(len(geom)):
        if geom[i] < 0:
            continue
        square = rays[i, 0] ** 2 + rays[i, 1] ** 2 + rays[i, 2] ** 2
        square *= (distance[i] / _HAZE_LENGTH) ** 2
        if square > _LEAST_HAZE:
            haze = -math.expm1(-square)
            behind = _sky(rays[i, 0], rays[i, 1], rays[i, 2], sky.zenith, sky.horizon)
            color[i, 0] += haze * (behind[0] - color[i, 0])
            color[i, 1] += haze * (behind[1] - color[i, 1])
            color[i, 2] += haze * (behind[2] - color[i, 2])


@compiled
def _sky(x, y, z, a, b):
    """Colour of the sky, from `a` at the zenith to `b` at the horizon and below."""
    sine = max(z / math.sqrt(x * x + y * y + z * z), 0.0)
    low = (1.0 - sine) ** _SKY_FALLOFF
    return a[0] + low * (b[0] - a[0]), a[1] + low * (b[1] - a[1]), a[2] + low * (b[2] - a[2])


@compiled
def encode(linear, scale, table, out):
    """Linear light (N, 3) times `scale` as bytes (N, 3), through the `table` of `shading.SRGB_OF_LINEAR`."""
    top = len(table) - 1
    for i in range(linear.shape[0]):
        for k in range(3):
            out[i, k] = table[int(min(max(linear[i, k] * scale, 0.0), 1.0) * top + 0.5)]
