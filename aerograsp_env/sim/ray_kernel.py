"""The compiled loops of the ray renderer: rays, surfaces, light. Vectors are rows; colours are linear RGB."""

from __future__ import annotations

import math

import numba
import numpy as np

_SHADOW_BIAS = 1e-5  # [m]
_HAZE_LENGTH = 40.0  # [m] at which a surface has lost 63 % of its contrast
_SKY_FALLOFF = 8  # how fast the sky darkens from the horizon up
_DIRECTIONAL, _SPOT = 0, 1  # shading.DIRECTIONAL, SPOT
_CHECKER, _PLANE, _BOX = 1, 2, 3  # ray_textures.CHECKER, PLANE, BOX

compiled = numba.njit(cache=True, error_model="numpy")


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
def depth_of(geom, distance):
    """Depth (N,) with 0 for a miss."""
    depth = np.zeros(len(geom), np.float32)
    for i in range(len(geom)):
        if geom[i] >= 0:
            depth[i] = distance[i]
    return depth


@compiled
def _texel(pyramids, image, level, u, v, k):
    """Channel k at (u, v) periods, between the four nearest texels of one level."""
    start, height, width = pyramids.levels[image, level]
    x, y = u * width - 0.5, v * height - 0.5
    fx, fy = math.floor(x), math.floor(y)
    c0, r0 = int(fx) % width, int(fy) % height
    c1, r1 = (c0 + 1) % width, (r0 + 1) % height
    a, b = x - fx, y - fy
    texels = pyramids.texels
    top = (1.0 - a) * texels[start + r0 * width + c0, k] + a * texels[start + r0 * width + c1, k]
    low = (1.0 - a) * texels[start + r1 * width + c0, k] + a * texels[start + r1 * width + c1, k]
    return (1.0 - b) * top + b * low


@compiled
def _read(pyramids, image, u, v, footprint, color):
    """Multiply the image's colour at (u, v) into `color`; `footprint`: how many texels of level 0 a pixel spans."""
    top = pyramids.depths[image] - 1
    level = min(max(math.log2(max(footprint, 1e-9)), 0.0), float(top))
    first = min(int(level), top)
    part = level - first
    for k in range(3):
        value = _texel(pyramids, image, first, u, v, k)
        if part > 0.0:
            value += part * (_texel(pyramids, image, first + 1, u, v, k) - value)
        color[k] *= value


@compiled
def _wave(u):
    """Integral of the square wave that is +1 on the first half of each period of 1 and −1 on the second."""
    return 0.5 - abs(u - math.floor(u) - 0.5)


@compiled
def _paint(covers, pyramids, geom, point, normal, ray, depth, steps, color):
    """Multiply the texture of `geom` at `point` (3,) into `color` (3,).

    ray (3,): from the camera, of length 1 along its axis; steps (2, 3): from it to the next rays across and down.
    """
    texture, kind, R = covers.texture[geom], covers.kind[geom], covers.rotation[geom]
    p, n, d = np.empty(3), np.empty(3), np.empty(3)
    for k in range(3):
        p[k] = n[k] = d[k] = 0.0
        for j in range(3):
            p[k] += R[j, k] * (point[j] - covers.origin[geom, j])
            n[k] += R[j, k] * normal[j]
            d[k] += R[j, k] * ray[j]
    if kind == _CHECKER:
        # A square wave's integral is a triangle wave, so its mean over a pixel's footprint is a difference of two.
        wave = 1.0
        for axis in range(2):
            if axis == 0:
                rate, u = covers.across[geom, 0], (p[0] - covers.low[geom, 0]) * covers.across[geom, 0]
            else:
                rate, u = covers.down[geom, 1], (covers.high[geom, 1] - p[1]) * covers.down[geom, 1]
            slope, width = d[axis] / d[2], 0.0
            for s in range(2):
                along = up = 0.0
                for j in range(3):
                    along += R[j, axis] * steps[s, j]
                    up += R[j, 2] * steps[s, j]
                width += abs(along - slope * up)
            width *= depth * abs(rate)
            wave *= (_wave(u + 0.5 * width) - _wave(u - 0.5 * width)) / max(width, 1e-9)
        for k in range(3):
            color[k] *= pyramids.mean[texture, k] * (1.0 + wave * pyramids.contrast[texture, k])
        return
    length, cosine, step = 0.0, 0.0, 0.0
    for k in range(3):
        length += ray[k] ** 2
        cosine += ray[k] * normal[k]
        step += steps[0, k] ** 2
    # Seen at an angle a pixel is long on the surface: the middle between its sides is neither blurred nor noisy.
    pitch = depth * math.sqrt(step / max(abs(cosine) / math.sqrt(length), 0.02))  # [m] a pixel spans
    image = pyramids.first[texture]
    if kind in (_PLANE, _BOX):
        axis = 2
        if kind == _BOX:
            axis = 0 if abs(n[0]) >= abs(n[1]) and abs(n[0]) >= abs(n[2]) else (1 if abs(n[1]) >= abs(n[2]) else 2)
        a, b = (1 if axis == 0 else 0), (1 if axis == 2 else 2)
        u = (p[a] - covers.low[geom, a]) * covers.across[geom, a]
        v = (covers.high[geom, b] - p[b]) * covers.down[geom, b]
        if kind == _BOX and (n[axis] < 0.0) != (axis == 1):
            u = -u  # not mirrored when seen from outside
        height, width = pyramids.levels[image, 0, 1], pyramids.levels[image, 0, 2]
        texels = max(abs(covers.across[geom, a]) * width, abs(covers.down[geom, b]) * height)
        _read(pyramids, image, u, v, pitch * texels, color)
        return
    # A cube: MuJoCo's order is right, left, up, down, front, back; OpenGL's orientation of each.
    scale = 0.0
    for k in range(3):
        p[k] = (p[k] - 0.5 * (covers.low[geom, k] + covers.high[geom, k])) * 2.0 * covers.across[geom, k]
        scale = max(scale, abs(p[k]))
    x, y, z = p[0], p[1], p[2]
    if abs(x) >= scale:
        face, s, t = (0, -z, -y) if x > 0.0 else (1, z, -y)
    elif abs(y) >= scale:
        face, s, t = (2, x, z) if y > 0.0 else (3, x, -z)
    else:
        face, s, t = (4, x, -y) if z > 0.0 else (5, -x, -y)
    if pyramids.faces[texture] == 1:
        face = 0
    scale = max(scale, 1e-12)
    half = 0.5 / pyramids.levels[image, 0, 2]  # no wrapping over a face's edge
    u, v = min(max(0.5 + 0.5 * s / scale, half), 1.0 - half), min(max(0.5 + 0.5 * t / scale, half), 1.0 - half)
    texels = covers.across[geom].max() / scale * pyramids.levels[image, 0, 2]
    _read(pyramids, image + face, u, v, pitch * texels, color)


@compiled
def shade(rays, geom, distance, normal, view, steps, rgba, covers, pyramids, sky):
    """What the rays meet, lit by the sky alone.

    Args:
        rays, geom, distance, normal: (N, 3), (N,), (N,), (N, 3): the cast; normals are turned towards the camera.
        view: (3,) the camera's position; steps: (2, 3) to the neighbouring rays.

    Returns:
        Colours (N, 3) of the sky and of surfaces in ambient light; surfaces' own colours (N, 3); points (N, 3).
    """
    count = len(geom)
    color, albedo, point = np.empty((count, 3), np.float32), np.empty((count, 3), np.float32), np.empty((count, 3))
    own = np.empty(3)
    for i in range(count):
        g = geom[i]
        if g < 0:
            _sky(rays[i], sky, color[i])
            continue
        facing = rays[i, 0] * normal[i, 0] + rays[i, 1] * normal[i, 1] + rays[i, 2] * normal[i, 2]
        for k in range(3):
            if facing > 0.0:
                normal[i, k] = -normal[i, k]
            point[i, k] = view[k] + distance[i] * rays[i, k]
            own[k] = rgba[g, k]
        if covers.kind[g] != 0:
            _paint(covers, pyramids, g, point[i], normal[i], rays[i], distance[i], steps, own)
        up = 0.5 + 0.5 * normal[i, 2]
        for k in range(3):
            albedo[i, k] = own[k]
            color[i, k] = own[k] * (sky.below[k] + up * (sky.above[k] - sky.below[k]))
    return color, albedo, point


@compiled
def reach(lights, index, geom, point, normal):
    """Which points light `index` shines on, were nothing in the way: rows (M,), rays (M, 3) to them, strengths (M,)."""
    rows, rays, strength = np.empty(len(geom), np.int64), np.empty((len(geom), 3)), np.empty(len(geom))
    source, axis = lights.source[index], lights.travel[index]
    kind, attenuation = lights.kind[index], lights.attenuation[index]
    count = 0
    for i in range(len(geom)):
        if geom[i] < 0:
            continue
        x, y, z = point[i, 0] - source[0], point[i, 1] - source[1], point[i, 2] - source[2]
        cosine = -(x * normal[i, 0] + y * normal[i, 1] + z * normal[i, 2])
        if cosine <= 0.0:
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
def add_light(color, albedo, rays, geom, normal, rows, to, strength, first, distance, light, gloss):
    """Add one light (3,) to `color` where nothing stands before the points: the first thing met is the surface.

    rows, to, strength: what `reach` returned; first, distance (M,): the cast of its rays, or empty for no shadows.
    """
    for j in range(len(rows)):
        i = rows[j]
        length = math.sqrt(to[j, 0] ** 2 + to[j, 1] ** 2 + to[j, 2] ** 2)
        if len(first) and first[j] >= 0 and distance[j] <= 1.0 - _SHADOW_BIAS / length:
            continue
        shine = gloss[geom[i], 0]
        if shine > 0.0:  # Blinn 1977
            d = math.sqrt(rays[i, 0] ** 2 + rays[i, 1] ** 2 + rays[i, 2] ** 2)
            square = cosine = facing = 0.0
            for k in range(3):
                halfway = -rays[i, k] / d - to[j, k] / length
                square += halfway * halfway
                cosine += halfway * normal[i, k]
                facing -= to[j, k] * normal[i, k]
            spread = max(cosine, 0.0) / math.sqrt(max(square, 1e-12))
            shine *= spread ** gloss[geom[i], 1] * strength[j] * length / facing
        for k in range(3):
            color[i, k] += light[k] * (albedo[i, k] * strength[j] + shine)


@compiled
def add_haze(color, rays, geom, distance, sky):
    """Blend surfaces into the sky behind them with distance."""
    behind = np.empty(3, np.float32)
    for i in range(len(geom)):
        if geom[i] < 0:
            continue
        square = rays[i, 0] ** 2 + rays[i, 1] ** 2 + rays[i, 2] ** 2
        haze = -math.expm1(-(distance[i] ** 2) * square / _HAZE_LENGTH**2)
        _sky(rays[i], sky, behind)
        for k in range(3):
            color[i, k] += haze * (behind[k] - color[i, k])


@compiled
def _sky(ray, sky, out):
    sine = ray[2] / math.sqrt(ray[0] ** 2 + ray[1] ** 2 + ray[2] ** 2)
    low = (1.0 - max(sine, 0.0)) ** _SKY_FALLOFF
    for k in range(3):
        out[k] = sky.zenith[k] + low * (sky.horizon[k] - sky.zenith[k])


@compiled
def encode(linear, scale, table, out):
    """Linear light (N, 3) times `scale` as bytes (N, 3), through the `table` of `shading.SRGB_OF_LINEAR`."""
    top = len(table) - 1
    for i in range(linear.shape[0]):
        for k in range(3):
            out[i, k] = table[int(min(max(linear[i, k] * scale, 0.0), 1.0) * top + 0.5)]
