"""A Gymnasium environment over one vehicle with arms and one task."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.envs.options import built
from aerograsp_env.envs.setup import Setup
from aerograsp_env.envs.world_env import WorldEnv
from aerograsp_env.sim.manipulation.look import CAMERAS
from aerograsp_env.sim.manipulation.reset import check_options
from aerograsp_env.sim.manipulation.task import Task
from aerograsp_env.sim.manipulation.worlds import ManipulationWorlds


def manipulation_setup(task: Task, reward_mode: str, n: int, threads: int | None = None) -> Setup:
    """`n` worlds of a task."""
    worlds = ManipulationWorlds(task.config, task, n, threads)
    return Setup(
        config=task.config,
        worlds=worlds,
        observation=task.observation,
        action_layout=task.actions,
        terms=tuple((name, task.terms.index(name)) for name in task.reward_terms(reward_mode)),
        metrics=task.metrics,
        always_reported=task.always_reported,
        counted=worlds.flags[:, 2],
        check_options=partial(check_options, known=task.reset_options),
    )


class ManipulationEnv(WorldEnv):
    """One world; subclasses name the function that makes their task from the options."""

    build: ClassVar[Callable[..., Task]]
    cameras: ClassVar[tuple[str, ...]] = CAMERAS

    def _setup(self, options: dict[str, Any]) -> Setup:
        self.task: Task = built(type(self).build, options)
        return manipulation_setup(self.task, self.reward_mode, 1)

    @property
    def record(self) -> np.void:
        """The task's record of this world: the truth, for oracles and tests."""
        return self._worlds.records[0]

    def _view(self) -> Any:
        from aerograsp_env.sim.manipulation.view import ManipulationView

        return ManipulationView(self.task, *self._render_settings)

    def _draw(self) -> NDArray[Any] | None:
        return self._scene_view.draw(self.model, self.data, self.record, self.state, self.render_mode)
