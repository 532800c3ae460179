"""Pictures of a vehicle with arms, with a mark at the task's target, and an optional window."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim.manipulation.scene import build_model
from aerograsp_env.sim.manipulation.task import Task
from aerograsp_env.sim.rendering import make_renderer


class ManipulationView:
    """Draws worlds of one task, from a model of its own: the simulated one has no geoms only to be seen.

    Args:
        task: of the worlds.
        width, height: of the pictures [px].
        camera: a camera's name.
        backend, samples: as for `make_renderer`.
    """

    def __init__(
        self, task: Task, width: int, height: int, camera: str, backend: str = "ray", samples: int = 1
    ) -> None:
        self._task, self._camera = task, camera
        self._settings = width, height, backend, samples
        self._shown: tuple[Any, ...] | None = None  # pieces of the model that is loaded
        self._viewer: Any = None

    def _load(self, record: np.void) -> None:
        pieces = tuple(self._task.shown_pieces(record))
        if self._shown == pieces:
            return
        if self._shown is not None:
            self.close()
        self._shown = pieces
        self._model = build_model(self._task.config, pieces, look=True)
        self._data = mujoco.MjData(self._model)
        self._renderer = make_renderer(self._model, *self._settings)

    def draw(
        self, model: mujoco.MjModel, data: mujoco.MjData, record: np.void, state: np.void, mode: str
    ) -> NDArray[Any] | None:
        """(H, W, 3) uint8, (H, W) float32 depth [m], or None after updating the window."""
        self._load(record)
        own = self._data
        own.qpos, own.time = data.qpos, data.time
        for i in range(model.nbody):  # the shown model has one mocap body more, the target's mark
            mocap = int(model.body_mocapid[i])
            if mocap >= 0:
                name = model.body(i).name
                other = int(self._model.body_mocapid[self._model.body(name).id])
                own.mocap_pos[other], own.mocap_quat[other] = data.mocap_pos[mocap], data.mocap_quat[mocap]
        mark = self._task.mark(record, state)
        if mark is not None:
            own.mocap_pos[self._model.body_mocapid[self._model.body("target").id]] = mark
        mujoco.mj_kinematics(self._model, own)
        mujoco.mj_camlight(self._model, own)
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
            self._viewer = None
        if self._shown is not None:
            self._renderer.close()
            self._shown = None
