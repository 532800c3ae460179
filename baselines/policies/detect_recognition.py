"""Which class a cluster is of: a random forest over its descriptors (Breiman 2001), grown on training scenes.

The forest ships as arrays in one file; `agents.detect_forest` grows it again.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, fields
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim.visual import CLASSES
from aerograsp_env.spatial import Array

NOTHING = "nothing"
"""The class of what stands out but is none of the objects: other things, edges of tables, parts of walls."""
NAMES = (*CLASSES, NOTHING)
SHARPNESS = 1.5  # exponent of the trees' mean vote, which is blunter than the odds it stands for
FLOOR = 5e-3  # least probability of a class in one frame


@dataclass(frozen=True, eq=False)
class Forest:
    """Decision trees, all of their nodes in a row. A leaf's child is itself.

    Raises:
        ValueError: arrays that do not fit each other.
    """

    roots: NDArray[np.int32]  # (T,) the trees' first nodes
    feature: NDArray[np.int16]  # (N,) which feature a node looks at
    threshold: NDArray[np.float32]  # (N,) up to which it goes left
    children: NDArray[np.int32]  # (N, 2) left, right
    votes: NDArray[np.uint8]  # (N, C) 255 times the share of each of `NAMES` among the examples that came to a node

    def __post_init__(self) -> None:
        count = len(self.feature)
        shapes = (self.threshold.shape, self.children.shape, self.votes.shape)
        if shapes != ((count,), (count, 2), (count, len(NAMES))) or self.children.max(initial=0) >= count:
            raise ValueError(f"nodes: expected {count} of each kind and {len(NAMES)} classes, got {shapes}")

    def log_probabilities(self, features: Array) -> Array:
        """(C,) of the classes for one cluster's features (D,), none below log `FLOOR`."""
        node = self.roots
        row = np.asarray(features, dtype=np.float32)
        while True:
            right = (row[self.feature[node]] > self.threshold[node]).astype(np.intp)
            following = self.children[node, right]
            if (following == node).all():
                break
            node = following
        p = np.maximum(self.votes[node].mean(axis=0) / 255.0, 1e-9) ** SHARPNESS
        return np.log(np.maximum(p / p.sum(), FLOOR))

    def save(self, path: Any) -> None:
        """As one npz file."""
        np.savez_compressed(path, **{f.name: getattr(self, f.name) for f in fields(self)})

    @classmethod
    def load(cls, file: Any) -> Forest:
        """From a file that `save` wrote.

        Raises:
            ValueError: not such a file.
        """
        with np.load(file, allow_pickle=False) as arrays:
            missing = [f.name for f in fields(cls) if f.name not in arrays]
            if missing:
                raise ValueError(f"file: expected a forest, got a file without {', '.join(missing)}")
            return cls(**{f.name: arrays[f.name] for f in fields(cls)})


@functools.cache
def shipped() -> Forest:
    """The forest grown on training scenes."""
    with (resources.files("baselines.policies") / "detect_forest.npz").open("rb") as file:
        return Forest.load(file)
