"""What `agents.speed` times: recorded flights replayed by the environments, bare MuJoCo steps of the same flight."""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import mujoco
import numpy as np
from numpy.typing import NDArray

import aerograsp_env
from aerograsp_env.sim.layout import SUBSTEPS

DOCK = "aerograsp/Dock-v0"
STATE = mujoco.mjtState.mjSTATE_INTEGRATION  # with the controls and applied forces of the moment
PROCESSOR, WALL = 0, 1
Seconds = NDArray[np.float64]  # (2,) of the calling thread's processor time, of wall time
Runner = Callable[[], Seconds]
LONG = 10**9  # steps: no episode ends by its time limit while it is timed


class Flight(NamedTuple):
    """A recorded flight under the id's reference policy: the same seed and actions give it again."""

    model: Any  # MjModel, None for a batch
    seed: int
    actions: NDArray[np.float32]  # (steps, A) or (steps, N, A)
    states: NDArray[np.float64]  # (steps / chunk, size): MuJoCo's at the beginning of each chunk
    chunk: int  # steps that are timed together


def make_single(env_id: str = DOCK) -> Any:
    """The single environment as users make it."""
    return gymnasium.make(env_id, max_episode_steps=LONG)


def make_batch(num_envs: int, threads: int | None, env_id: str = DOCK) -> Any:
    """The native batched environment."""
    options: Mapping[str, Any] = {"vectorization_mode": "vector_entry_point", "threads": threads}
    return gymnasium.make_vec(env_id, num_envs=num_envs, max_episode_steps=LONG, **options)


def record(env: Any, steps: int, chunk: int = 25, seed: int = 0, env_id: str = DOCK) -> Flight:
    """Fly with the id's reference policy and record.

    Raises:
        RuntimeError: an episode ended meanwhile, or the vehicle was not docked.
    """
    batched = hasattr(env, "num_envs")
    policy, state = aerograsp_env.reference_policy(env_id), None
    observation, _ = env.reset(seed=seed)
    actions, states = [], []
    for k in range(steps):
        if not batched and k % chunk == 0:
            model, data = env.unwrapped.model, env.unwrapped.data
            if not data.eq_active.all():
                raise RuntimeError(f"the tool is not coupled at step {k}: nothing docked to measure")
            states.append(np.zeros(mujoco.mj_stateSize(model, STATE)))
            mujoco.mj_getState(model, data, states[-1], STATE)
        action, state = policy.predict(observation, state=state)
        actions.append(np.asarray(action, np.float32))
        observation, _, terminated, _, _ = env.step(actions[-1])
        if np.any(terminated):
            raise RuntimeError(f"the recorded flight ended after {k} steps: no steady flight to measure")
    return Flight(None if batched else env.unwrapped.model, seed, np.array(actions), np.array(states), chunk)


class Replay:
    """Steps an environment along a flight; a call takes the next chunk's steps and returns their seconds."""

    def __init__(self, env: Any, flight: Flight) -> None:
        self._env, self._flight, self._next = env, flight, 0

    def __call__(self) -> Seconds:
        """Of one chunk; the reset before the first is not timed."""
        flight, step = self._flight, self._env.step
        if self._next == 0:
            self._env.reset(seed=flight.seed)
        actions = list(flight.actions[self._next : self._next + flight.chunk])
        self._next = (self._next + flight.chunk) % len(flight.actions)
        began = now()
        for action in actions:
            step(action)
        return now() - began


class BareSteps:
    """`mj_step` in a Python loop, from the flight's recorded states: the bound that no environment can pass."""

    def __init__(self, flight: Flight) -> None:
        self._flight, self._next = flight, 0
        self._data = mujoco.MjData(flight.model)
        self()
        self.constraints = int(self._data.nefc)  # active rows: the docked tool's weld has six
        self._next = 0

    def __call__(self) -> Seconds:
        """Of one chunk; restoring the state before it is not timed."""
        model, data, chunk = self._flight.model, self._data, self._flight.chunk
        mujoco.mj_setState(model, data, self._flight.states[self._next], STATE)
        mujoco.mj_forward(model, data)
        self._next = (self._next + 1) % len(self._flight.states)
        began = now()
        for _ in range(chunk):
            mujoco.mj_step(model, data, nstep=SUBSTEPS)
        return now() - began


def now() -> Seconds:
    """Both clocks."""
    return np.array([time.thread_time(), time.perf_counter()])


def in_turns(runners: Mapping[str, Runner], seconds: float, repeats: int) -> dict[str, NDArray[np.float64]]:
    """Seconds a call of every runner, (repeats, 2) each, in turns until `seconds` have passed in every repeat.

    Processor time is what single-threaded work costs, whatever slices of time the system gives to others; on an idle
    machine it is the wall time.
    """
    for run in runners.values():
        run()  # warm
    means = {name: np.zeros((repeats, 2)) for name in runners}
    for repeat in range(repeats):
        sums, turns, began = {name: np.zeros(2) for name in runners}, 0, time.perf_counter()
        while time.perf_counter() - began < seconds:
            for name, run in runners.items():
                sums[name] += run()
            turns += 1
        for name in runners:
            means[name][repeat] = sums[name] / turns
    return means


def reset_times(env: Any, n: int) -> NDArray[np.float64]:
    """Seconds of n resets, each with a seed of its own."""
    times = np.zeros(n)
    for k in range(n):
        began = time.perf_counter()
        env.reset(seed=k)
        times[k] = time.perf_counter() - began
    return times


def start_time() -> float:
    """Seconds from starting an interpreter to the result of the first step."""
    code = (
        f"import gymnasium, aerograsp_env\nenv = gymnasium.make({DOCK!r})\n"
        "env.reset(seed=0)\nenv.step(env.action_space.sample())"
    )
    began = time.perf_counter()
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
    return time.perf_counter() - began


@dataclass
class Load:
    """Cores that other processes kept busy on average; None where the system does not say."""

    cores: float | None = None


@contextmanager
def others_load() -> Iterator[Load]:
    """How busy other processes keep the machine within the block (Linux only)."""
    load = Load()
    busy, own, began = _busy(), time.process_time(), time.perf_counter()
    yield load
    after = _busy()
    if busy is not None and after is not None:
        others = after - busy - (time.process_time() - own)
        load.cores = max(others, 0.0) / (time.perf_counter() - began)


def _busy() -> float | None:
    """Seconds that all processors together have been busy since the system started."""
    path = Path("/proc/stat")
    if not path.exists():
        return None
    fields = [int(field) for field in path.read_text().split("\n", 1)[0].split()[1:9]]
    user, nice, system, _, _, irq, softirq, steal = fields
    return (user + nice + system + irq + softirq + steal) / os.sysconf("SC_CLK_TCK")
