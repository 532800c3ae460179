"""Figures of the grasp-planning comparison, as PNG bytes on a transparent ground, for a light or a dark page."""

from collections.abc import Mapping, Sequence

from agents.grasp_calibration import Reliability
from agents.plots import PALETTE, grid_lines, ink, new_figure, png_bytes
from agents.scoring import Column
from agents.table import Row

OUTCOME_COLORS = {
    "strict": "#2f8f5b",
    "held, moved": "#9bcf8d",
    "dropped": "#e8b13a",
    "missed": "#e8833a",
    "collision": "#c4557c",
    "no grasp": "#8a8f96",
}
_ASIDE = 0.006
_LEAST_LABEL = 0.055  # share of a bar below which its number does not fit


def rates(rows: Sequence[Row], columns: Sequence[Column], dark: bool) -> bytes:
    """Shares with their intervals, a line a policy, a colour a column; hollow for oracles."""
    figure, axis = new_figure(dark, 0.36 * len(rows) + 1.1)
    for i, column in enumerate(columns):
        offset = 0.24 * (i - 0.5 * (len(columns) - 1))
        for line, row in enumerate(rows):
            if (estimate := row.estimate(column)) is None:
                continue
            value, (low, high) = 100.0 * estimate.value, (100.0 * bound for bound in estimate.interval)
            axis.errorbar(
                value, line + offset, xerr=[[max(value - low, 0.0)], [max(high - value, 0.0)]], fmt="o", ms=5.5,
                color=PALETTE[i], mfc="none" if row.oracle else PALETTE[i], lw=1.5, capsize=2.4,
            )  # fmt: skip
    for line in range(1, len(rows), 2):
        axis.axhspan(line - 0.5, line + 0.5, color=ink(dark), alpha=0.05, lw=0)
    axis.set_yticks(range(len(rows)), [row.label for row in rows])
    axis.set_ylim(len(rows) - 0.5, -0.5)
    axis.set_xlim(-1.0, 101.0)
    axis.set_xlabel("share of the episodes [%]")
    grid_lines(axis, "x", dark)
    handles = [axis.plot([], [], "o", color=PALETTE[i], label=column.name)[0] for i, column in enumerate(columns)]
    figure.legend(handles=handles, ncols=len(columns), loc="upper right", frameon=False, labelcolor=ink(dark))
    return png_bytes(figure)


def outcome_bars(
    shares: Mapping[str, Mapping[str, float]], dark: bool, colors: Mapping[str, str] = OUTCOME_COLORS
) -> bytes:
    """What became of each policy's grasps: policy → outcome of `colors` → share, stacked to 1."""
    figure, axis = new_figure(dark, 0.36 * len(shares) + 1.0)
    for line, of in enumerate(shares.values()):
        left = 0.0
        for outcome, color in colors.items():
            share = of.get(outcome, 0.0)
            axis.barh(line, 100.0 * share, left=100.0 * left, height=0.72, color=color, lw=0)
            if share >= _LEAST_LABEL:
                middle = 100.0 * (left + 0.5 * share)
                axis.text(middle, line, f"{100.0 * share:.0f}", ha="center", va="center", color="#15181c", fontsize=7.5)
            left += share
    axis.set_yticks(range(len(shares)), list(shares))
    axis.set_ylim(len(shares) - 0.5, -0.5)
    axis.set_xlim(0.0, 100.0)
    axis.set_xlabel("share of the episodes [%]")
    grid_lines(axis, "x", dark)
    handles = [axis.barh(0, 0, color=color, label=outcome) for outcome, color in colors.items()]
    figure.legend(
        handles=handles, ncols=len(handles), loc="upper right", frameon=False, labelcolor=ink(dark),
        handlelength=1.0, columnspacing=1.2, fontsize=8.5,
    )  # fmt: skip
    return png_bytes(figure)


def reliability_diagram(curves: Mapping[str, Reliability], dark: bool) -> bytes:
    """Observed shares over predicted probabilities with Wilson intervals, the number of grasps in each bin below."""
    figure, axis = new_figure(dark, 4.4)
    axis.plot([0.0, 1.0], [0.0, 1.0], "--", color=ink(dark), alpha=0.5, lw=1.0)
    for of in next(iter(curves.values())).bins:
        axis.text(
            0.5 * (of.low + of.high), -0.055, str(of.samples), ha="center", va="center", fontsize=8, color=ink(dark)
        )
    for i, (name, curve) in enumerate(curves.items()):
        x = [of.predicted + _ASIDE * (i - 1) for of in curve.bins]  # whiskers side by side
        y = [of.observed for of in curve.bins]
        errors = [
            [max(of.observed - of.interval.low, 0.0) for of in curve.bins],
            [max(of.interval.high - of.observed, 0.0) for of in curve.bins],
        ]
        axis.errorbar(
            x, y, yerr=errors, fmt="o-", ms=5, lw=1.4, capsize=2.4, color=PALETTE[i],
            label=f"{name}: Brier {curve.brier:.3f}",
        )  # fmt: skip
    axis.set_xlim(-0.02, 1.02)
    axis.set_ylim(-0.1, 1.02)
    axis.set_xlabel("probability of force closure")
    axis.set_ylabel("observed share")
    grid_lines(axis, "both", dark)
    figure.legend(ncols=len(curves), loc="upper right", frameon=False, labelcolor=ink(dark), fontsize=8.5)
    return png_bytes(figure)
