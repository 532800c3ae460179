"""A mesh as convex pieces, for physics and collision checks, and convex pieces as one closed mesh."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import trimesh

from baselines.objects.mesh import MeshObject


def convex_pieces(mesh: MeshObject, threshold: float = 0.05, seed: int = 0) -> tuple[MeshObject, ...]:
    """Convex pieces whose union approximates the mesh. Wei et al. 2022, "Approximate convex decomposition for 3D meshes
    with collision-aware concavity and tree search" (CoACD).

    Args:
        threshold: largest concavity left, in (0, 1], as a fraction of the mesh scaled to a unit cube.
        seed: of the tree search; equal seeds give equal pieces.

    An open mesh is closed first by the library, which inflates it by a few parts in a thousand.

    Raises:
        ValueError: a threshold outside (0, 1], or nothing that could be decomposed.
    """
    if not 0.0 < threshold <= 1.0:
        raise ValueError(f"threshold: expected a concavity in (0, 1], got {threshold}")
    import coacd  # which takes a while to load

    coacd.set_log_level("error")
    parts = coacd.run_coacd(coacd.Mesh(mesh.vertices, mesh.faces), threshold=threshold, seed=seed)
    if not parts:
        raise ValueError("mesh: expected one that can be decomposed, got no pieces")
    pieces = []
    for vertices, _ in parts:
        hull = trimesh.convex.convex_hull(np.asarray(vertices))
        pieces.append(MeshObject.from_trimesh(hull, scale=1.0))
    return tuple(pieces)


def watertight_union(pieces: Sequence[MeshObject]) -> MeshObject:
    """One watertight mesh of the union of watertight pieces (manifold3d).

    Raises:
        ValueError: no pieces, a piece that is not watertight, or a union that is not.
    """
    if len(pieces) == 0:
        raise ValueError("pieces: expected at least one mesh, got none")
    for i, piece in enumerate(pieces):
        if not piece.watertight:
            raise ValueError(f"pieces: expected watertight meshes, got piece {i} with {'; '.join(piece.report.faults)}")
    joined = trimesh.boolean.union([piece.trimesh for piece in pieces], engine="manifold", check_volume=False)
    union = MeshObject.from_trimesh(joined, scale=1.0)
    if not union.watertight:
        raise ValueError(f"pieces: expected a watertight union, got {'; '.join(union.report.faults)}")
    return union
