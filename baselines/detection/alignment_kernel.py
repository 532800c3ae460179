"""The compiled part of model alignment: steps from many starts, and how well each pose agrees with what is seen."""

from __future__ import annotations

import numpy as np
from numba import njit

compiled = njit(cache=True, nogil=True, error_model="numpy")

POINT_SHARE = 0.1
"""Weight of distances between points next to those to tangent planes: keeps flat parts from sliding."""
STRETCH_PULL = 1e-4
"""How much a stretch is drawn to 1: this times the squared diameter, next to the squared distance of one pair."""


@compiled
def _nearest(x, y, z, origin, cell, nearest):
    """The model's point nearest to a place in its frame, by the cell that the place (or the grid's edge) lies in."""
    i = min(max(int(np.floor((x - origin[0]) / cell)), 0), nearest.shape[0] - 1)
    j = min(max(int(np.floor((y - origin[1]) / cell)), 0), nearest.shape[1] - 1)
    k = min(max(int(np.floor((z - origin[2]) / cell)), 0), nearest.shape[2] - 1)
    return nearest[i, j, k]


@compiled
def _small_turn(v):
    """(3, 3) rotation of a rotation vector."""
    angle = np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    a = np.sin(angle) / angle if angle > 1e-9 else 1.0
    b = (1.0 - np.cos(angle)) / (angle * angle) if angle > 1e-9 else 0.5
    x, y, z = v[0], v[1], v[2]
    R = np.empty((3, 3))
    R[0, 0], R[1, 1], R[2, 2] = 1.0 - b * (y * y + z * z), 1.0 - b * (x * x + z * z), 1.0 - b * (x * x + y * y)
    R[0, 1], R[1, 0] = b * x * y - a * z, b * x * y + a * z
    R[0, 2], R[2, 0] = b * x * z + a * y, b * x * z - a * y
    R[1, 2], R[2, 1] = b * y * z - a * x, b * y * z + a * x
    return R


@compiled
def _solve(A, b):
    """A x = b for a symmetric positive definite A (6, 6) by Cholesky, in place; false where it is not."""
    n = len(b)
    for j in range(n):
        total = A[j, j]
        for k in range(j):
            total -= A[j, k] * A[j, k]
        if total <= 0.0:
            return False
        A[j, j] = np.sqrt(total)
        for i in range(j + 1, n):
            total = A[i, j]
            for k in range(j):
                total -= A[i, k] * A[j, k]
            A[i, j] = total / A[j, j]
    for i in range(n):
        for k in range(i):
            b[i] -= A[i, k] * b[k]
        b[i] /= A[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            b[i] -= A[k, i] * b[k]
        b[i] /= A[i, i]
    return True


@compiled
def iterate(
    points, viewpoint, R, t, d, surface, normals, origin, cell, nearest, first_gate, last_gate, iterations, scale, most
):
    """Move (R, t, d), which map the cloud into the model's frame by p -> d * (R p + t), in place towards the model.

    Point-to-plane steps with Tukey's weights, whose gate shrinks from the first to the last; pairs with surface that
    faces away from the viewpoint do not count. Where `most` > 1, the stretch d (3,) along the model's axes is adjusted
    too, between its inverse and it, and drawn to 1. `scale` [m] balances turns and shifts in the damping. Returns the
    number of steps, negative where too few pairs were left.
    """
    size = 9 if most > 1.0 else 6
    A, b, row = np.empty((size, size)), np.empty(size), np.empty(size)
    shrink = (last_gate / first_gate) ** (1.0 / max(iterations - 1, 1))
    gate = first_gate
    for step in range(iterations):
        A[:], b[:] = 0.0, 0.0
        limit, pairs = gate * gate, 0
        vx = d[0] * (R[0, 0] * viewpoint[0] + R[0, 1] * viewpoint[1] + R[0, 2] * viewpoint[2] + t[0])
        vy = d[1] * (R[1, 0] * viewpoint[0] + R[1, 1] * viewpoint[1] + R[1, 2] * viewpoint[2] + t[1])
        vz = d[2] * (R[2, 0] * viewpoint[0] + R[2, 1] * viewpoint[1] + R[2, 2] * viewpoint[2] + t[2])
        for i in range(len(points)):
            px, py, pz = points[i, 0], points[i, 1], points[i, 2]
            x = d[0] * (R[0, 0] * px + R[0, 1] * py + R[0, 2] * pz + t[0])
            y = d[1] * (R[1, 0] * px + R[1, 1] * py + R[1, 2] * pz + t[1])
            z = d[2] * (R[2, 0] * px + R[2, 1] * py + R[2, 2] * pz + t[2])
            m = _nearest(x, y, z, origin, cell, nearest)
            dx, dy, dz = x - surface[m, 0], y - surface[m, 1], z - surface[m, 2]
            gap = dx * dx + dy * dy + dz * dz
            if gap >= limit:
                continue
            nx, ny, nz = normals[m, 0], normals[m, 1], normals[m, 2]
            if nx * (vx - x) + ny * (vy - y) + nz * (vz - z) <= 0.0:
                continue
            weight = (1.0 - gap / limit) ** 2
            pairs += 1
            error = nx * dx + ny * dy + nz * dz
            # Each pair measures its difference with the information w (n nᵀ + s I); the difference changes with a shift
            # v, a turn w and a change of log d, by D (v + w × u) + diag(x) δ, where u = (x, y, z) / d.
            ux, uy, uz = x / d[0], y / d[1], z / d[2]
            ax, ay, az = d[0] * nx, d[1] * ny, d[2] * nz
            row[0], row[1], row[2] = ax, ay, az
            row[3], row[4], row[5] = uy * az - uz * ay, uz * ax - ux * az, ux * ay - uy * ax
            if size == 9:
                row[6], row[7], row[8] = ax * ux, ay * uy, az * uz
            for r in range(size):
                scaled = weight * row[r]
                b[r] -= scaled * error
                for c in range(r + 1):
                    A[r, c] += scaled * row[c]
            weight *= POINT_SHARE
            fx, fy, fz = weight * d[0] * d[0], weight * d[1] * d[1], weight * d[2] * d[2]
            gx, gy, gz = weight * d[0] * dx, weight * d[1] * dy, weight * d[2] * dz
            b[0] -= gx
            b[1] -= gy
            b[2] -= gz
            b[3] -= uy * gz - uz * gy
            b[4] -= uz * gx - ux * gz
            b[5] -= ux * gy - uy * gx
            A[0, 0] += fx
            A[1, 1] += fy
            A[2, 2] += fz
            A[3, 1] -= fy * uz
            A[3, 2] += fz * uy
            A[4, 0] += fx * uz
            A[4, 2] -= fz * ux
            A[5, 0] -= fx * uy
            A[5, 1] += fy * ux
            A[3, 3] += fy * uz * uz + fz * uy * uy
            A[4, 4] += fx * uz * uz + fz * ux * ux
            A[5, 5] += fx * uy * uy + fy * ux * ux
            A[4, 3] -= fz * ux * uy
            A[5, 3] -= fy * ux * uz
            A[5, 4] -= fx * uy * uz
            if size == 9:
                b[6] -= ux * gx
                b[7] -= uy * gy
                b[8] -= uz * gz
                A[6, 0] += fx * ux
                A[7, 1] += fy * uy
                A[8, 2] += fz * uz
                A[7, 3] -= fy * uy * uz
                A[8, 3] += fz * uz * uy
                A[6, 4] += fx * ux * uz
                A[8, 4] -= fz * uz * ux
                A[6, 5] -= fx * ux * uy
                A[7, 5] += fy * uy * ux
                A[6, 6] += fx * ux * ux
                A[7, 7] += fy * uy * uy
                A[8, 8] += fz * uz * uz
        if pairs < 6:
            return -step - 1
        damping = 1e-4 * pairs
        for r in range(3):
            A[r, r] += damping
            A[r + 3, r + 3] += damping * scale * scale
            if size == 9:
                pull = STRETCH_PULL * pairs * scale * scale
                A[r + 6, r + 6] += pull
                b[r + 6] -= pull * np.log(d[r])
        if not _solve(A, b):
            return -step - 1
        turn = _small_turn(b[3:6])
        R[:] = turn @ R
        t[:] = turn @ t + b[:3]
        if size == 9:
            for r in range(3):
                d[r] = min(max(d[r] * np.exp(b[r + 6]), 1.0 / most), most)
        gate *= shrink
    return iterations


@compiled
def fit(points, R, t, d, surface, normals, origin, cell, nearest, gate):
    """Share of the points with surface within the gate, mean of squared distances cut at the gate over the gate's
    square, and the root mean square [m] of the inliers' distances to tangent planes."""
    inside, cost, squares = 0, 0.0, 0.0
    for i in range(len(points)):
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        x = d[0] * (R[0, 0] * px + R[0, 1] * py + R[0, 2] * pz + t[0])
        y = d[1] * (R[1, 0] * px + R[1, 1] * py + R[1, 2] * pz + t[1])
        z = d[2] * (R[2, 0] * px + R[2, 1] * py + R[2, 2] * pz + t[2])
        m = _nearest(x, y, z, origin, cell, nearest)
        dx, dy, dz = x - surface[m, 0], y - surface[m, 1], z - surface[m, 2]
        gap = dx * dx + dy * dy + dz * dz
        if gap < gate * gate:
            inside += 1
            cost += gap / (gate * gate)
            squares += (normals[m, 0] * dx + normals[m, 1] * dy + normals[m, 2] * dz) ** 2
        else:
            cost += 1.0
    n = len(points)
    return inside / n, cost / n, np.sqrt(squares / inside) if inside else np.nan


@compiled
def seen(surface, normals, R, t, d, viewpoint, depth, fx, fy, cx, cy, left, top, tolerance):
    """How many of the model's points that face the camera are seen where they should be, and how many are not there.

    (R, t, d) map the camera's frame into the model's. `depth` (H, W) [m] is a part of the image that starts at pixel
    (left, top). What is hidden behind something nearer, lies outside, or has no return does not count.
    """
    there, missing = 0, 0
    for m in range(len(surface)):
        dx, dy, dz = surface[m, 0] / d[0] - t[0], surface[m, 1] / d[1] - t[1], surface[m, 2] / d[2] - t[2]
        x = R[0, 0] * dx + R[1, 0] * dy + R[2, 0] * dz
        y = R[0, 1] * dx + R[1, 1] * dy + R[2, 1] * dz
        z = R[0, 2] * dx + R[1, 2] * dy + R[2, 2] * dz
        if z <= 0.0:
            continue
        ax, ay, az = normals[m, 0] * d[0], normals[m, 1] * d[1], normals[m, 2] * d[2]
        nx = R[0, 0] * ax + R[1, 0] * ay + R[2, 0] * az
        ny = R[0, 1] * ax + R[1, 1] * ay + R[2, 1] * az
        nz = R[0, 2] * ax + R[1, 2] * ay + R[2, 2] * az
        if nx * (viewpoint[0] - x) + ny * (viewpoint[1] - y) + nz * (viewpoint[2] - z) <= 0.0:
            continue
        u, v = int(np.rint(fx * x / z + cx)) - left, int(np.rint(fy * y / z + cy)) - top
        if u < 0 or v < 0 or u >= depth.shape[1] or v >= depth.shape[0]:
            continue
        got = depth[v, u]
        if got <= 0.0:
            continue
        if got > z + tolerance:
            missing += 1
        elif got >= z - tolerance:
            there += 1
    return there, missing


@compiled
def refine(
    points,
    viewpoint,
    Rs,
    ts,
    ds,
    surface,
    normals,
    origin,
    cell,
    nearest,
    looked,
    camera,
    depth,
    first,
    last,
    steps,
    scale,
    most,
):
    """Move the poses Rs (K, 3, 3), ts (K, 3), ds (K, 3) in place, and give the score (K,) of each in [0, 1].

    A score is the closeness of the points to the model times the share of the model's points `looked` (M,) that is
    seen where it should be. `camera` is fx, fy, cx, cy, left, top; a depth without pixels is left out of the score.
    """
    scores = np.zeros(len(Rs))
    some, their_normals = surface[looked], normals[looked]
    for k in range(len(Rs)):
        R, t, d = Rs[k], ts[k], ds[k]
        done = iterate(
            points, viewpoint, R, t, d, surface, normals, origin, cell, nearest, first, last, steps, scale, most
        )
        if done < 0:
            continue
        _, cost, _ = fit(points, R, t, d, surface, normals, origin, cell, nearest, last)
        scores[k] = 1.0 - cost
        if depth.size and scores[k] > 0.0:
            there, missing = seen(
                some,
                their_normals,
                R,
                t,
                d,
                viewpoint,
                depth,
                camera[0],
                camera[1],
                camera[2],
                camera[3],
                int(camera[4]),
                int(camera[5]),
                last,
            )
            scores[k] *= there / max(there + missing, 1)
    return scores
