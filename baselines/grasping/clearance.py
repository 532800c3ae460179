"""Whether a parallel-jaw gripper has room: its boxes, swept as they move, against a mesh or against points.

The gripper comes straight along its approach axis, open, and then closes on the contacts. Everything that its pads,
fingers and palm sweep on the approach, and its fingers while they close, has to be free. A box swept along one of its
own axes is again a box, so nothing of the motion is sampled. Boxes are shrunk by a tolerance on every side: the
penetration that is forgiven. Not looked at: the pads while they close (the object's faces may tilt against them by the
friction angle, so their edges may touch before their middles).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from aerograsp_env.sim.gripper import GripperConfig
from baselines.objects.mesh import MeshObject

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

TOLERANCE = 0.0005
"""[m] Penetration that is forgiven."""
APPROACH = 0.12
"""[m] How far back the gripper starts."""
FINGERS = (1, 3)
"""Which of the swept boxes are the open fingers'."""
PALM = 4
"""Which of the swept boxes is the palm's; the others are pads and fingers."""


def swept_boxes(
    gripper: GripperConfig, openings: Array, contact_widths: Array, approach: float = APPROACH, tolerance=TOLERANCE
) -> Array:
    """(G, 7, 6) lower and upper corners in the gripper's frame [m] of what its parts sweep.

    In the order of `GripperConfig.boxes` the five parts on the approach, then the left and the right finger closing.

    Args:
        openings: (G,) opening on the approach [m], in (0, max_width].
        contact_widths: (G,) distance between the contacts [m], at most the opening.
    """
    parts = gripper.boxes(gripper.max_width)
    swept = np.empty((len(openings), 7, 6))
    closing = 5
    for k, part in enumerate(parts):
        center, half = np.array(part.center), np.array(part.half_size)
        swept[:, k, :3], swept[:, k, 3:] = center - half, center + half
        side = part.name.split("_")[0]
        if side in ("left", "right"):
            sign = -1.0 if side == "left" else 1.0
            shift = 0.5 * sign * (openings - gripper.max_width)
            swept[:, k, 0] += shift
            swept[:, k, 3] += shift
            if part.name.endswith("finger"):
                swept[:, closing] = swept[:, k]
                swept[:, closing, 0 if sign > 0.0 else 3] += 0.5 * sign * (contact_widths - openings)
                closing += 1
    swept[:, :5, 2] -= approach
    swept[..., :3] += tolerance
    swept[..., 3:] -= tolerance
    return swept


@njit(cache=True, nogil=True, error_model="numpy")
def _first_point_hit(points, rotations, centers, boxes):
    found = np.full(len(centers), -1, dtype=np.int64)
    for g in range(len(centers)):
        lower, upper = np.full(3, np.inf), np.full(3, -np.inf)
        for k in range(boxes.shape[1]):
            for i in range(3):
                lower[i] = min(lower[i], boxes[g, k, i])
                upper[i] = max(upper[i], boxes[g, k, 3 + i])
        left, right, palm = -np.inf, np.inf, boxes[g, 4, 5]  # between left and right there is only the palm
        for k in range(boxes.shape[1]):
            if k != 4 and boxes[g, k, 0] + boxes[g, k, 3] < 0.0:
                left = max(left, boxes[g, k, 3])
            elif k != 4:
                right = min(right, boxes[g, k, 0])
        r = rotations[g]
        for n in range(len(points)):
            x, y, z = points[n, 0] - centers[g, 0], points[n, 1] - centers[g, 1], points[n, 2] - centers[g, 2]
            u = r[0, 0] * x + r[1, 0] * y + r[2, 0] * z
            v = r[0, 1] * x + r[1, 1] * y + r[2, 1] * z
            w = r[0, 2] * x + r[1, 2] * y + r[2, 2] * z
            near = (v > lower[1]) & (v < upper[1]) & (w > lower[2]) & (w < upper[2])
            if not near & ((w < palm) | (u < left) | (u > right)):  # one branch: each by itself is a coin toss
                continue
            for k in range(boxes.shape[1]):
                b = boxes[g, k]
                if b[0] < u and u < b[3] and b[1] < v and v < b[4] and b[2] < w and w < b[5]:
                    found[g] = k
                    break
            if found[g] >= 0:
                break
    return found


def point_collisions(points: Array, rotations: Array, centers: Array, boxes: Array) -> Ints:
    """Which box of each grasp a point is inside of: (G,), −1 where all are free.

    Exact for the points; what lies between them is not seen.

    Args:
        points: (N, 3) [m].
        rotations: (G, 3, 3) R_a_gripper.
        centers: (G, 3) gripper's origin in the points' frame [m].
        boxes: (G, 7, 6) see `swept_boxes`.
    """
    arrays = (np.ascontiguousarray(array, dtype=np.float64) for array in (points, rotations, centers, boxes))
    return np.asarray(_first_point_hit(*arrays))


@njit(cache=True, nogil=True, error_model="numpy")
def _least_distances(points, rotations, centers, boxes):
    found = np.empty(len(centers))
    for g in range(len(centers)):
        r, least = rotations[g], np.inf
        for n in range(len(points)):
            x, y, z = points[n, 0] - centers[g, 0], points[n, 1] - centers[g, 1], points[n, 2] - centers[g, 2]
            u = r[0, 0] * x + r[1, 0] * y + r[2, 0] * z
            v = r[0, 1] * x + r[1, 1] * y + r[2, 1] * z
            w = r[0, 2] * x + r[1, 2] * y + r[2, 2] * z
            for k in range(boxes.shape[1]):
                b = boxes[g, k]
                du, dv, dw = max(b[0] - u, u - b[3], 0.0), max(b[1] - v, v - b[4], 0.0), max(b[2] - w, w - b[5], 0.0)
                least = min(least, du * du + dv * dv + dw * dw)
        found[g] = np.sqrt(least)
    return found


def point_distances(points: Array, rotations: Array, centers: Array, boxes: Array, limit: float) -> Array:
    """Distance from the boxes of each grasp to the nearest point: (G,) [m], 0 inside of one and `limit` at most.

    Args:
        points, rotations, centers: as `point_collisions` has them.
        boxes: (G, K, 6) lower and upper corners in the gripper's frame [m].
        limit: [m], of what is told apart.
    """
    arrays = (np.ascontiguousarray(array, dtype=np.float64) for array in (points, rotations, centers, boxes))
    return np.minimum(_least_distances(*arrays), limit)


@njit(cache=True, nogil=True, error_model="numpy")
def _separated(ax, ay, az, p, half):
    """Whether the axis separates the triangle p (3, 3) from the box ± half about the origin."""
    reach = abs(ax) * half[0] + abs(ay) * half[1] + abs(az) * half[2]
    a = ax * p[0, 0] + ay * p[0, 1] + az * p[0, 2]
    b = ax * p[1, 0] + ay * p[1, 1] + az * p[1, 2]
    c = ax * p[2, 0] + ay * p[2, 1] + az * p[2, 2]
    return min(a, min(b, c)) > reach or max(a, max(b, c)) < -reach


@njit(cache=True, nogil=True, error_model="numpy")
def _triangle_meets_box(corners, box):
    """Separating axes: Akenine-Möller 2001, "Fast 3D triangle-box overlap testing"."""
    p, half = np.empty((3, 3)), np.empty(3)
    for i in range(3):
        half[i] = 0.5 * (box[3 + i] - box[i])
        middle = 0.5 * (box[3 + i] + box[i])
        for k in range(3):
            p[k, i] = corners[k, i] - middle
        if min(p[0, i], min(p[1, i], p[2, i])) > half[i] or max(p[0, i], max(p[1, i], p[2, i])) < -half[i]:
            return False
    e, f = p[1] - p[0], p[2] - p[0]
    if _separated(e[1] * f[2] - e[2] * f[1], e[2] * f[0] - e[0] * f[2], e[0] * f[1] - e[1] * f[0], p, half):
        return False
    for k in range(3):
        x, y, z = p[(k + 1) % 3, 0] - p[k, 0], p[(k + 1) % 3, 1] - p[k, 1], p[(k + 1) % 3, 2] - p[k, 2]
        if _separated(0.0, -z, y, p, half) or _separated(z, 0.0, -x, p, half) or _separated(-y, x, 0.0, p, half):
            return False
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _first_face_hit(node_boxes, links, corners, rotations, centers, boxes):
    found = np.full(len(centers), -1, dtype=np.int64)
    stack = np.empty(128, dtype=np.int64)
    middle, reach, moved = np.empty(3), np.empty(3), np.empty((3, 3))
    for g in range(len(centers)):
        r, c = rotations[g], centers[g]
        stack[0] = 0
        top = 1
        while top and found[g] < 0:
            top -= 1
            node = stack[top]
            b = node_boxes[node]
            for i in range(3):  # the box around the node's box in the gripper's axes
                middle[i] = reach[i] = 0.0
                for k in range(3):
                    middle[i] += r[k, i] * (0.5 * (b[k] + b[3 + k]) - c[k])
                    reach[i] += abs(r[k, i]) * 0.5 * (b[3 + k] - b[k])
            near = False
            for k in range(boxes.shape[1]):
                o = boxes[g, k]
                near = (
                    (middle[0] + reach[0] >= o[0] and middle[0] - reach[0] <= o[3])
                    and (middle[1] + reach[1] >= o[1] and middle[1] - reach[1] <= o[4])
                    and (middle[2] + reach[2] >= o[2] and middle[2] - reach[2] <= o[5])
                )
                if near:
                    break
            if not near:
                continue
            first, count = links[node]
            if first >= 0:
                stack[top], stack[top + 1] = first, count
                top += 2
                continue
            for row in range(~first, ~first + count):
                for k in range(3):
                    x, y, z = corners[row, k, 0] - c[0], corners[row, k, 1] - c[1], corners[row, k, 2] - c[2]
                    for i in range(3):
                        moved[k, i] = r[0, i] * x + r[1, i] * y + r[2, i] * z
                for k in range(boxes.shape[1]):
                    if _triangle_meets_box(moved, boxes[g, k]):
                        found[g] = k
                        break
                if found[g] >= 0:
                    break
    return found


def mesh_collisions(mesh: MeshObject, rotations: Array, centers: Array, boxes: Array) -> Ints:
    """Which box of each grasp the watertight mesh reaches into: (G,), −1 where all are free. Exact.

    Every triangle is tested against every box; a box that no triangle meets is inside the object or outside as a whole.
    Arguments as `point_collisions` has them, in the mesh's frame.
    """
    arrays = [np.ascontiguousarray(array, dtype=np.float64) for array in (rotations, centers, boxes)]
    rotations, centers, boxes = arrays
    found = np.asarray(_first_face_hit(mesh.bvh.boxes, mesh.bvh.links, mesh.bvh.corners, rotations, centers, boxes))
    longest = (boxes[..., 3:] - boxes[..., :3]).max(axis=-1)  # what is longer than the object is not inside of it
    rows, parts = np.nonzero((found < 0)[:, None] & (longest <= np.linalg.norm(mesh.extents)))
    if len(rows):
        middles = 0.5 * (boxes[rows, parts, :3] + boxes[rows, parts, 3:])
        inside = mesh.contains(centers[rows] + np.einsum("gij,gj->gi", rotations[rows], middles))
        found[rows[inside]] = parts[inside]
    return found
