"""What the entries of an action mean."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ActionDimension:
    """One entry of the action: what a full action (1.0) means."""

    name: str
    scale: float
    unit: str
    frame: str
