"""Every quality metric of many candidate grasps, as columns of one table."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from baselines.grasping.antipodal import closing_angles, line_distance, soft_antipodal
from baselines.grasping.candidates import GraspCandidates
from baselines.grasping.contacts import Array, Contact, finite, grasp_matrix
from baselines.grasping.matrix_metrics import q_isotropy, q_min, q_volume
from baselines.grasping.wrench_space import largest_min_resisted_wrench, wrench_volume


def evaluate_candidates(
    candidates: GraspCandidates,
    center: ArrayLike,
    friction: float = 0.5,
    torsion: float = 0.003,
    edges: int = 8,
    torque_scale: float = 0.1,
) -> dict[str, Array]:
    """Quality metrics of each grasp's two contacts; larger is better but for "closing_angle" and "line_distance".

    Args:
        candidates: G grasps.
        center: (3,) that torques are taken about [m], usually the centre of mass.
        friction: Coulomb coefficient of both contacts.
        torsion: [m] of both; 0 is a hard contact, and two of these never close.
        edges: of the linearised cones.
        torque_scale: length that torques are divided by [m].

    Returns:
        (G,) float arrays: "q_min", "q_volume", "q_isotropy" of the grasp matrix (its torque rows divided by
        `torque_scale`); "force_closure" (0 or 1, round cones); "lmrw_sum" and "lmrw_independent" [N], the largest
        minimum resisted wrench for both models of force; "wrench_volume" (of the sum model); "closing_angle" [rad];
        "antipodal_margin" [rad], the friction angle less it; "line_distance" [m] of the closing line from the centre.
        Grasps that differ only in their approach share their contacts, hence their values.

    Raises:
        ValueError: an argument of the wrong kind.
    """
    c = finite("center", center, (3,))
    scale = float(finite("torque_scale", torque_scale, ()))
    if scale <= 0.0:
        raise ValueError(f"torque_scale: expected a positive length, got {scale}")
    distinct, which = np.unique(candidates.positions.reshape(-1, 6), axis=0, return_inverse=True)
    which = which.reshape(-1)
    first = np.zeros(len(distinct), dtype=np.int64)
    first[which[::-1]] = np.arange(len(candidates))[::-1]
    positions, normals = candidates.positions[first], candidates.normals[first]
    angle = closing_angles(positions, normals)
    soft = soft_antipodal(positions, normals, friction) if torsion > 0.0 else np.zeros(len(first))
    table = {
        "force_closure": soft.astype(np.float64),
        "closing_angle": angle,
        "antipodal_margin": np.arctan(friction) - angle,
        "line_distance": line_distance(positions, c),
    }
    for name in ("q_min", "q_volume", "q_isotropy", "lmrw_sum", "lmrw_independent", "wrench_volume"):
        table[name] = np.empty(len(first))
    for i, (p, n) in enumerate(zip(positions, normals, strict=True)):
        contacts = [Contact(p[k], n[k], friction, torsion) for k in range(2)]
        matrix = grasp_matrix(contacts, c)
        matrix[3:] /= scale
        table["q_min"][i], table["q_volume"][i], table["q_isotropy"][i] = (
            q_min(matrix),
            q_volume(matrix),
            q_isotropy(matrix),
        )
        table["lmrw_sum"][i] = largest_min_resisted_wrench(contacts, c, "sum", edges, scale)
        table["lmrw_independent"][i] = largest_min_resisted_wrench(contacts, c, "independent", edges, scale)
        table["wrench_volume"][i] = wrench_volume(contacts, c, "sum", edges, scale)
    return {name: column[which] for name, column in table.items()}
