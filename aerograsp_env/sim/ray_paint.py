"""Reading textures at points of surfaces: part of the compiled loops of the ray renderer."""

from __future__ import annotations

import math

from numba import njit

from aerograsp_env.sim.ray_textures import BOX, CHECKER, CORNERS, CUBE

inlined = njit(cache=True, nogil=True, error_model="numpy", forceinline=True)


@inlined
def _texel(texels, levels, image, level, u, v):
    """Colour at (u, v) in [0, 1) periods, between the four nearest texels of one level."""
    start, height, width = levels[image, level, 0], levels[image, level, 1], levels[image, level, 2]
    x, y = u * width + (width - 0.5), v * height + (height - 0.5)  # a period further, so that int() rounds down
    c0, r0 = int(x), int(y)
    a, b = x - c0, y - r0
    c0, r0 = c0 - width if c0 >= width else c0, r0 - height if r0 >= height else r0
    c1, r1 = c0 + 1 if c0 + 1 < width else 0, r0 + 1 if r0 + 1 < height else 0
    p, q = start + r0 * width, start + r1 * width
    w, x, y, z = (1.0 - a) * (1.0 - b), a * (1.0 - b), (1.0 - a) * b, a * b
    t = texels
    return (
        w * t[p + c0, 0] + x * t[p + c1, 0] + y * t[q + c0, 0] + z * t[q + c1, 0],
        w * t[p + c0, 1] + x * t[p + c1, 1] + y * t[q + c0, 1] + z * t[q + c1, 1],
        w * t[p + c0, 2] + x * t[p + c1, 2] + y * t[q + c0, 2] + z * t[q + c1, 2],
    )


@inlined
def read_image(texels, levels, depths, image, u, v, footprint):
    """The image's colour at (u, v) periods; `footprint`: how many texels of its first level a pixel spans."""
    u, v = u - math.floor(u), v - math.floor(v)
    if footprint <= 1.0:
        return _texel(texels, levels, image, 0, u, v)
    level = min(math.log2(footprint), depths[image] - 1.0)
    first = int(level)
    part = level - first
    a = _texel(texels, levels, image, first, u, v)
    if part == 0.0:
        return a
    b = _texel(texels, levels, image, first + 1, u, v)
    return a[0] + part * (b[0] - a[0]), a[1] + part * (b[1] - a[1]), a[2] + part * (b[2] - a[2])


@inlined
def _into(layout, g, x, y, z):
    """A vector of the world in the texture's frame of geom g."""
    return (
        layout[g, 0] * x + layout[g, 3] * y + layout[g, 6] * z,
        layout[g, 1] * x + layout[g, 4] * y + layout[g, 7] * z,
        layout[g, 2] * x + layout[g, 5] * y + layout[g, 8] * z,
    )


@inlined
def _wave(u):
    """Integral of the square wave that is +1 on the first half of each period of 1 and −1 on the second."""
    return 0.5 - abs(u - math.floor(u) - 0.5)


@inlined
def _mean_wave(u, width):
    """Mean of that square wave over `width` around u."""
    return (_wave(u + 0.5 * width) - _wave(u - 0.5 * width)) / max(width, 1e-9)


@inlined
def checker(layout, g, p, d, depth, a, b):
    """Colour of a checker on a plane, averaged over a pixel.

    All in the plane's frame: the point p, the ray d (of length 1 along the camera's axis), the steps a and b from it to
    the next rays across and down. A square wave's integral is a triangle wave, so its mean is a difference of two.
    """
    slope_u, slope_v = d[0] / d[2], d[1] / d[2]
    width = (abs(a[0] - slope_u * a[2]) + abs(b[0] - slope_u * b[2])) * depth * abs(layout[g, 18])
    height = (abs(a[1] - slope_v * a[2]) + abs(b[1] - slope_v * b[2])) * depth * abs(layout[g, 22])
    wave = _mean_wave((p[0] - layout[g, 12]) * layout[g, 18], width)
    wave *= _mean_wave((layout[g, 16] - p[1]) * layout[g, 22], height)
    return (
        layout[g, 24] * (1.0 + wave * layout[g, 27]),
        layout[g, 25] * (1.0 + wave * layout[g, 28]),
        layout[g, 26] * (1.0 + wave * layout[g, 29]),
    )


@inlined
def place(kind, layout, g, p, n):
    """Where a point p of a surface with normal n, both in the texture's frame, lies in the image of geom g.

    Returns:
        The image; u and v [periods]; texels of the image a metre.
    """
    first, height, width = kind[g, 1], kind[g, 3], kind[g, 4]
    if kind[g, 0] == CUBE:
        # MuJoCo's order is right, left, up, down, front, back; OpenGL's orientation of each.
        x = (p[0] - 0.5 * (layout[g, 12] + layout[g, 15])) * 2.0 * layout[g, 18]
        y = (p[1] - 0.5 * (layout[g, 13] + layout[g, 16])) * 2.0 * layout[g, 19]
        z = (p[2] - 0.5 * (layout[g, 14] + layout[g, 17])) * 2.0 * layout[g, 20]
        scale = max(abs(x), abs(y), abs(z), 1e-12)
        if abs(x) >= scale:
            face, s, t = (0, -z, -y) if x > 0.0 else (1, z, -y)
        elif abs(y) >= scale:
            face, s, t = (2, x, z) if y > 0.0 else (3, x, -z)
        else:
            face, s, t = (4, x, -y) if z > 0.0 else (5, -x, -y)
        half = 0.5 / width  # no wrapping over a face's edge
        u, v = min(max(0.5 + 0.5 * s / scale, half), 1.0 - half), min(max(0.5 + 0.5 * t / scale, half), 1.0 - half)
        rate = max(layout[g, 18], layout[g, 19], layout[g, 20]) / scale * width
        return first + (face if kind[g, 2] > 1 else 0), u, v, rate
    axis, mirrored = 2, False
    if kind[g, 0] == BOX:
        x, y, z = abs(n[0]), abs(n[1]), abs(n[2])
        if x >= y and x >= z:
            axis, mirrored = 0, n[0] < 0.0
        elif y >= z:
            axis, mirrored = 1, n[1] > 0.0
        else:
            mirrored = n[2] < 0.0
    a, b = (1 if axis == 0 else 0), (1 if axis == 2 else 2)
    u = ((p[1] if axis == 0 else p[0]) - layout[g, 12 + a]) * layout[g, 18 + a]
    v = (layout[g, 15 + b] - (p[1] if axis == 2 else p[2])) * layout[g, 21 + b]
    if mirrored:  # seen from outside it is not
        u = -u
    return first, u, v, max(abs(layout[g, 18 + a]) * width, abs(layout[g, 21 + b]) * height)


@inlined
def paint(
    kind, layout, texels, levels, depths, texture, density,
    g, face, b1, b2, x, y, z, nx, ny, nz, dx, dy, dz, depth, steps,
):  # fmt: skip
    """Colour of the texture of geom g at the point (x, y, z) with the normal n, seen along the ray d.

    kind, layout: of `Covers`; texels, levels, depths: of `Pyramids`; texture, density: of `Corners`.
    face, b1, b2: of meshes the row of `texture` and the weights of its second and third corner.
    steps (2, 3): from the ray, of length 1 along the camera's axis, to the next rays across and down.
    """
    p = _into(layout, g, x - layout[g, 9], y - layout[g, 10], z - layout[g, 11])
    if kind[g, 0] == CHECKER:
        a = _into(layout, g, steps[0, 0], steps[0, 1], steps[0, 2])
        b = _into(layout, g, steps[1, 0], steps[1, 1], steps[1, 2])
        return checker(layout, g, p, _into(layout, g, dx, dy, dz), depth, a, b)
    if kind[g, 0] == CORNERS and face >= 0:
        c, b0 = texture, 1.0 - b1 - b2
        image = kind[g, 1]
        u = (b0 * c[face, 0, 0] + b1 * c[face, 1, 0] + b2 * c[face, 2, 0]) * layout[g, 18]
        v = (b0 * c[face, 0, 1] + b1 * c[face, 1, 1] + b2 * c[face, 2, 1]) * layout[g, 21]
        rate = density[face] * math.sqrt(kind[g, 3] * kind[g, 4] * abs(layout[g, 18] * layout[g, 21]))
    else:
        image, u, v, rate = place(kind, layout, g, p, _into(layout, g, nx, ny, nz))
    cosine = abs(dx * nx + dy * ny + dz * nz) / math.sqrt(dx * dx + dy * dy + dz * dz)
    # Seen at an angle a pixel is long on the surface: the middle between its sides is neither blurred nor noisy.
    step = math.sqrt(steps[0, 0] ** 2 + steps[0, 1] ** 2 + steps[0, 2] ** 2)
    footprint = depth * step * rate / math.sqrt(max(cosine, 0.02))
    return read_image(texels, levels, depths, image, u, v, footprint)
