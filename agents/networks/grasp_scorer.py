"""A network that scores grasps from the points seen about them.

Points and normals are given in the gripper's frame, one after another through shared layers and a maximum (Qi et al.
2017, "PointNet"; Liang et al. 2019, "PointNetGPD"), beside what the analytic planner knows of each grasp.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor, nn

OUTPUTS = ("held", "strict")


class ScorerLayout(NamedTuple):
    """What the network is made of; with the weights, everything that inference needs."""

    context: int  # numbers beside the points
    points: int = 192  # of the cloud that it looks at
    point_widths: tuple[int, ...] = (48, 96, 160)
    head_widths: tuple[int, ...] = (128, 64)
    length: float = 0.05  # [m] that positions are divided by


class GraspScorer(nn.Module):
    """Logits of being held, and of being held strictly.

    Args:
        layout: the sizes.
    """

    context_mean: Tensor  # (F,) of the training's grasps
    context_scale: Tensor  # (F,)

    def __init__(self, layout: ScorerLayout) -> None:
        super().__init__()
        self.layout = layout
        self.points = _perceptron((7, *layout.point_widths))
        width = 2 * layout.point_widths[-1] + layout.context
        self.head = nn.Sequential(
            _perceptron((width, *layout.head_widths)), nn.Linear(layout.head_widths[-1], len(OUTPUTS))
        )
        self.register_buffer("context_mean", torch.zeros(layout.context))
        self.register_buffer("context_scale", torch.ones(layout.context))

    def forward(self, positions: Tensor, normals: Tensor, context: Tensor) -> Tensor:
        """(B, 2) logits.

        Args:
            positions: (B, P, 3) in the gripper's frame [m].
            normals: (B, P, 3) in the gripper's frame.
            context: (B, F).
        """
        near = positions / self.layout.length
        distance = near.norm(dim=-1, keepdim=True)
        per_point = self.points(torch.cat([torch.tanh(near), normals, torch.exp(-distance)], dim=-1))
        # Beside the strongest answer anywhere the mean about the gripper: how much there is, not only whether.
        weight = torch.exp(-distance)
        mean = (per_point * weight).sum(dim=1) / (weight.sum(dim=1) + 1e-3)
        known = ((context - self.context_mean) / self.context_scale).clamp(-5.0, 5.0)
        return self.head(torch.cat([per_point.amax(dim=1), mean, known], dim=-1))


def _perceptron(widths: tuple[int, ...]) -> nn.Sequential:
    layers: list[nn.Module] = []
    for before, after in pairwise(widths):
        layers += [nn.Linear(before, after), nn.ReLU()]
    return nn.Sequential(*layers)
