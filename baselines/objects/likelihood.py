"""The marginal likelihood of a Gaussian-process implicit surface, its gradient, and where it is largest.

Source: Rasmussen & Williams 2006, eqs. 2.30 and 5.9. With α = K_y⁻¹ r the derivative by log θ is ½ tr((ααᵀ − K_y⁻¹)
∂K_y/∂log θ): the matrix in brackets is formed once, and contracted with the derivative of every kernel block by block.

All parameters are positive and searched by their logarithms. `noise` and `normal_noise` are factors on the deviations
of the values and of the normals, so that points of unequal noise keep their proportions.
"""

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from baselines.objects.kernels import Kernel
from baselines.objects.linear_algebra import Array, Factor, factorise
from baselines.objects.observations import Observations

Bounds = Mapping[str, tuple[float, float]]

RANGE = 1e2
"""By how much a parameter may leave its start, down and up, where no bounds are given."""

ACTIVE = 1e-6
"""Distance from a bound, in the logarithm, at which it counts as active."""


class Evidence(NamedTuple):
    """log p(observations | parameters), and its gradient by the logarithm of each parameter."""

    value: float
    gradient: dict[str, float]


class Maximum(NamedTuple):
    """Where the search ended."""

    kernel: Kernel
    noise_factor: float
    normal_noise_factor: float
    value: float  # log likelihood there; -inf when it exists nowhere that was tried
    converged: bool
    active: tuple[str, ...]  # parameters on a bound
    evaluations: int
    message: str


def log_likelihood(factor: Factor, residual: Array, weights: Array) -> float:
    """log N(residual; 0, K_y), with weights K_y⁻¹ residual. Rasmussen & Williams 2006, eq. 2.30."""
    fidelity = -0.5 * float(residual @ weights)
    return fidelity - factor.half_log_determinant - 0.5 * len(residual) * float(np.log(2.0 * np.pi))


def evidence(kernel: Kernel, data: Observations, residual: Array) -> Evidence:
    """The likelihood and its gradient; parameters `noise`, and with normals `normal_noise`, beside the kernel's.

    Raises:
        LinAlgError: the Gram matrix is not positive definite. No jitter is added: it would move with the parameters.
    """
    with_normals, count = data.normals is not None, len(data.points)
    gram = kernel.gram(data.points, with_normals)
    gram[np.diag_indices_from(gram)] += data.deviations**2
    factor = factorise(gram, jitters=())
    weights = factor.solve(residual)
    bracket = factor.inverse()
    bracket *= -1.0
    bracket += np.outer(weights, weights)  # right in the lower triangle, which is all that is read
    gradient = kernel.contract(data.points, np.asarray(bracket), with_normals)
    by_noise = np.diag(bracket) * 2.0 * data.deviations**2
    gradient["noise"] = float(by_noise[:count].sum())
    if with_normals:
        gradient["normal_noise"] = float(by_noise[count:].sum())
    value = log_likelihood(factor, residual, weights)
    return Evidence(value, {name: 0.5 * slope for name, slope in gradient.items()})


def scaled(data: Observations, noise: float, normal_noise: float) -> Observations:
    """The observations with their deviations multiplied."""
    deviations, count = data.deviations.copy(), len(data.points)
    deviations[:count] *= noise
    deviations[count:] *= normal_noise
    return data._replace(deviations=deviations)


def maximise(
    kernel: Kernel,
    data: Observations,
    residual: Array,
    bounds: Bounds,
    fixed: Collection[str],
    restarts: int,
    rng: np.random.Generator | None,
    max_iterations: int,
) -> Maximum:
    """Bounded L-BFGS-B (Byrd et al. 1995) from the parameters as they are, and from `restarts` random starts.

    Raises:
        ValueError: bounds or fixed parameters that do not exist, or bounds that do not hold the start; restarts
            without a generator; nothing left to optimise.
    """
    names, start, box = _search_space(kernel, data, bounds, fixed)
    if restarts < 0 or (restarts > 0 and rng is None):
        raise ValueError(f"restarts: expected a number ≥ 0, and a generator `rng` with it, got {restarts}, rng={rng}")

    def place(logs: Array) -> tuple[Kernel, float, float]:
        values = dict(zip(names, np.exp(logs), strict=True))
        own = {name: float(value) for name, value in values.items() if name in kernel.parameters}
        return replace(kernel, **own), float(values.get("noise", 1.0)), float(values.get("normal_noise", 1.0))

    def cost(logs: Array) -> tuple[float, Array]:
        moved, noise, normal_noise = place(logs)
        try:
            found = evidence(moved, scaled(data, noise, normal_noise), residual)
        except np.linalg.LinAlgError:
            return 1e12, np.zeros(len(logs))  # a wall: the line search steps back
        return -found.value, -np.array([found.gradient[name] for name in names])

    starts = [start]
    if rng is not None:
        starts += [rng.uniform(box[:, 0], box[:, 1]) for _ in range(restarts)]
    runs = [
        minimize(cost, s, jac=True, method="L-BFGS-B", bounds=box, options={"maxiter": max_iterations}) for s in starts
    ]
    best = min(runs, key=lambda run: float(run.fun))
    at_bound = (np.abs(best.x[:, None] - box) < ACTIVE).any(axis=1)
    failed = float(best.fun) >= 1e12
    return Maximum(
        *place(start if failed else best.x),
        -np.inf if failed else -float(best.fun),
        bool(best.success) and not failed,
        tuple(name for name, on in zip(names, at_bound, strict=True) if on),
        sum(int(run.nfev) for run in runs),
        "the Gram matrix is singular at every start" if failed else str(best.message),
    )


def _search_space(
    kernel: Kernel, data: Observations, bounds: Bounds, fixed: Collection[str]
) -> tuple[list[str], Array, Array]:
    """Names, logarithms to start from (P,) and box (P, 2) of what is optimised."""
    count = len(data.points)
    starts = dict(kernel.parameters)
    # A deviation of zero has no logarithm: exact data stays exact.
    for name, part in (("noise", data.deviations[:count]), ("normal_noise", data.deviations[count:])):
        if part.any():
            starts[name] = 1.0
    for argument, given in (("bounds", set(bounds)), ("fixed", set(fixed))):
        if unknown := sorted(given - set(starts)):
            raise ValueError(f"{argument}: expected names among {sorted(starts)}, got {unknown}")
    names = [name for name in starts if name not in fixed]
    if not names:
        raise ValueError(f"fixed: expected at least one of {sorted(starts)} left to optimise, got all of them")
    limits = {name: (starts[name] / RANGE, starts[name] * RANGE) for name in names}
    if "radius" in limits:  # thin plate: below the present radius the covariance may cease to be one
        limits["radius"] = (starts["radius"], starts["radius"] * RANGE)
    for name in names:
        low, high = limits[name] = bounds.get(name, limits[name])
        if not 0.0 < low <= starts[name] <= high < np.inf:
            raise ValueError(
                f"bounds: expected 0 < low ≤ {starts[name]:g} (the start) ≤ high for {name}, got {low, high}"
            )
    return names, np.log([starts[name] for name in names]), np.log([limits[name] for name in names])
