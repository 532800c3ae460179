"""Which features of a sequence's frames are the same: frame by frame, and its two ends."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.interfaces import Intrinsics
from baselines.detection.pnp import PnPResult, solve_pnp
from baselines.detection.stereo_features import FrameFeatures
from baselines.objects.matching import match_descriptors

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

SEQUENTIAL_ERROR = 4.0  # [px] of features of the next frame from where this frame's points would be seen
MIN_PAIRS = 8  # of features that consecutive frames must share


class Chain(NamedTuple):
    """Frames in the order in which they were taken, each matched with the one before."""

    frames: list[int]
    matches: list[Ints]  # (M, 2) rows of features of consecutive frames used
    T_c_o: list[Array]  # from the first used camera's frame
    skipped: list[tuple[int, str]]


def _step(a: FrameFeatures, b: FrameFeatures, intrinsics: Intrinsics, ratio: float) -> tuple[Ints, PnPResult]:
    """Matches of two frames that agree with one motion, and that motion (T_b_a)."""
    found = match_descriptors(a.descriptors, b.descriptors, ratio=ratio)
    # Pixels are free of distortion already, so the camera is one without.
    ideal = intrinsics._replace(distortion=None)
    solved = solve_pnp(a.points_c[found.query], b.pixels[found.train], ideal, SEQUENTIAL_ERROR, MIN_PAIRS)
    rows = np.column_stack([found.query, found.train])[solved.inliers]
    return rows, solved


def match_in_order(frames: Sequence[FrameFeatures], intrinsics: Intrinsics, ratio: float) -> Chain:
    """Match each frame with the last one that fitted; one that does not fit is left out."""
    chain = Chain([], [], [], [])
    for i, frame in enumerate(frames):
        if not chain.frames:
            if len(frame.pixels) >= MIN_PAIRS:
                chain.frames.append(i)
                chain.T_c_o.append(np.eye(4))
            else:
                chain.skipped.append((i, f"{len(frame.pixels)} features"))
            continue
        rows, solved = _step(frames[chain.frames[-1]], frame, intrinsics, ratio)
        if solved.T_c_object is None:
            chain.skipped.append((i, solved.reason))
            continue
        chain.matches.append(rows)
        chain.T_c_o.append(solved.T_c_object @ chain.T_c_o[-1])
        chain.frames.append(i)
    return chain


def join_beyond(
    matches: dict[tuple[int, int], Ints], frames: Sequence[FrameFeatures], intrinsics: Intrinsics, ratio: float
) -> None:
    """Match the ends of the sequence directly, which chains of neighbours do not reach, where they show the same."""
    last = len(frames) - 1
    for i, j in ((0, last), (0, last - 1), (1, last)):
        if j - i < 3:
            continue
        rows, solved = _step(frames[i], frames[j], intrinsics, ratio)
        if solved.T_c_object is not None:
            known = matches[i, j]
            new = ~np.isin(rows[:, 0], known[:, 0]) & ~np.isin(rows[:, 1], known[:, 1])
            matches[i, j] = np.concatenate([known, rows[new]])
