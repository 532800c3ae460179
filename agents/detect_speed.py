"""How many frames a second the policies of Detect-v0 keep up with, from observation to action on one thread."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import NamedTuple

import gymnasium
import numpy as np

from agents.policies import load_policy
from agents.seeds import VALIDATION_SEED
from agents.table import aligned

ID, WANTED = "aerograsp/Detect-v0", 15.0
POLICIES = ("clusters+icp", "features+pnp", "cnn+icp")
LEVELS = ("easy", "cluttered")


class PolicySpeed(NamedTuple):
    """Processor time of a policy's frames."""

    policy: str
    mean_seconds: float
    late_seconds: float  # 95th percentile
    frames: int


def policy_speed(name: str, flights: int, frames: int = 40) -> PolicySpeed:
    """A policy's frames on `flights` flights of each of `LEVELS`, after a flight to warm up."""
    policy = load_policy(ID, name)
    seconds: list[float] = []
    for level in LEVELS:
        env = gymnasium.make(ID, level=level)
        try:
            for flight in range(flights):
                observation, state = env.reset(seed=VALIDATION_SEED + flight)[0], None
                if not seconds:
                    policy.predict(observation)
                for _ in range(frames):
                    start = time.process_time()
                    action, state = policy.predict(observation, state)
                    seconds.append(time.process_time() - start)
                    observation = env.step(action)[0]
        finally:
            env.close()
    return PolicySpeed(name, float(np.mean(seconds)), float(np.quantile(seconds, 0.95)), len(seconds))


def table(rows: Sequence[PolicySpeed]) -> str:
    """Text for a terminal."""
    lines = [["policy", "a frame, mean [ms]", "95th percentile [ms]", "frames/s", "frames"]]
    for row in rows:
        times = (f"{1e3 * s:.1f}" for s in (row.mean_seconds, row.late_seconds))
        lines.append([row.policy, *times, f"{1.0 / row.mean_seconds:.1f}", str(row.frames)])
    return aligned(lines, [f"Processor time from observation to action. Wanted of cnn+icp: {WANTED:g} frames/s."])
