"""The learned grasp planner: candidates of the analytic one, chosen by a network that has learned which hold."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from aerograsp_env.envs.grasp_plan import Cloud
from aerograsp_env.interfaces import Grasp
from aerograsp_env.sim.gripper import gripper_pose
from agents.checkpoint import SCORER_KIND, CheckpointError, load_checkpoint
from agents.grasp_dataset import GRASP_PLAN, Labelled
from agents.networks.grasp_scorer import GraspScorer, ScorerLayout
from baselines.grasping.planning import Proposals
from baselines.policies.grasp_plan import CONTEXT, GraspPolicy, planner

SCORED = 96
"""Candidates that the network looks at, the best of the analytic ranking: it is to decide within 200 ms."""


class LearnedPlan:
    """One network's choice among the candidates of `planner("gpis")`.

    Args:
        network: trained.
    """

    def __init__(self, network: GraspScorer) -> None:
        self.network = network.eval()
        self.propose = planner("gpis")

    def __call__(self, cloud: Cloud, rng: np.random.Generator) -> Grasp | None:
        proposals = self.propose(cloud, rng)
        return proposals.grasp(int(np.argmax(self.score(cloud, proposals)))) if len(proposals) else None

    @torch.no_grad()
    def score(self, cloud: Cloud, proposals: Proposals) -> NDArray[np.float64]:
        """(min(G, SCORED),) mean of the probabilities of being held and of being held strictly."""
        from agents.networks.grasp_fit import batch_of

        count = min(len(proposals), SCORED)
        poses = np.stack([gripper_pose(proposals.grasp(index)) for index in range(count)])
        view = Labelled(
            cloud.points[None].astype(np.float32),
            cloud.normals[None].astype(np.float32),
            poses[None].astype(np.float32),
            proposals.context[None, :count].astype(np.float32),
            np.zeros((1, count, 2), dtype=np.float32),
            np.ones((1, count), dtype=np.bool_),
        )
        rows = np.arange(count)
        logits = self.network(*batch_of(view, np.zeros_like(rows), rows, self.network.layout, None))
        return logits.sigmoid().mean(dim=1).numpy().astype(np.float64)


def load_grasp_policy(path: str | Path) -> GraspPolicy:
    """A policy from what `aerograsp train aerograsp/GraspPlan-v0` exported.

    Raises:
        CheckpointError: not a whole checkpoint of a grasp scorer, or made for other candidates.
    """
    checkpoint = load_checkpoint(path, GRASP_PLAN)
    if checkpoint.card.get("kind") != SCORER_KIND:
        raise CheckpointError(f"{path}: expected a {SCORER_KIND}, got {checkpoint.card.get('kind')!r}")
    try:
        layout = layout_of(checkpoint.card["scorer"])
        network = GraspScorer(layout)
        network.load_state_dict({name: torch.from_numpy(array) for name, array in checkpoint.tensors.items()})
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise CheckpointError(f"{path}: the weights do not fit the card ({str(error).splitlines()[0]})") from None
    if (count := layout.context) != len(CONTEXT):
        raise CheckpointError(f"{path}: expected {len(CONTEXT)} context values as the planner has, got {count}")
    return GraspPolicy(LearnedPlan(network))


def layout_of(card: Mapping[str, Any]) -> ScorerLayout:
    """The sizes on a card."""
    widths = {name: tuple(int(width) for width in card[name]) for name in ("point_widths", "head_widths")}
    return ScorerLayout(int(card["context"]), int(card["points"]), length=float(card["length"]), **widths)
