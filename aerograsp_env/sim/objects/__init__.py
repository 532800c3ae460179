"""Objects to grasp: one watertight geometry for physics, rendering and oracles."""

from aerograsp_env.sim.objects.grasp_object import Convex, GraspObject

__all__ = ["Convex", "GraspObject"]
