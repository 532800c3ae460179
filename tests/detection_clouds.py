"""Depth images of meshes, for tests of detection: cast with trimesh's rays, no renderer needed."""

from __future__ import annotations

import numpy as np
import trimesh

from aerograsp_env.interfaces import RGBD, Intrinsics
from aerograsp_env.spatial import inverse, so3_log, transform, transform_points

CAMERA = Intrinsics(160, 120, 130.0, 130.0, 79.5, 59.5)


def cast(mesh: trimesh.Trimesh, T_c_m: np.ndarray, camera: Intrinsics = CAMERA) -> np.ndarray:
    """(H, W) [m] depth of a mesh, 0 where there is none."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1)
    directions = rays.reshape(-1, 3) @ T_c_m[:3, :3]
    origins = np.broadcast_to(inverse(T_c_m)[:3, 3], directions.shape)
    places, hits, _ = mesh.ray.intersects_location(origins, directions, multiple_hits=False)
    depth = np.zeros(len(directions))
    depth[hits] = transform_points(T_c_m, places)[:, 2]
    return depth.reshape(u.shape)


def noisy(depth: np.ndarray, rng: np.random.Generator, deviation: float = 0.0012) -> np.ndarray:
    """Depth (H, W) float32 with noise that grows with its square: `deviation` [m] at 1 m."""
    return np.where(depth > 0, depth + deviation * depth**2 * rng.normal(size=depth.shape), 0.0).astype(np.float32)


def frame_of(depth: np.ndarray, camera: Intrinsics = CAMERA, stamp: float = 0.0) -> RGBD:
    return RGBD(np.zeros((*depth.shape, 3), dtype=np.uint8), depth.astype(np.float32), camera, stamp)


def looking(eye: np.ndarray, target: np.ndarray) -> np.ndarray:
    """(4, 4) T_world_camera of a camera at `eye` that looks at `target`, upright."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return transform(np.stack([right, np.cross(forward, right), forward], axis=1), eye)


def surface_of(mesh: trimesh.Trimesh, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Points and outward normals (count, 3) of a mesh."""
    points, faces = trimesh.sample.sample_surface(mesh, count, seed=0)
    return np.asarray(points), np.asarray(mesh.face_normals[faces])


def pose_error(T: np.ndarray, truth: np.ndarray, symmetries: np.ndarray | None = None) -> tuple[float, float]:
    """Angle [deg], the smallest over the symmetries, and distance of the origins [m]."""
    turns = np.eye(3)[None] if symmetries is None else symmetries
    angles = [np.linalg.norm(so3_log((T[:3, :3] @ turn).T @ truth[:3, :3])) for turn in turns]
    return float(np.degrees(min(angles))), float(np.linalg.norm(T[:3, 3] - truth[:3, 3]))


def box_of(depth: np.ndarray) -> np.ndarray:
    """(4,) xyxy [px] of the pixels with depth."""
    rows, columns = np.nonzero(depth)
    return np.array([columns.min(), rows.min(), columns.max(), rows.max()], dtype=float)
