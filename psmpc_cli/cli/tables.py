"""What commands print: robots, tasks, runs and studies as tables."""

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from itertools import count, groupby, zip_longest
from json import dumps
from pathlib import Path

import numpy as np
import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from psmpc_cli.cli.common import BAD, GOOD, WARNING, echo, escaped
from psmpc_cli.logs.comparison import Comparison
from psmpc_cli.logs.numbers import EMPTY, TIME, last_place, number, quantiles
from psmpc_cli.logs.results import Results
from psmpc_cli.logs.run import Run
from psmpc_cli.logs.summary import Summary
from psmpc_cli.ocp.feasibility import LARGEST_UNKNOWN_LOAD
from psmpc_cli.ocp.forecast import StageForecast, forecast_configurations, initial_state
from psmpc_cli.ocp.postures import ArmPosture, arm_postures, largest_load_ratio
from psmpc_cli.ocp.stage import Stage
from psmpc_cli.report.texts import (
    MEASURES,
    NO_LIMITS,
    WHY_RATES_EXCEED,
    Measure,
    Shown,
    brief_measures,
    describe_mission,
    describe_verdict,
    filled_columns,
    measure_rows,
    stage_rows,
    warnings_of,
)
from psmpc_cli.robot.geometry import pieces_of
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.robot.thrusters import Thrusters
from psmpc_cli.robot.wheels import Wheels
from psmpc_cli.simulation.gradient_audit import AD_TOLERANCE, DIFFERENCE_TOLERANCE, audit_gradients
from psmpc_cli.simulation.replay import unequal_conditions
from psmpc_cli.simulation.run import build_experiment, converging
from psmpc_cli.specs.document import counted, plain
from psmpc_cli.specs.fields import Spec
from psmpc_cli.specs.geometry import ShapeSpec, pair_name
from psmpc_cli.specs.load import Task
from psmpc_cli.specs.object import GRASP_LOADS, ObjectSpec
from psmpc_cli.specs.parts import ANGLE, ERROR_AXES, LENGTH, QUANTITIES, TARGET_AXES, axes_of, units_of
from psmpc_cli.specs.priorities import ACCEPTABLE, weigh
from psmpc_cli.specs.robot import PartLimits, RobotSpec, SpatialRobot, labels, resolve_limits, units
from psmpc_cli.specs.task import ObjectEndSpec, PrioritiesSpec, TaskSpec, TrajectorySpec
from psmpc_cli.studies import fronts
from psmpc_cli.studies.compare import describe_terms, recommend_controller
from psmpc_cli.studies.front_movement import FrontMovement
from psmpc_cli.studies.monte_carlo import MonteCarloRuns
from psmpc_cli.studies.sweep import SweepCells, recommend

Row = Sequence[str]

ALL_WITH_VERBOSE = " (-v prints all that was measured)"
"""What a short output says of the rest."""

MOST_ROWS = 49
"""Rows of a sweep's table; of more runs so many are printed, evenly from the smallest to the largest ratio."""


MOST_SHORT = 11
"""Rows of the table of a short output, so that with its headings it has twelve."""


def print_table(headings: Row, rows: Sequence[Row], left: int = 2) -> None:
    """Print a table: as wide as the terminal, or of 160 columns into a file.

    Args:
        headings: Names of the columns, empty for a table without them.
        rows: Cells by row; columns without any content are left out.
        left: Number of columns that are aligned left.
    """
    headings, rows = filled_columns(headings, rows)
    table = Table(box=None, show_header=any(headings), pad_edge=False)
    for i, heading in enumerate(headings):
        table.add_column(Text(heading), justify="right" if i >= left else "left", overflow="fold")
    for row in rows:
        table.add_row(*(Text(escaped(cell)) for cell in row))
    terminal = Console()
    console = terminal if terminal.is_terminal else Console(width=160)
    with console.capture() as capture:
        console.print(table)
    typer.echo("\n".join(line.rstrip() for line in capture.get().splitlines()))  # may have the style of headings


def print_summary(run: Run, verbose: bool) -> None:
    """Print a run: how the mission went, warnings, its stages and what matters most; all of it if `verbose`."""
    summary = run.summary()
    echo(describe_mission(summary), colour=_colour_of(summary))
    for warning in warnings_of(summary):
        echo(f"warning: {warning}", colour=WARNING)
    headings, rows = stage_rows(summary)
    shown = rows if verbose else rows[:MOST_SHORT]
    print_table(headings, shown)
    if len(shown) < len(rows):
        echo(f"{counted(len(rows) - len(shown), 'more stage', 'more stages')}: -v shows all")
    if verbose:
        print_table(("", ""), list(measure_rows(summary)))
    else:
        echo("\n".join(brief_measures(summary)))
    if not summary.limits_dynamics:
        echo(NO_LIMITS)
    echo(f"log: {run.path}{'' if verbose else ALL_WITH_VERBOSE}")


def _colour_of(summary: Summary) -> str:
    """Return the colour of how a mission went."""
    return {True: GOOD, False: BAD, None: WARNING}[summary.succeeded if summary.ended else None]


def print_comparison(runs: Mapping[str, Run], path: Path, verbose: bool) -> None:
    """Print runs of one task, most often one of each controller: the recommended one, then a row for each.

    With `verbose`, all that was measured follows, with differences to the first run. Brackets are explained only where
    they occur, parentheses wherever there is a second run. Where all priorities are equal, psmpc is the same controller
    as smpc.

    Args:
        runs: The runs by name.
        path: The one file that holds them all.
        verbose: Whether all that was measured is printed.
    """
    summaries = {name: run.summary() for name, run in runs.items()}
    recommended = recommend_controller(summaries)
    echo(recommended.sentence, colour=WARNING if recommended.name is None else GOOD)
    for name, summary in summaries.items():
        if summary.succeeded is not True or verbose:
            echo(f"{name}: {describe_mission(summary)}", colour=_colour_of(summary))
        for warning in warnings_of(summary) if verbose else ():
            echo(f"{name}: warning: {warning}", colour=WARNING)
    rows = [[name, *(of(summary) for _, of in COMPARED)] for name, summary in summaries.items()]
    print_table(("controller", *(heading for heading, _ in COMPARED)), rows)
    echo(describe_terms(runs))
    if verbose:
        _print_all_compared(summaries)
    if not any(summary.limits_dynamics for summary in summaries.values()):
        echo(NO_LIMITS)
    if {"psmpc", "smpc"} <= set(summaries) and len({stage.priority for stage in summaries["psmpc"].stages}) == 1:
        echo("psmpc and smpc are the same controller for this task: all its priorities are equal")
    echo(f"logs: {path}{'' if verbose else ALL_WITH_VERBOSE}")


def _outcome(summary: Summary) -> str:
    """Write how a mission went in two words at most."""
    outcomes = {True: "succeeded", False: "failed", None: "not judged"}
    return outcomes[summary.succeeded] if summary.ended else "not finished"


COMPARED: tuple[tuple[str, Callable[[Summary], str]], ...] = (
    ("mission", _outcome),
    ("ends\n[s]", lambda run: number(run.duration, TIME) if run.ended else "-"),
    ("early\nstarts", lambda run: number(sum(stage.early for stage in run.stages))),
    ("effort [m^2/s^3,\nrad^2/s^3]", lambda run: number(run.control_effort)),
    ("base force\nat most [N]", lambda run: number(run.peaks["base_force"])),
    ("solve time,\np99 [ms]", lambda run: number(1e3 * run.solves.p99)),
    ("warnings", lambda run: number(sum(1 for _ in warnings_of(run)))),
)
"""Columns of a short comparison behind the controller: heading, and what is read of a run."""


def _print_all_compared(summaries: Mapping[str, Summary]) -> None:
    """Print all that was measured of runs side by side, with differences to the first one."""
    first, *others = summaries
    rows = [row for row in _compared(list(summaries.values())) if any(cell not in EMPTY for cell in row[1:])]
    print_table(("", *summaries), rows, left=1)
    if others:
        echo(f"in parentheses: difference to {first}")
    if any("[" in cell for row in rows for cell in row[1:]):
        echo("in brackets: published")


def _compared(runs: Sequence[Summary]) -> Iterator[Row]:
    """Yield the rows of a comparison: a measure of every run."""
    for stages in zip(*(run.stages for run in runs), strict=True):
        name = stages[0].name
        published = [each.published_start for each in stages]
        starts = _differences([each.actual_start for each in stages], TIME, published)
        early = ("early " if each.early else "" for each in stages)
        yield f"{name} actually starts [s]", *map("".join, zip(early, starts, strict=True))
        published = [each.published_switch for each in stages]
        yield f"{name} ends [s]", *_differences([each.switch_time for each in stages], TIME, published)
        yield f"{name} lasts [s]", *_differences([each.duration for each in stages], TIME)
    yield "end of the run [s]", *_differences([run.duration for run in runs], TIME)
    for measure in MEASURES:
        if Shown.COMPARED in measure.shown:
            yield measure.heading, *_measured(measure, runs)
    for verdicts in zip(*(run.monitors for run in runs), strict=True):
        yield f"monitor: {verdicts[0].name}", *map(describe_verdict, verdicts)


def _measured(measure: Measure, runs: Sequence[Summary]) -> list[str]:
    """Write a measure of every run, numbers with their differences."""
    values = [measure.of(run) for run in runs]
    numbers = [value for value in values if not isinstance(value, str)]
    return _differences(numbers, measure.resolution) if numbers else [str(value or "-") for value in values]


def _differences(values: Sequence[float], resolution: float, published: Sequence[float] = ()) -> list[str]:
    """Write numbers, those after the first with their difference to it, each with what was published of it."""
    texts = [number(value, resolution) for value in values]
    for i, value in enumerate(values[1:], start=1):
        difference = value - values[0]
        if math.isnan(difference):
            continue
        step = 0.0 if isinstance(difference, int) else 10.0 ** last_place(max(values[0], value, key=abs), resolution)
        texts[i] += " (=)" if texts[i] == texts[0] else f" ({number(difference, step, sign='+')})"
    marks = ["" if math.isnan(value) else f" [{number(value, 0.1)}]" for value in published] or [""] * len(texts)
    return list(map("".join, zip(texts, marks, strict=True)))


def print_differences(comparison: Comparison, log: Run) -> None:
    """Print how a repeated run differs from its log, and the conditions under which that is to be expected."""
    if not comparison.differences:
        echo(f"equal: all {comparison.compared} datasets but the wall times")
        return
    rows = []
    for each in comparison.differences:
        largest = "" if math.isnan(each.largest) else f"{each.largest:.1e}"
        text = f"{largest} ({each.what})" if largest and each.what else each.what or largest
        rows.append((each.path, each.units, text, "" if each.row < 0 else str(each.row)))
    print_table(("dataset", "units", "largest difference", "first in row"), rows)
    echo(f"differs: {len(rows)} of {comparison.compared} datasets; wall times were not compared")
    for condition in unequal_conditions(log):
        echo(f"note: {condition}")


def print_sweep(cells: SweepCells, verbose: bool) -> None:
    """Print a sweep over weights, complete or not: the recommended ratio, runs, and the cells by status.

    With `verbose` there is a row for each run, up to `MOST_ROWS`, with the starts by every threshold, end errors, and
    why a mission failed.
    """
    recommended = recommend(cells)
    echo(recommended.headline, colour=WARNING if recommended.ratio is None else GOOD)
    echo(recommended.reason)
    if len(cells.rows):
        _print_runs(cells, verbose)
    solves = cells.count("solves")
    failed = cells.count("solves_failed")
    echo(f"{len(cells.ratio)} cells: {_by_status(cells.results)}; {solves} solves, {failed} of them failed")
    for reason, times in Counter(cells.of("reason")[cells.failed]).most_common():
        echo(f"  {times} failed: {reason}")
    echo(f"sweep: {cells.results.path}{'' if verbose else ALL_WITH_VERBOSE}")


def print_key_sweep(results: Results) -> None:
    """Print what became of each run of a sweep over keys, complete or not."""
    succeeded = results["succeeded"]
    axes = [results[key] for key in results.quantities["succeeded"].dims]
    rows = [
        (*(str(axis[i]) for axis, i in zip(axes, cell, strict=True)), *_end_of_run(results, cell))
        for cell in np.ndindex(succeeded.shape)
    ]
    echo(f"{int(np.nansum(succeeded))} of {succeeded.size} runs succeeded: {_by_status(results)}")
    keys = results.quantities["succeeded"].dims
    print_table((*keys, "succeeded", "end [s]", "why"), rows[:MOST_ROWS], left=len(keys) + 1)
    if len(rows) > MOST_ROWS:
        echo(f"{len(rows) - MOST_ROWS} more runs in {results.path}")


def _end_of_run(results: Results, cell: tuple[int, ...]) -> Row:
    """Write whether a run of a study succeeded, when it ended and why; nothing of one that was not run."""
    if not np.isfinite(results["end_time"][cell]):
        return "", "", str(results["reason"][cell])
    return (
        "yes" if results["succeeded"][cell] == 1 else "no",
        f"{results['end_time'][cell]:.2f}",
        str(results["reason"][cell]),
    )


def _by_status(results: Results) -> str:
    """Write how many cells of a study there are of every status."""
    meanings = results.quantities["status"].meanings
    counts = [np.count_nonzero(results["status"] == code) for code in range(len(meanings))]
    return ", ".join(f"{n} {name}" for n, name in zip(counts, meanings, strict=True) if n)


def _print_runs(cells: SweepCells, verbose: bool) -> None:
    """Print a row for each run of a sweep, failed or not, or for some of many."""
    first, second = cells.names
    runs = cells.rows
    most = MOST_ROWS if verbose else MOST_SHORT
    apart = len(runs) > len(np.unique([f"{ratio:.9g}" for ratio in cells.ratio[runs]]))
    kept = runs[np.unique(np.linspace(0, len(runs) - 1, min(len(runs), most)).round().astype(int))]
    ends = [cells.instant, cells.of("completion_time")]
    thresholds = range(len(cells.epsilons)) if verbose else [cells.chosen]
    rows = [
        (
            *(f"{each:.4g}" for each in (cells.omega[run] if apart else cells.ratio[run : run + 1])),
            *(
                number(start, 0.1 if start < cells.instant[run] else TIME)
                for start in cells.of("actual_start")[run][thresholds]
            ),
            *(number(float(values[run]), TIME) for values in ends),
            number(float(cells.mission_end[run]), TIME) if cells.succeeded[run] else "failed",
            *(number(float(cells.of(name)[run])) for name in ("control_effort", "peak_base_force")),
            *((number(float(cells.end_error[run]), 0.01), cells.why(run)) if verbose else ()),
        )
        for run in kept
    ]
    over = ("omega_1", "omega_2") if apart else ("omega_2/omega_1",)
    if verbose:
        echo(f"actual start of {second} [s] by threshold epsilon")
        starts = [f"{epsilon:g}" for epsilon in cells.epsilons]
    else:
        starts = [f"{second}\nstarts [s]"]
    measured = (f"{first}\nends [s]", f"{second}\nends [s]", "mission\nends [s]", "effort [m^2/s^3,\nrad^2/s^3]")
    last = ("end error\n[tolerance]", "why") if verbose else ()
    print_table((*over, *starts, *measured, "base force\nat most [N]", *last), rows, left=0)
    if len(kept) < len(runs):
        echo(f"{len(kept)} of {len(runs)} {'runs' if apart else 'ratios'}")


def print_monte_carlo(runs: MonteCarloRuns, verbose: bool) -> None:
    """Print a Monte Carlo study, complete or not: the success rate, the spread of the runs, and the worst of them."""
    rate, *cautions = _success(runs)
    echo(rate)
    for caution in cautions:
        echo(f"warning: {caution}", colour=WARNING)
    rows = [(name, number(len(values)), *quantiles(values, (0.05, 0.5, 0.95))) for name, values in runs.spread()]
    shown = rows if verbose else rows[:MOST_SHORT]
    print_table(("over the runs that have it", "runs", "5 %", "50 %", "95 %"), shown, left=1)
    if len(shown) < len(rows):
        echo(f"{counted(len(rows) - len(shown), 'more quantity', 'more quantities')}: -v shows all")
    if runs.is_without_limits:
        echo(NO_LIMITS)
        if runs.exceeded("velocity").any():
            echo(WHY_RATES_EXCEED)
    if worst := [int(run) for run in runs.worst(count=5)]:
        echo("worst runs: failed, latest, largest error")
        rows = []
        for run in worst:
            seed = str(runs["seed"][run])
            outcome = "failed" if runs.failed[run] else "succeeded" if runs.succeeded[run] else "not judged"
            end = number(float(runs["end_time"][run]), TIME)
            error = number(float(runs["final_error"][run]))
            rows.append((seed, outcome, end, error, runs.why(run)))
        print_table(("seed", "", "ends [s]", "final error [tolerances]", "why"), rows)
        echo(f"repeat one: {runs.command(worst[0])}")
    echo(f"study: {runs.results.path}")


def _success(runs: MonteCarloRuns) -> list[str]:
    """Write how many runs succeeded, with the rate's interval and the runs by status; then how many exceeded limits."""
    made = int(runs.made.sum())
    succeeded = int(runs.succeeded.sum())
    states = _by_status(runs.results)
    if not made:
        return [f"no run was made yet: {states}"]
    low, high = runs.interval
    rate = f"{100 * succeeded / made:.1f} %, 95 % interval {100 * low:.1f} to {100 * high:.1f} %"
    parts = [f"{succeeded} of {made} runs succeeded: {rate} ({states})"]
    for kind in ("position", "velocity"):
        beyond = runs.exceeded(kind)
        if count := np.count_nonzero(beyond):
            parts.append(f"{count} of {made} exceeded a {kind} limit, by up to {100 * beyond.max():.2g} %")
    if runs.keeps_clear.any() and (count := np.count_nonzero(runs["touched"] == 1)):
        parts.append(f"{count} of {made} touched what they keep clear of")
    return parts


def print_fronts(results: Results) -> None:
    """Print a Pareto study: how the fronts move, and a row for each sample."""
    movement = FrontMovement(results) if "weighted_J_1" in results.quantities else None
    if movement is not None:
        echo(movement.over_ratio)
    print_table(fronts.HEADINGS, fronts.front_texts(results), left=0)
    echo(fronts.NOTE)
    for sentence in movement.over_time if movement is not None else ():
        echo(sentence)
    echo(f"results: {results.path}")


def print_task(task: Task, forecasts: Sequence[StageForecast]) -> None:
    """Print a task: what runs it, its stages part by part, and its object."""
    spec = task.spec
    controller = task.spec.controller
    echo(f"{spec.name}: {spec.description}" if spec.description else spec.name)
    echo(
        f"robot {task.robot.name}{_mobility(task.robot)}; "
        f"controller {controller.kind}, horizon {controller.horizon:g} s, {controller.nodes} nodes a stage, "
        f"sample time {controller.sample_time:g} s; "
        f"solver {spec.solver.kind}; plant {spec.plant.kind}"
    )
    if spec.priorities is not None:
        echo(_comparisons(spec.priorities, [stage.name for stage in spec.stages]))
    if spec.uncertainty.in_force:
        echo(f"uncertain, seed {spec.seed}, delay {_known_delay(task)}:")
        echo("\n".join(f"  {line}" for line in _changes(spec.uncertainty, "uncertainty")))
    headings = ("stage", "part", "target", "ends within", "distance of reach", "not before")
    print_table(headings, [row for forecast in forecasts for row in _stage(task, forecast)], left=len(headings))
    model = forecasts[0].model
    stages = [forecast.stage for forecast in forecasts]
    stops = forecast_configurations(task, forecasts)
    if rows := [_posture(task.robot, each) for each in arm_postures(model, stages, stops)]:
        echo()
        print_table(("at the target of", "arm", "joints", "end-effector"), rows, left=4)
    if limits := [(coordinate, force) for coordinate, *_, force in _limits(task.robot, spec.limits) if force]:
        echo()
        print_table(("coordinate", "limit of force, of robot and task"), limits, left=2)
    if spec.fires(task.robot):
        echo()
        echo(_thrusters(task.robot))
    if rows := list(_turns(task, model, stages)):
        echo()
        print_table(TURNS, rows, left=1)
    if rows := [*_obstacles(spec), *_clearance(task)]:
        echo()
        print_table(("clearance", ""), rows)
    if spec.object is not None:
        echo()
        print_table(("object", ""), [*_object(spec.object), *_unknown_load(task, model, stops)])


def _known_delay(task: Task) -> str:
    """Write what the controller knows of the delay of commands."""
    delay = task.spec.controller.delay
    if delay != "auto":
        return f"known as {delay:g} s"
    if task.spec.finds_delay(task.robot):
        return "found out"
    return "taken for none: pulses of thrusters cannot be told from one, so give it if there is one"


def _obstacles(task: TaskSpec) -> Iterator[Row]:
    """Yield a row for each obstacle: its shape, where it is and how it moves."""
    for obstacle in task.obstacles:
        drift = f", moves at {_listed(obstacle.velocity)} m/s" if any(obstacle.velocity) else ""
        yield f"obstacle {obstacle.name}", f"{_shape(obstacle.shape)} at {_pose(obstacle.pose)}{drift}"


def _shape(shape: ShapeSpec) -> str:
    """Write a shape with its sizes."""
    if shape.sphere is not None:
        return f"sphere of radius {shape.sphere:g} m"
    if shape.capsule is not None:
        radius, length = shape.capsule
        return f"capsule of radius {radius:g} m about {length:g} m"
    if shape.box is not None:
        return f"box of {' x '.join(f'{edge:g}' for edge in shape.box)} m"
    return f"half-space with normal {_listed(shape.half_space or ())}"


def _clearance(task: Task) -> Iterator[Row]:
    """Yield how far apart a task keeps what, in its stages too, and what its robot is made of for that."""
    spec = task.spec
    own = {f"in {stage.name}": stage.clearance for stage in spec.stages}
    for where, clearance in {"at least": spec.clearance, **own}.items():
        if clearance is not None:
            excepted = ", ".join(pair_name(*pair) for pair in clearance.excepted)
            but = f", but not {excepted}" if excepted else ""
            yield where, f"{1e3 * clearance.margin:g} mm, {'hard' if clearance.hard else 'soft'}{but}"
    if spec.keeps_clear:
        yield "robot", _geometry(task.robot)


def _geometry(robot: RobotSpec) -> str:
    """Write how many capsules the bodies of a robot have where distances count, and where they are from."""
    pieces = pieces_of(robot)
    counts = Counter(piece.part for piece in pieces)
    origin = "from its file" if robot.geometry else "fitted to its joints"
    by_body = ", ".join(f"{body} {n}" for body, n in counts.items())
    return f"{counted(len(pieces), 'capsule', 'capsules')} {origin}: {by_body}"


def _posture(robot: RobotSpec, posture: ArmPosture) -> Row:
    """Build the row of an arm at the target of a stage: its joints, and the pose of its end-effector."""
    joints = "none found"
    if posture.joints is not None:
        axes = axes_of(robot.parts, "joint", False)[posture.arm]
        joints = _target(posture.arm, list(zip(axes, posture.joints.tolist(), strict=True)), robot.sliding)
    return posture.stage, posture.arm, joints, _pose(posture.pose.tolist())


def _unknown_load(task: Task, model: RobotModel, stops: Sequence[np.ndarray]) -> Iterator[Row]:
    """Yield how large a load is against the robot, where the low-level law does not know of it."""
    if task.spec.body.grasp.known:
        return
    largest = largest_load_ratio(task, model, stops)
    if largest is None:
        return
    where = f"in a motion mostly of {largest.coordinate}, where {largest.stage} leads"
    yield "load over the robot's inertia", f"{largest.ratio:.3g} {where}; expected at most {LARGEST_UNKNOWN_LOAD:g}"


def _mobility(robot: RobotSpec) -> str:
    """Write what moves the base, where it is not thrusters."""
    return "" if robot.moved_by.actuated else f", {robot.mobility}"


def print_robot(robot: RobotSpec) -> None:
    """Print a robot: its bodies, and the limits of its coordinates."""
    echo(f"{robot.name}: {robot.description}" if robot.description else robot.name)
    d = robot.dimension
    bodies = robot.bodies
    total = sum(body.mass for body in bodies)
    kind = "planar" if d == 2 else "spatial"
    echo(f"{kind}{_mobility(robot)}, {sum(robot.parts.values())} degrees of freedom, {total:.6g} kg")
    rows: list[Row] = []
    carried = [("", "", "")]
    for each in robot.joints:
        at = each.at
        kind = "prismatic along" if each.prismatic else "revolute about"
        turn = math.degrees(math.hypot(*at.rotation))
        carrier = f"{bodies[at.body].name} at {_listed(at.position[:d])} m{f', {turn:.4g} deg' if turn else ''}"
        armature = f"{each.armature:g} {'kg' if each.prismatic else 'kg m^2'}" if each.armature else ""
        carried.append(("revolute" if d == 2 else f"{kind} {_listed(each.axis)}", carrier, armature))
    for body, (joint, carrier, armature) in zip(bodies, carried, strict=True):
        inertia = body.inertia[2:3] if d == 2 else body.inertia
        row = (body.name, joint, carrier, f"{body.mass:g}", _listed(body.centre[:d]), _listed(inertia), armature)
        rows.append(row)
    headings = ("body", "joint", "on", "mass [kg]", "centre of mass [m]", "inertia [kg m^2]", "armature")
    print_table(headings, rows, left=len(headings))
    echo()
    print_table(("coordinate", *QUANTITIES), _limits(robot), left=1 + len(QUANTITIES))
    echo()
    echo(f"shape: {_geometry(robot)}")
    if robot.thrusters:
        echo(_thrusters(robot))
    if robot.wheels:
        echo(_wheels(robot))
    if isinstance(robot, SpatialRobot) and robot.assumed:
        echo("assumed:")
        echo("\n".join(f"  {note}" for note in robot.assumed))


def _wheels(robot: RobotSpec) -> str:
    """Write what the reaction wheels of a robot can give and store about each axis of the base, about it alone."""
    wheels = Wheels.of(robot)
    axes = ERROR_AXES[robot.dimension][robot.dimension :]
    of_axes = []
    for axis, direction in zip(axes, np.eye(len(axes)), strict=True):
        torque, momentum = wheels.along(direction)
        of_axes.append(f"{axis} {torque:.3g} N m, {momentum:.3g} N m s" if torque else f"{axis} alone nothing")
    return f"{counted(wheels.count, 'reaction wheel', 'reaction wheels')}: about {'; '.join(of_axes)}"


def _turns(task: Task, model: RobotModel, stages: Sequence[Stage]) -> Iterator[Row]:
    """Yield what wheels give about each axis of the base, and how fast that turns the robot, its arms as at the start.

    The whole robot turns about its centre of mass, and wheels at rest store what it has then.
    """
    turned = [stage for stage in stages if stage.moved_by.is_turned and not stage.moved_by.is_pushed]
    wheels = Wheels.of(task.robot)
    if not (turned and wheels.count):
        return
    Q, _ = initial_state(task)
    rotation = model.space.rotation
    inertia = model.inertia_about_centre(Q)
    fastest = min((stage.limits.velocity_high[rotation] for stage in turned), key=lambda limits: float(limits.min()))
    for axis, direction, limit in zip(
        ERROR_AXES[model.dimension][rotation], np.eye(len(inertia)), fastest, strict=True
    ):
        torque, momentum = wheels.along(direction)
        _, rate = wheels.along(inertia @ direction)
        needs = ""
        if np.isfinite(limit):
            needs = f"{math.degrees(limit):.3g} deg/s, {limit * float(direction @ inertia @ direction):.3g} N m s"
        yield axis, f"{torque:.3g} N m", f"{momentum:.3g} N m s", f"{math.degrees(rate):.3g} deg/s", needs


TURNS = ("turn about", "wheels give", "wheels store", "so it turns at most at", "limit of velocity, takes")
"""Headings of what wheels give and store."""


def _thrusters(robot: RobotSpec) -> str:
    """Write what the thrusters of a robot give at most along each axis of the base, and whether they are used."""
    low, high = Thrusters.of(robot.thrusters).extent
    axes = ERROR_AXES[robot.dimension]
    units = [units_of("base", axis, ()).force for axis in axes]
    of_axes = (f"{axis} {-a:.4g} to {b:.4g} {unit}" for axis, a, b, unit in zip(axes, -low, high, units, strict=True))
    unused = "" if robot.moved_by.is_pushed else f", off where the base is {robot.mobility}"
    return f"{counted(len(robot.thrusters), 'thruster', 'thrusters')}{unused}, at most: {', '.join(of_axes)}"


def _listed(numbers: Sequence[float]) -> str:
    """Write numbers in a row, none of them as -0."""
    return " ".join(f"{number + 0.0:.4g}" for number in numbers)


def _comparisons(priorities: PrioritiesSpec, stages: list[str]) -> str:
    """Write the number of comparisons behind the priorities, and how consistent they are."""
    weighed = weigh(priorities.compare, stages)
    count = len(priorities.compare)
    agreement = f"consistency ratio {weighed.ratio:.2g}, acceptable up to {ACCEPTABLE:g}"
    agreement = agreement if weighed.surplus > 0 else "as few as possible, so their consistency is not known"
    return f"priorities from {counted(count, 'comparison', 'comparisons')}: {agreement}"


def _stage(task: Task, forecast: StageForecast) -> list[Row]:
    """Build the rows of one stage, one for each part."""
    stage = forecast.stage
    spec = task.spec.stages[forecast.stage.index]
    sizes = task.robot.parts
    space = task.spec.skills[spec.skill].wanted_in
    about = [spec.name, f"{spec.skill} ({space})", f"priority {spec.priority:g}"]
    about += [f"follows {spec.target.times[-1]:g} s"] if isinstance(spec.target, TrajectorySpec) else []
    about += [stage.moved_by.name] if stage.moved_by != task.robot.moved_by else []
    about += ["plumes avoided"] if task.spec.avoids_plumes(stage.index, task.robot) else []
    about += [f"at least {spec.dwell:g} s"] if spec.dwell else []
    if spec.ends_when and spec.ends_when.object:
        about += [f"object within {_object_end(spec.ends_when.object)}"]
    numbers = iter(stage.target)
    row = count()
    parts = []
    rests = [""] * len(stage.end.rows)
    if stage.end.rate_tolerance is not None:
        moving = stage.end.own_rates if len(stage.end.own_rates) else np.zeros(len(rests))
        bounds = zip(stage.end.rate_tolerance, moving, strict=True)
        rests = [f" ({f'{rate:g} +- ' if rate else ''}{each:g}/s)" for each, rate in bounds]
    asked_of = zip(stage.end.rows, stage.end.tolerance, rests, strict=True)
    tolerances = {row: f"{tolerance:g}{rest}" for row, tolerance, rest in asked_of}
    for (part, rows), axes in zip(axes_of(sizes, space).items(), axes_of(sizes, space, False).values(), strict=True):
        target = ("to " if stage.reference.moves else "") + _target(
            part, list(zip(axes, numbers, strict=False)), task.robot.sliding
        )
        if part == "base" and not (stage.moved_by.actuated or stage.relevant_rows[: len(rows)].any()):
            target = stage.moved_by.name
        asked = [tolerances.get(next(row), "-") for _ in rows]
        within = asked[0] if len(set(asked)) == 1 else ", ".join(asked)
        ends = f"at {spec.at:g} s" * (part == "base") if spec.at is not None else "" if within == "-" else within
        reach = forecast.reaches.get(part)
        parts.append((part, target, ends, f"{reach.distance:.3f} of {reach.full_reach:.3f} m" if reach else ""))
    earliest = [f"{math.floor(forecast.earliest_end * 100) / 100:g} s"]
    lines = zip_longest(about, parts, earliest)
    return [(left or "", *(middle or ("",) * 4), right or "") for left, middle, right in lines]


def _object_end(end: ObjectEndSpec) -> str:
    """Write what an end condition asks of the object."""
    lengths = ((end.position, "m"), (end.velocity, "m/s"))
    angles = ((end.angle, "deg"), (end.angular_velocity, "deg/s"))
    written = [f"{value:g} {unit}" for value, unit in lengths if value is not None]
    written += [f"{math.degrees(value):.4g} {unit}" for value, unit in angles if value is not None]
    return ", ".join(written)


def _target(part: str, values: Sequence[tuple[str, float]], sliding: Collection[str] = ()) -> str:
    """Write the target of a part, coordinates by axis in their order: lengths, angles in degrees, or an attitude.

    Args:
        part: The part.
        values: Its axes, and the numbers of them.
        sliding: Names of the joint coordinates that are lengths.
    """
    written = []
    for own, group in groupby(values, key=lambda each: units_of(part, each[0], sliding)):
        numbers = [value for _, value in group]
        if own == LENGTH:
            written.append(f"{', '.join(f'{value:g}' for value in numbers)} m")
        elif own == ANGLE:
            written.append(f"{', '.join(f'{math.degrees(value):.4g}' for value in numbers)} deg")
        else:
            turn = 2 * math.atan2(math.hypot(*numbers[1:]), abs(numbers[0]))
            written.append(f"turned by {math.degrees(turn):.4g} deg")
    return ", ".join(written)


def _object(target_object: ObjectSpec) -> Iterator[Row]:
    """Yield the rows of a task's object: what it is, how it moves, how it is grasped, and where it has to be."""
    yield "size", f"{' x '.join(f'{extent:g}' for extent in target_object.shape)} m"
    yield "pose at the start", _pose(target_object.pose)
    yield "taken", f"at the end of {target_object.taken_by}"
    let_go = target_object.let_go_by
    yield "let go", "never: it is held to the end" if let_go is None else f"at the beginning of {let_go}"
    body = target_object.body
    if body.mass == 0.0:
        return
    yield "mass", f"{body.mass:g} kg"
    yield "inertia", f"{_listed(body.inertia)} kg m^2"
    drift = f"{_listed(body.motion.linear)} m/s, {_listed_in_degrees(body.motion.angular)} deg/s"
    yield "drift", drift if body.motion.moves else "none"
    grasp = body.grasp
    for arm, pose in grasp.at.items():
        yield f"grasp of {arm}", _pose(pose)
    envelope = grasp.envelope
    position = f"{envelope.position:g} m, {math.degrees(envelope.angle):.4g} deg"
    velocity = f"{envelope.velocity:g} m/s, {math.degrees(envelope.angular_velocity):.4g} deg/s"
    yield "grippers close within", f"{position}, {velocity}"
    stiffness, angular_stiffness = grasp.stiffness
    yield (
        "stiffness of a grasp",
        f"{stiffness:g} N/m, {angular_stiffness:g} N m/rad, damping ratio {grasp.damping_ratio:g}",
    )
    strength = grasp.strength
    largest = dict(zip(GRASP_LOADS, grasp.largest_loads, strict=True))
    bounds = (f"{load} {largest[load]:g} {unit}" for load, unit in GRASP_LOADS.items() if math.isfinite(largest[load]))
    holds = "any load" if strength is None else f"{', '.join(bounds)}, filtered over {strength.filter:g} s"
    yield "a grasp holds", holds
    yield "load known to the low-level law", "found out" if grasp.is_estimated else "yes" if grasp.known else "no"
    destination = body.destination
    if destination is not None:
        d = len(target_object.shape)
        angles = _listed_in_degrees(destination.tolerance[d:])
        yield "destination", _pose(destination.pose)
        yield "destination within", f"{_listed(destination.tolerance[:d])} m, {angles} deg"
        yield "speed at the destination", f"at most {destination.speed:g} m/s"


def _pose(pose: Sequence[float]) -> str:
    """Write a pose in the plane or in space, there with the axis about which it is turned."""
    axes = next(axes for axes in TARGET_AXES.values() if len(axes) == len(pose))
    length = math.copysign(math.hypot(*pose[4:]), pose[3]) if len(pose) > 3 else 0.0
    about = f" about {_listed([each / length for each in pose[4:]])}" if length else ""
    return _target("base", list(zip(axes, pose, strict=True))) + about


def _listed_in_degrees(angles: Sequence[float]) -> str:
    """Write angles [rad] in a row, in degrees."""
    return _listed([math.degrees(angle) for angle in angles])


def _limits(robot: RobotSpec, *more: Mapping[str, PartLimits]) -> list[Row]:
    """Build the rows of the limits of every coordinate, angles in degrees; empty where there is none.

    Args:
        robot: The robot.
        more: Limits that hold besides its own, such as a task's.
    """
    limits = resolve_limits(robot, *more)
    rows = list[Row]()
    for row, (label, own) in enumerate(zip(labels(robot, "joint"), units(robot), strict=True)):
        spans = [label]
        for quantity in QUANTITIES:
            unit = getattr(own, quantity)
            low, high = (float(getattr(limits, f"{quantity}_{end}")[row]) for end in ("low", "high"))
            if unit == "rad":
                unit = "deg"
                low = math.degrees(low)
                high = math.degrees(high)
            spans.append("" if math.isinf(low) and math.isinf(high) else f"{low:.4g} to {high:.4g} {unit}")
        rows.append(spans)
    return rows


def print_gradients(task: Task) -> bool:
    """Audit the gradient at every switch of a task, print it, and tell whether it agrees with both references."""
    audits = audit_gradients(build_experiment(converging(task)))
    nodes = task.spec.controller.uniform_nodes
    echo("Gradient of the cost by the switching instant")
    rows = []
    for audit in audits:
        gaps = (f"{gap:.1e}" for gap in (audit.to_differentiation, audit.to_differences, *audit.costate_gaps))
        rows.append((" to ".join(audit.switch), f"{audit.gradient:.4f}", *gaps, "yes" if audit.holds else "NO"))
    headings = ("switch", "dJ/dt_s [1/s]", "adjoint - AD", "adjoint - differences")
    print_table((*headings, f"costate gap, N_s = {nodes}", f"N_s = {2 * nodes}", "agrees"), rows, left=1)
    echo(
        f"Differences are relative; expected: at most {AD_TOLERANCE:g} and {DIFFERENCE_TOLERANCE:g}. The costate "
        "formula's gap, taken at an optimum without limits and end conditions, halves with twice the nodes."
    )
    return all(audit.holds for audit in audits)


def _changes(spec: Spec, path: str) -> Iterator[str]:
    """Yield a line for every key that differs from its default, with its description."""
    for name, field in type(spec).model_fields.items():
        value = getattr(spec, name)
        if isinstance(value, Spec):
            yield from _changes(value, f"{path}.{name}")
        elif value != field.default:
            yield f"{path}.{name}: {dumps(plain(value))} ({field.description})"
