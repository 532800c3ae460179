"""Metrics of the grasp matrix: Ramon Soria 2018, section 2.4, after Li & Sastry 1988.

Li & Sastry 1988, "Task-oriented optimal grasping by multifingered robot hands", IEEE Journal of Robotics and
Automation 4(1).
"""

import numpy as np
from numpy.typing import ArrayLike

from baselines.grasping.contacts import Array, finite


def _singular_values(G: ArrayLike) -> Array:
    """The six singular values of G (6, columns), largest first; fewer than six columns leave zeros."""
    values = np.linalg.svd(finite("G", G, (6, -1)), compute_uv=False)
    return np.concatenate([values, np.zeros(6 - len(values))])


def q_min(G: ArrayLike) -> float:
    """σ_min(G) of a grasp matrix (6, columns): the distance to a grasp that cannot resist some wrench."""
    return float(_singular_values(G)[-1])


def q_volume(G: ArrayLike) -> float:
    """√det(G Gᵀ) = Π σ_i of a grasp matrix (6, columns): volume of the wrenches of unit contact forces, to a factor."""
    return float(np.prod(_singular_values(G)))


def q_isotropy(G: ArrayLike) -> float:
    """σ_min(G) / σ_max(G) in [0, 1] of a grasp matrix (6, columns); 0 for a zero matrix."""
    values = _singular_values(G)
    return float(values[-1] / values[0]) if values[0] > 0.0 else 0.0
