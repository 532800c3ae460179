"""A Gymnasium environment over one docking world."""

from __future__ import annotations

from typing import Any, ClassVar

from numpy.typing import NDArray

from aerograsp_env.envs import dock_task as task
from aerograsp_env.envs.options import built, dock_config
from aerograsp_env.envs.setup import Setup
from aerograsp_env.envs.world_env import Observation, WorldEnv
from aerograsp_env.sim.kernel_task import METRICS
from aerograsp_env.sim.reset import check_options
from aerograsp_env.sim.scene_look import CAMERAS
from aerograsp_env.sim.worlds import Worlds


def dock_setup(attach: bool, options: dict[str, Any], reward_mode: str, n: int, threads: int | None = None) -> Setup:
    """`n` docking worlds."""
    config = built(dock_config, options, attach=attach)
    worlds = Worlds(config, n, threads)
    return Setup(
        config=config,
        worlds=worlds,
        observation=worlds.layout,
        action_layout=task.action_layout(config),
        terms=task.term_columns(attach, reward_mode),
        metrics=METRICS,
        always_reported=task.ALWAYS_REPORTED,
        counted=worlds.states["error_count"],
        check_options=check_options,
    )


class DockBase(WorldEnv):
    """One world of the docking scene; the tasks differ in where an episode begins and what its action may do."""

    attach: ClassVar[bool] = False
    cameras = CAMERAS

    def _setup(self, options: dict[str, Any]) -> Setup:
        return dock_setup(self.attach, options, self.reward_mode, 1)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode.

        options: "goal" and "start", the set-point and the first position as (3,) offsets from the nominal airframe
        position [m]; "wind_direction" [rad], the azimuth the mean wind blows towards; "tilt" (2,) of the clamped base
        about its x and y axes [rad].
        """
        return super().reset(seed=seed, options=options)

    def _view(self) -> Any:
        from aerograsp_env.sim.scene_view import SceneView

        return SceneView(self.config, *self._render_settings)

    def _draw(self) -> NDArray[Any] | None:
        """Joints are coloured from green (far from saturation) to red (at a limit)."""
        return self._scene_view.draw(self.data, self.render_mode)
