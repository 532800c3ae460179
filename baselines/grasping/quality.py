"""How well contacts hold: grasp-matrix metrics, force closure, wrench-space metrics and force closure under doubt.

Ramon Soria 2018, section 2.4; Ferrari & Canny 1992, "Planning optimal grasps"; Nguyen 1988, "Constructing
force-closure grasps"; Li & Sastry 1988, "Task-oriented optimal grasping by multifingered robot hands".
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull, QhullError

from baselines.grasping.contacts import (
    Array,
    Contact,
    ForceModel,
    checked_contacts,
    finite,
    non_negative,
    unit,
    wrench_points,
)

RANK_TOLERANCE = 1e-10  # of the largest singular value
CLOSURE_TOLERANCE = 1e-9  # of the largest wrench: a smaller ball about zero is rounding, and counts as none
JOGGLE_TOLERANCE = 4e-10  # of the largest wrench: how far the joggled hull may stand off its own points


# --- grasp matrix ------------------------------------------------------------


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


# --- wrench space ------------------------------------------------------------


class _WrenchSpace(NamedTuple):
    """The grasp wrench space {x: normals @ x <= offsets}."""

    normals: Array  # (F, 6) unit
    offsets: Array  # (F,), all positive where there is force closure
    volume: float
    closure: bool


def _wrench_space(points: Array, model: ForceModel) -> _WrenchSpace | None:
    """The hull of points (M, 6) that include zero; None where they do not span the six dimensions."""
    values = np.linalg.svd(points, compute_uv=False)
    if len(values) < 6 or values[-1] <= RANK_TOLERANCE * values[0]:
        return None
    size = np.linalg.norm(points, axis=1).max()
    # Joggling is the faster way to the union's hull and errs by 1e-10. In a Minkowski sum so many points share a facet
    # that Qhull has to joggle harder, and merging facets is both exact and faster.
    hull = None
    for options in ("QJ", "Qt Qx") if model == "sum" else ("Qt Qx", "QJ"):
        try:
            hull = ConvexHull(points, qhull_options=options)
        except QhullError:  # merging can fail on nearly round cones ("wide merge"): the joggled hull stands in
            continue
        normals, offsets = hull.equations[:, :6], -hull.equations[:, 6]
        nearest = offsets.argmin()
        if (points @ normals[nearest]).max() - offsets[nearest] <= JOGGLE_TOLERANCE * size:
            break
    if hull is None:
        raise RuntimeError(f"no convex hull of the {len(points)} wrenches: Qhull failed with and without joggling")
    return _WrenchSpace(normals, offsets, float(hull.volume), bool(offsets[nearest] > CLOSURE_TOLERANCE * size))


def force_closure(contacts: Sequence[Contact], center: ArrayLike | None = None, edges: int = 8) -> bool:
    """Whether the contacts, with cones of `edges` edges, can resist every wrench: zero is inside the wrench space.

    The verdict does not depend on the centre, which defaults to the mean of the positions, nor on the force model.

    Raises:
        ValueError: no contacts, or an argument of the wrong kind.
    """
    contacts = checked_contacts(contacts)
    positions = np.stack([contact.position for contact in contacts])
    c = positions.mean(axis=0) if center is None else finite("center", center, (3,))
    arm = np.linalg.norm(positions - c, axis=1).max()  # torques of the size of forces, whatever the object's size
    space = _wrench_space(wrench_points(contacts, c, "sum", edges, arm if arm > 0.0 else 1.0), "sum")
    return space is not None and space.closure


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
        model: "sum" bounds Σ f_i·n_i <= 1; "independent" every f_i·n_i <= 1, at a cost that grows steeply with the
            number of contacts and edges (0.3 s for three soft contacts of 5 edges).
        edges: edges of each linearised cone.
        torque_scale: length that torques are divided by [m], so that the ball's radius is a force [N].

    Raises:
        ValueError: no contacts, or an argument of the wrong kind.
    """
    space = _wrench_space(wrench_points(contacts, center, model, edges, torque_scale), model)
    return float(space.offsets.min()) if space is not None and space.closure else 0.0


def wrench_volume(
    contacts: Sequence[Contact],
    center: ArrayLike,
    model: ForceModel = "sum",
    edges: int = 8,
    torque_scale: float = 1.0,
) -> float:
    """Six-dimensional volume of the wrench space, zero wrench included; arguments as `largest_min_resisted_wrench`.

    Without force closure it is still the volume of what can be resisted; 0.0 where that spans fewer dimensions.
    """
    space = _wrench_space(wrench_points(contacts, center, model, edges, torque_scale), model)
    return 0.0 if space is None else space.volume


def task_wrench_quality(
    contacts: Sequence[Contact],
    center: ArrayLike,
    ellipsoid: ArrayLike,
    mean: ArrayLike = (0.0,) * 6,
    model: ForceModel = "sum",
    edges: int = 8,
) -> float:
    """Largest k for which k times the task's ellipsoid of wrenches is resisted (Li & Sastry 1988).

    Args:
        contacts, center, model, edges: as for `largest_min_resisted_wrench`.
        ellipsoid: semi-axes (6,), or A (6, 6), of the task's wrenches {mean + A z: ‖z‖ <= 1} [N, N m].
        mean: (6,) its centre [N, N m], such as the object's weight.

    Returns:
        k, without units and whatever the units of length; 0.0 without force closure.

    Raises:
        ValueError: an ellipsoid that is not finite, of another shape, or zero as the mean is; no contacts.
    """
    shape = np.shape(ellipsoid)
    axes = np.diag(finite("ellipsoid", ellipsoid, (6,))) if len(shape) == 1 else finite("ellipsoid", ellipsoid, (6, 6))
    offset = finite("mean", mean, (6,))
    if not axes.any() and not offset.any():
        raise ValueError("ellipsoid: expected a task that asks for some wrench, got zero with a zero mean")
    space = _wrench_space(wrench_points(contacts, center, model, edges), model)
    if space is None or not space.closure:
        return 0.0
    reach = space.normals @ offset + np.linalg.norm(space.normals @ axes, axis=1)  # the task's support function
    outward = reach > 0.0
    return float((space.offsets[outward] / reach[outward]).min())


# --- two contacts in closed form, and doubt ----------------------------------


def soft_antipodal(positions: ArrayLike, normals: ArrayLike, friction: ArrayLike = 0.5) -> NDArray[np.bool_]:
    """Force closure of pairs of soft contacts, exact for round cones and any torsion > 0 (Nguyen 1988).

    The line between the contacts has to lie strictly inside both friction cones, with the fingers pushing towards
    each other, or apart (from inside a hollow).

    Args:
        positions: (n, 2, 3) [m].
        normals: (n, 2, 3) unit, into the object.
        friction: μ, one for all or (2,) per finger.

    Returns:
        (n,) verdicts; contacts in the same place never close.

    Raises:
        ValueError: wrong shapes, numbers that are not finite, normals that are not unit, negative friction.
    """
    p = finite("positions", positions, (-1, 2, 3))
    n = unit("normals", normals, p.shape)
    mu = non_negative("friction", friction, (2,) if np.ndim(friction) else ())
    line = p[:, 1] - p[:, 0]
    toward = np.stack([line, -line], axis=1)  # from each contact to the other
    along = np.einsum("nij,nij->ni", toward, n)
    across = np.linalg.norm(np.cross(toward, n), axis=-1)  # keeps its digits where the line is close to the normal
    return (across < mu * along).all(axis=1) | (across < -mu * along).all(axis=1)


class ForceClosureProbability(NamedTuple):
    """A Monte-Carlo estimate: the fraction of samples that close, its standard error, and how many samples."""

    probability: float
    standard_error: float
    samples: int


def probability_of_force_closure(
    positions: ArrayLike,
    normals: ArrayLike,
    friction: ArrayLike = 0.5,
    torsion: ArrayLike = 0.0,
    edges: int = 8,
) -> ForceClosureProbability:
    """The probability of force closure of a grasp whose contacts are known as samples, such as a GPIS posterior's.

    Two contacts have a closed form for round cones, all samples at once: if neither is soft they never close, else as
    in `soft_antipodal` (one torsional contact is enough). More contacts go through `force_closure` one by one.

    Args:
        positions: (n, k, 3) samples of the k contacts' positions [m].
        normals: (n, k, 3) samples of their unit normals, into the object.
        friction: μ, one for all or (k,).
        torsion: [m], one for all or (k,).
        edges: edges of the linearised cones, for three contacts and more.

    Returns:
        Probability s/n and its standard error √(p̃(1 − p̃)/(n + 2)), p̃ = (s + 1)/(n + 2) (Agresti & Coull 1998), which
        does not claim certainty where all samples agree.

    Raises:
        ValueError: no samples, or an argument of the wrong kind.
    """
    p = finite("positions", positions, (-1, -1, 3))
    samples, fingers = p.shape[:2]
    if samples == 0 or fingers == 0:
        raise ValueError(f"positions: expected at least one sample of at least one contact, got shape {p.shape}")
    n = unit("normals", normals, p.shape)
    mu, soft = (
        np.broadcast_to(non_negative(name, value, (fingers,) if np.ndim(value) else ()), (fingers,))
        for name, value in (("friction", friction), ("torsion", torsion))
    )
    if fingers == 2:
        closed = int(soft_antipodal(p, n, mu).sum()) if soft.any() else 0
    else:
        closed = sum(
            force_closure([Contact(*contact) for contact in zip(p_i, n_i, mu, soft, strict=True)], edges=edges)
            for p_i, n_i in zip(p, n, strict=True)
        )
    smoothed = (closed + 1) / (samples + 2)
    error = float(np.sqrt(smoothed * (1.0 - smoothed) / (samples + 2)))
    return ForceClosureProbability(closed / samples, error, samples)
