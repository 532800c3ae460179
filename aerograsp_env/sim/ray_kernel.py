"""The compiled loops of the ray renderer: rays, surfaces, light. Vectors are rows; colours are linear RGB."""

from __future__ import annotations

import math

import numpy as np

from aerograsp_env.sim.kernel_math import compiled

_HAZE_LENGTH = 40.0  # [m] at which a surface has lost 63 % of its contrast
_LEAST_HAZE = 1e-3  # below it, at 1.3 m, no byte changes
_SKY_FALLOFF = 8  # how fast the sky darkens from the horizon up
_DIRECTIONAL, _SPOT = 0, 1  # shading.DIRECTIONAL, SPOT
_CHECKER, _PLANE, _BOX = 1, 2, 3  # ray_textures.CHECKER, PLANE, BOX


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
def _texel(pyramids, image, level, u, v):
    """Colour at (u, v) in [0, 1) periods, between the four nearest texels of one level."""
    start, height, width = (
        pyramids.levels[image, level, 0],
        pyramids.levels[image, level, 1],
        pyramids.levels[image, level, 2],
    )
    x, y = u * width + (width - 0.5), v * height + (height - 0.5)  # a period further, so that int() rounds down
    c0, r0 = int(x), int(y)
    a, b = x - c0, y - r0
    c0, r0 = c0 - width if c0 >= width else c0, r0 - height if r0 >= height else r0
    c1, r1 = c0 + 1 if c0 + 1 < width else 0, r0 + 1 if r0 + 1 < height else 0
    p, q = start + r0 * width, start + r1 * width
    w, x, y, z = (1.0 - a) * (1.0 - b), a * (1.0 - b), (1.0 - a) * b, a * b
    t = pyramids.texels
    return (
        w * t[p + c0, 0] + x * t[p + c1, 0] + y * t[q + c0, 0] + z * t[q + c1, 0],
        w * t[p + c0, 1] + x * t[p + c1, 1] + y * t[q + c0, 1] + z * t[q + c1, 1],
        w * t[p + c0, 2] + x * t[p + c1, 2] + y * t[q + c0, 2] + z * t[q + c1, 2],
    )


@compiled
def _read(pyramids, image, u, v, footprint):
    """The image's colour at (u, v) periods; `footprint`: how many texels of level 0 a pixel spans."""
    u, v = u - math.floor(u), v - math.floor(v)
    if footprint <= 1.0:
        return _texel(pyramids, image, 0, u, v)
    top = pyramids.depths[image] - 1
    level = min(math.log2(footprint), float(top))
    first = int(level)
    part = level - first
    a = _texel(pyramids, image, first, u, v)
    if part == 0.0:
        return a
    b = _texel(pyramids, image, first + 1, u, v)
    return a[0] + part * (b[0] - a[0]), a[1] + part * (b[1] - a[1]), a[2] + part * (b[2] - a[2])


@compiled
def _wave(u):
    """Integral of the square wave that is +1 on the first half of each period of 1 and −1 on the second."""
    return 0.5 - abs(u - math.floor(u) - 0.5)


@compiled
def _mean_wave(u, width):
    """Mean of that square wave over `width` around u."""
    return (_wave(u + 0.5 * width) - _wave(u - 0.5 * width)) / max(width, 1e-9)


@compiled
def _paint(covers, pyramids, geom, point, normal, ray, depth, steps):
    """Colour of the texture of `geom` at `point` (3,).

    ray (3,): from the camera, of length 1 along its axis; steps (2, 3): from it to the next rays across and down.
    """
    texture, kind, R = covers.texture[geom], covers.kind[geom], covers.rotation[geom]
    x, y, z = point[0] - covers.origin[geom, 0], point[1] - covers.origin[geom, 1], point[2] - covers.origin[geom, 2]
    p = _into(R, x, y, z)
    low, high, across, down = covers.low[geom], covers.high[geom], covers.across[geom], covers.down[geom]
    if kind == _CHECKER:
        # A square wave's integral is a triangle wave, so its mean over a pixel's footprint is a difference of two.
        d = _into(R, ray[0], ray[1], ray[2])
        a, b = _into(R, steps[0, 0], steps[0, 1], steps[0, 2]), _into(R, steps[1, 0], steps[1, 1], steps[1, 2])
        slope_u, slope_v = d[0] / d[2], d[1] / d[2]
        width = (abs(a[0] - slope_u * a[2]) + abs(b[0] - slope_u * b[2])) * depth * abs(across[0])
        height = (abs(a[1] - slope_v * a[2]) + abs(b[1] - slope_v * b[2])) * depth * abs(down[1])
        wave = _mean_wave((p[0] - low[0]) * across[0], width) * _mean_wave((high[1] - p[1]) * down[1], height)
        m, c = pyramids.mean[texture], pyramids.contrast[texture]
        return m[0] * (1.0 + wave * c[0]), m[1] * (1.0 + wave * c[1]), m[2] * (1.0 + wave * c[2])

    length = math.sqrt(ray[0] ** 2 + ray[1] ** 2 + ray[2] ** 2)
    cosine = abs(ray[0] * normal[0] + ray[1] * normal[1] + ray[2] * normal[2]) / length
    # Seen at an angle a pixel is long on the surface: the middle between its sides is neither blurred nor noisy.
    step = math.sqrt(steps[0, 0] ** 2 + steps[0, 1] ** 2 + steps[0, 2] ** 2)
    pitch = depth * step / math.sqrt(max(cosine, 0.02))  # [m] a pixel spans
    image = pyramids.first[texture]
    rows, columns = pyramids.levels[image, 0, 1], pyramids.levels[image, 0, 2]
    if kind in (_PLANE, _BOX):
        axis, mirrored = 2, False
        if kind == _BOX:
            n = _into(R, normal[0], normal[1], normal[2])
            if abs(n[0]) >= abs(n[1]) and abs(n[0]) >= abs(n[2]):
                axis, mirrored = 0, n[0] < 0.0
            elif abs(n[1]) >= abs(n[2]):
                axis, mirrored = 1, n[1] > 0.0
            else:
                mirrored = n[2] < 0.0
        a, b = (1 if axis == 0 else 0), (1 if axis == 2 else 2)
        u = (p[a] - low[a]) * across[a]
        v = (high[b] - p[b]) * down[b]
        if mirrored:  # seen from outside it is not
            u = -u
        return _read(pyramids, image, u, v, pitch * max(abs(across[a]) * columns, abs(down[b]) * rows))
    # A cube: MuJoCo's order is right, left, up, down, front, back; OpenGL's orientation of each.
    x = (p[0] - 0.5 * (low[0] + high[0])) * 2.0 * across[0]
    y = (p[1] - 0.5 * (low[1] + high[1])) * 2.0 * across[1]
    z = (p[2] - 0.5 * (low[2] + high[2])) * 2.0 * across[2]
    scale = max(abs(x), abs(y), abs(z), 1e-12)
    if abs(x) >= scale:
        face, s, t = (0, -z, -y) if x > 0.0 else (1, z, -y)
    elif abs(y) >= scale:
        face, s, t = (2, x, z) if y > 0.0 else (3, x, -z)
    else:
        face, s, t = (4, x, -y) if z > 0.0 else (5, -x, -y)
    if pyramids.faces[texture] == 1:
        face = 0
    half = 0.5 / columns  # no wrapping over a face's edge
    u, v = min(max(0.5 + 0.5 * s / scale, half), 1.0 - half), min(max(0.5 + 0.5 * t / scale, half), 1.0 - half)
    return _read(pyramids, image + face, u, v, pitch * max(across[0], across[1], across[2]) / scale * columns)


@compiled
def _into(R, x, y, z):
    """Rᵀ @ (x, y, z): world to texture's frame."""
    return (
        R[0, 0] * x + R[1, 0] * y + R[2, 0] * z,
        R[0, 1] * x + R[1, 1] * y + R[2, 1] * z,
        R[0, 2] * x + R[1, 2] * y + R[2, 2] * z,
    )


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
    for i in range(count):
        g = geom[i]
        if g < 0:
            color[i, 0], color[i, 1], color[i, 2] = _sky(rays[i], sky)
            continue
        facing = rays[i, 0] * normal[i, 0] + rays[i, 1] * normal[i, 1] + rays[i, 2] * normal[i, 2]
        for k in range(3):
            if facing > 0.0:
                normal[i, k] = -normal[i, k]
            point[i, k] = view[k] + distance[i] * rays[i, k]
            albedo[i, k] = rgba[g, k]
        if covers.kind[g] != 0:
            paint = _paint(covers, pyramids, g, point[i], normal[i], rays[i], distance[i], steps)
            albedo[i, 0] *= paint[0]
            albedo[i, 1] *= paint[1]
            albedo[i, 2] *= paint[2]
        up = 0.5 + 0.5 * normal[i, 2]
        for k in range(3):
            color[i, k] = albedo[i, k] * (sky.below[k] + up * (sky.above[k] - sky.below[k]))
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
def add_light(color, albedo, rays, geom, normal, rows, to, strength, shadow, light, gloss):
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
                cosine += halfway * normal[i, k]
                facing -= to[j, k] * normal[i, k]
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
            behind = _sky(rays[i], sky)
            color[i, 0] += haze * (behind[0] - color[i, 0])
            color[i, 1] += haze * (behind[1] - color[i, 1])
            color[i, 2] += haze * (behind[2] - color[i, 2])


@compiled
def _sky(ray, sky):
    sine = max(ray[2] / math.sqrt(ray[0] ** 2 + ray[1] ** 2 + ray[2] ** 2), 0.0)
    low = (1.0 - sine) ** _SKY_FALLOFF
    a, b = sky.zenith, sky.horizon
    return a[0] + low * (b[0] - a[0]), a[1] + low * (b[1] - a[1]), a[2] + low * (b[2] - a[2])


@compiled
def encode(linear, scale, table, out):
    """Linear light (N, 3) times `scale` as bytes (N, 3), through the `table` of `shading.SRGB_OF_LINEAR`."""
    top = len(table) - 1
    for i in range(linear.shape[0]):
        for k in range(3):
            out[i, k] = table[int(min(max(linear[i, k] * scale, 0.0), 1.0) * top + 0.5)]
