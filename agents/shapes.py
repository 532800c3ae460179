"""Procedural shapes that the reproductions of chapter 2 observe: watertight, with outward normals, metres."""

from __future__ import annotations

import numpy as np
import trimesh


def revolve(profile: np.ndarray, sections: int = 96) -> trimesh.Trimesh:
    """Solid of revolution about z of a profile (N, 2) of radius and height, from the axis to the axis, upwards."""
    return trimesh.creation.revolve(profile, sections=sections)


def apple(radius: float = 0.04, height: float = 0.036, exponent: float = 2.4, dimple: float = 0.010) -> trimesh.Trimesh:
    """A superellipse of revolution, dented about both ends of its axis: the upper dent deeper than the lower.

    Args:
        radius: of the equator [m].
        height: half the height before the dents [m].
        exponent: of the superellipse; 2 is an ellipse.
        dimple: depth of the upper dent [m].
    """
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 121)
    r = radius * np.cos(angle) ** (2.0 / exponent)
    z = height * np.sign(angle) * np.abs(np.sin(angle)) ** (2.0 / exponent)
    z -= np.where(z > 0.0, 1.0, -0.5) * dimple * np.exp(-0.5 * (r / (0.25 * radius)) ** 2)
    r[[0, -1]] = 0.0
    return revolve(np.column_stack([r, z]))


def bottle(radius: float = 0.035, height: float = 0.2, neck: float = 0.014) -> trimesh.Trimesh:
    """A closed bottle that stands on z = −height/2: a straight body, a shoulder and a neck."""
    t = np.linspace(0.0, 1.0, 12)
    shoulder = neck + (radius - neck) * (0.5 + 0.5 * np.cos(np.pi * t))
    r = np.concatenate([[0.0, radius], shoulder, [neck, 0.0]])
    z = np.concatenate([[0.0, 0.0], height * (0.55 + 0.2 * t), [height, height]]) - 0.5 * height
    return revolve(np.column_stack([r, z]))


def mug(radius: float = 0.04, height: float = 0.095, wall: float = 0.012) -> trimesh.Trimesh:
    """An open cup with a handle along +x."""
    cup = trimesh.creation.cylinder(radius, height, sections=64)
    hollow = trimesh.creation.cylinder(radius - wall, height, sections=64).apply_translation([0.0, 0.0, wall])
    handle = trimesh.creation.torus(0.6 * radius, 0.16 * radius, major_sections=48, minor_sections=16)
    handle.apply_transform(trimesh.transformations.rotation_matrix(0.5 * np.pi, [1.0, 0.0, 0.0]))
    handle.apply_translation([1.15 * radius, 0.0, 0.0])
    whole = trimesh.boolean.union([cup, handle], engine="manifold")
    return trimesh.boolean.difference([whole, hollow], engine="manifold")


def box(size: tuple[float, float, float] = (0.06, 0.09, 0.13)) -> trimesh.Trimesh:
    """A box about the origin."""
    return trimesh.creation.box(size)


def surface_points(mesh: trimesh.Trimesh, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Points (count, 3), uniform on a mesh's surface, and its normals there."""
    points, faces = trimesh.sample.sample_surface(mesh, count, seed=rng)
    return np.asarray(points), np.asarray(mesh.face_normals[faces])


def noisy(
    points: np.ndarray, normals: np.ndarray, sigma: float, turn: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Points and unit normals with normal errors of `sigma` [m] and `turn` in each component."""
    turned = normals + turn * rng.standard_normal(normals.shape)
    return points + sigma * rng.standard_normal(points.shape), turned / np.linalg.norm(turned, axis=1, keepdims=True)
