"""Thesis Table 5.3: how well each position source lets the vehicle hold its set-point."""

from __future__ import annotations

from typing import Any

import numpy as np

from aerograsp_env.sim.config import DockConfig
from agents.evaluation import evaluate
from agents.published import TABLE_5_3, TABLE_5_3_RATES
from agents.reproduction import Reproduction, Request, text_table

EPISODES = 20
TOLERANCE = 0.25  # a figure within this share of the published one is marked
ENV_ID, POLICY = "aerograsp/Dock-v0", "pid"
NAMES = {"gps": "GPS, free hover", "vision": "vision, free hover", "dock": "docking tool"}

NOTES = """\
{episodes} pinned episodes of 60 s a source, light wind, the thesis's PID (Table 5.2) about the nominal set-point; e is
the true position's error, all samples after 5 s. μ: mean over the episodes of an episode's mean |e|; σ: mean over the
episodes of e's standard deviation within an episode; bias: mean of e, its sign kept, ± its spread over episodes.
The sensors' noise amplitudes, and nothing else, were calibrated to this table, on other seeds than these
(`python -m agents.calibrate`). The thesis measured with a total station."""


def conditions(source: str) -> dict[str, Any]:
    """The environment's options for one position source."""
    return {
        "wind": "light",
        "localization": source,
        "docked": source == "dock",
        "config": DockConfig(set_point_spread=0.0),
    }


def run(request: Request) -> Reproduction:
    """Measure the 18 figures and set them beside the published ones."""
    episodes = request.episodes or EPISODES
    figures: list[dict[str, Any]] = []
    sources: dict[str, Any] = {}
    for source, published in TABLE_5_3.items():
        result = evaluate(ENV_ID, POLICY, episodes, request.seed, conditions(source), progress=True)
        ended_early = int(np.sum(result.terminations != ""))
        sources[source] = {"episodes": episodes, "ended_early": ended_early, "rate": TABLE_5_3_RATES[source]}
        for i, axis in enumerate("xyz"):
            for statistic, metric, value in (("μ", "error", published[0][i]), ("σ", "std", published[1][i])):
                values = result.values(f"{metric}_{axis}")
                measured = float(np.mean(values))
                figures.append(
                    {
                        "source": source,
                        "axis": axis,
                        "statistic": statistic,
                        "measured": measured,
                        "published": value,
                        "ratio": measured / value,
                        "within": abs(measured / value - 1.0) <= TOLERANCE,
                        "values": values,
                    }
                )
            bias = result.values(f"bias_{axis}")
            sources[source][f"bias_{axis}"] = {"mean": float(bias.mean()), "spread": float(bias.std())}
    return Reproduction(_text(figures, sources, episodes), {"figures": figures, "sources": sources})


def _text(figures: list[dict[str, Any]], sources: dict[str, Any], episodes: int) -> str:
    head = ["source", "axis", "μ [m]", "thesis", "ratio", "", "σ [m]", "thesis", "ratio", "", "bias [m]"]
    rows = [head]
    for mean, spread in zip(figures[0::2], figures[1::2], strict=True):
        first = mean["axis"] == "x"
        bias = sources[mean["source"]][f"bias_{mean['axis']}"]
        cells = [NAMES[mean["source"]] if first else "", mean["axis"]]
        for f in (mean, spread):
            mark = "✓" if f["within"] else "✗"
            cells += [f"{f['measured']:.3f}", f"{f['published']:.3f}", f"{f['ratio']:.2f}", mark]
        rows.append([*cells, f"{bias['mean']:+.3f} ± {bias['spread']:.3f}"])
    within = sum(f["within"] for f in figures)
    lines = [
        text_table(rows),
        f"{within} of {len(figures)} figures within {100 * TOLERANCE:.0f} % of the published ones.",
    ]
    for source, facts in sources.items():
        if facts["ended_early"]:
            lines.append(
                f"{NAMES[source]}: {facts['ended_early']} of {episodes} episodes ended early; they count as far."
            )
    return "\n".join([*lines, NOTES.format(episodes=episodes)])
