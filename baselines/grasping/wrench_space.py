"""The grasp wrench space: what the contacts resist, the largest ball and the largest task inside it, its volume.

Ferrari & Canny 1992, "Planning optimal grasps". Normal forces are bounded by 1, in sum or each on its own. Balls and
tasks are measured by `expansion`, exact in either model; only the volume needs the whole hull, and takes Qhull.
"""

from collections.abc import Sequence
from typing import NamedTuple, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull, QhullError

from baselines.grasping import expansion
from baselines.grasping.contacts import (
    Array,
    Contact,
    ForceModel,
    checked_contacts,
    finite,
    primitive_wrenches,
    wrench_points,
)

RANK_TOLERANCE = 1e-10  # of the largest wrench: a thinner wrench space spans fewer than six dimensions
CLOSURE_TOLERANCE = 1e-9  # of the largest wrench: a smaller ball about zero is rounding, and counts as none
# of the largest wrench: how far facets may be apart and count as one. Wrenches that are that far out of a common plane
# can spoil a hull, which is noticed; then another threshold tells them apart, or a shift of the wrenches does
TOLERANCES = (1e-11, 1e-10, 1e-12, 1e-13, 3e-10, 1e-9, 3e-9, 1e-8, 1e-7)
SHIFTS = (3e-11, 3e-11, 3e-10, 3e-10)


class WrenchSpace(NamedTuple):
    """A grasp wrench space as the Minkowski sum of blocks, each the hull of zero and its rows."""

    rows: Array  # (M, 6) primitive wrenches
    starts: NDArray[np.int64]  # (blocks + 1,): block b is rows[starts[b]:starts[b + 1]]


class Task(NamedTuple):
    """Wrenches to resist: the Minkowski sum of terms, each the hull of ellipsoids {mean + axes @ z: ‖z‖ <= 1}."""

    means: Array  # (E, 6)
    axes: Array  # (E, 6, r)
    starts: NDArray[np.int64]  # (terms + 1,): term b is the ellipsoids [starts[b], starts[b + 1])


UNIT_BALL = Task(np.zeros((1, 6)), np.eye(6)[None], np.array([0, 1]))


def wrench_space(
    contacts: Sequence[Contact],
    center: ArrayLike,
    model: ForceModel = "sum",
    edges: int = 8,
    torque_scale: float = 1.0,
) -> WrenchSpace:
    """The wrench space of the contacts, (M, 6) with M = contacts · edges, torques about `center` over `torque_scale`.

    Raises:
        ValueError: no contacts, an unknown model, or an argument that `primitive_wrenches` refuses.
    """
    if model not in get_args(ForceModel):
        raise ValueError(f"model: expected one of {get_args(ForceModel)}, got {model!r}")
    cones = [primitive_wrenches(contact, center, edges, torque_scale) for contact in checked_contacts(contacts)]
    rows = np.concatenate(cones)
    starts = np.cumsum([0, *map(len, cones)]) if model == "independent" else np.array([0, len(rows)])
    return WrenchSpace(rows, starts)


def largest_scale(space: WrenchSpace, task: Task = UNIT_BALL, enough: float = np.inf) -> float:
    """The largest k with k times the task inside the wrench space; 0.0 unless zero is strictly inside that.

    Args:
        space: the wrench space.
        task: in the same units; for the unit ball k is the radius of the largest ball about zero.
        enough: stop as soon as k is known to be above this, and return a lower bound.

    Returns:
        k, exact to 1e-10 of the largest wrench (over the task's size), except where contacts are nearly, but not
        exactly, symmetric: there to the tolerance that kept the hull whole, at worst 1e-7. Infinity for a zero task.

    Raises:
        RuntimeError: rounding spoilt the hull at every tolerance.
    """
    size = float(np.linalg.norm(space.rows, axis=1).max())
    attempts = [(tolerance, 0.0) for tolerance in TOLERANCES] + [(TOLERANCES[2], shift) for shift in SHIFTS]
    rng = np.random.default_rng(0)
    for tolerance, shift in attempts:
        rows = space.rows + shift * size * rng.uniform(-1.0, 1.0, space.rows.shape) if shift else space.rows
        ended, scale, normal = expansion.expand(
            rows, space.starts, *task, size, CLOSURE_TOLERANCE * size, tolerance * size, RANK_TOLERANCE, enough
        )
        if ended == expansion.BROKEN:
            continue
        if shift and ended == expansion.FOUND and np.isfinite(scale):  # undo the shift along the normal that was found
            height = expansion.support(space.rows, space.starts, normal, np.empty(6))
            return float(height / expansion.reach(*task, normal))
        return float(scale)
    raise RuntimeError(f"contacts: no hull of their {len(space.rows)} primitive wrenches, which are nearly degenerate")


def largest_min_resisted_wrench(
    contacts: Sequence[Contact],
    center: ArrayLike,
    model: ForceModel = "sum",
    edges: int = 8,
    torque_scale: float = 1.0,
) -> float:
    """Radius of the largest ball about zero inside the wrench space; 0.0 without force closure (Ferrari & Canny 1992).

    Args:
        contacts: the contacts of the grasp.
        center: (3,) point that torques are taken about [m], usually the centre of mass.
        model: "sum" bounds Σ f_i·n_i <= 1; "independent" every f_i·n_i <= 1.
        edges: edges of each linearised cone.
        torque_scale: length that torques are divided by [m], so that the ball's radius is a force [N].

    Raises:
        ValueError: no contacts, or an argument of the wrong kind.
    """
    return largest_scale(wrench_space(contacts, center, model, edges, torque_scale))


def wrench_volume(
    contacts: Sequence[Contact],
    center: ArrayLike,
    model: ForceModel = "sum",
    edges: int = 8,
    torque_scale: float = 1.0,
) -> float:
    """Six-dimensional volume of the wrench space, zero wrench included; arguments as `largest_min_resisted_wrench`.

    Without force closure it is still the volume of what can be resisted; 0.0 where that spans fewer dimensions. With
    "independent" the hull has (edges + 1)^contacts points: 0.5 s for three hard contacts of 8 edges.

    Raises:
        ValueError: no contacts, or an argument of the wrong kind.
        RuntimeError: Qhull found no hull.
    """
    points = wrench_points(contacts, center, model, edges, torque_scale)
    values = np.linalg.svd(points, compute_uv=False)
    if len(values) < 6 or values[-1] <= RANK_TOLERANCE * values[0]:
        return 0.0
    for options in ("Qt Qx", "QJ"):  # merging can fail on nearly round cones ("wide merge"): joggled they have a hull
        try:
            return float(ConvexHull(points, qhull_options=options).volume)
        except QhullError:
            continue
    raise RuntimeError(f"contacts: no convex hull of their {len(points)} wrenches, merged or joggled")


def force_closure(contacts: Sequence[Contact], center: ArrayLike | None = None, edges: int = 8) -> bool:
    """Whether the contacts, with cones of `edges` edges, can resist every wrench: zero is inside the wrench space.

    The verdict does not depend on the centre, which defaults to the mean of the positions, nor on the force model.

    Raises:
        ValueError: no contacts, or an argument of the wrong kind.
    """
    contacts = checked_contacts(contacts)
    positions = np.stack([contact.position for contact in contacts])
    c = positions.mean(axis=0) if center is None else finite("center", center, (3,))
    space = wrench_space(contacts, c, "sum", edges, arm(positions, c))
    return largest_scale(space, enough=0.0) > 0.0


def arm(positions: Array, center: Array) -> float:
    """A length that makes torques about the centre of the size of forces, whatever the object's; 1.0 if there is none.

    Args:
        positions: (n, 3).
        center: (3,).
    """
    longest = float(np.linalg.norm(positions - center, axis=1).max())
    return longest if longest > 0.0 else 1.0
