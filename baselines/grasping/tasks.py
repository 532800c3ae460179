"""Quality with respect to what is asked of a grasp: a task's ellipsoid of wrenches, or all that can act on the object.

Li & Sastry 1988, "Task-oriented optimal grasping by multifingered robot hands"; Pollard 1994, "Parallel methods for
synthesizing whole-hand grasps from generalized prototypes"; Borst, Fischer & Hirzinger 2004, "Grasp planning: how to
choose a suitable task wrench space".
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import ConvexHull, QhullError

from baselines.grasping.contacts import Array, Contact, ForceModel, checked_contacts, finite, non_negative
from baselines.grasping.wrench_space import Task, arm, largest_scale, wrench_space

STANDARD_GRAVITY = 9.80665  # [m/s²]
EIGENVALUE_TOLERANCE = 1e-9  # of the largest moment of inertia


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
        k [1/N of grip], whatever the unit of length; 0.0 without force closure.

    Raises:
        ValueError: an ellipsoid that is not finite, of another shape, or zero as the mean is; no contacts.
    """
    shape = np.shape(ellipsoid)
    axes = np.diag(finite("ellipsoid", ellipsoid, (6,))) if len(shape) == 1 else finite("ellipsoid", ellipsoid, (6, 6))
    offset = finite("mean", mean, (6,))
    if not axes.any() and not offset.any():
        raise ValueError("ellipsoid: expected a task that asks for some wrench, got zero with a zero mean")
    return largest_scale(wrench_space(contacts, center, model, edges), Task(offset[None], axes[None], np.array([0, 1])))


@dataclass(frozen=True, eq=False)
class ObjectWrenches:
    """The object wrench space: weight and inertia in any direction, and a push on any one point of the surface.

    It is the Minkowski sum of three sets: forces of at most mass · (gravity + acceleration) through the centre of mass,
    torques inertia · α of ‖α‖ <= angular_acceleration, and the hull of forces of at most `push` through the `points`.

    Attributes:
        mass: [kg] >= 0.
        center_of_mass: (3,) [m], read-only.
        acceleration: largest acceleration of the centre of mass, in any direction [m/s²].
        inertia: (3, 3) about the centre of mass [kg m²], read-only.
        angular_acceleration: largest, about any axis [rad/s²].
        points: (N, 3) of the surface, where something may push [m], read-only.
        push: the largest such force, in any direction [N].
        gravity: [m/s²]; it may come from any direction, as the grasp's attitude is not known.

    Raises:
        ValueError: a wrong shape, a number that is not finite, a negative magnitude, an inertia that is not symmetric
            and positive semi-definite, a push without points, or a sum that asks for no wrench.
    """

    mass: float
    center_of_mass: Array
    acceleration: float = 0.0
    inertia: Array = field(default_factory=lambda: np.zeros((3, 3)))
    angular_acceleration: float = 0.0
    points: Array = field(default_factory=lambda: np.zeros((0, 3)))
    push: float = 0.0
    gravity: float = STANDARD_GRAVITY

    def __post_init__(self) -> None:
        shapes = {"center_of_mass": (3,), "inertia": (3, 3), "points": (-1, 3)}
        for name in (item.name for item in fields(self)):
            value = getattr(self, name)
            if name in shapes:
                value = finite(name, value, shapes[name])
                value.flags.writeable = False
            else:
                value = float(non_negative(name, value, ()))
            object.__setattr__(self, name, value)
        moments = np.linalg.eigvalsh(self.inertia)
        limit = EIGENVALUE_TOLERANCE * np.abs(moments).max()
        if np.abs(self.inertia - self.inertia.T).max() > limit or moments.min() < -limit:
            raise ValueError(f"inertia: expected symmetric and positive semi-definite, got {self.inertia.tolist()}")
        if self.push > 0.0 and not len(self.points):
            raise ValueError(f"points: expected at least one point for a push of {self.push} N, got none")
        if not (self._force > 0.0 or self._torques.any() or self.push > 0.0):
            raise ValueError("mass: expected an object on which some wrench acts, got neither weight, inertia nor push")

    @property
    def _force(self) -> float:
        return self.mass * (self.gravity + self.acceleration)

    @property
    def _torques(self) -> Array:
        return self.inertia * self.angular_acceleration

    def task(self, torque_scale: float = 1.0) -> Task:
        """As wrenches about the centre of mass [N, N m / torque_scale]."""
        points = _extreme(self.points) if self.push > 0.0 else self.points[:0]
        ellipsoids = np.zeros((2 + len(points), 6, 3))
        ellipsoids[0, :3] = self._force * np.eye(3)
        ellipsoids[1, 3:] = self._torques / torque_scale
        ellipsoids[2:, :3] = self.push * np.eye(3)
        # column j of a point's lower block is the torque of a force along axis j
        arms = (points - self.center_of_mass) / torque_scale
        ellipsoids[2:, 3:] = self.push * np.cross(arms[:, None], np.eye(3)).transpose(0, 2, 1)
        starts = np.array([0, 1, 2, 2 + len(points)][: 4 if len(points) else 3])
        return Task(np.zeros((len(ellipsoids), 6)), ellipsoids, starts)


def object_wrench_quality(
    contacts: Sequence[Contact], wrenches: ObjectWrenches, model: ForceModel = "sum", edges: int = 8
) -> float:
    """Largest k for which k times the object wrench space is resisted (Pollard 1994; Borst et al. 2004).

    The Minkowski sum and the hull of pushes are taken exactly, not by an ellipsoid around them.

    Args:
        contacts, model, edges: as for `largest_min_resisted_wrench`.
        wrenches: what acts on the object, in the frame of the contacts.

    Returns:
        k [1/N], since normal forces are bounded by 1 N: a grip of 1/k newtons resists all of it. It depends on no
        centre and no torque scale; 0.0 without force closure.

    Raises:
        ValueError: no contacts, or an argument of the wrong kind.
    """
    if not isinstance(wrenches, ObjectWrenches):
        raise ValueError(f"wrenches: expected ObjectWrenches, got {type(wrenches).__name__}")
    contacts = checked_contacts(contacts)
    center = wrenches.center_of_mass
    scale = arm(np.stack([contact.position for contact in contacts]), center)
    return largest_scale(wrench_space(contacts, center, model, edges, scale), wrenches.task(scale))


def _extreme(points: Array) -> Array:
    """The corners of the points' hull: pushes elsewhere ask for no more, as a wrench is linear in where it acts."""
    try:
        return points[ConvexHull(points).vertices] if len(points) > 4 else points
    except QhullError:  # flat
        return points
