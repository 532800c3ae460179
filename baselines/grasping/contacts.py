"""Contacts, their linearised friction cones, the wrenches they can apply and the grasp matrix.

Ramon Soria 2018, section 2.4; contact models after Murray, Li & Sastry 1994, "A Mathematical Introduction to Robotic
Manipulation", section 5.2. All vectors of one call are in one frame; a wrench is (force [N], torque about a centre).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
ForceModel = Literal["sum", "independent"]
UNIT_TOLERANCE = 1e-6


def finite(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    """`value` as a new finite float array of `shape`, where -1 stands for any size, or a ValueError that names it."""
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name}: expected an array of numbers of shape {shape}, got {value!r}") from error
    if array.ndim != len(shape) or any(want not in (-1, got) for want, got in zip(shape, array.shape, strict=True)):
        raise ValueError(f"{name}: expected shape {shape} (-1: any size), got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name}: expected finite numbers, got NaN or infinity")
    return array


def non_negative(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    """`value` as a finite array of `shape` without a negative number, or a ValueError that names it."""
    array = finite(name, value, shape)
    if (array < 0.0).any():
        raise ValueError(f"{name}: expected non-negative, got {array.min()}")
    return array


def unit(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    """`value` as a finite array of `shape` whose last axis holds unit vectors, or a ValueError that names it."""
    array = finite(name, value, shape)
    error = np.abs(np.linalg.norm(array, axis=-1) - 1.0).max(initial=0.0)
    if error > UNIT_TOLERANCE:
        raise ValueError(f"{name}: expected unit vectors to {UNIT_TOLERANCE:g}, got a length off by {error:.3g}")
    return array


@dataclass(frozen=True, eq=False)
class Contact:
    """One contact of a finger with the object: frictionless, hard (Coulomb) or soft (Coulomb with torsion).

    Attributes:
        position: (3,) where it touches [m], read-only.
        normal: (3,) unit to 1e-6, pointing into the object (the direction in which the finger pushes), read-only.
        friction: Coulomb coefficient μ >= 0, ‖f − (f·n)n‖ <= μ f·n; 0 is a frictionless contact.
        torsion: [m] >= 0; > 0 is a soft finger, |τ·n| <= torsion f·n.

    Raises:
        ValueError: a wrong shape, a number that is not finite, a normal that is not unit, negative friction or torsion.
    """

    position: Array
    normal: Array
    friction: float = 0.5
    torsion: float = 0.0

    def __post_init__(self) -> None:
        values = {
            "position": finite("position", self.position, (3,)),
            "normal": unit("normal", self.normal, (3,)),
            "friction": float(non_negative("friction", self.friction, ())),
            "torsion": float(non_negative("torsion", self.torsion, ())),
        }
        for name, value in values.items():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False
            object.__setattr__(self, name, value)


def contact_basis(normal: ArrayLike) -> tuple[Array, Array]:
    """Tangents u = n × e / ‖n × e‖ and w = n × u, (3,) each, with e the axis of n's smallest component by magnitude.

    Raises:
        ValueError: a normal that is not a finite unit (3,) vector.
    """
    n = unit("normal", normal, (3,))
    u = np.cross(n, np.eye(3)[np.argmin(np.abs(n))])
    u /= np.linalg.norm(u)
    return u, np.cross(n, u)


def friction_cone(contact: Contact, edges: int = 8) -> Array:
    """The edges of the linearised cone at unit normal force, as (m, 6) wrenches about the contact point [N, N m].

    Rows are n + μ (cos φ_j u + sin φ_j w), φ_j = 2πj/edges, without torque; a soft finger adds n with ± torsion about
    n. Without friction the edges coincide and stand as one row. The polyhedral cone is inscribed in the round one.

    Raises:
        ValueError: edges is not an integer of at least 3.
    """
    if not isinstance(edges, (int, np.integer)) or isinstance(edges, bool) or edges < 3:
        raise ValueError(f"edges: expected an integer >= 3, got {edges!r}")
    n = contact.normal
    u, w = contact_basis(n)
    angle = 2.0 * np.pi * np.arange(edges if contact.friction > 0.0 else 1)[:, None] / edges
    cone = np.zeros((len(angle) + (2 if contact.torsion > 0.0 else 0), 6))
    cone[: len(angle), :3] = n + contact.friction * (np.cos(angle) * u + np.sin(angle) * w)
    if contact.torsion > 0.0:
        cone[-2:, :3] = n
        cone[-2:, 3:] = np.outer((contact.torsion, -contact.torsion), n)
    return cone


def primitive_wrenches(contact: Contact, center: ArrayLike, edges: int = 8, torque_scale: float = 1.0) -> Array:
    """`friction_cone` about `center` (3,) [m]: (m, 6) rows (f, ((p − c) × f + τ) / torque_scale).

    Raises:
        ValueError: a bad centre or number of edges, or a torque_scale [m] that is not positive.
    """
    scale = float(finite("torque_scale", torque_scale, ()))
    if scale <= 0.0:
        raise ValueError(f"torque_scale: expected a positive length, got {scale}")
    wrenches = friction_cone(contact, edges)
    wrenches[:, 3:] += np.cross(contact.position - finite("center", center, (3,)), wrenches[:, :3])
    wrenches[:, 3:] /= scale
    return wrenches


def checked_contacts(contacts: Sequence[Contact]) -> list[Contact]:
    """The contacts as a list, or a ValueError where there are none or one is something else."""
    checked = list(contacts)
    if not checked:
        raise ValueError("contacts: expected at least one contact, got none")
    for i, contact in enumerate(checked):
        if not isinstance(contact, Contact):
            raise ValueError(f"contacts[{i}]: expected a Contact, got {type(contact).__name__}")
    return checked


def wrench_points(
    contacts: Sequence[Contact],
    center: ArrayLike,
    model: ForceModel = "sum",
    edges: int = 8,
    torque_scale: float = 1.0,
) -> Array:
    """Points (M, 6) whose convex hull is the grasp wrench space, the zero wrench included.

    "sum" bounds Σ f_i·n_i <= 1 (union of the primitive wrenches), "independent" every f_i·n_i <= 1 (Minkowski sum of
    each contact's primitives with zero: M grows as (edges + 1)^contacts). Ferrari & Canny 1992, section 3.

    Raises:
        ValueError: no contacts, an unknown model, or an argument that `primitive_wrenches` refuses.
    """
    if model not in get_args(ForceModel):
        raise ValueError(f"model: expected one of {get_args(ForceModel)}, got {model!r}")
    zero = np.zeros((1, 6))
    cones = [primitive_wrenches(contact, center, edges, torque_scale) for contact in checked_contacts(contacts)]
    if model == "sum":
        return np.concatenate([*cones, zero])
    points = zero
    for cone in cones:
        points = (points[:, None] + np.concatenate([cone, zero])).reshape(-1, 6)
    return points


def grasp_matrix(contacts: Sequence[Contact], center: ArrayLike) -> Array:
    """G = [G_1 B_1 … G_k B_k], (6, columns): from contact forces in their own frames to the wrench about `center`.

    G_i = [[R_i, 0], [S(p_i − c) R_i, R_i]] with R_i = [u w n]. B_i keeps what the contact transmits, in this order:
    forces along u and w (with friction), force along n, torque about n (soft finger): 1, 3 or 4 columns, 2 for a
    soft contact without friction. Murray, Li & Sastry 1994, equation 5.6.

    Raises:
        ValueError: no contacts, or a centre that is not a finite (3,) array.
    """
    c = finite("center", center, (3,))
    blocks = []
    for contact in checked_contacts(contacts):
        n = contact.normal
        forces = np.stack([*contact_basis(n), n] if contact.friction > 0.0 else [n])
        blocks.append(np.hstack([forces, np.cross(contact.position - c, forces)]))
        if contact.torsion > 0.0:
            blocks.append(np.concatenate([np.zeros(3), n])[None])
    return np.concatenate(blocks).T
