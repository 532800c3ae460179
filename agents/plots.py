"""The report's figures, as PNG bytes on a transparent ground, drawn for a light or a dark page."""

import io
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from agents.scoring import Column
from agents.table import Estimate, Published, Row

if TYPE_CHECKING:
    from agents.traces import Trace

PALETTE = ("#3b7dd8", "#e8833a", "#3fa66b", "#c4557c", "#8a6fd1", "#2fa3b5", "#b58a1b", "#7a8b3c")
AXES = {"error_x": "#3b7dd8", "error_y": "#e8833a", "error_z": "#3fa66b"}
NULL = {"zero": "#9aa0a6", "random": "#6d737a"}  # the rows that do nothing sensible
_OFF_SCALE = 8.0  # a bar this many times the shortest is cut, and its value written


def colors(names: Sequence[str]) -> dict[str, str]:
    """One colour a policy, in their order; greys for zero and random."""
    active = [name for name in names if name not in NULL]
    return NULL | {name: PALETTE[i % len(PALETTE)] for i, name in enumerate(active)}


def error_bars(rows: Sequence[Row], published: Sequence[Published], dark: bool) -> bytes:
    """Mean |error| per axis with intervals, a group of bars a policy; published figures hatched."""
    estimates: list[tuple[str, dict[str, Estimate]]] = [
        (row.policy, {name: e for name in AXES if (e := row.estimate(name)) is not None}) for row in rows
    ]
    estimates = [(policy, found) for policy, found in estimates if found]
    groups = len(estimates) + len(published)
    tops = [max(1e3 * e.interval.high for e in found.values()) for _, found in estimates]
    tops += [1e3 * max(value for value, _ in other.values.values()) for other in published]
    limit = 1.18 * max(top for top in tops if top <= _OFF_SCALE * min(tops)) or 1.0
    figure, axis = new_figure(dark, 0.62 * groups + 1.1)
    for group, (_, found) in enumerate(estimates):
        for i, (name, color) in enumerate(AXES.items()):
            if name not in found:
                continue
            mean, (low, high) = 1e3 * found[name].value, (1e3 * bound for bound in found[name].interval)
            y = group + 0.26 * (i - 1)
            axis.barh(y, min(mean, limit), height=0.23, color=color)
            if mean > limit:
                axis.text(0.985 * limit, y, f"{mean:.0f} ▸", ha="right", va="center", color="white", fontsize=7)
            else:
                axis.errorbar(mean, y, xerr=[[mean - low], [high - mean]], color=ink(dark), lw=1.1, capsize=2.2)
    for group, other in enumerate(published, start=len(estimates)):
        for i, (name, color) in enumerate(AXES.items()):
            if name in other.values:
                y, value = group + 0.26 * (i - 1), 1e3 * other.values[name][0]
                axis.barh(y, min(value, limit), height=0.23, facecolor="none", edgecolor=color, hatch="////", lw=1)
    axis.set_yticks(range(groups), [policy for policy, _ in estimates] + [other.label for other in published])
    axis.set_xlim(0.0, limit)
    axis.invert_yaxis()
    axis.set_xlabel("mean |error| [mm]")
    grid_lines(axis, "x", dark)
    handles = [axis.barh(0, 0, color=color, label=name.removeprefix("error_")) for name, color in AXES.items()]
    figure.legend(handles=handles, ncols=3, loc="upper right", frameon=False, labelcolor=ink(dark))
    return png_bytes(figure)


def error_strips(rows: Sequence[Row], dark: bool, name: str = "error", label: str = "mean |error| [mm]") -> bytes:
    """One point an episode, with the box of quartiles behind, on a logarithmic axis where no value is zero."""
    samples = [
        (row.policy, 1e3 * row.values[name][np.isfinite(row.values[name])]) for row in rows if name in row.values
    ]
    samples = [(policy, values) for policy, values in samples if values.size]
    palette = colors([policy for policy, _ in samples])
    figure, axis = new_figure(dark, 0.46 * len(samples) + 1.0)
    rng = np.random.default_rng(0)
    for i, (policy, values) in enumerate(samples):
        box = {"color": ink(dark), "linewidth": 1.0}
        axis.boxplot(
            values, positions=[i], orientation="horizontal", widths=0.56, showfliers=False,
            boxprops=box, whiskerprops=box, capprops=box, medianprops={**box, "linewidth": 2.0},
        )  # fmt: skip
        jitter = i + rng.uniform(-0.18, 0.18, values.size)
        axis.scatter(values, jitter, s=13, color=palette[policy], alpha=0.65, linewidths=0, zorder=1.5)
    axis.set_yticks(range(len(samples)), [policy for policy, _ in samples])
    if all(values.min() > 0.0 for _, values in samples):
        _log_axis(axis, "x")
    axis.invert_yaxis()
    axis.set_xlabel(label)
    grid_lines(axis, "x", dark)
    return png_bytes(figure)


def error_over_time(traces: Sequence["Trace"], dark: bool) -> bytes:
    """Observed |position error| over one pinned episode, a line a policy; a cross where an episode ended early."""
    palette = colors([line.policy for line in traces])
    end = max(line.time[-1] for line in traces)
    figure, axis = new_figure(dark, 3.3)
    for line in traces:
        color = palette[line.policy]
        error = np.maximum(1e3 * line.error, 0.1)
        axis.plot(line.time, error, color=color, lw=1.2, label=line.policy, alpha=0.9)
        if line.time[-1] < end:
            axis.plot(line.time[-1], error[-1], "x", color=color, ms=7, mew=2)
    _log_axis(axis, "y")
    axis.set_xlim(0.0, end)
    axis.set_xlabel("time [s]")
    axis.set_ylabel("|position error| [mm]")
    grid_lines(axis, "y", dark)
    figure.legend(ncols=len(traces), loc="upper right", frameon=False, labelcolor=ink(dark), handlelength=1.2)
    return png_bytes(figure)


def grouped_intervals(groups: Mapping[str, Sequence[Row]], dark: bool, column: Column, log: bool = True) -> bytes:
    """A column with its intervals, a group a condition and a colour a policy; hollow where over 1 % crashed."""
    policies = [row.policy for row in next(iter(groups.values()))]
    palette, step = colors(policies), 0.78 / max(len(policies), 1)
    figure, axis = new_figure(dark, len(groups) * (0.16 * len(policies) + 0.24) + 1.0)
    for group, rows in enumerate(groups.values()):
        if group % 2:
            axis.axhspan(group - 0.5, group + 0.5, color=ink(dark), alpha=0.05, lw=0)
        for i, row in enumerate(rows):
            estimate, crash = row.estimate(column), row.estimate("crash")
            if estimate is None:
                continue
            mean, (low, high) = (
                column.scale * estimate.value,
                (column.scale * bound for bound in estimate.interval),
            )
            color = palette[row.policy]
            face = "none" if crash is not None and crash.value > 0.01 else color
            axis.errorbar(
                mean, group + step * (i - 0.5 * (len(rows) - 1)), xerr=[[mean - low], [high - mean]],
                fmt="o", ms=5, mfc=face, color=color, lw=1.4, capsize=2.2,
            )  # fmt: skip
    axis.set_yticks(range(len(groups)), list(groups))
    axis.set_ylim(len(groups) - 0.5, -0.5)
    if log:
        _log_axis(axis, "x")
    axis.set_xlabel(column.head)
    grid_lines(axis, "x", dark)
    handles = [axis.plot([], [], "o", color=palette[policy], label=policy)[0] for policy in policies]
    figure.legend(handles=handles, ncols=len(handles), loc="upper right", frameon=False, labelcolor=ink(dark))
    return png_bytes(figure)


def ink(dark: bool) -> str:
    """The colour of text and lines."""
    return "#d5d9de" if dark else "#33383e"


def new_figure(dark: bool, height: float, width: float = 8.4) -> tuple[Any, Any]:
    """A figure and its axis, `height` and `width` in inches."""
    # Figure without pyplot: no global state, no display, no backend switched under the caller's feet.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    height = max(height, 1.9)
    room = 1.0 - 0.26 / height  # leaves space for the legend above the axes
    figure = Figure(figsize=(width, height), layout=ConstrainedLayoutEngine(rect=(0.0, 0.0, 1.0, room)))
    FigureCanvasAgg(figure)
    figure.patch.set_alpha(0.0)
    axis = figure.add_subplot()
    axis.patch.set_alpha(0.0)
    axis.spines[["top", "right", "left"]].set_visible(False)
    axis.spines["bottom"].set_color(ink(dark))
    axis.tick_params(colors=ink(dark), which="both", length=0)
    axis.xaxis.label.set_color(ink(dark))
    axis.yaxis.label.set_color(ink(dark))
    axis.set_axisbelow(True)
    return figure, axis


def grid_lines(axis: Any, which: str, dark: bool) -> None:
    """Faint lines across one axis, "x" or "y", or "both"."""
    axis.grid(axis=which, color=ink(dark), alpha=0.18, lw=0.7)


def _log_axis(axis: Any, which: str) -> None:
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    getattr(axis, f"set_{which}scale")("log")
    scale = getattr(axis, f"{which}axis")
    low, high = getattr(axis, f"get_{which}lim")()
    scale.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < 200.0 * low else (1.0,), numticks=20))
    scale.set_major_formatter(StrMethodFormatter("{x:g}"))
    scale.set_minor_formatter(NullFormatter())


def png_bytes(figure: Any) -> bytes:
    """The figure as PNG."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=160)
    return buffer.getvalue()
