"""Objects to grasp: one watertight geometry for physics, rendering and oracles."""

from aerograsp_env.sim.objects.build import build_object, mass_properties
from aerograsp_env.sim.objects.families import TEST_FAMILIES, TRAIN_FAMILIES, VALIDATION_FAMILIES, test_objects
from aerograsp_env.sim.objects.grasp_object import Convex, GraspObject

__all__ = [
    "TEST_FAMILIES",
    "TRAIN_FAMILIES",
    "VALIDATION_FAMILIES",
    "Convex",
    "GraspObject",
    "build_object",
    "mass_properties",
    "test_objects",
]
