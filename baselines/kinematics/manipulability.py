"""How well an arm moves its tool from where it stands: Yoshikawa's measure and the condition of its Jacobian."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.kinematics.arm import Arm
from baselines.kinematics.dls import RADIAN

Array = NDArray[np.float64]
Part = Literal["pose", "position", "rotation"]

_ROWS = {"pose": slice(0, 6), "position": slice(0, 3), "rotation": slice(3, 6)}


def singular_values(arm: Arm, q: ArrayLike, part: Part = "pose", radian: float | None = None) -> Array:
    """Singular values of the Jacobian at q (..., n), largest first, (..., min(rows, n)).

    Args:
        arm: the arm.
        q: (..., n) [rad].
        part: the rows that count.
        radian: what a radian weighs [m]; 0.4 of the arm's length by default, as in the damped steps.

    Raises:
        ValueError: q of another shape or not finite, an unknown part, or a weight that is not positive.
    """
    if part not in _ROWS:
        raise ValueError(f"part: expected one of {', '.join(_ROWS)}, got {part!r}")
    radian = RADIAN * arm.length if radian is None else radian
    if not 0.0 < radian < np.inf:
        raise ValueError(f"radian: expected a positive weight, got {radian}")
    jacobian = arm.jacobian(q)
    jacobian[..., 3:, :] *= radian
    return np.asarray(np.linalg.svd(jacobian[..., _ROWS[part], :], compute_uv=False), np.float64)


def manipulability(arm: Arm, q: ArrayLike, part: Part = "pose", radian: float = 1.0) -> Array:
    """Yoshikawa's measure √det(J Jᵀ) at q (..., n), (...): 0 where the tool cannot move in some direction.

    Of fewer joints than rows it is √det(Jᵀ J), which is 0 where the joints' effects are dependent. Yoshikawa 1985,
    "Manipulability of robotic mechanisms", with radians and metres alike (`radian` = 1).

    Raises:
        ValueError: as `singular_values`.
    """
    product: Array = np.prod(singular_values(arm, q, part, radian), axis=-1)
    return product


def condition_number(arm: Arm, q: ArrayLike, part: Part = "pose", radian: float | None = None) -> Array:
    """Largest over least singular value of the Jacobian at q (..., n), (...): 1 is isotropic, inf singular.

    Salisbury & Craig 1982, "Articulated hands". Arguments and errors as `singular_values`.
    """
    values = singular_values(arm, q, part, radian)
    with np.errstate(divide="ignore"):
        ratio: Array = np.where(values[..., -1] > 0.0, values[..., 0] / values[..., -1], np.inf)
    return ratio
