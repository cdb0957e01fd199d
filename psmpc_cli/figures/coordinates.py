"""Coordinates over time: states, velocities, controls, forces, and errors against the tolerances of the stages."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from psmpc_cli.figures import style
from psmpc_cli.figures.timeline import label_row, runs_as_list, timeline
from psmpc_cli.logs.run import Run, Span
from psmpc_cli.logs.summary import FAR_BEYOND
from psmpc_cli.ocp.problem import Problem, in_own_chart
from psmpc_cli.ocp.stage import Stage
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.simulation.measures import NOT_CUT
from psmpc_cli.specs.parts import ANGLE as ANGLE_UNITS
from psmpc_cli.specs.parts import LENGTH, axes_of, units_of

POSITION = ("position", "m")
ANGLE = ("angle", "rad")
"""Names and units of what states are."""

TO_TARGET = "to the target"
"""Name of the angle to the attitude that the current stage aims at."""

SEEN = "seen by the controller"
"""Look of the values that the controller saw."""

PANEL_HEIGHT = 0.87
"""Height of a panel of coordinates [in]."""

LIMIT_DISTANCE = 4.0
"""Limits farther away than so many times the largest value are not drawn."""

MOST_LINES = 4
"""Most coordinates that share a panel; the joints of an arm with more are in several."""

SMALLEST_ERROR = 1e-5
"""Smaller errors are not shown [m, rad]."""


@dataclass(frozen=True)
class CoordinatePanel:
    """The coordinates that share a panel.

    Attributes:
        part: The base or an arm, as it is written.
        quantity: Name of what is drawn, such as velocity.
        unit: Of what is drawn.
        rows: Rows of the coordinates in v, which have one unit.
        labels: Names of the rows in the legend.
    """

    part: str
    quantity: str
    unit: str
    rows: Sequence[int]
    labels: Sequence[str]


@dataclass(frozen=True, eq=False)
class ErrorCurve:
    """The largest error of a part against the target of one stage, over the time of that stage.

    Attributes:
        span: The stage.
        part: The base, an arm, or a part that only the stage's skill has.
        angular: Whether the errors are angles.
        time: Times (K,) [s].
        error: Largest error at each time (K,) [m] or [rad].
        tolerance: The tightest tolerance of the end condition [m] or [rad]; NaN where it does not ask for this part.
    """

    span: Span
    part: str
    angular: bool
    time: np.ndarray
    error: np.ndarray
    tolerance: float


def plot_states(runs: Run | Mapping[str, Run]) -> Figure:
    """Plot base pose [m, rad] and joint angles [rad], of a run or of several side by side. Paper Figs. 8 to 10.

    Of one run it also shows what the controller saw of them. In space the attitude is a rotation vector, beside the
    angle to the attitude the current stage aims at [rad], where it aims at one.
    """
    curves = [(run.motion.time, _unrolled_coordinates(run, run.motion.Q)) for run in runs_as_list(runs)]
    seen = (SEEN, _unrolled_coordinates(runs, runs.motion.Q_seen)) if isinstance(runs, Run) else None
    return _plot_quantity(runs, POSITION, ANGLE, curves, second_curve=seen)


def plot_velocities(run: Run) -> Figure:
    """Plot generalized velocities [m/s, rad/s] with the limits in force and what the controller saw."""
    curves = [(run.motion.time, run.motion.v)]
    seen = (SEEN, run.motion.v_seen)
    linear = ("velocity", "m/s")
    angular = ("velocity", "rad/s")
    return _plot_quantity(run, linear, angular, curves, second_curve=seen, limits="velocity")


def plot_controls(run: Run) -> Figure:
    """Plot the applied accelerations [m/s^2, rad/s^2], constant over each sample, with the limits in force.

    Those of a base without thrusters are what the plan has for its reaction.
    """
    # the last control is repeated at the end of the run, so that its step is as long as its sample
    held = [(np.r_[run.time, run.motion.end], np.vstack([run.u, run.u[-1:]]))]
    linear = ("control", "m/s²")
    angular = ("control", "rad/s²")
    return _plot_quantity(run, linear, angular, held, limits="acceleration", drawstyle="steps-post")


def plot_forces(run: Run) -> Figure:
    """Plot base force [N], base torque and joint torques [N m] of a run, with the limits in force.

    Forces are drawn at every tick (a short step of the simulated plant) if ticks were logged, else at every sample.
    With ticks, the commanded force is drawn too where it was cut at its limit. The force on the base is along the
    inertial axes. If it has limits, it is along the base's own axes, as these limits are.
    """
    ticks = run.ticks
    has_ticks = len(ticks.get("time", ())) > 0
    time, Q, F = (ticks["time"], ticks["Q"], ticks["F"]) if has_ticks else (run.time, run.Q, run["force/F"])
    commanded = ticks.get("commanded", F) if has_ticks else F
    axes_note = ""
    if limits_base_force(run):
        axes_note = ", own axes"
        F = along_base_axes(run.problem.model, Q, F)
        commanded = along_base_axes(run.problem.model, Q, commanded)
    # (K, n); commands that differ from F by rounding alone are not marked
    is_cut = np.abs(commanded - F) > NOT_CUT * np.abs(commanded).max(axis=0, initial=0.0)
    cut_commands = ("commanded, cut", np.where(is_cut, commanded, np.nan)) if is_cut.any() else None
    return _plot_quantity(
        run,
        linear=("force", "N"),
        angular=("torque", "N m"),
        curves=[(time, F)],
        second_curve=cut_commands,
        limits="force",
        heading=_describe_tightest_force(run),
        base_unit_note=axes_note,
    )


def _describe_tightest_force(run: Run) -> str:
    """Write which commanded force came nearest to its limit, and how long forces were cut; empty without limits."""
    summary = run.summary()
    force = summary.tightest_force
    if force is None:
        return ""
    part, _, axis = force.where.rpartition(".")
    of = "its limit" if run.task.spec.uncertainty.force_share == 1 else "what is there"
    largest = f"{style.readable(part)}.{axis} commanded up to {100 * force.value:.1f} % of {of}, at {force.time:.1f} s"
    far = f"beyond {100 * FAR_BEYOND:g} % of a limit {100 * summary.far_beyond:.1f} %"
    return f"{largest}\nforces cut {100 * summary.saturated:.1f} % of the time, {far}"


def limits_base_force(run: Run) -> bool:
    """Tell whether a stage has a limit of the force on the base, or thrusters have one."""
    if run.task.spec.fires(run.problem.model.spec):
        return True
    linear = slice(run.problem.model.dimension)
    bounds = [(stage.limits.force_low[linear], stage.limits.force_high[linear]) for stage in run.problem.stages]
    return bool(np.isfinite(bounds).any())


def along_base_axes(model: RobotModel, Q: np.ndarray, F: np.ndarray) -> np.ndarray:
    """Turn the force on the base in generalized forces F (K, n) at coordinates Q (K, nq) into its own axes."""
    return np.column_stack(model.space.along_base_axes(Q.T, F.T))


def _unrolled_coordinates(run: Run, Q: np.ndarray) -> np.ndarray:
    """Return coordinates (K, nq) as (K, n): a quaternion becomes a rotation vector that is continuous in time."""
    return run.problem.model.space.unrolled(Q)


def attitude_error(run: Run) -> np.ndarray:
    """Compute how far the base of a spatial robot is turned from the attitude that the current stage aims at.

    The figure of states shows it beside the attitude itself, whose rotation vector does not say how far it has to go.

    Returns:
        An angle (N,) [rad] for each state of the run's motion. It is NaN where the stage asks for no attitude, and at
        the first state of each stage but the first, so that the curve has a gap where its target changes.
    """
    attitude = slice(3, 6)  # errors of a spatial robot begin with the base's position and its rotation vector
    motion = run.motion
    angle = np.full(len(motion.time), np.nan)
    for span in run.spans:
        stage = run.followed(span)
        in_span = (motion.time >= span.start) & (motion.time <= span.end)
        if in_span.any() and stage.relevant_rows[attitude].any():
            errors = _stage_errors(run.problem, stage, motion.Q[in_span], motion.time[in_span] - span.start)
            angle[in_span] = np.linalg.norm(errors[:, attitude], axis=1)
            if span.index > 0:
                angle[np.flatnonzero(in_span)[0]] = np.nan
    return angle


def plot_overlay(runs: Mapping[str, Run]) -> Figure:
    """Plot every coordinate [m, rad] of several runs, with the curves of all runs in one panel, to compare them.

    There is a panel for each coordinate of base and arms that varies in some run, with a curve for each run. Dots mark
    the ends of stages.

    Args:
        runs: The runs by controller, of one task.
    """
    model = next(iter(runs.values())).problem.model
    labelled_rows: list[tuple[str, int]] = []  # for each panel its label, and the column of the states that it shows
    states = [(run.motion.time, _unrolled_coordinates(run, run.motion.Q)) for run in runs.values()]
    for panel in panels_that_vary(model, coordinate_panels(model, POSITION, ANGLE), [Q for _, Q in states]):
        quantity = "attitude " if panel.quantity == "attitude" else ""
        for row, label in zip(panel.rows, panel.labels, strict=True):
            labelled_rows.append((f"{panel.part} {quantity}{label}\n({panel.unit})", row))

    figure = style.new_figure(style.PAGE)
    columns = 3
    rows = -(-len(labelled_rows) // columns)  # rounded up
    # `style.finish` makes rows as high as their height ratios say [in]
    grid = figure.subplots(rows, columns, sharex=True, squeeze=False, height_ratios=[1.3] * rows)
    for axes, (label, row) in zip(grid.flat, labelled_rows, strict=False):
        for number, ((name, run), (time, Q)) in enumerate(zip(runs.items(), states, strict=True)):
            look = style.line_look(number)
            values = Q[:, row]
            axes.plot(
                time,
                values,
                linewidth=1.2,
                label=style.shared_label(style.escape_dollars(style.title_of(name))),
                **look,
            )
            # the stages that have ended
            switches = run.stages["switch_time"][np.isfinite(run.stages["switch_time"])]
            values_at_switches = np.interp(switches, time, values)
            axes.plot(switches, values_at_switches, "o", markersize=3, color=look["color"])
        axes.set_ylabel(label)
    for axes in grid.flat[len(labelled_rows) :]:
        axes.set_visible(False)
    for axes in grid.flat[: len(labelled_rows)][-columns:]:  # the lowest of each column
        axes.set_xlabel("Time (s)")
        axes.tick_params(labelbottom=True)
    # draws nothing, but is the entry of the dots in the common legend
    grid[0, 0].plot([], [], "o", markersize=3, color=style.EDGE, label=style.shared_label("ends of stages"))
    return style.finish(figure)


def _plot_quantity(
    runs: Run | Mapping[str, Run],
    linear: tuple[str, str],
    angular: tuple[str, str],
    curves: Sequence[tuple[np.ndarray, np.ndarray]],
    second_curve: tuple[str, np.ndarray] | None = None,
    limits: Literal["velocity", "acceleration", "force"] | None = None,
    drawstyle: Literal["default", "steps-post"] = "default",
    heading: str = "",
    base_unit_note: str = "",
) -> Figure:
    """Plot a quantity of all generalized coordinates over time: positions, velocities, controls or forces.

    There is a row of panels for base position, base angles and each arm, and a column for each run.

    Args:
        runs: A run, or several by controller.
        linear: Name and unit of the quantity for linear coordinates.
        angular: Name and unit for angular coordinates.
        curves: For each run the times (K,) [s] and the values (K, n).
        second_curve: What is drawn besides for every coordinate of a single run: the name of a look in `style.LOOKS`,
            and values (K, n). It is left out if it equals the first curve.
        limits: The limits of the stages that bound the quantity and are drawn; None for none.
        drawstyle: How values are joined: by straight lines, or as steps that hold each value until the next one.
        heading: What is written above the figure.
        base_unit_note: What is added to the unit of the base's linear coordinates, such as in which axes they are.
    """
    model = runs_as_list(runs)[0].problem.model
    panels = coordinate_panels(model, linear, angular, base_unit_note)
    panels = panels_that_vary(model, panels, [values for _, values in curves])
    # names that will stand beside the ends of lines
    labels = [label for panel in panels for label in (*panel.labels, *[TO_TARGET] * (panel.quantity == "attitude"))]
    figure, grid = timeline(runs, len(panels), PANEL_HEIGHT, beside=labels)
    for row_of_axes, panel in zip(grid, panels, strict=True):
        for axes, run, (time, all_values) in zip(row_of_axes, runs_as_list(runs), curves, strict=True):
            values = all_values[:, panel.rows]
            for i, label in enumerate(panel.labels):
                axes.plot(time, values[:, i], label=label, drawstyle=drawstyle, **style.line_look(i))
            axes.margins(y=0.08)
            if limits is not None:
                _plot_limits(axes, run, limits, panel.rows, values)
            if second_curve is not None and not np.array_equal(second_curve[1], all_values, equal_nan=True):
                look_name, second_values = second_curve
                axes.plot(time, second_values[:, panel.rows], **style.look(look_name))
            # beside the attitude of a base in space, how far it is from the one that the stage aims at
            if panel.quantity == "attitude" and np.isfinite(angle := attitude_error(run)).any():
                axes.plot(time, angle, label=TO_TARGET, color="black", linewidth=0.8)

        note = style.use_symlog_if_peaks_hide_rest(
            row_of_axes[0], np.vstack([values[:, panel.rows] for _, values in curves])
        )
        label_row(row_of_axes, _axis_label(panel), note)
    if heading:
        figure.suptitle(heading)
    return style.finish(figure)


def _axis_label(panel: CoordinatePanel) -> str:
    """Write part, quantity and unit in as few lines, two at least, as are shorter than a panel is high."""
    unit = f"({panel.unit})"
    for lines in ((f"{panel.part} {panel.quantity}", unit), (panel.part, f"{panel.quantity} {unit}")):
        if max(map(len, lines)) * style.CHARACTER < PANEL_HEIGHT:
            return "\n".join(lines)
    return f"{panel.part}\n{panel.quantity}\n{unit}"


def coordinate_panels(
    model: RobotModel, linear: tuple[str, str], angular: tuple[str, str], base_unit_note: str = ""
) -> list[CoordinatePanel]:
    """Choose the panels of a figure of generalized coordinates: base position, base angles, and the joints of each arm.

    Joints that turn and joints that slide have panels of their own, since their units differ. Where a panel would have
    more than `MOST_LINES` lines, they are divided among several panels with about as many lines each.

    Args:
        model: The robot.
        linear: Name and SI unit of the quantity for linear coordinates.
        angular: Name and SI unit of it for angular coordinates.
        base_unit_note: What is added to the unit of the base's linear coordinates.

    Returns:
        The panels, base first. Each says which rows of a velocity v (n,), and so of the quantity, it shows.
    """
    panels = _panels_of_parts(model, linear, angular, base_unit_note)
    return [divided_panel for panel in panels for divided_panel in _split_if_crowded(panel)]


def _split_if_crowded(panel: CoordinatePanel) -> Iterator[CoordinatePanel]:
    """Divide a panel into some of about as many lines each, none with more than can be told apart."""
    for places in np.array_split(np.arange(len(panel.rows)), -(-len(panel.rows) // MOST_LINES)):
        rows = [panel.rows[place] for place in places]
        yield replace(panel, rows=rows, labels=[panel.labels[place] for place in places])


def panels_that_vary(
    model: RobotModel, panels: Sequence[CoordinatePanel], values: Sequence[np.ndarray]
) -> list[CoordinatePanel]:
    """Leave out the panels of a base that nothing drives where its values (K, n) of all runs never change."""
    if model.spec.moved_by.actuated:
        return list(panels)
    every = np.vstack(values)
    varies = np.any(every[1:] != every[:-1], axis=0)
    return [panel for panel in panels if panel.rows[0] >= model.parts["base"].stop or varies[list(panel.rows)].any()]


def _panels_of_parts(
    model: RobotModel, linear: tuple[str, str], angular: tuple[str, str], base_unit_note: str
) -> Iterator[CoordinatePanel]:
    """Yield the panels of a figure of generalized coordinates, however many lines each then has.

    The base has a panel of its position and one of its angles. Each arm has a panel of its turning joints and one of
    its sliding joints, as far as it has such joints.

    Args:
        model: The robot.
        linear: Name and SI unit of the quantity for linear coordinates.
        angular: Name and SI unit of it for angular coordinates.
        base_unit_note: What is added to the unit of the base's linear coordinates.
    """
    base = model.parts["base"]
    d = model.dimension
    other_names = {} if d == 2 else {"angle": "attitude"}  # quantities that have another name for the base
    if not model.spec.moved_by.actuated:
        other_names["control"] = "acceleration"  # nothing moves the base, so its acceleration is no control
    quantity, unit = linear
    positions = range(base.start, base.start + d)
    yield CoordinatePanel("Base", other_names.get(quantity, quantity), unit + base_unit_note, positions, "xyz"[:d])

    quantity, unit = angular
    angles = range(base.start + d, base.stop)
    yield CoordinatePanel("Base", other_names.get(quantity, quantity), unit, angles, ("θ",) if d == 2 else "xyz")

    for name, rows in list(model.parts.items())[1:]:  # the first part is the base
        for unit_of_panel, (quantity, unit) in ((ANGLE_UNITS, angular), (LENGTH, linear)):
            rows_in_unit = [row for row in range(rows.start, rows.stop) if model.units[row] == unit_of_panel]
            numbers = [row - rows.start + 1 for row in rows_in_unit]
            labels = [f"joint {number}" for number in numbers]
            if rows_in_unit:
                yield CoordinatePanel(style.readable(name).capitalize(), quantity, unit, rows_in_unit, labels)


def _plot_limits(axes: Axes, run: Run, kind: str, rows: Sequence[int], values: np.ndarray) -> None:
    """Draw the limits of the current stage that are not far off the values, in the colours of their lines."""
    time = np.array([edge for span in run.spans for edge in (span.start, span.end)])
    limits = [run.problem.stages[span.index].limits for span in run.spans for _ in ("start", "end")]
    sides = [np.array([getattr(limit, f"{kind}_{side}")[rows] for limit in limits]) for side in ("low", "high")]
    for limit, places in limits_in_view(sides, values):
        style.draw_limit(axes, time, limit, [style.line_look(place)["color"] for place in places], "limit")


def limits_in_view(limits: Sequence[np.ndarray], values: np.ndarray) -> list[tuple[np.ndarray, list[int]]]:
    """Choose which limits a panel shows: those near its curves, each once with all the coordinates that it bounds.

    A limit far off the values would squeeze the curves, so it is left out where its size is more than `LIMIT_DISTANCE`
    times the largest value. Coordinates with the same limit share one line.

    Args:
        limits: Lower and upper limits of the coordinates over time, two arrays (T, coordinates).
        values: The values of the same coordinates, (K, coordinates), at times of their own.

    Returns:
        Pairs of a limit over time (T,), NaN where it is left out, and the columns of `values` that it bounds.
    """
    # where all values are 0, all limits are drawn
    largest_drawn = LIMIT_DISTANCE * float(np.nanmax(np.abs(values), initial=0.0)) or np.inf
    lines_of_limit: dict[bytes, tuple[np.ndarray, list[int]]] = {}
    for side in limits:
        drawn_limit = np.where(np.abs(side) < largest_drawn, side, np.nan)
        # equal limits have equal bytes, which can be the key of a dictionary
        for line in np.flatnonzero(np.isfinite(drawn_limit).any(axis=0)).tolist():
            _, lines = lines_of_limit.setdefault(drawn_limit[:, line].tobytes(), (drawn_limit[:, line], []))
            lines.append(line)
    return list(lines_of_limit.values())


def plot_errors(run: Run) -> Figure:
    """Plot how far base and arms are from the current stage's target, to show how stages come to their ends.

    A curve is the largest error of a group of coordinates: base position [m], base angle [rad], and of each arm its
    joints [rad or m], or the position [m] and the angle [rad] of its end-effector. Coordinates count if they are in the
    stage's end condition, and a line shows their tolerance. In a group without such coordinates those count that have a
    weight in its cost; a group without either has no curve. Where the target is a trajectory, the error is against its
    present value. There is a panel of errors in m and one of errors in rad, both logarithmic.
    """
    curves = list(error_curves(run))
    units_shown = sorted({curve.angular for curve in curves})
    parts_shown = {curve.part for curve in curves}
    looks = {part: _part_look(index) for index, part in enumerate(error_parts(run)) if part in parts_shown}
    figure, grid = timeline(run, rows=len(units_shown), height=1.35, beside=map(style.readable, looks))
    panels = dict(zip(units_shown, grid[:, 0], strict=True))
    in_legend: set[tuple[bool, str]] = set()  # a part has a curve for each stage, but one entry in each legend
    for curve in curves:
        axes = panels[curve.angular]
        look = looks[curve.part]
        label = style.NO_LABEL if (curve.angular, curve.part) in in_legend else style.readable(curve.part)
        in_legend.add((curve.angular, curve.part))
        axes.plot(curve.time, np.where(curve.error > 0, curve.error, np.nan), label=label, **look)
    # curves of one stage with the same tolerance share its line
    for span, angular, tolerance in dict.fromkeys((curve.span, curve.angular, curve.tolerance) for curve in curves):
        if np.isfinite(tolerance):
            parts = [
                curve_of_part.part
                for curve_of_part in curves
                if (curve_of_part.span, curve_of_part.angular, curve_of_part.tolerance) == (span, angular, tolerance)
            ]
            colors = [looks[part]["color"] for part in parts]
            style.draw_limit(panels[angular], [span.start, span.end], [tolerance] * 2, colors, "tolerance")

    labels = ("Position error\n(m)", "Angle error\n(rad)")
    kinds_of_error = ("largest coordinate", "largest joint or angle")
    for angular, axes in panels.items():
        axes.set_yscale("log")
        axes.set_ylim(bottom=max(axes.get_ylim()[0], SMALLEST_ERROR))
        axes.yaxis.set_minor_formatter(NullFormatter())
        label_row([axes], labels[angular], style.join_notes(kinds_of_error[angular], style.better_side("down")))
    return style.finish(figure)


def error_parts(run: Run) -> list[str]:
    """Return the names of what a run's errors are of: base and arms, then the parts that only its skills have."""
    parts = run.problem.model.spec.parts
    of_stages = (part for stage in run.problem.stages for part in axes_of(parts, stage.space))
    return list(dict.fromkeys([*parts, *of_stages]))


def error_curves(run: Run) -> Iterator[ErrorCurve]:
    """Yield the curves of `plot_errors`: for each stage and group of coordinates the largest error against the target.

    A group is all coordinates of one part (base or arm) that are lengths, or all that are angles. Of a group only the
    coordinates in the stage's end condition count. If it has none of these, those with a weight in the stage's cost do,
    and a group without either has no curve. A stage to which the run returned has curves for each time it was current.
    """
    motion = run.motion
    parts_of_robot = run.problem.model.spec.parts
    sliding = run.problem.model.spec.sliding
    for span in run.spans:
        in_span = (motion.time > span.start) & (motion.time < span.end)
        time = np.r_[span.start, motion.time[in_span], span.end]
        stage = run.followed(span)  # with the target that it had in this span
        Q = np.array([motion.coordinates_at(t) for t in time])
        errors = np.abs(_stage_errors(run.problem, stage, Q, time - span.start))
        tolerances = dict(zip(stage.end.rows, stage.end.tolerance, strict=True))

        # the rows of the stage's error are those of its parts one after the other, one for each of a part's axes
        first_row = 0
        for part, axes in axes_of(parts_of_robot, stage.space).items():
            is_angle = [units_of(part, axis, sliding) != LENGTH for axis in axes]
            for angular in (False, True):
                rows = [row for row, is_angular in enumerate(is_angle, start=first_row) if is_angular == angular]
                rows_in_end = [row for row in rows if row in tolerances]
                if rows_shown := rows_in_end or [row for row in rows if stage.relevant_rows[row]]:
                    largest = errors[:, rows_shown].max(axis=1)
                    tightest = min((tolerances[row] for row in rows_in_end), default=np.nan)
                    yield ErrorCurve(span, part, angular, time, largest, tightest)
            first_row += len(axes)


def _stage_errors(problem: Problem, stage: Stage, Q: np.ndarray, since: np.ndarray) -> np.ndarray:
    """Compute a stage's errors (K, rows) at coordinates (K, nq), at times since its start (K,) [s].

    In space every attitude has a chart of its own, and of a target's two quaternions the nearer one counts.
    """
    errors = []
    at_rest = np.zeros(problem.model.n)
    for q, time in zip(Q, since, strict=True):
        placed, x = in_own_chart(problem.model, stage, q, at_rest, time)
        errors.append(problem.costs.errors(placed, x[None], np.array([time]))[0])
    return np.array(errors)


def _part_look(index: int) -> dict[str, Any]:
    """Return colour and line style of a part: black for the base, then the arms as in the snapshots."""
    return {"color": style.PALETTE[-1], "linestyle": "-"} if index == 0 else style.line_look(index - 1)
