"""Fitting the grasp scorer to labelled grasps; the state of the training is on disk after every epoch."""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from agents.checkpoint import SCORER_KIND, CheckpointError, load_checkpoint, save_checkpoint
from agents.grasp_dataset import GRASP_PLAN, LABELS, Labelled
from agents.networks.grasp_scorer import GraspScorer, ScorerLayout
from agents.provenance import provenance

if TYPE_CHECKING:
    from agents.grasp_training import GraspTrainConfig

TRAINING_KIND = f"{SCORER_KIND}-training"  # a card's, of a run's whole state


def fit(
    config: GraspTrainConfig,
    data: Labelled,
    held_out: Labelled,
    folder: Path,
    resume: bool,
    export: str | Path | None,
    progress: bool,
    command: list[str],
) -> dict[str, Any]:
    """Train by the binary cross-entropy of both labels; returns the card of the network with the least validation loss.

    Raises:
        CheckpointError: what is to be resumed is no training of this network, or had other options.
        ValueError: no labelled grasps.
    """
    from tqdm import tqdm

    from agents.grasp_training import BEST, LATEST, standardisation

    if not data.valid.any() or not held_out.valid.any():
        raise ValueError("views: expected some that have labelled grasps, got none")
    torch.manual_seed(config.seed)
    layout = ScorerLayout(context=data.context.shape[-1])
    network = GraspScorer(layout)
    mean, scale = standardisation(data.context, data.valid)
    network.context_mean.copy_(torch.as_tensor(mean))
    network.context_scale.copy_(torch.as_tensor(scale))
    optimizer = torch.optim.AdamW(network.parameters(), config.learning_rate, weight_decay=config.weight_decay)
    views, slots = np.nonzero(data.valid)
    steps = config.epochs * -(-len(views) // config.batch_size)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer,
        config.learning_rate,
        total_steps=steps,
        pct_start=0.05 if steps > 20 else 0.0,  # a warm-up of less than a step would divide by nothing
        anneal_strategy="cos",
    )
    curve: list[dict[str, float]] = []
    first = 0
    settings = {**asdict(config), "layout": list(layout)}
    if resume and (folder / LATEST).exists():
        first, curve = _restore(folder / LATEST, settings, network, optimizer, schedule)
    facts = provenance(" ".join(command))
    card: dict[str, Any] = {}
    if curve:
        card = load_checkpoint(folder / BEST, GRASP_PLAN).card
    bar = tqdm(range(first, config.epochs), desc="epochs", unit="epoch", disable=None if progress else True)
    for epoch in bar:
        rng = np.random.default_rng([config.seed, epoch])  # an epoch's order depends on nothing before it
        order = rng.permutation(len(views))
        network.train()
        total = 0.0
        for start in range(0, len(order), config.batch_size):
            rows = order[start : start + config.batch_size]
            batch = batch_of(data, views[rows], slots[rows], layout, rng)
            loss = _loss(network(*batch), data, views[rows], slots[rows])
            optimizer.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
            optimizer.step()
            schedule.step()
            total += loss.item() * len(rows)
        row = {"epoch": epoch + 1, "loss": total / len(order), **validate(network, held_out)}
        curve.append(row)
        line = ", ".join(f"{name} {value:.4g}" for name, value in row.items())
        if progress:
            print(line, file=sys.stderr)
        shared = {
            "env_id": GRASP_PLAN,
            "kind": SCORER_KIND,
            "scorer": layout._asdict(),
            "training": settings,
            "curve": curve,
            "provenance": facts,
            "validation_loss": row["validation_loss"],
            "validation_error": 1.0 - row["top_strict"],
        }
        if row["validation_loss"] <= min(point["validation_loss"] for point in curve):
            card = shared
            save_checkpoint(folder / BEST, network.state_dict(), card)
        save_checkpoint(folder / LATEST, _state(network, optimizer), {**shared, "kind": TRAINING_KIND})
    card = {**card, "curve": curve}
    if export is not None:  # also where a resumed run had its best epoch before
        save_checkpoint(export, load_checkpoint(folder / BEST, GRASP_PLAN).tensors, card)
    return card


def batch_of(
    data: Labelled, views: Any, slots: Any, layout: ScorerLayout, rng: np.random.Generator | None
) -> tuple[Tensor, Tensor, Tensor]:
    """Points and normals in the gripper's frame, and context, of B grasps; with `rng`, augmented.

    The two fingers are alike: half of the grasps are turned by π about their approach axis.
    """
    pose = data.poses[views, slots]
    rotation = pose[:, :3, :3]
    total = data.points.shape[1]
    if rng is None:
        columns = np.arange(layout.points) * total // layout.points
        points, normals = data.points[views][:, columns], data.normals[views][:, columns]
    else:
        rotation = rotation * np.where(rng.random((len(pose), 1, 1)) < 0.5, 1.0, np.array([-1.0, -1.0, 1.0]))
        columns = rng.integers(0, total, (len(pose), layout.points))
        rows = np.asarray(views)[:, None]
        points, normals = data.points[rows, columns], data.normals[rows, columns]
    positions = (points - pose[:, None, :3, 3]) @ rotation
    return (
        torch.from_numpy(positions.astype(np.float32)),
        torch.from_numpy((normals @ rotation).astype(np.float32)),
        torch.from_numpy(data.context[views, slots]),
    )


def _loss(logits: Tensor, data: Labelled, views: Any, slots: Any) -> Tensor:
    return torch.nn.functional.binary_cross_entropy_with_logits(logits, torch.from_numpy(data.labels[views, slots]))


@torch.no_grad()
def validate(network: GraspScorer, data: Labelled) -> dict[str, float]:
    """Loss on labelled grasps of other families, and the rates at which each view's best-scored grasp held."""
    network.eval()
    views, slots = np.nonzero(data.valid)
    logits = torch.cat(
        [
            network(*batch_of(data, views[part], slots[part], network.layout, None))
            for part in np.array_split(np.arange(len(views)), -(-len(views) // 512))
        ]
    )
    score = np.full(data.valid.shape, -np.inf)
    score[views, slots] = logits.sigmoid().mean(dim=1).numpy()
    some = np.flatnonzero(data.valid.any(axis=1))
    top = data.labels[some, score[some].argmax(axis=1)]
    rates = {f"top_{name}": float(rate) for name, rate in zip(LABELS, top.mean(axis=0), strict=True)}
    return {"validation_loss": float(_loss(logits, data, views, slots)), **rates}


def _state(network: GraspScorer, optimizer: torch.optim.Optimizer) -> dict[str, Tensor]:
    state = {f"network.{name}": value for name, value in network.state_dict().items()}
    for index, entry in optimizer.state_dict()["state"].items():
        state |= {f"optimizer.{index}.{name}": torch.as_tensor(value) for name, value in entry.items()}
    return state


def _restore(
    path: Path, settings: dict[str, Any], network: GraspScorer, optimizer: torch.optim.Optimizer, schedule: Any
) -> tuple[int, list[dict[str, float]]]:
    """Epochs done and the curve, with network, optimiser and schedule as they were."""
    checkpoint = load_checkpoint(path, GRASP_PLAN)
    if checkpoint.card.get("kind") != TRAINING_KIND:
        raise CheckpointError(f"{path}: expected a {TRAINING_KIND}, got {checkpoint.card.get('kind')!r}")
    before = checkpoint.card["training"]
    if different := [name for name in settings if _plain(before.get(name)) != _plain(settings[name])]:
        raise CheckpointError(f"{path}: expected a run with the same options, got another {', '.join(different)}")
    tensors = {name: torch.from_numpy(np.array(value)) for name, value in checkpoint.tensors.items()}
    network.load_state_dict(
        {name.removeprefix("network."): value for name, value in tensors.items() if name.startswith("network.")}
    )
    state: dict[int, dict[str, Tensor]] = {}
    for name, value in tensors.items():
        if name.startswith("optimizer."):
            _, index, key = name.split(".")
            state.setdefault(int(index), {})[key] = value
    optimizer.load_state_dict({**optimizer.state_dict(), "state": state})
    curve = checkpoint.card["curve"]
    steps = int(next(iter(state.values()))["step"])
    schedule.load_state_dict({**schedule.state_dict(), "last_epoch": steps - 1, "_step_count": steps})
    schedule.step()  # sets the optimiser's rates, which follow from the number of steps alone
    return len(curve), curve


def _plain(value: Any) -> Any:
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value
