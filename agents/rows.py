"""Measured rows of a comparison, kept in its folder.

Every finished row lies there under a key of all that it depends on (policy, weights, settings, version, commit,
sources), so that an interrupted comparison goes on where it stopped.
"""

import hashlib
import importlib.util
import json
import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from agents.evaluation import EvaluationResult, evaluate
from agents.files import to_json, write_json
from agents.policies import PolicyUnavailable, checkpoints, load_policy


@dataclass(frozen=True)
class RowStore:
    """The rows of one folder, measured on the same episodes with one state of the sources."""

    folder: Path
    env_id: str
    episodes: int
    seed: int  # of episode 0
    provenance: Mapping[str, Any]
    fresh: bool = False  # measure rows again that are there already
    progress: bool = True  # a bar a row on a terminal, a line a row on standard error
    sources: str = field(default_factory=lambda: _sources())

    def row(self, name: str, policy: Any, env_kwargs: Mapping[str, Any], label: str = "") -> EvaluationResult:
        """The result of one policy under these options of the environment, measured if it is not there yet."""
        key = {
            "id": self.env_id,
            "policy": name,
            "episodes": self.episodes,
            "seed": self.seed,
            "env_kwargs": env_kwargs,
            "content": content_hash(self.env_id, name),
            "commit": self.provenance["commit"],
            "sources": self.sources,
            "version": self.provenance["versions"].get("aerograsp", ""),
        }
        result, kept = stored(self.folder, key), True
        if result is None or self.fresh:
            measured = evaluate(self.env_id, policy, self.episodes, self.seed, env_kwargs, self.progress)
            result, kept = replace(measured, policy=name), False
            store(self.folder, key, result)
        if self.progress:
            print(f"{label or name}: {'kept from an earlier run' if kept else 'done'}", file=sys.stderr)
        return result


def load_all(env_id: str, names: list[str], env_kwargs: Mapping[str, Any]) -> dict[str, Any]:
    """Policies by name, a `PolicyUnavailable` in the place of one that cannot be loaded here.

    Raises:
        ValueError: no such id, policy or option.
    """
    found: dict[str, Any] = {}
    for name in names:
        try:
            found[name] = load_policy(env_id, name, env_kwargs)
        except PolicyUnavailable as error:
            found[name] = error
    return found


def content_hash(env_id: str, name: str) -> str:
    """Hash of the file that a policy's behaviour is read from, "" where the project's sources cover it."""
    path = Path(name) if name.endswith(".safetensors") else checkpoints(env_id).get(name)
    module = name.partition(":")[0]
    if path is None and ":" in name:
        found = importlib.util.find_spec(module)
        path = Path(found.origin) if found is not None and found.origin else None
    return hashlib.sha256(path.read_bytes()).hexdigest() if path is not None and path.is_file() else ""


def _row_file(folder: Path, key: Mapping[str, Any]) -> Path:
    name = str(key["policy"])
    stem = re.sub(r"[^\w.-]+", "-", Path(name).stem if name.endswith(".safetensors") else name)
    digest = hashlib.sha256(json.dumps(to_json(dict(key)), sort_keys=True).encode()).hexdigest()
    return folder / "rows" / f"{stem}-{digest[:16]}.json"


def stored(folder: Path, key: Mapping[str, Any]) -> EvaluationResult | None:
    """The finished row of this key in the folder; None if there is none, or what is there is damaged."""
    try:
        return EvaluationResult.from_dict(json.loads(_row_file(folder, key).read_text())["result"])
    except (FileNotFoundError, ValueError, KeyError, TypeError):
        return None


def store(folder: Path, key: Mapping[str, Any], result: EvaluationResult) -> None:
    """Keep a finished row under its key."""
    path = _row_file(folder, key)
    path.parent.mkdir(exist_ok=True)
    write_json(path, {"key": key, "result": result.to_dict()})


def _sources() -> str:
    """Hash of the project's sources, so that a row never outlives an uncommitted change."""
    digest = hashlib.sha256()
    root = Path(__file__).resolve().parents[1]
    for package in ("aerograsp_env", "baselines", "agents"):
        for path in sorted((root / package).rglob("*")):
            if path.suffix in (".py", ".xml", ".npz", ".json") and path.is_file():
                digest.update(path.relative_to(root).as_posix().encode())
                digest.update(path.read_bytes())
    return digest.hexdigest()
