"""A simulated RGB-D camera at any pose, with a real one's faults.

It needs no camera element in the model, and by default no OpenGL. Frames are OpenCV's (x right, y down, z forward);
depth is along the optical axis.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.interfaces import RGBD, Intrinsics
from aerograsp_env.sim.cameras import pose_view
from aerograsp_env.sim.depth_noise import DepthNoiseConfig, noisy_depth
from aerograsp_env.sim.gl_probe import gl_fault
from aerograsp_env.sim.image_noise import ImageNoiseConfig, motion_blur, noisy_image
from aerograsp_env.sim.rendering import check_picture, make_renderer
from aerograsp_env.spatial import as_array, transform


@dataclass(frozen=True)
class RGBDCameraConfig:
    """An RGB-D camera whose depth is registered to its colour.

    Raises:
        ValueError: a value out of its range.
    """

    width: int = 320  # [px]
    height: int = 240
    fovy: float = math.radians(50.0)  # [rad] vertical field of view
    backend: str = "ray"  # or "gl"
    samples: int = 1  # the ray backend casts samples² rays a pixel for the colours
    min_depth: float = 0.2  # [m] below it, and
    max_depth: float = 6.0  # [m] above it there is no depth
    depth_noise: DepthNoiseConfig = field(default_factory=DepthNoiseConfig)
    image_noise: ImageNoiseConfig = field(default_factory=ImageNoiseConfig)

    def __post_init__(self) -> None:
        check_picture(self.width, self.height, self.backend, self.samples)
        for name, fits, expected in (
            ("fovy", 0.0 < self.fovy < math.pi, "between 0 and π rad"),
            ("min_depth", 0.0 <= self.min_depth < self.max_depth, "0 ≤ min_depth < max_depth"),
            ("max_depth", self.max_depth > 0.0, "positive [m]"),
        ):
            if not fits:
                raise ValueError(f"{name}: expected {expected}, got {getattr(self, name)!r}")

    @classmethod
    def ideal(cls, width: int = 320, height: int = 240, fovy: float = math.radians(50.0)) -> RGBDCameraConfig:
        """A camera without noise, blur or limits of range."""
        return cls(
            *(width, height, fovy),
            min_depth=0.0,
            max_depth=math.inf,
            depth_noise=DepthNoiseConfig.none(),
            image_noise=ImageNoiseConfig.none(),
        )

    @property
    def intrinsics(self) -> Intrinsics:
        """Square pixels, the optical axis in the picture's middle; the top left pixel's centre is (0, 0)."""
        f = 0.5 * self.height / math.tan(0.5 * self.fovy)
        return Intrinsics(self.width, self.height, f, f, 0.5 * (self.width - 1), 0.5 * (self.height - 1))


class Capture(NamedTuple):
    """One picture and what is true about it."""

    frame: RGBD  # what the camera gives, with T_world_camera
    segmentation: NDArray[np.int32]  # (H, W) geom ids, −1 where there is none
    clean_depth: NDArray[np.float32]  # (H, W) [m] true depth, without noise and limits of range
    backend: str  # which drew it: "ray" or "gl"


class SimulatedCamera:
    """Takes pictures of one model from any pose.

    Args:
        model: it is read again at each picture, but for its textures.
        config: the camera.
        groups: geom groups (0 to 5) that it sees.

    Raises:
        ValueError: groups out of range.
        RuntimeError: the backend is "gl" and OpenGL does not work here (tried in a process of its own).
    """

    def __init__(
        self, model: mujoco.MjModel, config: RGBDCameraConfig | None = None, groups: Sequence[int] = (0, 1, 2)
    ):
        self.config = config or RGBDCameraConfig()
        if self.config.backend == "gl" and (fault := gl_fault()) is not None:
            raise RuntimeError(fault)
        c = self.config
        self._intrinsics = c.intrinsics
        self._renderer = make_renderer(model, c.width, c.height, c.backend, c.samples, groups)

    @property
    def intrinsics(self) -> Intrinsics:
        """Of colour and depth alike."""
        return self._intrinsics

    def capture(
        self,
        data: mujoco.MjData,
        T_world_camera: ArrayLike,
        rng: np.random.Generator | None = None,
        stamp: float = 0.0,
        twist_c: ArrayLike | None = None,
    ) -> Capture:
        """Take a picture.

        Args:
            data: with its kinematics up to date.
            T_world_camera: (4, 4).
            rng: of the noise; None for a picture without noise and blur (range limits remain).
            stamp: time of the middle of the exposure [s].
            twist_c: (6,) the camera's own velocity in its frame (linear [m/s], angular [rad/s]), for motion blur.

        Raises:
            ValueError: a pose that is not rigid, a twist of the wrong shape, data of another model.
        """
        config = self.config
        seen = self._renderer.frame(data, pose_view(T_world_camera, self._intrinsics))
        rgb, depth = seen.rgb, seen.depth
        if twist_c is not None:
            twist_c = as_array(twist_c, (6,), "twist_c")
        if rng is not None:
            if twist_c is not None and config.image_noise.exposure_time > 0.0:
                rgb = motion_blur(rgb, depth, self._intrinsics, twist_c, config.image_noise.exposure_time)
            rgb = noisy_image(rgb, config.image_noise, rng)
            depth = noisy_depth(depth, self._intrinsics, config.depth_noise, rng)
        within = (depth >= config.min_depth) & (depth <= config.max_depth)
        frame = RGBD(
            *(rgb, np.where(within, depth, np.float32(0.0)), self._intrinsics, float(stamp)),
            T_world_camera=np.asarray(T_world_camera, dtype=np.float64),
        )
        return Capture(frame, seen.geom, seen.depth, self._renderer.backend)

    def close(self) -> None:
        """Free what the renderer holds."""
        self._renderer.close()


def stereo_pair(
    camera: SimulatedCamera,
    data: mujoco.MjData,
    T_world_left: ArrayLike,
    baseline: float,
    rng: np.random.Generator | None = None,
    stamp: float = 0.0,
    twist_c: ArrayLike | None = None,
) -> tuple[RGBD, NDArray[np.uint8]]:
    """A rectified stereo pair: the left frame, and the right picture (H, W, 3).

    The right camera stands `baseline` [m] to the right of the left one (along its x), turned alike, with the same
    intrinsics: a point at depth z is seen f · baseline / z pixels farther left in its picture.

    Raises:
        ValueError: a baseline that is not positive, and as `SimulatedCamera.capture`.
    """
    if not 0.0 < baseline < math.inf:
        raise ValueError(f"baseline: expected a positive distance [m], got {baseline!r}")
    left = camera.capture(data, T_world_left, rng, stamp, twist_c).frame
    assert left.T_world_camera is not None
    T_world_right = left.T_world_camera @ transform(np.eye(3), [baseline, 0.0, 0.0])
    if twist_c is not None:
        twist = as_array(twist_c, (6,), "twist_c")
        twist_c = np.concatenate([twist[:3] + np.cross(twist[3:], [baseline, 0.0, 0.0]), twist[3:]])
    return left, camera.capture(data, T_world_right, rng, stamp, twist_c).frame.rgb
