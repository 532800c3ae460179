"""Grasp analysis: contacts and what they transmit, and how well a set of them holds an object.

    contacts = [Contact((0.03, 0, 0), (-1, 0, 0), friction=0.6, torsion=0.003), Contact((-0.03, 0, 0), (1, 0, 0), ...)]
    force_closure(contacts)
    largest_min_resisted_wrench(contacts, center=(0, 0, 0), torque_scale=0.03)

Candidate grasps of a parallel-jaw gripper come from a mesh, a cloud or an implicit surface::

    candidates = grasps_on_mesh(mesh, GripperConfig())  # says in `candidates.reasons` what was turned down
    table = evaluate_candidates(candidates, mesh.center_of_mass)
    best = candidates.order(table["lmrw_sum"]).grasps()[0]

Positions are in metres, normals point into the object, and a wrench is (force, torque about the centre).
"""

from baselines.grasping.antipodal import closing_angles, line_distance, soft_antipodal
from baselines.grasping.cache import GraspCache
from baselines.grasping.candidate_metrics import evaluate_candidates
from baselines.grasping.candidates import GraspCandidates
from baselines.grasping.contacts import (
    Contact,
    contact_basis,
    friction_cone,
    grasp_matrix,
    primitive_wrenches,
    wrench_points,
)
from baselines.grasping.matrix_metrics import q_isotropy, q_min, q_volume
from baselines.grasping.on_cloud import grasps_on_cloud
from baselines.grasping.on_gpis import grasps_on_gpis
from baselines.grasping.on_mesh import grasps_on_mesh
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
    "GraspCache",
    "GraspCandidates",
    "ObjectWrenches",
    "antipodal_probability",
    "closing_angles",
    "contact_basis",
    "evaluate_candidates",
    "force_closure",
    "friction_cone",
    "grasp_matrix",
    "grasps_on_cloud",
    "grasps_on_gpis",
    "grasps_on_mesh",
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
