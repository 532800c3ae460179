"""What every reproduction gives: a text, the same as data, and perhaps a picture."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from agents.seeds import TEST_SEED

DATA_VARIABLE = "AEROGRASP_DATA"


@dataclass(frozen=True)
class Request:
    """What was asked for."""

    seed: int = TEST_SEED  # episode k resets with seed + k
    episodes: int | None = None  # None: as many as the published figure asks for
    picture: bool = False
    data: str | None = None  # folder of real data; see `data_folder`


@dataclass(frozen=True)
class Reproduction:
    """What came of it."""

    text: str
    data: dict[str, Any] = field(default_factory=dict)
    picture: bytes | None = None  # PNG


def data_folder(named: str | None = None) -> Path:
    """Where data sets lie: the folder named, else `AEROGRASP_DATA`, else `shared/data` beside the checkout.

    Raises:
        FileNotFoundError: a folder was named, and there is none.
    """
    if named is not None and not Path(named).is_dir():
        raise FileNotFoundError(f"--data: no folder {named}")
    named = named or os.environ.get(DATA_VARIABLE)
    return Path(named) if named else Path(__file__).resolve().parents[2] / "shared" / "data"


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
