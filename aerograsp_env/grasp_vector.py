"""The native batched grasping environments."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.envs.grasp import grasp_task
from aerograsp_env.envs.grasp_dual import grasp_dual_task
from aerograsp_env.envs.grasp_task import GraspTask
from aerograsp_env.manipulation_vector import ManipulationVectorEnv


class GraspVectorEnv(ManipulationVectorEnv):
    """`aerograsp/Grasp-v0`, N at a time (`gymnasium.make_vec(id, num_envs=N)`): options, spaces and results as there.

    Args: see `aerograsp_env.vector_base.BatchedEnv`.
    """

    build: ClassVar[Callable[..., GraspTask]] = staticmethod(grasp_task)
    task: GraspTask

    def __init__(self, num_envs: int = 1, max_episode_steps: int = 1000, **options: Any) -> None:
        super().__init__(num_envs, max_episode_steps, **options)

    def _infos(self, mask: NDArray[np.bool_]) -> dict[str, Any]:
        infos = super()._infos(mask)
        worlds: Any = self._worlds
        told = [self.task.told(record) if known else {} for record, known in zip(worlds.records, mask, strict=True)]
        for name in ("cause", "object", "support"):
            infos[name] = np.array([entry.get(name, "") for entry in told])
            infos[f"_{name}"] = mask
        return infos


class GraspDualVectorEnv(GraspVectorEnv):
    """`aerograsp/GraspDual-v0`, N at a time."""

    build = staticmethod(grasp_dual_task)
