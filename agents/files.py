"""Files that are whole or absent: written under a temporary name beside the target, then renamed."""

import json
import math
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np


def write_atomic(path: str | Path, content: str | bytes) -> Path:
    """Write a file so that a reader, or an interruption, never meets half of it. Returns its path.

    Raises:
        OSError: the folder does not exist or cannot be written.
    """
    target = Path(path)
    data = content.encode() if isinstance(content, str) else content
    handle, temporary = tempfile.mkstemp(prefix=f".{target.name}.", suffix=".tmp", dir=target.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        umask = os.umask(0)
        os.umask(umask)
        Path(temporary).chmod(0o666 & ~umask)  # mkstemp makes it private
        Path(temporary).replace(target)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
    return target


def to_json(value: Any) -> Any:
    """Plain JSON values: arrays become lists, NaN and infinities null (JSON has neither)."""
    if isinstance(value, dict):
        return {str(key): to_json(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return to_json(value.tolist())
    if isinstance(value, list | tuple | range):
        return [to_json(item) for item in value]
    if isinstance(value, np.generic):
        return to_json(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, Path):
        return str(value)
    raise ValueError(f"value: expected something that JSON can hold, got {type(value).__name__}")


def dumps(value: Any) -> str:
    """Indented, strictly valid JSON with a newline at its end."""
    return json.dumps(to_json(value), indent=2, allow_nan=False) + "\n"


def write_json(path: str | Path, value: Any) -> None:
    """Write `value` as JSON, atomically; `-` writes to standard output."""
    if str(path) == "-":
        sys.stdout.write(dumps(value))
    else:
        write_atomic(path, dumps(value))


def writable_folder(path: str | Path) -> Path:
    """Make the folder and prove that it takes a file, before any work is done for it.

    Raises:
        OSError: it cannot be made or written.
    """
    folder = Path(path)
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryFile(dir=folder):
        return folder
