"""Grasp analysis: contacts and what they transmit, and how well a set of them holds an object.

    contacts = [Contact((0.03, 0, 0), (-1, 0, 0), friction=0.6, torsion=0.003), Contact((-0.03, 0, 0), (1, 0, 0), ...)]
    force_closure(contacts)
    largest_min_resisted_wrench(contacts, center=(0, 0, 0), torque_scale=0.03)

Positions are in metres, normals point into the object, and a wrench is (force, torque about the centre).
"""

from baselines.grasping.antipodal import closing_angles, line_distance, soft_antipodal
from baselines.grasping.contacts import (
    Contact,
    contact_basis,
    friction_cone,
    grasp_matrix,
    primitive_wrenches,
    wrench_points,
)
from baselines.grasping.matrix_metrics import q_isotropy, q_min, q_volume
from baselines.grasping.probability import (
    ForceClosureProbability,
    antipodal_probability,
    probability_of_force_closure,
)
from baselines.grasping.tasks import ObjectWrenches, object_wrench_quality, task_wrench_quality
from baselines.grasping.wrench_space import force_closure, largest_min_resisted_wrench, wrench_volume

__all__ = [
    "Contact",
    "ForceClosureProbability",
    "ObjectWrenches",
    "antipodal_probability",
    "closing_angles",
    "contact_basis",
    "force_closure",
    "friction_cone",
    "grasp_matrix",
    "largest_min_resisted_wrench",
    "line_distance",
    "object_wrench_quality",
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
