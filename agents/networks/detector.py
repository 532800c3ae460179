"""The three families of detectors behind one description."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from torch import nn

from agents.networks.detector_parts import Widths
from agents.networks.detector_ssd import Ssd
from agents.networks.detector_two_stage import TwoStage
from agents.networks.detector_yolo import Yolo

FAMILIES: dict[str, type[Yolo] | type[Ssd] | type[TwoStage]] = {"yolo": Yolo, "ssd": Ssd, "two-stage": TwoStage}
INPUTS = {"rgb": 3, "rgbd": 4}
"""Channels of each kind of input."""
Network = Yolo | Ssd | TwoStage


@dataclass(frozen=True)
class DetectorLayout:
    """What a network is made of; with the weights, everything that inference needs.

    Raises:
        ValueError: no such family or input, no classes, or widths that are not positive.
    """

    classes: tuple[str, ...]
    family: str = "yolo"  # yolo, ssd or two-stage
    input: str = "rgbd"  # rgb, or rgbd with inverse depth as a fourth channel
    stages: tuple[int, ...] = Widths().stages
    pyramid: int = Widths().pyramid

    def __post_init__(self) -> None:
        for name, value, known in (("family", self.family, FAMILIES), ("input", self.input, INPUTS)):
            if value not in known:
                raise ValueError(f"{name}: expected one of {', '.join(known)}, got {value!r}")
        if not self.classes or len(set(self.classes)) != len(self.classes):
            raise ValueError(f"classes: expected different names, at least one, got {list(self.classes)}")
        if len(self.stages) != 5 or min(*self.stages, self.pyramid) < 2:
            raise ValueError(f"stages, pyramid: expected five widths and one, each at least 2, got {asdict(self)}")

    @classmethod
    def from_card(cls, card: Mapping[str, Any]) -> DetectorLayout:
        """Read the "layout" of a card. Raises ValueError where it is none."""
        try:
            layout = dict(card["layout"])
            tuples = {"classes": tuple(map(str, layout["classes"])), "stages": tuple(map(int, layout["stages"]))}
            return cls(**{**layout, **tuples})
        except (KeyError, TypeError) as error:
            raise ValueError(f"the card's \"layout\" is not a detector's ({error!r})") from None


def build(layout: DetectorLayout) -> Network:
    """An untrained network; weights are drawn from torch's generator."""
    stages = layout.stages
    widths = Widths((stages[0], stages[1], stages[2], stages[3], stages[4]), layout.pyramid)
    network = FAMILIES[layout.family](INPUTS[layout.input], len(layout.classes), widths)
    for module in network.modules():
        if isinstance(module, nn.Conv2d) and module.bias is None:
            nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
    return network
