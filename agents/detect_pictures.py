"""Pictures for training detectors: blocks of a few, drawn from a seed alone.

A block shares the shapes of its objects, because making them takes longest: `ARRANGEMENTS` times they are laid out and
coloured anew, and each layout is seen from `VIEWS` viewpoints in as many lights. Two distributions are mixed: "studio",
close and mostly from above like photographs of tools, and "aerial", as a vehicle sees a table, a floor or a pipe.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from aerograsp_env.interfaces import RGBD, Intrinsics
from aerograsp_env.sim.cameras import pose_view
from aerograsp_env.sim.depth_noise import DepthNoiseConfig, noisy_depth
from aerograsp_env.sim.image_noise import ImageNoiseConfig, motion_blur, noisy_image
from aerograsp_env.sim.rendering import Renderer, make_renderer
from aerograsp_env.sim.visual import CLASSES
from aerograsp_env.sim.visual.objects import VisualObject, nominal_object, random_object, recolored
from aerograsp_env.sim.visual.scene_mjcf import SceneModel
from aerograsp_env.sim.visual.scenes import LEVELS, SceneConfig, make_scene
from aerograsp_env.sim.visual.textures import texture_image
from aerograsp_env.sim.visual.truths import Truth, owners, truths_of
from aerograsp_env.sim.visual.viewpoints import Viewpoint, draw_viewpoint

ARRANGEMENTS, VIEWS = 4, 3
BLOCK = ARRANGEMENTS * VIEWS  # pictures
TOOLS = CLASSES[:4]
STUDIO = 0.6  # share of studio pictures
NEAR, FAR = 0.15, 6.0  # [m] range of the depth camera


class Picture(NamedTuple):
    """One picture and its truth."""

    frame: RGBD
    truths: list[Truth]
    style: str
    level: str
    scene_seed: int


def draw_block(
    scene_seed: int,
    size: tuple[int, int] = (320, 240),
    randomize: bool = True,
    meshes: Mapping[str, VisualObject] = MappingProxyType({}),
) -> list[Picture]:
    """The `BLOCK` pictures of the scenes `scene_seed`, `scene_seed` + 1, … (`ARRANGEMENTS` of them).

    Args:
        size: width and height [px].
        randomize: off for nominal shapes, fixed looks, one light and plain grounds.
        meshes: what the objects of a class are instead of random ones; they keep their colours.
    """
    rng = np.random.default_rng([scene_seed, 1])
    studio = bool(rng.random() < STUDIO)
    labels = TOOLS if studio and rng.random() < 0.85 else CLASSES
    count = int(rng.integers(5, 9))
    chosen = [str(label) for label in rng.choice(labels, count)]
    pool = [
        meshes.get(label) or (random_object(label, rng) if randomize else nominal_object(label)) for label in chosen
    ]
    own = frozenset(meshes)
    pictures = []
    for seed in range(scene_seed, scene_seed + ARRANGEMENTS):
        pictures += _draw_scene(seed, pool, "studio" if studio else "aerial", size, randomize, own)
    return pictures


def _draw_scene(
    seed: int, pool: list[VisualObject], style: str, size: tuple[int, int], randomize: bool, own: frozenset[str]
) -> list[Picture]:
    rng = np.random.default_rng(seed)
    names = [item.label for item in pool]
    level = str(rng.choice(LEVELS[:2], p=(0.6, 0.4)) if style == "studio" else rng.choice(LEVELS))
    many = (1, 1) if style == "studio" and rng.random() < 0.35 else (2, min(7, len(pool)))
    config = SceneConfig(level, tuple(dict.fromkeys(names)), many, style=style, randomize=randomize)

    def pick(label: str, generator: np.random.Generator) -> VisualObject:
        same = [item for item in pool if item.label == label]
        item = same[int(generator.integers(len(same)))]
        return recolored(item, generator) if randomize and label not in own else item

    scene = make_scene(config, rng, pick)
    scene_model: SceneModel = scene.model()
    renderer = make_renderer(scene_model.model, *size)
    pictures = []
    for view in range(VIEWS):
        if view and randomize:
            scene_model = scene_model.relight(scene.relit(rng))
        viewpoint = draw_viewpoint(scene_model.scene, rng)
        pictures.append(_take(scene_model, renderer, viewpoint, size, rng, seed))
    return pictures


def _take(
    scene_model: SceneModel,
    renderer: Renderer,
    viewpoint: Viewpoint,
    size: tuple[int, int],
    rng: np.random.Generator,
    seed: int,
) -> Picture:
    scene = scene_model.scene
    intrinsics = intrinsics_of(size, viewpoint.fovy)
    seen = renderer.frame(scene_model.data, pose_view(viewpoint.T_world_camera, intrinsics))
    placed = scene.objects
    owner = owners(seen.geom, scene_model.geom_object)
    found = truths_of(
        *(owner, [item.object for item in placed], [item.T_world_object for item in placed]),
        *(viewpoint.T_world_camera, intrinsics),
    )
    rgb = seen.rgb
    if scene.config.randomize:
        rgb = _photograph(rgb, seen.geom, seen.depth, scene_model, intrinsics, rng)
    depth = noisy_depth(seen.depth, intrinsics, DepthNoiseConfig(), rng)
    depth = np.where((depth >= NEAR) & (depth <= FAR), depth, np.float32(0.0))
    frame = RGBD(rgb, depth, intrinsics, 0.0, viewpoint.T_world_camera)
    return Picture(frame, found, scene.config.style, scene.config.level, seed)


def intrinsics_of(size: tuple[int, int], fovy: float) -> Intrinsics:
    """Of a camera of square pixels with its axis in the middle of the picture."""
    focal = 0.5 * size[1] / math.tan(0.5 * fovy)
    return Intrinsics(*size, focal, focal, 0.5 * (size[0] - 1), 0.5 * (size[1] - 1))


def _photograph(
    rgb: NDArray[np.uint8],
    geom: NDArray[np.int32],
    depth: NDArray[np.float32],
    scene_model: SceneModel,
    intrinsics: Intrinsics,
    rng: np.random.Generator,
) -> NDArray[np.uint8]:
    """What becomes of a picture in a camera, and before it is published."""
    config = scene_model.scene.config
    studio = config.style == "studio"
    bare = np.append(scene_model.geom_ground, True)[geom]  # nothing, geom −1, reads the last
    if studio and rng.random() < 0.35:
        rgb = np.where(bare[..., None], _backdrop(rgb, bare, rng), rgb)
    elif (geom < 0).any():
        rgb = np.where((geom < 0)[..., None], _backdrop(rgb, bare, rng), rgb)
    if rng.random() < 0.12:
        rgb = _glare(rgb, bare, rng)
    if studio and rng.random() < 0.06:
        rgb = _overprint(rgb, rng)
    if config.level == "blurred":
        twist = np.concatenate([rng.normal(0.0, 0.4, 3), rng.normal(0.0, 0.9, 3)])
        rgb = motion_blur(rgb, depth, intrinsics, twist, float(rng.uniform(0.004, 0.02)))
    if rng.random() < 0.75:  # a lens, and the averaging of a picture made smaller
        rgb = np.asarray(cv2.GaussianBlur(rgb, (0, 0), float(rng.uniform(0.35, 0.8))))
    faults: dict[str, Any] = {"white_balance_sigma": 0.05, "exposure_sigma": 0.3 if studio else 0.2}
    if studio:
        faults["target"] = 0.0  # photographs of white grounds stay white
    noise = ImageNoiseConfig(full_well=float(np.exp(rng.uniform(np.log(800.0), np.log(12000.0)))), **faults)
    return noisy_image(np.ascontiguousarray(rgb, dtype=np.uint8), noise, rng)


def _backdrop(rgb: NDArray[np.uint8], bare: NDArray[np.bool_], rng: np.random.Generator) -> NDArray[np.uint8]:
    """White, flat, graded, or noise like that of photographs; sometimes the shadows stay."""
    height, width = rgb.shape[:2]
    kind = rng.random()
    color = np.full(3, rng.uniform(0.9, 1.0)) if kind < 0.6 else np.full(3, rng.random()) + rng.normal(0.0, 0.05, 3)
    if kind > 0.92:
        image = texture_image("photo", rng.random(3), int(rng.integers(2**31)), 256).astype(np.float32)
        back = cv2.resize(image, (width, height))
    else:
        back = np.broadcast_to(255.0 * np.clip(color, 0.0, 1.0), rgb.shape).astype(np.float32)
        if rng.random() < 0.4:
            y, x = np.mgrid[0:height, 0:width].astype(np.float32)
            slope = rng.normal(0.0, 0.25, 2)
            back = back * (1.0 + slope[0] * (x / width - 0.5) + slope[1] * (y / height - 0.5))[..., None]
    if rng.random() < 0.5 and bare.any():  # keep what is darker than most of the ground
        grey = rgb.mean(axis=2)
        shade = np.clip(grey / max(float(np.median(grey[bare])), 1.0), 0.0, 1.0) ** rng.uniform(0.3, 1.0)
        back = back * shade[..., None]
    return np.clip(back, 0.0, 255.0).astype(np.uint8)


def _glare(rgb: NDArray[np.uint8], bare: NDArray[np.bool_], rng: np.random.Generator) -> NDArray[np.uint8]:
    """A lamp mirrored in a glossy ground."""
    height, width = bare.shape
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    x, y = x / width - rng.uniform(0.0, 1.0), y / height - rng.uniform(0.0, 1.0)
    angle, wide, long = rng.uniform(0.0, np.pi), rng.uniform(0.03, 0.2), rng.uniform(0.2, 2.0)
    across, along = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
    spot = np.exp(-((across / wide) ** 2) - (along / long) ** 2) * bare * rng.uniform(40.0, 255.0)
    return np.clip(rgb + spot[..., None], 0.0, 255.0).astype(np.uint8)


def _overprint(rgb: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
    """Letters over the picture, as catalogues and picture agencies print them."""
    image = np.ascontiguousarray(rgb)
    layer = image.copy()
    for _ in range(int(rng.integers(1, 4))):
        text = "".join(chr(int(c)) for c in rng.integers(65, 91, int(rng.integers(3, 12))))
        at = (int(rng.integers(-20, image.shape[1])), int(rng.integers(8, image.shape[0])))
        color = tuple(int(c) for c in rng.integers(0, 256, 3))
        cv2.putText(
            layer, text, at, int(rng.integers(0, 5)), float(rng.uniform(0.3, 1.2)), color, int(rng.integers(1, 3))
        )
    return np.asarray(cv2.addWeighted(layer, share := float(rng.uniform(0.3, 1.0)), image, 1.0 - share, 0.0))
