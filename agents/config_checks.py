"""What the numbers of a training's options must be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

MAY_BE_ZERO = ("seed", "weight_decay")


def check_numbers(config: Any, skip: Sequence[str] = ()) -> None:
    """See that every field of a dataclass is a number as its default is: whole or not, and positive or at least 0.

    Args:
        skip: fields that are something else.

    Raises:
        ValueError: one is not, by its name.
    """
    for field in fields(config):
        if field.name in skip:
            continue
        value = getattr(config, field.name)
        whole = isinstance(field.default, int)
        least = 0 if field.name in MAY_BE_ZERO else 1 if whole else 1e-12
        fits = isinstance(value, int if whole else int | float) and not isinstance(value, bool)
        if not fits or not least <= value < 2**32:
            raise ValueError(f"{field.name}: expected a {'whole ' * whole}number of at least {least}, got {value!r}")
