"""Pictures of the docking scene: joint colours by quality, and an optional window."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim.config import DockConfig
from aerograsp_env.sim.rendering import make_renderer
from aerograsp_env.sim.scene import JOINT_NAMES, build_model


def joint_qualities(config: DockConfig, joints: NDArray[np.float64]) -> NDArray[np.float64]:
    """(5,) distance of each joint to its signal limit as a share of half the range: 1 at the centre, 0 at a limit."""
    half = 0.5 * config.tool.signal_range
    return np.clip(1.0 - np.abs(joints - np.asarray(config.tool.centers)) / half, 0.0, 1.0)


def quality_color(quality: float) -> NDArray[np.float64]:
    """RGBA from red (0) over amber to green (1)."""
    stops = np.array([[0.85, 0.15, 0.15], [0.95, 0.70, 0.15], [0.15, 0.70, 0.30]])
    rgb = [np.interp(quality, [0.0, 0.5, 1.0], stops[:, i]) for i in range(3)]
    return np.array([*rgb, 1.0])


class SceneView:
    """Draws worlds of one configuration, from a model of its own: the simulated one has no geoms only to be seen.

    Args:
        config: of the worlds.
        width, height: of the pictures [px].
        camera: a name of `scene_look.CAMERAS`.
        backend, samples: as for `make_renderer`.
    """

    def __init__(
        self, config: DockConfig, width: int, height: int, camera: str, backend: str = "ray", samples: int = 1
    ) -> None:
        self._config, self._camera = config, camera
        self._model = build_model(config.airframe.with_payload(config.payload), config.tool, look=True)
        self._data = mujoco.MjData(self._model)
        self._renderer = make_renderer(self._model, width, height, backend, samples)
        self._geoms = [self._model.geom(f"{name}_hub").id for name in JOINT_NAMES]
        self._viewer: Any = None

    def draw(self, data: mujoco.MjData, mode: str) -> NDArray[Any] | None:
        """(H, W, 3) uint8, (H, W) float32 depth [m], or None after updating the window."""
        own = self._data
        own.qpos, own.mocap_pos, own.mocap_quat, own.time = data.qpos, data.mocap_pos, data.mocap_quat, data.time
        mujoco.mj_kinematics(self._model, own)
        mujoco.mj_camlight(self._model, own)
        joints = np.array([own.joint(name).qpos[0] for name in JOINT_NAMES])
        for geom, quality in zip(self._geoms, joint_qualities(self._config, joints), strict=True):
            self._model.geom_rgba[geom] = quality_color(float(quality))
        if mode == "depth_array":
            return self._renderer.depth(own, self._camera)
        if mode == "rgb_array":
            return self._renderer.render(own, self._camera)
        if self._viewer is None:
            from mujoco import viewer  # needs a display

            try:
                self._viewer = viewer.launch_passive(self._model, own)
            except Exception as error:
                raise RuntimeError(f"render_mode='human' needs a display and OpenGL: {error}") from error
        self._viewer.sync()
        return None

    def close(self) -> None:
        """Close the window and the renderer."""
        if self._viewer is not None:
            self._viewer.close()
        self._renderer.close()
