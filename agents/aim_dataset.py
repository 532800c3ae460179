"""What came of grasps that were flown: attempts of `grasp-dls` that are aimed at random, with the tracker's true bias.

One row is one attempt: where it was planned, which grasp, where the tool was when the jaws closed, and what happened.
The bias, which only the simulator knows, is a label: the learned policy never sees it.
"""

from __future__ import annotations

import io
import zipfile
import zlib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.aim_choice import ENDINGS, GONE, HELD, aimed, shifted
from agents.files import writable_folder, write_atomic
from baselines.grasping.reaching import GraspPlanner
from baselines.grasping.scenes import Scene
from baselines.policies.grasp import FRICTION, failures
from baselines.policies.grasp_state import Attempt, Manoeuvre, Phase

Array = NDArray[np.float64]


BLOCK = 20  # episodes in a file
STEPS = 1000  # of an episode at most
MOST = 2  # attempts in an episode
VERSION = 1

SPREAD = 0.010  # standard deviation of the aim across, when exploring [m]
DEPTHS = (-0.008, 0.024)  # of the aim along the approach [m]
TEMPERATURE = 0.4  # of the choice among a plan's grasps


class Attempts(NamedTuple):
    """N attempts."""

    episode: NDArray[np.int64]  # (N,) its seed
    cloud: NDArray[np.float32]  # (N, 256, 6) the tracker's model, object frame [m]
    T_level_object: Array  # (N, 4, 4) by the estimate
    support: Array  # (N, 2, 3) the seat's middle [m] and unit normal, level frame
    T_object_grasp: Array  # (N, 4, 4) as flown
    jaws: Array  # (N, 2) distance of the contacts and opening on the approach [m]
    score: Array  # (N,) the planner's
    moved: Array  # (N, 3) see `Attempt`
    bias: Array  # (N, 3) of the estimate's position, level frame [m]
    outcome: NDArray[np.int64]  # (N,) see `aim_choice.OUTCOMES`

    def take(self, rows: NDArray[Any]) -> Attempts:
        """Some of them."""
        return Attempts(*(array[rows] for array in self))


class Exploring:
    """Good grasps of the plan, aimed at random: a planner of `Flight`."""

    def __init__(self, planner: GraspPlanner, rng: np.random.Generator) -> None:
        self.planner, self.rng = planner, rng
        self.gone = False  # the object, after an attempt

    def __call__(self, scene: Scene, attempts: tuple[Attempt, ...]) -> Manoeuvre | None:
        """The manoeuvre, or None if nothing can be done."""
        grasps = self.planner.plan(scene, FRICTION).grasps
        if not grasps:
            self.gone = len(attempts) > 0
            return None
        scores = np.array([grasp.score - 0.5 * failures(grasp.T_object_grasp, attempts) for grasp in grasps])
        chosen = int(np.argmax(scores + TEMPERATURE * self.rng.gumbel(size=len(scores))))
        aim = np.append(SPREAD * self.rng.standard_normal(2), self.rng.uniform(*DEPTHS))
        grasp = shifted(grasps[chosen], aim)
        return Manoeuvre((grasp,), grasp.T_level_object)


def collect(
    folder: str | Path, objects: str, level: str, first_seed: int, episodes: int, progress: bool = False
) -> Attempts:
    """Attempts of the episodes that reset with `first_seed` and so on; blocks in the folder are not flown again.

    Raises:
        ValueError: fewer than one episode.
        OSError: the folder cannot be written.
    """
    if episodes < 1:
        raise ValueError(f"episodes: expected at least 1, got {episodes}")
    from tqdm import tqdm

    from aerograsp_env.envs.grasp import GraspEnv

    folder = writable_folder(folder)
    parts: list[Attempts] = []
    env: Any = None
    blocks = range(-(-episodes // BLOCK))
    bar = tqdm(blocks, desc=f"{objects}: blocks of {BLOCK} episodes", unit="block", disable=None if progress else True)
    for block in bar:
        seed = first_seed + BLOCK * block
        path = folder / f"{objects}-{level}-{seed}.npz"
        part = read_block(path)
        if part is None:
            env = GraspEnv(level=level, objects=objects) if env is None else env
            part = fly_block(env, seed)
            write_block(path, part)
        parts.append(part)
    joined = Attempts(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))
    return joined.take(joined.episode < first_seed + episodes)


def fly_block(env: Any, first_seed: int) -> Attempts:
    """`BLOCK` episodes of a `GraspEnv` with `Exploring`."""
    planner = GraspPlanner(env.config.machine, "right")
    rows = [row for seed in range(first_seed, first_seed + BLOCK) for row in _fly(env, planner, seed)]
    return Attempts(*(np.stack(arrays) for arrays in zip(*rows, strict=True)))


def _fly(env: Any, planner: GraspPlanner, seed: int) -> list[tuple[Any, ...]]:
    exploring = Exploring(planner, np.random.default_rng(seed))
    policy = aimed(exploring)
    observation, info = env.reset(seed=seed)
    cloud = observation["object_cloud"].reshape(-1, 6)
    bias = np.array(env._worlds.parameters[0]["track_bias"][0])
    state: Any = None
    for _ in range(STEPS):
        action, state = policy.predict(observation, state)
        observation, _, terminated, _, info = env.step(action)
        pilot = state[0]
        over = len(pilot.attempts) == MOST and pilot.phase == Phase.TRANSIT
        if terminated or info["success"] or exploring.gone or over:
            break
    done = [(attempt, ENDINGS[attempt.ended]) for attempt in pilot.attempts]
    if exploring.gone:
        done[-1] = (done[-1][0], GONE)
    if info["success"]:
        last = Attempt(pilot.scene, pilot.grasps[0], pilot.moved, Phase.LIFT, float(observation["gripper"][0]))
        done.append((last, HELD))
    return [(np.int64(seed), cloud, *_row(attempt), bias, np.int64(outcome)) for attempt, outcome in done]


def _row(attempt: Attempt) -> tuple[Any, ...]:
    """The fields of `Attempts` from `T_level_object` to `moved`."""
    scene, grasp = attempt.scene, attempt.grasp
    support, jaws = np.stack([scene.support, scene.up]), np.array([grasp.width, grasp.opening])
    return scene.T_level_object, support, grasp.T_object_grasp, jaws, np.float64(grasp.score), attempt.moved


def write_block(path: Path, block: Attempts) -> None:
    """Write atomically, compressed."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, version=VERSION, **block._asdict())
    write_atomic(path, buffer.getvalue())


def read_block(path: Path) -> Attempts | None:
    """A block as written; None where there is none, or what is there is damaged."""
    try:
        with np.load(path, allow_pickle=False) as data:
            if int(data["version"]) != VERSION:
                return None
            return Attempts(**{name: data[name] for name in Attempts._fields})
    except (OSError, ValueError, KeyError, TypeError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error):
        return None
