"""Grasps kept on disk by the content of what they were made from, so that equal objects share them."""

from __future__ import annotations

import hashlib
import json
import os
import sys
import tempfile
import warnings
import zipfile
import zlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.grasping.candidates import SHAPES, GraspCandidates

VARIABLE = "AEROGRASP_CACHE"
FORMAT = 1
"""Of the files: part of every key."""


def default_folder() -> Path:
    """$AEROGRASP_CACHE, or else the platform's folder for caches."""
    if given := os.environ.get(VARIABLE):
        return Path(given)
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "aerograsp"


class GraspCache:
    """A folder of candidates, one .npz file a key. Nothing in it is trusted: what cannot be read is made anew.

    Args:
        folder: made when first written to; None is `default_folder()`.
    """

    def __init__(self, folder: str | Path | None = None) -> None:
        self.folder = default_folder() if folder is None else Path(folder)

    def __repr__(self) -> str:
        return f"GraspCache({str(self.folder)!r})"

    def key(self, version: str, arrays: Iterable[NDArray[Any]], parameters: Mapping[str, Any]) -> str:
        """SHA-256 over all that the result depends on, as hexadecimal digits."""
        digest = hashlib.sha256(json.dumps([FORMAT, version, parameters], sort_keys=True).encode())
        for array in arrays:
            plain = np.ascontiguousarray(array)
            digest.update(f"{plain.dtype.str}{plain.shape}".encode())
            digest.update(plain.tobytes())
        return digest.hexdigest()

    def path(self, key: str) -> Path:
        """The file of a key."""
        return self.folder / f"{key}.npz"

    def load(self, key: str) -> GraspCandidates | None:
        """What was stored, or None; a file that is damaged or not as it should be is warned of, and counts as none."""
        path = self.path(key)
        if not path.is_file():
            return None
        try:
            with np.load(path, allow_pickle=False) as archive:
                if str(archive["key"]) != key:
                    raise ValueError("stored under another key")
                content: dict[str, Any] = {name: archive[name] for name in SHAPES}
                for name in ("reasons", "counts"):
                    names, values = archive[f"{name}_names"].tolist(), archive[f"{name}_values"].tolist()
                    content[name] = dict(zip(names, values, strict=True))
            return GraspCandidates(**content)
        except (OSError, EOFError, KeyError, ValueError, TypeError, zipfile.BadZipFile, zlib.error) as error:
            warnings.warn(f"cache: {path.name} is of no use and is made anew ({error})", RuntimeWarning, stacklevel=3)
            return None

    def store(self, key: str, candidates: GraspCandidates) -> None:
        """Write all of it under a temporary name, then rename; a folder that cannot be written to is warned of."""
        content: dict[str, Any] = {name: getattr(candidates, name) for name in SHAPES}
        for name in ("reasons", "counts"):
            tally = getattr(candidates, name)
            content[f"{name}_names"] = np.array(list(tally), dtype=np.str_)
            content[f"{name}_values"] = np.array(list(tally.values()), dtype=np.int64)
        temporary: Path | None = None
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            handle, name = tempfile.mkstemp(dir=self.folder, prefix=".", suffix=".npz")
            temporary = Path(name)
            with os.fdopen(handle, "wb") as file:
                np.savez_compressed(file, key=np.array(key), **content)
            temporary.replace(self.path(key))
        except OSError as error:
            warnings.warn(f"cache: could not write to {self.folder} ({error})", RuntimeWarning, stacklevel=3)
        finally:
            if temporary is not None:
                temporary.unlink(missing_ok=True)
