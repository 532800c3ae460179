"""State filters behind one interface: extended Kalman, unscented Kalman and particle.

All three are built from a `Model` and used alike::

    belief = filter.initial(mean, covariance)
    belief = filter.predict(belief, dt, u)
    belief = filter.update(belief, z)      # belief.mean, belief.covariance, belief.innovation

Beliefs are immutable values, so one filter serves any number of tracks and a policy can keep them in its state.
"""

from typing import Any, Protocol, TypeVar

from numpy.typing import ArrayLike

from baselines.filtering.kalman import ExtendedKalmanFilter, UnscentedKalmanFilter
from baselines.filtering.model import Belief, Innovation, Model, constant_velocity_model, numeric_jacobian
from baselines.filtering.particle import ParticleBelief, ParticleFilter

B = TypeVar("B", Belief, ParticleBelief)


class Filter(Protocol[B]):
    """What every filter here can do; B is its kind of belief, with `.mean`, `.covariance` and `.innovation`."""

    def initial(self, mean: ArrayLike, covariance: ArrayLike) -> B: ...

    def predict(self, belief: B, dt: float, u: Any = None) -> B: ...

    def update(self, belief: B, z: ArrayLike) -> B: ...


__all__ = [
    "Belief",
    "ExtendedKalmanFilter",
    "Filter",
    "Innovation",
    "Model",
    "ParticleBelief",
    "ParticleFilter",
    "UnscentedKalmanFilter",
    "constant_velocity_model",
    "numeric_jacobian",
]
