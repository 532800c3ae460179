"""What native batched environments have in common: N worlds stepped by compiled calls, on all cores.

World i equals the single environment reset with seed + i, to the last bit: both run the same compiled step.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import gymnasium
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from aerograsp_env.envs.dock_task import observation_space, slices
from aerograsp_env.envs.options import REWARD_MODES, check_action, choose
from aerograsp_env.envs.setup import Setup
from aerograsp_env.sim.config import CONTROL_STEP
from aerograsp_env.sim.layout import TERMINATIONS

Observation = dict[str, NDArray[np.float32]]
_MODES = {
    "next_step": AutoresetMode.NEXT_STEP,
    "same_step": AutoresetMode.SAME_STEP,
    "disabled": AutoresetMode.DISABLED,
}
_TERMINATIONS = np.array(TERMINATIONS)


class BatchedEnv(VectorEnv, ABC):
    """N worlds at a time (`gymnasium.make_vec(id, num_envs=N)`): options, spaces and results as of the single one.

    Args:
        num_envs: number of worlds.
        max_episode_steps: steps after which a world truncates.
        autoreset_mode: "next_step", "same_step" or "disabled" (then `reset(options={"reset_mask": (N,) bool})`).
        threads: worker threads; default one a core.
    """

    @abstractmethod
    def _setup(self, options: dict[str, Any], threads: int | None) -> Setup:
        """The worlds that `options` mean; `num_envs` and `reward_mode` are set."""

    def __init__(
        self,
        num_envs: int = 1,
        max_episode_steps: int = 1000,
        autoreset_mode: str | AutoresetMode = "next_step",
        reward_mode: str = "dense",
        render_mode: str | None = None,
        threads: int | None = None,
        **options: Any,
    ) -> None:
        if not isinstance(num_envs, (int, np.integer)) or num_envs < 1:
            raise ValueError(f"num_envs must be a positive integer, got {num_envs!r}")
        if not isinstance(max_episode_steps, (int, np.integer)) or max_episode_steps < 1:
            raise ValueError(f"max_episode_steps must be a positive integer, got {max_episode_steps!r}")
        if threads is not None and (not isinstance(threads, (int, np.integer)) or threads < 1):
            raise ValueError(f"threads must be a positive integer or None, got {threads!r}")
        if render_mode is not None:
            raise ValueError(f"render_mode must be None for batched worlds (render a single one), got {render_mode!r}")
        if not isinstance(autoreset_mode, AutoresetMode):
            autoreset_mode = _MODES[choose("autoreset_mode", autoreset_mode, _MODES)]
        self.metadata = {"autoreset_mode": autoreset_mode, "render_modes": [], "render_fps": round(1.0 / CONTROL_STEP)}
        self.render_mode = None
        self.num_envs = int(num_envs)
        self.max_episode_steps = int(max_episode_steps)
        self.reward_mode = choose("reward_mode", reward_mode, REWARD_MODES)
        self._setting = setting = self._setup(options, threads)
        self.config, self._worlds, self.action_layout = setting.config, setting.worlds, setting.action_layout
        self.single_observation_space = observation_space(setting.observation)
        self.single_action_space = gymnasium.spaces.Box(-1.0, 1.0, (self._worlds.action_size,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._slices, self._terms = tuple(slices(setting.observation).items()), setting.terms
        self._rngs: list[np.random.Generator] = [seeding.np_random()[0] for _ in range(self.num_envs)]
        self._done = np.zeros(self.num_envs, bool)
        self._begun = np.zeros(self.num_envs, bool)
        self._every = np.ones(self.num_envs, bool)

    @property
    def dt(self) -> float:
        """Seconds per step."""
        return CONTROL_STEP

    @property
    def states(self) -> NDArray[Any]:
        """The simulator's records (N,): the truth, for oracles and tests."""
        return self._worlds.states

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode in every world, or in those of `options["reset_mask"]`. World i is seeded with seed + i."""
        options = dict(options or {})
        mask = np.asarray(options.pop("reset_mask", self._every))
        if mask.shape != (self.num_envs,) or mask.dtype != bool:
            raise ValueError(f"options['reset_mask'] must be a bool array of shape {(self.num_envs,)}, got {mask!r}")
        checked = self._setting.check_options(options)
        n = self.num_envs
        seeds = seed if isinstance(seed, list) else [None if seed is None else seed + i for i in range(n)]
        if len(seeds) != n:
            raise ValueError(f"seed must be an int or a list of {n}, got {len(seeds)} of them")
        for i in np.flatnonzero(mask):
            if seeds[i] is not None:
                self._rngs[i], _ = seeding.np_random(seeds[i])
            self._restart(int(i), checked)
        return self._observation(), self._infos(mask)

    def _restart(self, index: int, options: dict[str, Any]) -> None:
        self._worlds.reset(index, self._rngs[index], options)
        self._done[index], self._begun[index] = False, True

    def step(
        self, actions: Any
    ) -> tuple[Observation, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Advance every world by `dt`."""
        if not self._begun.all():
            raise gymnasium.error.ResetNeeded("call reset() before step()")
        checked = check_action(actions, self.action_space.shape or ())
        mode = self.metadata["autoreset_mode"]
        if mode == AutoresetMode.DISABLED and self._done.any():
            done = np.flatnonzero(self._done).tolist()
            raise gymnasium.error.ResetNeeded(f"worlds {done} are done: reset them first")
        restarted = self._done.copy()
        self._worlds.active[:] = ~restarted
        self._worlds.step(checked, self._rngs)
        for i in np.flatnonzero(restarted):  # NEXT_STEP: this step is the reset, its action is ignored
            self._restart(int(i), {})
        rewards = np.zeros(self.num_envs)
        for _, column in self._terms:  # in the order in which a single world's dictionary is summed
            rewards += self._worlds.terms[:, column]
        terminations = self._worlds.flags[:, 1].copy()
        truncations = (self._worlds.states["step"] >= self.max_episode_steps) & ~terminations
        finished = terminations | truncations
        self._done = finished.copy()  # restarting clears it; the masks handed out must stay
        infos = self._infos(self._every)
        if mode == AutoresetMode.SAME_STEP and finished.any():
            observation, final = self._observation(), np.full(self.num_envs, None, dtype=object)
            for i in np.flatnonzero(finished):
                final[i] = {name: value[i] for name, value in observation.items()}
            final_info = self._infos(finished)
            for i in np.flatnonzero(finished):
                self._restart(int(i), {})
            infos = self._infos(self._every)
            infos |= {"final_obs": final, "_final_obs": finished, "final_info": final_info, "_final_info": finished}
        return self._observation(), rewards, terminations, truncations, infos

    def _observation(self) -> Observation:
        rows = self._worlds.observations
        return {name: rows[:, part].copy() for name, part in self._slices}

    def _infos(self, mask: NDArray[np.bool_]) -> dict[str, Any]:
        """Gymnasium's convention: arrays over worlds, each with a mask of the worlds it speaks of."""
        worlds = self._worlds
        terms: dict[str, Any] = {}
        for name, column in self._terms:
            terms[name], terms[f"_{name}"] = worlds.terms[:, column].copy(), mask
        figures: dict[str, Any] = {}
        columns = worlds.metrics.T.copy()
        counted, always = mask & (self._setting.counted > 0), self._setting.always_reported
        for name, column_values in zip(self._setting.metrics, columns, strict=True):
            figures[name], figures[f"_{name}"] = column_values, mask if name in always else counted
        return {
            "success": worlds.flags[:, 0].copy(), "_success": mask,
            "reward_terms": terms, "_reward_terms": mask,
            "metrics": figures, "_metrics": mask,
            "termination": _TERMINATIONS[worlds.states["termination"]], "_termination": mask,
        }  # fmt: skip

    def close_extras(self, **kwargs: Any) -> None:
        """Stop the worker threads."""
        self._worlds.close()
