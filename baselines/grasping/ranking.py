"""How candidate grasps are ranked: what is known of each, and what each of that counts."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from baselines.grasping.contacts import Array

CONTEXT = (
    "pfc",
    "closing_angle",
    "line_distance",
    "centre_distance",
    "width",
    "deviation_first",
    "deviation_second",
    "unseen_first",
    "unseen_second",
    "approach_to_view",
    "closing_to_view",
    "approach_to_up",
    "closing_to_up",
    "size",
    "slenderness",
    "tightness",
    "room",
    "above",
    "aside",
)
"""What is known of a candidate beside the points, in the order of `Proposals.context`."""

TERMS = (*CONTEXT, "closing_to_view_squared", "closing_to_up_squared", "crowding")
"""What can count in the ranking: `CONTEXT`, two squares of it, and how close fingers or palm come, see `terms`."""

WEIGHTS: Mapping[str, float] = MappingProxyType(
    {
        "pfc": 0.2,  # of its logarithm
        "closing_angle": -2.0,  # [1/rad]
        "aside": -48.0,  # [1/m]
        "above": 13.5,
        "centre_distance": -17.0,
        "deviation_first": -220.0,
        "deviation_second": -8.0,
        "approach_to_view": -0.6,
        "width": 6.6,
        "room": 23.0,
        "closing_to_view_squared": -0.92,
        "closing_to_up": -0.63,
        "closing_to_up_squared": 1.9,
        "crowding": -0.84,
    }
)
"""What each of `TERMS` counts in the ranking, in log-odds of holding, and of holding without turning, averaged.

Calibrated by logistic regression on 10 754 grasps of the training and validation families' objects that the physics
labelled. Beside angle and deviation the probability, which saturates, told nothing more there; its weight is set by
hand.
"""

CROWDED = 0.004  # [m] distance of fingers or palm from the surface at which `crowding` has fallen to 1/e
LEAST_PROBABILITY = 1e-3


def terms(context: Array, clearance: Array) -> Array:
    """What the ranking weighs (G, T), in the order of `TERMS`.

    Args:
        context: (G, F), see `CONTEXT`; of "pfc" the logarithm counts.
        clearance: (G,) distance of the open fingers and palm from what is known of the object [m].
    """
    known = context.copy()
    known[:, CONTEXT.index("pfc")] = np.log(np.maximum(context[:, CONTEXT.index("pfc")], LEAST_PROBABILITY))
    squares = [context[:, CONTEXT.index(name)] ** 2 for name in ("closing_to_view", "closing_to_up")]
    return np.column_stack([known, *squares, np.exp(-clearance / CROWDED)])


def ranking(context: Array, clearance: Array, weights: Mapping[str, float] = WEIGHTS) -> Array:
    """Scores (G,) of candidates; arguments as `terms` has them, and what each of `TERMS` counts."""
    return terms(context, clearance) @ np.array([weights.get(name, 0.0) for name in TERMS])
