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
