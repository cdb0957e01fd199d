"""Planned switch times, the stages' shares and solve times over time. Paper Figs. 1 and 11."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from psmpc_cli.figures import style
from psmpc_cli.figures.timeline import DOTTED, open_timeline
from psmpc_cli.logs.run import Run

ACROSS = 4
"""Stages side by side in the lower panels of several runs."""

DASHED = (0, (5, 2))

HATCHES = ("", "//////", "......")
"""Patterns that go with the colours, so that a print in grey can be read as well."""

COST, CONTROL = "weighted cost", "applied control"
"""What the stages have shares in."""

PRESENT: Mapping[str, Any] = {"color": style.EDGE, "linewidth": 0.7}
"""Look of the line of the present time."""


def plot_instants(run: Run) -> Figure:
    """Plot the planned switch time that ends each stage [s], and how far it is from the actual one [ms].

    A switch happens when its planned time meets the line of the present time; the horizon ends T_h above that line.
    The second panel is there only if a planned switch happened.
    """
    planned, switches = _planned([run]), run.stages["switch_time"]
    happened = [stage for stage in planned if np.isfinite(switches[stage])]
    timeline = open_timeline(run, 2 if happened else 1, 1.5)
    above, below = timeline.panels[0, 0], timeline.panels[-1, 0]
    ends, horizon = np.array([run.motion.time[0], run.motion.end]), run.task.spec.controller.horizon
    above.plot(ends, ends, zorder=1.5, **PRESENT)
    above.plot(ends, ends + horizon, linestyle=DASHED, zorder=1.5, **PRESENT)
    above.set_ylim(ends[0], ends[1] + horizon)
    for stage in planned:
        time, instant = _planned_end(run, stage)
        look: dict[str, Any] = {"markevery": [0], "linewidth": 1.3, **style.mark_look(stage)}
        above.plot(time, instant, label=style.readable(run.stage_names[stage]), **look)
        if stage in happened:
            below.plot(time, 1e3 * (instant - switches[stage]), **look)
    above.plot(switches, switches, "o", color="black", markerfacecolor="white", markersize=3.5, zorder=3)
    timeline.label(0, "Planned switch\ntime (s)", "" if planned else "no switch time was planned")
    if happened:
        below.axhline(0.0, zorder=1.5, **PRESENT)
        below.set_ylabel("Planned minus\nactual (ms)")
    return timeline.finish(
        [
            style.entry("present time", **PRESENT),
            style.entry("actual switch", color="black", linestyle="none", marker="o", markerfacecolor="white"),
            style.entry("end of the horizon", linestyle=DASHED, **PRESENT),
        ]
    )


def _planned(runs: Iterable[Run]) -> list[int]:
    """Return the stages whose end any of these runs planned."""
    return sorted({int(s) for run in runs for s in np.flatnonzero(np.isfinite(run["window/instants"]).any(axis=0))})


def _planned_end(run: Run, stage: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the samples at which the end of a stage was planned, and for when, (K,) [s] each."""
    instants = run["window/instants"][:, stage]
    return run.time[np.isfinite(instants)], instants[np.isfinite(instants)]


def plot_compared_instants(runs: Mapping[str, Run]) -> Figure:
    """Plot the planned switch times of several runs [s], and by stage how far they are from the actual one [ms]."""
    planned, names = _planned(runs.values()), next(iter(runs.values())).stage_names
    across = min(ACROSS, len(planned)) or 1
    rows = -(-len(planned) // across)
    figure = style.new_figure(2.2 + rows * (1.5 + style.LINE) + 0.8, style.PAGE)
    grid = figure.add_gridspec(1 + rows, across, height_ratios=[2.2] + [1.5] * rows)
    overview, end = figure.add_subplot(grid[0, :]), max(run.motion.end for run in runs.values())
    overview.plot([0.0, end], [0.0, end], zorder=1.5, **PRESENT)
    overview.set(xlim=(0.0, end * 1.012), ylim=(0.0, end * 1.05), xlabel="Time (s)", ylabel="Planned switch\ntime (s)")
    shared: Axes | None = None
    for i, stage in enumerate(planned):
        axes = figure.add_subplot(grid[1 + i // across, i % across], sharey=shared, sharex=shared)
        shared = shared or axes
        axes.axhline(0.0, zorder=1.5, **PRESENT)
        for number, run in enumerate(runs.values()):
            (time, instant), end = _planned_end(run, stage), float(run.stages["switch_time"][stage])
            overview.plot(time, instant, linewidth=1.3, **style.line_look(number))
            if np.isfinite(end):
                axes.plot(time - end, 1e3 * (instant - end), linewidth=1.3, **style.line_look(number))
        axes.set_title(f"end of {style.readable(names[stage])}", fontsize=style.TEXT, pad=3)
        axes.set_xlabel("Time minus actual end (s)")
        axes.set_ylabel("Planned minus\nactual (ms)")
        axes.label_outer()
    handles: list[Artist] = []
    for number, (name, run) in enumerate(runs.items()):
        hollow = {"markersize": 4.5, "markeredgewidth": 0.9, "markerfacecolor": "none", **style.mark_look(number)}
        switches = run.stages["switch_time"]
        overview.plot(switches, switches, zorder=3, **hollow, linestyle="none")
        handles.append(style.entry(style.title_of(name), linewidth=1.3, **hollow | style.line_look(number)))
    style.add_legend(figure, [*handles, style.entry("present time; markers: actual switches", **PRESENT)])
    return figure


def plot_shares(runs: Run | Mapping[str, Run]) -> Figure:
    """Plot each stage's share [%] in the window's weighted cost and in the applied control, of one or several runs.

    The cost is omega_s J_s of the window's stages; the pending cost, which belongs to no stage, is left out. The share
    in the control is the stage's weight in that combination of the controls all stages in the window would apply on
    their own which is nearest to the applied one; its panel is there only if those shares were logged.
    """
    columns = [runs] if isinstance(runs, Run) else list(runs.values())
    shares = {COST: [cost_shares(run) for run in columns]}
    logged = [run["window/share"] for run in columns]
    if any(np.isfinite(values).any() for values in logged):
        shares[CONTROL] = logged
    timeline = open_timeline(runs, len(shares), 1.2, shaded=False)
    for row, (whole, found) in enumerate(shares.items()):
        for axes, run, values in zip(timeline.panels[row], columns, found, strict=True):
            _plot_stack(axes, run, values)
        timeline.panels[row, 0].set_ylabel(f"Share in the\n{whole} (%)")
    timeline.label(0, f"Share in the\n{COST} (%)")  # one legend serves both rows
    handles: list[Artist] = []
    if any(len(run.spans) > 1 for run in columns):
        handles.append(style.entry("switch", color="black", linewidth=0.6))
    if not all(np.isfinite(values).any(axis=1).all() for found in shares.values() for values in found):
        handles.append(style.patch_entry("no share: stages agree, or no solution", facecolor="white"))
    return timeline.finish(handles)


def cost_shares(run: Run) -> np.ndarray:
    """Return each stage's share in the sum of omega_s J_s of the window (K, S); NaN outside the window."""
    omega = np.ones(len(run.problem.stages)) if run.task.spec.controller.kind == "smpc" else run.stages["priority"]
    cost = np.maximum(run["window/cost"], 0.0) * omega
    total = np.nansum(cost, axis=1, keepdims=True)
    return np.asarray(cost / np.where(total > 0, total, np.nan))


def _plot_stack(axes: Axes, run: Run, shares: np.ndarray) -> None:
    """Stack the shares (K, S), a step a sample, and mark when stages end and when the next one starts early."""
    last = run.time[-1]
    edges = np.r_[run.time, run.motion.end if run.motion.end > last else last + run.task.spec.controller.sample_time]
    top = np.zeros(len(run.time))
    for stage in map(int, np.flatnonzero(np.any(np.isfinite(shares), axis=0))):
        bottom, top = top, top + 100 * np.nan_to_num(shares[:, stage])
        axes.stairs(
            top,
            edges,
            baseline=bottom,
            fill=True,
            facecolor=(style.PALETTE[stage % len(style.PALETTE)], 0.75),
            edgecolor="white",
            linewidth=0.0,
            zorder=1,
            hatch=HATCHES[stage % len(HATCHES)],
            label=style.readable(run.stage_names[stage]),
        )
    for span in run.spans:
        if span.index:
            axes.axvline(span.start, color="black", linewidth=0.6)
        if span.early is not None:
            axes.axvline(span.early, color="black", linestyle=DOTTED, linewidth=0.8)
    axes.set_ylim(0, 100)


def plot_solve_time(run: Run) -> Figure:
    """Plot the wall time [ms] and the iterations of each solve over time, by how many stages were in the window."""
    timeline = open_timeline(run, 2, 1.25)
    above, below = timeline.panels[:, 0]
    time, wall, iterations = run.time, run["solver/wall_time"] * 1e3, run["solver/iterations"]
    count, solved = run["window/count"], np.isfinite(wall) & (wall > 0)
    counts = np.unique(count[solved])
    for i, stages in enumerate(counts):
        which = solved & (count == stages)
        label = f"{stages} stage{'s' if stages > 1 else ''}{' in the window' if stages == counts[-1] else ''}"
        for axes, values in ((above, wall), (below, iterations)):
            axes.plot(time[which], values[which], label=label, linestyle="none", markersize=1.8, **style.mark_look(i))
    limit = run.task.spec.controller.sample_time * 1e3
    above.axhline(limit, **PRESENT)
    style.make_logarithmic(above)
    above.margins(y=0.1)
    below.set_ylabel("Iterations of\nthe solve (1)")
    below.margins(y=0.1)
    below.set_ylim(bottom=0)
    below.yaxis.set_major_locator(MaxNLocator(integer=True, nbins=5, steps=[1, 2, 5, 10]))
    timeline.label(0, "Solve time\n(ms)")
    handles = [style.entry(f"sample time, {limit:g} ms", **PRESENT)]
    failed = run["events/solve_failed"].astype(bool)
    if np.any(failed):
        for axes, values in ((above, np.where(solved, wall, limit)), (below, iterations)):
            axes.plot(time[failed], values[failed], **style.FAILED)
        handles.append(style.entry("failed solve", **style.FAILED))
    return timeline.finish(handles)
