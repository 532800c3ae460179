"""The native batched docking environments."""

from __future__ import annotations

from typing import Any, ClassVar

from aerograsp_env.envs import dock_task as task
from aerograsp_env.envs.base import make_config
from aerograsp_env.sim.kernel_task import METRICS
from aerograsp_env.sim.reset import check_options
from aerograsp_env.sim.worlds import Worlds
from aerograsp_env.vector_base import BatchedEnv, Setup


class DockVectorEnv(BatchedEnv):
    """`aerograsp/Dock-v0`, N at a time (`gymnasium.make_vec(id, num_envs=N)`): options, spaces and results as there.

    Args: see `aerograsp_env.vector_base.BatchedEnv`.
    """

    attach: ClassVar[bool] = False

    def __init__(self, num_envs: int = 1, max_episode_steps: int = 3000, **options: Any) -> None:
        super().__init__(num_envs, max_episode_steps, **options)

    def _setup(self, options: dict[str, Any], threads: int | None) -> Setup:
        config = make_config(self.attach, options)
        worlds = Worlds(config, self.num_envs, threads)
        return Setup(
            config=config,
            worlds=worlds,
            observation=worlds.layout,
            action_layout=task.action_layout(config),
            terms=task.term_columns(self.attach, self.reward_mode),
            metrics=METRICS,
            always_reported=frozenset(task.ALWAYS_REPORTED),
            counted=lambda: worlds.states["error_count"] > 0,
            check_options=check_options,
        )


class DockAttachVectorEnv(DockVectorEnv):
    """`aerograsp/DockAttach-v0`, N at a time."""

    attach: ClassVar[bool] = True
