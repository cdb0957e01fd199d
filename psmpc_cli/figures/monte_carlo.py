"""The runs of a Monte Carlo study: how often they succeed, when their stages end, how near to limits they come."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from psmpc_cli.figures import style
from psmpc_cli.studies.monte_carlo import MonteCarloRuns


def plot_success(runs: MonteCarloRuns) -> Figure:
    """Plot the fraction of the runs whose stages have ended over time [s], below a line with the success rate.

    The times of a stage are relative to their median, which the legend names; those of the last one are the ends of the
    mission. A curve that ends below 1 belongs to a stage that not every run has ended.
    """
    xlabel = "Switch time that ends the stage, less its median (s)"
    figure, (axes,) = style.stack(["Fraction of runs (1)"], [2.2], xlabel)
    times = runs["switch_time"]
    made = int(runs.made.sum())
    for number, stage in enumerate(runs.stages):
        ended = np.sort(times[np.isfinite(times[:, number]), number])
        if len(ended):
            median = float(np.median(ended))
            fraction = np.arange(len(ended) + 1) / made
            label = f"{style.readable(stage)}, {median:.1f} s"
            axes.step(np.r_[ended[0], ended] - median, fraction, where="post", label=label, **style.line_look(number))
    axes.locator_params(axis="x", nbins=5)
    axes.set_ylim(-0.04, 1.04)
    style.panel_legend(axes, title="Stage, median of its end")
    low, high = (100 * bound for bound in runs.interval)
    rate = f"{runs.succeeded.sum()} of {made} runs succeeded; 95 % interval of the rate: {low:.0f} to {high:.0f} %"
    figure.suptitle(rate)
    return style.finish(figure)


def plot_runs(runs: MonteCarloRuns) -> Figure:
    """Plot final error [tolerances], tightest margins [%] and those of the monitors, by unit, of every run.

    Failed runs are ringed, or crosses on the lower edge where they have no values.
    """
    error = runs["final_error"]
    margins = {kind: 100 * runs[f"relative_{kind}_margin"] for kind in ("position", "velocity")}
    panels = [("Final error\n(tolerances)", {"": error}, 1.0, "tolerance")]
    panels.append(("Tightest margin\n(% of the limit)", margins, 0.0, "limit"))
    margins_of = {}
    if runs.monitors:
        margins_of = dict(zip(runs.monitors, runs["monitor_margin"].T, strict=True))
    for unit in dict.fromkeys(runs.monitors.values()):
        monitored = {style.readable(name): margins_of[name] for name, its in runs.monitors.items() if its == unit}
        panels.append((f"Margin of monitor\n({unit})", monitored, 0.0, "bound"))
    figure, rows = style.stack([label for label, *_ in panels], [1.1] * len(panels), "Seed of the run (1)")
    positive = error[np.isfinite(error) & (error > 0)]
    if len(positive) and positive.max() > 30.0 * positive.min():
        rows[0].set_yscale("log")
    else:
        rows[0].set_ylim(0.0, 1.12 * max(1.0, float(np.nanmax(error, initial=0.0))))
    seed = runs["seed"]
    failed = runs.failed
    for axes, (_, values, level, limit) in zip(rows, panels, strict=True):
        for number, (name, value) in enumerate(values.items()):
            look = {"linestyle": "none", "markersize": 3.0, "markeredgewidth": 0, **style.mark_look(number)}
            axes.plot(seed, value, label=name or "_", **look)
            axes.plot(seed[failed], value[failed], **style.look("ring around a failed run", label="_"))
        axes.margins(y=0.12)
        known = np.isfinite(list(values.values())).any(axis=0)
        if (failed & known).any():
            axes.plot([], [], **style.look("ring around a failed run", label="failed"))
        if (lost := seed[failed & ~known]).size:  # along the lower edge
            look = style.look("failed", label="failed, no value", transform=axes.get_xaxis_transform(), clip_on=False)
            axes.plot(lost, np.zeros(len(lost)), **look)
        axes.axhline(level, label=limit, **style.LEVEL)
        style.panel_legend(axes)
    rows[-1].xaxis.set_major_locator(MaxNLocator(integer=True))
    return style.finish(figure)
