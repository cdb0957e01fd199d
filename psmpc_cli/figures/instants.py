"""Planned switch times, the stages' shares and solve times over time. Paper Figs. 1 and 11."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from psmpc_cli.control.window_builder import priorities_in_force
from psmpc_cli.figures import style
from psmpc_cli.figures.timeline import label_row, runs_of, timeline
from psmpc_cli.logs.run import Run

HATCHES = ("", "//////", "......")
"""Patterns that go with the colours, so that a print in grey can be read as well."""


def plot_instants(runs: Run | Mapping[str, Run]) -> Figure:
    """Plot the planned switch time that ends each stage [s], and how far it is from the actual one [ms].

    A switch happens when its planned time meets the line of the present time; the horizon ends T_h above that line.
    The second row is there only if a planned switch happened.
    """
    planned = [np.isfinite(run["window/instants"]) for run in runs_of(runs)]
    any_planned = np.flatnonzero(np.any([seen.any(axis=0) for seen in planned], axis=0)).tolist()
    off = [run["window/instants"] - run.stages["switch_time"] for run in runs_of(runs)]
    happened = any(np.isfinite(values).any() for values in off)
    figure, grid = timeline(runs, 2 if happened else 1, 1.5)
    for column, run, seen, late in zip(grid.T, runs_of(runs), planned, off, strict=True):
        above = column[0]
        ends = run.motion.time[[0, -1]]
        horizon = run.task.spec.controller.horizon
        above.plot(ends, ends, label="_present time", **style.LEVEL)
        above.plot(ends, ends + horizon, label="_end of the horizon", linestyle=style.DASHED, **style.LEVEL)
        above.set_ylim(bottom=ends[0])
        switches = run.stages["switch_time"]
        for stage in any_planned:
            time = run.time[seen[:, stage]]
            instant = run["window/instants"][seen[:, stage], stage]
            look: dict[str, Any] = {"markevery": 10**6, "linewidth": 1.3, **style.mark_look(stage)}
            above.plot(time, instant, label=style.readable(run.stage_names[stage]), **look)
            if np.isfinite(switches[stage]):
                column[1].plot(time, 1e3 * late[seen[:, stage], stage], **look)
        look = {"color": "black", "markerfacecolor": "white", "markersize": 3.5, "zorder": 3}
        above.plot(switches, switches, "o", label="_actual switch", **look)
        if happened:
            column[1].axhline(0.0, **style.LEVEL)
    label_row(grid[0], "Planned switch\ntime (s)", "" if any_planned else "no switch time was planned")
    if happened:
        grid[1, 0].set_ylabel("Planned minus\nactual (ms)")
    return style.finish(figure)


def plot_shares(runs: Run | Mapping[str, Run]) -> Figure:
    """Plot each stage's share [%] in the window's weighted cost and in the applied control, of one or several runs.

    The cost is omega_s J_s of the window's stages; the pending cost, which belongs to no stage, is left out. The share
    in the control is the stage's weight in that combination of the controls all stages in the window would apply on
    their own which is nearest to the applied one; its panel is there only if those shares were logged.
    """
    shares = {"weighted cost": [cost_shares(run) for run in runs_of(runs)]}
    logged = [run["window/share"] for run in runs_of(runs)]
    if any(np.isfinite(values).any() for values in logged):
        shares["applied control"] = logged
    figure, grid = timeline(runs, len(shares), 1.2, shaded=False)
    for panels, (whole, found) in zip(grid, shares.items(), strict=True):
        for axes, run, values in zip(panels, runs_of(runs), found, strict=True):
            _plot_stack(axes, run, values)
            if not np.isfinite(values).any(axis=1).all():
                axes.bar(run.time[0], 0, color="white", label=["_no share: stages agree, or no solution"])
        panels[0].set_ylabel(f"Share in the\n{whole} (%)")
    label_row(grid[0], grid[0, 0].get_ylabel())  # one legend serves both rows
    return style.finish(figure)


def cost_shares(run: Run) -> np.ndarray:
    """Return each stage's share in the sum of omega_s J_s of the window (K, S); NaN outside the window."""
    omega = priorities_in_force(run.task.spec.controller, run.problem.stages)
    cost = np.maximum(run["window/cost"], 0.0) * omega
    total = np.nansum(cost, axis=1, keepdims=True)
    return np.asarray(cost / np.where(total > 0, total, np.nan))


def _plot_stack(axes: Axes, run: Run, shares: np.ndarray) -> None:
    """Stack the shares (K, S), a step a sample, and mark when stages end and when the next one starts early."""
    last = run.time[-1]
    edges = np.r_[run.time, run.motion.end if run.motion.end > last else last + run.task.spec.controller.sample_time]
    top = np.zeros(len(run.time))
    for stage in np.flatnonzero(np.isfinite(shares).any(axis=0)).tolist():
        bottom = top
        top = top + 100 * np.nan_to_num(shares[:, stage])
        label = style.readable(run.stage_names[stage])
        color = style.PALETTE[stage % len(style.PALETTE)]
        look: dict[str, Any] = {"facecolor": (color, 0.75), "hatch": HATCHES[stage % len(HATCHES)], "zorder": 1}
        axes.stairs(top, edges, baseline=bottom, fill=True, label=label, edgecolor="white", linewidth=0.0, **look)
    for span in run.spans:
        if span.index:
            axes.axvline(span.start, color="black", linewidth=0.6, label="_switch")
        if span.early is not None:
            axes.axvline(span.early, **style.look("early start"))
    axes.set_ylim(0, 100)


def plot_solve_time(run: Run) -> Figure:
    """Plot the wall time [ms] and the iterations of each solve over time, by how many stages were in the window."""
    figure, grid = timeline(run, 2, 1.25)
    above, below = grid[:, 0]
    time = run.time
    wall = run["solver/wall_time"] * 1e3
    iterations = run["solver/iterations"]
    count = run["window/count"]
    solved = np.isfinite(wall) & (wall > 0)
    counts = np.unique(count[solved])
    for i, stages in enumerate(counts):
        which = solved & (count == stages)
        label = f"{stages} stage{'s' if stages > 1 else ''}{' in the window' if stages == counts[-1] else ''}"
        for axes, values in ((above, wall), (below, iterations)):
            axes.plot(time[which], values[which], label=label, linestyle="none", markersize=1.8, **style.mark_look(i))
    limit = run.task.spec.controller.sample_time * 1e3
    above.axhline(limit, label=f"_sample time, {limit:g} ms", **style.LEVEL)
    style.make_logarithmic(above)
    above.margins(y=0.1)
    below.set_ylabel("Iterations of\nthe solve (1)")
    below.margins(y=0.1)
    below.set_ylim(bottom=0)
    below.yaxis.set_major_locator(MaxNLocator(integer=True, nbins=5, steps=[1, 2, 5, 10]))
    label_row(grid[0], "Solve time\n(ms)")
    failed = run["events/solve_failed"].astype(bool)
    if np.any(failed):
        for axes, values in ((above, np.where(solved, wall, limit)), (below, iterations)):
            axes.plot(time[failed], values[failed], **style.look("failed", label="_failed solve"))
    return style.finish(figure)


def plot_pull(run: Run) -> Figure:
    """Plot the filtered pull [N] on each grasp over time, the strength, and where grasps closed and opened."""
    figure, grid = timeline(run, 1, 1.6)
    capture = run.task.spec.capture
    axes = grid[0, 0]
    for i, gripper in enumerate(run["gripper"]):
        held = np.where(run["grasp/closed"][:, i] == 1, run["grasp/pull"][:, i], np.nan)
        axes.plot(run.time, held, label=style.readable(str(gripper)), **style.line_look(i))
        if run["grasp/lost"][i] == 1:
            axes.plot(run["grasp/opened_at"][i], np.nanmax(held), **style.look("failed", label="_lost"))
    strength = capture.grasp.largest_pull if capture else np.inf
    if np.isfinite(strength):
        axes.axhline(strength, label=f"_strength, {strength:g} N", **style.LEVEL)
    label_row(grid[0], "Pull on a\ngrasp (N)")
    return style.finish(figure)
