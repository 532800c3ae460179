"""N docking worlds and the one call that steps them."""

from __future__ import annotations

import copy
import ctypes
import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim import kernel
from aerograsp_env.sim import layout as lay
from aerograsp_env.sim.config import DockConfig
from aerograsp_env.sim.coupling import clamp
from aerograsp_env.sim.kernel_math import all_finite
from aerograsp_env.sim.kernel_task import METRICS, TERMS, summarize
from aerograsp_env.sim.reset import reset_world
from aerograsp_env.sim.scene import build_model

_THREADED_FROM = 8  # worlds; below, handing work to a thread costs more than it saves


def mj_step_address() -> int:
    """Address of MuJoCo's C function mj_step in the library that the Python package has loaded."""
    folder = Path(mujoco.__file__).parent
    for pattern in ("libmujoco.so*", "libmujoco*.dylib", "mujoco.dll"):
        for path in sorted(folder.glob(pattern)):
            return int(ctypes.cast(ctypes.CDLL(str(path)).mj_step, ctypes.c_void_p).value or 0)
    raise RuntimeError(f"no MuJoCo library found beside {Path(mujoco.__file__).name}; is the mujoco package intact?")


class Worlds:
    """`n` independent worlds of one configuration.

    Results are rows of arrays that the next call overwrites: `observations` (n, D) float32 in the order of `layout`,
    reward `terms` (n, len(TERMS)), `metrics` (n, len(METRICS)), `flags` (n, 2) bool = (success, terminated); and
    `states`.
    """

    def __init__(self, config: DockConfig, n: int, threads: int | None = None) -> None:
        self.config, self.n = config, n
        self.layout = lay.ATTACH_OBSERVATION if config.attach else lay.DOCK_OBSERVATION
        self.action_size = 5 if config.attach else 3
        self.model = build_model(config.airframe.with_payload(config.payload), config.tool)
        own = config.randomize is not None  # a drawn vehicle needs a model of its own
        self.models = [copy.copy(self.model) if own else self.model for _ in range(n)]
        self.datas = [mujoco.MjData(m) for m in self.models]
        self.parameters = np.zeros(n, lay.PARAMETERS)
        self.states = np.zeros(n, lay.STATE)
        self.bounds = np.concatenate([np.full(size, bound) for _, size, bound in self.layout])
        self.observations = np.zeros((n, len(self.bounds)), np.float32)
        self.terms = np.zeros((n, len(TERMS)))
        self.metrics = np.zeros((n, len(METRICS)))
        self.flags = np.zeros((n, 2), np.bool_)
        self.active = np.ones(n, np.bool_)  # worlds that `step` advances
        self._noise = np.zeros((n, lay.NOISE_BLOCK, lay.NOISE))
        self._cursors = np.zeros(n, np.int64)
        self._actions = np.zeros((n, self.action_size))
        pairs = zip(self.models, self.datas, strict=True)
        self._pointers = np.array([self._addresses(model, data) for model, data in pairs], np.int64)
        self._arguments = (
            mj_step_address(), self._pointers, self.parameters, self.states, self._noise, self._cursors,
            self.active, self._actions, self.bounds, self.observations, self.terms, self.metrics, self.flags,
        )  # fmt: skip
        self._used_up = 0  # worlds that need a fresh block of noise before their next step
        threads = min(threads or os.cpu_count() or 1, max(n // (_THREADED_FROM // 2), 1))
        self._pool = ThreadPoolExecutor(threads, "aerograsp") if threads > 1 and n >= _THREADED_FROM else None
        edges = np.linspace(0, n, threads + 1).astype(int)
        self._slices = list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))

    @staticmethod
    def _addresses(model: mujoco.MjModel, data: mujoco.MjData) -> list[int]:
        arrays = (
            data.qpos, data.qvel, data.qacc, data.ctrl, data.xfrc_applied, data.qfrc_applied,
            data.xmat, data.xpos, data.sensordata,
        )  # fmt: skip
        return [model._address, data._address, *(a.ctypes.data for a in arrays)]

    def reset(self, index: int, rng: np.random.Generator, options: dict) -> None:
        """Begin an episode in world `index`; its first observation stands in `observations[index]`."""
        i = index
        p, s = self.parameters[i : i + 1].reshape(()), self.states[i : i + 1].reshape(())
        reset_world(self.config, self.model, self.models[i], self.datas[i], rng, options, p, s)
        self.draw_noise(i, rng)
        self.terms[i], self.metrics[i], self.flags[i] = 0.0, 0.0, False
        kernel.read_worlds(
            self._pointers, self.parameters, self.states, self._noise, self._cursors, self.bounds,
            self.observations, i, i + 1,
        )  # fmt: skip

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
            for i in np.flatnonzero(self.active & (self._cursors >= lay.NOISE_BLOCK)).tolist():
                self.draw_noise(i, rngs[i])
        if self._pool is None:
            self._used_up = kernel.step_worlds(*self._arguments, 0, self.n)
        else:
            self._used_up = sum(self._pool.map(lambda s: kernel.step_worlds(*self._arguments, *s), self._slices))
        for i, data in enumerate(self.datas):  # contacts are rare: the count is read outside the compiled loop
            if data.ncon and self.active[i] and not self.flags[i, 1]:
                self.states["termination"][i] = lay.COLLISION
                summarize(self.parameters[i], self.states[i], self.terms[i], self.metrics[i], self.flags[i])
        if self.config.attach:
            closing = (self.states["coupled"] | self.states["wants_coupling"]) != 0
            for i in np.flatnonzero(self.active & closing).tolist():
                clamp(self.datas[i], self.parameters, self.states, i)

    def close(self) -> None:
        """Stop the worker threads."""
        if self._pool is not None:
            self._pool.shutdown(wait=True)
            self._pool = None
