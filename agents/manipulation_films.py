"""Films of the best and the worst test episode of a task's reference policy."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from agents import page
from agents.bench_setup import Condition, Measured, setup_of
from agents.play import draws_pictures, play
from agents.policies import registered_policies
from agents.scoring import Scoring
from agents.table import Row, scoring

LARGEST = 1_900_000  # bytes of a film
SECONDS, AFTER = 20.0, 2.5  # of an episode at most; after a success
SHAPES = ((10.0, 400, 300), (8.0, 320, 240), (5.0, 320, 240), (5.0, 240, 180))  # frames a second, width, height


class Shot(NamedTuple):
    """One episode of one row."""

    title: str  # "Best", "Worst"
    condition: str
    policy: str
    number: int  # of the episode
    said: str  # what became of it
    seconds: float  # of it that are worth seeing


def reference(rows: Sequence[Row], env_id: str) -> Row | None:
    """The row of the id's first analytic policy that ran; without one the best, if any is."""
    by_name = {row.policy: row for row in rows if row.values and not row.oracle}
    found = next((by_name[name] for name in registered_policies(env_id) if name in by_name), None)
    return found or scoring(rows).best(list(by_name.values()))


def choose(conditions: Mapping[str, Condition], env_id: str, policy: str | None = None) -> list[Shot]:
    """The best and the worst episode of a policy under these conditions, by `Scoring.goodness`.

    Of equals the first counts. One shot where all are alike, none where the policy did not run. By default it is the
    reference policy.
    """
    episodes: list[tuple[tuple[float, ...], str, int]] = []
    rows: dict[str, Row] = {}
    for name, condition in conditions.items():
        ran = {row.policy: row for row in condition.rows if row.values}
        if (row := reference(condition.rows, env_id) if policy is None else ran.get(policy)) is None:
            continue
        rows[name] = row
        order = np.stack([goodness(row, scoring([row]), *pair) for pair in scoring([row]).goodness], axis=-1)
        episodes += [(tuple(of), name, k) for k, of in enumerate(order.tolist())]
    if not episodes:
        return []
    best, worst = (choice(episodes, key=lambda episode: episode[0]) for choice in (max, min))
    shots = [("Best", best), ("Worst", worst)] if best[0] != worst[0] else [("Like all others", best)]
    return [
        Shot(title, name, rows[name].policy, k, outcome(rows[name], scoring([rows[name]]), k), worth(rows[name], k))
        for title, (_, name, k) in shots
    ]


def goodness(row: Row, kind: Scoring, name: str, sign: float) -> np.ndarray:
    """(E,) a value of a row, more is better; −∞ where it is not defined."""
    values = sign * row.values.get(name, np.zeros(row.episodes))
    return np.where(np.isfinite(values), values, -np.inf)


def outcome(row: Row, kind: Scoring, number: int) -> str:
    """What became of an episode, in words."""
    values = {name: float(of[number]) for name, of in row.values.items()}
    if values.get("crash"):
        return "it crashed"
    if "lift_time" in values:
        if values["success"]:
            return f"lifted and held after {values['lift_time']:.1f} s"
        cause = next((cause for cause in kind.causes if values.get(cause)), "failed")
        return f"{cause.replace('_', ' ')}, lifted by {1e3 * values['lift']:.0f} mm"
    if kind.primary is None or kind.primary.name not in values:
        return "success" if values["success"] else "failure"
    name, _, unit = kind.primary.head.partition(" [")
    shown = kind.primary.scale * values[kind.primary.name]
    return f"{name} {shown:.{kind.primary.digits}f} {unit.rstrip(']')}"


def worth(row: Row, number: int) -> float:
    """Seconds of an episode that are worth seeing: until shortly after its success, where it says when that was."""
    if "lift_time" in row.values and row.values["success"][number]:
        return min(float(row.values["lift_time"][number]) + AFTER, SECONDS)
    return SECONDS


def film(env_id: str, policy: str, seed: int, env_kwargs: Mapping[str, Any], seconds: float = SECONDS) -> bytes:
    """An episode's first seconds, if it lasts as long, as a GIF in real time, as fine as `LARGEST` lets it be.

    Raises:
        ValueError, RuntimeError: it cannot be drawn here.
    """
    data = b""
    for fps, width, height in SHAPES:
        look = {"width": width, "height": height}
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder) / "film.gif"
            play(env_id, policy, out, seconds=seconds, seed=seed, env_kwargs={**env_kwargs, **look}, fps=fps)
            data = out.read_bytes()
        if len(data) <= LARGEST:
            break
    return data


def films_section(measured: Measured, policy: str | None = None) -> list[str]:
    """The films of a policy, the reference one by default, as parts of the page.

    None where the id draws no pictures or they cannot be drawn here.
    """
    setup = setup_of(measured.env_id)
    filmed = {name: of for name, of in measured.conditions.items() if name in setup.filmed}
    filmed = filmed or dict(list(measured.conditions.items())[:1])
    if not draws_pictures(measured.env_id, measured.env_kwargs):
        return []
    parts = []
    for shot in choose(filmed, measured.env_id, policy):
        seed = measured.seed + shot.number
        where = f"{shot.condition}, " if shot.condition else ""
        try:
            data = film(
                measured.env_id, shot.policy, seed, {**filmed[shot.condition].options, **setup.look}, shot.seconds
            )
        except (ValueError, RuntimeError) as error:
            if measured.progress:
                print(f"no film: {error}", file=sys.stderr)
            return []
        caption = f"{shot.title} test episode of {shot.policy} ({where}seed {seed}): {shot.said}. In real time."
        parts.append(page.film_figure(data, caption))
    if not parts:
        return []
    of = f" of {policy}" if policy else ""
    return [f"<h2>Best and worst episode{page.text(of)}</h2>", '<div class="films">', *parts, "</div>"]
