"""The native batched docking environments."""

from __future__ import annotations

from typing import Any, ClassVar

from aerograsp_env.envs.base import dock_setup
from aerograsp_env.envs.setup import Setup
from aerograsp_env.vector_base import BatchedEnv


class DockVectorEnv(BatchedEnv):
    """`aerograsp/Dock-v0`, N at a time (`gymnasium.make_vec(id, num_envs=N)`): options, spaces and results as there.

    Args: see `aerograsp_env.vector_base.BatchedEnv`.
    """

    attach: ClassVar[bool] = False

    def __init__(self, num_envs: int = 1, max_episode_steps: int = 3000, **options: Any) -> None:
        super().__init__(num_envs, max_episode_steps, **options)

    def _setup(self, options: dict[str, Any], threads: int | None) -> Setup:
        return dock_setup(self.attach, options, self.reward_mode, self.num_envs, threads)


class DockAttachVectorEnv(DockVectorEnv):
    """`aerograsp/DockAttach-v0`, N at a time."""

    attach: ClassVar[bool] = True
