"""The native batched environments of vehicles with arms."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

from aerograsp_env.envs.dock_manipulate import dock_manipulate_task
from aerograsp_env.envs.manipulation_base import manipulation_setup
from aerograsp_env.envs.options import built
from aerograsp_env.envs.reach import GoalReward, reach_task
from aerograsp_env.envs.setup import Setup
from aerograsp_env.sim.manipulation.task import Task
from aerograsp_env.vector_base import BatchedEnv


class ManipulationVectorEnv(BatchedEnv):
    """A task of a vehicle with arms, N at a time; subclasses name the function that makes the task from the options."""

    build: ClassVar[Callable[..., Task]]

    def _setup(self, options: dict[str, Any], threads: int | None) -> Setup:
        self.task: Task = built(type(self).build, options)
        return manipulation_setup(self.task, self.reward_mode, self.num_envs, threads)


class ReachVectorEnv(GoalReward, ManipulationVectorEnv):
    """`aerograsp/Reach-v0`, N at a time (`gymnasium.make_vec(id, num_envs=N)`): options, spaces and results as there.

    Args: see `aerograsp_env.vector_base.BatchedEnv`.
    """

    build = staticmethod(reach_task)

    def __init__(self, num_envs: int = 1, max_episode_steps: int = 500, **options: Any) -> None:
        super().__init__(num_envs, max_episode_steps, **options)


class DockManipulateVectorEnv(ManipulationVectorEnv):
    """`aerograsp/DockManipulate-v0`, N at a time: options, spaces and results as there.

    Args: see `aerograsp_env.vector_base.BatchedEnv`.
    """

    build = staticmethod(dock_manipulate_task)

    def __init__(self, num_envs: int = 1, max_episode_steps: int = 1500, **options: Any) -> None:
        super().__init__(num_envs, max_episode_steps, **options)
