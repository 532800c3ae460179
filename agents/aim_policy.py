"""`grasp-dls` that is aimed by a network which has learned what comes of grasps: loading it from a checkpoint."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from aerograsp_env.sim.arms.vehicles import BELEROFONTE_ARMS
from agents.aim_choice import OUTCOMES, QUANTILES, AimPlanner, Outcomes, aimed
from agents.aim_features import NAMES
from agents.bench_setup import GRASP
from agents.checkpoint import AIM_KIND, CheckpointError, load_checkpoint
from baselines.grasping.reaching import GraspPlanner
from baselines.policies.grasp import GraspPolicy


def load_aim_policy(path: str | Path) -> GraspPolicy:
    """A policy from what `aerograsp train aerograsp/Grasp-v0 --algorithm aim` exported.

    Raises:
        CheckpointError: not a whole checkpoint of this kind, or made for other features.
    """
    checkpoint = load_checkpoint(path, GRASP)
    card, tensors = checkpoint.card, checkpoint.tensors
    if card.get("kind") != AIM_KIND:
        raise CheckpointError(f"{path}: expected a {AIM_KIND}, got {card.get('kind')!r}")
    if card.get("features") != list(NAMES) or card.get("outcomes") != list(OUTCOMES):
        raise CheckpointError(f"{path}: expected the features and outcomes of this version, got others")
    try:
        members, hidden = int(card["members"]), [int(width) for width in card["hidden"]]
    except (KeyError, TypeError, ValueError) as error:
        raise CheckpointError(f"{path}: the card does not say how the network is wired ({error!r})") from None
    for name, shape in aim_shapes(members, hidden).items():
        if name not in tensors or tensors[name].shape != shape:
            raise CheckpointError(f"{path}: expected a tensor {name!r} of shape {shape}")
    planner = GraspPlanner(BELEROFONTE_ARMS.with_active(["right"]), "right")
    return aimed(AimPlanner(planner, Outcomes(tensors), tensors["error.lengths"].astype(np.float64)))


def aim_shapes(members: int, hidden: list[int]) -> dict[str, tuple[int, ...]]:
    """Name and shape of every tensor."""
    widths = [len(NAMES), *hidden, len(OUTCOMES)]
    shapes: dict[str, tuple[int, ...]] = {"input.mean": (len(NAMES),), "input.scale": (len(NAMES),)}
    shapes["error.lengths"] = (QUANTILES,)
    for k in range(len(hidden) + 1):
        shapes[f"layer.{k}.weight"] = (members, widths[k], widths[k + 1])
        shapes[f"layer.{k}.bias"] = (members, 1, widths[k + 1])
    return shapes
