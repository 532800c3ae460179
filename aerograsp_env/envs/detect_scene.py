"""What Detect-v0's camera sees of an episode's scene, and what is true of it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from aerograsp_env.envs.detect_options import BASELINE, DetectOptions
from aerograsp_env.interfaces import Intrinsics
from aerograsp_env.metrics import PoseModel, TrueObject
from aerograsp_env.sim.flight import READINGS
from aerograsp_env.sim.rgbd_camera import SimulatedCamera
from aerograsp_env.sim.visual.objects import VisualObject
from aerograsp_env.sim.visual.scenes import Scene, SceneConfig, make_scene
from aerograsp_env.sim.visual.truths import truths
from aerograsp_env.spatial import Array, transform

AIMED_AT_ONE = 0.7  # share of the flights that keep one object in view, not the middle of all
MODEL_POINTS = 400  # that poses of an object are scored with
FOCAL_BOUND = 1e4  # of the observed intrinsics [px]


class Look(NamedTuple):
    """One frame and what is true of it."""

    rgb: NDArray[np.uint8]  # (H, W, 3)
    depth: NDArray[np.float32]  # (H, W) [m]
    right: NDArray[np.uint8] | None  # (H, W, 3) of the second camera, where there is one
    T_world_camera: Array  # (4, 4)
    truths: tuple[TrueObject, ...]


class Sensor:
    """The camera's part of the observation."""

    def __init__(self, options: DetectOptions) -> None:
        self.stereo = options.sensors == "stereo"
        self.intrinsics: Intrinsics = options.camera.intrinsics
        height, width = self.intrinsics.height, self.intrinsics.width
        image = spaces.Box(0, 255, (height, width, 3), np.uint8)
        parts: dict[str, spaces.Space] = {"rgb": image, "intrinsics": _box(0.0, FOCAL_BOUND, 4)}
        if self.stereo:
            parts |= {"right": image, "baseline": _box(0.0, 1.0, 1)}
        else:
            parts["depth"] = _box(0.0, options.camera.max_depth, height * width)
        parts["camera_tilt"] = _box(0.0, 0.5 * np.pi, 1)
        parts |= {name: _box(-bound, bound, size) for name, size, bound in READINGS}
        self.space = spaces.Dict(parts)

    def observed(self, look: Look) -> dict[str, NDArray[Any]]:
        """The entries that the camera fills."""
        camera = self.intrinsics
        entries: dict[str, NDArray[Any]] = {
            "rgb": look.rgb.copy(),
            "intrinsics": np.array([camera.fx, camera.fy, camera.cx, camera.cy], dtype=np.float32),
        }
        if look.right is not None:
            return {**entries, "right": look.right.copy(), "baseline": np.array([BASELINE], dtype=np.float32)}
        return {**entries, "depth": look.depth.ravel().copy()}

    def enlarged_depth(self, look: Look, size: tuple[int, int]) -> NDArray[np.float32]:
        """The depth image at `size` = (width, height) [px], nearest pixels, 0 where there is no return."""
        rows, columns = ((np.arange(n) + 0.5) / n for n in size[::-1])
        height, width = look.depth.shape
        return look.depth[(rows * height).astype(int)[:, None], (columns * width).astype(int)]


def _box(low: float, high: float, size: int) -> spaces.Box:
    return spaces.Box(low, high, (size,), np.float32)


class SeenScene:
    """One episode's scene with its camera."""

    def __init__(self, scene: Scene, options: DetectOptions) -> None:
        self._scene_model = scene.model()
        self.scene = scene
        self.model = self._scene_model.model
        self.data = self._scene_model.data
        self._stereo = options.sensors == "stereo"
        self._camera = SimulatedCamera(self.model, options.camera)
        self._models: dict[int, PoseModel] = {}

    def target(self, rng: np.random.Generator) -> Array:
        """(3,) [m] what a flight keeps in view: one of the objects, or the middle of all."""
        places = [placed.T_world_object[:3, 3] for placed in self.scene.objects]
        chosen = int(rng.integers(len(places))) if places else 0
        return places[chosen].copy() if places and rng.random() < AIMED_AT_ONE else self.scene.center

    def look(self, T_world_camera: Array, twist_c: Array, stamp: float, rng: np.random.Generator) -> Look:
        """Take a frame; the camera moves with `twist_c` (6,) in its own frame."""
        capture = self._camera.capture(self.data, T_world_camera, rng, stamp, twist_c)
        right = None
        if self._stereo:
            arm = np.array([BASELINE, 0.0, 0.0])
            twist = np.concatenate([twist_c[:3] + np.cross(twist_c[3:], arm), twist_c[3:]])
            T_world_right = T_world_camera @ transform(np.eye(3), arm)
            right = self._camera.capture(self.data, T_world_right, rng, stamp, twist).frame.rgb
        found = []
        for true in truths(capture, self._scene_model):
            model, difficult = self._model(true.index), bool(true.difficult)
            found.append(TrueObject(true.label, true.box, true.T_c_object, model, difficult, true.index))
        return Look(capture.frame.rgb, capture.frame.depth, right, T_world_camera, tuple(found))

    def _model(self, index: int) -> PoseModel:
        if index not in self._models:
            seen: VisualObject = self.scene.objects[index].object
            points, _, _ = seen.surface(MODEL_POINTS, np.random.default_rng(0))
            self._models[index] = PoseModel(points, seen.diameter, seen.symmetries)
        return self._models[index]

    def close(self) -> None:
        """Free the renderer."""
        self._camera.close()


def draw_scene(options: DetectOptions, rng: np.random.Generator) -> SeenScene:
    """A new scene."""
    mesh = options.mesh
    maker = None if mesh is None else lambda label, rng: mesh
    return SeenScene(make_scene(SceneConfig(level=options.level, labels=options.labels), rng, maker), options)
