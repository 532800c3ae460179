"""Grasp analysis: contacts and what they transmit, and how well a set of them holds an object.

    contacts = [Contact((0.03, 0, 0), (-1, 0, 0), friction=0.6, torsion=0.003), Contact((-0.03, 0, 0), (1, 0, 0), ...)]
    force_closure(contacts)
    largest_min_resisted_wrench(contacts, center=(0, 0, 0), torque_scale=0.03)

Positions are in metres, normals point into the object, and a wrench is (force, torque about the centre).
"""

from baselines.grasping.contacts import (
    Contact,
    contact_basis,
    friction_cone,
    grasp_matrix,
    primitive_wrenches,
    wrench_points,
)
from baselines.grasping.quality import (
    ForceClosureProbability,
    force_closure,
    largest_min_resisted_wrench,
    probability_of_force_closure,
    q_isotropy,
    q_min,
    q_volume,
    soft_antipodal,
    task_wrench_quality,
    wrench_volume,
)

__all__ = [
    "Contact",
    "ForceClosureProbability",
    "contact_basis",
    "force_closure",
    "friction_cone",
    "grasp_matrix",
    "largest_min_resisted_wrench",
    "primitive_wrenches",
    "probability_of_force_closure",
    "q_isotropy",
    "q_min",
    "q_volume",
    "soft_antipodal",
    "task_wrench_quality",
    "wrench_points",
    "wrench_volume",
]
