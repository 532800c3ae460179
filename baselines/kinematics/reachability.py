"""Where an arm can bring its tool, and from which sides (thesis figure 5.9).

Over a grid of positions, which approach directions some configuration within the limits serves: the capability map of
Zacharias, Borst & Hirzinger 2007, "Capturing robot workspace structure". By the closed forms, so that a direction that
is not served is not for want of luck. Kinematics alone: collisions are another matter.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.sim.kernel_math import compiled
from aerograsp_env.spatial import as_array
from baselines.kinematics import closed_form_4dof, closed_form_6dof
from baselines.kinematics.arm import Arm
from baselines.kinematics.chain import POSITION, forward_kernel
from baselines.kinematics.closed_form import TOLERANCE, reference_angles

Array = NDArray[np.float64]

_MAX_CELLS = 20_000_000  # positions times directions


class Reachability(NamedTuple):
    """Positions in the frame of the arm's poses, and the approach directions that are served there."""

    x: Array  # (nx,) [m]
    y: Array  # (ny,) [m]
    z: Array  # (nz,) [m]
    approaches: Array  # (k, 3) unit
    served: NDArray[np.bool_]  # (nx, ny, nz, k)

    @property
    def share(self) -> Array:
        """(nx, ny, nz) share of the directions that are served, in [0, 1]."""
        share: Array = self.served.mean(axis=-1)
        return share

    def volume(self, least: float = 0.0) -> float:
        """Of the grid's cells whose share is above `least` [m³]; the axes must be evenly spaced."""
        cell = math.prod(float(axis[1] - axis[0]) for axis in self[:3])
        return float(np.sum(self.share > least)) * cell


def approach_directions(count: int = 32) -> Array:
    """(count, 3) unit vectors spread evenly over the sphere (Fibonacci lattice: González 2010)."""
    if count < 1:
        raise ValueError(f"count: expected 1 or more, got {count}")
    k = np.arange(count)
    z = 1.0 - (2.0 * k + 1.0) / count
    turn = k * math.pi * (3.0 - math.sqrt(5.0))
    radius = np.sqrt(1.0 - z**2)
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), z], axis=1)


def reachability(
    arm: Arm,
    x: ArrayLike,
    y: ArrayLike,
    z: ArrayLike,
    approaches: ArrayLike | None = None,
    rolls: int = 8,
    cone: float = math.radians(20.0),
) -> Reachability:
    """Which approach directions are served at each position of a grid.

    Arms of six joints serve a direction where they reach some of the evenly spaced `rolls` about it. Arms of four
    joints cannot choose their direction: they serve those within `cone` of the ones that reach the position.

    Args:
        arm: one with a closed form: of four joints, or of six with a spherical wrist.
        x, y, z: the grid's positions along each axis [m], in the frame of the arm's poses.
        approaches: (k, 3) directions of the tool's z, of any length; 32 over the whole sphere by default.
        rolls: about each direction, for arms of six joints.
        cone: half angle [rad], for arms of four joints.

    Raises:
        ValueError: an arm without a closed form, axes that are not finite and one-dimensional, directions of another
            shape or of no length, a number of rolls or a cone that is not positive, or a grid too large.
    """
    axes = []
    for name, values in (("x", x), ("y", y), ("z", z)):
        axis = np.atleast_1d(np.asarray(values, np.float64))
        if axis.ndim != 1 or not np.isfinite(axis).all():
            raise ValueError(f"{name}: expected finite positions (m,), got shape {axis.shape}")
        axes.append(axis)
    towards = approach_directions() if approaches is None else np.atleast_2d(as_array(approaches, (3,), "approaches"))
    lengths = np.linalg.norm(towards, axis=-1, keepdims=True)
    if towards.ndim != 2 or not lengths.all():
        raise ValueError(f"approaches: expected (k, 3) directions of positive length, got {towards.tolist()}")
    towards = towards / lengths
    if rolls < 1:
        raise ValueError(f"rolls: expected 1 or more, got {rolls}")
    if not 0.0 < cone <= math.pi:
        raise ValueError(f"cone: expected an angle in (0, π], got {cone}")
    cells = math.prod(len(axis) for axis in axes) * len(towards)
    if cells > _MAX_CELLS:
        raise ValueError(f"x, y, z: {cells} positions and directions, at most {_MAX_CELLS}; take a coarser grid")
    served = np.zeros((*(len(axis) for axis in axes), len(towards)), np.bool_)
    middle = reference_angles(arm, None)
    if arm.n == 4:
        serve: Callable[..., None] = _serve_four
        given: tuple[object, ...] = (*closed_form_4dof.four_joints(arm), middle, *axes, towards, math.cos(cone))
    else:
        serve = _serve_six
        given = (*closed_form_6dof.six_joints(arm), middle, *axes, _frames(towards, rolls))
    serve(arm.chain, arm.limits, *given, served)
    return Reachability(axes[0], axes[1], axes[2], towards, served)


def _frames(towards: Array, rolls: int) -> Array:
    """(k, rolls, 3, 3) rotations whose z axis is each direction, evenly spaced about it."""
    other = np.eye(3)[np.argmin(np.abs(towards), axis=1)]
    x = np.cross(other, towards)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    y = np.cross(towards, x)
    angle = np.arange(rolls) * (2.0 * math.pi / rolls)
    c, s = np.cos(angle)[None, :, None], np.sin(angle)[None, :, None]
    across = c * x[:, None] + s * y[:, None]
    along = np.broadcast_to(towards[:, None], across.shape)
    return np.stack([across, np.cross(along, across), along], axis=-1)


@compiled
def _serve_six(chain, limits, axes, shoulder, elbow, point, T_tool, middle, x, y, z, frames, served):
    found, target = np.empty((8, 6)), np.eye(4)
    for i in range(len(x)):
        for j in range(len(y)):
            for k in range(len(z)):
                target[0, 3], target[1, 3], target[2, 3] = x[i], y[j], z[k]
                for a in range(frames.shape[0]):
                    for b in range(frames.shape[1]):
                        target[:3, :3] = frames[a, b]
                        if closed_form_6dof.branches_kernel(
                            chain, limits, axes, shoulder, elbow, point, T_tool, target, middle, TOLERANCE, found
                        ):
                            served[i, j, k, a] = True
                            break


@compiled
def _serve_four(chain, limits, axes, shoulder, elbow, point, T_tool, middle, x, y, z, towards, cosine, served):
    found, target, tool = np.empty((4, 4)), np.eye(4), np.empty((3, 4))
    for i in range(len(x)):
        for j in range(len(y)):
            for k in range(len(z)):
                target[0, 3], target[1, 3], target[2, 3] = x[i], y[j], z[k]
                count = closed_form_4dof.branches_kernel(
                    chain, limits, axes, shoulder, elbow, point, T_tool, target, middle, POSITION, TOLERANCE, found
                )
                for c in range(count):
                    forward_kernel(chain, found[c], tool)
                    for a in range(towards.shape[0]):
                        along = tool[0, 2] * towards[a, 0] + tool[1, 2] * towards[a, 1] + tool[2, 2] * towards[a, 2]
                        if along >= cosine:
                            served[i, j, k, a] = True
