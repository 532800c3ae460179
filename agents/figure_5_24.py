"""Thesis section 5.4.7 and figure 5.24: the free arm's end-effector held at a point, docked and hovering."""

from __future__ import annotations

from typing import Any, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim.config import CONTROL_STEP
from agents.evaluation import EvaluationResult, evaluate
from agents.pictures import figure_grid, png
from agents.policies import load_policy
from agents.reproduction import Reproduction, Request, text_table
from agents.statistics import bootstrap_interval, mean

EPISODES, STEPS = 20, 1500
ENV_ID, POLICY = "aerograsp/DockManipulate-v0", "dock-dls"
SUCCESS = 20.0  # [mm]
GPS_SHARE = 1.0 / 3.0  # of the error on GPS that the docked one may have at most

# name: what it is called, options, colour
CONDITIONS: dict[str, tuple[str, dict[str, Any], str]] = {
    "dock": ("docked, by the tool", {}, "#3fa66b"),
    "vision": ("hovering, by vision", {"docked": False, "localization": "vision"}, "#3b7dd8"),
    "gps": ("hovering, by GPS", {"docked": False, "localization": "gps"}, "#e8833a"),
}

NOTES = """\
{episodes} pinned episodes of {seconds:g} s a condition, light wind, the policy {policy}: the same seeds, points and
gains. Error: true distance of the end-effector from its point, mean over an episode after 5 s, then over the episodes,
95 % bootstrap interval in brackets. Estimate: distance from the end-effector to where the vehicle believes it, by the
pose estimate and the arm's encoders. Base: the airframe's distance from its set-point. Held: success, an error of at
most 20 mm and no crash. The thesis plots one docked experiment against a total station and prints no figures of it."""


class Course(NamedTuple):
    """One episode, step by step."""

    time: NDArray[np.float64]  # (T,) [s]
    true: NDArray[np.float64]  # (T, 3) end-effector − point, world [mm]
    estimated: NDArray[np.float64]  # (T, 3) the same as the vehicle believes [mm]


def course(options: dict[str, Any], seed: int, steps: int = STEPS) -> Course:
    """The end-effector's way over one pinned episode, to its end or a crash."""
    env = gymnasium.make(ENV_ID, max_episode_steps=steps, disable_env_checker=True, **options)
    world: Any = env.unwrapped
    actor, state = load_policy(ENV_ID, POLICY, options), None
    observation, _ = env.reset(seed=seed)
    true, estimated, done = [], [], False
    while not done:
        s, target = world.state, world.record["target"]
        true.append(s["position"] + s["rotation"] @ s["true_tool"][0, :3, 3] - target)
        estimated.append(s["estimate"] + s["attitude"] @ s["tool"][0, :3, 3] - target)
        action, state = actor.predict(observation, state=state)
        observation, _, terminated, truncated, _ = env.step(action)
        done = terminated or truncated
    env.close()
    return Course(world.dt * np.arange(len(true)), 1e3 * np.array(true), 1e3 * np.array(estimated))


def run(request: Request, steps: int = STEPS) -> Reproduction:
    """The three conditions side by side; the picture shows each one's first episode."""
    episodes = request.episodes or EPISODES
    head = ["", "error [mm]", "largest [mm]", "estimate [mm]", "base [mm]", "held [%]", "crash [%]"]
    rows, data = [head], {}
    for name, (label, options, _) in CONDITIONS.items():
        options = {**options, "max_episode_steps": steps}
        result = evaluate(ENV_ID, POLICY, episodes, request.seed, options, progress=True)
        data[name] = facts = _facts(result)
        low, high = facts["interval"]
        figures = [f"{facts[key]:.1f}" for key in ("largest", "estimate", "base")]
        shares = [f"{100 * facts[key]:.0f}" for key in ("held", "crash")]
        rows.append([label, f"{facts['error']:.1f} [{low:.1f}, {high:.1f}]", *figures, *shares])
    docked, vision, gps = (data[name]["error"] for name in CONDITIONS)
    checks = {
        f"docked at most as on vision: {docked:.1f} ≤ {vision:.1f} mm": docked <= vision,
        f"docked at most a third of GPS: {docked:.1f} ≤ {GPS_SHARE * gps:.1f} mm": docked <= GPS_SHARE * gps,
    }
    lines = [text_table(rows, 1), *(f"{'✓' if good else '✗'} {text}" for text, good in checks.items())]
    lines += [
        f"{label}: {data[name]['uncounted']} of {episodes} episodes crashed before errors count and are left out."
        for name, (label, *_) in CONDITIONS.items()
        if data[name]["uncounted"]
    ]
    text = "\n".join([*lines, NOTES.format(episodes=episodes, policy=POLICY, seconds=steps * CONTROL_STEP)])
    picture = _picture(data, request.seed, steps) if request.picture else None
    return Reproduction(text, {"conditions": data, "checks": checks}, picture)


def _facts(result: EvaluationResult) -> dict[str, Any]:
    """Figures of one condition, lengths in mm; episodes that ended before errors count have none."""

    def values(metric: str) -> NDArray[np.float64]:
        everything = 1e3 * result.metrics.get(metric, np.full(result.episodes, np.nan))
        return everything[np.isfinite(everything)]

    error = values("error")
    nothing = float("nan")
    return {
        "error": float(mean(error)) if len(error) else nothing,
        "interval": tuple(bootstrap_interval(error, statistic=mean)) if len(error) else (nothing, nothing),
        "largest": float(values("error_max").max(initial=0.0)) if len(error) else nothing,
        "estimate": float(mean(values("estimate_error"))) if len(error) else nothing,
        "base": float(mean(values("hover"))) if len(error) else nothing,
        "held": result.mean("success"),
        "crash": result.mean("crash"),
        "uncounted": result.episodes - len(error),
        "errors": error,
    }


def _picture(data: dict[str, Any], seed: int, steps: int) -> bytes:
    figure, (docked, all_three, episodes) = figure_grid(1, 3, (13.0, 3.8))
    courses = {name: course(options, seed, steps) for name, (_, options, _) in CONDITIONS.items()}
    held = courses["dock"]
    for i, (axis, color) in enumerate(zip("xyz", ("#3b7dd8", "#e8833a", "#3fa66b"), strict=True)):
        docked.plot(held.time, held.true[:, i], color=color, lw=1.3, label=f"{axis}, true")
        docked.plot(held.time, held.estimated[:, i], color=color, lw=0.9, ls="--", label=f"{axis}, by the tool")
    docked.set(title="docked: end-effector from its point", xlabel="time [s]", ylabel="[mm]", ylim=(-16.0, 16.0))
    docked.legend(frameon=False, ncols=3, fontsize=8, loc="lower right")
    for place, (name, (label, _, color)) in enumerate(CONDITIONS.items()):
        way = courses[name]
        all_three.plot(way.time, np.linalg.norm(way.true, axis=1), color=color, lw=1.2, label=label)
        spread = np.linspace(-0.18, 0.18, len(data[name]["errors"]))
        episodes.plot(place + spread, np.sort(data[name]["errors"]), "o", color=color, ms=4, alpha=0.8)
        episodes.plot([place - 0.3, place + 0.3], 2 * [data[name]["error"]], color="black", lw=1.4)
    for axis in (all_three, episodes):
        axis.axhline(SUCCESS, color="#9aa0a6", lw=0.8, ls=":", label="success" if axis is all_three else None)
        axis.set(yscale="log", ylabel="error [mm]")
    all_three.set(title="one episode", xlabel="time [s]")
    all_three.legend(frameon=False, fontsize=8)
    episodes.set(title="all episodes and their mean")
    episodes.set_xticks(range(len(CONDITIONS)), [label.replace(", ", "\n") for label, *_ in CONDITIONS.values()])
    return png(figure)
