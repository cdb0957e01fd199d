"""Each stage's share in the objective and in the applied control. What Fig. 1 of the paper sketches."""

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from psmpc_cli.figures.panels import panel_legend
from psmpc_cli.figures.run import Run
from psmpc_cli.figures.style import EDGE, PALETTE, readable
from psmpc_cli.figures.timeline import DOTTED, open_timeline

HEIGHT = 1.2
"""Height of one panel [in]."""

HATCHES = ("", "//////", "......")
"""Patterns that go with the colours, so that a print in grey can be read as well."""

MOST_NAMES = 6
"""Stages that the legend names; of more it gives the numbers."""

HANDLE = 1.2
"""Length of the patches in the legend [em]."""


COST, CONTROL = "weighted cost", "applied control"
"""What the stages have shares in."""


def plot_shares(run: Run) -> Figure:
    """Return each stage's share [%] in the window's weighted cost, and in the applied control, over time.

    The cost is omega_s J_s of the window's stages; the pending cost, which belongs to no stage, is left out. The share
    in the control is the stage's weight in that combination of the controls all stages in the window would apply on
    their own which comes nearest to the applied one; its panel is there only if those shares were logged.
    """
    shares = logged_shares(run)
    timeline = open_timeline(run, len(shares), HEIGHT)
    for axes, (whole, values) in zip(timeline.panels, shares.items(), strict=True):
        plot_stack(axes, run, values)
        axes.set_ylabel(f"Share in the\n{whole} (%)")
    panel_legend(timeline.panels[0], "", HANDLE)
    return timeline.finish(blanks(*shares.values()))


def logged_shares(run: Run) -> dict[str, np.ndarray]:
    """Return each stage's share (K, S) in the weighted cost and, where those were logged, in the applied control."""
    shares, control = {COST: cost_shares(run)}, run.log["window/share"]
    return shares | {CONTROL: control} if np.isfinite(control).any() else shares


def cost_shares(run: Run) -> np.ndarray:
    """Return each stage's share in the sum of omega_s J_s of the window (K, S); NaN outside the window."""
    omega = np.ones(len(run.stages)) if run.task.controller.kind == "smpc" else run.log.stages["priority"]
    cost = np.maximum(run.log["window/cost"], 0.0) * omega
    total = np.nansum(cost, axis=1, keepdims=True)
    return np.asarray(cost / np.where(total > 0, total, np.nan))


def plot_stack(axes: Axes, run: Run, shares: np.ndarray) -> None:
    """Stack the shares (K, S), a step a sample, and mark when stages end and when the next one starts early."""
    last = run.log.time[-1]
    edges = np.r_[run.log.time, run.end if run.end > last else last + run.task.controller.sample_time]
    numbered, top = len(run.stages) > MOST_NAMES, np.zeros(len(run.log.time))
    for stage in np.flatnonzero(np.any(np.isfinite(shares), axis=0)):
        bottom, top = top, top + 100 * np.nan_to_num(shares[:, stage])
        axes.stairs(
            top,
            edges,
            baseline=bottom,
            fill=True,
            facecolor=_tint(PALETTE[stage % len(PALETTE)]),
            edgecolor="white",
            linewidth=0.0,
            zorder=1,
            hatch=HATCHES[stage % len(HATCHES)],
            label=str(stage + 1) if numbered else readable(run.log.stage_names[stage]),
        )
    for span in run.spans:
        if span.index:
            axes.axvline(span.start, color="black", linewidth=0.6)
        if span.early is not None:
            axes.axvline(span.early, color="black", linestyle=DOTTED, linewidth=0.8)
    axes.set_ylim(0, 100)


def _tint(color: str) -> tuple[float, ...]:
    """Return a colour mixed with white: filled areas need less of it than lines."""
    return tuple(0.75 * part + 0.25 for part in to_rgb(color))


def blanks(*shares: np.ndarray) -> list[Artist]:
    """Return what a legend says of samples without shares, where there are any."""
    if all(np.isfinite(values).any(axis=1).all() for values in shares):
        return []
    return [Patch(facecolor="white", edgecolor=EDGE, linewidth=0.4, label="no share: stages agree, or no solution")]
