"""Families of procedural objects: test, training and validation kinds, which have no kind in common."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from aerograsp_env.sim.objects import everyday, primitives
from aerograsp_env.sim.objects.build import build_object
from aerograsp_env.sim.objects.everyday import Parts
from aerograsp_env.sim.objects.grasp_object import GraspObject

Family = Callable[[np.random.Generator], GraspObject]

MASSES = (0.6, 0.9)  # [kg] a lighter object forgives every grasp
TEST_MASS = 0.75  # [kg]
MIXED = 0.3  # share of the training objects whose parts differ in density
DENSITIES = (0.25, 4.0)  # relative, of such parts


@functools.cache
def test_objects() -> tuple[GraspObject, ...]:
    """The fifteen named objects that planners are compared on, always in this order."""
    return tuple(_assemble(name, name, kind(_nominal), TEST_MASS) for name, kind in everyday.KINDS.items())


def _assemble(name: str, family: str, parts: Parts, mass: float) -> GraspObject:
    pieces = [piece for part in parts for piece in part.pieces]
    densities = [part.density for part in parts for _ in part.pieces]
    return build_object(name, family, pieces, mass=mass, densities=densities)


def _nominal(nominal: float, low: float, high: float) -> float:
    return nominal


def _everyday(name: str, kind: Callable[[everyday.Size], Parts]) -> Family:
    def member(rng: np.random.Generator) -> GraspObject:
        parts = kind(lambda nominal, low, high: rng.uniform(low, high))
        return _assemble(name, name, parts, rng.uniform(*MASSES))

    return member


def _primitive(name: str, kind: Callable[[np.random.Generator], Parts]) -> Family:
    def member(rng: np.random.Generator) -> GraspObject:
        parts = kind(rng)
        if rng.random() < MIXED:
            parts = tuple(part._replace(density=np.exp(rng.uniform(*np.log(DENSITIES)))) for part in parts)
        return _assemble(name, name, parts, rng.uniform(*MASSES))

    return member


TEST_FAMILIES: Mapping[str, Family] = MappingProxyType({n: _everyday(n, k) for n, k in everyday.KINDS.items()})
TRAIN_FAMILIES: Mapping[str, Family] = MappingProxyType({n: _primitive(n, k) for n, k in primitives.TRAIN.items()})
VALIDATION_FAMILIES: Mapping[str, Family] = MappingProxyType(
    {n: _primitive(n, k) for n, k in primitives.VALIDATION.items()}
)
