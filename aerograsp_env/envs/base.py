"""A Gymnasium environment over one docking world."""

from __future__ import annotations

from operator import itemgetter
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from aerograsp_env.envs import dock_task as task
from aerograsp_env.envs.options import (
    REWARD_MODES,
    available_render_modes,
    check_action,
    check_render_mode,
    choose,
    dock_config,
)
from aerograsp_env.sim import layout as lay
from aerograsp_env.sim.config import CONTROL_STEP
from aerograsp_env.sim.kernel_task import METRICS
from aerograsp_env.sim.rendering import check_picture
from aerograsp_env.sim.reset import check_options
from aerograsp_env.sim.scene_look import CAMERAS
from aerograsp_env.sim.worlds import Worlds

Observation = dict[str, NDArray[np.float32]]
METADATA = {"render_modes": available_render_modes(), "render_fps": round(1.0 / CONTROL_STEP)}


class DockBase(gymnasium.Env):
    """One world of the docking scene; the tasks differ in where an episode begins and what its action may do."""

    metadata = METADATA
    attach = False

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
        self._render_settings = (width, height, choose("camera", camera, CAMERAS), render_backend, render_samples)
        self.config = make_config(self.attach, options)
        self._worlds = Worlds(self.config, 1)
        self.observation_space = task.observation_space(self._worlds.layout)
        self.action_space = spaces.Box(-1.0, 1.0, (self._worlds.action_size,), np.float32)
        self._action_shape = (self._worlds.action_size,)
        self.action_layout = task.action_layout(self.config)
        slices = task.slices(self._worlds.layout)
        self._names, self._cut = tuple(slices), itemgetter(*slices.values())
        self._terms = task.term_columns(self.attach, self.reward_mode)
        # this world's rows of the simulator's results, looked up once
        worlds = self._worlds
        self._row, self._terms_row, self._metrics_row = worlds.observations[0], worlds.terms[0], worlds.metrics[0]
        self._flags, self._termination = worlds.flags[0], worlds.states["termination"]
        self._counted = worlds.states["error_count"]
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
        """The simulator's record of this world (`aerograsp_env.sim.layout.STATE`): the truth, for oracles and tests."""
        return self._worlds.states[0]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode.

        options: "goal" and "start", the set-point and the first position as (3,) offsets from the nominal airframe
        position [m]; "wind_direction" [rad], the azimuth the mean wind blows towards; "tilt" (2,) of the clamped base
        about its x and y axes [rad].
        """
        checked = check_options(options)
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
        return self._observation(), sum(info["reward_terms"].values()), info["termination"] != "", False, info

    def _observation(self) -> Observation:
        return dict(zip(self._names, self._cut(self._row.copy()), strict=True))

    def _info(self) -> dict[str, Any]:
        terms = self._terms_row.tolist()
        metrics = dict(zip(METRICS, self._metrics_row.tolist(), strict=True))
        if not self._counted.item():
            metrics = {name: metrics[name] for name in task.ALWAYS_REPORTED}
        return {
            "success": self._flags.item(0),
            "reward_terms": {name: terms[column] for name, column in self._terms},
            "metrics": metrics,
            "termination": lay.TERMINATIONS[self._termination.item()],
        }

    def render(self) -> NDArray[Any] | None:
        """The scene as `render_mode` says; joints are coloured from green (far from saturation) to red (at a limit)."""
        if self.render_mode is None:
            gymnasium.logger.warn("render() was called, but the environment was made without render_mode")
            return None
        if self._scene_view is None:
            from aerograsp_env.sim.scene_view import SceneView

            self._scene_view = SceneView(self.config, *self._render_settings)
        return self._scene_view.draw(self.data, self.render_mode)

    def close(self) -> None:
        """Free the renderer."""
        if self._scene_view is not None:
            self._scene_view.close()
            self._scene_view = None
        self._worlds.close()


def make_config(attach: bool, options: dict[str, Any]):
    """`dock_config`, with an error that lists the valid names where an option is unknown."""
    import difflib
    import inspect

    known = [name for name in inspect.signature(dock_config).parameters if name != "attach"]
    for name in options:
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise ValueError(f"unknown option {name!r}{hint}; options: {', '.join(known)}")
    return dock_config(attach=attach, **options)
