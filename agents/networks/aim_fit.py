"""Fitting the outcomes of aimed grasps to flights: an ensemble of small perceptrons, all at once."""

from __future__ import annotations

import itertools
import math
import sys
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from agents.aim_choice import OUTCOMES, QUANTILES
from agents.aim_dataset import Attempts
from agents.aim_features import grasp_features
from baselines.grasping.scenes import Scene

if TYPE_CHECKING:
    from agents.aim_training import AimConfig

JITTER = 0.003  # [m] of the displacements, in copies: the estimate wanders about its bias


def inputs(data: Attempts, copies: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """(2, copies, N, F): where the tool was sent, and where it was; the first copy has no jitter."""
    rows: list[NDArray[np.float64]] = []
    for k in range(len(data.outcome)):
        cloud = data.cloud[k].astype(np.float64)
        scene = Scene(data.T_level_object[k], cloud[:, :3], cloud[:, 3:], data.support[k, 0], data.support[k, 1])
        T, score = data.T_object_grasp[k], float(data.score[k])
        width, opening = (float(length) for length in data.jaws[k])
        off = data.bias[k] @ (scene.T_level_object[:3, :3] @ T[:3, :3])
        jitter = JITTER * rng.standard_normal((copies, 3))
        jitter[0] = 0.0
        parts = [
            grasp_features(scene, T, width, opening, score, off + moved + jitter, measured)
            for moved, measured in ((np.zeros(3), False), (data.moved[k], True))
        ]
        rows.append(np.stack(parts))
    return np.stack(rows, axis=2)


def fit(
    config: AimConfig, data: Attempts, held_out: Attempts, progress: bool = False
) -> tuple[dict[str, NDArray[np.float32]], list[dict[str, float]]]:
    """The tensors that `aim_choice.Outcomes` takes, of the epoch with the least loss on `held_out`; and the curve.

    Raises:
        ValueError: flights without attempts.
    """
    if not len(data.outcome) or not len(held_out.outcome):
        raise ValueError("episodes: expected some with attempts that came to an end, got none")
    torch.manual_seed(config.seed)
    rng = np.random.default_rng(config.seed)
    x = inputs(data, config.copies, rng)
    flat = x.reshape(-1, x.shape[-1])
    mean, scale = flat.mean(axis=0), np.maximum(flat.std(axis=0), 1e-4)
    train_x, train_y = _tensor((x - mean) / scale), torch.as_tensor(data.outcome)
    test_x = _tensor((inputs(held_out, 1, rng)[:, 0] - mean) / scale)
    test_y = torch.as_tensor(held_out.outcome)
    # each member knows episodes by weights of its own (the Bayesian bootstrap, Rubin 1981)
    seeds, episode = np.unique(data.episode, return_inverse=True)
    weights = _tensor(rng.exponential(size=(config.members, len(seeds)))[:, episode])
    layers = _layers(config, x.shape[-1])
    optimizer = torch.optim.AdamW(
        [p for layer in layers for p in layer], config.learning_rate, weight_decay=config.weight_decay
    )
    count, batches = len(train_y), math.ceil(len(train_y) / config.batch_size)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, config.epochs * batches)
    curve: list[dict[str, float]] = []
    best: list[Tensor] = []
    for epoch in range(config.epochs):
        total = 0.0
        order = torch.randperm(count)
        for rows in order.split(config.batch_size):
            kinds, copies = torch.randint(2, (len(rows),)), torch.randint(config.copies, (len(rows),))
            logits = _forward(layers, train_x[kinds, copies, rows])
            wanted = train_y[rows].expand(config.members, -1)
            losses = torch.nn.functional.cross_entropy(logits.transpose(1, 2), wanted, reduction="none")
            loss = (losses * weights[:, rows]).mean()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
            total += loss.item() * len(rows)
        with torch.no_grad():
            chances = _forward(layers, test_x.reshape(-1, test_x.shape[-1])).softmax(-1).mean(0)
        wanted = test_y.repeat(2)
        loss_held_out = float(torch.nn.functional.nll_loss(chances.clamp_min(1e-6).log(), wanted))
        right = float((chances.argmax(-1) == wanted).float().mean())
        curve.append({"epoch": epoch, "loss": total / count, "validation_loss": loss_held_out, "right": right})
        if loss_held_out <= min(row["validation_loss"] for row in curve):
            best = [p.detach().clone() for layer in layers for p in layer]
    if progress:
        row = min(curve, key=lambda row: row["validation_loss"])
        print(f"epoch {row['epoch']}: validation loss {row['validation_loss']:.4f}", file=sys.stderr)
    _, first = np.unique(data.episode, return_index=True)
    lengths = np.quantile(np.linalg.norm(data.bias[first], axis=1), np.linspace(0.0, 1.0, QUANTILES))
    tensors = {"input.mean": mean, "input.scale": scale, "error.lengths": lengths}
    for k in range(len(layers)):
        tensors |= {f"layer.{k}.weight": best[2 * k].numpy(), f"layer.{k}.bias": best[2 * k + 1].numpy()}
    return {name: np.asarray(value, dtype=np.float32) for name, value in tensors.items()}, curve


def _tensor(values: NDArray[Any]) -> Tensor:
    return torch.as_tensor(np.clip(values, -5.0, 5.0), dtype=torch.float32)


def _layers(config: AimConfig, size: int) -> list[tuple[Tensor, Tensor]]:
    """Weights (M, in, out) and biases (M, 1, out); He et al. 2015."""
    widths, layers = (size, *config.hidden, len(OUTCOMES)), []
    for before, after in itertools.pairwise(widths):
        weight = torch.randn(config.members, before, after) * math.sqrt(2.0 / before)
        layers.append((weight.requires_grad_(), torch.zeros(config.members, 1, after, requires_grad=True)))
    return layers


def _forward(layers: list[tuple[Tensor, Tensor]], x: Tensor) -> Tensor:
    """Logits (M, B, 4) of (B, F)."""
    out = x[None]
    for k, (weight, bias) in enumerate(layers):
        out = out @ weight + bias
        if k < len(layers) - 1:
            out = torch.relu(out)
    return out
