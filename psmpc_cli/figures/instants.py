"""Planned switch times, the stages' shares, solve times, grasps and distances over time. Paper Figs. 1 and 11."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import StepPatch
from matplotlib.ticker import MaxNLocator

from psmpc_cli.control.window_builder import priorities_in_force
from psmpc_cli.figures import style
from psmpc_cli.figures.coordinates import LIMIT_DISTANCE
from psmpc_cli.figures.timeline import hide_panels, label_row, runs_as_list, timeline
from psmpc_cli.logs.run import Run
from psmpc_cli.robot.actuators.wheels import Wheels
from psmpc_cli.specs.object import GRASP_LOADS

HATCHES = ("", "//////", "......")
"""Patterns that go with the colours, so that a print in grey can be read as well."""


NOT_LOGGED = "shares in the applied control were not logged: log.shares is off"
"""Heading of the figure where these shares are missing by the task's choice."""

NOTHING_PLANNED = "no switch time was planned"
"""Note where no sample planned the end of a stage."""

LEVELS_OF_SWITCHES = ("present time", "end of horizon")
"""Names of the lines between which planned switch times lie."""

NEAREST_PAIRS = 6
"""Most pairs of parts whose distances have a line of their own."""

MARGINS_SHOWN = 10.0
"""Distances up to so many margins are always in view."""

BAR_HEIGHT = 0.8
"""Height of the bar of a thruster that fires throughout a sample, of its row."""


SHUT = "0.85"
"""Colour behind a thruster that is shut."""


def plans_switches(run: Run) -> bool:
    """Tell whether a run ever planned when a stage ends."""
    return bool(np.isfinite(run["window/instants"]).any())


def plot_instants(runs: Run | Mapping[str, Run]) -> Figure:
    """Plot how planned switch times change from sample to sample, to show whether plans foresee the actual switches.

    A switch time is the time at which one stage ends and the next one begins; the controller plans it anew at each
    sample. First row: the planned switch time that ends each stage [s] over the present time. A switch happens when its
    planned time meets the line of the present time. The horizon ends T_h above that line. Each sample is a point and
    points are not joined, because the planned time may jump between two samples. Second row: planned minus actual time
    [ms or s], if in any run a planned switch happened.

    Args:
        runs: A run, or several by controller, each in a column of its own.
    """
    deviations = [run["window/instants"] - run.stages["switch_time"] for run in runs_as_list(runs)]
    has_switch = [bool(np.isfinite(deviation).any()) for deviation in deviations]
    rows = 2 if any(has_switch) else 1
    unit, in_unit = _unit_of_deviations(deviations)
    figure, grid = timeline(runs, rows, 1.5, beside=LEVELS_OF_SWITCHES, stage_look=_color_of_stage)
    for column, run, deviation in zip(grid.T, runs_as_list(runs), deviations, strict=True):
        main_panel = column[0]
        ends = run.motion.time[[0, -1]]
        horizon = run.task.spec.controller.horizon
        main_panel.plot(ends, ends, label=LEVELS_OF_SWITCHES[0], **style.LEVEL)
        main_panel.plot(ends, ends + horizon, label=LEVELS_OF_SWITCHES[1], linestyle=style.DASHED, **style.LEVEL)

        instants = run["window/instants"]
        switch_time = run.stages["switch_time"]
        for stage, name in enumerate(run.stage_names):
            samples = np.isfinite(instants[:, stage])
            time = run.time[samples]
            look: dict[str, Any] = {"linestyle": "none", "markeredgecolor": "none", **style.mark_look(stage)}
            look["markersize"] = 2.0
            if samples.any():
                main_panel.plot(time, instants[samples, stage], gid=name, label=style.NO_LABEL, **look)
            if np.isfinite(deviation[:, stage]).any():
                column[1].plot(time, in_unit * deviation[samples, stage], label=style.NO_LABEL, **look)

        # on the line of the present time
        look = {"color": "black", "markerfacecolor": "white", "markersize": 3.5, "zorder": 3}
        main_panel.plot(switch_time, switch_time, "o", label=style.shared_label("actual switch"), **look)
        for axes in column[1:]:
            axes.axhline(0.0, **style.LEVEL)
    # after all is drawn, since the panels of the row share this limit
    grid[0, 0].set_ylim(bottom=min(run.motion.time[0] for run in runs_as_list(runs)))
    note = "" if any(map(plans_switches, runs_as_list(runs))) else NOTHING_PLANNED
    label_row(grid[0], "Planned switch\ntime (s)", note)
    if rows == 2:
        note = style.use_symlog_if_peaks_hide_rest(grid[1, 0], in_unit * np.vstack(deviations))
        label_row(grid[1], f"Planned minus\nactual ({unit})", note)
        hide_panels(grid, 1, [column for column, is_there in enumerate(has_switch) if not is_there])
    return style.finish(figure)


def _unit_of_deviations(deviations: Sequence[np.ndarray]) -> tuple[str, float]:
    """Return the unit in which deviations [s] are drawn, and how many of it make a second."""
    largest = max(float(np.nanmax(np.abs(each), initial=0.0)) for each in deviations)
    return ("s", 1.0) if largest > 1.0 else ("ms", 1e3)


def _color_of_stage(stage: int) -> dict[str, Any]:
    """Return the look of a stage's patch in the strip, in the colour of its curves."""
    return {"facecolor": style.mark_look(stage)["color"]}


def plot_shares(runs: Run | Mapping[str, Run]) -> Figure:
    """Plot how much each stage counts at every sample, to show which stages the controller works for: its shares [%].

    The window of a sample is the stages that the controller plans over. A stage's share in the weighted cost is
    omega_s J_s over the sum of this over the window's stages; the pending cost, which belongs to no stage, is left out.
    A stage's share in the control is a weight: each stage alone would apply a control of its own, and of the convex
    combinations of these controls the one nearest to the applied control has the shares as weights. The panel of shares
    in the control is there only if they were logged (`log.shares`).

    Args:
        runs: A run, or several by controller, each in a column of its own.
    """
    shares = {"weighted cost": [cost_shares(run) for run in runs_as_list(runs)]}
    logged = [run["window/share"] for run in runs_as_list(runs)]
    if any(np.isfinite(values).any() for values in logged):
        shares["applied control"] = logged
    figure, grid = timeline(runs, len(shares), 1.2, shaded=False, stage_look=_pattern_of_stage)
    for panels, (shared, shares_of_runs) in zip(grid, shares.items(), strict=True):
        for axes, run, values in zip(panels, runs_as_list(runs), shares_of_runs, strict=True):
            _stack_shares(axes, run, values)
            if not np.isfinite(values).any(axis=1).all():
                # a bar of no height: the entry of the white parts in the common legend
                axes.bar(
                    run.time[0], 0, color="white", label=[style.shared_label("no share: stages agree, or no solution")]
                )
        panels[0].set_ylabel(f"Share in the\n{shared} (%)")
    switched_off = len(shares) == 1 and not all(run.task.spec.log.shares for run in runs_as_list(runs))
    if switched_off:
        figure.suptitle(NOT_LOGGED)
    return style.finish(figure)


def cost_shares(run: Run) -> np.ndarray:
    """Compute each stage's share in the sum of omega_s J_s of the window (K, S); NaN outside the window."""
    omega = priorities_in_force(run.task.spec.controller, run.problem.stages)
    cost = np.maximum(run["window/cost"], 0.0) * omega
    total = np.nansum(cost, axis=1, keepdims=True)
    return np.asarray(cost / np.where(total > 0, total, np.nan))


def _stack_shares(axes: Axes, run: Run, shares: np.ndarray) -> None:
    """Draw the shares of stages as bands upon each other, and lines where a stage ends or the next one starts early.

    A share is the part of the cost or of the control that a stage accounts for.

    Args:
        axes: The panel, whose vertical axis is in percent.
        run: The run.
        shares: Shares (K, S) of S stages at K samples, from 0 to 1; NaN where a stage has none.
    """
    last_sample = run.time[-1]
    # a run that was cut off after its last sample has no state at the end of this sample
    end = run.motion.end if run.motion.end > last_sample else last_sample + run.task.spec.controller.sample_time
    edges = np.r_[run.time, end]
    top = np.zeros(len(run.time))
    for stage in np.flatnonzero(np.isfinite(shares).any(axis=0)).tolist():
        bottom = top
        top = top + 100 * np.nan_to_num(shares[:, stage])
        look: dict[str, Any] = {**_pattern_of_stage(stage), "baseline": bottom, "linewidth": 0.0, "zorder": 1}
        steps = StepPatch(top, edges, fill=True, gid=run.stage_names[stage], **look)
        axes.add_artist(steps)  # not add_patch, which looks for the limits of every step
    for span in run.spans:
        if span.index:
            axes.axvline(span.start, color="black", linewidth=0.6, label=style.shared_label("switch"))
        if span.early is not None:
            axes.axvline(span.early, **style.look("early start"))
    axes.set_ylim(0, 100)


def _pattern_of_stage(stage: int) -> dict[str, Any]:
    """Return the look of a stage's band of shares, and of its patch in the strip."""
    color = style.PALETTE[stage % len(style.PALETTE)]
    return {"facecolor": (color, 0.75), "edgecolor": "white", "hatch": HATCHES[stage % len(HATCHES)]}


def plot_solve_time(run: Run) -> Figure:
    """Plot wall time [ms] and iterations of each solve over time, to show whether the controller is fast enough.

    There is a point for each sample, coloured by how many stages were in the window that was solved. A line shows the
    sample time, within which a solve has to end in real time. Failed solves are crosses.
    """
    figure, grid = timeline(run, rows=2, height=1.25)
    above, below = grid[:, 0]
    time = run.time
    wall_time = run["solver/wall_time"] * 1e3
    iterations = run["solver/iterations"]
    stages_in_window = run["window/count"]
    solved = np.isfinite(wall_time) & (wall_time > 0)  # samples whose solve was timed
    stage_counts = np.unique(stages_in_window[solved])
    for color_number, stages in enumerate(stage_counts):
        samples = solved & (stages_in_window == stages)
        # the last label says what all of them count
        label = f"{stages} stage{'s' if stages > 1 else ''}{' in the window' if stages == stage_counts[-1] else ''}"
        for axes, values in ((above, wall_time), (below, iterations)):
            look = {"linestyle": "none", "markersize": 1.8, **style.mark_look(color_number)}
            axes.plot(time[samples], values[samples], label=label, **look)
    limit = run.task.spec.controller.sample_time * 1e3
    above.axhline(limit, label=style.shared_label(f"sample time, {limit:g} ms"), **style.LEVEL)
    style.make_logarithmic(above)
    above.margins(y=0.1)
    below.set_ylabel("Iterations of\nthe solve (1)")
    below.margins(y=0.1)
    below.set_title(style.use_symlog_if_peaks_hide_rest(below, iterations))
    if below.get_yscale() == "linear":
        below.yaxis.set_major_locator(MaxNLocator(integer=True, nbins=5, steps=[1, 2, 5, 10]))
    below.set_ylim(bottom=0)
    label_row(grid[0], "Solve time\n(ms)", style.better_side("down", "sooner"))
    failed = run["events/solve_failed"].astype(bool)
    if np.any(failed):
        for axes, values in ((above, np.where(solved, wall_time, limit)), (below, iterations)):
            axes.plot(time[failed], values[failed], **style.look("failed", label=style.shared_label("failed solve")))
    return style.finish(figure)


def plot_grasps(run: Run) -> Figure:
    """Plot the filtered loads on each grasp while it is closed: pull [N], shear [N] and moment [N m].

    The strength, the load beyond which a grasp is lost, is drawn if it is near the loads, and else named above the
    panel. A cross marks where a grasp was lost.
    """
    grippers = [style.readable(str(gripper)) for gripper in run["gripper"]]
    figure, grid = timeline(run, len(GRASP_LOADS), 1.2, beside=grippers)
    strengths = run.task.spec.body.grasp.largest_loads
    for (axes,), (load, unit), strength in zip(grid, GRASP_LOADS.items(), strengths, strict=True):
        loads = np.where(run["grasp/closed"] == 1, run[f"grasp/{load}"], np.nan)
        for number, (gripper, load_of_gripper) in enumerate(zip(grippers, loads.T, strict=True)):
            axes.plot(run.time, load_of_gripper, label=gripper, **style.line_look(number))
            if run["grasp/lost"][number] == 1:
                look = style.look("failed", label=style.shared_label("lost"))
                axes.plot(run["grasp/opened_at"][number], np.nanmax(load_of_gripper), **look)
        is_near = strength < LIMIT_DISTANCE * np.nanmax(np.abs(loads), initial=0.0)
        if is_near:
            axes.axhline(strength, label=style.shared_label(f"strength, {strength:g} {unit}"), **style.LEVEL)
        strength_note = f"strength {strength:g} {unit}, out of view" if np.isfinite(strength) and not is_near else ""
        label_row(
            [axes],
            f"{load.capitalize()} on a\ngrasp ({unit})",
            style.join_notes(strength_note, style.better_side("down")),
        )
    return style.finish(figure)


def plot_thrusters(run: Run) -> Figure:
    """Plot when thrusters fire: a row for each thruster, and in it a bar for each sample.

    A bar is as high as its duty: the impulse in the sample, divided by the impulse of a thruster that fires throughout
    it. The row is grey where the thruster is shut, since its plume would hit something.
    """
    robot = run.problem.model.spec
    sample_time = run.task.spec.controller.sample_time
    duty = run["thrusters/impulse"] / (sample_time * np.array([thruster.force for thruster in robot.thrusters]))
    n_thrusters = duty.shape[1]
    color = style.line_look(0)["color"]
    figure, grid = timeline(run, rows=1, height=0.3 + 0.2 * n_thrusters)
    axes = grid[0, 0]
    for thruster_row in range(n_thrusters):
        # thruster 1 is at the top: the axis goes downwards, so that bars which reach upwards have negative heights
        foot = thruster_row + 1 + BAR_HEIGHT / 2
        if "thrusters/shut" in run:
            shut = run["thrusters/shut"][:, thruster_row] > 0
            axes.bar(run.time[shut], -1.0, sample_time, bottom=thruster_row + 1.5, align="edge", color=SHUT)
        axes.bar(run.time, -BAR_HEIGHT * duty[:, thruster_row], sample_time, bottom=foot, align="edge", color=color)
    axes.set_ylim(n_thrusters + 0.7, 0.3)
    axes.set_yticks(range(1, n_thrusters + 1))
    axes.set_ylabel("Thruster")
    note = "\ngrey: shut because of its plume" if "thrusters/shut" in run else ""
    axes.set_title(f"full bar: it fires throughout the sample{note}")
    return style.finish(figure)


def plot_wheels(run: Run) -> Figure:
    """Plot the angular momentum of each reaction wheel [N m s] and the torque of its motor [N m] over time.

    A limit is drawn as two lines, one for either direction. If it is too far off to be in view, it is named above the
    panel.
    """
    wheels = Wheels.of(run.problem.model.spec)
    figure, grid = timeline(run, rows=2, height=1.4, beside=[str(name) for name in run["wheel"]])
    panels = (
        ("momentum", "Angular momentum", "N m s", wheels.momentum),
        ("torque", "Motor torque", "N m", wheels.torque),
    )
    for (axes,), (quantity, label, unit, limits) in zip(grid, panels, strict=True):
        values = run[f"wheels/{quantity}"]
        notes = []
        for i, name in enumerate(run["wheel"]):
            axes.plot(run.time, values[:, i], label=str(name), **style.line_look(i))
        for limit in np.unique(limits):
            if limit > LIMIT_DISTANCE * np.nanmax(np.abs(values), initial=0.0):
                notes.append(f"limit {limit:g} {unit}, out of view")
                continue
            for bound in (-limit, limit):
                axes.axhline(bound, label=style.shared_label(f"limits, {limit:g} {unit} both ways"), **style.LEVEL)
        label_row([axes], f"{label}\n({unit})", style.join_notes(*notes))
    return style.finish(figure)


@dataclass(frozen=True, eq=False)
class NearestPairs:
    """The pairs of parts of a run that come nearest to each other, at its K samples.

    Attributes:
        names: The two parts of each pair, the nearest pair first (P,).
        distances: Smallest distance of each pair over each sample (K, P) [m]; NaN where its parts may touch.
        others: Smallest distance of all other pairs (K,) [m]; NaN without others.
        n_others: Number of other pairs.
        margin: Distance that the current stage keeps (K,) [m]; NaN where it keeps none.
    """

    names: Sequence[tuple[str, str]]
    distances: np.ndarray
    others: np.ndarray
    n_others: int
    margin: np.ndarray

    @property
    def top(self) -> float:
        """Distance up to which they are worth looking at [m]."""
        largest = 1.25 * float(np.fmin.reduce(self.distances, axis=0).max())
        return max(MARGINS_SHOWN * float(np.nanmax(self.margin)), largest)


def has_distances(run: Run) -> bool:
    """Tell whether parts of a run keep clear of each other at any sample."""
    return "clearance/distance" in run and bool(np.isfinite(run["clearance/distance"]).any())


def nearest_pairs(run: Run) -> NearestPairs:
    """Find the pairs of parts that come nearest to each other in a run, for a figure that has no room for all pairs.

    At most `NEAREST_PAIRS` pairs are named, and all others are summed up by their smallest distance. Pairs whose parts
    may touch throughout the run are left out.
    """
    # columns of the logged distances (K, columns) that are of the same two parts: the log has a pair with the object
    # twice, with the object first while it is held, and last while it is free
    columns_by_pair = dict[frozenset[str], list[int]]()
    logged_pairs = [tuple(name.split(" - ")) for name in run["clearance/pair"].tolist()]
    for column in np.flatnonzero(np.isfinite(run["clearance/distance"]).any(axis=0)).tolist():
        columns_by_pair.setdefault(frozenset(logged_pairs[column]), []).append(column)
    names: list[tuple[str, str]] = []
    distances_of_pairs: list[np.ndarray] = []
    for columns in columns_by_pair.values():
        first, second = logged_pairs[columns[0]]
        names.append((first, second))
        distances_of_pairs.append(np.fmin.reduce(run["clearance/distance"][:, columns], axis=1))
    distances = np.column_stack(distances_of_pairs)

    order = np.argsort(np.nanmin(distances, axis=0), kind="stable")
    nearest, others = np.split(order, [NEAREST_PAIRS])
    # what the task asks for in the stage that is current at each sample
    keeping = [run.task.spec.clearance_of(stage) for stage in run["window/first"].tolist()]
    return NearestPairs(
        names=[names[pair] for pair in nearest],
        distances=distances[:, nearest],
        others=np.fmin.reduce(distances[:, others], axis=1, initial=np.nan),
        n_others=len(others),
        margin=np.array([np.nan if clearance is None else clearance.margin for clearance in keeping]),
    )


def name_of_pair(names: Sequence[str]) -> str:
    """Return the names of two parts as pages write them, and figures as a `escape_dollars`."""
    return " \N{EN DASH} ".join(map(style.words_of, names))


def plot_clearance(run: Run) -> Figure:
    """Plot how near parts of the robot come to each other, to obstacles and to the object, with the margin in force.

    The nearest pairs of parts have a line each, of their smallest distance [mm] over each sample; the other pairs share
    one line, the smallest of their distances. Distances far beyond the smallest ones are out of view. Where two parts
    overlap their distance is negative, and a cross is at its smallest value.
    """
    pairs = nearest_pairs(run)
    distances = 1e3 * pairs.distances
    others = 1e3 * pairs.others
    margin = 1e3 * pairs.margin
    smallest = np.nanmin(distances, axis=0)
    smallest_other = np.fmin.reduce(others)
    top = 1e3 * pairs.top

    figure, grid = timeline(run, rows=1, height=1.9)
    axes = grid[0, 0]
    edges = np.r_[run.time, run.motion.end]

    def draw(values: np.ndarray, **look: Any) -> None:
        """Draw values (K,) as steps, each over its sample."""
        axes.plot(edges, np.r_[values, values[-1]], drawstyle="steps-post", **look)

    for pair, names in enumerate(pairs.names):
        draw(
            distances[:, pair],
            label=style.shared_label(style.escape_dollars(name_of_pair(names))),
            **style.line_look(pair),
        )
    if smallest_other < top:
        draw(others, **style.look("other pairs", label=style.shared_label(f"nearest of {pairs.n_others} others")))
    margins = ", ".join(f"{value:g} mm" for value in np.unique(margin[np.isfinite(margin)]))
    draw(margin, **style.look("bound", label=style.shared_label(f"margin, {margins}")))
    axes.axhline(0.0, **style.LEVEL)
    for pair in np.flatnonzero(smallest < 0).tolist():
        deepest = np.nanargmin(distances[:, pair])
        look = style.look("failed", label=style.shared_label("touch"), zorder=3)
        axes.plot(run.time[deepest], smallest[pair], **look)
    bottom = min(0.0, float(smallest[0]))
    axes.set_ylim(bottom - 0.04 * (top - bottom), top)
    count = len(pairs.names)
    note = f"{count} of {count + pairs.n_others} pairs; the others stay above {np.floor(smallest_other):.0f} mm"
    label_row(
        [axes],
        "Smallest distance\nover a sample (mm)",
        style.join_notes(note if pairs.n_others else "", style.better_side("up", "safer")),
    )
    return style.finish(figure)
