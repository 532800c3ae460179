"""One training of a detector: its whole state, a step, validation, and going on after an interruption."""

from __future__ import annotations

import copy
import math
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from agents.checkpoint import DETECTOR_KIND, CheckpointError, load_checkpoint, save_checkpoint
from agents.detect_assign import PADDING, Targets
from agents.detect_augment import Frames, example
from agents.detect_evaluate_scores import DetectorScores, collect, score
from agents.detect_frames import FrameCache, Repeated, repeats
from agents.detect_loss import detection_loss
from agents.detect_torch import DETECT, load_detector, torch_detector
from agents.detect_train import BEST, LATEST, DetectTrainConfig
from agents.detect_train_parallel import ALONE, Shard, share_gradients
from agents.networks.detector import INPUTS, DetectorLayout, Network, build
from agents.provenance import provenance

TRAINING_KIND = f"{DETECTOR_KIND}-training"  # a card's, of a run's whole state


class Training:
    """A run.

    Args:
        config: the options.
        layout: of the network.
        cache: the training pictures.
        held_out: validation samples, an `agents.detect_dataset.DetectDataset`.
        folder: of the run.
        command: what to record in the card.
        shard: which part of every batch this process computes; the first one validates and saves.
    """

    def __init__(
        self,
        config: DetectTrainConfig,
        layout: DetectorLayout,
        cache: FrameCache,
        held_out: Any,
        folder: Path,
        command: list[str],
        shard: Shard = ALONE,
    ) -> None:
        cv2.setNumThreads(1)
        torch.set_num_threads(1)  # two threads on a busy machine are slower by an order of magnitude
        torch.manual_seed(config.seed)
        self.config, self.layout, self.held_out, self.folder = config, layout, held_out, folder
        self.pictures, self.shard = len(cache), shard
        times = repeats(cache.presence(len(layout.classes)), config.balance)
        self.frames: Frames = Repeated(cache, times)
        self.network = build(layout).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.average = copy.deepcopy(self.network).eval().requires_grad_(False)
        self.optimizer = torch.optim.AdamW(
            _groups(self.network, config.weight_decay), lr=config.learning_rate, fused=True
        )
        self.step, self.seconds, self.curve = 0, 0.0, []  # type: int, float, list[dict[str, float]]
        self.card: dict[str, Any] = {}
        self.initial: dict[str, Any] | None = None  # what the weights that it began with were trained by
        self._order: tuple[int, NDArray[np.int64]] = (-1, np.zeros(0, dtype=np.int64))
        self._facts = provenance(" ".join(command))

    def begin_with(self, path: str | Path) -> None:
        """Take the weights of another training of the same layout.

        Raises:
            CheckpointError: no detector's checkpoint, or another layout.
        """
        layout, tensors, card = load_detector(path)
        if layout != self.layout:
            raise CheckpointError(f"{path}: expected the layout {asdict(self.layout)}, got {asdict(layout)}")
        for network in (self.network, self.average):
            network.load_state_dict(tensors)
        self.initial = {name: card.get(name) for name in ("training", "pictures", "step", "provenance", "initial")}

    def run(self, progress: bool) -> dict[str, Any]:
        """Train to the last step; returns the best network's card.

        Raises:
            KeyboardInterrupt: after Ctrl-C, once the step is finished and the state is on disk.
        """
        from tqdm import tqdm

        bar = tqdm(total=self.config.steps, initial=self.step, unit="step", disable=None if progress else True)
        with _deferred_interrupt() as interrupted, bar:
            while self.step < self.config.steps:
                began = time.process_time()
                loss = self.advance()
                self.seconds += time.process_time() - began
                bar.update()
                bar.set_postfix_str(f"loss {loss:.3f}", refresh=False)
                if self.shard.rank:
                    continue
                if self.step % self.config.validate_every == 0 or self.step == self.config.steps:
                    self._validated(loss, progress)
                    self.save()
                if interrupted.is_set():
                    self.save()
                    raise KeyboardInterrupt
        return self.card

    def advance(self) -> float:
        """One step; returns its loss."""
        config, step = self.config, self.step
        images, targets = self.batch(step)
        torch.manual_seed(int(np.random.default_rng([config.seed, 2, step, self.shard.rank]).integers(2**62)))
        for group in self.optimizer.param_groups:
            group["lr"] = config.learning_rate * _rate(step, config.steps, config.warmup)
        self.network.train()
        with torch.autocast("cpu", torch.bfloat16):
            loss = detection_loss(self.network, images, targets)
        self.optimizer.zero_grad()
        loss.backward()
        share_gradients(self.network.parameters(), self.shard)
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), 10.0)
        self.optimizer.step()
        self.step += 1
        # The average follows more quickly while there is little to average.
        decay = config.averaging * (1.0 - math.exp(-self.step / 500.0))
        with torch.no_grad():
            for mine, theirs in zip(_tensors(self.average), _tensors(self.network), strict=True):
                mine.lerp_(theirs, 1.0 - decay) if mine.is_floating_point() else mine.copy_(theirs)
        if not math.isfinite(value := float(loss.detach())):
            raise FloatingPointError(f"loss: expected a number at step {self.step}, got {value}")
        return value

    def batch(self, step: int) -> tuple[Tensor, Targets]:
        """This process's pictures of a step and what is in them; they depend on the seed and the step alone."""
        config, count = self.config, len(self.frames)
        rng = np.random.default_rng([config.seed, 1, step, self.shard.rank])
        size, settings = config.size(step), config.augmentation(step)
        mine = config.batch // self.shard.processes
        first = step * config.batch + self.shard.rank * mine
        examples = [example(self.frames, self._picture(first + k, count), size, settings, rng) for k in range(mine)]
        channels = INPUTS[self.layout.input]
        pixels = np.stack([picture.image[..., :channels] for picture in examples])
        most = max(1, *(len(picture.labels) for picture in examples))
        boxes, labels = np.zeros((mine, most, 4), dtype=np.float32), np.full((mine, most), PADDING)
        for row, picture in enumerate(examples):
            boxes[row, : len(picture.labels)] = picture.boxes
            labels[row, : len(picture.labels)] = picture.labels
        images = torch.from_numpy(pixels).permute(0, 3, 1, 2)  # channels last, without a copy
        return images, Targets(torch.from_numpy(boxes), torch.from_numpy(labels))

    def _picture(self, position: int, count: int) -> int:
        """Every epoch goes through all pictures, in an order of its own."""
        epoch = position // count
        if self._order[0] != epoch:
            self._order = epoch, np.random.default_rng([self.config.seed, 3, epoch]).permutation(count)
        return int(self._order[1][position % count])

    def validate(self) -> DetectorScores:
        """The averaged network on the first validation pictures."""
        samples = (self.held_out[i] for i in range(min(self.config.validation_images, len(self.held_out))))
        return score(*collect(torch_detector(self.average, self.layout), samples), self.layout.classes)

    def _validated(self, loss: float, progress: bool) -> None:
        scores = self.validate()
        overall = scores.overall
        row = {"step": self.step, "loss": loss, **{name: overall[k] for k, name in enumerate(overall._fields[:3])}}
        self.curve.append({**row, "cpu_seconds": round(self.seconds, 1)})
        if progress:
            print(", ".join(f"{name} {value:.4g}" for name, value in self.curve[-1].items()), file=sys.stderr)
        if overall.map50 >= max(point["map50"] for point in self.curve):
            self.card = self._card() | {"validation_score": overall.map50, "threshold": scores.threshold}
            save_checkpoint(self.folder / BEST, self.average.state_dict(), self.card)
        self.card = {**self.card, "curve": self.curve}

    def _card(self) -> dict[str, Any]:
        return {
            "env_id": DETECT,
            "kind": DETECTOR_KIND,
            "layout": asdict(self.layout),
            "training": asdict(self.config),
            "pictures": self.pictures,
            "step": self.step,
            "curve": self.curve,
            "provenance": self._facts,
            "initial": self.initial,
        }

    def save(self) -> None:
        """The whole state, whole or not at all."""
        state = {f"network.{name}": value for name, value in self.network.state_dict().items()}
        state |= {f"average.{name}": value for name, value in self.average.state_dict().items()}
        for index, entry in self.optimizer.state_dict()["state"].items():
            state |= {f"optimizer.{index}.{name}": torch.as_tensor(value) for name, value in entry.items()}
        best = {key: value for key, value in self.card.items() if key != "curve"}
        facts = {"kind": TRAINING_KIND, "best": best, "cpu_seconds": self.seconds}
        save_checkpoint(self.folder / LATEST, state, {**self._card(), **facts})

    def restore(self, path: Path) -> None:
        """Go on where `save` was called.

        Raises:
            CheckpointError: no state of a training, or of one with other options.
        """
        checkpoint = load_checkpoint(path, DETECT)
        card = checkpoint.card
        if card.get("kind") != TRAINING_KIND:
            raise CheckpointError(f"{path}: expected a {TRAINING_KIND}, got {card.get('kind')!r}")
        wanted = {**asdict(self.config), "pictures": self.pictures, "classes": list(self.layout.classes)}
        had = {**card["training"], "pictures": card["pictures"], "classes": list(card["layout"]["classes"])}
        if different := [name for name, value in wanted.items() if had.get(name) != value]:
            raise CheckpointError(f"{path}: expected a run with the same options, got another {', '.join(different)}")
        tensors = {name: torch.from_numpy(np.array(value)) for name, value in checkpoint.tensors.items()}
        self.network.load_state_dict(_part(tensors, "network."))
        self.average.load_state_dict(_part(tensors, "average."))
        state: dict[int, dict[str, Tensor]] = {}
        parameters = [value for group in self.optimizer.param_groups for value in group["params"]]
        for name, value in _part(tensors, "optimizer.").items():
            index, key = name.split(".")
            # The fused optimiser wants its state laid out in memory as the weights are: channels last.
            placed = torch.empty_like(parameters[int(index)]).copy_(value) if value.ndim else value
            state.setdefault(int(index), {})[key] = placed.detach()
        self.optimizer.load_state_dict({**self.optimizer.state_dict(), "state": state})
        self.step, self.curve, self.seconds = int(card["step"]), card["curve"], float(card["cpu_seconds"])
        self.initial = card.get("initial")
        self.card = {**card["best"], "curve": self.curve} if card["best"] else {}


def _groups(network: Network, decay: float) -> list[dict[str, Any]]:
    """Weights of convolutions decay; offsets and normalisations do not."""
    weights = [value for value in network.parameters() if value.ndim > 1]
    others = [value for value in network.parameters() if value.ndim <= 1]
    return [{"params": weights, "weight_decay": decay}, {"params": others, "weight_decay": 0.0}]


def _tensors(network: Network) -> list[Tensor]:
    return [*network.parameters(), *network.buffers()]


def _part(tensors: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {name.removeprefix(prefix): value for name, value in tensors.items() if name.startswith(prefix)}


def _rate(step: int, steps: int, warmup: int) -> float:
    """Share of the learning rate: linear at first, then half a cosine to a hundredth."""
    cosine = 0.505 + 0.495 * math.cos(math.pi * step / steps)
    return cosine * min(1.0, (step + 1) / max(warmup, 1))


@contextmanager
def _deferred_interrupt() -> Iterator[threading.Event]:
    """Ctrl-C sets an event, so that a step is finished first; elsewhere than in the main thread it stays as it is."""
    event = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield event
        return
    before = signal.signal(signal.SIGINT, lambda *_: event.set())
    try:
        yield event
    finally:
        signal.signal(signal.SIGINT, before)
