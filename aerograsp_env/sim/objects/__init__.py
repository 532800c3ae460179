"""Objects to grasp: one watertight geometry for physics, rendering and oracles."""

from aerograsp_env.sim.objects.build import build_object, mass_properties
from aerograsp_env.sim.objects.families import TEST_FAMILIES, TRAIN_FAMILIES, VALIDATION_FAMILIES, test_objects
from aerograsp_env.sim.objects.grasp_object import Convex, GraspObject
from aerograsp_env.sim.objects.mesh_object import FromMesh, from_mesh

__all__ = [
    "TEST_FAMILIES",
    "TRAIN_FAMILIES",
    "VALIDATION_FAMILIES",
    "Convex",
    "FromMesh",
    "GraspObject",
    "build_object",
    "from_mesh",
    "mass_properties",
    "test_objects",
]
