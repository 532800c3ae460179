"""A Gymnasium environment over one vehicle with arms and one task."""

from __future__ import annotations

from collections.abc import Callable
from operator import itemgetter
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from aerograsp_env.envs.dock_task import observation_space, slices
from aerograsp_env.envs.manipulation_options import built
from aerograsp_env.envs.options import (
    REWARD_MODES,
    available_render_modes,
    check_action,
    check_render_mode,
    choose,
)
from aerograsp_env.sim.config import CONTROL_STEP
from aerograsp_env.sim.manipulation import layout as lay
from aerograsp_env.sim.manipulation.look import CAMERAS
from aerograsp_env.sim.manipulation.reset import check_options
from aerograsp_env.sim.manipulation.task import Task
from aerograsp_env.sim.manipulation.worlds import ManipulationWorlds
from aerograsp_env.sim.rendering import check_picture

Observation = dict[str, NDArray[np.float32]]
METADATA = {"render_modes": available_render_modes(), "render_fps": round(1.0 / CONTROL_STEP)}


class ManipulationEnv(gymnasium.Env):
    """One world; subclasses name the function that makes their task from the options."""

    metadata = METADATA
    build: ClassVar[Callable[..., Task]]
    cameras: ClassVar[tuple[str, ...]] = CAMERAS

    def __init__(
        self,
        render_mode: str | None = None,
        reward_mode: str = "dense",
        width: int = 480,
        height: int = 360,
        camera: str = "side",
        render_backend: str = "ray",
        render_samples: int = 1,
        **options: Any,
    ) -> None:
        self.reward_mode = choose("reward_mode", reward_mode, REWARD_MODES)
        self.render_mode = check_render_mode(render_mode)
        check_picture(width, height, render_backend, render_samples, prefix="render_")
        self._render_settings = (width, height, choose("camera", camera, self.cameras), render_backend, render_samples)
        self.task: Task = built(type(self).build, options)
        self.config = self.task.config
        self._worlds = ManipulationWorlds(self.config, self.task, 1)
        self.observation_space = observation_space(self.task.observation)
        self._action_shape = (self._worlds.action_size,)
        self.action_space = spaces.Box(-1.0, 1.0, self._action_shape, np.float32)
        self.action_layout = self.task.actions
        parts = slices(self.task.observation)
        self._names, self._cut = tuple(parts), itemgetter(*parts.values())
        self._terms = tuple((name, self.task.terms.index(name)) for name in self.task.reward_terms(self.reward_mode))
        # this world's rows of the simulator's results, looked up once
        worlds = self._worlds
        self._row, self._terms_row, self._metrics_row = worlds.observations[0], worlds.terms[0], worlds.metrics[0]
        self._flags, self._termination = worlds.flags[0], worlds.states["termination"]
        self._scene_view: Any = None
        self._begun = False

    @property
    def model(self):
        """This world's MjModel."""
        return self._worlds.models[0]

    @property
    def data(self):
        """This world's MjData."""
        return self._worlds.datas[0]

    @property
    def dt(self) -> float:
        """Seconds per step."""
        return CONTROL_STEP

    @property
    def state(self) -> np.void:
        """The simulator's record of this world (`sim.manipulation.layout.STATE`): the truth, for oracles and tests."""
        return self._worlds.states[0]

    @property
    def record(self) -> np.void:
        """The task's record of this world: the truth, for oracles and tests."""
        return self._worlds.records[0]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode; `options` are the task's."""
        checked = check_options(options, self.task.reset_options)
        super().reset(seed=seed)
        self._worlds.reset(0, self.np_random, checked)
        self._begun = True
        return self._observation(), self._info()

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Advance by `dt`. The episode never truncates here: Gymnasium's TimeLimit does that."""
        if not self._begun:
            raise gymnasium.error.ResetNeeded("call reset() before step()")
        self._worlds.step(check_action(action, self._action_shape), [self.np_random])
        info = self._info()
        return self._observation(), sum(info["reward_terms"].values()), self._flags.item(1), False, info

    def _observation(self) -> Observation:
        return dict(zip(self._names, self._cut(self._row.copy()), strict=True))

    def _info(self) -> dict[str, Any]:
        terms = self._terms_row.tolist()
        metrics = dict(zip(self.task.metrics, self._metrics_row.tolist(), strict=True))
        if not self._flags.item(2):
            metrics = {name: metrics[name] for name in self.task.always_reported}
        return {
            "success": self._flags.item(0),
            "reward_terms": {name: terms[column] for name, column in self._terms},
            "metrics": metrics,
            "termination": lay.TERMINATIONS[self._termination.item()],
        }

    def render(self) -> NDArray[Any] | None:
        """The scene as `render_mode` says."""
        if self.render_mode is None:
            gymnasium.logger.warn("render() was called, but the environment was made without render_mode")
            return None
        if self._scene_view is None:
            from aerograsp_env.sim.manipulation.view import ManipulationView

            self._scene_view = ManipulationView(self.task, *self._render_settings)
        return self._scene_view.draw(self.model, self.data, self.record, self.state, self.render_mode)

    def close(self) -> None:
        """Free the renderer."""
        if self._scene_view is not None:
            self._scene_view.close()
            self._scene_view = None
        self._worlds.close()
