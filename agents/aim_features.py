"""What a network sees of a grasp that is flown with the tool somewhere else than planned.

The tool's displacement from the grasp is partly intended (the aim) and partly not (the estimate's bias). What lies
between the pads, before the fingers and under them then follows from the tracker's model and the support: that geometry
is computed here for many displacements at once, so that the network need not learn it. Frame: the grasp's (x closing,
z approach). Grasps are the same with x or y reversed, and so are the features.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim.gripper import GripperConfig
from aerograsp_env.sim.kernel_math import compiled
from aerograsp_env.spatial import inverse
from baselines.grasping.on_model import volume_center
from baselines.grasping.scenes import Scene

Array = NDArray[np.float64]

NAMES = (
    "aside_x", "aside_y", "deeper",  # the displacement [m]
    "facing_less", "facing_more", "facing_wide",  # log of surface between the pads that faces them, by side; and around
    "width_here", "off_middle", "gap",  # of what is between the pads [m]
    "fingers_hit", "finger_top", "palm_in",  # surface where the fingers are (log), and how far it reaches up them [m]
    "below_top", "above_bottom",  # of the object between the jaws [m]
    "height", "tip_height",  # over the support [m]
    "opening", "width", "down", "tilt_x", "tilt_y",  # as planned; of the axes against the support's normal
    "lever", "beside",  # of the centre of mass, from the closing axis and along it [m]
    "score", "slope",  # the planner's; cosine of the support's slope
    "long", "middle", "short",  # standard deviations of the model [m]
    "measured",  # 1: where the tool was when the jaws closed; 0: where it was sent
)  # fmt: skip

NEAR = 0.005  # [m] about a pad: how fast a point's weight fades
WIDE = 0.012


def grasp_features(
    scene: Scene, T_object_grasp: Array, width: float, opening: float, score: float, displacements: Array,
    measured: bool, gripper: GripperConfig | None = None,
) -> Array:  # fmt: skip
    """(E, len(NAMES)) for displacements (E, 3) [m] of the tool from a grasp, in the grasp's frame.

    Args:
        scene: the object and its support.
        T_object_grasp: (4, 4).
        width, opening: of the contacts and of the jaws on the approach [m].
        score: the planner's.
        displacements: (E, 3) [m].
        measured: whether the tool was there when the jaws closed; else it is sent there.
        gripper: None is `GripperConfig()`.
    """
    g = GripperConfig() if gripper is None else gripper
    R = T_object_grasp[:3, :3]
    p, n = (scene.points - T_object_grasp[:3, 3]) @ R, scene.normals @ R
    T_grasp_level = inverse(scene.T_level_object @ T_object_grasp)
    up, seat = T_grasp_level[:3, :3] @ scene.up, T_grasp_level[:3, :3] @ scene.support + T_grasp_level[:3, 3]
    center = volume_center(p, n)
    size = np.sqrt(np.linalg.eigvalsh(np.cov(p.T)))[::-1]
    e = np.ascontiguousarray(displacements, dtype=np.float64)
    out = np.empty((len(e), len(NAMES)))
    jaws = np.array([g.pad_width, g.pad_height, g.pad_depth, g.finger_width, g.finger_thickness, g.finger_length])
    _geometry(np.ascontiguousarray(p), np.ascontiguousarray(n), e, opening, jaws, out)
    height = (e - seat) @ up
    half = 0.5 * opening + g.pad_depth + g.finger_thickness
    reach = abs(up[0]) * half + 0.5 * g.finger_width * abs(up[1]) + 0.5 * g.pad_height * abs(up[2])
    out[:, 14], out[:, 15] = height, height - reach
    out[:, 16:21] = opening, width, -up[2], abs(up[0]), abs(up[1])
    away = center - e
    out[:, 21], out[:, 22] = np.hypot(away[:, 1], away[:, 2]), np.abs(away[:, 0])
    out[:, 23], out[:, 24] = score, scene.up[2]
    out[:, 25:28] = size
    out[:, 28] = measured
    return out


@compiled
def _geometry(points, normals, displacements, opening, jaws, out):
    """The first 14 features."""
    half_y, half_z = 0.5 * jaws[0], 0.5 * jaws[1]
    inner = 0.5 * opening
    outer = inner + jaws[2] + jaws[4]
    for k in range(displacements.shape[0]):
        ex, ey, ez = displacements[k, 0], displacements[k, 1], displacements[k, 2]
        less, more, wide, hits = 0.0, 0.0, 0.0, 0.0
        low, high, top, palm = 1.0, -1.0, 0.0, 0.0
        first, last = 1.0, -1.0
        for i in range(points.shape[0]):
            x, y, z = points[i, 0] - ex, points[i, 1] - ey, points[i, 2] - ez
            ay, az = max(abs(y) - half_y, 0.0), max(abs(z) - half_z, 0.0)
            if z < -jaws[5] and abs(x) < outer and abs(y) < 0.020:
                palm = max(palm, -jaws[5] - z)
            beside = inner - 0.002 < abs(x) < outer + 0.003 and abs(y) < 0.5 * jaws[3] + 0.003
            if beside and -jaws[5] < z < half_z + 0.002:
                hits += 1.0
                top = max(top, half_z - z)
            if abs(x) > inner + 0.004:
                continue
            if ay < 0.006:
                first, last = min(first, z), max(last, z)
            if ay > 0.03 or az > 0.03:
                continue
            square = ay * ay + az * az
            facing = abs(normals[i, 0])
            weight = facing * math.exp(-0.5 * square / NEAR**2)
            wide += facing * math.exp(-0.5 * square / WIDE**2)
            if normals[i, 0] < 0.0:
                less += weight
            else:
                more += weight
            if square < 0.006**2:
                low, high = min(low, x), max(high, x)
        found = high >= low
        out[k, 0], out[k, 1], out[k, 2] = abs(ex), abs(ey), ez
        out[k, 3], out[k, 4], out[k, 5] = math.log1p(min(less, more)), math.log1p(max(less, more)), math.log1p(wide)
        out[k, 6] = high - low if found else 0.0
        out[k, 7] = 0.5 * abs(high + low) if found else 0.05
        out[k, 8] = inner - max(high, -low) if found else 0.05
        out[k, 9], out[k, 10], out[k, 11] = math.log1p(hits), top, palm
        out[k, 12] = min(max(-first, -0.05), 0.10) if last >= first else -0.05
        out[k, 13] = min(max(last, -0.05), 0.10) if last >= first else -0.05
