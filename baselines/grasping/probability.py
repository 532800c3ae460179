"""The probability of force closure of grasps whose contacts are known as samples, such as a GPIS posterior's.

Ramon Soria 2018, section 2.4; Laaksonen, Nikandrova & Kyrki 2012, "Probabilistic sensor-based grasping".
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from baselines.grasping.antipodal import soft_antipodal
from baselines.grasping.contacts import Array, Contact, finite, non_negative, unit
from baselines.grasping.wrench_space import force_closure


class ForceClosureProbability(NamedTuple):
    """A Monte-Carlo estimate: the fraction of samples that close, its standard error, and how many samples."""

    probability: float
    standard_error: float
    samples: int


def _standard_error(closed: ArrayLike, samples: int) -> Array:
    """√(p̃(1 − p̃)/(n + 2)), p̃ = (s + 1)/(n + 2) (Agresti & Coull 1998): never certain where all samples agree."""
    smoothed = (np.asarray(closed, dtype=np.float64) + 1.0) / (samples + 2.0)
    return np.asarray(np.sqrt(smoothed * (1.0 - smoothed) / (samples + 2.0)))


def antipodal_probability(positions: ArrayLike, normals: ArrayLike, friction: ArrayLike = 0.5) -> tuple[Array, Array]:
    """The probability of force closure of many grasps of two soft contacts at once.

    Assumes that each sample draws both contacts of a grasp jointly (correlations are then respected), that samples are
    independent of one another, round friction cones, and a torsional contact whose limit may be as small as it likes.
    Grasps may share samples: that correlates their errors, not their values.

    Args:
        positions: (S, G, 2, 3) samples of G grasps' contact positions [m].
        normals: (S, G, 2, 3) samples of their unit normals, into the object.
        friction: μ, broadcast to (S, G, 2): one for all, (2,) per finger, or sampled as the contacts are.

    Returns:
        The fractions that close (G,) and their standard errors (G,), as `probability_of_force_closure` has them.

    Raises:
        ValueError: no samples, or an argument of the wrong kind.
    """
    shape = np.shape(positions)
    if len(shape) != 4 or shape[0] == 0:
        raise ValueError(f"positions: expected shape (S, G, 2, 3) with at least one sample, got {shape}")
    closed = soft_antipodal(positions, normals, friction).sum(axis=0).astype(np.float64)
    return closed / shape[0], _standard_error(closed, shape[0])


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
    return ForceClosureProbability(closed / samples, float(_standard_error(closed, samples)), samples)
