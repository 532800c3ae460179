"""Scenes drawn at random: what lies where, on what, and in which light.

Two styles. "aerial": a table, a floor or a pipe in a room, to be seen obliquely from 0.6 to 2 m, as a vehicle sees it.
"studio": things side by side on a plain or textured ground, to be seen closely, mostly from above, as in photographs
of tools. The support is horizontal, z up, and the things lie around the z axis.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim.visual import CLASSES
from aerograsp_env.sim.visual import looks as look_makers
from aerograsp_env.sim.visual.distractors import distractor
from aerograsp_env.sim.visual.looks import Look
from aerograsp_env.sim.visual.objects import VisualObject, nominal_object, random_object
from aerograsp_env.sim.visual.placing import Placed, lined_up, on_pipe, scatter
from aerograsp_env.sim.visual.textures import GROUNDS
from aerograsp_env.spatial import transform

if TYPE_CHECKING:
    from aerograsp_env.sim.visual.scene_mjcf import SceneModel

Array = NDArray[np.float64]
Maker = Callable[[str, np.random.Generator], VisualObject]

LEVELS = ("easy", "cluttered", "dark", "blurred")
STYLES = ("aerial", "studio")


@dataclass(frozen=True)
class SceneConfig:
    """What may be in a scene.

    Raises:
        ValueError: an unknown level, style or label, or counts that are not 0 ≤ min ≤ max.
    """

    level: str = "easy"  # "dark" has little light, "cluttered" and "dark" distractors and things that overlap
    labels: tuple[str, ...] = CLASSES
    objects: tuple[int, int] = (3, 6)  # from, to; fewer lie there where there is no room
    distractors: tuple[int, int] | None = None  # None: by the level
    style: str = "aerial"
    randomize: bool = True  # False: nominal shapes, fixed looks, one light, plain grounds

    def __post_init__(self) -> None:
        for name, known in (("level", LEVELS), ("style", STYLES)):
            if getattr(self, name) not in known:
                raise ValueError(f"{name}: expected one of {', '.join(known)}, got {getattr(self, name)!r}")
        if not self.labels or (unknown := [label for label in self.labels if label not in CLASSES]):
            raise ValueError(f"labels: expected some of {', '.join(CLASSES)}, got {list(self.labels) and unknown}")
        for name in ("objects", "distractors"):
            bounds = getattr(self, name)
            if bounds is not None and not 0 <= bounds[0] <= bounds[1]:
                raise ValueError(f"{name}: expected 0 ≤ from ≤ to, got {bounds}")


class Ground(NamedTuple):
    """A piece of the room."""

    shape: str  # "plane", "box" or "cylinder"
    size: tuple[float, float, float]  # [m] as MuJoCo's geoms: half-sides, or radius and half-length
    T_world_ground: Array  # (4, 4)
    look: Look
    repeat: float = 1.0  # of the texture over 2 m


class Light(NamedTuple):
    """One light."""

    kind: str  # "directional", "point"
    position: Array  # (3,) [m]
    direction: Array  # (3,) of travel
    color: Array  # (3,) linear; 1 lights a white surface fully
    shadow: bool = True


@dataclass(frozen=True, eq=False)
class Scene:
    """Everything there is to see."""

    objects: tuple[Placed, ...]
    distractors: tuple[Placed, ...]
    grounds: tuple[Ground, ...]
    lights: tuple[Light, ...]
    ambient: Array  # (3,) linear light from all sides
    sky: float  # [0, 1] how much of daylight comes from the sky, and how bright it is where there is nothing
    support_height: float  # [m]
    radius: float  # [m] of what is worth looking at
    config: SceneConfig

    @property
    def center(self) -> Array:
        """(3,) [m] the middle of the things."""
        if not self.objects:
            return np.array([0.0, 0.0, self.support_height])
        return np.mean([placed.T_world_object[:3, 3] for placed in self.objects], axis=0)

    def model(self) -> SceneModel:
        """The compiled scene."""
        from aerograsp_env.sim.visual.scene_mjcf import compile_scene

        return compile_scene(self)

    def relit(self, rng: np.random.Generator) -> Scene:
        """The same things in another light."""
        lights, ambient, sky = draw_lights(self.config, rng, self.support_height)
        return replace(self, lights=lights, ambient=ambient, sky=sky)


def make_scene(config: SceneConfig, rng: np.random.Generator, maker: Maker | None = None) -> Scene:
    """A scene at random, the same for the same generator state.

    Args:
        maker: of the objects, by label; None for `random_object` (`nominal_object` where `config.randomize` is off).
    """
    build = maker or (random_object if config.randomize else _nominal)
    count = int(rng.integers(config.objects[0], config.objects[1] + 1))
    labels = [str(label) for label in rng.choice(config.labels, count)]
    if config.style == "studio" and rng.random() < 0.25:
        labels = [labels[0]] * count if labels else []
    items = [build(label, rng) for label in labels]
    extra = config.distractors or _clutter(config)
    others = [distractor(rng) for _ in range(int(rng.integers(extra[0], extra[1] + 1)))]
    room = _studio if config.style == "studio" else _aerial
    placed, strewn, grounds, height, radius = room(config, items, others, rng)
    lights, ambient, sky = draw_lights(config, rng, height)
    return Scene(tuple(placed), tuple(strewn), tuple(grounds), lights, ambient, sky, height, radius, config)


def _nominal(label: str, rng: np.random.Generator) -> VisualObject:
    return nominal_object(label)


def _clutter(config: SceneConfig) -> tuple[int, int]:
    if not config.randomize:
        return 0, 0
    if config.style == "studio":
        return (0, 2) if config.level == "easy" else (2, 7)
    return {"easy": (0, 2), "cluttered": (4, 9), "dark": (2, 6), "blurred": (0, 4)}[config.level]


_Room = tuple[list[Placed], list[Placed], list[Ground], float, float]


def _studio(
    config: SceneConfig, items: list[VisualObject], others: list[VisualObject], rng: np.random.Generator
) -> _Room:
    sizes = [item.diameter for item in items] or [0.2]
    half = 0.42 * float(np.sqrt(np.sum(np.square(sizes)))) * rng.uniform(0.7, 1.3)
    area = (half * rng.uniform(0.7, 1.3), half * rng.uniform(0.7, 1.3))
    if len(items) == 1:
        area = (0.01, 0.01)
    stack = 0.6 if config.level == "cluttered" else 0.1
    if config.randomize and len(items) > 1 and rng.random() < 0.3:
        placed = lined_up(items, rng)
    else:
        placed = scatter(items, rng, area, 0.0, stack)
    strewn = scatter(others, rng, (1.3 * half + 0.1, 1.3 * half + 0.1), 0.0, 0.3, placed)
    ground = Ground("plane", (0.0, 0.0, 1.0), np.eye(4), ground_look(config, rng, plain=0.5), _repeat(rng, 2.0, 14.0))
    return placed, strewn, [ground], 0.0, half + 0.1


def _aerial(
    config: SceneConfig, items: list[VisualObject], others: list[VisualObject], rng: np.random.Generator
) -> _Room:
    grounds = [Ground("plane", (0.0, 0.0, 1.0), np.eye(4), ground_look(config, rng, 0.2), _repeat(rng, 0.5, 6.0))]
    if rng.random() < 0.6:  # walls
        angle = rng.uniform(-np.pi, np.pi)
        for k in range(int(rng.integers(1, 3))):
            grounds.append(_wall(config, angle + 0.5 * np.pi * k, rng.uniform(1.2, 3.5), rng))
    kind = "pipe" if any(item.label == "crawler" for item in items) and rng.random() < 0.75 else "table"
    if kind == "table" and rng.random() < 0.45:
        kind = "floor"
    height = 0.0 if kind == "floor" else float(rng.uniform(0.4, 1.0))
    placed: list[Placed] = []
    half = np.array([rng.uniform(0.25, 0.5), rng.uniform(0.25, 0.5)])
    if kind == "table":
        thick = rng.uniform(0.01, 0.04)
        T = transform(np.eye(3), np.array([0.0, 0.0, height - thick]))
        size = (float(half[0]) + 0.12, float(half[1]) + 0.12, float(thick))
        grounds.append(Ground("box", size, T, ground_look(config, rng, 0.3), _repeat(rng, 1.0, 8.0)))
    elif kind == "pipe":
        radius, crawler = float(rng.uniform(0.14, 0.35)), next(i for i in items if i.label == "crawler")
        axis = max(height, radius + 0.1)
        T = transform(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]), np.array([0.0, 0.0, axis]))
        look = look_makers.metal(rng) if config.randomize else look_makers.STEEL
        grounds.append(Ground("cylinder", (radius, 2.5, 0.0), T, look, _repeat(rng, 1.0, 4.0)))
        placed.append(on_pipe(crawler, rng, radius, float(rng.uniform(-0.15, 0.15)), axis))
        items = [item for item in items if item is not crawler and item.label != "crawler"]
        height = 0.0  # the rest lies on the floor below, beside the pipe
    stack = {"easy": 0.0, "cluttered": 0.5, "dark": 0.2, "blurred": 0.2}[config.level]
    area = (float(half[0]), float(half[1]))
    if kind == "pipe":
        area = (0.9, 0.6)
    placed += scatter(items, rng, area, height, stack, placed)
    strewn = scatter(others, rng, area, height, 0.3, placed)
    support = height if kind != "pipe" else float(placed[0].T_world_object[2, 3])
    return placed, strewn, grounds, support, float(half.max())


def _wall(config: SceneConfig, angle: float, distance: float, rng: np.random.Generator) -> Ground:
    """A plane that faces the origin."""
    n = np.array([-np.cos(angle), -np.sin(angle), 0.0])
    R = np.column_stack([np.cross((0.0, 0.0, 1.0), n), (0.0, 0.0, 1.0), n])
    T = transform(R, -distance * n)
    return Ground("plane", (0.0, 0.0, 1.0), T, ground_look(config, rng, 0.4), _repeat(rng, 0.5, 4.0))


def _repeat(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def ground_look(config: SceneConfig, rng: np.random.Generator, plain: float = 0.3) -> Look:
    """Of floors, tables and walls: white, grey, black or coloured, plain with the given probability."""
    if not config.randomize:
        return Look((0.75, 0.75, 0.73), None, 0.05, 0.1)
    kind = rng.random()
    if kind < 0.35:
        grey = float(rng.uniform(0.75, 1.0))
        color = np.full(3, grey) + rng.normal(0.0, 0.015, 3)
    elif kind < 0.60:
        color = np.full(3, rng.uniform(0.03, 0.75)) + rng.normal(0.0, 0.03, 3)
    elif kind < 0.80:  # brown, sand
        color = np.array([0.75, 0.55, 0.36]) * rng.uniform(0.35, 1.3) + rng.normal(0.0, 0.05, 3)
    else:
        color = rng.random(3)
    r, g, b = np.clip(color, 0.01, 1.0)
    rgb = (float(r), float(g), float(b))
    if rng.random() < plain:
        return Look(
            rgb, None if rng.random() < 0.6 else "cloud", float(rng.uniform(0.0, 0.4)), 0.3, int(rng.integers(2**31))
        )
    return Look(rgb, str(rng.choice(GROUNDS)), float(rng.uniform(0.0, 0.4)), 0.3, int(rng.integers(2**31)))


def draw_lights(config: SceneConfig, rng: np.random.Generator, height: float) -> tuple[tuple[Light, ...], Array, float]:
    """Lights, ambient light (3,) and daylight; about one in all on a surface that faces up, a tenth where dark."""
    if not config.randomize:
        sun = Light("directional", np.array([0.0, 0.0, 3.0]), np.array([0.35, 0.25, -0.9]), np.full(3, 0.65))
        return (sun,), np.full(3, 0.3), 0.5
    total = float(np.exp(rng.uniform(np.log(0.45), np.log(1.5))))
    if config.level == "dark":
        total = float(np.exp(rng.uniform(np.log(0.04), np.log(0.2))))
    share = rng.uniform(0.2, 0.9) if config.style == "studio" else rng.uniform(0.15, 0.6)  # of the ambient light
    tint = np.clip(1.0 + rng.normal(0.0, 0.06, 3), 0.7, 1.3)
    count = int(rng.choice([1, 2, 3], p=(0.6, 0.3, 0.1)))
    parts = rng.dirichlet(np.full(count, 2.0)) * (1.0 - share) * total
    lights = []
    for k, part in enumerate(parts):
        elevation, azimuth = np.arcsin(rng.uniform(0.3, 0.98)), rng.uniform(-np.pi, np.pi)
        toward = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
        color = part / toward[2] * np.clip(1.0 + rng.normal(0.0, 0.05, 3), 0.7, 1.3) * tint
        kind = "point" if rng.random() < 0.5 else "directional"
        position = np.array([0.0, 0.0, height]) + rng.uniform(0.5, 3.0) * toward
        lights.append(Light(kind, position, -toward, color, bool(k == 0 or rng.random() < 0.3)))
    return (
        tuple(lights),
        share * total * tint,
        float(rng.uniform(0.0, 0.3)) if config.level == "dark" else float(rng.uniform(0.0, 1.0)),
    )
