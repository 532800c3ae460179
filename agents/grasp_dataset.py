"""Grasps labelled by the physics: views of objects, grasps proposed on each, and what became of them.

A folder holds one `.npz` a block of views (no pickle), written whole or not at all; collecting again goes on where it
was interrupted. Block b of a set starts at its first seed + b · `BLOCK`.
"""

from __future__ import annotations

import io
import zipfile
import zlib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.bench_setup import GRASP_PLAN
from agents.files import writable_folder, write_atomic
from agents.workers import run_jobs

BLOCK = 25  # views a file
VERSION = 1
LABELS = ("held", "strict")


class Labelled(NamedTuple):
    """V views with K grasps each; `valid` says which of the K there are."""

    points: NDArray[np.float32]  # (V, N, 3) [m]
    normals: NDArray[np.float32]  # (V, N, 3)
    poses: NDArray[np.float32]  # (V, K, 4, 4) T_cloud_gripper
    context: NDArray[np.float32]  # (V, K, F)
    labels: NDArray[np.float32]  # (V, K, 2), in the order of `LABELS`
    valid: NDArray[np.bool_]  # (V, K)

    @classmethod
    def joined(cls, parts: list[Labelled]) -> Labelled:
        """All views of all parts."""
        return cls(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def collect(
    folder: str | Path, objects: str, first_seed: int, views: int, grasps: int, workers: int = 1, progress: bool = False
) -> Labelled:
    """Label `grasps` grasps on each of `views` views of the objects of a set, or read those that are there.

    Args:
        folder: of the blocks; made if need be.
        objects: "train" or "validation".
        first_seed: of the first view.
        views: rounded up to whole blocks.
        grasps: K, the best of the analytic ranking first, then random ones.
        workers: processes.
        progress: a bar, if standard error is a terminal.

    Raises:
        ValueError: a number below 1.
        OSError: the folder cannot be written.
    """
    for name, value in (("views", views), ("grasps", grasps), ("workers", workers)):
        if value < 1:
            raise ValueError(f"{name}: expected at least 1, got {value}")
    from tqdm import tqdm

    folder = writable_folder(folder)
    jobs = [
        (folder / f"{objects}-{first_seed}-{block:05d}-{grasps}.npz", objects, first_seed + block * BLOCK, grasps)
        for block in range(-(-views // BLOCK))
    ]
    found = {path: read_block(path) for path, *_ in jobs}
    todo = [job for job in jobs if found[job[0]] is None]
    bar = tqdm(total=len(jobs), initial=len(jobs) - len(todo), desc=f"{objects}: blocks of {BLOCK} views", unit="block")
    bar.disable = bar.disable or not progress
    with bar:
        for path in run_jobs(label_block, todo, workers):
            found[path] = read_block(path)
            bar.update()
    parts = [part for part in found.values() if part is not None]
    if len(parts) < len(jobs):
        raise OSError(f"{folder}: expected {len(jobs)} blocks of labels, {len(jobs) - len(parts)} cannot be read back")
    return Labelled.joined(parts)


def label_block(path: Path, objects: str, first_seed: int, grasps: int) -> Path:
    """Write one block; returns its path."""
    import gymnasium

    from aerograsp_env.envs.grasp_plan import unpack_cloud
    from aerograsp_env.sim.gripper import gripper_pose
    from baselines.grasping.planning import usable
    from baselines.policies.grasp_plan import CONTEXT, planner

    propose = planner("gpis")
    env: Any = gymnasium.make(GRASP_PLAN, objects=objects, disable_env_checker=True).unwrapped
    rows: list[tuple[Any, ...]] = []
    for seed in range(first_seed, first_seed + BLOCK):
        observation, _ = env.reset(seed=seed)
        rng = np.random.default_rng(seed)
        cloud = unpack_cloud(observation)
        proposals = propose(cloud, rng) if usable(cloud.points) else None
        chosen = np.empty(0, dtype=np.intp) if proposals is None else _chosen(proposals.score, grasps, rng)
        poses = np.tile(np.eye(4, dtype=np.float32), (grasps, 1, 1))
        context = np.zeros((grasps, len(CONTEXT)), dtype=np.float32)
        labels = np.zeros((grasps, len(LABELS)), dtype=np.float32)
        for k, index in enumerate(chosen):
            assert proposals is not None
            grasp = proposals.grasp(int(index))
            judgement = env.judge(grasp)
            poses[k], context[k] = gripper_pose(grasp), proposals.context[index]
            labels[k] = [getattr(judgement, name) for name in LABELS]
        rows.append((cloud.points, cloud.normals, poses, context, labels, np.arange(grasps) < len(chosen)))
    env.close()
    block = Labelled(*(np.stack(arrays) for arrays in zip(*rows, strict=True)))
    write_block(path, block)
    return path


def _chosen(score: NDArray, grasps: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """The best half by the analytic score, where decisions are made, and the rest at random from the others."""
    order = np.argsort(-score, kind="stable")
    best = order[: (grasps + 1) // 2]
    others = order[len(best) :]
    return np.concatenate([best, rng.permutation(others)[: grasps - len(best)]])


def write_block(path: Path, block: Labelled) -> None:
    """Write atomically, compressed; positions in half precision err by 0.1 mm at 0.25 m."""
    buffer = io.BytesIO()
    arrays = {name: getattr(block, name) for name in Labelled._fields}
    arrays["points"], arrays["normals"] = block.points.astype(np.float16), block.normals.astype(np.float16)
    np.savez_compressed(buffer, version=VERSION, **arrays)
    write_atomic(path, buffer.getvalue())


def read_block(path: Path) -> Labelled | None:
    """A block as written; None where there is none, or what is there is damaged."""
    try:
        with np.load(path, allow_pickle=False) as data:
            if int(data["version"]) != VERSION:
                return None
            arrays = {name: data[name] for name in Labelled._fields}
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile, zlib.error):
        return None
    except RuntimeError:  # flipped bits that zipfile takes for encryption, or for a compression that it does not know
        return None
    arrays["points"] = arrays["points"].astype(np.float32)
    arrays["normals"] = arrays["normals"].astype(np.float32)
    return Labelled(**arrays)
