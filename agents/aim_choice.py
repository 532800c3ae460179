"""Where a grasp is aimed when the estimate of the object may be centimetres off: learned outcomes, and a belief.

A network has learned from flights what comes of a grasp if the tool is displaced from it (`agents.aim_features`). With
that one model a flight does two things: what came of its attempts so far says where the tracker's error can be (Bayes'
rule over particles), and the next attempt is the grasp and the aim that hold with the highest probability under that
belief. The network acts through `grasp-dls`, which flies the manoeuvre.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.aim_features import grasp_features
from baselines.grasping.reaching import GraspPlanner, Reached
from baselines.grasping.scenes import Scene
from baselines.policies.grasp import FRICTION, GraspPolicy, grasp_dls
from baselines.policies.grasp_pilot import Flight
from baselines.policies.grasp_state import Attempt, Manoeuvre, Phase, PilotSettings

Array = NDArray[np.float64]

HELD, LOST, EMPTY, BLOCKED, GONE = range(5)
OUTCOMES = ("held", "lost", "empty", "blocked", "gone")
"""Lifted to success; slipped on the way up; the jaws closed on nothing; given up before they closed; any of the last
three after which no grasp can be reached, because the object fell."""
ENDINGS = {Phase.LIFT: LOST, Phase.CLOSE: EMPTY, Phase.APPROACH: BLOCKED, Phase.ALIGN: BLOCKED}

SETTINGS = PilotSettings(deeper=0.0, nearly=0.03)
"""Of flights that are aimed: the aim says how deep to go, and what the tools meet on the way there is closed upon."""

PARTICLES = 600
QUANTILES = 9  # by which the error's length is known
LATER = (0.5, 0.3)  # what an object that stays is worth, after as many attempts: it may be held by the next one
DOUBT = 0.02  # probability of an outcome that the network does not know of
FIELD = (np.arange(-0.048, 0.049, 0.012), np.arange(-0.048, 0.049, 0.008), np.arange(-0.040, 0.057, 0.008))
"""Displacements of the tool at which the network is asked [m]."""
AIMS = (np.arange(-0.012, 0.013, 0.012), np.arange(-0.018, 0.019, 0.006), np.arange(-0.012, 0.031, 0.006))
"""Aims that are compared, about the belief's mean [m]."""


def mesh(axes: tuple[Array, Array, Array]) -> Array:
    """(X·Y·Z, 3) points of a grid, the last axis fastest."""
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def shifted(grasp: Reached, aim: Array) -> Reached:
    """The same grasp, `aim` (3,) [m] aside in its own frame, done in the same posture of the arm."""
    T, T_level = grasp.T_object_grasp.copy(), grasp.T_level_object.copy()
    step = T[:3, :3] @ aim
    T[:3, 3] += step
    T_level[:3, 3] -= T_level[:3, :3] @ step
    return grasp._replace(T_object_grasp=T, T_level_object=T_level)


def aimed(planner: Any) -> GraspPolicy:
    """`grasp-dls` with another planner (see `grasp_pilot.Planner`), and `SETTINGS`."""
    return GraspPolicy(Flight(grasp_dls().flight.arms, planner, SETTINGS))


class Outcomes:
    """An ensemble of perceptrons, in NumPy: the probabilities of `OUTCOMES` from `aim_features`.

    Args:
        tensors: input.mean, input.scale (F,); layer.k.weight (M, in, out) and layer.k.bias (M, 1, out).
    """

    def __init__(self, tensors: Mapping[str, NDArray[Any]]) -> None:
        self.mean, self.scale = tensors["input.mean"], tensors["input.scale"]
        count = sum(name.endswith(".weight") for name in tensors)
        self.layers = [(tensors[f"layer.{k}.weight"], tensors[f"layer.{k}.bias"]) for k in range(count)]

    def __call__(self, features: Array) -> Array:
        """(E, 5) of (E, F), the members' mean."""
        x = np.clip((features.astype(np.float32) - self.mean) / self.scale, -5.0, 5.0)[None]
        for weight, bias in self.layers[:-1]:
            x = np.maximum(x @ weight + bias, 0.0)
        x = x @ self.layers[-1][0] + self.layers[-1][1]
        x = np.exp(x - x.max(axis=-1, keepdims=True))
        return np.asarray((x / x.sum(axis=-1, keepdims=True)).mean(axis=0), dtype=np.float64)


class AimPlanner:
    """Chooses among the plan's grasps and aims them: a planner of `Flight`. Remembers nothing.

    Args:
        planner: finds grasps.
        outcomes: what comes of them.
        lengths: (Q,) quantiles, evenly spaced from the least to the largest, of the length that the estimate's error
            had where the outcomes were learned [m]; its direction may be any.
    """

    def __init__(self, planner: GraspPlanner, outcomes: Outcomes, lengths: Array) -> None:
        self.planner, self.outcomes = planner, outcomes
        rng = np.random.default_rng(0)
        direction = rng.standard_normal((PARTICLES, 3))
        length = np.interp(rng.random((PARTICLES, 1)), np.linspace(0.0, 1.0, len(lengths)), lengths)
        self.particles = length * direction / np.linalg.norm(direction, axis=1, keepdims=True)
        self.field, self.aims = mesh(FIELD), mesh(AIMS)

    def __call__(self, scene: Scene, attempts: tuple[Attempt, ...]) -> Manoeuvre | None:
        """The manoeuvre, or None if nothing can be done."""
        grasps = self.planner.plan(scene, FRICTION).grasps
        if not grasps:
            return None
        belief = self.belief(attempts)
        later = LATER[len(attempts)] if len(attempts) < len(LATER) else 0.0
        chosen = max((self.best_aim(scene, grasp, belief, later) for grasp in grasps), key=lambda found: found[1])[0]
        return Manoeuvre((chosen,), chosen.T_level_object)

    def belief(self, attempts: tuple[Attempt, ...]) -> Array:
        """(PARTICLES,) weights of the estimate's possible errors after what came of some attempts."""
        weights = np.full(PARTICLES, 1.0 / PARTICLES)
        for attempt in attempts:
            R = attempt.scene.T_level_object[:3, :3] @ attempt.grasp.T_object_grasp[:3, :3]
            chances = self._chances(attempt.scene, attempt.grasp, attempt.moved + self.particles @ R, True)
            weights = weights * (DOUBT + chances[:, ENDINGS[attempt.ended]])
        return np.asarray(weights / weights.sum())

    def best_aim(self, scene: Scene, grasp: Reached, belief: Array, later: float = 0.0) -> tuple[Reached, float]:
        """The grasp aimed as well as can be, and its value: the chance that it holds, and `later` if it is left."""
        chances = self._chances(scene, grasp, self.field, False)
        worth = chances[:, HELD] + later * (1.0 - chances[:, HELD] - chances[:, GONE])
        errors = self.particles @ (scene.T_level_object[:3, :3] @ grasp.T_object_grasp[:3, :3])
        aims = self.aims - belief @ errors
        rows = np.zeros((len(aims), PARTICLES), dtype=np.int64)
        for k, axis in enumerate(FIELD):
            at = (aims[:, None, k] + errors[None, :, k] - axis[0]) / (axis[1] - axis[0])
            rows = rows * len(axis) + np.clip(np.rint(at), 0, len(axis) - 1).astype(np.int64)
        values = worth[rows] @ belief
        index = int(np.argmax(values))
        return shifted(grasp, aims[index]), float(values[index])

    def _chances(self, scene: Scene, grasp: Reached, displacements: Array, measured: bool) -> Array:
        """(E, 5) probabilities of the outcomes, with the tool at displacements (E, 3) of a grasp."""
        T, width, opening = grasp.T_object_grasp, grasp.width, grasp.opening
        return self.outcomes(grasp_features(scene, T, width, opening, grasp.score, displacements, measured))
