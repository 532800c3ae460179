"""What every reproduction gives: a text, the same as data, and perhaps a picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from agents.seeds import TEST_SEED


@dataclass(frozen=True)
class Request:
    """What was asked for."""

    seed: int = TEST_SEED  # episode k resets with seed + k
    episodes: int | None = None  # None: as many as the published figure asks for
    picture: bool = False


@dataclass(frozen=True)
class Reproduction:
    """What came of it."""

    text: str
    data: dict[str, Any] = field(default_factory=dict)
    picture: bytes | None = None  # PNG


def text_table(rows: Sequence[Sequence[str]], left: int = 2) -> str:
    """Aligned lines: the first row is the head, the first `left` columns are flush left."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = [
        "  ".join(
            cell.ljust(width) if i < left else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]
    rule = "─" * max(map(len, lines))
    return "\n".join([lines[0], rule, *lines[1:], rule])
