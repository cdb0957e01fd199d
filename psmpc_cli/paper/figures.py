"""What the reproduction of the paper shows beside its claims, and the ablations of what departs from the paper."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from textwrap import fill
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from psmpc_cli.figures import style
from psmpc_cli.figures.registry import save_figure
from psmpc_cli.figures.timeline import draw_stages, label_row, place_bars, timeline
from psmpc_cli.logs.run import Run, Span
from psmpc_cli.logs.verdicts import judge_monitor, monitor_bounds, monitored_signal
from psmpc_cli.paper.ablations import Ablation

Curves = Mapping[str, tuple[np.ndarray, np.ndarray]]
Panels = Mapping[str, Curves]
"""Curves (x, y) by panel and label, as the ablations measure them."""

SMALLEST = 1e-5
EXACT = 1e-9
"""A smaller control that a waiting stage adds is not shown [m/s^2, rad/s^2]; smaller errors are none [m, rad]."""


class PresenceScale(NamedTuple):
    """How the presence of waiting stages in the control is drawn: label of the axis, smallest value, kind of scale."""

    label: str
    smallest: float
    logarithmic: bool


PRESENCE: Mapping[str, PresenceScale] = {
    "control": PresenceScale("Control added by a waiting stage\n(m/s², rad/s²)", SMALLEST, logarithmic=True),
    "closeness": PresenceScale("Closeness to a waiting stage's\nown optimum (1)", -1.0, logarithmic=False),
}
"""The scale by what the task's `onset` compares with its threshold."""

HEIGHT = 1.0
"""Height of a panel [in]."""

OVER_TIME = ("Planned switch\ntime from now (s)", "Variation of joint\ncontrol (rad/s²)")

HORIZON = "T_f"
"""The curve that says how far ahead the horizon ends."""

NAMES: Mapping[str, str] = {
    "ours": "ours",
    "printed": "as printed, δ = 0",
    "range and printed": "range, δ = 0",
    "exact": "exact",
    "euler": "Euler, as printed",
}
"""Runs and forms as the legends have them; other labels stand for themselves."""


def has_waiting_stage(run: Run) -> bool:
    """Tell whether a stage ever waits in a run while another one is on."""
    return bool(np.isfinite(run["window/presence"]).any())


def plot_presence(run: Run, published: Mapping[str, float] = {}) -> Figure:
    """Plot the presence of each waiting stage over time, with the threshold from which on it counts as started.

    A stage waits while it is in the window behind the current one. Its presence is how much it acts on the control by
    then, measured as the task's `onset` says. Marks on the threshold are the published starts. Paper sections III-E and
    IV-B.

    Args:
        run: The run, in which a stage waits.
        published: Published actual starts by stage [s].
    """
    presence = run["window/presence"]
    waiting = np.flatnonzero(np.isfinite(presence).any(axis=0)).tolist()
    figure, grid = timeline(run, 1, 2.4, stage_look=lambda stage: {"facecolor": style.line_look(stage)["color"]})
    axes: Axes = grid[0, 0]
    time = run.time
    onset = run.task.spec.onset
    scale = PRESENCE[onset.kind]
    for stage in waiting:
        is_waiting = np.isfinite(presence[:, stage])
        values = np.maximum(presence[is_waiting, stage], scale.smallest)
        axes.plot(time[is_waiting], values, gid=run.stage_names[stage], label="_", **style.line_look(stage))
    axes.axhline(onset.epsilon, label="_threshold", **style.LEVEL)
    for start in published.values():
        axes.plot(start, onset.epsilon, **style.look("published start"))
    if scale.logarithmic:
        axes.set_yscale("log")
        axes.set_ylim(bottom=scale.smallest)
    label_row(grid[0], scale.label)
    return style.finish(figure)


def plot_monitors(run: Run) -> Figure:
    """Plot for every monitor of the task the quantity that it judges, over time.

    A monitor is a bound on a distance or speed during one stage. The bound is drawn over that stage, and a mark where
    the quantity first left it. The task needs at least one monitor.
    """
    monitors = run.task.spec.monitors
    figure, grid = timeline(run, len(monitors), 1.6)
    for row, monitor in enumerate(monitors):
        verdict = judge_monitor(monitor, run.arrays)
        axes: Axes = grid[row, 0]
        time = run.time
        values = monitored_signal(monitor, run.arrays)
        axes.plot(time, values, color=style.PALETTE[0])
        during = run["window/first"] == run.stage_names.index(monitor.during)
        # bounds may be relative to the value at the beginning of the stage
        for bound, _ in monitor_bounds(monitor, float(values[during][0])) if during.any() else ():
            axes.plot(time[during][[0, -1]], [bound, bound], **style.look("bound"))
        if np.isfinite(verdict.broken_at):
            value = np.interp(verdict.broken_at, time, values)
            axes.plot(verdict.broken_at, value, **style.look("broken"))
        frames = " and ".join(map(style.readable, [*monitor.of, "base"][:2]))
        label = "Speed (m/s)" if monitor.quantity == "speed" else f"Distance of\n{frames} (m)"
        label_row(grid[row], label, f"{style.readable(monitor.name)} during {style.readable(monitor.during)}")
    return style.finish(figure)


def plot_schedule(runs: Mapping[str, Run], published: Mapping[str, Mapping[str, float]] = {}) -> Figure:
    """Plot the stages of every method as bars, with early starts and marks at the published ends.

    Args:
        runs: By method.
        published: Published ends by method and stage [s].
    """
    figure, (axes,) = style.stack([""], [0.5 * len(runs)], "Time (s)")
    latest = max((time for name in runs for time in published.get(name, {}).values()), default=0.0)
    _draw_schedule(axes, {style.escape_dollars(style.title_of(name)): run.spans for name, run in runs.items()}, latest)
    for name, y in zip(runs, axes.get_yticks(), strict=True):
        for time in published.get(name, {}).values():
            axes.plot(time, y - 1.3, **style.look("published end"))
    return style.finish(figure)


def _draw_schedule(axes: Axes, schedules: Mapping[str, Sequence[Span]], latest: float = 0.0) -> None:
    """Draw the stages of each run in rows beside its name; the axis reaches the last end, and a latest mark [s]."""
    end = max((span.end for spans in schedules.values() for span in spans), default=1.0)
    view = (0.0, max(1.01 * end, 1.02 * latest))
    bars = place_bars(list(schedules.values()), view, style.AXIS_WIDTH)
    deep = 1.7 + max((bar.row for placed in bars for bar in placed), default=1)
    axes.set_yticks(deep * np.arange(len(bars)) + 1, [fill(name, 12) for name in schedules])
    axes.tick_params(axis="y", length=0)
    axes.set(ylim=(deep * len(bars), -0.7), xlim=view)
    for number, placed in enumerate(bars):
        draw_stages(axes, placed, first_row=deep * number)


def plot_pending_cost(panels: Panels) -> Figure:
    """Plot what the pending cost changes: the figure of the ablation `pending_cost`, in four rows.

    (a) how far ahead the planned switch time is over a run [s], (b) the variation of the joints' control, and (c), (d)
    the cost J of single windows over their switch time, as printed and with the pending cost. J is over its value at
    the earliest feasible switch time. Circles are its minima, triangles what the free optimizer returns.

    Args:
        panels: Curves by panel and label, as `run_ablations` computes them.
    """
    labels = [*OVER_TIME, "$J$, δ = 0\n(relative)", "$J$, ours\n(relative)"]
    heights = [HEIGHT] * 4
    x_label = "Switch time $t_s$ after $T_0$ (s)"
    figure, (ahead, variation, printed, ours) = style.stack(labels, heights, x_label, False)
    _plot_over_time(ahead, variation, panels, "ab")
    ours.sharex(printed)
    for axes, form in ((printed, "printed"), (ours, "ours")):
        _plot_cost_over_switch_time(axes, panels, form, end=float(panels["instant"][HORIZON][1][0]))
    style.panel_legend(printed, "(c)")
    ours.set_title("(d)")  # the same legend
    printed.tick_params(labelbottom=False)
    return style.finish(figure)


def plot_normalization(panels: Panels) -> Figure:
    """Plot what the normalization of costs changes: the figure of the ablation `normalization`, in three rows.

    (a) the stages of each run as bars, (b) how far ahead the planned switch time is [s], and (c) the variation of the
    joints' control, on a logarithmic axis.

    Args:
        panels: Curves by panel and label, as `run_ablations` computes them. Those of `stages` are the starts and ends
            of the stages of a run, infinite or NaN where there is none; such stages are not drawn.
    """
    heights = [0.35 * len(panels["stages"]), HEIGHT, HEIGHT]
    figure, (stages, ahead, variation) = style.stack(["", *OVER_TIME], heights, "Time (s)", False)
    spans = {
        NAMES.get(label, label): [
            Span(index, str(index + 1), begin, end, start if start < begin else None)
            # a stage begins where the one before it ends, and has started early if `start` is before that
            for index, (start, begin, end) in enumerate(zip(starts, np.r_[0.0, ends[:-1]], ends, strict=True))
            if np.isfinite([begin, end]).all()
        ]
        for label, (starts, ends) in panels["stages"].items()
    }
    _draw_schedule(stages, spans)
    _plot_over_time(ahead, variation, panels, "bc")
    stages.sharex(ahead)
    stages.tick_params(labelbottom=False)
    style.panel_legend(stages, "(a) stages by number")
    sizes = np.concatenate([y[y > 0] for _, y in panels["variation"].values()])
    if len(sizes):
        style.make_logarithmic(variation, subs=(1.0,))
        variation.set_ylim(max(float(sizes.min()), 0.1), 2.0 * float(sizes.max()))
    return style.finish(figure)


def plot_discretization(panels: Panels) -> Figure:
    """Plot what the discretization changes: the figure of the ablation `discretization`, over N_s, in three rows.

    (a) the error of predicted coordinates [m, rad], (b) by how much the end condition is missed at the switch
    [tolerances], and (c) when the run ends [s]. A discretization whose errors are all below `EXACT` has no curve on the
    logarithmic axis of (a), and is named above it.

    Args:
        panels: Curves by panel and label, as `run_ablations` computes them.
    """
    labels = ["Prediction error\n(m, rad)", "Miss at $t_s$\n(tolerances)", "End of\nthe run (s)"]
    figure, rows = style.stack(labels, [HEIGHT] * 3, "Intervals of a stage, $N_s$ (1)")
    style.make_logarithmic(rows[0])
    for axes, panel, letter in zip(rows, ("error", "missed", "end"), "abc", strict=True):
        note = f"({letter})"
        for i, (kind, (nodes, values)) in enumerate(panels[panel].items()):
            if panel == "error" and not np.any(values > EXACT):
                note += f"   {NAMES.get(kind, kind)}: below $10^{{{np.log10(EXACT):.0f}}}$"
            else:
                axes.plot(nodes, values, marker=style.MARKERS[i], label=NAMES.get(kind, kind), **style.line_look(i))
        axes.margins(y=0.12)
        style.panel_legend(axes, note)
    rows[1].set_ylim(bottom=0.0)
    style.make_logarithmic(rows[-1], "x")
    rows[-1].set_xticks(sorted({float(n) for nodes, _ in panels["end"].values() for n in nodes}))
    return style.finish(figure)


def _plot_over_time(above: Axes, below: Axes, panels: Panels, letters: str) -> None:
    """Plot two quantities of several runs over time, one above the other.

    Above is how far ahead of each sample its planned switch time lies [s], with the end of the horizon as a line: a
    switch that is put off stays there. Below is the variation of the joints' control.

    Args:
        above: Axes of the planned switch times, a point a sample.
        below: Axes of the variation.
        panels: Times and values by quantity and label of the run.
        letters: Those of the two panels.
    """
    runs = [label for label in panels["instant"] if label != HORIZON]
    for i, label in enumerate(runs):
        name = NAMES.get(label, label)
        look = {"linestyle": "none", "markeredgecolor": "none", "markersize": 2.0, **style.mark_look(i)}
        above.plot(*panels["instant"][label], label=name, **look)
        below.plot(*panels["variation"][label], label=name, **style.line_look(i))
    time, ahead = panels["instant"][HORIZON]
    above.plot(time, ahead, label="$T_f$", **style.LEVEL)
    above.set_ylim(0.0, 1.06 * float(ahead[0]))
    below.set_ylim(bottom=0.0)
    below.sharex(above)
    above.tick_params(labelbottom=False)
    above.margins(x=0.012)
    below.set_xlabel("Time (s)")
    style.panel_legend(above, f"({letters[0]})")
    style.panel_legend(below, f"({letters[1]})")


def _plot_cost_over_switch_time(axes: Axes, panels: Panels, form: str, end: float) -> None:
    """Plot the cost J over the switch time for each ratio of priorities, its minima, and what the optimizer returns.

    Args:
        axes: Where it is drawn.
        panels: The panels `J`, `minima` and `found` of each form, with points by ratio.
        form: Form of the objective, `printed` or `ours`.
        end: The horizon [s], where a line is drawn.
    """
    curves, minima, found = (panels[f"{what}, {form}"] for what in ("J", "minima", "found"))
    earliest = min(float(switch_times[0]) for switch_times, _ in curves.values())
    axes.axvspan(0.0, earliest, facecolor="#DDDDDD", edgecolor="none", zorder=0)
    axes.text(earliest / 2, 0.5, "infeasible", transform=axes.get_xaxis_transform(), ha="center")
    axes.axvline(end, **style.LEVEL)
    marks: dict[str, Any] = {"markeredgecolor": "black", "linestyle": "none", "markersize": 4.5}
    for i, (label, curve) in enumerate(curves.items(), start=2):  # the first two colours are those of the runs
        axes.plot(*curve, label=label, **style.line_look(i))
        for marker, points in (("o", minima[label]), ("v", found[label])):
            axes.plot(*points, marker=marker, color=style.PALETTE[i], clip_on=False, zorder=4, **marks)
    for marker, name in (("o", "minimum"), ("v", "returned")):
        axes.plot([], [], marker=marker, color="white", label=name, **marks)  # for the legend alone
    axes.set_xlim(0.0, 1.01 * end)
    axes.margins(y=0.12)
    axes.set_ylim(bottom=0.0)
    axes.xaxis.set_major_locator(MaxNLocator(nbins=8, steps=[1, 2, 5, 10]))


ABLATIONS: Mapping[str, Callable[[Panels], Figure]] = {
    "pending_cost": plot_pending_cost,
    "normalization": plot_normalization,
    "discretization": plot_discretization,
}
"""The functions that make the figures of the ablations, by their names."""


def save_ablation(ablation: Ablation, folder: Path) -> Path:
    """Draw the figure of an ablation into a folder, over one that is there.

    Raises:
        InputError: It cannot be written.
    """
    draw = partial(ABLATIONS[ablation.name], ablation.panels)
    return save_figure(draw, folder / figure_of(ablation.name), force=True)


def figure_of(ablation: str) -> str:
    """Return the name of the file with the figure of an ablation."""
    return f"ablation_{ablation}.png"
