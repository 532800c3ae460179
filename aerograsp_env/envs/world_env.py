"""A Gymnasium environment over one world: spaces, results, pictures."""

from __future__ import annotations

from abc import abstractmethod
from operator import itemgetter
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from aerograsp_env.envs.dock_task import observation_space, slices
from aerograsp_env.envs.options import (
    REWARD_MODES,
    available_render_modes,
    check_action,
    check_render_mode,
    choose,
)
from aerograsp_env.envs.setup import Setup
from aerograsp_env.sim.config import CONTROL_STEP
from aerograsp_env.sim.layout import TERMINATIONS
from aerograsp_env.sim.rendering import check_picture

Observation = dict[str, NDArray[np.float32]]
METADATA = {"render_modes": available_render_modes(), "render_fps": round(1.0 / CONTROL_STEP)}


class WorldEnv(gymnasium.Env):
    """One world; subclasses say what their options mean and how it is drawn."""

    metadata = METADATA
    cameras: ClassVar[tuple[str, ...]]

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
        setting = self._setup(options)
        self.config, self.action_layout = setting.config, setting.action_layout
        self._worlds: Any = setting.worlds
        self.observation_space = observation_space(setting.observation)
        self._action_shape = (self._worlds.action_size,)
        self.action_space = spaces.Box(-1.0, 1.0, self._action_shape, np.float32)
        parts = slices(setting.observation)
        self._names, self._cut = tuple(parts), itemgetter(*parts.values())
        self._terms, self._metrics, self._always = setting.terms, setting.metrics, setting.always_reported
        self._check_options = setting.check_options
        # this world's rows of the simulator's results, looked up once
        worlds = self._worlds
        self._row, self._terms_row, self._metrics_row = worlds.observations[0], worlds.terms[0], worlds.metrics[0]
        self._flags, self._termination, self._counted = worlds.flags[0], worlds.states["termination"], setting.counted
        self._scene_view: Any = None
        self._begun = False

    @abstractmethod
    def _setup(self, options: dict[str, Any]) -> Setup:
        """The one world that `options` mean; `reward_mode` is set."""

    @abstractmethod
    def _view(self) -> Any:
        """What draws the scene, made at the first picture."""

    @abstractmethod
    def _draw(self) -> NDArray[Any] | None:
        """The scene as `render_mode` says, by `_scene_view`."""

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
        """The simulator's record of this world (`STATE` of its `layout` module): the truth, for oracles and tests."""
        return self._worlds.states[0]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode; `options` are the task's."""
        checked = self._check_options(options)
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
        metrics = dict(zip(self._metrics, self._metrics_row.tolist(), strict=True))
        if not self._counted.item():
            metrics = {name: metrics[name] for name in self._always}
        return {
            "success": self._flags.item(0),
            "reward_terms": {name: terms[column] for name, column in self._terms},
            "metrics": metrics,
            "termination": TERMINATIONS[self._termination.item()],
        }

    def render(self) -> NDArray[Any] | None:
        """The scene as `render_mode` says."""
        if self.render_mode is None:
            gymnasium.logger.warn("render() was called, but the environment was made without render_mode")
            return None
        if self._scene_view is None:
            self._scene_view = self._view()
        return self._draw()

    def close(self) -> None:
        """Free the renderer."""
        if self._scene_view is not None:
            self._scene_view.close()
            self._scene_view = None
        self._worlds.close()
