"""N vehicles with arms, and the two calls that step them: the vehicle's, and the task's."""

from __future__ import annotations

import copy
import os
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim.kernel_math import all_finite
from aerograsp_env.sim.layout import NOISE_BLOCK
from aerograsp_env.sim.manipulation import kernel
from aerograsp_env.sim.manipulation import layout as lay
from aerograsp_env.sim.manipulation.config import ManipulationConfig
from aerograsp_env.sim.manipulation.parameters import make_parameters, set_addresses
from aerograsp_env.sim.manipulation.reset import reset_world
from aerograsp_env.sim.manipulation.scene import build_model
from aerograsp_env.sim.manipulation.task import Task
from aerograsp_env.sim.worlds import mj_step_address

_THREADED_FROM = 8  # worlds; below, handing work to a thread costs more than it saves


class ManipulationWorlds:
    """`n` independent worlds of one configuration and one task.

    Results are rows of arrays that the next call overwrites: `observations` (n, D) float32 in the order of
    `task.observation`, reward `terms`, `metrics`, `flags` (n, 3) bool = (success, terminated, counted: metrics have
    begun); `parameters`, `states` (records of `layout`) and `records` (the task's own).
    """

    def __init__(self, config: ManipulationConfig, task: Task, n: int, threads: int | None = None) -> None:
        self.config, self.task, self.n = config, task, n
        self.model = build_model(config, task.pieces())
        self._nominal, self._blank = [self.model] * n, [make_parameters(config, self.model)] * n
        self.models, self.datas = [self.model] * n, [mujoco.MjData(self.model)] * n
        self._pointers = np.zeros((n, len(lay.POINTERS)), np.int64)
        self.parameters = np.zeros(n, lay.PARAMETERS)
        self.states = np.zeros(n, lay.STATE)
        self.records = np.zeros(n, task.record)
        self.bounds = np.concatenate([np.full(size, bound) for _, size, bound in task.observation])
        self.observations = np.zeros((n, len(self.bounds)), np.float32)
        self.terms = np.zeros((n, len(task.terms)))
        self.metrics = np.zeros((n, len(task.metrics)))
        self.flags = np.zeros((n, 3), np.bool_)
        self.active = np.ones(n, np.bool_)  # worlds that `step` advances
        width = lay.NOISE_WITH_TOOL if config.vehicle.tool else lay.NOISE
        self._noise = np.zeros((n, NOISE_BLOCK, width))
        self._cursors = np.zeros(n, np.int64)
        self._actions = np.zeros((n, len(task.slots)))
        for i in range(n):
            self._use(i, self.model)
        self._step = (
            mj_step_address(), self._pointers, self.parameters, self.states, self._noise, self._cursors,
            self.active, self._actions, task.slots,
        )  # fmt: skip
        results = self.bounds, task.slots, self.observations, self.terms, self.metrics, self.flags
        self._evaluate = (self.parameters, self.states, self.records, self._noise, self._cursors, self.active)
        self._results = results
        self._used_up = 0  # worlds that need a fresh block of noise before their next step
        threads = min(threads or os.cpu_count() or 1, max(n // (_THREADED_FROM // 2), 1))
        self._pool = ThreadPoolExecutor(threads, "aerograsp") if threads > 1 and n >= _THREADED_FROM else None
        edges = np.linspace(0, n, threads + 1).astype(int)
        self._slices = list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))

    @property
    def action_size(self) -> int:
        """Entries of an action."""
        return len(self.task.slots)

    def _use(self, index: int, model: mujoco.MjModel) -> None:
        """World `index` lives in `model` from now on, or in a copy of it where its vehicle is drawn."""
        if model is not self._nominal[index]:
            blank = self._blank[index].copy()
            set_addresses(blank, self.config, model)
            self._nominal[index], self._blank[index] = model, blank
        own = copy.copy(model) if self.config.randomize is not None else model
        data = mujoco.MjData(own)
        self.models[index], self.datas[index] = own, data
        arrays = (
            data.qpos, data.qvel, data.qacc, data.ctrl, data.actuator_force, data.xfrc_applied, data.qfrc_applied,
            data.xmat, data.xpos, data.sensordata,
        )  # fmt: skip
        self._pointers[index] = [own._address, data._address, *(a.ctypes.data for a in arrays)]

    def reset(self, index: int, rng: np.random.Generator, options: dict[str, Any]) -> None:
        """Begin an episode in world `index`; its first observation stands in `observations[index]`."""
        i = index
        model = self.task.scene(rng, options)
        if model is not None and model is not self._nominal[i]:
            self._use(i, model)
        p, s, record = (a[i : i + 1].reshape(()) for a in (self.parameters, self.states, self.records))
        reset_world(
            self.config, self.task, self._blank[i], self._nominal[i], self.models[i], self.datas[i], rng, options,
            p, s, record,
        )  # fmt: skip
        self.draw_noise(i, rng)
        self.terms[i], self.metrics[i], self.flags[i] = 0.0, 0.0, False
        kernel.read_worlds(self._pointers, self.parameters, self.states, self._noise, self._cursors, i, i + 1)
        active = np.ones(self.n, np.bool_)
        self.task.evaluate(*self._evaluate[:-1], active, False, *self._results, i, i + 1)

    def draw_noise(self, index: int, rng: np.random.Generator) -> None:
        """A fresh block of noise for one world."""
        rng.standard_normal(out=self._noise[index])
        self._cursors[index] = 0

    def step(self, actions: NDArray[np.float64], rngs: list[np.random.Generator]) -> None:
        """One control step of every active world. actions (n, A) or, of one world, (A,); clipped to [−1, 1].

        Raises ValueError, with nothing advanced, where an action is not finite.
        """
        self._actions[:] = actions
        if not all_finite(self._actions):
            raise ValueError(f"action must be finite, got {actions.tolist()}")
        if self._used_up:
            for i in np.flatnonzero(self.active & (self._cursors >= NOISE_BLOCK)).tolist():
                self.draw_noise(i, rngs[i])
        if self._pool is None:
            self._used_up = self._advance((0, self.n))
        else:
            self._used_up = sum(self._pool.map(self._advance, self._slices))

    def _advance(self, part: tuple[int, int]) -> int:
        used_up = kernel.step_worlds(*self._step, *part)
        self.task.evaluate(*self._evaluate, True, *self._results, *part)
        return used_up

    def close(self) -> None:
        """Stop the worker threads."""
        if self._pool is not None:
            self._pool.shutdown(wait=True)
            self._pool = None
