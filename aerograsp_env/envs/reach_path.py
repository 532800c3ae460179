"""Paths of targets that an arm can follow: smooth, closed, below and in front of the vehicle, clear of it.

Paths are closed curves of joint angles, q(s) = q₀ + a sin s + b cos s, taken through the arm's kinematics at the
hover's nominal pose: what they pass through can be reached, and is checked to be clear of the vehicle. With a and b
the joint motions that move the tool along two perpendicular vectors of equal length, they are nearly circles.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim.kernel_math import compiled
from aerograsp_env.sim.manipulation import layout as lay
from aerograsp_env.sim.manipulation.kernel_arm import forward, jacobian
from aerograsp_env.sim.manipulation.task import Episode

POINTS = 128  # of a path
RADII = (0.06, 0.12)  # of the nearly circular paths [m]
MARGIN = 0.15  # of a path from the joint limits [rad]
LOWEST_GAIN = 0.05  # least singular value of the position's Jacobian along a path [m/rad]
HIGHEST, HINDMOST = -0.22, -0.10  # of a path, body z and x [m]: below the vehicle and in front
BENDING_RADIUS = 0.04  # least along a path [m]
CHECKED = 8  # configurations along a path that are checked for reach and collisions
_ATTEMPTS, _BATCH = 400, 64


@compiled
def _trace(p, center, sine, cosine, out):
    """Tool positions (M, 3), body frame, along q(s) = center + sine sin s + cosine cos s."""
    poses, tool, q = np.empty((lay.JOINTS, 4, 4)), np.empty((4, 4)), np.empty(lay.JOINTS)
    for m in range(out.shape[0]):
        s = 2.0 * math.pi * m / out.shape[0]
        for i in range(center.shape[0]):
            q[i] = center[i] + sine[i] * math.sin(s) + cosine[i] * math.cos(s)
        forward(p, 0, q, poses, tool)
        for i in range(3):
            out[m, i] = tool[i, 3]


@compiled
def _gain(p, q, moves):
    """The square of the least singular value of the tool's Jacobian (position) at q (n,); its pseudo-inverse (n, 3)."""
    n = q.shape[0]
    poses, tool, j = np.empty((lay.JOINTS, 4, 4)), np.empty((4, 4)), np.empty((6, lay.JOINTS))
    padded = np.zeros(lay.JOINTS)
    padded[:n] = q
    forward(p, 0, padded, poses, tool)
    jacobian(p, 0, poses, tool, j)
    gram = np.zeros((3, 3))
    for a in range(3):
        for b in range(3):
            for i in range(n):
                gram[a, b] += j[a, i] * j[b, i]
    least = np.linalg.eigvalsh(gram)[0]
    if least > LOWEST_GAIN**2:
        inverse = np.linalg.inv(gram)
        moves[:] = 0.0
        for i in range(n):
            for a in range(3):
                for b in range(3):
                    moves[i, a] += j[b, i] * inverse[b, a]
    return least


@compiled
def _bends(curve):
    """The least radius of curvature of a closed curve (M, 3) of equal parameter steps, by central differences [m]."""
    count, least = curve.shape[0], 1e9
    for m in range(count):
        before, here, after = curve[m - 1], curve[m], curve[(m + 1) % count]
        u, v = 0.5 * (after - before), after - 2.0 * here + before
        x, y, z = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
        speed = math.sqrt(u[0] ** 2 + u[1] ** 2 + u[2] ** 2)
        turning = math.sqrt(x * x + y * y + z * z)
        if turning > 0.0:
            least = min(least, speed**3 / turning)
    return least


@compiled
def _search(p, low, high, uniforms, normals, curve, waves):
    """The first of M drawn paths that is good, or −1: uniforms (M, n + 1) in [0, 1), normals (M, 2, 3).

    Writes its points (POINTS, 3), body frame, and its joint waves (3, n): centre, sine, cosine.
    """
    n = low.shape[0]
    moves, q = np.empty((n, 3)), np.empty(n)
    for k in range(uniforms.shape[0]):
        center = low + uniforms[k, :n] * (high - low)
        if _gain(p, center, moves) < LOWEST_GAIN**2:
            continue
        u = normals[k, 0] / np.linalg.norm(normals[k, 0])
        v = normals[k, 1] - np.sum(normals[k, 1] * u) * u
        v /= np.linalg.norm(v)
        largest = RADII[1]  # that the joints' limits leave
        for i in range(n):
            sine, cosine = np.sum(moves[i] * u), np.sum(moves[i] * v)
            waves[0, i], waves[1, i], waves[2, i] = center[i], sine, cosine
            room = min(center[i] - low[i], high[i] - center[i])
            largest = min(largest, room / max(math.sqrt(sine**2 + cosine**2), 1e-9))
        if largest < RADII[0]:
            continue
        waves[1:] *= RADII[0] + uniforms[k, n] * (largest - RADII[0])
        _trace(p, waves[0], waves[1], waves[2], curve)
        if curve[:, 2].max() > HIGHEST or curve[:, 0].min() < HINDMOST or _bends(curve) < BENDING_RADIUS:
            continue
        able = True
        for m in range(CHECKED):
            s = 2.0 * math.pi * m / CHECKED
            for i in range(n):
                q[i] = waves[0, i] + waves[1, i] * math.sin(s) + waves[2, i] * math.cos(s)
            able = able and _gain(p, q, moves) >= LOWEST_GAIN**2
        if able:
            return k
    return -1


def equidistant(curve: NDArray[np.float64], count: int) -> tuple[NDArray[np.float64], float]:
    """`count` points at equal distances along the closed polygon `curve` (M, 3), and its length [m]."""
    closed = np.concatenate([curve, curve[:1]])
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    at = np.arange(count) * along[-1] / count
    return np.stack([np.interp(at, along, closed[:, i]) for i in range(3)], axis=1), float(along[-1])


def draw_path(episode: Episode, limits: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Equidistant points (POINTS, 3) of a path for the first arm, body frame of the level vehicle, and its length [m].

    The arm's joints in `episode.data` are left anywhere.
    """
    rng, n, p = episode.rng, len(limits), episode.parameters.reshape(1)[0]
    low, high = limits.T + np.array([[MARGIN], [-MARGIN]])
    curve, waves, angles = np.empty((POINTS, 3)), np.empty((3, n)), 2.0 * np.pi * np.arange(CHECKED) / CHECKED
    for _ in range(_ATTEMPTS):
        uniforms, normals = rng.uniform(size=(_BATCH, n + 1)), rng.standard_normal((_BATCH, 2, 3))
        if _search(p, low, high, uniforms, normals, curve, waves) < 0:
            continue
        configurations = waves[0] + np.outer(np.sin(angles), waves[1]) + np.outer(np.cos(angles), waves[2])
        if _clear(episode, configurations):
            path, length = equidistant(curve, POINTS)
            return np.roll(path, -rng.integers(POINTS), axis=0), length
    raise RuntimeError(f"no path of targets found in {_ATTEMPTS * _BATCH} attempts")


def _clear(episode: Episode, configurations: NDArray[np.float64]) -> bool:
    joints = episode.arm_joints(0)
    for q in configurations:
        joints[:] = q
        mujoco.mj_fwdPosition(episode.model, episode.data)
        if episode.data.ncon:
            return False
    return True
