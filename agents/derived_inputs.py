"""What a network reads beside the observation's own keys: functions of them, the same in training and inference.

Where the observation has goals, a network has to act on their difference, which is of millimetres, while the goals
themselves spread over decimetres and all inputs are normalised alike. It is therefore given the difference, and once
more on a fine scale:

| key | value | unit |
| --- | --- | --- |
| goal_offset | desired_goal − achieved_goal | the goals' |
| goal_offset_fine | tanh(goal_offset / 0.02) | 1 |

NumPy alone: policies act without torch.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

GOALS = ("achieved_goal", "desired_goal")
OFFSET, FINE_OFFSET = "goal_offset", "goal_offset_fine"
DERIVED = (OFFSET, FINE_OFFSET)
FINE_SCALE = 0.02  # [m] of the fine offset: Reach's success distance


def derived_boxes(boxes: Mapping[str, spaces.Space]) -> dict[str, spaces.Box]:
    """The spaces of the derived keys that these observations allow; none without goals."""
    achieved, desired = (boxes.get(key) for key in GOALS)
    if not isinstance(achieved, spaces.Box) or not isinstance(desired, spaces.Box) or achieved.shape != desired.shape:
        return {}
    low, high = desired.low - achieved.high, desired.high - achieved.low
    return {OFFSET: spaces.Box(low, high, dtype=np.float32), FINE_OFFSET: spaces.Box(-1.0, 1.0, low.shape, np.float32)}


def derive(key: str, achieved: NDArray[Any], desired: NDArray[Any]) -> NDArray[Any]:
    """The value (..., n) of a derived key for goals (..., n), in their precision."""
    offset = desired - achieved
    return offset if key == OFFSET else np.tanh(offset / FINE_SCALE)


def with_derived(observation: Mapping[str, NDArray[Any]], keys: Iterable[str]) -> Mapping[str, NDArray[Any]]:
    """The observation with those of `keys` that are derived, computed anew.

    Raises:
        KeyError: it has no goals.
    """
    wanted = [key for key in keys if key in DERIVED]
    if not wanted:
        return observation
    achieved, desired = (np.asarray(observation[key]) for key in GOALS)
    return {**observation, **{key: derive(key, achieved, desired) for key in wanted}}
