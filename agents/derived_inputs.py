"""What a network reads beside the observation's own keys: functions of them, the same in training and inference.

Where the observation has goals, a network has to act on their difference, which is of millimetres, while the goals
themselves spread over decimetres and all inputs are normalised alike. It is therefore given the difference, once more
on a fine scale, and how the goal moves, without which a controller that remembers nothing trails it:

| key | value | unit |
| --- | --- | --- |
| goal_offset | desired_goal − achieved_goal | the goals' |
| goal_offset_fine | tanh(goal_offset / 0.02) | 1 |
| goal_step | desired_goal − that of the step before, 0 in an episode's first observation | the goals' |

NumPy alone: policies act without torch.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

GOALS = ("achieved_goal", "desired_goal")
OFFSET, FINE_OFFSET, STEP = "goal_offset", "goal_offset_fine", "goal_step"
DERIVED = (OFFSET, FINE_OFFSET, STEP)
FINE_SCALE = 0.02  # [m] of the fine offset: Reach's success distance


def derived_boxes(boxes: Mapping[str, spaces.Space]) -> dict[str, spaces.Box]:
    """The spaces of the derived keys that these observations allow; none without goals."""
    achieved, desired = (boxes.get(key) for key in GOALS)
    if not isinstance(achieved, spaces.Box) or not isinstance(desired, spaces.Box) or achieved.shape != desired.shape:
        return {}
    extent = desired.high - desired.low
    return {
        OFFSET: spaces.Box(desired.low - achieved.high, desired.high - achieved.low, dtype=np.float32),
        FINE_OFFSET: spaces.Box(-1.0, 1.0, extent.shape, np.float32),
        STEP: spaces.Box(-extent, extent, dtype=np.float32),
    }


def derive(key: str, achieved: NDArray[Any], desired: NDArray[Any], before: NDArray[Any]) -> NDArray[Any]:
    """The value (..., n) of a derived key.

    Args:
        key: one of `DERIVED`.
        achieved: the goal that is reached now (..., n).
        desired: the one that is wanted now (..., n).
        before: the one that was wanted a step earlier (..., n); `desired` itself in an episode's first observation.
    """
    if key == STEP:
        return desired - before
    return desired - achieved if key == OFFSET else np.tanh((desired - achieved) / FINE_SCALE)
