"""From the names that users pass to `aerograsp/GraspPlan-v0` to objects and checked configurations."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.envs.options import choose
from aerograsp_env.sim.objects import TRAIN_FAMILIES, VALIDATION_FAMILIES, GraspObject, from_mesh, test_objects
from aerograsp_env.spatial import as_array, matrix_from_quat_wxyz

Array = NDArray[np.float64]
Maker = Callable[[np.random.Generator], GraspObject]
Range = tuple[float, float]

SETS = ("test", "train", "validation")
RESET_OPTIONS = ("object", "orientation", "view", "occluded")


@dataclass(frozen=True)
class GraspRandomizeConfig:
    """Domain randomisation: factors drawn uniformly per episode, of the object's nominal values and the camera's."""

    mass: Range = (0.8, 1.2)  # and inertia
    friction: Range = (0.8, 1.2)
    noise: Range = (0.5, 1.5)

    def __post_init__(self) -> None:
        for field in fields(self):
            low, high = getattr(self, field.name)
            if not (np.isfinite([low, high]).all() and 0 < low <= high <= 10):
                raise ValueError(f"GraspRandomizeConfig.{field.name} must be 0 < low <= high <= 10, got {(low, high)}")


class ObjectChoice:
    """Which object an episode is about.

    Args:
        objects: "test", "train" or "validation"; a name of a test object or a family; a path of a mesh; a GraspObject;
            or a sequence of the last four.

    Raises:
        ValueError: none of these, or two objects of one name.
    """

    def __init__(self, objects: Any) -> None:
        self.drawn = isinstance(objects, str) and objects in ("train", "validation")
        makers: list[tuple[str, Maker]]
        if isinstance(objects, str) and objects in SETS:
            if objects == "test":
                makers = [(item.name, _constant(item)) for item in test_objects()]
            else:
                makers = list((TRAIN_FAMILIES if objects == "train" else VALIDATION_FAMILIES).items())
        else:
            given = [objects] if isinstance(objects, str | Path | GraspObject) else objects
            if not isinstance(given, Sequence) or not given:
                raise ValueError(
                    "objects must be 'test', 'train', 'validation', an object's name, a mesh's path, a GraspObject or "
                    f"a sequence of these, got {objects!r}"
                )
            makers = [_maker(one) for one in given]
        self.makers = dict(makers)
        if len(self.makers) != len(makers):
            raise ValueError(f"objects must have names of their own, got {[name for name, _ in makers]}")
        self.names = tuple(self.makers)

    def pick(self, seed: int | None, rng: np.random.Generator, name: str | None = None) -> GraspObject:
        """The object named; else, of a fixed list, number seed mod n; else (no seed, or a family set) a drawn one."""
        if name is None:
            index = int(rng.integers(len(self.names))) if seed is None or self.drawn else seed % len(self.names)
            name = self.names[index]
        return self.makers[name](rng)


def _constant(item: GraspObject) -> Maker:
    return lambda rng: item


def _maker(one: Any) -> tuple[str, Maker]:
    if isinstance(one, GraspObject):
        return one.name, _constant(one)
    if isinstance(one, Path) or (isinstance(one, str) and Path(one).suffix):
        item = from_mesh(one).object
        return item.name, _constant(item)
    fixed = {item.name: item for item in test_objects()}
    families = {**TRAIN_FAMILIES, **VALIDATION_FAMILIES}
    name = choose("objects", one, [*SETS, *fixed, *families])
    if name in SETS:
        raise ValueError(f"objects must name single objects or families within a sequence, got {name!r}")
    return name, _constant(fixed[name]) if name in fixed else families[name]


class Start(NamedTuple):
    """What `reset(options=)` fixes; None is drawn."""

    name: str | None
    R_world_object: Array | None  # (3, 3)
    view: Array | None  # (3,) unit
    occluded: bool | None


def check_start(options: Mapping[str, Any] | None, names: Sequence[str]) -> Start:
    """The checked options of `reset`.

    Raises:
        ValueError: an unknown option or name, a quaternion or direction without length, or a value of another kind.
    """
    given = dict(options or {})
    for key in given:
        choose("reset option", key, RESET_OPTIONS)
    name = choose("options['object']", given["object"], names) if given.get("object") is not None else None
    rotation = view = None
    if given.get("orientation") is not None:
        rotation = matrix_from_quat_wxyz(_direction(given["orientation"], 4, "orientation"))
    if given.get("view") is not None:
        view = _direction(given["view"], 3, "view")
    occluded = given.get("occluded")
    if occluded is not None and not isinstance(occluded, bool | np.bool_):
        raise ValueError(f"options['occluded'] must be True or False, got {occluded!r}")
    return Start(name, rotation, view, None if occluded is None else bool(occluded))


def _direction(value: Any, size: int, name: str) -> Array:
    vector = as_array(value, (size,), f"options['{name}']")
    length = float(np.linalg.norm(vector))
    if vector.ndim != 1 or length < 1e-9:
        raise ValueError(f"options['{name}'] must be {size} numbers, not all zero, got {value!r}")
    return vector / length


def draw_orientation(rng: np.random.Generator) -> Array:
    """(3, 3) uniform over the rotations: a normal quaternion has no preferred direction."""
    return matrix_from_quat_wxyz(_direction(rng.standard_normal(4), 4, "orientation"))


def draw_view(rng: np.random.Generator) -> Array:
    """(3,) direction from the object to the camera: any azimuth, elevation −20° to 70°, both uniform."""
    azimuth, elevation = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(math.radians(-20.0), math.radians(70.0))
    level = math.cos(elevation)
    return np.array([level * math.cos(azimuth), level * math.sin(azimuth), math.sin(elevation)])


def varied(item: GraspObject, config: GraspRandomizeConfig, rng: np.random.Generator) -> GraspObject:
    """The object with another mass and friction."""
    mass, friction = rng.uniform(*config.mass), rng.uniform(*config.friction)
    return replace(item, mass=mass * item.mass, inertia=mass * item.inertia, friction=friction * item.friction)
