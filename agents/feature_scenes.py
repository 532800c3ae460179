"""Printed cartons among other cartons, and pictures of them: what feature models are learned from and tested on."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray

from aerograsp_env.interfaces import RGBD
from aerograsp_env.sim.rgbd_camera import RGBDCameraConfig, SimulatedCamera, stereo_pair
from aerograsp_env.sim.visual.viewpoints import look_at
from aerograsp_env.spatial import inverse, transform
from baselines.detection.stereo_features import StereoRig

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

SIZE = (0.18, 0.09, 0.24)  # [m] of the carton
BASELINE = 0.12  # [m] between the cameras, as a ZED's
PRINT_PIXELS, GROUND_PIXELS = 192, 512
CAMERA = RGBDCameraConfig(640, 480)
OCCLUDER_SHARE = 0.6  # of the way from the camera to the object
NOWHERE = (0.0, 0.0, -5.0)


def print_image(rng: np.random.Generator, size: int = PRINT_PIXELS) -> Image:
    """A printed face (S, S, 3): a ground colour, blocks, discs and words."""
    image = np.full((size, size, 3), rng.integers(120, 255, 3), dtype=np.uint8)
    for _ in range(10):
        a, b = rng.integers(0, size, 2), rng.integers(size // 12, size // 3, 2)
        color = tuple(int(c) for c in rng.integers(0, 255, 3))
        if rng.random() < 0.6:
            cv2.rectangle(image, tuple(map(int, a)), tuple(map(int, a + b)), color, -1)
        else:
            cv2.circle(image, tuple(map(int, a)), int(b[0] // 2), color, -1)
    for _ in range(12):
        word = "".join(rng.choice(list("ABCDEFGHKLMNPRSTUVXYZ2345689"), int(rng.integers(3, 9))))
        at = (int(rng.integers(-size // 8, size // 2)), int(rng.integers(size // 12, size)))
        color = tuple(int(c) for c in rng.integers(0, 110, 3))
        cv2.putText(image, word, at, cv2.FONT_HERSHEY_SIMPLEX, float(rng.uniform(0.35, 0.9)), color, 2, cv2.LINE_AA)
    return image


def ground_image(rng: np.random.Generator, size: int = GROUND_PIXELS) -> Image:
    """A busy floor (S, S, 3): grains of several sizes."""
    grey = np.zeros((size, size))
    for cells in (16, 48, 128):
        grey += cv2.resize(rng.standard_normal((cells, cells)), (size, size), interpolation=cv2.INTER_CUBIC)
    tint = rng.uniform(0.7, 1.0, 3)
    return np.clip((115.0 + 22.0 * grey)[..., None] * tint, 0, 255).astype(np.uint8)


class FeatureScene:
    """A carton that stands on a floor among others, and an occluder that can be held before the camera.

    Args:
        carton: seed of the carton's print: the same object for the same seed.
        surroundings: seed of everything else.
        config: of the camera.
    """

    def __init__(self, carton: int, surroundings: int, config: RGBDCameraConfig = CAMERA, others: int = 5):
        rng = np.random.default_rng((surroundings, 1))
        spec = mujoco.MjSpec()
        plane, box = mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_BOX
        floor = _texture(spec, "floor", ground_image(rng), uniform=True)
        spec.worldbody.add_geom(name="floor", type=plane, size=[0.0, 0.0, 1.0], material=floor)
        half = 0.5 * np.array(SIZE)
        faces = np.random.default_rng((carton, 0))
        printed = _texture(spec, "carton", np.concatenate([print_image(faces) for _ in range(6)]), cube=True)
        self.T_world_object = transform(np.eye(3), [0.0, 0.0, half[2]])
        spec.worldbody.add_geom(name="carton", type=box, size=half, pos=[0.0, 0.0, half[2]], material=printed)
        for k in range(others):
            angle, size = 2.0 * np.pi * (k + rng.uniform(0.0, 0.5)) / others, rng.uniform(0.03, 0.09, 3)
            place = rng.uniform(0.28, 0.4) * np.array([np.cos(angle), np.sin(angle), 0.0]) + [0.0, 0.0, size[2]]
            look = _texture(spec, f"other{k}", np.concatenate([print_image(rng) for _ in range(6)]), cube=True)
            turn = rng.uniform(-np.pi, np.pi)
            quat = [np.cos(0.5 * turn), 0.0, 0.0, np.sin(0.5 * turn)]
            spec.worldbody.add_geom(name=f"other{k}", type=box, size=size, pos=place, quat=quat, material=look)
        held = spec.worldbody.add_body(name="occluder", mocap=True, pos=NOWHERE)
        look = _texture(spec, "board", print_image(rng, 2 * PRINT_PIXELS))
        held.add_geom(name="occluder", type=box, size=[0.3, 0.3, 0.002], material=look)
        for direction in ((0.4, 0.3, -1.0), (-0.5, -0.6, -0.8)):
            spec.worldbody.add_light(
                type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, dir=direction, pos=[0.0, 0.0, 4.0],
                diffuse=[0.45] * 3, ambient=[0.12] * 3,
            )  # fmt: skip
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self.config = config
        self.camera = SimulatedCamera(self.model, config)
        self._carton = self.model.geom("carton").id
        self.free()

    @property
    def rig(self) -> StereoRig:
        """The stereo camera."""
        return StereoRig.rectified(self.camera.intrinsics, BASELINE)

    def free(self) -> None:
        """Put the occluder away."""
        self.data.mocap_pos[0] = NOWHERE
        mujoco.mj_forward(self.model, self.data)

    def visible(self, T_world_camera: Array) -> NDArray[np.bool_]:
        """(H, W) pixels of the carton."""
        return self.camera.capture(self.data, T_world_camera).segmentation == self._carton

    def hide(self, T_world_camera: Array, share: float, angle: float) -> float:
        """Hold the occluder so that its edge hides `share` of the carton's pixels, coming from `angle` [rad].

        Returns:
            The share that is hidden, counted.
        """
        self.free()
        seen = self.visible(T_world_camera)
        rows, columns = np.nonzero(seen)
        normal = np.array([np.cos(angle), np.sin(angle)])
        k = self.camera.intrinsics
        rays = np.column_stack([(columns - k.cx) / k.fx, (rows - k.cy) / k.fy])
        edge = np.quantile(rays @ normal, 1.0 - share)
        depth = OCCLUDER_SHARE * float((inverse(T_world_camera) @ self.T_world_object)[2, 3])
        along = rays.mean(axis=0) @ [-normal[1], normal[0]]
        middle = np.append(edge * normal + along * np.array([-normal[1], normal[0]]), 1.0) * depth
        middle[:2] += 0.3 * normal
        R = np.column_stack([np.append(normal, 0.0), [-normal[1], normal[0], 0.0], [0.0, 0.0, 1.0]])
        T = T_world_camera @ transform(R, middle)
        self.data.mocap_pos[0] = T[:3, 3]
        mujoco.mju_mat2Quat(self.data.mocap_quat[0], T[:3, :3].ravel())
        mujoco.mj_forward(self.model, self.data)
        return 1.0 - float(self.visible(T_world_camera).sum()) / max(int(seen.sum()), 1)


class StereoSequence(NamedTuple):
    """Stereo pairs around the carton, in order."""

    pairs: list[tuple[Image, Image]]
    masks: list[NDArray[np.bool_]]  # where in the left image the carton is
    T_c_object: Array  # (K, 4, 4)


def orbit(count: int, turn: float = 2.0 * np.pi, distance: float = 0.55, start: float = 0.0) -> Array:
    """(count, 4, 4) poses T_world_camera on a wavy circle that look at the carton's middle; `turn` in all [rad]."""
    poses = []
    for k in range(count):
        share = k / count
        azimuth = start + turn * share
        elevation = np.radians(28.0 + 12.0 * np.sin(3.0 * 2.0 * np.pi * share))
        flat = distance * np.cos(elevation)
        eye = [flat * np.cos(azimuth), flat * np.sin(azimuth), 0.1 + distance * np.sin(elevation)]
        poses.append(look_at(np.array(eye), np.array([0.0, 0.0, 0.5 * SIZE[2]])))
    return np.array(poses)


def view(rng: np.random.Generator) -> Array:
    """T_world_camera (4, 4) from any side, 0.4 to 0.8 m away, not aimed exactly, somewhat rolled."""
    azimuth, elevation = rng.uniform(-np.pi, np.pi), np.radians(rng.uniform(10.0, 55.0))
    distance = rng.uniform(0.4, 0.8)
    flat = distance * np.cos(elevation)
    eye = np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), 0.08 + distance * np.sin(elevation)])
    target = np.array([0.0, 0.0, 0.5 * SIZE[2]]) + rng.normal(0.0, 0.03, 3)
    return look_at(eye, target, rng.normal(0.0, np.radians(8.0)))


def stereo_sequence(scene: FeatureScene, poses: Array, rng: np.random.Generator | None) -> StereoSequence:
    """The sequence from given camera poses, with the camera's noise if there is a generator."""
    pairs, masks = [], []
    for T in poses:
        left, right = stereo_pair(scene.camera, scene.data, T, BASELINE, rng)
        pairs.append((left.rgb, right))
        masks.append(scene.visible(T))
    return StereoSequence(pairs, masks, inverse(poses) @ scene.T_world_object)


def frame(scene: FeatureScene, T_world_camera: Array, rng: np.random.Generator | None) -> tuple[RGBD, Array]:
    """One frame and the true T_c_object (4, 4)."""
    taken = scene.camera.capture(scene.data, T_world_camera, rng).frame
    return taken, inverse(T_world_camera) @ scene.T_world_object


def small(config: RGBDCameraConfig = CAMERA, scale: float = 0.5) -> RGBDCameraConfig:
    """The same camera with fewer pixels."""
    return replace(config, width=int(scale * config.width), height=int(scale * config.height))


def _texture(spec: mujoco.MjSpec, name: str, image: Image, uniform: bool = False, cube: bool = False) -> str:
    kind = mujoco.mjtTexture.mjTEXTURE_CUBE if cube else mujoco.mjtTexture.mjTEXTURE_2D
    texture = spec.add_texture(name=name, type=kind, width=image.shape[1], height=image.shape[0], nchannel=3)
    texture.data = np.ascontiguousarray(image).tobytes()
    material = spec.add_material(name=name, texuniform=uniform)
    material.textures[int(mujoco.mjtTextureRole.mjTEXROLE_RGB)] = name
    return name
