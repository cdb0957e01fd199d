"""What the reproduction of the paper shows beside its claims, and the ablations of what departs from the paper."""

from collections.abc import Mapping, Sequence
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, MaxNLocator, NullLocator, StrMethodFormatter

from psmpc_cli.figures import style
from psmpc_cli.figures.timeline import open_timeline
from psmpc_cli.logs.run import Run, Span
from psmpc_cli.logs.summary import signal, verdicts
from psmpc_cli.specs.task import MonitorSpec

Curves = Mapping[str, tuple[np.ndarray, np.ndarray]]
Panels = Mapping[str, Curves]
"""Curves (x, y) by panel and label, as the ablations measure them."""

SMALLEST = 1e-5
"""Less presence is not shown [m/s^2, rad/s^2]."""

PUBLISHED: Mapping[str, Any] = {
    "marker": "v",
    "color": "black",
    "markerfacecolor": "white",
    "markersize": 5.0,
    "linestyle": "none",
}
"""Look of a published value."""

BOUND: Mapping[str, Any] = {"color": style.EDGE, "linewidth": 0.9, "linestyle": (0, (5, 2))}
"""Look of a monitor's bound."""

BROKEN: Mapping[str, Any] = {"color": style.PALETTE[1], "linestyle": "none", "marker": "X", "markersize": 6.0}
"""Look of the time at which a monitor broke."""

HEIGHT, MARGIN, AXIS = 1.2, 0.25, 0.3
"""Height of a panel, of around it all, and of an axis with its label [in]."""

ROW = 0.38
"""Height of a run's row of bars [in]."""

HORIZON = "T_f"
"""The curve that says how far ahead the horizon ends."""

EXACT = 1e-9
"""Errors below this are none [m, rad]."""

NAMES: Mapping[str, str] = {
    "ours": "ours",
    "printed": "as printed, δ = 0",
    "range and printed": "range, δ = 0",
    "exact": "exact",
    "euler": "Euler, as printed",
}
"""Runs and forms as the legends have them; other labels stand for themselves."""


def plot_presence(run: Run, published: Mapping[str, float] = {}) -> Figure:
    """Plot what each waiting stage adds to the control, its threshold, and where it starts. Paper section IV-B.

    Args:
        run: The run.
        published: Published actual starts by stage [s].
    """
    timeline = open_timeline(run, 1, 2.4)
    axes: Axes = timeline.panels[0, 0]
    presence, time, waited = run["window/presence"], run.time, False
    for stage, name in enumerate(run.stage_names):
        which = np.isfinite(presence[:, stage])
        if which.any():
            waited, values = True, np.maximum(presence[which, stage], SMALLEST)
            marker = style.point_if_alone(time[which])
            axes.plot(time[which], values, label=style.readable(name), marker=marker, **style.line_look(stage))
    axes.axhline(run.task.spec.onset.epsilon, color=style.EDGE, linewidth=0.7, zorder=1.5)
    for start in published.values():
        axes.plot(start, run.task.spec.onset.epsilon, **PUBLISHED)
    axes.set_yscale("log")
    axes.set_ylim(bottom=SMALLEST)
    label = "Control added by a waiting stage\n(m/s², rad/s²)"
    timeline.label(0, label, "" if waited else "no stage waits: one at a time")
    marks = [style.entry("published start", **PUBLISHED)] if published else []
    return timeline.finish([style.entry("threshold", color=style.EDGE, linewidth=0.7), *marks])


def plot_monitors(run: Run) -> Figure:
    """Plot the signal of every monitor over time, its bounds while they count, and where it broke.

    A task without a monitor has one empty panel.
    """
    monitors = run.task.spec.monitors
    timeline = open_timeline(run, max(1, len(monitors)), 1.6)
    if not monitors:
        timeline.panels[0, 0].set_yticks([])
        style.panel_legend(timeline.panels[0, 0], "the task has no monitor")
        return timeline.finish()
    handles: list[Artist] = [style.entry("bound", **BOUND)]
    for row, (monitor, verdict) in enumerate(zip(monitors, verdicts(monitors, run.arrays), strict=True)):
        axes: Axes = timeline.panels[row, 0]
        time, values = run.time, signal(monitor, run.arrays)
        axes.plot(time, values, color=style.PALETTE[0])
        _plot_bounds(axes, run, monitor, values)
        if np.isfinite(verdict.broken_at):
            axes.plot(verdict.broken_at, np.interp(verdict.broken_at, time, values), zorder=3, **BROKEN)
            handles.append(style.entry("broken", **BROKEN))
        timeline.label(
            row, _signal_label(monitor), f"{style.readable(monitor.name)} during {style.readable(monitor.during)}"
        )
    return timeline.finish(handles)


def _plot_bounds(axes: Axes, run: Run, monitor: MonitorSpec, values: np.ndarray) -> None:
    """Draw the bounds over the samples of the monitor's stage."""
    during = run["window/first"] == run.stage_names.index(monitor.during)
    if not during.any():
        return
    time, start = run.time[during], float(values[during][0])
    above, below = monitor.above_start_at_most, monitor.below_start_at_most
    bounds = (
        None if above is None else start + above,
        None if below is None else start - below,
        monitor.at_most,
        monitor.at_least,
    )
    for bound in bounds:
        if bound is not None:
            axes.plot(time[[0, -1]], [bound, bound], zorder=1.5, **BOUND)


def _signal_label(monitor: MonitorSpec) -> str:
    if monitor.quantity == "speed":
        return "Speed (m/s)"
    names = [style.readable(name) for name in monitor.of] + ["base"] * (len(monitor.of) == 1)
    return f"Distance of\n{' and '.join(names)} (m)"


def plot_schedule(runs: Mapping[str, Run], published: Mapping[str, Mapping[str, float]] = {}) -> Figure:
    """Plot a bar a stage for every method, early starts below it, and marks at the published ends.

    Args:
        runs: By method.
        published: Published ends by method and stage [s].
    """
    figure = style.new_figure(0.9 + 0.5 * len(runs))
    axes = figure.subplots()
    ends = [run.motion.end for run in runs.values()]
    latest = max(ends + [time for times in published.values() for time in times.values()])
    axes.set_xlim(0.0, latest * 1.02)
    _draw_schedule(axes, {style.title_of(name): run.spans for name, run in runs.items()})
    for row, name in enumerate(runs):
        for time in published.get(name, {}).values():
            axes.plot(time, row - 0.33, **PUBLISHED)
    axes.set_xlabel("Time (s)")
    names = enumerate(next(iter(runs.values())).stage_names, start=1)
    legend = ", ".join(f"{number} {style.readable(name)}" for number, name in names)
    axes.set_title(legend, loc="left", pad=4, fontsize=style.TEXT)
    handles: list[Artist] = []
    if any(span.early is not None for run in runs.values() for span in run.spans):
        handles.append(style.patch_entry("next stage already acts", facecolor=style.EARLY))
    style.add_legend(figure, [*handles, *([style.entry("published end", **PUBLISHED)] if published else [])])
    return figure


def _draw_schedule(axes: Axes, runs: Mapping[str, Sequence[Span]]) -> None:
    """Draw the stages of each run as numbered bars in a row with its name, and early starts below them."""
    axes.set_yticks(range(len(runs)), [fill(name, 12) for name in runs])
    axes.tick_params(axis="y", length=0)
    axes.set_ylim(len(runs) - 0.5, -0.6)
    look: dict[str, Any] = {"edgecolor": style.EDGE, "linewidth": 0.5}
    for row, spans in enumerate(runs.values()):
        for span in spans:
            face = style.STAGE if span.index % 2 else "white"
            axes.barh(row, span.end - span.start, 0.46, span.start, facecolor=face, **look)
            middle = (span.start + span.end) / 2
            axes.text(middle, row, str(span.index + 1), fontsize=style.TEXT, ha="center", va="center_baseline")
            if span.early is not None:
                axes.barh(row + 0.32, span.start - span.early, 0.18, span.early, facecolor=style.EARLY, **look)


def plot_pending_cost(panels: Panels) -> Figure:
    """Plot how far ahead the planned switch time is [s], the control's variation, and J over the instant [s].

    J is over its value at the earliest instant that can be met, the other variables optimized; circles are its minima,
    triangles what the free optimizer returns.
    """
    figure = style.new_figure(4 * HEIGHT + 2 * AXIS + MARGIN)
    ahead, variation, printed, ours = figure.subplots(4, 1)
    _plot_over_time((ahead, variation), panels)
    ours.sharex(printed)
    end = float(panels["instant"][HORIZON][1][0])
    for axes, objective, letter in ((printed, "printed", "c"), (ours, "ours", "d")):
        curves, minima, found = (panels[f"{what}, {objective}"] for what in ("J", "minima", "found"))
        _plot_scan(axes, curves, minima, found, end)
        axes.set_ylabel(f"$J$, {'ours' if objective == 'ours' else 'δ = 0'}\n(relative)")
        axes.set_title(f"({letter})", loc="left", pad=3.5, fontsize=style.TEXT)
    style.panel_legend(printed, "(c)")
    printed.tick_params(labelbottom=False)
    ours.set_xlabel("Switch time $t_s$ after $T_0$ (s)")
    figure.align_ylabels()
    return figure


def plot_normalization(panels: Panels) -> Figure:
    """Plot the stages of each run [s], how far ahead the planned switch time is [s], and the control's variation."""
    runs = len(panels["stages"])
    figure = style.new_figure(runs * ROW + 2 * HEIGHT + AXIS + MARGIN + style.LINE)
    stages, ahead, variation = figure.subplots(3, 1, height_ratios=[runs * ROW, HEIGHT, HEIGHT])
    _plot_stages(stages, panels["stages"])
    _plot_over_time((ahead, variation), panels, "bc")
    stages.sharex(ahead)
    sizes = [y[y > 0] for _, y in panels["variation"].values() if np.any(y > 0)]
    if sizes:
        style.make_logarithmic(variation, subs=(1.0,))
        variation.set_ylim(max(min(float(y.min()) for y in sizes), 0.1), 2.0 * max(float(y.max()) for y in sizes))
    figure.align_ylabels([ahead, variation])
    return figure


def plot_discretization(panels: Panels) -> Figure:
    """Plot over N_s the prediction's error [m, rad], the miss at the switch [tolerances] and the run's end [s].

    A form whose prediction has no error to speak of is named above its panel.
    """
    figure = style.new_figure(3 * HEIGHT + AXIS + MARGIN)
    rows = figure.subplots(3, 1, sharex=True)
    labels = ("Prediction error\n(m, rad)", "Miss at $t_s$\n(tolerances)", "End of\nthe run (s)")
    for axes, panel, label, letter in zip(rows, ("error", "missed", "end"), labels, "abc", strict=True):
        without = []
        for i, (kind, (nodes, values)) in enumerate(panels[panel].items()):
            if panel == "error" and not np.any(values > EXACT):
                without.append(f"{NAMES.get(kind, kind)}: below 10{_raised(round(np.log10(EXACT)))}")
                continue
            axes.plot(nodes, values, marker=style.MARKERS[i], label=NAMES.get(kind, kind), **style.line_look(i))
        axes.set_ylabel(label)
        style.panel_legend(axes, "   ".join((f"({letter})", *without)))
    style.make_logarithmic(rows[0])
    rows[1].set_ylim(bottom=0.0)
    for axes in rows:
        axes.margins(y=0.12)
    _count_nodes(rows[-1], panels["end"])
    figure.align_ylabels()
    return figure


def _raised(exponent: int) -> str:
    """Return a whole number as superscript."""
    return str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def _count_nodes(axes: Axes, curves: Curves) -> None:
    """Make the axis one of N_s, with the numbers that were tried."""
    counts = sorted({float(n) for nodes, _ in curves.values() for n in nodes})
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(FixedLocator(counts))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.set_xlabel("Intervals of a stage ($N_s$)")


def _plot_over_time(rows: tuple[Axes, Axes], panels: Panels, letters: str = "ab") -> None:
    """Plot how far ahead the planned switch time is [s], a point a sample, and the variation of the joints' control."""
    above, below = rows
    runs = [label for label in panels["instant"] if label != HORIZON]
    for i, label in enumerate(runs):
        name, color = NAMES.get(label, label), style.PALETTE[i]
        look: dict[str, Any] = {"marker": style.MARKERS[i], "linestyle": "none", "markeredgecolor": "none"}
        above.plot(*panels["instant"][label], color=color, label=name, markersize=2.0, **look)
        below.plot(*panels["variation"][label], label=name, **style.line_look(i))
    time, ahead = panels["instant"][HORIZON]
    above.plot(time, ahead, color=style.EDGE, linewidth=0.7, label="$T_f$", zorder=1.5)
    above.set_ylim(0.0, 1.06 * float(ahead[0]))
    above.set_ylabel("Planned switch\ntime from now (s)")
    below.set_ylabel("Variation of joint\ncontrol (rad/s$^2$)")
    below.set_ylim(bottom=0.0)
    below.sharex(above)
    above.tick_params(labelbottom=False)
    above.margins(x=0.012)
    below.set_xlabel("Time (s)")
    style.panel_legend(above, f"({letters[0]})")
    style.panel_legend(below, f"({letters[1]})")


def _plot_scan(axes: Axes, curves: Curves, minima: Curves, found: Curves, end: float) -> None:
    """Plot J over the instant for each ratio of priorities, its minima, and what the optimizer returns."""
    earliest = min(float(instants[0]) for instants, _ in curves.values())
    axes.axvspan(0.0, earliest, facecolor="#DDDDDD", edgecolor="none", zorder=0)
    axes.text(earliest / 2, 0.5, "infeasible", transform=axes.get_xaxis_transform(), fontsize=style.TEXT, ha="center")
    axes.axvline(end, color=style.EDGE, linewidth=0.7, zorder=1.5)
    for i, (label, (instants, cost)) in enumerate(curves.items()):
        look = style.line_look(i + 2)
        axes.plot(instants, cost, label=label, **look)
        marks: dict[str, Any] = {"color": look["color"], "markeredgecolor": "black", "clip_on": False, "zorder": 4}
        axes.plot(*minima[label], "o", markersize=4.5, **marks)
        axes.plot(*found[label], "v", markersize=5, **marks)
    for marker, size, name in (("o", 4.5, "minimum"), ("v", 5, "returned")):
        axes.plot([], [], marker, color="white", markersize=size, markeredgecolor="black", label=name)
    axes.set_xlim(0.0, 1.01 * end)
    axes.margins(y=0.12)
    axes.set_ylim(bottom=0.0)
    axes.xaxis.set_major_locator(MaxNLocator(nbins=8, steps=[1, 2, 5, 10]))


def _plot_stages(axes: Axes, runs: Curves) -> None:
    """Draw the stages of each run, given as the starts and ends of its stages, infinite or NaN if it has none."""
    spans: dict[str, list[Span]] = {}
    for label, (starts, ends) in runs.items():
        times = zip(starts, np.r_[0.0, ends[:-1]], ends, strict=True)
        spans[NAMES.get(label, label)] = [
            Span(index, "", begin, end, start if start < begin else None)
            for index, (start, begin, end) in enumerate(times)
            if np.isfinite([begin, end]).all()
        ]
    _draw_schedule(axes, spans)
    axes.tick_params(labelbottom=False)
    keys = [
        style.patch_entry("stage, by number", facecolor="white"),
        style.patch_entry("next one already acts", facecolor=style.EARLY),
    ]
    axes.legend(handles=keys, loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=2, handlelength=1.0)
    axes.set_title("(a)", loc="left", pad=3.5, fontsize=style.TEXT)
